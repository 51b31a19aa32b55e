"""Range smoothing: exact where theory is exact, quiet as theory says, deaf to outliers, quick after true jumps."""

import dataclasses
import math
from fractions import Fraction

import numpy as np
import pytest
from tests.builders import CENTRED_CAMERA, open_hand

from twohands.errors import InputError
from twohands.geometry.canonical import camera_from_canonical
from twohands.inference.tracker import (
    PREDICTED,
    HandTracker,
    RangeFilter,
    RangeSmoothing,
    moved_to_range,
    polynomial_value,
    polynomial_weights,
)
from twohands.skeleton import LEFT, RIGHT, ROOT
from twohands.types import HandPose, TwoHandPose

FPS = 30.0
HAND_LENGTH_M = 0.09
ABSENT = HandPose(present=False)
PARABOLA = RangeSmoothing(length=15, degree=2, fade=1.0)
"""The setting for which the numbers below were worked out; the default may change with the sweep."""


def smoothed(radii, smoothing=PARABOLA, times=None):
    """All results of one filter; times default to 30 frames a second."""
    range_filter = RangeFilter(smoothing)
    times = np.arange(len(radii)) / FPS if times is None else times
    return [range_filter.update(time, radius) for time, radius in zip(times, radii, strict=True)]


def hand_at(radius_m, theta=0.2, phi=-0.3, valid=True):
    """A hand in a direction; not valid: as the estimator gives it where the projection found no range."""
    canonical = open_hand()
    return HandPose(
        present=True,
        score=0.9,
        box_px=np.array([10.0, 20.0, 110.0, 120.0]),
        joints_px=np.arange(42.0).reshape(21, 2),
        joint_scores=np.full(21, 0.8),
        canonical=canonical,
        joints_m=camera_from_canonical(canonical, HAND_LENGTH_M, radius_m, theta, phi) if valid else None,
        range_m=radius_m if valid else None,
        theta_deg=math.degrees(theta),
        phi_deg=math.degrees(phi),
        key_bone="wrist",
        method="all-joints",
        valid=valid,
    )


def frame(left, right=ABSENT, index=0, time_s=None):
    return TwoHandPose(left, right, CENTRED_CAMERA, None, index, time_s)


def same_hand(a, b):
    """Whether two records hold the same values."""
    return all(
        np.array_equal(getattr(a, field.name), getattr(b, field.name))
        if isinstance(getattr(a, field.name), np.ndarray)
        else getattr(a, field.name) == getattr(b, field.name)
        for field in dataclasses.fields(a)
    )


# --- the regression ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("times", "values", "degree", "at", "expected"),
    [
        ((0, 1, 2), (1, 2, 6), 0, 2, Fraction(3)),  # the mean
        ((0, 1, 2), (0, 0, 3), 1, 2, Fraction(5, 2)),  # mean 1, slope 3/2, one step from the middle
        ((0, 1, 2), (0, 0, 3), 1, 3, Fraction(4)),
        ((0, 1, 3), (1, 0, 2), 1, 3, Fraction(12, 7)),  # slope 2 / (14/3) about (4/3, 1); over the index: 3/2
        ((0, 1, 2, 3), (0, 0, 0, 1), 2, 3, Fraction(19, 20)),  # the cubic left out is (-1, 3, -3, 1) / sqrt 20
        ((0, 1, 2, 3), (1, 0, 0, 0), 2, 3, Fraction(1, 20)),
        ((0, 1, 2, 3, 4), (0, 0, 1, 0, 0), 2, 4, Fraction(-3, 35)),  # last row (3, -5, -3, 9, 31) / 35
        ((0, 1, 2, 3, 4), (0, 0, 0, 1, 0), 2, 4, Fraction(9, 35)),
        ((3, 0, 2, 1), (1, 0, 0, 0), 2, 3, Fraction(19, 20)),  # order does not matter
    ],
)
def test_least_squares_by_hand(times, values, degree, at, expected):
    assert polynomial_value(times, values, degree, at) == pytest.approx(float(expected), abs=1e-14)


@pytest.mark.parametrize(
    ("values", "degree", "at", "expected"),
    [
        ((0, 0, 3), 0, 2, Fraction(12, 7)),  # 3 / (1 + 1/2 + 1/4)
        ((4, 0, 0), 0, 0, Fraction(4, 7)),
        ((0, 0, 3), 1, 2, Fraction(36, 13)),  # counting 1/4, 1/2, 1: slope 24/13 about (10/7, 12/7)
    ],
)
def test_a_fading_fit_by_hand(values, degree, at, expected):
    assert polynomial_value((0, 1, 2), values, degree, at, 0.5) == pytest.approx(float(expected), abs=1e-14)


