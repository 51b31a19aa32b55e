"""Hand length and focal length from one hand at a taped distance.

A range in the middle of the picture goes with focal length times hand length, so that one known range fixes their
product, even where both are wrong. Towards the picture's edges it goes with the focal length less: hands in several
places, at distances that are known, tell both numbers apart. What they do not tell is shared out by how far either may
be off. Measured in docs/calibration.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from twohands.errors import InputError
from twohands.formats.profiles import IntrinsicsSource, ScaleSource
from twohands.geometry.projection import project_global, range_weights
from twohands.inference.range_sigma import ASSUMED_LENGTH_SPREAD, TYPED_LENGTH_SPREAD
from twohands.types import HandPose, PinholeCamera

FOCAL_SPREAD: Final = 0.2
"""How far a focal length may be off that nobody has measured, standard deviation of its logarithm."""
RANGE_NOISE: Final = 0.03
"""Of one hand's range, as a share: what 68 % of errors lie within on generated pictures of style paper."""
OUTLIER: Final = 0.1
"""From which share on a hand that disagrees with the others does not count more."""
_STEPS: Final = 61


@dataclass(frozen=True, slots=True)
class TapeFit:
    """What taped distances say.

    Attributes:
        hand_length_m: |wrist - middle knuckle|, metres.
        focal_scale: by which the camera's focal lengths are to be multiplied.
        sigma: standard deviation of the hand length, as a share: how far the hands' own ranges may be off.
    """

    hand_length_m: float
    focal_scale: float
    sigma: float


def fit_tape(
    hands: Sequence[HandPose],
    camera: PinholeCamera,
    distances_m: Sequence[float],
    hand_length_m: float,
    *,
    focal_spread: float = 0.0,
    length_spread: float = math.inf,
) -> TapeFit:
    """Hand length, and focal length where that may be wrong, with which ranges are the taped ones.

    What is wrong with all of them alike is shared out between the two by their spreads. Beyond that the focal length
    changes only as far as hands in several places ask for it.

    Args:
        hands: estimates, of one hand each; those that were not placed do not count.
        camera: with which they were estimated.
        distances_m: true distances of their middle knuckles from the lens, metres, as many.
        hand_length_m: with which they were estimated.
        focal_spread: how far the camera's focal length may be off, standard deviation of its logarithm; 0 where it was
            measured.

    Raises:
        InputError: no hand was placed, or a distance is no positive number.
    """
    if bad := [value for value in distances_m if not (math.isfinite(value) and value > 0)]:
        raise InputError(f"the distance must be a positive number of metres, got {bad[0]:g}")
    placed = [(hand, far) for hand, far in zip(hands, distances_m, strict=True) if hand.valid]
    if not placed:
        raise InputError("no hand was found; show one hand at the taped distance")
    true = np.log([far for _, far in placed])
    steps = np.linspace(-3 * focal_spread, 3 * focal_spread, _STEPS) if focal_spread > 0 else np.zeros(1)
    off = np.stack(
        [np.log(ranges([hand for hand, _ in placed], zoomed(camera, math.exp(step)), hand_length_m)) for step in steps]
    )
    off -= true
    usable = np.isfinite(off).all(axis=0)
    if not usable.any():
        raise InputError("the hand's range is not known; show its palm or back to the camera")
    lengths = -np.median(off[:, usable], axis=1)
    left = np.minimum(np.abs(off[:, usable] + lengths[:, None]), OUTLIER) / RANGE_NOISE
    cost = (left**2).sum(axis=1) + (steps / (focal_spread or 1.0)) ** 2 + (lengths / length_spread) ** 2
    best = int(np.argmin(cost))
    own = [hand.range_sigma_m / hand.range_m for hand, _ in placed if hand.range_sigma_m and hand.range_m]
    spread = float(np.median(np.abs(off[best, usable] + lengths[best]))) / math.sqrt(usable.sum())
    sigma = max(spread, float(np.median(own)) if own else RANGE_NOISE)
    return TapeFit(hand_length_m * math.exp(lengths[best]), math.exp(steps[best]), sigma)


def focal_spread(source: IntrinsicsSource) -> float:
    """How far a camera's focal length may be off that is known so."""
    return 0.0 if source in ("file", "board") else FOCAL_SPREAD


def length_spread(source: ScaleSource) -> float:
    """How far a hand length may be off that is known so, before a hand at a taped distance measures it (again)."""
    return {"typed": TYPED_LENGTH_SPREAD, "assumed": ASSUMED_LENGTH_SPREAD}.get(source, math.inf)


def ranges(hands: Sequence[HandPose], camera: PinholeCamera, hand_length_m: float) -> np.ndarray:
    """Distances of middle knuckles as projected, not drawn towards what is usual, nor smoothed.

    Args:
        hands: with joints in pixels and canonical pose.
        camera, hand_length_m: with which they are placed, not necessarily those of the estimates.

    Returns:
        (B,) metres; NaN where a hand cannot be placed.
    """
    nothing = np.full((21, 3), np.nan)
    canonical = np.stack([nothing if hand.canonical is None else hand.canonical for hand in hands])
    pixels = np.stack([nothing[:, :2] if hand.joints_px is None else hand.joints_px for hand in hands])
    scores = np.stack([nothing[:, 0] if hand.joint_scores is None else hand.joint_scores for hand in hands])
    lengths = np.full(len(hands), hand_length_m)
    weights = range_weights(scores)
    return np.asarray(project_global(canonical, pixels, camera, lengths, method="fitted", weights=weights).radius_m)


def zoomed(camera: PinholeCamera, scale: float) -> PinholeCamera:
    """The camera with its focal lengths multiplied."""
    return replace(camera, fx=camera.fx * scale, fy=camera.fy * scale)
