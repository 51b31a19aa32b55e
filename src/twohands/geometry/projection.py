"""From a canonical pose and its 2D joints to metres: the paper's central claim.

The root's pixel gives the direction (theta, phi). What is missing is its distance r. With the camera turned towards
the root, joint j of a hand of length L lies at (L x_j, L y_j, r + L z_j) and is seen along the slope m_j, so

    m_j (r + L z_j) = L (x_j, y_j)        for every joint j.

The paper solves this for one joint, the far end of the *key bone*; we solve it for all of them together. The root's own
pixel is an estimate like the others', and some joints are found in the wrong place: the fitted solution starts from
there, lets the direction go too and doubts joints that disagree with the rest.
"""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np

from twohands.errors import InputError
from twohands.geometry._arrays import float_arrays
from twohands.geometry.camera import project, unproject
from twohands.geometry.canonical import camera_from_canonical
from twohands.geometry.rotation import centring_angles, paper_angles, rotate, rotation_from_angles
from twohands.skeleton import KEY_BONES, PALM, ROOT, WRIST
from twohands.types import Array, GlobalPose, PinholeCamera

Method = Literal["fitted", "all-joints", "keybone"]
Angles = Literal["exact", "paper"]

_SHORTEST_PX = 1e-6
"""2D distance from the root, in pixels, up to which a joint says nothing about the range (docs/paper-map.md)."""

_SHORTEST_ACROSS = 1e-6
"""The same in 3D: distance from the root across its line of sight, canonical units."""

FINGER_WEIGHT = 0.25
"""Of a finger's joint beside 1 for wrist and knuckles: the palm is nearly rigid, so its joints are known best."""

ROOT_WEIGHT = 4.0
"""Of the root beside the other knuckles; it counts in the fit alone."""

FIT_TOLERANCE = 0.08
"""How far, in hand lengths, a joint is seen from where the pose puts it when the fit counts it half."""

_FIT_STEPS = 3
"""Of the fit. After 12, the ranges of 684 estimated hands are no better."""

_STEADINESS = 1e-9
"""Weight of the present solution in a step of the fit beside all joints: what they do not tell stays as it is."""

LEAST_SCORE = 0.05
"""No joint is ignored altogether: a hand of which nothing is certain still has a range."""


def range_weights(
    joint_scores: Array,
    *,
    finger: float = FINGER_WEIGHT,
    root: float = ROOT_WEIGHT,
    least_score: float = LEAST_SCORE,
) -> Array:
    """Weights with which a hand is placed by its estimated joints: palm before fingers, certain before doubtful.

    Args:
        joint_scores: (..., 21) 0..1, certainty of the 2D joints; NaN where the system says nothing, which counts as 1.
        finger, root: weight of the joints of the fingers beyond the knuckles, and of the root, beside 1 for wrist and
            the other knuckles.
        least_score: what lower scores count as.

    Returns:
        (..., 21) positive, for `project_global`: that weight times score^2.

    Source: ours; measured in docs/paper-map.md, *Weights of the joints*.
    """
    xp, scores = float_arrays(joint_scores)
    joints = xp.arange(scores.shape[-1], device=scores.device)
    palm = xp.any(xp.stack([joints == joint for joint in PALM]), axis=0)
    certain = xp.where(xp.isfinite(scores), xp.where(scores > least_score, scores, least_score), 1.0)
    by_joint = xp.where(joints == ROOT, root, xp.where(palm, 1.0, finger))
    return xp.astype(by_joint, scores.dtype) * certain**2


