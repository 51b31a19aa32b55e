"""How a command ends, where it lets others keep their caches, and how its warnings are said."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.datasets import fakes
from tests.oracles import write_tiny_weights

from twohands.cli import process, track
from twohands.cli.main import main
from twohands.errors import PlausibilityWarning

EXAMPLES = Path(track.__file__).parents[1] / "examples_data"


@pytest.fixture(scope="module")
def weights(tmp_path_factory) -> str:
    return str(write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny"))


def folder_of_pictures(folder: Path, count: int) -> Path:
    folder.mkdir()
    picture = sorted(EXAMPLES.glob("*.png"))[0].read_bytes()
    for number in range(count):
        (folder / f"{number}.png").write_bytes(picture)
    return folder


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_folder_that_is_ended_keeps_what_is_done(number, weights, tmp_path, monkeypatch, capsys):
    """`docker stop` and schedulers send SIGTERM, a terminal that is closed SIGHUP."""
    folder, out = folder_of_pictures(tmp_path / "in", 4), tmp_path / "out"
    estimate = track.HandEstimator.estimate

    def ended(self, *args, index, **more):
        if index == 2:
            signal.raise_signal(number)
        return estimate(self, *args, index=index, **more)

    monkeypatch.setattr(track.HandEstimator, "estimate", ended)
    monkeypatch.setattr(track, "_write_views", lambda *_: True)
    default = signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL
    own = signal.signal(number, default)  # what started the tests may ignore it, as nohup does
    before = signal.getsignal(number)
    try:
        code = main(["track", str(folder), "--out", str(out), "--weights", weights])
        assert code == 128 + number and signal.getsignal(number) is before
    finally:
        signal.signal(number, own)
    record = json.loads((out / "hands.json").read_text())
    assert [frame["file"] for frame in record["frames"]] == ["0.png", "1.png"]
    assert not list(out.glob(".*")), "no part of a file is left"
    assert capsys.readouterr().err.splitlines()[-1].startswith("twohands: ")


def test_results_are_written_now_and_then(weights, tmp_path, monkeypatch):
    """So that an end that lets nothing more be done leaves all but the last seconds."""
    monkeypatch.setattr(track, "KEEP_EVERY_S", 0.0)
    monkeypatch.setattr(track, "_write_views", lambda *_: True)
    folder, out = folder_of_pictures(tmp_path / "in", 3), tmp_path / "out"
    counts = []
    write = track.write_file

    def counted(path, content):
        write(path, content)
        if path.name == "hands.json":
            counts.append(len(json.loads(path.read_text())["frames"]))

    monkeypatch.setattr(track, "write_file", counted)
    assert main(["track", str(folder), "--out", str(out), "--weights", weights]) == 0
    assert counts == [1, 2, 3, 3]


def test_a_full_disk_keeps_what_is_done(weights, tmp_path, monkeypatch, capsys):
    folder, out = folder_of_pictures(tmp_path / "in", 4), tmp_path / "out"
    write = Path.write_bytes

    def full(path: Path, content: bytes) -> int:
        if "2_overlay" not in path.name:
            return write(path, content)
        write(path, content[: len(content) // 2])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(track, "_write_views", lambda *_: True)
    monkeypatch.setattr(Path, "write_bytes", full)
    assert main(["track", str(folder), "--out", str(out), "--weights", weights]) == 2
    assert "2_overlay.png: cannot be written: No space left on device" in capsys.readouterr().err
    assert len(json.loads((out / "hands.json").read_text())["frames"]) == 3, "the third was estimated, too"
    assert not list(out.glob(".*"))


def test_only_the_first_signal_counts_and_children_end_as_ever():
    with process.ending_like_ctrl_c():
        with pytest.raises(process.EndedBySignal):
            signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGTERM)  # while what is done is being saved
        child = os.fork()
        if child == 0:
            signal.raise_signal(signal.SIGTERM)
            os._exit(0)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGTERM


class EndsWithASignal:
    def __del__(self) -> None:
        signal.raise_signal(signal.SIGTERM)


def test_a_signal_while_an_object_is_taken_away_is_not_lost():
    """matplotlib's figures leave many such moments: the run went on to its end, and no second signal counted."""
    with pytest.raises(process.EndedBySignal), process.ending_like_ctrl_c():
        EndsWithASignal()
        for _ in range(1000):
            time.sleep(0.01)
        pytest.fail("the signal was lost")


def test_signals_that_are_ignored_stay_ignored_and_other_threads_change_nothing():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup does
    try:
        with process.ending_like_ctrl_c():
            signal.raise_signal(signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)
    failures = []

    def enter() -> None:
        try:
            with process.ending_like_ctrl_c():
                pass
        except BaseException as error:
            failures.append(error)

    thread = threading.Thread(target=enter)
    thread.start()
    thread.join()
    assert not failures


def test_the_cache_is_where_it_can_be_written(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    assert process.cache_folder() == tmp_path / ".cache" / "twohands"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "x"))
    assert process.cache_folder() == tmp_path / "x" / "twohands"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(os, "access", lambda path, mode: "tmpfiles" in str(path))  # root may write everywhere
    (tmp_path / "tmpfiles").mkdir()
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path / "tmpfiles"))
    assert process.cache_folder() == tmp_path / "tmpfiles" / f"twohands-cache-{os.getuid()}"
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert process.cache_folder() is None


