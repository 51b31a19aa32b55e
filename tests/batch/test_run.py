"""Many clips: the same bytes whoever tracks them and however often they are killed; bad input is one line."""

from __future__ import annotations

import importlib.util
import json
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("av")
from tests.batch.clips import contents, write_clips
from tests.oracles import write_tiny_weights

from twohands.cli.main import main
from twohands.inference.clip_files import read_clip

needs_ray = pytest.mark.skipif(
    importlib.util.find_spec("ray") is None, reason="ray is not installed (extra 'cluster'; not part of make test)"
)


@pytest.fixture(scope="module")
def weights(tmp_path_factory) -> str:
    return str(write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny"))


@pytest.fixture
def clips(tmp_path) -> Path:
    return write_clips(tmp_path / "clips", 3)


def track(*arguments: object) -> int:
    return main(["track", *map(str, arguments)])


@pytest.fixture
def options(weights) -> list[object]:
    """Fast ones; one worker is this process."""
    return ["--weights", weights, "--fov", 70, "--hand-length", 9, "--no-overlay", "--workers", 1]


def manifest_of(out: Path) -> list[dict]:
    return [json.loads(line) for line in (out / "manifest.jsonl").read_text().splitlines()][1:]


def test_a_folder_of_clips(clips, options, tmp_path, capsys):
    (clips / "notes.txt").write_text("no clip")
    (clips / "broken.mp4").write_text("no video")
    assert track(clips, "--out", tmp_path / "out", *options) == 0
    captured = capsys.readouterr()
    assert "3 clips tracked, 12 frames; 0 were there already" in captured.out
    assert captured.err.splitlines() == [
        "twohands: 1 files left out, no videos by their endings",
        "twohands: failed: broken.mp4: broken.mp4: not a video that can be read (Invalid data found when processing "
        "input)",
    ]
    broken, *good = manifest_of(tmp_path / "out")
    assert (broken["input"], broken["status"], broken["frames"]) == ("broken.mp4", "failed", 0)
    assert [(each["input"], each["status"], each["frames"], each["error"]) for each in good] == [
        ("clip0.mp4", "done", 3, None),
        ("clip1.mp4", "done", 4, None),
        ("clip2.mp4", "done", 5, None),
    ]
    assert good[0]["size"] == (clips / "clip0.mp4").stat().st_size
    header, poses = read_clip(tmp_path / "out" / "clip1.mp4" / "hands.jsonl")
    assert header["source"] == "clip1.mp4" and len(list(poses)) == 4
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "clip0.mp4",
        "clip1.mp4",
        "clip2.mp4",
        "manifest.jsonl",
    ]


def test_a_clip_among_many_is_tracked_as_alone(clips, weights, tmp_path):
    arguments = ["--weights", weights, "--fov", 70, "--hand-length", 9]
    assert track(clips, "--out", tmp_path / "many", "--workers", 1, *arguments) == 0
    assert track(clips / "clip2.mp4", "--out", tmp_path / "alone", *arguments) == 0
    many, alone = contents(tmp_path / "many" / "clip2.mp4"), contents(tmp_path / "alone")
    assert set(many) == set(alone)
    frames = [files["hands.jsonl"].splitlines()[1:] for files in (many, alone)]
    assert frames[0] == frames[1] and many["overlay.mp4"] == alone["overlay.mp4"]


def test_a_pattern_through_folders_leaves_out_what_lies_below_the_output(clips, weights, options, tmp_path):
    """Named case: a second run tracked the overlays that the first one had drawn."""
    write_clips(clips / "day2", 1)
    pattern, out = clips / "**" / "*.mp4", clips / "out"
    drawn = [option for option in options if option != "--no-overlay"]
    assert track(pattern, "--out", out, *drawn) == 0
    there = contents(out)
    assert "day2/clip0.mp4/overlay.mp4" in there
    assert track(pattern, "--out", out, "--resume", *drawn) == 0
    assert contents(out) == there


def test_a_run_goes_on_with_what_is_missing_or_has_changed(clips, options, tmp_path, capsys):
    out = tmp_path / "out"
    assert track(clips, "--out", out, *options) == 0
    whole = contents(out)
    assert track(clips, "--out", out, *options) == 2  # it is not empty
    assert "go on with --resume" in capsys.readouterr().err and contents(out) == whole
    lines = (out / "manifest.jsonl").read_text().splitlines(keepends=True)
    (out / "manifest.jsonl").write_text("".join(lines[:2] + lines[3:]))
    for name in ("clip1.mp4", "clip2.mp4"):
        (out / name / "hands.csv").unlink()
    assert track(clips, "--out", out, "--resume", *options) == 0
    assert "1 clips tracked, 4 frames; 2 were there already" in capsys.readouterr().out
    there = contents(out)
    assert whole.keys() - there.keys() == {"clip2.mp4/hands.csv"}  # it was said to be done
    write_clips(clips, 3, frames=6)
    assert track(clips, "--out", out, "--resume", *options) == 0
    assert "3 clips tracked, 21 frames; 0 were there already" in capsys.readouterr().out


def test_other_settings_do_not_go_on(clips, options, tmp_path, capsys):
    out = tmp_path / "out"
    assert track(clips, "--out", out, *options) == 0
    there = contents(out)
    for more in (["--fov", 71], ["--mirrored"], ["--start", 0.04]):
        assert track(clips, "--out", out, "--resume", *options, *more) == 2
        assert "holds results of another run (it differs in " in capsys.readouterr().err
    (out / "manifest.jsonl").write_text("{}")
    assert track(clips, "--out", out, "--resume", *options) == 2
    assert "manifest.jsonl is damaged" in capsys.readouterr().err
    assert track(clips, "--out", out, "--overwrite", *options) == 0
    assert contents(out) == there