@pytest.mark.parametrize("degree", [0, 1, 2, 3, 5])
def test_a_polynomial_of_the_degree_is_its_own_fit(degree):
    rng = np.random.default_rng(degree)
    times = np.sort(rng.uniform(-3, 5, 12))
    at = np.array([-4.0, 0.3, 5.0, 6.0])
    coefficients = rng.standard_normal(degree + 1)
    fitted = polynomial_value(times, np.polyval(coefficients, times), degree, at)
    np.testing.assert_allclose(fitted, np.polyval(coefficients, at), rtol=1e-9, atol=1e-9)
    if degree:
        fading = polynomial_value(times, np.polyval(coefficients, times), degree, at, 0.7)
        np.testing.assert_allclose(fading, fitted, rtol=1e-9, atol=1e-9)
        lower = polynomial_value(times, np.polyval(coefficients, times), degree - 1, at)
        assert np.abs(lower - np.polyval(coefficients, at)).max() > 0.01


def test_the_fit_does_not_depend_on_where_and_in_what_unit_time_is_counted():
    times = np.cumsum(np.random.default_rng(1).uniform(0.02, 0.05, 15))
    weights = polynomial_weights(times, 2, times[-1])
    np.testing.assert_allclose(polynomial_weights(1000 * times, 2, 1000 * times[-1]), weights, atol=1e-12)
    for start, error in ((1e3, 1e-10), (1.75e9, 1e-4)):  # seconds since 1970 resolve 2e-7 s
        np.testing.assert_allclose(polynomial_weights(times + start, 2, times[-1] + start), weights, atol=error)


def test_weights_sum_to_one_and_have_the_shape_of_the_points_asked_for():
    weights = polynomial_weights(np.arange(7), 3, np.array([[0.0, 2.5], [6.0, 9.0]]))
    assert weights.shape == (2, 2, 7)
    np.testing.assert_allclose(weights.sum(axis=-1), 1, atol=1e-12)
    assert polynomial_weights(np.arange(7), 3, 2.0).shape == (7,)
    assert polynomial_weights([4.0], 0, 9.0).tolist() == [1.0]


@pytest.mark.parametrize(
    ("times", "degree"),
    [([0.0, 1.0], 2), ([0.0, 1.0, 1.0], 2), ([0.0, 1.0], -1), ([0.0, np.nan], 0), ([[0.0, 1.0]], 0)],
)
def test_a_regression_without_a_unique_answer_is_refused(times, degree):
    with pytest.raises(InputError, match="polynomial regression"):
        polynomial_weights(np.array(times), degree, 1.0)


CLOSED_FORM = {
    1: lambda n: (4 * n - 2) / (n * (n + 1)),
    2: lambda n: 3 * (3 * n**2 - 3 * n + 2) / (n * (n + 1) * (n + 2)),
    3: lambda n: 8 * (2 * n**3 - 3 * n**2 + 7 * n - 3) / (n * (n + 1) * (n + 2) * (n + 3)),
}
"""Variance of the fit at the newest of n evenly spaced points."""
PRINTED = {1: (0.77, 0.59, 0.49, 0.43), 2: (0.94, 0.79, 0.68, 0.61), 3: (0.99, 0.91, 0.82, 0.75)}
"""The table of docs/paper-map.md, *Smoothing*."""


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_noise_factors_are_those_of_theory(degree):
    for n, printed in zip((5, 10, 15, 20), PRINTED[degree], strict=True):
        factor = np.linalg.norm(polynomial_weights(np.arange(n), degree, n - 1))
        assert factor == pytest.approx(math.sqrt(CLOSED_FORM[degree](n)), abs=1e-12)
        assert factor == pytest.approx(printed, abs=0.006)


# --- one hand ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("length", "degree"), [(15, 2), (8, 1), (5, 1)])
def test_white_noise_is_reduced_by_the_factor_of_theory(length, degree):
    noise = 0.01 * np.random.default_rng(2).standard_normal(2500)
    results = np.array(smoothed(0.4 + noise, RangeSmoothing(length, degree, fade=1.0)))[length:]
    assert results.std() / noise.std() == pytest.approx(math.sqrt(CLOSED_FORM[degree](length)), rel=0.05)
    assert results.mean() == pytest.approx(0.4, abs=1e-3)


