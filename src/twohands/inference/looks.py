"""What PoseNet2D sees: crops of hands and what was read from them, kept, chosen and exchanged together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twohands.geometry.boxes import box_in_picture, mirrored_columns
from twohands.types import HandCrop

SMALLEST_BOX_PX = 8.0
"""Where the joints of a hand span less than this of the picture, there is nothing to see."""
MEDIAN_STEPS = 10
"""Steps towards a geometric median. Of seven looks at 463 hands, half of the joints end within 0.01 pixels of it, 99 %
within 0.3; further steps change no error."""
AGREEMENT = 0.04
"""How far, as a share of the hand's longer side, looks see a joint from their median when they are said to agree half.
0.02 to 0.06 are alike (docs/experiments.md, *Where looks agree*)."""


@dataclass(frozen=True, slots=True)
class Look:
    """What PoseNet2D sees in B crops.

    Attributes:
        crops: B of them.
        heatmaps: (B, 21 + cues, M, M).
        joints_px: (B, 21, 2) pixels of the picture.
        joint_scores: (B, 21) 0..1.
        hand_logits: (B,) log-odds that a crop shows a hand of its side.
    """

    crops: list[HandCrop]
    heatmaps: np.ndarray
    joints_px: np.ndarray
    joint_scores: np.ndarray
    hand_logits: np.ndarray

    @property
    def sides(self) -> np.ndarray:
        """(B,) LEFT or RIGHT of every crop."""
        return np.array([crop.side for crop in self.crops], int)

    def rows(self, chosen: Sequence[int] | np.ndarray) -> Look:
        """Some of the crops."""
        rows = np.asarray(chosen, int)
        return Look([self.crops[i] for i in rows], *(values[rows] for values in self._arrays()))

    def replaced(self, rows: np.ndarray, other: Look) -> Look:
        """The same, with another look at some of the crops."""
        order = np.arange(len(self.crops))
        order[rows] = len(order) + np.arange(len(rows))
        return Look.joined([self, other]).rows(order.tolist())

    @staticmethod
    def joined(looks: Sequence[Look]) -> Look:
        """One after the other; at least one."""
        if len(looks) == 1:
            return looks[0]
        arrays = zip(*(look._arrays() for look in looks), strict=True)
        return Look([crop for look in looks for crop in look.crops], *(np.concatenate(parts) for parts in arrays))

    def _arrays(self) -> tuple[np.ndarray, ...]:
        return self.heatmaps, self.joints_px, self.joint_scores, self.hand_logits


def mirror_crop(crop: HandCrop) -> HandCrop:
    """The crop as that of a hand of the other side."""
    from_mirrored = mirrored_columns(crop.image.shape[1])
    image = np.ascontiguousarray(crop.image[:, ::-1])
    return HandCrop(image, crop.image_from_crop @ from_mirrored, 1 - crop.side, mirrored=not crop.mirrored)


def geometric_median(points: np.ndarray) -> np.ndarray:
    """The place with the least sum of distances to the given ones; an outlier among them moves it little.

    Args:
        points: (N, ..., D) places, N >= 1 of each.

    Returns:
        (..., D).

    Source: Weiszfeld's algorithm, from the mean; the mean of places weighted by the inverse of how far each is off.
    """
    median = points.mean(axis=0)
    for _ in range(MEDIAN_STEPS):
        weights = 1 / np.maximum(np.linalg.norm(points - median, axis=-1, keepdims=True), 1e-6)
        median = (weights * points).sum(axis=0) / weights.sum(axis=0)
    return median


def agreement(points_px: np.ndarray, median_px: np.ndarray) -> np.ndarray:
    """How well several looks at a hand agree on where its joints are.

    Args:
        points_px: (N, B, 21, 2) pixels, of N looks.
        median_px: (B, 21, 2) their median.

    Returns:
        (B, 21) 0..1: 1 / (1 + (d / (`AGREEMENT` s))^2), with d the root mean square distance from the median and s the
        longer side of the box of all joints; 1 for a single look.
    """
    squares = ((points_px - median_px) ** 2).sum(axis=-1).mean(axis=0)
    half_px = AGREEMENT * np.maximum(np.ptp(median_px, axis=-2).max(axis=-1, keepdims=True), 1e-6)
    return 1 / (1 + squares / half_px**2)


def joint_boxes(joints_px: np.ndarray, image_size: tuple[int, int], otherwise_px: np.ndarray) -> np.ndarray:
    """Tight boxes of hands' joints within the picture.

    Args:
        joints_px: (B, 21, 2) pixels.
        image_size: (H, W) of the picture.
        otherwise_px: (B, 4) u0, v0, u1, v1 for hands whose joints span less than `SMALLEST_BOX_PX` of the picture.

    Returns:
        (B, 4) u0, v0, u1, v1.
    """
    boxes_px = np.asarray(box_in_picture(joints_px, image_size[1], image_size[0]))
    return np.where(_large(boxes_px)[:, None], boxes_px, otherwise_px)


def in_sight(joints_px: np.ndarray, image_size: tuple[int, int]) -> np.ndarray:
    """(B,) bool: whether the joints (B, 21, 2) of a hand span `SMALLEST_BOX_PX` or more of a picture of size (H, W)."""
    return _large(np.asarray(box_in_picture(joints_px, image_size[1], image_size[0])))


def _large(boxes_px: np.ndarray) -> np.ndarray:
    return (boxes_px[:, 2:] - boxes_px[:, :2]).min(axis=1) >= SMALLEST_BOX_PX
