"""One hand at taped distances: their product, and where hands in several places tell focal length and length apart."""

import math

import numpy as np
import pytest

from twohands.calibration.tape import FOCAL_SPREAD, fit_tape, focal_spread, length_spread, ranges, zoomed
from twohands.errors import InputError
from twohands.geometry.camera import project
from twohands.geometry.canonical import camera_from_canonical
from twohands.geometry.projection import project_global
from twohands.skeleton import ROOT, WRIST
from twohands.types import HandPose, PinholeCamera

TRUE = PinholeCamera(500.0, 500.0, 480.0, 270.0, 960, 540)
LENGTH_M = 0.11


def hand_at(distance_m: float, theta: float, phi: float, seed: int = 0) -> HandPose:
    """A hand as it is seen by the true camera."""
    canonical = np.random.default_rng(seed).uniform(-0.7, 0.7, (21, 3))
    canonical[ROOT], canonical[WRIST] = 0, (0.2, 0.97, 0.1)
    canonical[WRIST] /= np.linalg.norm(canonical[WRIST])
    placed = [np.array([value]) for value in (LENGTH_M, distance_m, theta, phi)]
    pixels = project(camera_from_canonical(canonical[None], *placed), TRUE)[0]
    return HandPose(True, canonical=canonical, joints_px=pixels, joint_scores=np.ones(21), valid=True)


PLACES = [(0.0, 0.0), (0.35, 0.1), (-0.3, 0.5), (0.1, -0.6), (0.0, 0.7), (-0.35, -0.4)]


def test_with_true_camera_and_length_ranges_are_the_distances():
    hands = [hand_at(0.4 + 0.1 * i, *place, seed=i) for i, place in enumerate(PLACES)]
    np.testing.assert_allclose(ranges(hands, TRUE, LENGTH_M), 0.4 + 0.1 * np.arange(len(PLACES)), rtol=1e-9)


@pytest.mark.parametrize("scale", [0.8, 1.25])
def test_a_measured_camera_leaves_all_to_the_length(scale):
    fit = fit_tape([hand_at(0.5, 0.1, 0.2)], TRUE, [0.5], LENGTH_M / scale)
    assert fit.hand_length_m == pytest.approx(LENGTH_M) and fit.focal_scale == 1


def test_one_hand_or_one_place_says_nothing_of_the_focal_length():
    wrong = zoomed(TRUE, 0.8)
    for count in (1, 4):
        hands = [hand_at(0.5, 0.0, 0.3)] * count
        fit = fit_tape(hands, wrong, [0.5] * count, 0.8 * LENGTH_M, focal_spread=FOCAL_SPREAD)
        assert fit.focal_scale == 1
        assert ranges(hands, wrong, fit.hand_length_m) == pytest.approx(0.5)


@pytest.mark.parametrize("spread", [0.1, 0.2, 0.4])
@pytest.mark.parametrize("off", [0.8, 1.0, 1.2])
def test_what_one_hand_does_not_tell_is_shared_out_by_the_spreads(spread, off):
    """In the middle of the picture only the product counts: of two normal numbers whose sum is known, each takes its
    share of the variance."""
    hand = hand_at(0.5, 0.0, 0.0)
    fit = fit_tape([hand], TRUE, [0.5], LENGTH_M / off, focal_spread=0.2, length_spread=spread)
    share = 0.2**2 / (0.2**2 + spread**2)
    assert math.log(fit.focal_scale) == pytest.approx(share * math.log(off), abs=0.02)
    assert ranges([hand], zoomed(TRUE, fit.focal_scale), fit.hand_length_m) == pytest.approx(0.5)


@pytest.mark.parametrize(("focal", "length"), [(0.8, 1.2), (1.2, 0.8), (0.8, 1.0), (1.2, 1.2)])
def test_hands_in_several_places_tell_focal_length_and_hand_length_apart(focal, length):
    hands = [hand_at(0.5, *place, seed=i) for i, place in enumerate(PLACES)]
    fit = fit_tape(hands, zoomed(TRUE, focal), [0.5] * len(hands), length * LENGTH_M, focal_spread=FOCAL_SPREAD)
    assert fit.focal_scale * focal == pytest.approx(1, rel=0.05)
    assert fit.hand_length_m == pytest.approx(LENGTH_M, rel=0.05)


def test_its_uncertainty_is_that_of_the_hands_own_ranges():
    hand = hand_at(0.5, 0.0, 0.0)
    known = [HandPose(True, canonical=hand.canonical, joints_px=hand.joints_px, joint_scores=hand.joint_scores,
                      range_m=0.5, range_sigma_m=sigma, valid=True) for sigma in (0.01, 0.02, 0.05)]  # fmt: skip
    assert fit_tape(known, TRUE, [0.5] * 3, LENGTH_M).sigma == pytest.approx(0.04)


def test_pulled_to_their_lines_of_sight_hands_have_the_range_they_were_placed_at():
    """What an estimate shows of its pose is pulled to where joints are seen; its range as projected comes back."""
    from twohands.geometry.projection import pull_to_rays, range_weights

    hand = hand_at(0.5, 0.2, 0.3)
    rng = np.random.default_rng(3)
    canonical = hand.canonical + rng.normal(0, 0.02, (21, 3))
    canonical[ROOT] = 0
    canonical[WRIST] /= np.linalg.norm(canonical[WRIST])
    weights = range_weights(hand.joint_scores)
    placed = project_global(canonical, hand.joints_px, TRUE, LENGTH_M, method="fitted", weights=weights)
    pulled = pull_to_rays(canonical, hand.joints_px, TRUE, LENGTH_M, placed, 0.5)
    shown = HandPose(True, canonical=pulled, joints_px=hand.joints_px, joint_scores=hand.joint_scores, valid=True)
    assert ranges([shown], TRUE, LENGTH_M)[0] == pytest.approx(float(placed.radius_m), rel=0.01)


def test_what_cannot_be_is_refused():
    hand = hand_at(0.5, 0.0, 0.0)
    for bad in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(InputError, match="positive number of metres"):
            fit_tape([hand], TRUE, [bad], LENGTH_M)
    for hands in ([], [HandPose(True, valid=False)]):
        with pytest.raises(InputError, match="no hand was found"):
            fit_tape(hands, TRUE, [0.5] * len(hands), LENGTH_M)
    flat = HandPose(True, canonical=np.zeros((21, 3)), joints_px=np.full((21, 2), 99.0), valid=True)
    with pytest.raises(InputError, match="not known; show its palm"):
        fit_tape([flat], TRUE, [0.5], LENGTH_M)


def test_measured_cameras_are_taken_for_true():
    assert [focal_spread(source) for source in ("file", "board")] == [0, 0]
    assert [focal_spread(source) for source in ("fov", "exif", "assumed")] == [FOCAL_SPREAD] * 3


def test_lengths_that_were_measured_are_measured_again():
    assert [length_spread(source) for source in ("board", "distance")] == [math.inf] * 2
    assert 0 < length_spread("typed") < length_spread("assumed") < 1