def test_a_constant_range_stays_constant():
    np.testing.assert_allclose(smoothed(np.full(40, 0.37)), 0.37, rtol=1e-12)


def test_polynomial_motion_comes_through_exactly_also_at_uneven_frame_times():
    times = np.cumsum(np.random.default_rng(3).uniform(0.01, 0.09, 60))
    radii = 0.3 + 0.05 * times - 0.01 * times**2
    np.testing.assert_allclose(smoothed(radii, times=times), radii, rtol=1e-10)
    by_index = smoothed(radii, dataclasses.replace(PARABOLA, max_gap_s=math.inf), times=np.arange(60.0))
    assert np.abs(by_index - radii).max() > 1e-4  # the same numbers on an even clock are no parabola


def test_the_first_frames_use_what_there_is():
    radii = [0.40, 0.42, 0.41, 0.44, 0.43]
    results = smoothed(radii)
    assert results[:2] == radii[:2]
    assert results[2] == pytest.approx(0.41)  # three points, one parabola
    assert results[3] == pytest.approx((0.40 - 3 * 0.42 + 3 * 0.41 + 19 * 0.44) / 20)
    assert results[4] == pytest.approx((3 * 0.40 - 5 * 0.42 - 3 * 0.41 + 9 * 0.44 + 31 * 0.43) / 35)


def test_the_queue_forgets_what_is_older_than_its_length():
    radii = 0.4 + 0.02 * np.random.default_rng(4).standard_normal(30)
    other = radii.copy()
    other[:15] = 0.41
    assert smoothed(radii)[29] == smoothed(other)[29]
    assert smoothed(radii)[28] != smoothed(other)[28]


def test_length_below_three_turns_smoothing_off():
    radii = list(0.4 + 0.02 * np.random.default_rng(4).standard_normal(10))
    assert smoothed(radii, RangeSmoothing(length=2)) == radii


def test_results_do_not_change_when_later_frames_come():
    radii = 0.4 + 0.03 * np.random.default_rng(5).standard_normal(50)
    radii[[20, 33, 34, 35, 36]] = 1.2
    whole = smoothed(radii)
    for end in (1, 4, 21, 35, 36):
        assert smoothed(radii[:end]) == whole[:end]


def test_scaling_the_world_scales_the_results():
    radii = 0.4 + 0.03 * np.random.default_rng(6).standard_normal(50)
    radii[[20, 33, 34, 35, 36]] = 1.2
    np.testing.assert_allclose(smoothed(3 * radii), 3 * np.array(smoothed(radii)), rtol=1e-9)


def test_the_clock_may_start_anywhere():
    rng = np.random.default_rng(7)
    times, radii = np.cumsum(rng.uniform(0.02, 0.05, 50)), 0.4 + 0.03 * rng.standard_normal(50)
    radii[30] = 1.2
    for start in (-12.5, 1.75e9):
        np.testing.assert_allclose(smoothed(radii, times=times + start), smoothed(radii, times=times), atol=1e-6)


def test_an_outlier_leaves_no_trace():
    radii = 0.4 + 0.005 * np.random.default_rng(8).standard_normal(40)
    for outlier in (0.8, 0.1):
        spoilt = radii.copy()
        spoilt[25] = outlier
        missing = [*radii[:25], None, *radii[26:]]
        assert smoothed(spoilt) == smoothed(missing)
        assert abs(smoothed(spoilt)[25] - 0.4) < 0.02
        ungated = smoothed(spoilt, RangeSmoothing(gate=math.inf))
        assert abs(ungated[25] - 0.4) > 0.1


@pytest.mark.parametrize(
    ("radii", "floor", "limit"),
    [
        # mean 4/10; the floor 0.08 x 4/10 is the scale; the mean of four has 1/4 of the variance
        ((0.4, 0.4, 0.4, 0.4), 0.08, 3 * 0.08 * 0.4 * math.sqrt(5 / 4)),
        # mean 3, deviations 2 1 0 3, their median 3/2, one coefficient of four fitted
        ((1.0, 2.0, 3.0, 6.0), 0.0, 3 * 1.4826 * 1.5 * math.sqrt(4 / 3) * math.sqrt(5 / 4)),
    ],
)
def test_the_gate_by_hand(radii, floor, limit):
    for deviation, refused in ((0.999 * limit, False), (1.001 * limit, True)):
        range_filter = RangeFilter(RangeSmoothing(degree=0, fade=1.0, scale_floor=floor))
        for i, radius in enumerate([*radii, np.mean(radii) + deviation]):
            range_filter.update(i / FPS, radius)
        assert range_filter.predicting == refused


