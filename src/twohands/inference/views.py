"""Further views of hands: as rolled cameras see them, the one with the surest joints, and what all views agree on.

Ours; the paper's networks see a hand once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from twohands.geometry.camera import unproject
from twohands.geometry.canonical import unrolled_canonical
from twohands.geometry.rotation import rotation_about_z
from twohands.inference.keypoints import Keypoints, in_sight, off_upright_deg, rolled_hand_box
from twohands.inference.stages import Stages
from twohands.inference.weights import WeightsCard
from twohands.skeleton import ROOT
from twohands.types import PinholeCamera

MEDIAN_STEPS: Final = 10
"""Steps towards a geometric median. Of seven views of 463 hands, half of the joints end within 0.01 pixels of it, 99 %
within 0.3; further steps change no error."""


@dataclass(frozen=True, slots=True)
class HandViewer:
    """Shows the hands of one picture to the pose networks, as cameras see them that are rolled about their line of
    sight.

    Attributes:
        stages, card: of the estimator.
        image: (H, W, 3).
        masks: (H, W), as `masks_from_logits` gives them.
        camera: of the image.
        alone: whether no clip has shown anything before it.
    """

    stages: Stages
    card: WeightsCard
    image: np.ndarray
    masks: np.ndarray
    camera: PinholeCamera
    alone: bool = True

    def turned(self, keypoints: Keypoints, canonical: np.ndarray) -> tuple[Keypoints, np.ndarray]:
        """Sees doubtful hands again, turned by that one of `ViewConfig.turns_deg` that brings their fingers nearest to
        up, if any does; of both views the one with the surer joints counts.

        The networks know hands best with the fingers up, as the hands of who wears the camera, or is before it, mostly
        are: seen upside down, one whose fingers point down is one of these. Pose networks whose own card has no turns
        see no hand so.

        Args:
            keypoints: of B hands.
            canonical: (B, 21, 3), from these keypoints.

        Returns:
            Keypoints and canonical poses of the views that count.
        """
        views, sureness = self.card.views, _sureness(keypoints)
        turns = [len(self.stages.of_pair(crop.pair).card.views.turns_deg) > 0 for crop in keypoints.crops]
        doubtful = turns & (sureness < views.turn_below_score)
        if not doubtful.any():
            return keypoints, canonical
        turns_deg = nearest_turns(off_upright_deg(keypoints), views.turns_deg)
        rows = np.flatnonzero(doubtful & (turns_deg != 0) & self._in_sight(keypoints))
        if not len(rows):
            return keypoints, canonical
        doubted = keypoints.rows(rows)
        again, again_poses = self._rolled(doubted, doubted.placed_px, turns_deg[rows])
        surer = np.flatnonzero(_sureness(again) > sureness[rows] + views.turn_lead)
        poses = canonical.copy()
        poses[rows[surer]] = again_poses[surer]
        return keypoints.replaced(rows[surer], again.rows(surer)), poses

    def agreed(
        self, keypoints: Keypoints, canonical: np.ndarray, better: Keypoints | None = None
    ) -> tuple[Keypoints, np.ndarray]:
        """Sees every hand again, rolled by `ViewConfig.tta_rolls_deg`; all views count alike.

        What is learnt from rolled hands is not the same for every roll; the errors of such views differ, and now and
        then one takes one finger for another, so that the joints are in the views' median.

        Args:
            keypoints: of B hands, to be kept but for joints and scores.
            canonical: (B, 21, 3), from these keypoints.
            better: the same hands by the pose networks whose joints count, if not these: who say whether there are
                further views, and where these look.

        Returns:
            The keypoints with the geometric median of the joints, scores that are the geometric mean of the joints'
            mean scores and of how well the views agree (`agreement`), and the mean canonical pose. A preset without
            rolls of its own is fitted to scores of single views: they stay.
        """
        joints_px, joint_scores, mean_pose = keypoints.joints_px.copy(), keypoints.joint_scores.copy(), canonical.copy()
        better = keypoints if better is None else better
        pairs, placed_px = better.pairs, better.placed_px
        for pair in np.unique(pairs).tolist():
            if not (rolls_deg := self._rolls_deg(pair)):
                continue
            rows = np.flatnonzero(self._in_sight(better) & (pairs == pair))
            if not len(rows):
                continue
            first = keypoints.rows(rows)
            views = (self._rolled(first, placed_px[rows], degrees) for degrees in rolls_deg)
            seen = [(first, canonical[rows]), *views]
            seen_px = np.array([view.joints_px for view, _ in seen])
            joints_px[rows] = geometric_median(seen_px)
            if self.card.views.tta_rolls_deg:
                agreed = agreement(seen_px, joints_px[rows], self.card.views.agreement_share)
                joint_scores[rows] = np.sqrt(np.mean([view.joint_scores for view, _ in seen], axis=0) * agreed)
            mean_pose[rows] = np.mean([poses for _, poses in seen], axis=0)
        return replace(keypoints, joints_px=joints_px, joint_scores=joint_scores), mean_pose

    def _rolls_deg(self, pair: int) -> tuple[float, ...]:
        """Of all hands those of the preset; where it has none, of a picture alone those of the second pose networks:
        a frame of a clip has the next one."""
        rolls_deg = self.card.views.tta_rolls_deg
        return self.stages.of_pair(pair).card.views.tta_rolls_deg if self.alone and not rolls_deg else rolls_deg

    def _in_sight(self, keypoints: Keypoints) -> np.ndarray:
        return in_sight(keypoints.placed_px, self.image.shape[:2], self.card.views.smallest_box_px)

    def _rolled(
        self, first: Keypoints, placed_px: np.ndarray, further_deg: float | np.ndarray
    ) -> tuple[Keypoints, np.ndarray]:
        """Keypoints of B hands and their canonical poses (B, 21, 3) in the camera of the picture, as cameras see them,
        around points (B, 21, 2), that are rolled so far further, all alike or each by its own (B,), than those that saw
        them first."""
        crops, size = [], (self.image.shape[0], self.image.shape[1])
        further = np.broadcast_to(further_deg, len(first.crops)).tolist()
        for points_px, crop, by_deg in zip(placed_px, first.crops, further, strict=True):
            roll_deg = crop.roll_deg + by_deg
            own = self.stages.of_pair(crop.pair)
            box_px = rolled_hand_box(own.card, points_px, size, self.camera, roll_deg)
            crops.append(own.crop(self.image, self.masks, box_px, crop.side, self.camera, roll_deg))
        again = self.stages.keypoints(crops)
        return again, lifted(self.stages, again, self.camera)


def lifted(stages: Stages, keypoints: Keypoints, camera: PinholeCamera) -> np.ndarray:
    """Canonical poses of B hands in the camera of the picture, however the cameras were rolled that saw them.

    Args:
        stages: of the estimator.
        keypoints: of B hands.
        camera: of the picture.

    Returns:
        (B, 21, 3) unitless.
    """
    canonical = stages.lifted(keypoints)
    if not any(crop.roll_deg for crop in keypoints.crops):
        return canonical
    roots_px = keypoints.joints_px[:, ROOT]
    rays, pinhole = unproject(roots_px, camera), unproject(roots_px, replace(camera, distortion=()))
    rays = np.where(np.isfinite(rays), rays, pinhole)  # a lens has none far outside the picture
    rolls = np.array([rotation_about_z(math.radians(crop.roll_deg)) for crop in keypoints.crops])
    return unrolled_canonical(canonical, rays, rolls)


def nearest_turns(off_deg: np.ndarray, turns_deg: Sequence[float]) -> np.ndarray:
    """(B,) for angles (B,) the nearest of given turns, degrees, where turning is nearer than 0."""
    choices = np.array([0.0, *turns_deg])
    return choices[np.abs((off_deg[:, None] - choices + 180) % 360 - 180).argmin(axis=1)]


def _sureness(keypoints: Keypoints) -> np.ndarray:
    """(B,) mean scores of the joints."""
    return keypoints.joint_scores.mean(axis=-1)


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


def agreement(points_px: np.ndarray, median_px: np.ndarray, half_share: float) -> np.ndarray:
    """How well several views of a hand agree on where its joints are.

    Args:
        points_px: (N, B, 21, 2) pixels, of N views.
        median_px: (B, 21, 2) their median.
        half_share: `ViewConfig.agreement_share`.

    Returns:
        (B, 21) 0..1: 1 / (1 + (d / (`half_share` s))^2), with d the root mean square distance from the median and s the
        longer side of the box of all joints; 1 for a single view.
    """
    squares = ((points_px - median_px) ** 2).sum(axis=-1).mean(axis=0)
    half_px = half_share * np.maximum(np.ptp(median_px, axis=-2).max(axis=-1, keepdims=True), 1e-6)
    return 1 / (1 + squares / half_px**2)
