"""Pixels and rays of one pinhole camera, with OpenCV's lens distortion."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twohands.geometry._arrays import float_arrays
from twohands.types import Array, PinholeCamera

_NEWTON_STEPS = 12
"""Enough for machine precision wherever the lens model can be inverted; the number is fixed so that gradients exist."""
_FOLD_CHECKS = 8
"""Points between axis and ray at which a fold of the lens model is looked for."""


def unproject(points_px: Array, camera: PinholeCamera) -> Array:
    """Rays through pixels.

    Args:
        points_px: (..., 2) pixels (u, v), (0, 0) the outer corner of the first pixel; NaN stays NaN.
        camera: intrinsics; its lens distortion is undone.

    Returns:
        (..., 3) camera frame, scaled to z = 1. NaN where the lens model maps no ray to that pixel.

    Source: x = (u - cx) / fx, y = (v - cy) / fy; the paper has one focal length and a centred principal point.
    """
    xp, points_px = float_arrays(points_px)
    x = (points_px[..., 0] - camera.cx) / camera.fx
    y = (points_px[..., 1] - camera.cy) / camera.fy
    if any(camera.distortion):
        with np.errstate(all="ignore"):  # outside the lens model the iteration may run away; the answer is then NaN
            x, y = _undistort(xp, x, y, camera.distortion)
    return xp.stack([x, y, xp.ones_like(x)], axis=-1)


def intrinsic_matrix(camera: PinholeCamera) -> NDArray[np.float64]:
    """K (3, 3), from a ray (x, y, 1) to a pixel (u, v, 1); lens distortion is no part of it."""
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], dtype=np.float64)


def project(points_cam: Array, camera: PinholeCamera, *, distort: bool = False) -> Array:
    """Pixels of points in the camera frame.

    Args:
        points_cam: (..., 3) camera frame, any unit.
        camera: intrinsics.
        distort: apply the camera's lens distortion, so that the pixels fit the image as it was taken.

    Returns:
        (..., 2) pixels, not clipped to the image. NaN for points not in front of the camera (z <= 0).
    """
    xp, points_cam = float_arrays(points_cam)
    in_front = xp.isfinite(points_cam[..., 2]) & (points_cam[..., 2] > 0)
    depth = xp.where(in_front, points_cam[..., 2], xp.ones_like(points_cam[..., 2]))
    xy = xp.where(in_front[..., None], points_cam[..., :2] / depth[..., None], xp.nan)
    x, y = xy[..., 0], xy[..., 1]
    if distort and any(camera.distortion):
        with np.errstate(all="ignore"):  # points far outside the field of view may overflow
            x, y, _, _, _ = _distort(x, y, camera.distortion)
    return xp.stack([x * camera.fx + camera.cx, y * camera.fy + camera.cy], axis=-1)


def _distort(x: Array, y: Array, coefficients: tuple[float, ...]) -> tuple[Any, ...]:
    """OpenCV's lens model on normalised coordinates, and its symmetric Jacobian.

    Returns:
        distorted x, distorted y, d(xd)/dx, d(xd)/dy = d(yd)/dx, d(yd)/dy.

    Source: OpenCV documentation of `projectPoints`, coefficients (k1, k2, p1, p2[, k3[, k4, k5, k6]]).
    """
    k1, k2, p1, p2, k3, k4, k5, k6 = (*coefficients, *(0.0,) * (8 - len(coefficients)))
    r2 = x * x + y * y
    above = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = above / below
    slope = (k1 + r2 * (2 * k2 + r2 * 3 * k3) - radial * (k4 + r2 * (2 * k5 + r2 * 3 * k6))) / below  # d radial / d r2
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    xx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    xy = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    yy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    return xd, yd, xx, xy, yy


def _undistort(xp: Any, xd: Array, yd: Array, coefficients: tuple[float, ...]) -> tuple[Any, Any]:
    """Inverse of `_distort` by Newton's method from the distorted point.

    OpenCV's own inverse is a fixed-point iteration that stops early and has no gradient. NaN where the iteration does
    not arrive, or arrives beyond a radius at which the lens model folds back.
    """
    finite = xp.isfinite(xd) & xp.isfinite(yd)
    xd, yd = xp.where(finite, xd, 0.0), xp.where(finite, yd, 0.0)  # NaN in the iteration would spoil gradients
    x, y = xd, yd
    for _ in range(_NEWTON_STEPS):
        now_x, now_y, xx, xy, yy = _distort(x, y, coefficients)
        determinant = xx * yy - xy * xy
        determinant = xp.where(xp.abs(determinant) > 1e-12, determinant, 1.0)
        error_x, error_y = now_x - xd, now_y - yd
        x = x - (yy * error_x - xy * error_y) / determinant
        y = y - (xx * error_y - xy * error_x) / determinant
    now_x, now_y, *_ = _distort(x, y, coefficients)
    tolerance = 1e3 * xp.finfo(xd.dtype).eps * (1 + xp.abs(xd) + xp.abs(yd))
    arrived = finite & (xp.abs(now_x - xd) + xp.abs(now_y - yd) < tolerance)
    for step in range(1, _FOLD_CHECKS + 1):  # all the way out, the model must have grown outwards
        _, _, xx, xy, yy = _distort(x * (step / _FOLD_CHECKS), y * (step / _FOLD_CHECKS), coefficients)
        arrived = arrived & (xx * yy - xy * xy > 0) & (xx + yy > 0)
    return xp.where(arrived, x, xp.nan), xp.where(arrived, y, xp.nan)
