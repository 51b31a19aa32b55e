"""A body's joints in pixels, and where its hands should be."""

import numpy as np
import pytest

from twohands.geometry.body import (
    FINDER_SIZE,
    JOINTS_SIZE,
    Body,
    body_of,
    body_square,
    found_body,
)
from twohands.geometry.boxes import apply_homography, picture_square

ANCHORS = 28 * 28 * 2 + 14 * 14 * 2 + 7 * 7 * 6
WRIST, LITTLE, FIRST, THUMB = (15, 16), (17, 18), (19, 20), (21, 22)


def joints_of(at_px, visible=5.0) -> np.ndarray:
    """(39, 5) joints of which the named ones are somewhere, and all seen."""
    joints = np.zeros((39, 5))
    joints[:, 3:] = visible
    for number, place in at_px.items():
        joints[number, :2] = place
    return joints


def standing() -> np.ndarray:
    """Shoulders 100 pixels above the hips, arms hanging: 20 pixels from wrist to knuckles, these 10 apart.

    LEFT is on the right of the picture, as of a person that looks into the camera.
    """
    at_px = {11: (160, 60), 12: (100, 60), 23: (150, 160), 24: (110, 160), 33: (130, 160), 34: (130, 20)}
    for side, u in enumerate((170, 90)):
        at_px |= {
            WRIST[side]: (u, 150),
            LITTLE[side]: (u - 5, 170),
            FIRST[side]: (u + 5, 170),
            THUMB[side]: (u + 5, 160),
        }
    return joints_of(at_px)


@pytest.mark.parametrize("size", [(480, 640), (640, 480), (100, 100)])
def test_a_picture_fits_the_finders_square(size):
    corners = np.array([[0.0, 0], [size[1], size[0]]])
    seen = apply_homography(np.linalg.inv(picture_square(size, FINDER_SIZE)), corners)
    assert seen.min() == pytest.approx(0) and seen.max() == pytest.approx(FINDER_SIZE)
    np.testing.assert_allclose(seen.mean(axis=0), FINDER_SIZE / 2)  # in its middle


@pytest.mark.parametrize(
    ("anchor", "middle"),
    [
        (0, (4, 4)),  # two of 8 pixels in each place
        (3, (12, 4)),
        (1568, (8, 8)),  # then two of 16
        (1960, (16, 16)),  # then six of 32
        (ANCHORS - 1, (208, 208)),
    ],
)
def test_bodies_are_told_from_the_middle_of_their_anchor(anchor, middle):
    points, logits = np.zeros((ANCHORS, 12)), np.full(ANCHORS, -9.0)
    points[anchor, 4:8] = 3, -2, 3, -50
    logits[anchor] = 1.0
    np.testing.assert_allclose(found_body(points, logits, 0.5), np.add(middle, [[3, -2], [3, -50]]))


def test_what_is_not_sure_is_no_body():
    points, logits = np.zeros((ANCHORS, 12)), np.full(ANCHORS, -9.0)
    logits[7] = np.log(3)  # a chance of 3/4
    assert found_body(points, logits, 0.76) is None and found_body(points, logits, 0.74) is not None


@pytest.mark.parametrize("end", [(0, -80), (80, 0), (-30, 60), (0, 1e-12)])
def test_a_bodys_end_is_above_its_middle(end):
    around_px = np.array([[200.0, 150.0], np.add((200.0, 150.0), end)])
    middle, top = apply_homography(np.linalg.inv(body_square(around_px)), around_px)
    np.testing.assert_allclose(middle, JOINTS_SIZE / 2)
    if np.hypot(*end) > 1:
        np.testing.assert_allclose(top, [128, 128 - 128 / 1.25])
    assert np.linalg.det(body_square(around_px)) > 0  # turned, never mirrored


