"""Stages 4 and 5, from 2D keypoints to metres: PoseNet3D, the global solve, and what is most likely after it.

The solve is the paper's (section 4.4) with all joints for one. Two steps after it are ours. Joints are pulled to the
lines of sight on which they are seen. And uncertain ranges are drawn towards what is usual: an estimated range is in
error by a share of itself, and the more, the less certain the 2D joints are; hands are mostly within reach of what they
do and of each other, and of the body whose they are, of which its size tells how far it is. Measured in docs/history/
journal.md, *What is usual, and the other hand* and *As far as the body*.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Final, NamedTuple

import numpy as np

from twohands.errors import CheckpointError
from twohands.geometry.body import Body
from twohands.geometry.camera import unproject
from twohands.geometry.canonical import camera_from_canonical
from twohands.geometry.projection import Method, project_global, pull_to_rays, range_weights
from twohands.geometry.segmentation import HandBoxes
from twohands.inference.decision import PlacementConfig
from twohands.inference.keypoints import Keypoints
from twohands.skeleton import N_JOINTS, PALM
from twohands.types import GlobalPose, HandPose, PinholeCamera

METHOD: Final[Method] = "fitted"
KEY_BONE_NAMES: Final = ("wrist", "little")
LEAST_MISFIT: Final = 0.005
"""Of a palm's joints, in hand lengths: no estimate is better."""
DOUBT: Final = 1.01
"""What the mean score of the most certain joints lacks something of."""


def lift(network: Callable[[np.ndarray], np.ndarray], keypoints: Keypoints) -> np.ndarray:
    """Stage 4, PoseNet3D: heatmaps -> canonical joints (B, 21, 3) of the real, unmirrored hands.

    Raises:
        CheckpointError: the network answers in another shape.
    """
    unmirror = np.array([[-1.0 if crop.mirrored else 1.0, 1.0, 1.0] for crop in keypoints.crops])
    joints = network(np.stack(keypoints.heatmaps))
    if joints.shape != (expected := (len(keypoints.crops), N_JOINTS, 3)):
        raise CheckpointError(f"pose_net_3d: joints of shape {expected} expected, got {joints.shape}; it is damaged")
    return joints.astype(np.float64) * unmirror[:, None, :]


def place(
    config: PlacementConfig,
    canonical: np.ndarray,
    joints_px: np.ndarray,
    joint_scores: np.ndarray,
    camera: PinholeCamera,
    lengths_m: np.ndarray,
) -> GlobalPose:
    """Stage 5: canonical joints (B, 21, 3) and joints in pixels (B, 21, 2) -> metres in camera space.

    A joint that was found so far outside the picture that the lens's model has no line of sight there does not count.

    Args:
        config: how joints count.
        canonical, joints_px, camera: as `project_global`.
        joint_scores: (B, 21) 0..1.
        lengths_m: (B,) |wrist - root| of every hand.
    """
    seen = np.isfinite(unproject(joints_px, camera)).all(axis=-1)  # (B, 21)
    weights = range_weights(
        joint_scores, finger=config.finger_weight, root=config.root_weight, least_score=config.least_score
    )
    weights = np.where(seen, weights, 0.0)
    return project_global(
        canonical, joints_px, camera, lengths_m, method=METHOD, weights=weights, fit_tolerance=config.fit_tolerance
    )


class PlacedHands(NamedTuple):
    """B hands as one pair of pose networks sees them: canonical joints (B, 21, 3), and where `place` puts them."""

    canonical: np.ndarray
    keypoints: Keypoints
    placed: GlobalPose

    def rows(self, chosen: np.ndarray) -> PlacedHands:
        """Some of the hands."""
        placed = GlobalPose(*(np.asarray(getattr(self.placed, one.name))[chosen] for one in fields(GlobalPose)))
        return PlacedHands(self.canonical[chosen], self.keypoints.rows(chosen), placed)

    def scaled(self, shares: np.ndarray) -> PlacedHands:
        """The same hands at so many times their ranges, (B,); as they are where that is NaN."""
        known = np.isfinite(shares)
        if not known.any():
            return self
        radius_m = self.placed.radius_m * np.where(known, shares, 1.0)
        return self._replace(placed=replace(self.placed, radius_m=radius_m))

    def replaced(self, rows: np.ndarray, other: PlacedHands) -> PlacedHands:
        """The same, with other hands in some rows."""
        order = np.arange(len(self.canonical))
        order[rows] = len(order) + np.arange(len(rows))
        names, places = [one.name for one in fields(GlobalPose)], (self.placed, other.placed)
        placed = GlobalPose(*(np.concatenate([getattr(one, name) for one in places])[order] for name in names))
        canonical = np.concatenate([self.canonical, other.canonical])[order]
        return PlacedHands(canonical, self.keypoints.replaced(rows, other.keypoints), placed)


