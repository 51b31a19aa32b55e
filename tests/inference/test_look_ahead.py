"""Ranges with what comes after: true lines stay, noise shrinks without lag, outliers leave no trace, nobody is lost."""

from dataclasses import replace

import numpy as np
import pytest
from tests.inference.test_video import pose_of

from twohands.errors import InputError
from twohands.inference.look_ahead import LookAhead, line_at_zero
from twohands.inference.tracker import HandTracker
from twohands.types import TwoHandPose


def at_range(index: int, range_m: float, present=(True, True)) -> TwoHandPose:
    """The drawn hands, the left one at a range."""
    pose = pose_of(index, present=present)
    if pose.left.range_m is None or pose.left.joints_m is None:
        return pose
    left = replace(pose.left, range_m=range_m, joints_m=pose.left.joints_m * range_m / pose.left.range_m)
    return replace(pose, left=left)


def through(look: LookAhead, poses) -> list[TwoHandPose]:
    return [known for pose in poses for known in look.push(pose)] + look.finish()


def test_every_frame_comes_once_and_in_order():
    poses = [at_range(i, 0.4, present=(i % 5 != 0, True)) for i in range(40)]
    known = through(LookAhead(0.25), poses)
    assert [pose.index for pose in known] == list(range(40))
    assert [pose.left.present for pose in known] == [pose.left.present for pose in poses]


def test_all_else_of_a_frame_stays():
    """Named case: whether hands were followed was forgotten."""
    poses = [replace(at_range(i, 0.4), followed=i % 2 == 1) for i in range(10)]
    assert [pose.followed for pose in through(LookAhead(0.1), poses)] == [i % 2 == 1 for i in range(10)]


def test_frames_are_held_back_for_as_long_as_said():
    look = LookAhead(0.1)
    held = [len(look.push(at_range(i, 0.4))) for i in range(10)]
    assert sum(held) == 6 and held[:4] == [0, 0, 0, 0], "0.1 s are three frames, and what comes behind them"


def test_a_hand_that_moves_evenly_stays_where_it_is():
    poses = [at_range(i, 0.3 + 0.01 * i) for i in range(20)]
    for pose, known in zip(poses, through(LookAhead(0.2), poses), strict=True):
        assert known.left.range_m == pytest.approx(pose.left.range_m, abs=1e-12)
        np.testing.assert_allclose(known.left.joints_m, pose.left.joints_m, atol=1e-12)


def test_an_outlier_leaves_no_trace():
    poses = [at_range(i, 0.4 if i != 9 else 0.9) for i in range(20)]
    known = through(LookAhead(0.2), poses)
    np.testing.assert_allclose([pose.left.range_m for pose in known], 0.4, atol=1e-12)


def test_less_noise_and_less_lag_than_smoothing_causally():
    rng = np.random.default_rng(1)
    true = 0.4 + 0.1 * np.sin(np.arange(200) / 12)
    poses = [at_range(i, r * (1 + 0.02 * rng.standard_normal())) for i, r in enumerate(true)]
    ahead = np.array([pose.left.range_m for pose in through(LookAhead(0.25), poses)])
    tracker = HandTracker()
    causal = np.array([tracker.update(pose).left.range_m for pose in poses])
    rough = np.array([pose.left.range_m for pose in poses])
    errors = [float(np.sqrt(np.mean((found - true) ** 2))) for found in (ahead, causal, rough)]
    assert errors[0] < 0.75 * errors[1] and errors[0] < 0.6 * errors[2]


def test_the_line_by_hand():
    """Weights 1 and, at half the reach, 0.75 each: (1 * 2 + 0.75 * 1 + 0.75 * 6) / 2.5 = 2.9; an even spread of times
    makes the line's value at 0 the weighted mean."""
    value = line_at_zero(np.array([-0.5, 0.0, 0.5]), np.array([1.0, 2.0, 6.0]), 1 / 1.001)
    assert value == pytest.approx(2.9)
    assert np.isnan(line_at_zero(np.zeros(3), np.array([1.0, np.nan, 2.0]), 1.0))


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan"), float("inf")])
def test_a_time_must_be_a_time(seconds):
    with pytest.raises(InputError, match="look-ahead"):
        LookAhead(seconds)
