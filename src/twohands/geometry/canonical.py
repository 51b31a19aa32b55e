"""The canonical pose: what the 3D network learns, free of place and size.

canonical = (R w - R w_root) / hand_length, where R turns the camera towards the root joint. The root is at the origin,
|wrist - root| = 1, the axes are those of the centred frame (x right, y down, z away from the camera).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from twohands.geometry._arrays import float_arrays
from twohands.geometry.rotation import centring_angles, rotate, rotation_from_angles
from twohands.skeleton import ROOT, WRIST
from twohands.types import Array


@dataclass(frozen=True, slots=True)
class Canonical:
    """A canonical pose and what is needed to leave it again.

    Attributes:
        joints: (..., 21, 3) unitless, centred frame; NaN where not valid.
        hand_length_m: (...) |wrist - root| in metres; NaN where not valid.
        root_cam: (..., 3) root joint, camera frame, metres; NaN where not valid.
        valid: (...) bool.
    """

    joints: Array
    hand_length_m: Array
    root_cam: Array
    valid: Array


def canonical_from_camera(joints_m: Array) -> Canonical:
    """Canonical pose of a hand given in the camera frame.

    Args:
        joints_m: (..., 21, 3) camera frame, metres.

    Returns:
        The canonical pose. Not valid: a hand with a joint that is not finite, or whose root lies in the pinhole or on
        its wrist (so an absent hand, whether written as NaN or as zeros).

    Source: paper Eq. 1; docs/conventions.md.
    """
    xp, joints_m = float_arrays(joints_m)
    finite = xp.all(xp.isfinite(joints_m), axis=(-2, -1))
    root, wrist = joints_m[..., ROOT, :], joints_m[..., WRIST, :]
    valid = finite & xp.any(root != 0, axis=-1) & xp.any(root != wrist, axis=-1)
    # A stand-in keeps hands that are not valid out of the arithmetic, so that gradients of the others stay clean.
    joints_m = xp.where(valid[..., None, None], joints_m, _stand_in(xp, joints_m))
    root = joints_m[..., ROOT, :]
    centred = rotate(rotation_from_angles(*centring_angles(root)), joints_m - root[..., None, :])
    length = xp.linalg.vector_norm(joints_m[..., WRIST, :] - root, axis=-1)
    return Canonical(
        joints=xp.where(valid[..., None, None], centred / length[..., None, None], xp.nan),
        hand_length_m=xp.where(valid, length, xp.nan),
        root_cam=xp.where(valid[..., None], root, xp.nan),
        valid=valid,
    )


def unrolled_canonical(canonical: Array, root_ray: Array, rolled_from_camera: Array) -> Array:
    """A canonical pose for a camera, from that for the same camera rolled about its line of sight.

    The centred frames of the two differ by a roll about the root's ray, which is that of the cameras only for a root on
    the axis.

    Args:
        canonical: (..., 21, 3) as the rolled camera has it.
        root_ray: (..., 3) direction of the root in the camera that is not rolled, any length.
        rolled_from_camera: (3, 3) rotation about z, `rotation.rotation_about_z`.

    Returns:
        (..., 21, 3) as the camera has it.
    """
    xp, canonical, ray, roll = float_arrays(canonical, root_ray, rolled_from_camera)
    centred = rotation_from_angles(*centring_angles(ray))
    rolled = rotation_from_angles(*centring_angles(rotate(roll, ray[..., None, :])[..., 0, :]))
    return rotate(xp.matmul(centred, xp.matrix_transpose(xp.matmul(rolled, roll))), canonical)


def camera_from_canonical(
    canonical: Array, hand_length_m: Array | float, radius_m: Array, theta: Array, phi: Array
) -> Array:
    """Put a canonical pose back into the world: scale, move along z, rotate.

    Args:
        canonical: (..., 21, 3) unitless, root at 0, centred frame.
        hand_length_m: (...) or a number, |wrist - root| in metres.
        radius_m: (...) distance of the root from the pinhole, metres.
        theta, phi: (...) direction of the root, radians (`rotation.centring_angles`).

    Returns:
        joints_m: (..., 21, 3) camera frame, metres; NaN wherever an input is NaN.

    Source: paper section 4.4: w_glob = R^T (L w_can + (0, 0, r)).
    """
    xp, canonical, length, radius, theta, phi = float_arrays(canonical, hand_length_m, radius_m, theta, phi)
    zero = xp.zeros_like(radius)
    away = xp.stack([zero, zero, radius], axis=-1)[..., None, :]
    with np.errstate(invalid="ignore"):  # the root of an infinite hand has no place: NaN
        centred = canonical * length[..., None, None] + away
    return rotate(xp.matrix_transpose(rotation_from_angles(theta, phi)), centred)


def spherical_alignment(canonical: Array, hand_length_m: Array | float, joints_m_gt: Array) -> Array:
    """Place a canonical pose with the true root's distance and direction, to compare it with the truth in metres.

    Args:
        canonical: (..., 21, 3) unitless, root at 0, centred frame.
        hand_length_m: (...) or a number, |wrist - root| in metres.
        joints_m_gt: (..., 21, 3) camera frame, metres; only the root is used.

    Returns:
        joints_m: (..., 21, 3) camera frame, metres; NaN where the true root is unknown or lies in the pinhole.

    Source: paper section 5.1 ("spherical alignment").
    """
    xp, canonical, joints_m_gt = float_arrays(canonical, joints_m_gt)
    root = joints_m_gt[..., ROOT, :]
    known = xp.all(xp.isfinite(root), axis=-1) & xp.any(root != 0, axis=-1)
    root = xp.where(known[..., None], root, xp.ones_like(root))
    radius = xp.linalg.vector_norm(root, axis=-1)
    joints_m = camera_from_canonical(canonical, hand_length_m, radius, *centring_angles(root))
    return xp.where(known[..., None, None], joints_m, xp.nan)


def cartesian_alignment(canonical: Array, hand_length_m: Array | float, joints_m_gt: Array) -> Array:
    """Place a canonical pose by moving its root onto the true root, without rotation: what other methods do.

    Args, Returns: as `spherical_alignment`.

    Source: paper section 5.1 ("Cartesian alignment"). Even a perfect canonical pose keeps an error.
    """
    xp, canonical, length, joints_m_gt = float_arrays(canonical, hand_length_m, joints_m_gt)
    root = joints_m_gt[..., ROOT, :]
    known = xp.all(xp.isfinite(root), axis=-1) & xp.any(root != 0, axis=-1)
    with np.errstate(invalid="ignore"):  # as `camera_from_canonical`
        joints_m = canonical * length[..., None, None] + root[..., None, :]
    return xp.where(known[..., None, None], joints_m, xp.nan)


def _stand_in(xp: Any, like: Array) -> Any:
    """Joints (j + 1, 0, 1): any set with a root away from pinhole and wrist will do."""
    index = xp.cumulative_sum(xp.ones_like(like[..., 0]), axis=-1)
    return xp.stack([index, xp.zeros_like(index), xp.ones_like(index)], axis=-1)
