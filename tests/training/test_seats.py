"""Rendered hands that photographed ones replace."""

from pathlib import Path

import numpy as np
import pytest
from tests.training.made_frames import BODY, write_frames

from twohands.geometry.anatomy import HAND_LENGTH
from twohands.skeleton import LEFT, RIGHT, ROOT
from twohands.synth.sets.cache import FrameCache
from twohands.training.seats import parts_of, rendered_picture, seat_of, without


@pytest.fixture
def frames(tmp_path: Path) -> FrameCache:
    write_frames(tmp_path / "frames", present=(False, True))
    return FrameCache(tmp_path / "frames")


def test_a_seat_is_where_wrist_and_elbow_are(frames: FrameCache) -> None:
    frame, camera = frames.stored(0)
    seat = seat_of(frame, camera, RIGHT)
    assert seat is not None and seat_of(frame, camera, LEFT) is None
    joints = frame.joints_m[RIGHT]
    assert seat.palm_px == pytest.approx(0.1 * (1 + HAND_LENGTH) / 2 * camera.fx / joints[1 + ROOT, 2], rel=0.1)
    elbow = camera.fx * joints[0, :2] / joints[0, 2] + [camera.cx, camera.cy]
    towards = (elbow - seat.wrist_px) / np.linalg.norm(elbow - seat.wrist_px)
    assert seat.towards_elbow is not None and seat.towards_elbow @ towards > 0.999
    assert not seat.sleeved  # arm and hand have one colour
    frame.rgb[frame.labels == 8] = (30, 30, 90)
    assert seat_of(frame, camera, RIGHT).sleeved  # type: ignore[union-attr]


def test_what_is_taken_away_leaves_body_or_nothing(frames: FrameCache) -> None:
    frame, camera = frames.stored(0)
    gone = np.zeros(frame.labels.shape, bool)
    gone[50:60, 100:110], gone[50:60, 5:15] = True, True  # before the body, beside it
    less = without(frame, gone)
    assert less.alpha[52:58, 102:108].min() > 250 and less.alpha[52:58, 7:13].max() == 0
    assert np.abs(less.rgb[52:58, 102:108].astype(int) - BODY).max() < 60
    kept = ~gone
    np.testing.assert_array_equal(less.rgb[kept], frame.rgb[kept])
    assert (less.labels[gone] == 0).all()
    picture = rendered_picture(less, camera, np.zeros_like(frame.rgb), [RIGHT])
    assert picture.present.tolist() == [False, True] and picture.valid[RIGHT].all()
    assert np.isnan(picture.joints_px[LEFT]).all()


def test_parts_of_a_hand():
    labels = np.arange(15, dtype=np.uint8)[None]
    assert np.flatnonzero(parts_of(labels, [RIGHT], 1)[0]).tolist() == [9, 10, 11, 12, 13, 14]
    assert np.flatnonzero(parts_of(labels, [LEFT, RIGHT], 0)[0]).tolist() == list(range(1, 15))
