"""Frames at even times: hand-computed."""

import numpy as np
import pytest

from twohands.errors import InputError
from twohands.motion.even_times import MOST_FRAMES, even_times


def test_even_clips_stay_as_they_are():
    """Rounded to a microsecond, as hands.jsonl has them."""
    times = even_times(np.round(5 + np.arange(100) / 30, 6), np.arange(100))
    assert times.step_s == pytest.approx(1 / 30, abs=1e-7)
    np.testing.assert_array_equal(times.before, np.arange(100))
    assert times.share.max() < 1e-3 and not times.still.any()


def test_a_dropped_frame_is_half_way():
    """0, 1, (2), 3, 4 s: frame 2 lies half-way between the second and third of the clip."""
    times = even_times(np.array([0.0, 1.0, 3.0, 4.0]), np.arange(4))
    assert times.step_s == 1.0
    np.testing.assert_array_equal(times.before, [0, 1, 1, 2, 3])
    np.testing.assert_array_equal(times.after, [1, 2, 2, 3, 3])
    np.testing.assert_allclose(times.share, [0, 0, 0.5, 0, 0], atol=1e-12)


def test_a_hand_that_is_away_stands_still():
    """In frames 2 and 3 of 0..5: before it comes as it will be, then as it was."""
    times = even_times(np.arange(6.0), np.array([2, 3]))
    np.testing.assert_array_equal(times.before, [0, 0, 0, 1, 1, 1])
    np.testing.assert_array_equal(times.share, 0)
    np.testing.assert_array_equal(times.still, [True, True, False, False, True, True])


def test_it_does_not_move_over_a_gap():
    """A frame without the hand lies between, so nobody knows the way."""
    times = even_times(np.array([0.0, 1.0, 1.5, 2.5]), np.array([0, 1, 3]))
    assert times.step_s == pytest.approx(2.5 / 2)  # the median distance is 1 s: two and a half steps
    np.testing.assert_array_equal(times.before, [0, 1, 2])
    np.testing.assert_allclose(times.share, [0, 0, 0])


def test_one_frame():
    times = even_times(np.array([7.0]), np.array([0]))
    assert times.before.tolist() == [0] and times.share.tolist() == [0] and times.step_s == pytest.approx(1 / 30)


def test_a_clip_with_a_pause_of_a_day_is_refused():
    with pytest.raises(InputError, match=rf"8\.64e\+06 for 86400.* in steps of 0\.01 s; at most {MOST_FRAMES}"):
        even_times(np.array([0.0, 0.01, 0.02, 86400.0]), np.arange(4))