def project_global(
    canonical: Array,
    joints_px: Array,
    camera: PinholeCamera,
    hand_length_m: Array | float,
    *,
    method: Method = "all-joints",
    angles: Angles = "exact",
    weights: Array | None = None,
    fit_tolerance: float = FIT_TOLERANCE,
) -> GlobalPose:
    """Place a canonical pose in the camera frame, given where its joints are seen.

    Args:
        canonical: (..., 21, 3) unitless, root at 0, centred frame.
        joints_px: (..., 21, 2) pixels of the camera's image, (0, 0) the outer corner of the first pixel.
        camera: intrinsics; its lens distortion is undone.
        hand_length_m: (...) or a number, |wrist - root| in metres, whichever key bone is used.
        method: "all-joints", ours: the r of least squares over all joints. "keybone", the paper's: the r of one joint,
            the wrist if it is seen strictly farther from the root than the little MCP, else the little MCP. "fitted",
            ours: from the former on, the root's place, not its distance alone, with which all joints are seen where
            they should be; the more a joint is off, the less it counts. Exact input gives the same exact answer; noise
            hurts all-joints less, by a third to two thirds, and fitted least (docs/paper-map.md).
        angles: "exact", or "paper" for the printed equation (`rotation.paper_angles`), kept for comparison.
        weights: (..., 21) not negative, not for "keybone"; a joint of weight 0 is ignored and its pixel may be unknown.
            None weighs all joints alike.
        fit_tolerance: how far, in hand lengths, a joint is off when the fit counts it half.

    Returns:
        The pose in metres. `theta` and `phi` are known wherever the root's pixel is, else NaN; those of that pixel but
        for "fitted". Not valid (joints and
        radius NaN): input that is not finite, a hand length not above 0, all used joints seen at the root's pixel or
        lying on its line of sight, the root or a used joint not in front of the centred camera (r <= 0 included).

    Raises:
        InputError: an unknown method or kind of angles, weights for the key bone, or a fit with the paper's angles.

    Source: paper section 4.4 (key bone); docs/paper-map.md, *All joints* and *The fit*.
    """
    if method not in get_args(Method) or angles not in get_args(Angles):
        raise InputError(
            f"expected method fitted, all-joints or keybone and angles exact or paper, got {method!r} and {angles!r}"
        )
    if method == "fitted" and angles != "exact":
        raise InputError("the fit turns the camera exactly towards the root; use angles='exact'")
    if weights is not None and method == "keybone":
        raise InputError("the key bone method uses one joint and takes no weights; use another method")
    given = () if weights is None else (weights,)
    xp, canonical, joints_px, length, *given = float_arrays(canonical, joints_px, hand_length_m, *given)
    with np.errstate(all="ignore"):  # values near the end of the range may overflow; the result is then not valid
        # Unknown values are replaced, not skipped: gradients of the other hands in the batch stay clean.
        pose = _finite_or(xp, canonical, 0.0)
        scale = _finite_or(xp, length, 1.0)[..., None]
        rays_cam = unproject(joints_px, camera)
        known, rays, theta, phi = _centred_rays(xp, rays_cam, angles)
        slopes, _ = _slopes(xp, rays)
        key_bone, key_joint = _key_joint(xp, joints_px)

        if method == "keybone":
            weight = xp.astype(key_joint, canonical.dtype)
            radius = _keybone_radius(xp, slopes, pose, scale, key_joint)
            observed = xp.all(xp.stack([known[..., joint] for joint, _ in KEY_BONES]), axis=0)
        else:
            weight = given[0] if given else xp.ones_like(joints_px[..., 0])
            radius = _least_squares_radius(xp, slopes, pose, scale, xp.where(weight > 0, weight, 0.0))
            observed = xp.all((known | (weight == 0)) & (weight >= 0), axis=-1)
        if method == "fitted":
            start = radius, theta, phi
            radius, theta, phi = _fitted(xp, rays_cam, pose * scale[..., None], scale, weight, start, fit_tolerance)

        used = weight > 0
        across_px = xp.linalg.vector_norm(joints_px - joints_px[..., ROOT : ROOT + 1, :], axis=-1)
        across = xp.linalg.vector_norm(canonical[..., :2], axis=-1)
        before_camera = _before_camera(xp, rays_cam, scale * pose[..., 2], radius, theta, phi)
        joints_m = camera_from_canonical(pose, scale[..., 0], radius, theta, phi)
        valid = (
            xp.all(xp.isfinite(canonical), axis=(-2, -1))
            & (xp.isfinite(length) & (length > 0))
            & (observed & known[..., ROOT])
            & xp.any(used & (across_px > _SHORTEST_PX), axis=-1)
            & xp.any(used & (across > _SHORTEST_ACROSS), axis=-1)
            & ((radius > 0) & xp.all(before_camera | ~used, axis=-1))
            & xp.all(xp.isfinite(joints_m), axis=(-2, -1))
        )
    batch = valid.shape
    return GlobalPose(
        joints_m=xp.where(valid[..., None, None], joints_m, xp.nan),
        radius_m=xp.where(valid, radius, xp.nan),
        theta=xp.broadcast_to(xp.where(known[..., ROOT], theta, xp.nan), batch),
        phi=xp.broadcast_to(xp.where(known[..., ROOT], phi, xp.nan), batch),
        key_bone=xp.broadcast_to(key_bone, batch),
        valid=valid,
    )


