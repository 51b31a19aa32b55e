"""`twohands generate` through the command line: what it says, and what it refuses without touching anything."""

import json
import signal
import subprocess
import sys
import time

import cv2
import numpy as np
import pytest

from twohands.cli.generate import _at_frame_size
from twohands.cli.main import main
from twohands.cli.progress import RateLog, duration
from twohands.errors import RendererError
from twohands.synth.render import blender, raster
from twohands.synth.scene.config import WILD, SynthConfig

SMALL = ["--count", "3", "--workers", "1", "--config.width", "128", "--config.height", "72"]


def generate(*arguments: object) -> int:
    return main(["generate", "static", *SMALL, *map(str, arguments)])


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and lines[0].startswith("twohands: error: "), lines
    return lines[0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--seed", -1], "seed must be 0 or a larger whole number, got -1"),
        (["--count", 0], "--count must be at least 1, got 0"),
        (["--count", -1], "--count must be at least 1, got -1"),
        (["--sequences", -2], "--sequences must be at least 1, got -2"),
        (["--count", 10**9], "count must be 1 to"),
        (["--workers", -1], "--workers must be 0"),
        (["--config.drop-rate", "nan"], "drop_rate must lie in"),
        (["--config.drop-rate", 1], "drop_rate must lie in"),
        (["--config.box-min", "0.5", "0", "0.3"], "hand box is empty"),
        (["--config.box-max", "0.1", "nan", "0.5"], "hand box is empty"),
        (["--config.box-max", "inf", "inf", "inf"], "hand box must be finite"),
        (["--config.box-min", "-inf", "0", "0.3"], "hand box must be finite"),
        (["--config.width", 40000, "--config.height", 32], "image must be 32 to 16384 pixels a side, got 40000x32"),
        (["--config.skin-tones", "0.8", "0.2"], "skin_tones must be an ordered pair"),
        (["--config.hand-length", 9], "hand_length must lie in"),
        (["--config.lights", 0], "lights must be 1 to 4"),
        (["--format", "webdataset", "--shard-size", 0], "shard size must be at least 1"),
        (["--backgrounds", "/nowhere"], "background folder /nowhere does not exist"),
        (["--fabrics", "/nowhere", "--preset", "wild"], "fabric folder /nowhere does not exist"),
        (["--fabrics", "/nowhere", "--preset", "wild", "--renderer", "blender"], "Blender draws no fabrics"),
        (["--fabrics", "/nowhere"], "--fabrics needs people with sleeves or gloves"),
    ],
)
def test_nonsense_is_one_line_and_exit_code_2(tmp_path, capsys, arguments, message):
    assert generate("--out", tmp_path / "set", *arguments) == 2
    assert message in one_line(capsys)
    assert not list(tmp_path.rglob("0*"))


def test_what_is_given_counts_even_where_it_is_the_other_preset_s_default(tmp_path):
    """Named case: --preset wild --config.sensor 0 once kept the camera's noise, for 0 is preset paper's default."""
    given = ["--preset", "wild", "--config.sensor", "0", "--config.fov", "None"]
    assert generate("--out", tmp_path / "set", *given) == 0
    config = json.loads((tmp_path / "set" / "manifest.json").read_text())["config"]
    assert config["sensor"] == 0 and config["fov"] is None and (config["width"], config["height"]) == (128, 72)
    assert all(config[name] == getattr(WILD, name) for name in ("sleeves", "gestures", "free_view", "hand_length"))


def test_bad_backgrounds_are_one_line(tmp_path, capsys):
    (tmp_path / "photos").mkdir()
    assert generate("--out", tmp_path / "set", "--backgrounds", tmp_path / "photos") == 2
    assert "no background picture" in one_line(capsys)
    (tmp_path / "photos" / "a.jpg").write_bytes(b"no picture")
    assert generate("--out", tmp_path / "set", "--backgrounds", tmp_path / "photos") == 2
    assert "none of the 1 background pictures" in one_line(capsys)
    assert not (tmp_path / "set").exists()


def test_skipped_backgrounds_are_counted_and_named_at_the_end(tmp_path, capsys):
    (tmp_path / "photos").mkdir()
    cv2.imwrite(str(tmp_path / "photos" / "good.png"), np.full((40, 60, 3), 90, np.uint8))
    for name in ("bad.jpg", "empty.png"):
        (tmp_path / "photos" / name).write_bytes(b"x" if name == "bad.jpg" else b"")
    assert generate("--count", 8, "--out", tmp_path / "set", "--backgrounds", tmp_path / "photos") == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-3:] == [
        "2 files were skipped:",
        "  background bad.jpg cannot be read",
        "  background empty.png cannot be read",
    ]


