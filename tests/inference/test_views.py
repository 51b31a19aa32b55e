"""`inference.views`: the place that several views agree on, and how well they do."""

import numpy as np
import pytest

from twohands.inference.decision import ViewConfig
from twohands.inference.views import agreement, geometric_median

HALF = ViewConfig().agreement_share


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        ([[3, 4]], [3, 4]),
        ([[0, 0], [4, 0]], [2, 0]),  # any place between them is as good
        ([[0, 0], [1, 0], [10, 0]], [1, 0]),  # along a line, the median
        ([[0, 0], [2, 0], [2, 2], [0, 2]], [1, 1]),  # where the diagonals cross
        ([[0, 0], [4, 0], [2, 2 * np.sqrt(3)]], [2, 2 / np.sqrt(3)]),  # all sides are seen under 120 degrees
        ([[0, 0], [4, 0.5], [-4, 0.5]], [0, 0]),  # the corner of a flat triangle
        ([[5, 5], [5, 5], [90, 5]], [5, 5]),
    ],
)
def test_geometric_median_of_places_whose_least_sum_of_distances_is_known(points, expected):
    np.testing.assert_allclose(geometric_median(np.array(points, float)), expected, atol=0.05)


def test_geometric_median_takes_every_joint_by_itself_and_turns_with_the_places():
    points = np.random.default_rng(2).normal(size=(7, 3, 21, 2))
    median = geometric_median(points)
    assert median.shape == (3, 21, 2)
    np.testing.assert_allclose(median[1, 4], geometric_median(points[:, 1, 4]))
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    np.testing.assert_allclose(geometric_median(points @ turn.T + [7, -2]), median @ turn.T + [7, -2], atol=1e-9)


def test_agreement_by_hand():
    median = np.zeros((1, 21, 2))
    median[0, 0] = [200, 100]  # the box of all joints is 200 x 100
    away = 200 * HALF
    points = np.stack([median, median])
    points[:, 0, 1] = [[away, 0], [0, -away]]  # both views off by as much as counts half
    points[0, 0, 2, 0] = np.sqrt(2) * away  # one view only, and the same root mean square
    points[:, 0, 3, 0] = [3 * away, -3 * away]
    np.testing.assert_allclose(agreement(points, median, HALF)[0, :5], [1, 0.5, 0.5, 0.1, 1])


def test_agreement_is_that_of_a_share_of_the_hand_and_a_single_view_agrees_with_itself():
    points = np.random.default_rng(2).normal(size=(7, 3, 21, 2))
    median = geometric_median(points)
    shares = agreement(points, median, HALF)
    assert shares.shape == (3, 21)
    assert ((shares > 0) & (shares < 1)).all()
    np.testing.assert_allclose(agreement(30 * points + [7, -2], 30 * median + [7, -2], HALF), shares)
    assert (agreement(points[:1], points[0], HALF) == 1).all()
    assert (agreement(np.zeros((2, 1, 21, 2)), np.zeros((1, 21, 2)), HALF) == 1).all()  # a hand without extent