def test_nothing_is_refused_before_there_is_a_scale():
    assert smoothed([0.4] * 6 + [3.0])[-1] == pytest.approx(0.4)
    assert smoothed([0.4] * 5 + [3.0])[-1] > 2


def test_three_radii_predict_along_a_line():
    """0.41 + 2 * 0.005; the parabola through them would say 0.37."""
    assert smoothed([0.40, 0.42, 0.41, None])[-1] == pytest.approx(0.42)


def test_an_outlier_is_judged_by_the_noise_around_it():
    """0.4 -> 0.7: gross where the range is steady, ordinary where it always jumps that far."""
    steady = np.full(20, 0.4)
    wild = 0.4 + 0.15 * np.tile([1, -1, -1, 1], 5)
    assert smoothed([*steady, 0.7])[-1] == pytest.approx(0.4)
    range_filter = RangeFilter(PARABOLA)
    for i, radius in enumerate([*wild, 0.7]):
        range_filter.update(i / FPS, radius)
    assert range_filter.radii_m[-1] == 0.7


def test_a_fast_reach_is_no_outlier():
    """30 cm in 0.4 s (minimum jerk) after a second of rest: every radius enters the queue."""
    times = np.arange(75) / FPS
    for noise in (0.0, 0.01, 0.03):
        for start in np.linspace(1, 1.03, 4):
            s = np.clip((times - start) / 0.4, 0, 1)
            radii = 0.3 + 0.3 * (10 * s**3 - 15 * s**4 + 6 * s**5)
            radii = radii * (1 + noise * np.random.default_rng(9).standard_normal(len(times)))
            range_filter = RangeFilter(PARABOLA)
            for time, radius in zip(times, radii, strict=True):
                range_filter.update(time, radius)
                assert not range_filter.predicting


def test_a_true_jump_is_followed_in_the_third_frame():
    results = smoothed([0.4] * 20 + [0.8] * 20)
    np.testing.assert_allclose(results[20:22], 0.4, rtol=1e-12)
    np.testing.assert_allclose(results[22:], 0.8, rtol=1e-12)
    slower = smoothed([0.4] * 20 + [0.8] * 20, RangeSmoothing(jump_frames=5))
    np.testing.assert_allclose(slower[20:24], 0.4, rtol=1e-12)
    np.testing.assert_allclose(slower[24:], 0.8, rtol=1e-12)


def test_a_noisy_jump_is_followed_in_the_third_frame():
    for seed in range(20):
        noise = 0.01 * np.random.default_rng(seed).standard_normal(40)
        results = smoothed(np.repeat([0.4, 0.8], 20) + noise)
        assert np.abs(np.array(results[22:]) - 0.8).max() < 0.04
        assert results[22] == pytest.approx(0.8 + noise[22])


def test_outliers_that_do_not_follow_each_other_start_nothing():
    radii = np.full(40, 0.4)
    radii[[20, 21, 23, 24, 27, 29, 31]] = 0.9
    np.testing.assert_allclose(smoothed(radii), 0.4, rtol=1e-12)


def test_a_short_gap_is_bridged_and_a_long_one_drops_the_queue():
    def radius(i):
        return 0.3 + 0.002 * i

    for gap, bridged in ((4, True), (5, False)):
        frames = [radius(i) for i in range(20)] + [None] * gap
        results = smoothed(frames)
        assert results[20:24] == pytest.approx([radius(i) for i in range(20, 24)])
        range_filter = RangeFilter(PARABOLA)
        for i, value in enumerate(frames):
            range_filter.update(i / FPS, value)
        assert len(range_filter.times) == (15 if bridged else 0)
        assert range_filter.update(25 / FPS, 0.345) == pytest.approx(0.345 if not bridged else 0.35, abs=0.005)
        assert len(range_filter.times) == (15 if bridged else 1)
    assert smoothed(frames)[24] is None


