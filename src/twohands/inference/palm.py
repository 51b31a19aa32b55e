"""Palms in a picture, by a network that has seen them.

Ours. Where PoseNet2D does not know a real hand, it does not know its joints either, and HandCheck looks at it askew.
MediaPipe Hands' palm detector, as published, says where a hand's palm is and where its fingers point; by that the
second pose networks and HandCheck see the hand as they have learnt hands (docs/decision.md, *Palms*).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twohands.geometry.boxes import picture_square, warp_image
from twohands.geometry.palm import PALM_SIZE, Palm, found_palms

PalmDetector = Callable[[np.ndarray], tuple[np.ndarray, ...]]
"""(1, 192, 192, 3) RGB, 0..1 -> points (1, A, 18) and logits (1, A, 1) as `geometry.palm.found_palms` reads them."""


def no_palms() -> tuple[Palm, ...]:
    """Where nobody looks for them."""
    return ()


def seen_palms(network: PalmDetector, image: np.ndarray) -> tuple[Palm, ...]:
    """Palms in a picture (H, W, 3) uint8 RGB, the surest first."""
    place = picture_square((image.shape[0], image.shape[1]), PALM_SIZE)
    crop = warp_image(image, place, PALM_SIZE)
    points, logits = network(crop[None].astype(np.float32) / 255)
    return found_palms(points[0].astype(np.float64), logits[0, :, 0].astype(np.float64), place)