def test_a_folder_of_something_else_is_not_gone_on_with(clips, options, tmp_path, capsys):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "letter.txt").write_text("dear")
    assert track(clips, "--out", tmp_path / "out", "--resume", *options) == 2
    assert "holds no manifest.jsonl to go on with" in capsys.readouterr().err
    assert contents(tmp_path / "out") == {"letter.txt": b"dear"}


def test_a_folder_of_strangers_is_not_replaced(clips, options, tmp_path, capsys):
    """Named case: a run into a folder of something else deleted what had a clip's name."""
    out = tmp_path / "out"
    (out / "clip0.mp4").mkdir(parents=True)
    (out / "clip0.mp4" / "letter.txt").write_text("dear")
    assert track(clips, "--out", out, "--overwrite", *options) == 2
    captured = capsys.readouterr()
    assert "holds something else than a clip's results" in captured.err and captured.err.count("\n") == 1
    assert contents(out / "clip0.mp4") == {"letter.txt": b"dear"}


def test_two_workers_write_the_same_bytes(clips, weights, tmp_path):
    for workers in (1, 2):
        out = tmp_path / str(workers)
        assert track(clips, "--out", out, "--weights", weights, "--fov", 70, "--workers", workers) == 0
    assert contents(tmp_path / "1") == contents(tmp_path / "2")


@pytest.mark.slow
def test_twenty_clips_and_four_workers(weights, tmp_path):
    clips = write_clips(tmp_path / "clips", 20, size=(320, 180))
    for workers in (1, 4):
        out = tmp_path / str(workers)
        assert track(clips, "--out", out, "--weights", weights, "--fov", 70, "--workers", workers) == 0
    assert contents(tmp_path / "1") == contents(tmp_path / "4")


@needs_ray
@pytest.mark.slow
def test_a_ray_cluster_writes_the_same_bytes(weights, tmp_path):
    clips = write_clips(tmp_path / "clips", 20, size=(320, 180))
    for engine in (["--workers", 1], ["--engine", "ray", "--workers", 2]):
        out = tmp_path / engine[-2].strip("-")
        assert track(clips, "--out", tmp_path / str(len(engine)), "--weights", weights, "--fov", 70, *engine) == 0, out
    assert contents(tmp_path / "2") == contents(tmp_path / "4")


@pytest.mark.slow
def test_killed_at_ten_random_moments_and_resumed(weights, tmp_path):
    """Always after the manifest has been begun; a kill takes the workers with it."""
    clips = write_clips(tmp_path / "clips", 20, size=(320, 180))
    out = tmp_path / "killed"
    arguments = ["track", clips, "--weights", weights, "--fov", 70, "--workers", 2, "--out"]
    command = [sys.executable, "-m", "twohands.cli.main", *map(str, arguments), str(out), "--resume"]
    rng = random.Random(0)
    for _ in range(10):
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            _wait_for_news(out, process)
            time.sleep(rng.uniform(0, 1))
            process.send_signal(signal.SIGKILL)
    assert subprocess.run(command, stdout=subprocess.DEVNULL).returncode == 0
    assert main([*map(str, arguments), str(tmp_path / "whole")]) == 0
    assert contents(out) == contents(tmp_path / "whole")


def _wait_for_news(out: Path, process: subprocess.Popen) -> None:
    """Until a clip more is done than before, or the process has ended."""
    manifest = out / "manifest.jsonl"
    before = manifest.read_bytes() if manifest.exists() else b""
    while process.poll() is None and (not manifest.exists() or manifest.read_bytes() == before):
        time.sleep(0.02)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere/*.mp4"], "no file there"),
        (["clips", "--out", "clips"], "is the folder of the clips"),
        (["clips", "--workers", "-1"], "--workers must be 0"),
        (["clips", "--ray-address", "auto"], "--ray-address needs --engine ray"),
        (["clips", "--json"], "--json is for a single clip"),
        (["clips", "--estimator", "mediapipe", "--peer-python", "/bin/true"], "has no MediaPipe Hands"),
        (["clips", "--resume", "--overwrite"], "not both"),
        (["clips", "--weights", "nonesuch"], "nonesuch"),
        (["clips", "--stride", "0"], "stride must be at least 1"),
        (["clips", "--out", "https://host/x"], "a folder or a bucket expected"),
        (["clips", "--out", "clips/clip0.mp4"], "clip0.mp4"),
        (["*/*", "--out", "out"], "matches videos and pictures"),
        (["clips/clip0.mp4", "--resume"], "--resume is for many clips"),
        (["clips/clip0.mp4", "--workers", "2"], "--workers is for many clips"),
        (["camera:0", "--out", "s3://bucket/x"], "needs a folder of this machine"),
    ],
)
def test_bad_input_is_one_line_exit_2(arguments, message, clips, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "a.png").write_bytes(b"")
    before = contents(tmp_path)
    assert track(*arguments, "--fov", 70, "--hand-length", 9) == 2
    captured = capfd.readouterr()
    assert message in captured.err and captured.err.count("\n") == 1 and captured.out == ""
    assert contents(tmp_path) == before


def test_without_ray_the_extra_is_named(clips, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    assert track(clips, "--out", tmp_path / "out", "--engine", "ray", "--fov", 70, "--hand-length", 9) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and "pip install 'twohands[cluster]'" in lines[0]
    assert not (tmp_path / "out").exists()
