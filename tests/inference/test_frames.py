"""Frames of video files: the file's own times, turned upright, and whatever a damaged file still holds."""

import math
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("av")
from tests.inference.clips import TIMES_S, colour_of, write_clip

from twohands.errors import InputError, MissingExtraError
from twohands.inference import frames
from twohands.inference.frames import VideoFrames, is_video, open_frames


def read(path, **options):
    with VideoFrames(path, **options) as video:
        return list(video), video


def test_frames_have_the_files_times(tmp_path: Path):
    found, video = read(write_clip(tmp_path / "c.mp4"))
    assert [frame.index for frame in found] == list(range(10))
    np.testing.assert_allclose([frame.time_s for frame in found], TIMES_S, atol=1e-3)
    assert found[3].image.shape == (48, 64, 3) and found[3].image.dtype == np.uint8
    for index in (0, 5, 9):
        np.testing.assert_allclose(found[index].image[40, 40], colour_of(index), atol=12)
    assert (video.decoded, video.unreadable, video.total) == (10, 0, 10)


def test_a_part_of_the_frames_keeps_their_numbers_and_times(tmp_path: Path):
    path = write_clip(tmp_path / "c.mp4")
    found, _ = read(path, start_s=0.1, end_s=0.52, stride=2)
    assert [(frame.index, round(frame.time_s, 2)) for frame in found] == [(3, 0.2), (5, 0.28), (7, 0.5)]


@pytest.mark.parametrize(("quarters", "corner"), [(1, (-1, 0)), (2, (-1, -1)), (3, (0, -1))])
def test_a_telephones_rotation_is_applied(tmp_path: Path, quarters, corner, monkeypatch):
    """The white corner of the picture as stored goes where a player shows it."""
    (frame, *_), _ = read(write_clip(tmp_path / "c.mp4"))
    assert frame.image[0, 0].min() > 200

    class Turned:
        rotation = 90 * quarters

        def to_ndarray(self, format):
            return frame.image

    turned = frames._upright(Turned())
    assert turned.shape == ((48, 64, 3) if quarters == 2 else (64, 48, 3))
    assert turned[corner].min() > 200 and turned[0, 0].max() < 100


def test_a_file_that_was_cut_off_yields_what_it_holds(tmp_path: Path):
    whole = write_clip(tmp_path / "c.mkv", [i / 25 for i in range(200)], size=(320, 240)).read_bytes()
    (tmp_path / "half.mkv").write_bytes(whole[: len(whole) // 2])
    found, _ = read(tmp_path / "half.mkv")
    assert 40 < len(found) < 160
    np.testing.assert_allclose(found[40].image[200, 200], found[40].image[200, 300], atol=3)


def test_lost_frames_are_counted_where_the_file_says_how_many_it_has(tmp_path: Path):
    whole = bytearray(write_clip(tmp_path / "c.mp4", [i / 25 for i in range(100)]).read_bytes())
    start = whole.index(b"mdat") + 4
    end = whole.index(b"moov") - 4
    middle = (start + end) // 2
    whole[middle : middle + 400] = bytes(400)
    (tmp_path / "d.mp4").write_bytes(bytes(whole))
    found, video = read(tmp_path / "d.mp4")
    assert video.total == 100 and video.unreadable == 100 - len(found) > 0
    assert found[-1].index > 90


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("missing.mp4", "no such file"),
        ("text.mp4", "not a video that can be read"),
        ("empty.mp4", "not a video that can be read"),
        ("http://127.0.0.1:9/a.mp4", "not a video that can be read"),
        ("camera:x", "a number after camera: expected"),
        ("camera:77", "no such camera"),
    ],
)
def test_what_cannot_be_opened_is_one_line_within_5_seconds(source, message, tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("text.mp4").write_text("no video")
    Path("empty.mp4").write_bytes(b"")
    started = time.monotonic()
    with pytest.raises(InputError, match=message) as error:
        open_frames(source)
    assert time.monotonic() - started < 5 and "\n" not in str(error.value)


IMPOSSIBLE = [{"start_s": -1.0}, {"start_s": 2.0, "end_s": 1.0}, {"end_s": math.nan}, {"stride": 0}]


@pytest.mark.parametrize("options", IMPOSSIBLE)
def test_impossible_parts_are_refused(options, tmp_path: Path):
    with pytest.raises(InputError):
        VideoFrames(write_clip(tmp_path / "c.mp4"), **options)


def test_without_pyav_the_extra_is_named(tmp_path: Path, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(MissingExtraError, match=r"twohands\[video\]"):
        VideoFrames(tmp_path / "c.mp4")


def test_what_is_a_video_is_told_by_its_name():
    assert all(map(is_video, ["a/b.MP4", "camera:0", "rtsp://h/x", "c.mkv"]))
    assert not any(map(is_video, ["a.png", "folder", "a.mp4.png", "mp4"]))
