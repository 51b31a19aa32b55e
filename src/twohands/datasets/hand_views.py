"""Where the hands of a labelled picture are, and the changes that all training pictures share."""

from __future__ import annotations

import numpy as np

from twohands.geometry.boxes import box_from_points
from twohands.geometry.rotation import rotation_about_z
from twohands.types import HandSample

LEAST_INSIDE = 0.2
"""A hand of whose box a change has left less than this in the picture counts as absent."""


def hand_classes(labels: np.ndarray) -> np.ndarray:
    """Part labels 0..14 -> classes 0 background, 1 left, 2 right, same shape, uint8."""
    return ((labels > 0).astype(np.uint8) + (labels > 7)).astype(np.uint8)


def hand_box(sample: HandSample, side: int) -> np.ndarray | None:
    """Tight box of a hand's labelled 2D joints, clipped to the picture.

    Returns:
        (4,) u0, v0, u1, v1 in pixels; None if the hand is absent or less than 2 pixels of it are in the picture.
    """
    boxes, found = boxes_inside(hand_points(sample)[[side]], *sample.image.shape[1::-1])
    return boxes[0] if found[0] else None


def hand_points(sample: HandSample) -> np.ndarray:
    """(2, 21, 2) joints, moved into the picture where they lie outside; NaN where unknown or of an absent hand."""
    height, width = sample.image.shape[:2]
    points = np.asarray(sample.joints_px, np.float64)
    known = np.asarray(sample.valid) & np.asarray(sample.present)[:, None] & np.isfinite(points).all(axis=-1)
    return np.where(known[..., None], np.clip(points, 0, [width, height]), np.nan)


def boxes_inside(points: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Tight boxes of hands (N, K, 2), clipped to the picture, (N, 4), 0 for a hand of which less than 2 pixels or
    `LEAST_INSIDE` of its box are inside; and whether there is one, (N,)."""
    whole = np.asarray(box_from_points(points))
    inside = np.clip(whole, 0, [width, height, width, height])
    sizes, whole_sizes = inside[:, 2:] - inside[:, :2], whole[:, 2:] - whole[:, :2]
    present = (sizes.min(axis=1) >= 2) & (sizes.prod(axis=1) >= LEAST_INSIDE * whole_sizes.prod(axis=1))
    return np.where(present[:, None], inside, 0.0), present


def random_roll(largest_deg: float, rng: np.random.Generator | None) -> np.ndarray:
    """(3, 3) rotation about z, from the frame of a camera to that of the rolled one: in half of all cases none, else by
    at most so many degrees."""
    if rng is None or not largest_deg or rng.random() < 0.5:
        return np.eye(3)
    return rotation_about_z(np.radians(rng.uniform(-largest_deg, largest_deg)))