def pull_to_rays(
    canonical: Array,
    joints_px: Array,
    camera: PinholeCamera,
    hand_length_m: Array | float,
    place: GlobalPose,
    share: Array | float,
) -> Array:
    """A canonical pose whose joints lie nearer to the lines of sight on which they are seen.

    Ours. The canonical pose is an estimate from one picture of the whole hand; across the line of sight each joint's
    own heatmap knows more. Every joint but the root goes towards the point of its ray at the same distance from the
    camera; the wrist then goes back along its bone to its distance from the root, which is given. An exact pose stays
    as it is; with a share of 1 all of it but root and wrist is seen exactly at `joints_px`.

    Args:
        canonical, joints_px, camera, hand_length_m: as `project_global`.
        place: where it was put by `project_global`; its radius and direction are used.
        share: (..., 21) or a number, of the way to go, 0..1.

    Returns:
        (..., 21, 3) canonical pose with the root at 0, for the same hand length and place; as it was where that or a
        joint's ray is unknown or the ray not in front of the camera turned to the root.
    """
    xp, canonical, joints_px, length, part = float_arrays(canonical, joints_px, hand_length_m, share)
    put = xp.isfinite(place.radius_m + place.theta + place.phi)
    radius, theta, phi = (xp.where(put, value, 1.0) for value in (place.radius_m, place.theta, place.phi))
    rays = unproject(joints_px, camera)
    known = xp.all(xp.isfinite(rays), axis=-1)
    rays = rotate(rotation_from_angles(theta, phi), xp.where(known[..., None], rays, 1.0))
    joint = xp.arange(canonical.shape[-2], device=canonical.device)
    usable = known & (rays[..., 2] > 0) & put[..., None] & (joint != ROOT)
    zero = xp.zeros_like(radius)
    away = xp.stack([zero, zero, radius], axis=-1)[..., None, :] / length[..., None, None]
    placed = canonical + away
    rays = rays / xp.linalg.vector_norm(rays, axis=-1)[..., None]
    with np.errstate(invalid="ignore"):  # an infinite joint goes nowhere: NaN
        on_ray = rays * xp.linalg.vector_norm(placed, axis=-1)[..., None] - away
        drawn = xp.where(usable[..., None], canonical + part[..., None] * (on_ray - canonical), canonical)
        lengths, drawn_lengths = (xp.linalg.vector_norm(pose[..., WRIST, :], axis=-1) for pose in (canonical, drawn))
        back = lengths / xp.where(drawn_lengths > 0, drawn_lengths, 1.0)
        return xp.where((joint == WRIST)[..., None], drawn * back[..., None, None], drawn)


def consistent_joints_px(
    canonical: Array,
    joints_px: Array,
    camera: PinholeCamera,
    hand_length_m: Array | float,
    *,
    weights: Array | None = None,
) -> Array:
    """2D joints that agree with the canonical pose: the pose placed by all joints, seen by the camera.

    The paper replaces the 2D network's joints by these before it computes the range, but needs the range to compute
    them; the least squares over all joints closes the circle. The key bone method on the result returns that range.

    Args:
        canonical, joints_px, camera, hand_length_m, weights: as `project_global`.

    Returns:
        (..., 21, 2) pixels of the camera's image, lens distortion included; NaN where the placement is not valid.

    Source: paper section 4.3 ("we replace p"); docs/paper-map.md, *All joints*.
    """
    pose = project_global(canonical, joints_px, camera, hand_length_m, weights=weights)
    return project(pose.joints_m, camera, distort=True)


