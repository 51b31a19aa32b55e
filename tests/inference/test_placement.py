"""What is left of two uncertain ranges, by hand and by law."""

import dataclasses
import math

import numpy as np
import pytest

from twohands.geometry.body import Body
from twohands.inference.decision import PlacementConfig
from twohands.inference.placement import body_ranges, posterior_ranges

PRIOR = PlacementConfig(range_errors=(0.04, 0.06))
OF_BODIES = PlacementConfig(range_errors=(0.04, 0.06), body_spread=0.2, body_correlation=0.7)
SIZES_PX = np.array([60.0, 6.0, 90.0])


def scores(*means: float) -> np.ndarray:
    return np.array(means)


def likely(ranges: list[float], *means: float) -> np.ndarray:
    return posterior_ranges(np.array(ranges), scores(*means), PRIOR)


@pytest.mark.parametrize(("score", "error"), [(1.0, 0.04), (0.8, 0.06), (0.6, 0.09)])
def test_one_hand_is_drawn_towards_the_usual_by_the_share_of_its_error_in_the_variance(score, error):
    share = error**2 / (error**2 + PRIOR.usual_spread**2)
    (found,) = likely([2 * PRIOR.usual_range_m], score)
    assert math.log(found / PRIOR.usual_range_m) == pytest.approx((1 - share) * math.log(2))


def test_usual_ranges_stay_whatever_their_certainty():
    np.testing.assert_allclose(likely([PRIOR.usual_range_m] * 2, 0.1, 0.9), PRIOR.usual_range_m)


def test_nothing_moves_where_no_error_is_to_be_feared():
    found = posterior_ranges(np.array([0.2, 1.5]), scores(0.9, 0.5), PlacementConfig(range_errors=(1e-6, 1e-6)))
    np.testing.assert_allclose(found, [0.2, 1.5], rtol=1e-6)


def test_an_uncertain_hand_is_drawn_towards_a_certain_one_more_than_the_other_way():
    alone = likely([0.5], 0.3)[0]
    certain, uncertain = likely([0.9, 0.5], 0.95, 0.3)
    assert alone < uncertain < certain < 0.9
    assert 0.9 / certain < uncertain / 0.5


def test_both_hands_are_treated_alike():
    np.testing.assert_allclose(likely([0.3, 0.8], 0.9, 0.4), likely([0.8, 0.3], 0.4, 0.9)[::-1])


def test_a_hand_without_a_range_keeps_none_and_does_not_count():
    unknown, known = likely([math.nan, 0.8], 0.9, 0.5)
    assert math.isnan(unknown)
    assert known == likely([0.8], 0.5)[0]
    assert np.isnan(likely([math.nan, math.nan], 0.9, 0.9)).all()


def test_a_hand_is_drawn_towards_its_body_instead():
    """Error .06, spread .2: the share of 9 in 109 of the variance; nothing is known of a hand without a body."""
    (found,) = posterior_ranges(np.array([0.8]), scores(0.8), OF_BODIES, np.array([1.6]))
    assert math.log(found / 0.8) == pytest.approx(9 / 109 * math.log(2))
    given = np.array([0.5, 0.8])
    for bodies_m in (None, np.array([np.nan, np.nan]), np.array([0.7, np.nan])):
        np.testing.assert_array_equal(
            posterior_ranges(given, scores(0.7, 0.8), OF_BODIES, bodies_m),
            posterior_ranges(given, scores(0.7, 0.8), OF_BODIES),
        )
    of_one = posterior_ranges(np.array([np.nan, 0.8]), scores(0.8, 0.8), OF_BODIES, np.array([np.nan, 1.6]))
    np.testing.assert_allclose(of_one, [np.nan, found])


def test_hands_where_their_bodies_have_them_stay_and_err_together():
    bodies_m = np.array([0.9, 1.2])
    np.testing.assert_allclose(posterior_ranges(bodies_m, scores(0.5, 0.7), OF_BODIES, bodies_m), bodies_m)
    first, second = posterior_ranges(np.array([0.45, 1.2]), scores(0.99, 0.5), OF_BODIES, bodies_m)
    assert first < 0.5 and second < 1.2, "one that is surely nearer than its body says has the other one come, too"


def test_how_far_hands_are_by_a_body_by_hand():
    """60 pixels from shoulder to shoulder at a focal length of 600, times e^-2, and of shorter hands the root less."""
    body = Body(*(np.zeros((2, n)) for n in (2, 4)), np.ones(2), *np.zeros((2, 2, 2)), SIZES_PX, np.array([60.0, 0, 0]))
    config = dataclasses.replace(OF_BODIES, body_weights=(-2.0, 0.0, 0.0, 0.5, 0.0, 0.5))
    np.testing.assert_allclose(body_ranges(body, 600.0, 0.1, config), 10 * np.exp([-1.95, -2.0]))
    np.testing.assert_allclose(body_ranges(body, 600.0, 0.064, config), 8 * np.exp([-1.95, -2.0]))
    assert np.isnan(body_ranges(None, 600.0, 0.1, config)).all()
    assert np.isnan(body_ranges(body, 600.0, 0.1, dataclasses.replace(config, body_weights=()))).all()


def test_the_given_ranges_are_left_alone():
    given = np.array([0.2, 1.0])
    posterior_ranges(given, scores(0.5, 0.5), PRIOR)
    assert given.tolist() == [0.2, 1.0]


def test_without_errors_ranges_are_taken_as_they_are():
    given = np.array([0.2, np.nan])
    np.testing.assert_array_equal(posterior_ranges(given, scores(0.5, 0.5), PlacementConfig()), given)