def test_hands_of_a_body_by_hand():
    body = body_of(standing(), np.eye(3))
    np.testing.assert_allclose(body.palms_px, [[170, 490 / 3], [90, 490 / 3]])
    np.testing.assert_allclose(body.around_px, [[130, 160], [130, 20]])
    np.testing.assert_allclose(body.along_px, [[0, 20], [0, 20]])
    np.testing.assert_allclose(body.visible, 1 / (1 + np.exp(-5.0)))
    span = np.hypot(5, 20)  # wrist to knuckle
    half = np.sqrt(2.4 * span * 0.47 * 100) / 2
    np.testing.assert_allclose(body.boxes_px[0], [170 - half, 176 - half, 170 + half, 176 + half])


def test_a_wrist_is_visible_if_it_is_in_the_picture_and_not_hidden():
    joints = standing()
    joints[WRIST[0], 3], joints[WRIST[1], 4] = 0.0, -100.0
    np.testing.assert_allclose(body_of(joints, np.eye(3)).visible, [0.5, 0.0], atol=1e-12)


def test_a_crop_that_is_moved_turned_and_scaled_moves_the_body():
    half = 0.5
    place = np.array([[0, -half, 300], [half, 0, 40], [0, 0, 1.0]])
    body, there = body_of(standing(), np.eye(3)), body_of(standing(), place)
    np.testing.assert_allclose(there.palms_px, apply_homography(place, body.palms_px))
    sizes = [(one.boxes_px[:, 2:] - one.boxes_px[:, :2]) for one in (there, body)]
    np.testing.assert_allclose(sizes[0], half * sizes[1])
    np.testing.assert_allclose(there.visible, body.visible)


def test_sizes_and_depths_of_a_body_by_hand():
    joints = standing()
    joints[[2, 5], :2] = (138, 30), (122, 30)  # eyes
    joints[[9, 10], :2] = (134, 36), (126, 36)  # mouth
    joints[[9, 10], 2] = 8  # behind them
    joints[11, 2], joints[WRIST[0], 2] = 80, -12  # the left shoulder is behind, its wrist before the hips
    body = body_of(joints, np.eye(3))
    np.testing.assert_allclose(body.sizes_px, [100, 10, np.hypot(100, 40)])
    np.testing.assert_allclose(body.depths_px, [-12, 0, 40])
    terms, beside = body.distance_terms(600.0, np.array([0.1, 0.08]))
    assert beside == pytest.approx(np.log(6.0))
    np.testing.assert_allclose(terms[0], [1, np.log(0.1), np.log(np.hypot(100, 40) / 100), -0.02, 40 / 600, 0])
    np.testing.assert_allclose(terms[1], [*terms[0, :3], 0, 40 / 600, np.log(0.8)])


def test_a_picture_enlarged_with_its_camera_shows_the_same_distances():
    joints = standing()
    joints[:, 2] = np.linspace(-20, 20, 39)
    place = np.array([[0, -3.0, 400], [3.0, 0, 40], [0, 0, 1.0]])
    plain, large = (body_of(joints, one).distance_terms(f, 0.09) for one, f in ((np.eye(3), 500.0), (place, 1500.0)))
    for one, other in zip(plain, large, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


def test_a_body_of_no_size_says_nothing_infinite():
    terms, beside = body_of(np.zeros((39, 5)), np.eye(3)).distance_terms(500.0, 0.1)
    assert np.isfinite(terms).all() and np.isfinite(beside)


def test_which_hand_a_box_shows():
    palms_px = np.array([[100.0, 50], [40, 50]])
    body = Body(palms_px, np.zeros((2, 4)), np.array([0.9, 0.5]), *np.zeros((2, 2, 2)), *np.zeros((2, 3)))
    near = body.near(np.array([70.0, 40, 130, 60]))  # its middle is the left palm; the right one is a side away
    np.testing.assert_allclose(near, [0.9, 0.5 * np.exp(-1 / 0.36)])
    assert np.isfinite(body.near(np.full(4, 100.0))).all()  # of no size
