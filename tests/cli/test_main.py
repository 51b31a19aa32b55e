"""The command itself: help, version, mistakes, exit codes, what is imported."""

import dataclasses
import importlib
import os
import subprocess
import sys
import typing

import pytest

import twohands
from twohands.cli import main as main_module
from twohands.cli.main import VERBS, main
from twohands.errors import InputError


@pytest.mark.parametrize("arguments", [[], ["--help"], ["-h"]])
def test_help_names_every_verb_with_one_line(arguments, capsys):
    assert main(arguments) == 0
    lines = capsys.readouterr().out.splitlines()
    for verb, what in VERBS.items():
        assert sum(line.split() == [verb, *what.split()] for line in lines) == 1


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"twohands {twohands.__version__}\n"


def test_the_package_runs_as_a_module():
    done = subprocess.run([sys.executable, "-m", "twohands", "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, f"twohands {twohands.__version__}\n")
    assert subprocess.run([sys.executable, "-m", "twohands", "xyzzy"], capture_output=True, check=False).returncode == 2


@pytest.mark.parametrize(
    ("word", "hint"), [("trak", "did you mean 'track'?"), ("xyzzy", "known: track"), ("--foo", "known:")]
)
def test_an_unknown_verb_is_one_line_and_exit_2(word, hint, capsys):
    assert main([word]) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1
    assert f"unknown command '{word}'" in captured.err and hint in captured.err


@pytest.mark.parametrize(
    "arguments", [["track"], ["track", "a.png", "--nonsense"], ["track", "a.png", "--fov", "wide"]]
)
def test_arguments_that_cannot_be_parsed_are_exit_2(arguments, capsys):
    assert main(arguments) == 2
    assert capsys.readouterr().err


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_keeps_the_contract_and_has_help(verb, capsys):
    try:
        module = importlib.import_module(f"twohands.cli.{verb.replace('-', '_')}")
    except ModuleNotFoundError as error:
        assert error.name in main_module._EXTRA_OF_MODULE, error
        pytest.skip(f"needs {error.name}")
    hints = typing.get_type_hints(module.run)
    assert hints.pop("return") is int
    (config,) = hints.values()
    for kind in typing.get_args(config) or (config,):
        assert dataclasses.is_dataclass(kind)
    assert main([verb, "--help"]) == 0
    assert f"twohands {verb}" in capsys.readouterr().out


def fake_verb(monkeypatch, error):
    @dataclasses.dataclass(frozen=True)
    class Nothing:
        """No arguments."""

    def run(args: Nothing) -> int:
        raise error

    run.__annotations__ = {"args": Nothing, "return": int}
    module = type(sys)("fake", "A verb that fails.")
    module.run = run  # type: ignore[attr-defined]
    monkeypatch.setattr(main_module, "VERBS", {"fake": "fails"})
    monkeypatch.setitem(sys.modules, "twohands.cli.fake", module)


def test_an_expected_failure_is_one_line_and_exit_2(monkeypatch, capsys):
    fake_verb(monkeypatch, InputError("this\nis  wrong"))
    assert main(["fake"]) == 2
    assert capsys.readouterr().err == "twohands: error: this is wrong\n"


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (PermissionError(13, "Permission denied", "private/a.npz"), "private/a.npz: Permission denied"),
        (OSError(36, "File name too long", "aaa"), "aaa: File name too long"),
        (OSError(28, "No space left on device"), "No space left on device"),
        (OSError("without a number"), "without a number"),
    ],
)
def test_a_file_that_the_system_refuses_is_one_line_and_exit_2(error, message, monkeypatch, capsys):
    fake_verb(monkeypatch, error)
    assert main(["fake"]) == 2
    assert capsys.readouterr().err == f"twohands: error: {message}\n"


def test_a_name_too_long_for_a_file_is_one_line_for_verbs_that_look_at_files(capsys):
    name = "a" * 300
    report = ["eval", "report", "d", "--predictions", f"{name}.npz", "--out", "report"]
    for words in (["inspect", name], ["bench", name], report):
        assert main(words) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and name in error, words


def test_bake_replaces_nothing_and_names_the_file(tmp_path, capsys):
    asset = tmp_path / "arms.npz"
    asset.write_bytes(b"precious")
    assert main(["bake", "--out", str(asset)]) == 2
    assert capsys.readouterr().err == f"twohands: error: {asset}: exists already; choose another --out\n"
    assert asset.read_bytes() == b"precious"


def test_ctrl_c_is_exit_130_without_traceback(monkeypatch, capsys):
    fake_verb(monkeypatch, KeyboardInterrupt())
    assert main(["fake"]) == 130
    assert capsys.readouterr().err == "twohands: interrupted\n"


@pytest.mark.parametrize("environment", [{}, {"PYTHONUNBUFFERED": "1"}])
def test_a_reader_that_left_is_exit_141_without_a_word(environment):
    """As for a program that SIGPIPE ends: what was to be done is not done."""
    script = "import sys; from twohands.cli.main import main; sys.exit(main(['--help']))"
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-c", script], stdout=writer, stderr=subprocess.PIPE, env=os.environ | environment, check=False
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (141, b"")


def test_a_name_that_is_no_text_is_printed_all_the_same():
    script = r"""
import sys
from twohands.cli import main as module
module._run = lambda words: print(words[0]) or 0
sys.exit(module.main(["caf\udce9.png"]))"""
    environment = os.environ | {"PYTHONIOENCODING": "utf-8:strict"}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, env=environment, check=False)
    assert (done.returncode, done.stdout.split()) == (0, [rb"caf\udce9.png"]), done.stderr


def test_a_missing_extra_is_named(monkeypatch, capsys):
    fake_verb(monkeypatch, ModuleNotFoundError("No module named 'torch.nn'", name="torch.nn"))
    assert main(["fake"]) == 2
    assert "pip install 'twohands[train]'" in capsys.readouterr().err


def test_our_own_bugs_are_not_hidden(monkeypatch):
    fake_verb(monkeypatch, ModuleNotFoundError("No module named 'numppy'", name="numppy"))
    with pytest.raises(ModuleNotFoundError):
        main(["fake"])


def imported_by(code: str) -> set[str]:
    script = f"{code}\nimport sys\nprint(*{{name.split('.')[0] for name in sys.modules}}, file=sys.stderr)"
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return set(result.stderr.split())


def test_import_and_help_are_light():
    heavy = {"numpy", "cv2", "openvino", "torch", "matplotlib", "tyro", "rich", "moderngl"}
    assert not heavy & imported_by("import twohands")
    assert not heavy & imported_by("from twohands.cli.main import main; main(['--help'])")


def test_tracking_imports_no_extra():
    modules = imported_by("import twohands.cli.track, twohands.cli.demo")
    assert not {"torch", "moderngl", "matplotlib", "safetensors", "onnx", "lightning", "scipy"} & modules


def test_every_public_name_is_there():
    assert set(twohands.__all__) <= set(dir(twohands))
    for name in twohands.__all__:
        assert getattr(twohands, name).__name__ == name
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = twohands.nonsense
