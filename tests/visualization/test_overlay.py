"""The overlay: drawn where the hands are, in the hands' colours, and nowhere else."""

import dataclasses
import tracemalloc

import cv2
import numpy as np
import pytest
from tests.oracles import UNUSED, drawn_hands, full_truth, make_card

from twohands.inference.estimator import HandEstimator
from twohands.skeleton import LEFT, RIGHT
from twohands.types import HandPose, PinholeCamera, TwoHandPose
from twohands.visualization import overlay
from twohands.visualization.overlay import draw_overlay
from twohands.visualization.palette import HAND_COLOURS, finger_colour, joint_colour


def pose_of(sample) -> TwoHandPose:
    return HandEstimator(UNUSED, make_card()).estimate(sample.image, sample.camera, 0.1, full_truth(sample))


def distance_to(image: np.ndarray, colour) -> np.ndarray:
    return np.abs(image.astype(int) - np.array(colour)).max(axis=-1)


@pytest.mark.parametrize("size", [(240, 135), (480, 270), (960, 540)])
def test_every_joint_shows_its_own_colour(size):
    """At the tips, whose discs lie on top of their own bone; other bones may cross the inner joints."""
    seen = total = 0
    for seed in range(5):
        sample = drawn_hands(seed, width=size[0], height=size[1])
        picture = draw_overlay(sample.image, pose_of(sample))
        for side in (LEFT, RIGHT):
            for tip in (4, 8, 12, 16, 20):
                u, v = sample.joints_px[side, tip].astype(int)
                patch = picture[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2]
                seen += distance_to(patch, joint_colour(side, tip)).min() < 30
                total += 1
    assert seen >= 0.9 * total


@pytest.mark.parametrize("centre", [(100.5, 60.5), (100.0, 60.0), (100.25, 60.75)])
def test_a_joint_is_drawn_at_its_place_to_a_tenth_of_a_pixel(centre):
    """All 21 joints on one point make one disc; pixel i covers i to i + 1, so its centre counts as i + 0.5."""
    image = np.full((270, 480, 3), 200, np.uint8)
    hand = HandPose(present=True, joints_px=np.tile(centre, (21, 1)))
    picture = draw_overlay(image, TwoHandPose(hand, HandPose(present=False), PinholeCamera.ego3dhands()))
    changed = np.abs(picture.astype(float) - 200).sum(axis=-1)[50:72, 90:112]  # the label lies above
    rows, columns = np.mgrid[50:72, 90:112] + 0.5
    assert (changed * columns).sum() / changed.sum() == pytest.approx(centre[0], abs=0.1)
    assert (changed * rows).sum() / changed.sum() == pytest.approx(centre[1], abs=0.1)


def test_pixels_away_from_hands_and_labels_are_untouched():
    sample = drawn_hands(0, width=480, height=270)
    pose = pose_of(sample)
    picture = draw_overlay(sample.image, pose)
    assert picture.shape == sample.image.shape and picture.dtype == np.uint8
    changed = (picture != sample.image).any(axis=-1)
    near = np.zeros(changed.shape, np.uint8)
    assert pose.masks is not None
    near[pose.masks > 0] = 1
    for joints in sample.joints_px:
        hull = cv2.convexHull(joints.astype(np.float32))
        cv2.fillConvexPoly(near, np.rint(hull).astype(np.int32), (1,))
    near = cv2.dilate(near, np.ones((15, 15), np.uint8))
    labels = changed & (near == 0)
    count, _, stats, _ = cv2.connectedComponentsWithStats(labels.astype(np.uint8))
    blobs = [stats[i] for i in range(1, count)]
    plates = [b for b in blobs if b[cv2.CC_STAT_WIDTH] > 40 and b[cv2.CC_STAT_HEIGHT] > 10]
    assert len(plates) <= 2
    assert labels.sum() == sum(b[cv2.CC_STAT_AREA] for b in plates)
    assert changed.mean() < 0.35


def test_the_input_is_left_as_it_was():
    sample = drawn_hands(1)
    before = sample.image.copy()
    draw_overlay(sample.image, pose_of(sample))
    np.testing.assert_array_equal(sample.image, before)


