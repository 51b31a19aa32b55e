"""Cut-out hands in other pictures."""

import math

import numpy as np
import pytest
from tests.datasets.photographed import photograph

from twohands.datasets.cutting import CutOut, cut_out
from twohands.skeleton import LEFT, RIGHT, WRIST
from twohands.training.arms import cloth_strip
from twohands.training.pasting import (
    Look,
    Picture,
    Place,
    changed,
    draw_hand_and_arm,
    free_place,
    label_hand,
    mean_light,
    paste,
    turned,
)
from twohands.types import PinholeCamera

PLAIN = Look(np.ones(3), 1.0, np.zeros(2), 0.0)


@pytest.fixture(scope="module")
def cut() -> CutOut:
    picture, _, joints = photograph(np.random.default_rng(0))
    return cut_out(picture, joints)


def empty(width: int = 320, height: int = 240) -> Picture:
    return Picture(np.full((height, width, 3), 90, np.uint8), PinholeCamera.from_fov(60.0, width, height))


@pytest.mark.parametrize("scale", [0.4, 1.0, 2.2])
def test_a_pasted_hand_is_the_hand_at_another_size(cut, scale):
    picture = empty()
    place = Place(RIGHT, scale * np.eye(2), np.array([10.0, 5.0]))
    paste(picture, cut, place, PLAIN)
    label_hand(picture, cut, place, np.ones(21))
    covered = picture.labels > 0
    assert covered.sum() == pytest.approx((cut.alpha > 127).sum() * scale**2, rel=0.05)
    middle = np.argwhere(covered).mean(axis=0)[::-1] + 0.5
    expected = place.points(np.argwhere(cut.alpha > 127).mean(axis=0)[::-1] + 0.5)
    assert np.abs(middle - expected).max() < 0.6
    assert (picture.image[~covered] == 90).mean() > 0.95
    assert picture.present.tolist() == [False, True] and picture.valid[RIGHT].all()


def test_arm_and_hand_have_labels_of_their_own(cut):
    picture = empty()
    place = Place(LEFT, np.diag([-2.0, 2.0]), np.array([220.0, 10.0]))
    paste(picture, cut, place, PLAIN)
    assert set(np.unique(picture.labels)) == {0, 1, 2}
    wrist_row = place.points(cut.joints_px[WRIST])[1]
    assert np.argwhere(picture.labels == 1)[:, 0].min() > wrist_row - 8
    assert np.argwhere(picture.labels == 2)[:, 0].max() < wrist_row + 8


def test_a_hand_never_ends_in_the_air(cut):
    """Wherever it is put, and whatever it wears, its labelled pixels reach the picture's border."""
    rng = np.random.default_rng(7)
    for kind in (0.1, 0.4, 0.9) * 5:
        picture = empty()
        place = free_place(cut, int(rng.integers(2)), 60.0, picture.labels.shape, None, rng)
        draw_hand_and_arm(picture, cut, place, PLAIN, cloth_strip(rng), kind, rng)
        mask = picture.labels > 0
        assert mask[0].any() or mask[-1].any() or mask[:, 0].any() or mask[:, -1].any()


def test_turning_points_the_forearm(cut):
    for side in (LEFT, RIGHT):
        for angle in (-2.0, 0.3, math.pi / 2):
            along = turned(cut, side, 1.7, angle) @ cut.along
            np.testing.assert_allclose(along, 1.7 * np.array([math.cos(angle), math.sin(angle)]), atol=1e-9)
    assert np.linalg.det(turned(cut, LEFT, 1.0, 0.0)) == pytest.approx(-1)


def test_a_forearm_fades_or_hides(cut):
    place = Place(RIGHT, 2 * np.eye(2), np.zeros(2))
    whole, faded, hidden = empty(), empty(), empty()
    paste(whole, cut, place, PLAIN)
    paste(faded, cut, place, PLAIN, fade=True)
    paste(hidden, cut, place, PLAIN, under=np.ones(hidden.labels.shape, bool))
    arms = [np.count_nonzero(picture.labels == 8) for picture in (whole, faded, hidden)]
    hands = [np.count_nonzero(picture.labels == 9) for picture in (whole, faded, hidden)]
    assert arms[0] > arms[1] > arms[2] == 0 and min(hands) > 0.95 * max(hands)


def test_light_changes_as_it_is_told(cut):
    inside = cut.alpha > 250
    dim = changed(cut, Look(np.array([0.5, 0.25, 1.0]), 1.0, np.zeros(2), 0.0))
    ratio = mean_light(dim, inside) / mean_light(cut.colour, inside)
    np.testing.assert_allclose(ratio, [0.5, 0.25, 1.0], rtol=0.03)
