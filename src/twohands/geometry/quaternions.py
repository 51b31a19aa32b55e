"""Rotations as quaternions and back. Order (x, y, z, w), w last, as glTF, ROS and Unity have it; numpy only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def quaternions(rotations: Floats) -> Floats:
    """Unit quaternions of rotations, w >= 0 (of a half turn, either sign).

    Args:
        rotations: (..., 3, 3) orthonormal, determinant 1.

    Returns:
        (..., 4) x, y, z, w.

    Source: Bar-Itzhack 2000 in its simplest form: of the four rows that are each a multiple of the quaternion, the
    longest, so that nothing is divided by a small number.
    """
    r = np.asarray(rotations, np.float64)
    xx, yy, zz = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    xy, xz, yz = r[..., 0, 1] + r[..., 1, 0], r[..., 0, 2] + r[..., 2, 0], r[..., 1, 2] + r[..., 2, 1]
    x, y, z = r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]
    rows = np.stack(
        [
            np.stack([1 + xx - yy - zz, xy, xz, x], axis=-1),
            np.stack([xy, 1 - xx + yy - zz, yz, y], axis=-1),
            np.stack([xz, yz, 1 - xx - yy + zz, z], axis=-1),
            np.stack([x, y, z, 1 + xx + yy + zz], axis=-1),
        ],
        axis=-2,
    )  # (..., 4, 4): row i is 4 q_i q
    best = np.argmax(np.stack([rows[..., i, i] for i in range(4)], axis=-1), axis=-1)
    longest: Floats = np.take_along_axis(rows, best[..., None, None], axis=-2)[..., 0, :]
    unit: Floats = longest / np.linalg.norm(longest, axis=-1, keepdims=True)
    return np.where(unit[..., 3:] < 0, -unit, unit)


def rotations(quaternions: Floats) -> Floats:
    """Rotations of quaternions.

    Args:
        quaternions: (..., 4) x, y, z, w, of unit length.

    Returns:
        (..., 3, 3).
    """
    x, y, z, w = np.moveaxis(np.asarray(quaternions, np.float64), -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def without_jumps(quaternions: Floats) -> Floats:
    """The same rotations over time, signs so that neighbours lie within a half turn: safe to interpolate.

    Args:
        quaternions: (F, ..., 4) of unit length.

    Returns:
        (F, ..., 4).
    """
    turned = (quaternions[1:] * quaternions[:-1]).sum(axis=-1) < 0
    sign = np.cumprod(np.where(turned, -1.0, 1.0), axis=0)
    return np.concatenate([quaternions[:1], quaternions[1:] * sign[..., None]])


def between(first: Floats, second: Floats, share: Floats) -> Floats:
    """On the shortest way from one rotation to another at constant speed.

    Args:
        first, second: (..., 4) of unit length.
        share: (...) of the way, 0..1.

    Returns:
        (..., 4) of unit length.
    """
    dot = (first * second).sum(axis=-1)
    second = np.where(dot[..., None] < 0, -second, second)
    angle = np.arccos(np.minimum(np.abs(dot), 1.0))
    near = angle < 1e-6  # there the arc is a line
    sine = np.where(near, 1.0, np.sin(angle))
    one = np.where(near, 1 - share, np.sin((1 - share) * angle) / sine)
    other = np.where(near, share, np.sin(share * angle) / sine)
    mixed = one[..., None] * first + other[..., None] * second
    return mixed / np.linalg.norm(mixed, axis=-1, keepdims=True)