def test_skipped_fabrics_of_frames_are_named_too(tmp_path, capsys):
    """Named case: what the workers had met was lost."""
    (tmp_path / "cloth").mkdir()
    cv2.imwrite(str(tmp_path / "cloth" / "good.png"), np.full((40, 60, 3), 90, np.uint8))
    (tmp_path / "cloth" / "bad.jpg").write_bytes(b"x")
    options = ["--frame-width", "64", "--count", "8", "--config.sleeves", "1", "--fabrics", str(tmp_path / "cloth")]
    for workers in ("1", "2"):
        out = str(tmp_path / workers)
        assert main(["generate", "frames", "--out", out, "--workers", workers, *options]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert lines[-2:] == ["1 files were skipped:", "  fabric bad.jpg cannot be read"]


def test_without_opengl_the_package_to_install_is_named(tmp_path, capsys, monkeypatch):
    def fail(**_):
        raise RuntimeError("libEGL.so not loaded")

    import moderngl

    monkeypatch.setattr(moderngl, "create_standalone_context", fail)
    with pytest.raises(RendererError):
        raster.renderer_name()
    for kind in ("static", "frames"):
        assert main(["generate", kind, "--out", str(tmp_path / kind), *SMALL[:4]]) == 2
        message = one_line(capsys)
        assert "apt-get install libegl1" in message and "--renderer blender" in message
        assert not (tmp_path / kind).exists()


def test_without_blender_the_extra_is_named(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(blender, "_blender", blender.import_blender)
    monkeypatch.setitem(sys.modules, "bpy", None)
    for kind in ("static", "dynamic", "frames"):
        assert main(["generate", kind, "--renderer", "blender", "--out", str(tmp_path / kind), *SMALL[:4]]) == 2
        assert "pip install 'twohands[blender]'" in one_line(capsys)
        assert not (tmp_path / kind).exists()


def test_without_blenders_libraries_the_packages_are_named(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(blender, "_blender", blender.import_blender)
    monkeypatch.delitem(sys.modules, "bpy", raising=False)
    (tmp_path / "bpy.py").write_text("raise ImportError('libXi.so.6: cannot open shared object file')")
    monkeypatch.syspath_prepend(tmp_path)
    assert main(["generate", "static", "--renderer", "blender", "--out", str(tmp_path / "set")]) == 2
    message = one_line(capsys)
    assert "libXi.so.6" in message and "apt-get install" in message and "libxi6" in message


def test_a_set_keeps_its_renderer(tmp_path, capsys, monkeypatch):
    assert generate("--out", tmp_path / "set") == 0
    capsys.readouterr()
    monkeypatch.setattr(blender, "renderer_name", lambda: "Cycles")
    assert generate("--out", tmp_path / "set", "--renderer", "blender") == 2
    assert 'renderer is "raster" there, "blender" here' in one_line(capsys)


def test_another_run_is_not_touched(tmp_path, capsys):
    assert generate("--out", tmp_path / "set") == 0
    before = sorted((path, path.stat().st_mtime_ns) for path in (tmp_path / "set").rglob("*"))
    capsys.readouterr()
    for arguments in (["--split", "test"], ["--seed", 3], ["--format", "webdataset"]):
        assert generate("--out", tmp_path / "set", *arguments) == 2
        assert "holds another set" in one_line(capsys)
    assert sorted((path, path.stat().st_mtime_ns) for path in (tmp_path / "set").rglob("*")) == before


def test_frames_take_no_backgrounds(tmp_path, capsys):
    assert main(["generate", "frames", "--out", str(tmp_path / "c"), "--split", "test"]) == 2
    assert "frames have no background" in one_line(capsys)
    for width in ("0", "500"):
        assert main(["generate", "frames", "--out", str(tmp_path / "c"), "--frame-width", width]) == 2
        assert f"--frame-width must be a multiple of 16, got {width}" in one_line(capsys)


@pytest.mark.slow
def test_ctrl_c_says_how_to_go_on(tmp_path):
    """To the whole process group, as a terminal sends it: no traceback of any process."""
    options = ["--count", "5000", "--workers", "2", "--config.width", "128", "--config.height", "72"]
    command = [sys.executable, "-m", "twohands.cli.main", "generate", "static", "--out", str(tmp_path / "s"), *options]
    run = subprocess.Popen(
        command,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background jobs ignore Ctrl-C
    )
    index = tmp_path / "s" / "index.jsonl"
    while run.poll() is None and not (index.is_file() and index.stat().st_size):
        time.sleep(0.05)
    import os

    os.killpg(run.pid, signal.SIGINT)
    _, errors = run.communicate(timeout=600)
    assert run.returncode == 130
    assert errors.splitlines()[-1] == "twohands: interrupted" and "Traceback" not in errors
    assert "run the same command again" in errors


def test_rate_and_time_left_count_this_run_only():
    """40 of 100 were there; 20 more in 10 s are 2 a second, and the last 40 take 20 s."""
    said: list[str] = []
    now = iter([0.0, 5.0, 10.0, 12.0])
    log = RateLog("frames", said.append, clock=lambda: next(now), seconds=8.0)
    for done in (40, 50, 60, 64):
        log(done, 100)
    assert said == ["frames 60/100, 2.0/s, 0:20 left"]
    assert [duration(s) for s in (0, 59.6, 3600, 11220)] == ["0:00", "1:00", "1:00:00", "3:07:00"]


def test_given_intrinsics_shrink_with_the_frames():
    """Named case: those of 960x540 pictures were kept for frames of 480x270."""
    config = _at_frame_size(SynthConfig(width=960, height=540, intrinsics=(400.0, 410.0, 480.0, 270.0)), 480)
    assert (config.width, config.height) == (480, 270)
    assert config.intrinsics == (200.0, 205.0, 240.0, 135.0)
    assert _at_frame_size(SynthConfig(), 480).intrinsics is None
