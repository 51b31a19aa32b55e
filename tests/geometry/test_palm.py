"""What the palm detector says, in pixels of the picture."""

import numpy as np
import pytest

from twohands.geometry.boxes import apply_homography, picture_square
from twohands.geometry.palm import LEAST_LOGIT, PALM_SIZE, VALUES, Palm, found_palms, palm_in

ANCHORS = 24 * 24 * 2 + 12 * 12 * 6
PALM = Palm(1.0, np.array([100.0, 50.0]), np.array([0.0, -8.0]), 20.0)


def said(*palms: tuple[int, float, tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Points and log-odds of upright palms 30 wide and 20 high: anchor, log-odds, the middle from the anchor's."""
    points, logits = np.zeros((ANCHORS, VALUES)), np.full(ANCHORS, -9.0)
    for anchor, logit, (u, v) in palms:
        points[anchor, :4] = u, v, 30, 20
        points[anchor, 4:6], points[anchor, 8:10] = (u, v + 10), (u, v - 10)  # wrist, middle knuckle
        logits[anchor] = logit
    return points, logits


@pytest.mark.parametrize(
    ("anchor", "middle"),
    [
        (0, (4, 4)),  # two of 8 pixels in each place
        (3, (12, 4)),
        (48, (4, 12)),  # the second row
        (1152, (8, 8)),  # then six of 16
        (ANCHORS - 1, (184, 184)),
    ],
)
def test_palms_are_told_from_the_middle_of_their_anchor(anchor, middle):
    (palm,) = found_palms(*said((anchor, 1.5, (3.0, -2.0))), np.eye(3))
    assert palm.logit == 1.5 and palm.side_px == 30
    np.testing.assert_allclose(palm.along_px, [0, -20])
    np.testing.assert_allclose(palm.middle_px, np.add(middle, (3, -2 - 15)))  # half a side towards the fingers


def test_palms_come_the_surest_first_and_none_twice():
    anchors = (
        (1152, 0.5, (0.0, 0.0)),
        (1158, 2.0, (-10.0, 0.0)),
        (1300, 1.0, (0.0, 0.0)),
        (5, LEAST_LOGIT - 0.1, (0, 0)),
    )
    palms = found_palms(*said(*anchors), np.eye(3))
    assert [palm.logit for palm in palms] == [2.0, 1.0]  # the first is the second's; the last is none
    assert found_palms(*said(), np.eye(3)) == ()


@pytest.mark.parametrize("size", [(480, 640), (640, 480), (96, 96)])
def test_palms_lie_where_the_picture_shows_them(size):
    place = picture_square(size, PALM_SIZE)
    (palm,) = found_palms(*said((1152, 1.0, (80.0, 90.0))), place)
    scale = max(size) / PALM_SIZE
    np.testing.assert_allclose(palm.middle_px, apply_homography(place, np.array([88.0, 98 - 15])))
    np.testing.assert_allclose([palm.side_px, *palm.along_px], np.multiply(scale, [30, 0, -20]), atol=1e-9)


@pytest.mark.parametrize("along", [(0.0, -8.0), (8.0, 0.0), (-3.0, 5.0), (0.0, 0.0)])
def test_a_hand_is_cut_out_with_its_fingers_up(along):
    palm = PALM._replace(along_px=np.array(along))
    crop = palm.square(64)
    np.testing.assert_allclose(apply_homography(crop, np.full((1, 2), 32.0)), [palm.middle_px])
    edge = apply_homography(crop, np.array([[0.0, 0], [64, 0]]))
    assert np.linalg.norm(edge[1] - edge[0]) == pytest.approx(2.6 * 20)  # as wide as published
    up = apply_homography(crop, np.array([[32.0, 0.0]]))[0] - palm.middle_px
    if np.any(along):
        np.testing.assert_allclose(up / np.linalg.norm(up), np.array(along) / np.linalg.norm(along), atol=1e-9)
    assert np.linalg.det(crop) > 0  # turned, never mirrored


def test_a_hand_ends_within_its_circle():
    np.testing.assert_allclose(np.linalg.norm(PALM.around_px() - PALM.middle_px, axis=1), 0.85 * 20)


def test_which_palm_a_box_shows():
    far, unsure = PALM._replace(middle_px=np.array([300.0, 50])), PALM._replace(logit=-1.5)
    box = np.array([90.0, 40, 130, 60])  # its middle is a quarter of its longer side from the palm's
    number, near = palm_in([far, PALM], box)
    assert number == 1 and near == pytest.approx(np.exp(-((0.25 / 0.6) ** 2)))
    assert palm_in([unsure, PALM], box)[0] == 1  # of two that are as near, the surer
    assert palm_in([], box) is None