def canonical_xy_from_rays(rays: Array, distance: Array, z: Array) -> Array:
    """2D joints brought into the canonical frame, with the depth of each taken as known: the target of L_proj.

    Args:
        rays: (..., 21, 3) through the 2D joints, camera frame, any length (`camera.unproject`).
        distance: (...) or a number, r / L: distance of the root joint in hand lengths.
        z: (..., 21) canonical depth of every joint.

    Returns:
        (..., 21, 2) canonical x and y, m_j (r / L + z_j); for the true 2D joints exactly those of the canonical pose.
        NaN for joints whose ray is unknown or not in front of the centred camera.

    Source: paper Eq. 2 (L_proj). One scale for the whole hand (weak perspective) would be wrong by a
    third: r / L is about 3 and z reaches 1.
    """
    xp, rays, distance, z = float_arrays(rays, distance, z)
    known, rays, _, _ = _centred_rays(xp, rays, "exact")
    slopes, in_front = _slopes(xp, rays)
    xy = slopes * (distance[..., None] + z)[..., None]
    return xp.where((known & in_front & known[..., ROOT : ROOT + 1])[..., None], xy, xp.nan)


def _centred_rays(xp: Any, rays: Array, angles: Angles) -> tuple[Any, Any, Any, Any]:
    """Rays of the joints with the camera turned towards the root.

    Returns:
        known: (..., 21) bool, the ray is finite.
        rays: (..., 21, 3) centred frame, any length; the stand-in of an unknown ray is the camera's axis.
        theta, phi: (...) radians.
    """
    known = xp.all(xp.isfinite(rays), axis=-1)
    axis = xp.stack([xp.zeros_like(rays[..., 0])] * 2 + [xp.ones_like(rays[..., 0])], axis=-1)
    rays = xp.where(known[..., None], rays, axis)
    theta, phi = (centring_angles if angles == "exact" else paper_angles)(rays[..., ROOT, :])
    return known, rotate(rotation_from_angles(theta, phi), rays), theta, phi


def _slopes(xp: Any, rays: Array) -> tuple[Any, Any]:
    """Slopes m = (x / z, y / z) of rays (..., 21, 3), and which point forward at all."""
    in_front = rays[..., 2] > 0
    depth = xp.where(in_front, rays[..., 2], xp.ones_like(rays[..., 2]))
    return rays[..., :2] / depth[..., None], in_front


def _key_joint(xp: Any, joints_px: Array) -> tuple[Any, Any]:
    """Index into KEY_BONES (...) of the bone that is seen longer, and its secondary joint as a mask (..., 21)."""
    (wrist, root), (little, _) = KEY_BONES
    across = xp.linalg.vector_norm(joints_px - joints_px[..., root : root + 1, :], axis=-1)
    is_little = ~(across[..., wrist] > across[..., little])
    joint = xp.arange(joints_px.shape[-2], device=joints_px.device)
    mask = xp.where(is_little[..., None], joint == little, joint == wrist)
    return xp.astype(is_little, xp.int64), mask


def _keybone_radius(xp: Any, slopes: Array, pose: Array, scale: Array, key_joint: Array) -> Any:
    """r = z_3d - L z_s with z_3d = z_2d h_3d / h_2d: similar triangles in the plane of the key bone (paper Eq. 4 to 6).

    A slope is (h_2d / z_2d) long, so dividing by its length is the paper's z_2d / h_2d.
    """
    slope = xp.sum(xp.where(key_joint[..., None], slopes, 0.0), axis=-2)
    joint = xp.sum(xp.where(key_joint[..., None], pose, 0.0), axis=-2) * scale
    slope_length = xp.linalg.vector_norm(slope, axis=-1)
    h_3d = xp.linalg.vector_norm(joint[..., :2], axis=-1)
    return h_3d / xp.where(slope_length > 0, slope_length, 1.0) - joint[..., 2]


def _least_squares_radius(xp: Any, slopes: Array, pose: Array, scale: Array, weight: Array) -> Any:
    """The r that minimises sum_j w_j |m_j (r + L z_j) - L (x_j, y_j)|^2; the root itself has m = 0."""
    joints = pose * scale[..., None]
    along = xp.sum(slopes * (joints[..., :2] - slopes * joints[..., 2:]), axis=-1)  # (..., 21)
    above = xp.sum(weight * along, axis=-1)
    below = xp.sum(weight * xp.sum(slopes * slopes, axis=-1), axis=-1)
    return above / xp.where(below > 0, below, 1.0)