def refine(
    config: PlacementConfig,
    hands: PlacedHands,
    ranged: PlacedHands,
    sigmas: np.ndarray,
    sure: np.ndarray,
    camera: PinholeCamera,
    lengths_m: np.ndarray,
    bodies_m: np.ndarray,
) -> tuple[np.ndarray, GlobalPose, np.ndarray]:
    """The joints pulled to their lines of sight (`pull_to_rays`), and all of it at the likely range
    (`posterior_ranges`).

    Args:
        config: how far.
        hands: whose joints count.
        ranged: the same hands, as those pose networks see them whose ranges count.
        sigmas: (B,) standard deviations of ranges as shares of them, where they are known from before; NaN elsewhere.
        sure: (B,) 0..1, mean scores of the joints that ranges were estimated from, now or before.
        camera, lengths_m: as for `place`.
        bodies_m: as for `posterior_ranges`.

    Returns:
        Canonical joints (B, 21, 3), the hands in metres, and the standard deviations of their ranges (B,) in metres,
        NaN where they are not known.
    """
    scores, canonical = ranged.keypoints.joint_scores, pulled(config, ranged, camera, lengths_m)
    radius_m = posterior_ranges(ranged.placed.radius_m, sure, config, bodies_m)
    misfit = palm_misfit(canonical, ranged.keypoints.joints_px, camera, lengths_m, ranged.placed)
    sigma = range_sigma(scores, misfit, palm_span(canonical), config)
    sigma = np.where(np.isfinite(sigmas), sigmas, sigma)
    placed = replace(hands.placed, radius_m=ranged.placed.radius_m, valid=ranged.placed.valid)
    if hands is not ranged:
        canonical = pulled(config, hands._replace(placed=placed), camera, lengths_m)
    joints_m = camera_from_canonical(canonical, lengths_m, radius_m, placed.theta, placed.phi)
    finite = np.isfinite(joints_m).all(axis=(1, 2))
    found = replace(placed, joints_m=joints_m, radius_m=radius_m, valid=placed.valid & finite)
    return canonical, found, sigma * radius_m


def pulled(config: PlacementConfig, hands: PlacedHands, camera: PinholeCamera, lengths_m: np.ndarray) -> np.ndarray:
    """Canonical joints (B, 21, 3), pulled to the lines of sight on which they are seen; arguments as of `refine`."""
    share = config.ray_share * hands.keypoints.joint_scores
    return pull_to_rays(hands.canonical, hands.keypoints.joints_px, camera, lengths_m, hands.placed, share)


def palm_misfit(
    canonical: np.ndarray, joints_px: np.ndarray, camera: PinholeCamera, lengths_m: np.ndarray, placed: GlobalPose
) -> np.ndarray:
    """How far the palm's joints are seen from where the pose has them, root mean square in hand lengths.

    Args:
        canonical, joints_px, camera, lengths_m: as for `place`.
        placed: the hands as `place` puts them.

    Returns:
        (B,), at least `LEAST_MISFIT`; NaN where a hand has no place or the lens no line of sight.
    """
    palm = list(PALM)
    joints_m = camera_from_canonical(canonical, lengths_m, placed.radius_m, placed.theta, placed.phi)[:, palm]
    off = unproject(joints_px[:, palm], camera)[..., :2] - joints_m[..., :2] / joints_m[..., 2:]
    away = np.asarray(placed.radius_m)[:, None] / lengths_m[:, None]
    rms = np.sqrt(((off**2).sum(axis=-1) * away**2).mean(axis=-1))
    return np.maximum(rms, LEAST_MISFIT)


def palm_span(canonical: np.ndarray) -> np.ndarray:
    """How wide palms (B, 21, 3) are seen: root mean square distance of their joints from their mean, across the line of
    sight, in hand lengths; (B,)."""
    across = canonical[:, list(PALM), :2]
    return np.sqrt(((across - across.mean(axis=1, keepdims=True)) ** 2).sum(axis=-1).mean(axis=-1))


def range_sigma(joint_scores: np.ndarray, misfit: np.ndarray, span: np.ndarray, config: PlacementConfig) -> np.ndarray:
    """How far likely ranges may be off, by how certain the 2D joints are, how well they agree with the pose, and how
    the palm is seen.

    Args:
        joint_scores: (B, 21) 0..1.
        misfit: (B,) of `palm_misfit`.
        span: (B,) of `palm_span`.
        config: how it goes with them; at most what is usual, since no picture tells less.

    Returns:
        (B,) standard deviations as shares of the range; NaN where they are not known.
    """
    if config.range_sigma is None:
        return np.full(len(misfit), np.nan)
    share, score_power, misfit_power, span_power = config.range_sigma
    lack = (DOUBT - joint_scores.mean(axis=-1)) / (DOUBT - config.sigma_score)
    sigma = share * lack**score_power * (misfit / config.sigma_misfit) ** misfit_power
    return np.minimum(sigma * (span / config.sigma_span) ** span_power, config.usual_spread)


