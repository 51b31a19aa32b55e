"""The picture of one hand as the pose network sees it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twohands.geometry.boxes import warp_image
from twohands.geometry.segmentation import UNCERTAIN
from twohands.types import Array

OTHER_HAND_WEIGHT = 0.5
"""Brightness of the other hand: visible enough to explain what it hides (paper section 4.2)."""


def compose_hand_input(
    image: Array,
    masks: Array,
    image_from_crop: NDArray[np.float64],
    side: int,
    size: int,
    background: float = 0.0,
) -> Array:
    """Crop one hand, black out or dim the background, dim the other hand.

    Args:
        image: (H, W, 3) uint8 RGB.
        masks: (h, w) uint8, 0 background, 1 left, 2 right, 3 perhaps left, 4 perhaps right, over the same view; its
            resolution may differ.
        image_from_crop: (3, 3) from `square_crop` or `perspective_crop`; carries the mirroring.
        side: LEFT or RIGHT, the hand in question.
        size: side of the crop in pixels.
        background: brightness of the background, 0..1. 0 is the paper's. Dimming it instead leaves a finger that the
            mask missed visible, so that one wrong mask does not spoil the stages behind it. The other hand is never
            darker than the background: 1 leaves the crop as it is, the masks unused.

    Returns:
        (size, size, 3) uint8: crop * mask(this hand) + 0.5 * crop * mask(other hand) + `background` * the rest, rounded
        down; black outside the image.

    Source: paper section 4.2 ("reducing the brightness of the secondary hand by a factor of 0.5").
    """
    crop = warp_image(image, image_from_crop, size)
    if background == 1:
        return crop
    mask_per_image = np.array([masks.shape[1] / image.shape[1], masks.shape[0] / image.shape[0], 1.0])
    mask = warp_image(masks, mask_per_image[:, None] * image_from_crop, size, interpolation="nearest")
    weight = np.full(256, background, dtype=np.float32)
    own, other = 1 + side, 2 - side
    weight[[own, own + UNCERTAIN]], weight[[other, other + UNCERTAIN]] = 1.0, max(OTHER_HAND_WEIGHT, background)
    return (crop * weight[mask][..., None]).astype(np.uint8)
