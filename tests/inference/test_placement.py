"""What is left of two uncertain ranges, by hand and by law."""

import math

import numpy as np
import pytest

from twohands.inference.decision import PlacementConfig
from twohands.inference.placement import posterior_ranges

PRIOR = PlacementConfig(range_errors=(0.04, 0.06))


def scores(*means: float) -> np.ndarray:
    return np.tile(np.array(means)[:, None], (1, 21))


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


def test_the_given_ranges_are_left_alone():
    given = np.array([0.2, 1.0])
    posterior_ranges(given, scores(0.5, 0.5), PRIOR)
    assert given.tolist() == [0.2, 1.0]


def test_without_errors_ranges_are_taken_as_they_are():
    given = np.array([0.2, np.nan])
    np.testing.assert_array_equal(posterior_ranges(given, scores(0.5, 0.5), PlacementConfig()), given)
