"""What a picture of part labels (`skeleton.part_label`) says of the hands."""

from __future__ import annotations

import numpy as np

from twohands.skeleton import PART_NAMES


def hand_classes(labels: np.ndarray) -> np.ndarray:
    """Whose hand a pixel shows; arms belong to their hand (docs/conventions.md).

    Args:
        labels: (...) uint8 part labels, 0..14.

    Returns:
        The same shape, uint8: 0 background, 1 left, 2 right.
    """
    return ((labels > 0).astype(np.uint8) + (labels > len(PART_NAMES))).astype(np.uint8)


def visible_share(joints_px: np.ndarray, labels: np.ndarray | None, side: int) -> float:
    """Share of a hand's joints at whose pixel the hand itself, or its arm, is seen.

    What lies under the hand's own skin counts as seen; what another hand, a thing or the picture's border hides does
    not.

    Args:
        joints_px: (J, 2) pixels of the picture; NaN where unknown, which counts as hidden.
        labels: (H, W) uint8 part labels, 0..14, or None.
        side: LEFT or RIGHT.

    Returns:
        0..1; NaN without labels.
    """
    if labels is None:
        return float("nan")
    height, width = labels.shape
    with np.errstate(invalid="ignore"):
        inside = ((joints_px >= 0) & (joints_px < [width, height])).all(axis=1)
    pixels = joints_px[inside].astype(np.intp)
    own = hand_classes(labels[pixels[:, 1], pixels[:, 0]]) == 1 + side
    return np.count_nonzero(own) / len(joints_px)