def test_a_gap_in_time_drops_the_queue():
    for pause, kept in ((0.49, 15), (0.51, 1)):
        range_filter = RangeFilter(PARABOLA)
        for i in range(20):
            range_filter.update(i / FPS, 0.4)
        assert range_filter.update(19 / FPS + pause, 0.42) == pytest.approx(0.42, abs=0.02)
        assert len(range_filter.times) == kept


def test_missing_frames_after_a_pause_have_no_prediction():
    range_filter = RangeFilter(PARABOLA)
    for i in range(20):
        range_filter.update(i / FPS, 0.4)
    assert range_filter.update(19 / FPS + 0.51, None) is None


def test_refused_and_missing_frames_together_end_the_queue():
    """The prediction is never carried on for longer than `missing_frames`; the radius at hand then starts anew."""
    results = smoothed([0.4] * 20 + [0.9, None, None, None, 0.9, 0.9])
    assert results[20:24] == pytest.approx([0.4] * 4)
    assert results[24:] == pytest.approx([0.9, 0.9])


@pytest.mark.parametrize("bad", [None, math.nan, math.inf, 0.0, -0.3])
def test_what_is_no_range_counts_as_missing(bad):
    assert smoothed([0.4] * 10 + [bad])[-1] == pytest.approx(0.4)
    assert smoothed([bad, 0.4, bad, 0.4, bad]) == [None, 0.4, None, 0.4, None]


def test_a_prediction_is_a_range_or_none():
    """A hand that rushes at the camera does not pass through it."""
    results = smoothed([0.5, 0.35, 0.2, 0.05, None, None])
    assert results[4:] == [None, None]


def test_a_smoothed_range_stays_positive():
    radii = [1.0] * 8 + [0.01] * 7
    assert polynomial_value(np.arange(15), radii, 1, 14) < 0
    assert smoothed(radii, RangeSmoothing(degree=1, gate=math.inf))[-1] == 0.01


def test_reset_is_a_new_filter():
    radii = list(0.4 + 0.03 * np.random.default_rng(10).standard_normal(20))
    range_filter = RangeFilter(PARABOLA)
    for i, radius in enumerate([0.9, 0.8, *radii]):
        range_filter.update(100.0 + i / FPS, radius)
    range_filter.reset()
    assert len(range_filter.times) == 0 and not range_filter.predicting
    assert [range_filter.update(i / FPS, radius) for i, radius in enumerate(radii)] == smoothed(radii)


@pytest.mark.parametrize("time", [1.0, 0.5, math.nan, math.inf])
def test_time_must_advance(time):
    range_filter = RangeFilter(PARABOLA)
    range_filter.update(1.0, 0.4)
    with pytest.raises(InputError, match=r"reset\(\)"):
        range_filter.update(time, 0.4)


@pytest.mark.parametrize(
    "bad",
    [
        {"length": 0},
        {"degree": -1},
        {"fade": 0.0},
        {"fade": 1.1},
        {"fade": math.nan},
        {"gate": 0.0},
        {"gate": math.nan},
        {"scale_floor": -0.1},
        {"scale_floor": math.inf},
        {"jump_frames": 0},
        {"missing_frames": 0},
        {"max_gap_s": 0.0},
    ],
)
def test_settings_out_of_range_are_refused_by_name(bad):
    with pytest.raises(InputError, match=next(iter(bad))):
        RangeSmoothing(**bad)


# --- both hands -------------------------------------------------------------------------------------------------------


def test_only_the_range_is_smoothed():
    """Direction and shape are the current frame's: the result is the canonical pose placed at the smoothed radius."""
    rng = np.random.default_rng(11)
    radii = 0.4 + 0.02 * rng.standard_normal(30)
    directions = rng.uniform(-0.5, 0.5, (30, 2))
    tracker, expected = HandTracker(PARABOLA), smoothed(radii)
    for i, (radius, (theta, phi)) in enumerate(zip(radii, directions, strict=True)):
        given = hand_at(radius, theta, phi)
        hand = tracker.update(frame(given, time_s=i / FPS)).left
        assert hand.range_m == pytest.approx(expected[i], abs=1e-12)
        placed = camera_from_canonical(open_hand(), HAND_LENGTH_M, expected[i], theta, phi)
        np.testing.assert_allclose(hand.joints_m, placed, atol=1e-12)
        assert np.linalg.norm(hand.joints_m[ROOT]) == pytest.approx(hand.range_m)
        assert same_hand(dataclasses.replace(hand, joints_m=given.joints_m, range_m=given.range_m), given)
    assert abs(hand.range_m - radius) > 1e-4