def test_without_hands_the_picture_stays_the_same():
    sample = drawn_hands(2, present=(False, False))
    absent = HandPose(present=False)
    pose = TwoHandPose(absent, absent, sample.camera, masks=np.zeros(sample.image.shape[:2], np.uint8))
    np.testing.assert_array_equal(draw_overlay(sample.image, pose), sample.image)


def test_the_mask_tints_towards_the_hands_colour():
    image = np.full((270, 480, 3), 100, np.uint8)
    masks = np.zeros((270, 480), np.uint8)
    masks[100:200, 50:150], masks[100:200, 300:400] = 1, 2
    absent = HandPose(present=False)
    picture = draw_overlay(image, TwoHandPose(absent, absent, PinholeCamera.ego3dhands(), masks=masks)).astype(float)
    for side, u in ((LEFT, 100), (RIGHT, 350)):
        shift = picture[150, u] - 100
        towards = np.array(HAND_COLOURS[side]) - 100.0
        assert shift @ towards / np.linalg.norm(shift) / np.linalg.norm(towards) > 0.99
        assert 0.1 < np.linalg.norm(shift) / np.linalg.norm(towards) < 0.4


@pytest.mark.parametrize("where", [(-5.0, -5.0), (500.0, 300.0), (470.0, 5.0)])
def test_hands_at_and_beyond_the_border_are_drawn_with_their_label_inside(where):
    sample = drawn_hands(3, width=480, height=270)
    pose = pose_of(sample)
    assert pose.left.joints_px is not None
    shifted = pose.left.joints_px - pose.left.joints_px[9] + where
    moved = dataclasses.replace(pose, left=dataclasses.replace(pose.left, joints_px=shifted), masks=None)
    alone = dataclasses.replace(moved, right=HandPose(present=False))
    picture = draw_overlay(sample.image, alone)
    bar = distance_to(picture, HAND_COLOURS[LEFT]) < 6
    assert bar.any(axis=1).sum() >= 10, "the label's colour bar is inside the picture"


def test_a_hand_without_range_and_with_unknown_joints_is_drawn_all_the_same():
    sample = drawn_hands(4)
    pose = pose_of(sample)
    assert pose.left.joints_px is not None
    joints = pose.left.joints_px.copy()
    joints[7] = np.nan
    left = dataclasses.replace(pose.left, joints_px=joints, joints_m=None, range_m=None, valid=False)
    picture = draw_overlay(sample.image, dataclasses.replace(pose, left=left))
    assert (picture != sample.image).any()


def test_hands_and_fingers_differ_in_colour_and_hands_stay_apart_without_red_or_green():
    """Brightness falls from thumb to little finger; blue against yellow is what most colour-blind eyes keep."""
    brightness = np.array([0.299, 0.587, 0.114])
    for side in (LEFT, RIGHT):
        values = [np.array(finger_colour(side, finger)) @ brightness for finger in range(5)]
        assert (np.diff(values) < -10).all()
    left, right = (np.array(colour, float) for colour in HAND_COLOURS)
    assert (left[2] - left[:2].mean()) - (right[2] - right[:2].mean()) > 200


@pytest.mark.parametrize("size", [(480, 270), (2400, 1350)])
def test_tinting_some_rows_at_a_time_changes_no_pixel(size, monkeypatch):
    sample = drawn_hands(0, width=size[0], height=size[1])
    pose = pose_of(sample)
    monkeypatch.setattr(overlay, "_ROWS", 10_000)
    whole = draw_overlay(sample.image, pose)
    monkeypatch.setattr(overlay, "_ROWS", 7)
    np.testing.assert_array_equal(draw_overlay(sample.image, pose), whole)


def test_a_telephones_picture_takes_few_bytes_a_pixel():
    """66 of them, or 3.3 GiB for 50 million pixels, when all of it was tinted at once."""
    width, height = 4000, 3000
    masks = np.zeros((height, width), np.uint8)
    masks[500:2500, 500:1800], masks[500:2500, 2200:3500] = 1, 2
    pose = TwoHandPose(
        HandPose(present=False), HandPose(present=False), PinholeCamera.from_fov(60, width, height), masks
    )
    image = np.zeros((height, width, 3), np.uint8)
    tracemalloc.start()
    draw_overlay(image, pose)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20 * width * height
