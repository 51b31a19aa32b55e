"""From what a system says about a hand to everything that can be scored.

Systems differ in what they predict: joints in the camera frame, joints in the picture, or a pose without a place. What
follows from the rest is filled in here by the geometry that everyone may use: the picture's intrinsics and, where a
range must be solved for, the hand length of the protocol.
"""

from __future__ import annotations

from numbers import Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twohands.errors import DataFormatError
from twohands.geometry.boxes import box_from_points
from twohands.geometry.camera import project
from twohands.geometry.canonical import canonical_from_camera
from twohands.geometry.projection import Method, project_global, range_weights
from twohands.plausibility import LARGEST_NUMBER
from twohands.skeleton import N_JOINTS, ROOT, WRIST
from twohands.types import HandPose, HandSample, PinholeCamera

FloatArray = NDArray[np.float64]
ROUNDING = 1e-5
"""By which a score may lie beyond 0 and 1: a sigmoid in float32 ends beyond them, and is taken as 0 or 1."""


def complete_hand(
    camera: PinholeCamera,
    hand_length_m: float,
    *,
    joints_m: ArrayLike | None = None,
    joints_px: ArrayLike | None = None,
    canonical: ArrayLike | None = None,
    box_px: ArrayLike | None = None,
    score: float | None = None,
    method: Method = "fitted",
) -> HandPose:
    """One present hand with everything that follows from what is given.

    Missing 2D joints are the projection of `joints_m`, a missing canonical pose is that of `joints_m`, missing
    `joints_m` are solved from 2D joints and canonical pose, a missing box is the tight one of the 2D joints.

    Args:
        camera: intrinsics of the picture.
        hand_length_m: |wrist - root| with which a range is solved.
        joints_m: (21, 3) camera frame, metres.
        joints_px: (21, 2) pixels, (0, 0) the outer corner of the first pixel.
        canonical: (21, 3) root at 0, centred frame, in any unit: it is scaled to |wrist - root| = 1.
        box_px: (4,) u0, v0, u1, v1 pixels.
        score: 0..1.
        method: how a range is solved (`geometry.projection.project_global`).

    Returns:
        The hand; not valid where nothing tells its place in the camera frame.

    Raises:
        DataFormatError: an array has another shape, is not finite or of absurd size, a box's corners are exchanged, the
            score is no number from 0 to 1, or nothing is given at all.
    """
    if score is not None:
        if isinstance(score, bool) or not isinstance(score, Real) or not -ROUNDING <= score <= 1 + ROUNDING:
            raise DataFormatError(f"score: a number from 0 to 1 expected, got {score!r}")
        score = min(max(float(score), 0.0), 1.0)
    space = None if joints_m is None else _array("joints_m", joints_m, (N_JOINTS, 3))
    pixels = None if joints_px is None else _array("joints_px", joints_px, (N_JOINTS, 2))
    pose = None if canonical is None else unit_pose(_array("canonical", canonical, (N_JOINTS, 3)))
    box = None if box_px is None else _array("box_px", box_px, (4,))
    if box is not None and (box[:2] > box[2:]).any():
        raise DataFormatError(f"box_px: u0 <= u1 and v0 <= v1 expected, got {box.tolist()}")
    if space is None and pixels is None and pose is None and box is None:
        raise DataFormatError("a present hand needs at least one of joints_m, joints_px, canonical and box_px")
    if space is not None:
        with np.errstate(all="ignore"):  # of joints next to the pinhole, a wrist next to the root
            projected = np.asarray(project(space, camera, distort=True))
            own = canonical_from_camera(space)
        if pixels is None:
            pixels = projected if np.isfinite(projected).all() else None  # behind the camera: not in the picture
        if pose is None:
            pose = np.asarray(own.joints) if np.isfinite(own.joints).all() else None
    elif pixels is not None and pose is not None:
        weights = None if method == "keybone" else range_weights(np.ones(N_JOINTS))
        solved = project_global(pose, pixels, camera, hand_length_m, method=method, weights=weights)
        space = np.asarray(solved.joints_m) if bool(solved.valid) else None
    if box is None and pixels is not None:
        box = np.asarray(box_from_points(pixels))
    return HandPose(
        present=True,
        score=score,
        box_px=box,
        joints_px=pixels,
        canonical=pose,
        joints_m=space,
        range_m=None if space is None else float(np.linalg.norm(space[ROOT])),
        valid=space is not None,
    )


def hand_lengths_m(sample: HandSample, fallback: float = 0.10) -> FloatArray:
    """(2,) |wrist - root| of a sample's labelled hands in metres, what the paper takes as known.

    A hand without these labels has the other one's length; where there is neither, it is the fallback. The default is
    the length to which the paper scales its data.
    """
    lengths = np.linalg.norm(sample.joints_m[:, WRIST] - sample.joints_m[:, ROOT], axis=-1)
    known = np.isfinite(lengths) & (lengths > 0) & sample.present
    rest = float(lengths[known].mean()) if known.any() else fallback
    return np.where(known, lengths, rest)


def unit_pose(joints: FloatArray) -> FloatArray:
    """A pose (21, 3) of any unit and origin as canonical: root at 0, |wrist - root| = 1.

    Raises:
        DataFormatError: wrist and root are the same point.
    """
    length = np.linalg.norm(joints[WRIST] - joints[ROOT])
    with np.errstate(all="ignore"):
        unit = (joints - joints[ROOT]) / length
    if not np.isfinite(unit).all():
        raise DataFormatError("canonical: wrist and root joint are the same point, so it has no scale")
    return unit


def _array(name: str, values: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    try:
        array = np.asarray(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise DataFormatError(f"{name}: numbers of shape {shape} expected") from None
    if array.shape != shape:
        raise DataFormatError(f"{name}: shape {shape} expected, got {array.shape}")
    if not np.isfinite(array).all():
        raise DataFormatError(f"{name}: {int((~np.isfinite(array)).sum())} of {array.size} numbers are not finite")
    if (largest := float(np.abs(array).max())) > LARGEST_NUMBER:
        raise DataFormatError(f"{name}: a number of {largest:.3g}; at most {LARGEST_NUMBER:g} can be one of a hand")
    return array
