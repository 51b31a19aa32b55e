"""`twohands track` of a video: files, times, parts, and every kind of bad clip."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("av")
from tests.inference.clips import TIMES_S, write_clip
from tests.oracles import write_tiny_weights

from twohands.cli import track
from twohands.cli.main import main
from twohands.inference.clip_files import read_clip
from twohands.inference.frames import VideoFrames
from twohands.types import HandPose, TwoHandPose


@pytest.fixture(scope="session")
def weights(tmp_path_factory) -> str:
    return str(write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny"))


@pytest.fixture
def clip(tmp_path) -> Path:
    return write_clip(tmp_path / "clip.mp4", size=(160, 96))


def run_track(*arguments: object) -> int:
    return main(["track", *map(str, arguments)])


def test_a_clip(clip, weights, tmp_path, capsys):
    out = tmp_path / "out"
    assert run_track(clip, "--out", out, "--weights", weights, "--fov", 90, "--hand-length", 9) == 0
    captured = capsys.readouterr()
    assert captured.err == "" and "10 frames" in captured.out and f"written to {out}" in captured.out
    assert sorted(path.name for path in out.iterdir()) == [
        "hands.csv",
        "hands.jsonl",
        "hands.npz",
        "overlay.mp4",
        "report.html",
    ]
    header, poses = read_clip(out / "hands.jsonl")
    poses = list(poses)
    assert (header["weights"], header["smoothed"], header["mirrored"]) == ("tiny", True, False)
    assert header["camera"]["fx"] == 80 and "views" in header["config"]
    np.testing.assert_allclose([pose.time_s for pose in poses], TIMES_S, atol=1e-3)
    assert poses[0].left.present and poses[0].left.valid
    with np.load(out / "hands.npz") as arrays:
        np.testing.assert_allclose(arrays["range_m"][0, 0], poses[0].left.range_m, atol=1e-6)
    with VideoFrames(out / "overlay.mp4") as video:
        shown = list(video)
    np.testing.assert_allclose([frame.time_s for frame in shown], TIMES_S, atol=1e-3)


def test_a_part_printed_as_lines(clip, weights, tmp_path, capsys):
    part = ["--start", 0.1, "--end", 0.52, "--stride", 2, "--no-overlay", "--no-smooth", "--json"]
    assert run_track(clip, "--out", tmp_path / "out", "--weights", weights, *part) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["index"] for line in lines] == [3, 5, 7]
    assert not (tmp_path / "out" / "overlay.mp4").exists()
    assert (tmp_path / "out" / "hands.jsonl").read_text().count("\n") == 4


def test_looking_ahead_loses_no_frame(clip, weights, tmp_path):
    assert run_track(clip, "--out", tmp_path / "out", "--weights", weights, "--look-ahead", 0.2) == 0
    header, poses = read_clip(tmp_path / "out" / "hands.jsonl")
    assert header["look_ahead_s"] == 0.2 and [pose.index for pose in poses] == list(range(10))
    with VideoFrames(tmp_path / "out" / "overlay.mp4") as video:
        assert len(list(video)) == 10


def test_mirrored_frames_are_turned_back(clip, weights, tmp_path, monkeypatch):
    """The white corner of the clip, at its left, is at the right of what is estimated."""
    seen = []

    def look(self, image, camera, hand_length_m, *, index, time_s, previous):
        seen.append((image[5, 5].mean(), image[5, -5].mean()))
        return TwoHandPose(HandPose(False), HandPose(False), camera, index=index, time_s=time_s)

    monkeypatch.setattr(track.HandEstimator, "estimate", look)
    assert run_track(clip, "--out", tmp_path / "out", "--weights", weights, "--mirrored", "--no-overlay") == 0
    assert seen[0][0] < 100 and seen[0][1] > 200


def test_a_clip_of_another_shape_than_the_camera(clip, weights, tmp_path, capsys):
    (tmp_path / "c.json").write_text('{"fx": 80, "fy": 80, "cx": 80, "cy": 80, "width": 160, "height": 160}')
    assert run_track(clip, "--out", tmp_path / "out", "--weights", weights, "--camera", tmp_path / "c.json") == 1
    errors = capsys.readouterr().err
    assert "10 frames skipped" in errors and "another aspect ratio" in errors and "not one frame" in errors
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("missing.mp4", [], "no such file"),
        ("text.mp4", [], "not a video that can be read"),
        ("clip.mp4", ["--start", 3, "--end", 2], "--start and --end"),
        ("clip.mp4", ["--stride", 0], "stride must be at least 1"),
        ("clip.mp4", ["--look-ahead", -1], "look-ahead must be a positive"),
        ("clip.mp4", ["--out", "."], "is not empty"),
        ("clip.mp4", ["--estimator", "mediapipe", "--peer-python", "/bin/true"], "has no MediaPipe Hands"),
        ("camera:77", [], "no such camera"),
    ],
)
def test_a_bad_clip_or_option_is_one_line_exit_2(name, arguments, message, clip, weights, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text.mp4").write_text("no video")
    before = sorted(tmp_path.iterdir())
    assert run_track(name, "--weights", weights, *arguments) == 2
    captured = capfd.readouterr()
    assert message in captured.err and captured.err.count("twohands: error") == 1 and captured.out == ""
    assert sorted(tmp_path.iterdir()) == before
