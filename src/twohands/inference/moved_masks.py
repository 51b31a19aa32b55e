"""Masks of hands that are followed: what was the hand in the last frame, moved as the picture has moved since.

Ours; the paper's networks see every frame alone. A hand's mask goes stale within a frame or two: fingers move, and what
the mask misses is dimmed, what it has too much of is bright. Dense optical flow tells where every pixel around a hand
was (Kroeger et al., Fast Optical Flow using Dense Inverse Search, ECCV 2016; OpenCV's).
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from twohands.geometry.boxes import box_from_points, near_picture, square_crop, warp_image
from twohands.geometry.segmentation import UNCERTAIN
from twohands.inference.expected import joints_of
from twohands.skeleton import LEFT
from twohands.types import TwoHandPose

NO_MASKS: Final = np.zeros((1, 1), np.uint8)
"""Of a picture in which nothing is known to be a hand."""

WINDOW_SIZE: Final = 160
"""Pixels along a side of the window around a hand in which its motion is sought (docs/history/journal.md, *Masks that
move with the picture*)."""
_ROOM: Final = 1.5
"""A side of the window over the longer side of the box of the hand's joints."""
_MOST_CELLS: Final = 960
"""Moved masks have at most so many cells along the longer side of the picture."""


def moved_masks(before: TwoHandPose, image: np.ndarray, expected_px: np.ndarray) -> np.ndarray:
    """What was seen of the hands in the last frame, what is perhaps a hand's included, where it is in this one.

    Args:
        before: the last frame, with its picture.
        image: (H, W, 3) uint8 RGB of this one.
        expected_px: (2, 21, 2) `Expected.joints_px`, where the motion is sought.

    Returns:
        (h, w) uint8 masks of the picture, 0 background, 1 left, 2 right, of large pictures coarser than these; all
        background where nothing was seen.
    """
    if before.crop_masks is None or before.image is None:
        return NO_MASKS
    step = -(-max(before.crop_masks.shape) // _MOST_CELLS)
    known = np.ascontiguousarray(before.crop_masks[::step, ::step])
    masks, cells = np.zeros_like(known), np.diag([*np.divide(known.shape, image.shape[:2])[::-1], 1.0])
    for side, (joints, moved) in enumerate(zip(joints_of(before), expected_px, strict=True)):
        box_px = np.asarray(box_from_points(near_picture(joints, image.shape[1], image.shape[0])))
        if (box_px[2:] > box_px[:2]).any() and np.isfinite(moved).all():
            own = np.zeros(256, np.uint8)
            own[[1 + side, 1 + side + UNCERTAIN]] = 255
            window = square_crop(box_px, size=WINDOW_SIZE, side=LEFT, margin=_ROOM)  # not mirrored
            there = window.copy()
            there[:2, 2] += (moved - joints).mean(axis=0)
            flow = _flow(warp_image(image, there, WINDOW_SIZE), warp_image(before.image, window, WINDOW_SIZE))
            mask = warp_image(cv2.LUT(known, own), cells @ window, WINDOW_SIZE)
            _paste(cv2.remap(mask, *flow, cv2.INTER_LINEAR), cells @ there, masks, 1 + side)
    return masks


def _flow(now: np.ndarray, before: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows (S, S) float32 at which each pixel of a window (S, S, 3) was in that of the last frame."""
    grey, grey_before = (cv2.cvtColor(window, cv2.COLOR_RGB2GRAY) for window in (now, before))
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)  # it has a state, and threads share us
    moved = search.calc(grey, grey_before, np.zeros((*grey.shape, 2), np.float32))
    rows, columns = np.indices(grey.shape, np.float32)
    return columns + moved[..., 0], rows + moved[..., 1]


def _paste(mask: np.ndarray, cells_from_window: np.ndarray, masks: np.ndarray, label: int) -> None:
    """Writes a label where a window's mask (S, S), 0..255, is rather a hand, into masks (h, w), in place."""
    corner, extent = cells_from_window[:2, 2], np.diag(cells_from_window)[:2] * mask.shape
    low, high = np.maximum(np.floor(corner), 0), np.minimum(np.ceil(corner + extent), masks.shape[::-1])
    if (low >= high).any():
        return
    (left, top), (right, bottom) = low.astype(int), high.astype(int)
    covered = masks[top:bottom, left:right]
    shift = np.array([[1, 0, left], [0, 1, top], [0, 0, 1.0]])
    part = warp_image(mask, np.linalg.inv(cells_from_window) @ shift, max(covered.shape))
    covered[part[: bottom - top, : right - left] > 127] = label