def body_ranges(
    body: Body | None, focal_px: float, lengths_m: float | np.ndarray, config: PlacementConfig
) -> np.ndarray:
    """(2,) metres, how far LEFT and RIGHT, of one length or (2,), are by the size of the person's body; NaN without
    one."""
    if body is None or not config.body_weights:
        return np.full(2, np.nan)
    return distances_of(*body.distance_terms(focal_px, lengths_m), config)


def distances_of(terms: np.ndarray, beside: np.ndarray | float, config: PlacementConfig) -> np.ndarray:
    """(B,) metres, by what `Body.distance_terms` gives, terms (B, `BODY_TERMS`), and beside them one number or (B,)."""
    return np.exp(terms @ np.array(config.body_weights) + beside)


def posterior_ranges(
    radius_m: np.ndarray, mean_scores: np.ndarray, config: PlacementConfig, bodies_m: np.ndarray | None = None
) -> np.ndarray:
    """The most likely ranges of the hands of one picture.

    The logarithms of the ranges are taken for normal, of known mean and covariance, and so are the errors of their
    estimates, independent of each other: the result is the mean of what remains possible.

    Args:
        radius_m: (B,) estimated distances of the root joints from the pinhole, metres, of one hand or of both; NaN
            where unknown.
        mean_scores: (B,) 0..1, of the joints.
        config: what is usual, and the errors of estimates: those at other scores than the two given follow as powers.
        bodies_m: (B,) `body_ranges` of these hands, which count instead of what is usual where all of them are known.

    Returns:
        (B,) metres; NaN where it was; the estimates themselves where the config has no `range_errors`.
    """
    if config.range_errors is None:
        return radius_m
    known = np.isfinite(radius_m)
    highest, lower = config.range_errors
    part = (1 - mean_scores[known]) / (1 - config.lower_score)
    error = highest ** (1 - part) * lower**part
    if bodies_m is not None and np.isfinite(bodies_m[known]).all():
        usual, spread, correlation = np.log(bodies_m[known]), config.body_spread, config.body_correlation
    else:
        usual, spread = np.full(len(error), math.log(config.usual_range_m)), config.usual_spread
        correlation = config.correlation
    covariance = spread**2 * np.where(np.eye(len(error)), 1.0, correlation)
    off = np.linalg.solve(covariance + np.diag(error**2), np.log(radius_m[known]) - usual)
    likely = np.array(radius_m, np.float64)
    likely[known] = np.exp(usual + covariance @ off)
    return likely


def hand_poses(
    boxes: HandBoxes,
    keypoints: Keypoints,
    canonical: np.ndarray,
    placed: GlobalPose,
    side_logits: np.ndarray | None = None,
    sigmas_m: np.ndarray | None = None,
) -> tuple[HandPose, HandPose]:
    """Everything known about the hands LEFT and RIGHT of a picture, from batches of those that are there; of their
    sides from (2,) log-odds, of their ranges from (B,) standard deviations in metres."""
    hands = [HandPose(present=False), HandPose(present=False)]
    for i, side in enumerate(keypoints.sides):
        valid = bool(placed.valid[i])
        hands[side] = HandPose(
            present=True,
            score=float(boxes.scores[side]),
            box_px=boxes.boxes_px[side],
            joints_px=keypoints.joints_px[i],
            joint_scores=keypoints.joint_scores[i],
            canonical=canonical[i],
            joints_m=np.asarray(placed.joints_m[i]) if valid else None,
            range_m=float(placed.radius_m[i]) if valid else None,
            theta_deg=_degrees(placed.theta[i]),
            phi_deg=_degrees(placed.phi[i]),
            key_bone=KEY_BONE_NAMES[int(placed.key_bone[i])],
            method=METHOD,
            valid=valid,
            side_logit=None if side_logits is None else float(side_logits[side]),
            pair=keypoints.crops[i].pair,
            range_sigma_m=float(sigmas_m[i]) if valid and sigmas_m is not None and math.isfinite(sigmas_m[i]) else None,
        )
    return hands[0], hands[1]


def _degrees(angle: float) -> float | None:
    """Radians in degrees; None where unknown."""
    return math.degrees(angle) if math.isfinite(angle) else None