def test_a_warning_is_one_line_once(capsys):
    with process.warnings_as_lines():
        for text in ("a hand of 11 m", "a hand of 12 m", "another"):
            warnings.warn(text, PlausibilityWarning, stacklevel=1)
    assert capsys.readouterr().err == "twohands: warning: a hand of 11 m\ntwohands: warning: another\n"


def test_so_many_warnings_are_cut_short(capsys):
    with process.warnings_as_lines():
        for number in range(100):
            warnings.warn(chr(97 + number), PlausibilityWarning, stacklevel=1)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == process.MOST_WARNINGS + 1 and "further warnings" in lines[-1]


WATCH = """
import sys
seen = []
def watch(event, args):
    if event.startswith(("socket.connect", "socket.getaddrinfo", "socket.gethostby", "socket.sendto", "urllib")):
        seen.append(event)
sys.addaudithook(watch)
import json
from twohands.cli.main import main
for command in json.loads(sys.argv[1]):
    print("CODE", main(command), command[0], file=sys.stderr)
import time
time.sleep(0.5)
print("NETWORK", sorted(set(seen)), file=sys.stderr)
"""


def test_nothing_is_looked_up_and_nothing_is_left_in_the_home_folder(weights, tmp_path):
    """OpenVINO asked its maker's statistics server, and left a number for the user in ~/intel."""
    home, temporary, out = tmp_path / "home", tmp_path / "tmp", tmp_path / "out"
    home.mkdir()
    temporary.mkdir()
    inputs = tmp_path / "in"
    inputs.mkdir()
    picture = inputs / "hands.png"
    picture.write_bytes(sorted(EXAMPLES.glob("*.png"))[0].read_bytes())
    fakes.write_instance(inputs / "dataset" / "0")
    results = Path(__file__).parents[1] / "lifting" / "files" / "mediapipe_tasks.json"
    commands = [
        ["track", picture, "--weights", weights, "--out", out / "track"],
        ["lift", results, "--fov", "70", "--size", "640", "480", "--out", out / "lifted.json"],
        ["calibrate", out / "board.pdf"],
        ["inspect", inputs / "dataset"],
        ["eval", "predict", inputs / "dataset", "--weights", weights, "--out", out / "ours.npz"],
        ["eval", "score", out / "ours.npz", inputs / "dataset"],
        ["bench", picture, "--count", "1", "--weights", weights],
        ["demo", "--help"],
    ]
    before = {path for path in inputs.rglob("*")}
    kept = {key: value for key, value in os.environ.items() if key not in ("CI", "XDG_CACHE_HOME", "MPLCONFIGDIR")}
    done = subprocess.run(
        [sys.executable, "-c", WATCH, json.dumps([list(map(str, command)) for command in commands])],
        env={**kept, "HOME": str(home), "TMPDIR": str(temporary)},
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    codes = [line.split()[1] for line in done.stderr.splitlines() if line.startswith("CODE")]
    assert codes == ["0"] * len(commands), done.stderr
    assert "NETWORK []" in done.stderr
    left = {path.relative_to(home).parts[:2] for path in home.rglob("*") if path.is_file()}
    assert left <= {(".cache", "twohands")}
    assert not list(temporary.iterdir())
    assert {path for path in inputs.rglob("*")} == before
    assert {path.name for path in tmp_path.iterdir()} <= {"home", "tmp", "in", "out"}


def test_a_user_without_a_home_can_track(weights, tmp_path):
    picture = sorted(EXAMPLES.glob("*.png"))[0]
    started = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "twohands", "track", str(picture), "--weights", weights, "--out", str(tmp_path / "out")],
        env={**os.environ, "HOME": "/nonexistent/home"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0 and (tmp_path / "out" / "hands.json").is_file(), done.stderr
    assert "Traceback" not in done.stderr and time.monotonic() - started < 120


MANY = """
import resource, sys
from twohands.cli import track
from twohands.cli.main import main
track._write_views = lambda *_: True
peaks = []
for folder in sys.argv[2:]:
    assert main(["track", folder, "--weights", sys.argv[1], "--out", folder + "_out", "--fov", "60"]) == 0
    peaks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10)
print("PEAKS", *peaks)
"""


@pytest.mark.slow
def test_two_thousand_pictures_take_no_more_memory_than_a_hundred(weights, tmp_path):
    """But for their results, some 5 KiB each."""
    rng = np.random.default_rng(0)
    picture = cv2.imencode(".jpg", rng.integers(0, 256, (64, 96, 3), dtype=np.uint8))[1].tobytes()
    folders = []
    for count in (100, 2000):
        folder = tmp_path / str(count)
        folder.mkdir()
        folders.append(str(folder))
        for number in range(count):
            (folder / f"{number}.jpg").write_bytes(picture)
    done = subprocess.run([sys.executable, "-c", MANY, weights, *folders], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    few, many = map(int, done.stdout.split("PEAKS")[1].split())
    assert many - few < 32, f"{few} MiB, then {many} MiB"
