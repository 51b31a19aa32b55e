"""Any hand tracker's joints in metres: where they are seen, their shape in any unit, the camera, and one length.

Most trackers tell a hand's shape but not where it is: MediaPipe's "world" joints, the joints of MANO, poses about a
wrist. `lift` brings such a shape into the canonical frame and places it by `projection.project_global`.
"""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np

from twohands.errors import InputError
from twohands.geometry._arrays import float_arrays
from twohands.geometry.camera import unproject
from twohands.geometry.projection import Method, project_global, range_weights
from twohands.geometry.rotation import centring_angles, rotate, rotation_from_angles
from twohands.skeleton import ROOT, WRIST
from twohands.types import Array, GlobalPose, PinholeCamera

View = Literal["centred", "camera"]
"""Whose axes a shape is given in: those of a camera that looks at the hand's root joint, as of networks that see a crop
of the hand; or those of the camera itself, as of a pose that was moved to its wrist."""


def canonical_from_shape(joints_3d: Array, joints_px: Array, camera: PinholeCamera, *, view: View = "centred") -> Array:
    """A shape of any unit and origin as a canonical pose.

    Args:
        joints_3d: (..., 21, 3) any unit, any origin; x right, y down, z away from the camera.
        joints_px: (..., 21, 2) pixels of the camera's image; only the root's is used, and for view "camera" alone.
        camera: intrinsics; its lens distortion is undone.
        view: whose axes the shape has.

    Returns:
        (..., 21, 3) unitless, root at 0, |wrist - root| = 1, centred frame. NaN where wrist and root are the same
        point, and, for view "camera", where the root's line of sight is unknown.

    Raises:
        InputError: another view.
    """
    if view not in get_args(View):
        raise InputError(f"expected view centred or camera, got {view!r}")
    xp, shape, joints_px = float_arrays(joints_3d, joints_px)
    with np.errstate(invalid="ignore"):  # an infinite joint has no place about the root: NaN
        shape = shape - shape[..., ROOT : ROOT + 1, :]
        length = xp.linalg.vector_norm(shape[..., WRIST, :], axis=-1)
        sized = xp.isfinite(length) & (length > 0)
        # Stand-ins, not skipping: gradients of the other hands in the batch stay clean.
        canonical = shape / xp.where(sized, length, 1.0)[..., None, None]
    if view == "camera":
        rays = unproject(joints_px[..., ROOT, :], camera)
        seen = xp.all(xp.isfinite(rays), axis=-1)
        axis = xp.stack([xp.zeros_like(rays[..., 0])] * 2 + [xp.ones_like(rays[..., 0])], axis=-1)
        angles = centring_angles(xp.where(seen[..., None], rays, axis))
        canonical, sized = rotate(rotation_from_angles(*angles), canonical), sized & seen
    return xp.where(sized[..., None, None], canonical, xp.nan)


def lift(
    joints_px: Array,
    joints_3d: Array,
    camera: PinholeCamera,
    hand_length_m: Array | float,
    *,
    view: View = "centred",
    joint_scores: Array | None = None,
    method: Method = "fitted",
) -> GlobalPose:
    """Places hands of any tracker in the camera frame.

    Args:
        joints_px: (..., 21, 2) pixels of the camera's image, (0, 0) the outer corner of the first pixel; joints in the
            order of OpenPose and MediaPipe. Of a joint that was not found NaN; the root (9) is needed.
        joints_3d: (..., 21, 3) the hand's shape in any unit, about any origin; x right, y down, z away from the camera.
            numpy arrays or torch tensors, as `joints_px`.
        camera: intrinsics; its lens distortion is undone.
        hand_length_m: (...) or a number, distance from wrist (0) to middle knuckle (9) in metres, where that tracker
            puts them. Ranges go with it one to one.
        view: "centred" for a shape as seen by a camera that looks at the hand (MediaPipe's world joints, networks that
            see a crop); "camera" for one in the axes of this camera.
        joint_scores: (..., 21) 0..1, certainty of the 2D joints; None counts all alike.
        method: as `project_global`.

    Returns:
        The hands in metres. True pixels and shapes give the true place to 1e-9 m. Not valid, with NaN for joints and
        range: hands whose wrist and root coincide, and those that `project_global` cannot place.

    Raises:
        InputError: another view or method.
    """
    given = () if joint_scores is None else (joint_scores,)
    xp, joints_px, *scores = float_arrays(joints_px, *given)
    canonical = canonical_from_shape(joints_3d, joints_px, camera, view=view)
    if method == "keybone":
        return project_global(canonical, joints_px, camera, hand_length_m, method=method)
    weights: Any = range_weights(scores[0] if scores else xp.full_like(joints_px[..., 0], xp.nan))
    found = xp.all(xp.isfinite(joints_px), axis=-1)
    weights = xp.where(found, weights, 0.0)
    return project_global(canonical, joints_px, camera, hand_length_m, method=method, weights=weights)