def test_poses_of_other_systems_need_no_canonical_pose():
    tracker = HandTracker(PARABOLA)
    for i, radius in enumerate((0.40, 0.42, 0.41, 0.44)):
        bare = dataclasses.replace(hand_at(radius), canonical=None, theta_deg=None, phi_deg=None)
        hand = tracker.update(frame(bare, index=i)).left
    assert hand.range_m == pytest.approx((0.40 - 3 * 0.42 + 3 * 0.41 + 19 * 0.44) / 20)
    lost = dataclasses.replace(hand_at(0.4, valid=False), canonical=None)
    assert tracker.update(frame(lost, index=4)).left is lost


def test_the_hands_do_not_influence_each_other():
    rng = np.random.default_rng(12)
    left, right = 0.4 + 0.02 * rng.standard_normal((2, 30))
    left[20] = 1.5
    both, only = HandTracker(PARABOLA), HandTracker(PARABOLA)
    for i in range(30):
        other = ABSENT if 5 < i < 15 else hand_at(right[i], phi=0.3)
        pose = both.update(frame(hand_at(left[i]), other, index=i))
        assert same_hand(pose.left, only.update(frame(hand_at(left[i]), index=i)).left)
    swapped = HandTracker(PARABOLA)
    for i in range(30):
        hands = [hand_at(left[i]), ABSENT if 5 < i < 15 else hand_at(right[i], phi=0.3)]
        mirrored = swapped.update(frame(hands[1], hands[0], index=i))
    assert same_hand(mirrored.hands[RIGHT], pose.hands[LEFT]) and same_hand(mirrored.left, pose.right)


def test_absent_hands_and_the_rest_of_the_frame_pass_through():
    tracker = HandTracker(PARABOLA)
    for i in range(10):
        tracker.update(frame(hand_at(0.4), hand_at(0.5), index=i))
    masks = np.zeros((4, 4), np.uint8)
    given = TwoHandPose(ABSENT, hand_at(0.5), CENTRED_CAMERA, masks, 10, None)
    pose = tracker.update(given)
    assert pose.left is ABSENT
    assert (pose.camera, pose.masks, pose.index, pose.time_s) == (CENTRED_CAMERA, masks, 10, None)


def test_a_hand_without_a_valid_range_is_placed_at_the_prediction():
    tracker = HandTracker(PARABOLA)
    for i in range(10):
        tracker.update(frame(hand_at(0.3 + 0.01 * i), index=i))
    hand = tracker.update(frame(hand_at(0.0, theta=0.1, phi=0.4, valid=False), index=10)).left
    assert (hand.valid, hand.method) == (True, PREDICTED)
    assert hand.range_m == pytest.approx(0.4)
    np.testing.assert_allclose(
        hand.joints_m, camera_from_canonical(open_hand(), HAND_LENGTH_M, 0.4, 0.1, 0.4), atol=1e-9
    )
    after = tracker.update(frame(hand_at(0.41), index=11)).left
    assert (after.range_m, after.method) == (pytest.approx(0.41), "all-joints")


@pytest.mark.parametrize(
    ("frames", "changes"),
    [
        (2, {}),  # two radii are no regression
        (6, {"canonical": None}),
        (6, {"theta_deg": None}),
        (6, {"canonical": np.full((21, 3), np.nan)}),
    ],
)
def test_a_hand_that_cannot_be_placed_stays_as_it_is(frames, changes):
    tracker = HandTracker(PARABOLA)
    for i in range(frames):
        tracker.update(frame(hand_at(0.4), index=i))
    lost = dataclasses.replace(hand_at(0.4, valid=False), **changes)
    assert tracker.update(frame(lost, index=frames)).left is lost


def test_no_joint_is_put_behind_the_camera():
    """2 cm away, a hand whose fingers reach 3 cm towards the camera would lie half behind it."""
    lost = hand_at(0.1, valid=False)
    assert HAND_LENGTH_M * lost.canonical[:, 2].min() < -0.03
    for nearer, placed in ((0.010, True), (0.040, False)):
        tracker = HandTracker(PARABOLA)
        for i in range(6):
            tracker.update(frame(hand_at(0.06 + nearer * (5 - i)), index=i))
        hand = tracker.update(frame(lost, index=6)).left
        assert (hand is not lost) == placed
    solved = hand_at(0.1)
    assert moved_to_range(solved, 0.02) is solved
    assert moved_to_range(solved, 0.04).range_m == 0.04


