"""From other data sets' numbers to our records: arrays, cameras, samples."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from twohands.errors import DataFormatError, InputError
from twohands.geometry.camera import project
from twohands.plausibility import LARGEST_NUMBER
from twohands.skeleton import N_JOINTS
from twohands.types import HandSample, PinholeCamera

CORNER_FROM_CENTRE: Final = 0.5
"""Added to pixels, and to the principal point, of data sets that count from the first pixel's centre."""


def number_array(values: Any, shape: tuple[int, ...], what: str) -> np.ndarray:
    """Numbers of a file as float64.

    Args:
        values: nested lists or an array.
        shape: the shape it must have.
        what: file and entry, for the message.

    Raises:
        DataFormatError: other shape, or not finite numbers.
    """
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise DataFormatError(f"{what}: expected an array of numbers of shape {shape}") from None
    if array.shape != shape or not np.isfinite(array).all():
        raise DataFormatError(f"{what}: expected finite numbers of shape {shape}, got shape {array.shape}")
    if array.size and (largest := float(np.abs(array).max())) > LARGEST_NUMBER:
        raise DataFormatError(f"{what}: a number of {largest:.3g}; at most {LARGEST_NUMBER:g} can be right")
    return array


def camera_of(
    focal: np.ndarray, principal_point: np.ndarray, size: tuple[int, int], what: str, *, from_centre: bool = True
) -> PinholeCamera:
    """A camera without distortion.

    Args:
        focal: (2,) fx, fy in pixels.
        principal_point: (2,) cx, cy in pixels.
        size: width, height of the image.
        what: file and entry, for the message.
        from_centre: the principal point counts from the first pixel's centre (calibrations) and not from its outer
            corner (renderers).

    Raises:
        DataFormatError: a focal length that is not positive.
    """
    cx, cy = principal_point + (CORNER_FROM_CENTRE if from_centre else 0.0)
    try:
        return PinholeCamera(float(focal[0]), float(focal[1]), float(cx), float(cy), *size)
    except InputError as error:
        raise DataFormatError(f"{what}: {error}") from None


def camera_of_matrix(matrix: Any, size: tuple[int, int], what: str, *, from_centre: bool = True) -> PinholeCamera:
    """As `camera_of`, of a (3, 3) matrix K.

    Raises:
        DataFormatError: not a matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]].
    """
    k = number_array(matrix, (3, 3), what)
    rest = k - [[k[0, 0], 0, k[0, 2]], [0, k[1, 1], k[1, 2]], [0, 0, 1]]
    if np.abs(rest).max() > 1e-6 * abs(k[0, 0]):
        raise DataFormatError(f"{what}: expected K = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got {k.tolist()}")
    return camera_of(k[[0, 1], [0, 1]], k[:2, 2], size, what, from_centre=from_centre)


def single_hand(joints: np.ndarray, side: int) -> np.ndarray:
    """Joints (21, K) of one hand as (2, 21, K), (LEFT, RIGHT), the other hand NaN."""
    both = np.full((2, N_JOINTS, joints.shape[-1]), np.nan)
    both[side] = joints
    return both


def projected_sample(
    image: np.ndarray, camera: PinholeCamera, joints_m: np.ndarray, source: str, present: np.ndarray | None = None
) -> HandSample:
    """A sample of a data set whose 2D labels are the projections of its 3D labels.

    Args:
        image: (H, W, 3) uint8 RGB.
        camera: its intrinsics.
        joints_m: (2, 21, 3) camera frame, metres, NaN where unknown.
        source: identifies the sample.
        present: (2,) bool; by default the hands with any known joint.

    Returns:
        The sample.
    """
    joints_px = np.asarray(project(joints_m, camera))
    valid = np.asarray(np.isfinite(joints_px).all(axis=-1))  # (2, 21)
    return HandSample(
        image=image,
        camera=camera,
        present=np.any(valid, axis=1) if present is None else present,
        joints_px=joints_px,
        joints_m=joints_m,
        valid=valid,
        source=source,
    )
