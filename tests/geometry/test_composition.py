"""The picture of one hand as the pose network sees it (paper section 4.2)."""

import numpy as np

from twohands.geometry.boxes import square_crop, warp_image
from twohands.geometry.composition import compose_hand_input
from twohands.skeleton import LEFT, RIGHT

IDENTITY = np.eye(3)
IMAGE = np.arange(4 * 4 * 3, dtype=np.uint8).reshape(4, 4, 3) + 101
MASKS = np.array([[0, 1, 1, 0], [0, 1, 2, 2], [0, 1, 2, 2], [0, 0, 0, 0]], dtype=np.uint8)


def test_by_hand():
    """This hand as it is, the other at half its brightness (rounded down), nothing else."""
    left = compose_hand_input(IMAGE, MASKS, IDENTITY, LEFT, 4)
    assert left.shape == (4, 4, 3) and left.dtype == np.uint8
    np.testing.assert_array_equal(left[0], [[0, 0, 0], [104, 105, 106], [107, 108, 109], [0, 0, 0]])
    np.testing.assert_array_equal(left[1], [[0, 0, 0], [116, 117, 118], [59, 60, 60], [61, 61, 62]])  # 119..124 halved
    np.testing.assert_array_equal(left[3], np.zeros((4, 3)))


def test_the_right_hand_is_mirrored():
    right = compose_hand_input(IMAGE, MASKS, square_crop([0, 0, 4, 4], size=4, side=RIGHT, margin=1.0), RIGHT, 4)
    weight = np.array([0.0, 0.5, 1.0])[MASKS][..., None]
    np.testing.assert_array_equal(right, np.floor(IMAGE * weight)[:, ::-1])


def test_masks_may_be_coarser_than_the_image():
    image = IMAGE.repeat(3, axis=0).repeat(3, axis=1)
    crop = square_crop([2, 1, 9, 10], size=32, side=LEFT)
    fine = compose_hand_input(image, MASKS.repeat(3, axis=0).repeat(3, axis=1), crop, LEFT, 32)
    coarse = compose_hand_input(image, MASKS, crop, LEFT, 32)
    np.testing.assert_array_equal(coarse, fine)
    assert fine.any()


def test_outside_the_image_is_black_and_inputs_stay():
    image, masks = IMAGE.copy(), np.full((4, 4), 1, np.uint8)
    crop = compose_hand_input(image, masks, np.array([[1.0, 0, -2], [0, 1, 0], [0, 0, 1]]), LEFT, 4)
    assert (crop[:, :2] == 0).all()
    np.testing.assert_array_equal(crop[:, 2:], IMAGE[:, :2])
    np.testing.assert_array_equal(image, IMAGE)
    assert (masks == 1).all()


def test_all_of_one_hand_is_the_plain_crop():
    masks = np.full((4, 4), 2, np.uint8)
    crop = square_crop([0, 0, 3, 2], size=16, side=RIGHT)
    np.testing.assert_array_equal(
        compose_hand_input(IMAGE, masks, crop, RIGHT, 16)[6:10, 6:10], warp_image(IMAGE, crop, 16)[6:10, 6:10]
    )


def test_what_is_perhaps_a_hands_is_shown_like_the_hand():
    perhaps = np.where(MASKS > 0, MASKS + 2, 0).astype(np.uint8)
    for side in (LEFT, RIGHT):
        shown, plain = (
            compose_hand_input(IMAGE, masks, IDENTITY, side, 4, background=0.25) for masks in (perhaps, MASKS)
        )
        np.testing.assert_array_equal(shown, plain)


def test_a_dimmed_background_keeps_what_the_mask_missed():
    plain = compose_hand_input(IMAGE, MASKS, IDENTITY, LEFT, 4)
    dimmed = compose_hand_input(IMAGE, MASKS, IDENTITY, LEFT, 4, background=0.25)
    outside = MASKS == 0
    np.testing.assert_array_equal(dimmed[~outside], plain[~outside])
    np.testing.assert_array_equal(dimmed[outside], (IMAGE[outside] * np.float32(0.25)).astype(np.uint8))
    beyond = compose_hand_input(
        IMAGE, MASKS, np.array([[1.0, 0, -100], [0, 1, 0], [0, 0, 1]]), LEFT, 4, background=0.25
    )
    assert not beyond.any()


def test_a_full_background_leaves_the_other_hand_too():
    """The ablation without segmentation: the masks change nothing."""
    crop = compose_hand_input(IMAGE, MASKS, IDENTITY, LEFT, 4, background=1.0)
    np.testing.assert_array_equal(crop, IMAGE)