def test_a_refused_range_is_replaced_and_says_so():
    tracker = HandTracker(PARABOLA)
    for i in range(10):
        tracker.update(frame(hand_at(0.4), index=i))
    hand = tracker.update(frame(hand_at(1.5), index=10)).left
    assert (hand.range_m, hand.method) == (pytest.approx(0.4), PREDICTED)
    np.testing.assert_allclose(hand.joints_m, hand_at(0.4).joints_m, atol=1e-12)


def test_time_stamps_count_where_there_are_any():
    times = np.cumsum(np.random.default_rng(13).uniform(0.01, 0.09, 30))
    radii = 0.3 + 0.2 * times - 0.05 * times**2
    timed, untimed = HandTracker(PARABOLA), HandTracker(PARABOLA)
    errors = []
    for i, (time, radius) in enumerate(zip(times, radii, strict=True)):
        pose = timed.update(frame(hand_at(radius), index=7, time_s=time))  # the index is not looked at
        assert pose.left.range_m == pytest.approx(radius, rel=1e-10)
        errors.append(abs(untimed.update(frame(hand_at(radius), index=i)).left.range_m - radius))
    assert max(errors) > 1e-4


def test_the_index_alone_knows_no_seconds():
    """Every tenth frame of a video: ten indices apart are no gap."""
    tracker = HandTracker(PARABOLA)
    results = [tracker.update(frame(hand_at(0.4 + 0.01 * (i % 2)), index=10 * i)).left.range_m for i in range(12)]
    expected = smoothed([0.4 + 0.01 * (i % 2) for i in range(12)])
    np.testing.assert_allclose(results, expected, rtol=1e-9)


def test_a_change_of_clock_drops_the_queues():
    tracker = HandTracker(PARABOLA)
    for i in range(10):
        tracker.update(frame(hand_at(0.4), time_s=50 + i / FPS))
    assert tracker.update(frame(hand_at(0.43), index=10)).left.range_m == 0.43


def test_frames_without_any_clock_are_refused():
    tracker = HandTracker(PARABOLA)
    tracker.update(frame(hand_at(0.4)))
    with pytest.raises(InputError, match="index"):
        tracker.update(frame(hand_at(0.4)))


@pytest.mark.parametrize("refused_at", [math.nan, math.inf, 0.0])
@pytest.mark.parametrize("timed", [True, False])
def test_a_refused_frame_is_as_if_it_had_not_come(refused_at, timed):
    """Also one that comes with another clock."""
    disturbed, plain = HandTracker(PARABOLA), HandTracker(PARABOLA)
    radii = 0.4 + 0.03 * np.random.default_rng(15).standard_normal(12)
    for i, radius in enumerate(radii):
        pose = frame(hand_at(radius, valid=i != 8), index=i, time_s=i / FPS if timed else None)
        if i == 8 and (timed or refused_at != 0):
            with pytest.raises(InputError, match="frame time"):
                disturbed.update(frame(hand_at(0.9), index=i, time_s=refused_at))
        assert same_hand(disturbed.update(pose).left, plain.update(pose).left)


def test_tracker_reset_is_a_new_tracker():
    radii = 0.4 + 0.03 * np.random.default_rng(14).standard_normal(12)
    used, new = HandTracker(PARABOLA), HandTracker(PARABOLA)
    for i in range(12):
        used.update(frame(hand_at(0.9), hand_at(0.2), time_s=100.0 + i))
    used.reset()
    for i, radius in enumerate(radii):
        pose = frame(hand_at(radius, valid=i not in (0, 8)), time_s=i / FPS)
        assert same_hand(used.update(pose).left, new.update(pose).left)


def test_inputs_are_not_changed():
    tracker = HandTracker(PARABOLA)
    for i in range(12):
        hand = hand_at(0.4 + 0.01 * (i % 3), valid=i != 9)
        copy = hand_at(0.4 + 0.01 * (i % 3), valid=i != 9)
        for field in dataclasses.fields(hand):
            if isinstance(getattr(hand, field.name), np.ndarray):
                getattr(hand, field.name).setflags(write=False)
        pose = tracker.update(frame(hand, index=i))
        assert same_hand(hand, copy)
        assert pose.left.joints_m is not hand.joints_m
