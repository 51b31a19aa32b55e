"""The two angles that turn the camera towards a hand.

Frames: *camera* is OpenCV's (x right, y down, z forward). *Centred* is the camera turned so that its z axis runs
through one chosen point; hands are described there because a hand looks the same wherever it is in the image.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twohands.geometry._arrays import float_arrays
from twohands.types import Array


def centring_angles(point: Array) -> tuple[Array, Array]:
    """Angles of the rotation that brings a point onto the z axis.

    Args:
        point: (..., 3) camera frame, any unit; a ray will do.

    Returns:
        theta, phi: (...) radians. theta = atan2(y, z), about x, in (-pi, pi]; phi = atan2(x, hypot(y, z)), about y
        and measured after the first rotation, in [-pi/2, pi/2].

    Source: docs/conventions.md; the authors' `global_to_canon`. Paper Eq. 3 differs, see `paper_angles`.
    """
    xp, point = float_arrays(point)
    x, y, z = point[..., 0], point[..., 1], point[..., 2]
    return xp.atan2(y, z), xp.atan2(x, xp.hypot(y, z))


def paper_angles(ray: Array) -> tuple[Array, Array]:
    """Angles as the paper prints them: theta = atan2(y, z), phi = atan2(x, z).

    Kept for comparison only. Both are measured in the unrotated camera, although the second rotation happens after
    the first: off the horizontal axis of the image the two do not bring the ray onto the z axis (1.4 degrees off at
    (180, 60) px from the centre of the paper's 480x270 image, 5.9 degrees in its corner).

    Args:
        ray: (..., 3) camera frame, as `camera.unproject` returns it.

    Returns:
        theta, phi: (...) radians.

    Source: paper Eq. 3; table of its errors in docs/paper-map.md, *The printed angle*.
    """
    xp, ray = float_arrays(ray)
    x, y, z = ray[..., 0], ray[..., 1], ray[..., 2]
    return xp.atan2(y, z), xp.atan2(x, z)


def rotation_from_angles(theta: Array, phi: Array) -> Array:
    """Rotation from the camera frame to the centred frame, R = R_y(phi) R_x(theta): theta first, then phi.

    Any other rotation to the centre differs by a roll about the line of sight, so this order is part of the definition
    of a canonical pose. For the angles of `centring_angles(p)`, R @ p = (0, 0, |p|).

    Args:
        theta, phi: (...) radians.

    Returns:
        R_centre_from_cam: (..., 3, 3), orthonormal, determinant 1. Its transpose leads back.

    Source: paper Eq. 1; docs/conventions.md. Written for the axis order (x, y, z); the paper's is (row, column, depth).
    """
    xp, theta, phi = float_arrays(theta, phi)
    theta, phi = xp.broadcast_arrays(theta, phi)
    with np.errstate(invalid="ignore"):  # an infinite angle has no rotation: NaN
        cos_t, sin_t, cos_p, sin_p = xp.cos(theta), xp.sin(theta), xp.cos(phi), xp.sin(phi)
    rows = (
        *(cos_p, -sin_p * sin_t, -sin_p * cos_t),
        *(xp.zeros_like(cos_p), cos_t, -sin_t),
        *(sin_p, cos_p * sin_t, cos_p * cos_t),
    )
    return xp.reshape(xp.stack(rows, axis=-1), (*cos_p.shape, 3, 3))


def rotation_about_z(angle: float) -> NDArray[np.float64]:
    """Rotation about the line of sight, (3, 3): x towards y by `angle` radians."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def rotate(rotation: Array, points: Array) -> Array:
    """Rotate every point of a set: R @ p.

    Args:
        rotation: (..., 3, 3).
        points: (..., N, 3).

    Returns:
        (..., N, 3).
    """
    xp, rotation, points = float_arrays(rotation, points)
    with np.errstate(invalid="ignore"):  # an infinite point has no place after a rotation: NaN
        return xp.matmul(points, xp.matrix_transpose(rotation))
