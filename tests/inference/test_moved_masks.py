"""Masks of followed hands go where the picture goes."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from twohands.inference.moved_masks import moved_masks
from twohands.types import HandPose, PinholeCamera, TwoHandPose

SIZE = (240, 320)
CAMERA = PinholeCamera.from_fov(60, SIZE[1], SIZE[0])
NOTHING = np.full((21, 2), np.nan)


def texture(seed: int, size: tuple[int, int] = SIZE, mean: float = 128.0) -> np.ndarray:
    """A picture (H, W, 3) with something to see everywhere."""
    noise = np.random.default_rng(seed).uniform(-1, 1, (*size, 3)).astype(np.float32)
    return np.clip(cv2.GaussianBlur(noise, (0, 0), 4) * 350 + mean, 0, 255).astype(np.uint8)


SKIN, ROOM = texture(2, mean=170), texture(1, mean=80)


def turned(angle_deg: float, shift: tuple[float, float], about: tuple[float, float]) -> np.ndarray:
    """(2, 3) of a turn about a point and a shift."""
    place = cv2.getRotationMatrix2D(about, angle_deg, 1.0)
    place[:, 2] += shift
    return place


def moved(what: np.ndarray, place: np.ndarray) -> np.ndarray:
    return cv2.warpAffine(what, place, SIZE[::-1], flags=cv2.INTER_NEAREST)


def frame(mask: np.ndarray, surface: np.ndarray) -> np.ndarray:
    """A surface where the mask is, before a background that does not move."""
    return np.where(mask[..., None] > 0, surface, ROOM)


def pose(left_px: np.ndarray, masks: np.ndarray | None, image: np.ndarray, right_px: np.ndarray = NOTHING):
    hands = (HandPose(bool(np.isfinite(px).all()), 0.9, joints_px=px) for px in (left_px, right_px))
    return TwoHandPose(*hands, CAMERA, crop_masks=masks, image=image)


def joints_in(mask: np.ndarray) -> np.ndarray:
    """21 of a mask's pixels, its corners among them."""
    pixels = np.argwhere(mask > 0)[:, ::-1]
    return pixels[np.linspace(0, len(pixels) - 1, 21).astype(int)].astype(float)


def overlap(found: np.ndarray, true: np.ndarray) -> float:
    return ((found > 0) & (true > 0)).sum() / ((found > 0) | (true > 0)).sum()


def a_hand() -> np.ndarray:
    """A palm with two fingers."""
    mask = np.zeros(SIZE, np.uint8)
    mask[100:160, 120:180], mask[60:100, 125:140], mask[60:100, 155:170] = 1, 1, 1
    return mask


@pytest.mark.parametrize(("angle_deg", "shift"), [(0, (0, 0)), (0, (14.0, -9.0)), (12, (0, 0)), (-9, (-8.0, 6.0))])
def test_a_mask_goes_where_its_pixels_go(angle_deg, shift):
    """Also where the hand was expected elsewhere, by some pixels."""
    mask, surface, place = a_hand(), SKIN, turned(angle_deg, shift, (150.0, 110.0))
    joints_px, true = joints_in(mask), moved(mask, place)
    image = frame(true, moved(surface, place))
    known = np.stack([joints_px + shift + [3.0, -2.0], NOTHING])
    found = moved_masks(pose(joints_px, mask, frame(mask, surface)), image, known)
    assert overlap(found, true) > 0.93
    assert set(np.unique(found)) == {0, 1}


def test_fingers_may_move_by_themselves():
    """What no shift or turn of the whole mask would do, which is what was done before."""
    mask, surface = a_hand(), SKIN
    palm, finger = np.zeros_like(mask), np.zeros_like(mask)
    palm[100:], finger[:100, :150] = mask[100:], mask[:100, :150]
    other = mask - palm - finger
    bent = turned(25, (0, 0), (132.0, 100.0))
    image = frame(palm, surface)
    for part in (other, finger):
        place = bent if part is finger else turned(0, (0, 0), (0.0, 0.0))
        image = np.where(moved(part, place)[..., None] > 0, moved(surface, place), image)
    true = np.maximum(palm + other, moved(finger, bent))
    joints_px = joints_in(mask)
    found = moved_masks(pose(joints_px, mask, frame(mask, surface)), image, np.stack([joints_px, NOTHING]))
    assert overlap(mask, true) < 0.88
    assert overlap(found, true) > 0.93


def test_what_is_perhaps_a_hand_goes_along_and_sides_stay():
    masks = np.zeros(SIZE, np.uint8)
    masks[40:100, 40:100], masks[100:110, 40:100], masks[130:190, 200:260] = 1, 3, 2
    left_px, right_px = joints_in(np.isin(masks, [1, 3])), joints_in(masks == 2)
    image = frame(masks, SKIN)
    found = moved_masks(pose(left_px, masks, image, right_px), image, np.stack([left_px, right_px]))
    for side, known in ((1, [1, 3]), (2, [2])):
        assert overlap(found == side, np.isin(masks, known)) > 0.95


@pytest.mark.parametrize("shift_px", [(-150.0, 0.0), (0.0, 140.0), (900.0, 0.0), (1e30, -1e30)])
def test_hands_may_leave_the_picture(shift_px):
    mask, surface = a_hand(), SKIN
    joints_px, true = joints_in(mask), np.zeros_like(mask)
    if max(np.abs(shift_px)) < 900:
        true = moved(mask, turned(0, shift_px, (0.0, 0.0)))
    image = frame(true, moved(surface, turned(0, np.clip(shift_px, -400, 400), (0.0, 0.0))))
    found = moved_masks(pose(joints_px, mask, frame(mask, surface)), image, np.stack([joints_px + shift_px, NOTHING]))
    assert found.shape == SIZE
    assert overlap(found, true) > 0.85 if true.any() else not found.any()


def test_a_joint_far_outside_the_picture_needs_no_more_memory():
    """Cameras of wide angle see joints anywhere."""
    mask = a_hand()
    joints_px = joints_in(mask)
    joints_px[0] = [1e7, -1e7]
    found = moved_masks(pose(joints_px, mask, ROOM), ROOM, np.stack([joints_px, NOTHING]))
    assert found.shape == SIZE and found.max() <= 1


def test_nothing_is_known_without_masks_or_picture():
    mask = a_hand()
    before, known = pose(joints_in(mask), mask, ROOM), np.stack([joints_in(mask), NOTHING])
    assert moved_masks(before, ROOM, known).any()
    assert not moved_masks(before.without_masks(), ROOM, known).any()
    assert not moved_masks(replace(before, crop_masks=None), ROOM, known).any()
    assert not moved_masks(before, ROOM, np.full((2, 21, 2), np.nan)).any()


def test_masks_of_large_pictures_are_coarser():
    image, mask = texture(1, (1080, 1920)), np.zeros((1080, 1920), np.uint8)
    mask[200:400, 200:400] = 1
    found = moved_masks(pose(joints_in(mask), mask, image), image, np.stack([joints_in(mask), NOTHING]))
    assert found.shape == (540, 960)
    assert overlap(found, mask[::2, ::2]) > 0.97
    again = moved_masks(pose(joints_in(mask), found, image), image, np.stack([joints_in(mask), NOTHING]))
    assert again.shape == (540, 960) and overlap(again, mask[::2, ::2]) > 0.97
