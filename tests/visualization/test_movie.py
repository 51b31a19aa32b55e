"""A film that plays, whole or cut off; and what is drawn into its frames."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("av")
from tests.inference.test_video import pose_of
from tests.oracles import drawn_hands

from twohands.inference.frames import VideoFrames
from twohands.types import HandPose, TwoHandPose
from twohands.visualization.live import draw_live
from twohands.visualization.movie import Movie


def frames_of(path: Path):
    with VideoFrames(path) as video:
        return list(video)


def write(path: Path, count: int = 120, size=(97, 65)) -> Path:
    with Movie(path, *size, rate=30.0) as movie:
        for i in range(count):
            image = np.full((size[1], size[0], 3), 2 * i, np.uint8)
            movie.write(image, i / 30 + 0.1 * (i >= 60))
    return path


def test_pictures_and_times_come_back(tmp_path: Path):
    found = frames_of(write(tmp_path / "m.mp4"))
    assert len(found) == 120 and found[0].image.shape == (64, 96, 3), "an odd size loses a line"
    assert found[59].time_s == pytest.approx(59 / 30, abs=1e-3) and found[60].time_s == pytest.approx(2.1, abs=1e-3)
    np.testing.assert_allclose(found[50].image[30, 30], 100, atol=6)


def test_half_a_file_plays(tmp_path: Path):
    whole = write(tmp_path / "m.mp4").read_bytes()
    pictures = whole.index(b"mdat", len(whole) // 2) + 8  # the third second's have just begun
    (tmp_path / "half.mp4").write_bytes(whole[:pictures])
    assert 25 <= len(frames_of(tmp_path / "half.mp4")) < 100


def test_both_hands_and_the_views_are_drawn_and_the_picture_stays():
    sample = drawn_hands(1)
    before = sample.image.copy()
    drawn = draw_live(sample.image, pose_of(0))
    np.testing.assert_array_equal(sample.image, before)
    changed = (drawn != before).any(axis=-1)
    for side in range(2):
        u, v = sample.joints_px[side, 9].astype(int)
        assert changed[v, u]
    assert changed[6:30, -30:-6].mean() > 0.9, "the inset"
    plain = draw_live(sample.image, pose_of(0), inset=False)
    assert not (plain[6:30, -30:-6] != before[6:30, -30:-6]).any()


def test_nobody_and_unknown_joints_are_no_error():
    sample = drawn_hands(1)
    joints = sample.joints_px[0].copy()
    joints[4] = np.nan
    unknown = HandPose(True, joints_px=np.full((21, 2), np.nan))
    draw_live(sample.image, TwoHandPose(HandPose(True, joints_px=joints), unknown, sample.camera))
    draw_live(sample.image[:40, :40], TwoHandPose(HandPose(False), HandPose(False), sample.camera))