def _fitted(
    xp: Any,
    rays: Array,
    joints: Array,
    scale: Array,
    weight: Array,
    start: tuple[Any, Any, Any],
    fit_tolerance: float,
) -> tuple[Any, Any, Any]:
    """Distance and direction of the root with which all joints are seen where they should be, as nearly as can be.

    Least squares again and again, in the frame of a camera turned to the root as it was before: there, for a root at t,
    m_j (t_z + L z_j) = t_xy + L (x_j, y_j), which is linear in t. Its weights are
    w_j / (1 + (d_j / `fit_tolerance`)^2), where d_j is how far joint j was seen from where it should be, in hand
    lengths at the root's distance. As the slopes m_j are estimates, too, noise in them alone draws the range in: by
    0.2 % at 1 px of 480x270, 4 % at 4 px.

    Args:
        rays: (..., 21, 3) camera frame, not finite where unknown.
        joints: (..., 21, 3) canonical pose in metres.
        scale: (..., 1) hand length L.
        weight: (..., 21) not negative.
        start: radius, theta, phi, each (...).
        fit_tolerance: as `project_global`.

    Returns:
        radius, theta, phi; those of the start where the fit leads nowhere, a joint behind the camera included.
    """
    radius, theta, phi = (_finite_or(xp, value, 0.0) for value in start)
    tolerance = scale[..., 0] * fit_tolerance
    begun = xp.isfinite(start[0]) & (radius > 0) & (tolerance > 0)
    radius, tolerance = (xp.where(begun, value, 1.0) for value in (radius, tolerance))
    known = xp.all(xp.isfinite(rays), axis=-1) & (weight > 0) & begun[..., None]
    rays, weight = xp.where(known[..., None], rays, 1.0), xp.where(known, weight, 0.0)
    for _ in range(_FIT_STEPS):
        to_centre = rotation_from_angles(theta, phi)
        slopes, in_front = _slopes(xp, rotate(to_centre, rays))
        depth = radius[..., None] + joints[..., 2]
        usable = known & in_front & (depth > 0)
        depth = xp.where(usable, depth, 1.0)
        off = (slopes - joints[..., :2] / depth[..., None]) * (radius / tolerance)[..., None, None]
        trust = xp.where(usable, weight / (1 + xp.sum(off * off, axis=-1)) / depth**2, 0.0)
        whole = xp.sum(trust, axis=-1, keepdims=True)
        trust = (trust / xp.where(whole > 0, whole, 1.0))[..., None]  # (..., 21, 1)
        # t_xy = mean(m) t_z + mean(y) with y_j = L (m_j z_j - xy_j), which leaves (m_j - mean(m)) t_z = mean(y) - y_j
        wanted = slopes * joints[..., 2:] - joints[..., :2]
        mean, across = (xp.sum(trust * values, axis=-2, keepdims=True) for values in (slopes, wanted))
        aside = slopes - mean
        above = _STEADINESS * radius - xp.sum(trust * aside * wanted, axis=(-2, -1))
        away = above / (xp.sum(trust * aside * aside, axis=(-2, -1)) + _STEADINESS)
        root = xp.concat([mean * away[..., None, None] + across, away[..., None, None]], axis=-1)
        root = rotate(xp.matrix_transpose(to_centre), root)[..., 0, :]
        theta, phi = centring_angles(root)
        radius = xp.linalg.vector_norm(root, axis=-1)
    before_camera = _before_camera(xp, rays, joints[..., 2], radius, theta, phi)
    found = begun & xp.isfinite(radius + theta + phi) & (radius > 0) & xp.all(before_camera | ~known, axis=-1)
    return tuple(xp.where(found, new, old) for new, old in zip((radius, theta, phi), start, strict=True))


def _before_camera(xp: Any, rays: Array, along: Array, radius: Array, theta: Array, phi: Array) -> Any:
    """Joints (..., 21) that are both seen and placed in front of the camera turned towards the root.

    Args:
        rays: (..., 21, 3) camera frame; one that is unknown points nowhere.
        along: (..., 21) metres beyond the root along its line of sight.
        radius, theta, phi: (...) of the root.
    """
    in_front = rotate(rotation_from_angles(theta, phi), rays)[..., 2] > 0
    return in_front & (radius[..., None] + along > 0)


def _finite_or(xp: Any, values: Array, fallback: float) -> Any:
    return xp.where(xp.isfinite(values), values, fallback)
