"""Boxes, and the square pictures of one hand cut around them.

A crop is described by one matrix, `image_from_crop`: crop pixels to image pixels, mirroring included. The networks see
every hand as a left hand, so the crop of a right hand is mirrored, and taking a joint out of the crop and un-mirroring
it is one multiplication.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from twohands.errors import InputError
from twohands.geometry._arrays import float_arrays
from twohands.geometry.camera import intrinsic_matrix, unproject
from twohands.geometry.rotation import centring_angles, rotation_about_z, rotation_from_angles
from twohands.skeleton import LEFT, RIGHT, ROOT, WRIST
from twohands.types import Array, PinholeCamera

_LEAST_DEPTH: Final = 0.1
"""Of what is estimated in a crop of a wide camera nothing lies nearer to the plane of the pinhole than this share of
the distance from it to the crop's centre: beyond that plane there are no pixels."""


_TOUCHING: Final = 0.01
"""A box that ends this near an edge, as a share of the picture's longer side, touches it: about a cell of HandSegNet's
masks."""
_CONTINUED: Final = 0.2
"""How far such a box is continued there, as a share of its longer side (docs/history/journal.md, *Hands that leave the
picture*)."""
_NEAR: Final = 0.6
"""Distance from a box's middle, in its longer sides, at which what lies there counts 1/e."""


def box_from_points(points_px: Array, valid: Array | None = None) -> Array:
    """Tight box around points.

    Args:
        points_px: (..., N, 2) pixels; points that are not finite are left out.
        valid: (..., N) bool, which points count; None for all.

    Returns:
        (..., 4) u0, v0, u1, v1 in pixels; NaN where no point is left.
    """
    xp, points = float_arrays(points_px)
    if valid is None:
        box = xp.concat([xp.min(points, axis=-2), xp.max(points, axis=-2)], axis=-1)
        if xp.all(xp.isfinite(box)):  # all points are: nothing is left out
            return box
    counted = xp.all(xp.isfinite(points), axis=-1)
    if valid is not None:
        counted = counted & xp.astype(valid, xp.bool)
    low = xp.min(xp.where(counted[..., None], points, xp.inf), axis=-2)
    high = xp.max(xp.where(counted[..., None], points, -xp.inf), axis=-2)
    return xp.where(xp.any(counted, axis=-1)[..., None], xp.concat([low, high], axis=-1), xp.nan)


def box_in_picture(points_px: Array, width: int, height: int) -> Array:
    """Tight box around points, cut to the picture: of hands that reach beyond its edge, what can be seen.

    Args:
        points_px: (..., N, 2) pixels; points that are not finite are left out.
        width, height: of the picture.

    Returns:
        (..., 4) u0, v0, u1, v1 in pixels, 0..width and 0..height; NaN where no point is left.
    """
    xp, box = float_arrays(box_from_points(points_px))
    corner = xp.asarray([width, height, width, height], dtype=box.dtype, device=box.device)
    return xp.minimum(xp.maximum(box, xp.zeros_like(corner)), corner)


def continued_box(box_px: NDArray[np.float64], width: int, height: int) -> NDArray[np.float64]:
    """The box of what a picture shows of a hand, continued beyond the edges that it touches: there may be more of it.

    Args:
        box_px: (4,) u0, v0, u1, v1 in pixels.
        width, height: of the picture.

    Returns:
        (4,) moved out at those edges by `_CONTINUED` of its longer side; the same box if it touches none.
    """
    low, high = box_px[:2], box_px[2:]
    picture = np.array([width, height], np.float64)
    touched = np.stack([np.abs(low), np.abs(high - picture)]) <= _TOUCHING * picture.max()  # [which end, axis]
    before, behind = touched * (_CONTINUED * (high - low).max())
    return np.concatenate([low - before, high + behind])


def near_picture(points_px: NDArray[np.float64], width: int, height: int) -> NDArray[np.float64]:
    """Points of hands, moved towards the picture where they lie farther beyond its edge than the part in the picture is
    long: of a hand of which so little can be seen nobody can tell where it ends.

    Args:
        points_px: (..., N, 2) pixels.
        width, height: of the picture.

    Returns:
        (..., N, 2) pixels; NaN where a point is, and for all points of a hand none of which is finite.
    """
    box = np.asarray(box_in_picture(points_px, width, height))
    reach = (box[..., 2:] - box[..., :2]).max(axis=-1)[..., None, None]
    return np.minimum(np.maximum(points_px, -reach), np.array([width, height]) + reach)


def inside_picture(points_px: NDArray[Any], width: int, height: int) -> NDArray[np.bool_]:
    """(..., 2) points -> (...) bool, within [0, width) x [0, height); NaN is outside."""
    return np.asarray(((points_px >= 0) & (points_px < [width, height])).all(axis=-1))


def box_iou(a: Array, b: Array) -> Array:
    """Intersection over union.

    Args:
        a, b: (..., 4) u0, v0, u1, v1.

    Returns:
        (...) 0..1; 0 if both are empty, NaN if one is unknown.
    """
    xp, a, b = float_arrays(a, b)
    overlap = xp.minimum(a[..., 2:], b[..., 2:]) - xp.maximum(a[..., :2], b[..., :2])
    common = xp.prod(xp.clip(overlap, 0.0, None), axis=-1)
    union = xp.prod(a[..., 2:] - a[..., :2], axis=-1) + xp.prod(b[..., 2:] - b[..., :2], axis=-1) - common
    return common / xp.where(union == 0, xp.ones_like(union), union)


def square_crop(box_px: Array, *, size: int, side: int, margin: float = 1.5) -> NDArray[np.float64]:
    """The paper's crop: an upright square around the box, scaled to `size`.

    Args:
        box_px: (4,) u0, v0, u1, v1 in pixels.
        size: side of the crop in its own pixels.
        side: LEFT, or RIGHT for a mirrored crop.
        margin: side of the square over the larger side of the box.

    Returns:
        image_from_crop: (3, 3).

    Raises:
        InputError: the box is not finite or has no extent.

    Source: paper section 4.2; it is silent on shape and margin.
    """
    u0, v0, u1, v1 = _checked_box(box_px)
    scale = margin * max(u1 - u0, v1 - v0) / size
    centre_u, centre_v = (u0 + u1) / 2, (v0 + v1) / 2
    image_from_square = np.array(
        [[scale, 0, centre_u - scale * size / 2], [0, scale, centre_v - scale * size / 2], [0, 0, 1]], dtype=np.float64
    )
    return image_from_square @ _mirror(side, size)


def picture_square(image_size: tuple[int, int], size: int) -> NDArray[np.float64]:
    """image_from_crop (3, 3) of the square of `size` pixels a side in which a picture of size (H, W) fits."""
    height, width = image_size
    return square_crop(np.array([0.0, 0.0, width, height]), size=size, side=LEFT, margin=1.0)


def perspective_crop(
    box_px: Array, camera: PinholeCamera, *, size: int, side: int, margin: float = 1.5
) -> NDArray[np.float64]:
    """Our crop: what a camera at the same place would see if it looked at the centre of the box.

    Off the axis of a wide camera a hand is stretched; the canonical pose is not. This crop undoes the stretch: it is
    K R^T K_crop^-1 with R the rotation that centres the box and K_crop a camera with square pixels.

    Args:
        box_px: (4,) u0, v0, u1, v1 in pixels.
        camera: intrinsics; lens distortion is ignored, a homography cannot hold it.
        size: side of the crop in its own pixels.
        side: LEFT, or RIGHT for a mirrored crop.
        margin: side of the crop over the smallest centred square that holds the whole box.

    Returns:
        image_from_crop: (3, 3).

    Raises:
        InputError: the box is not finite, has no extent, or reaches 90 degrees away from its own centre.

    Source: ours; docs/paper-map.md, *Perspective crop*.
    """
    box = _checked_box(box_px)
    intrinsics = intrinsic_matrix(camera)
    rays = _box_rays(box, camera)
    rotation = rotation_from_angles(*centring_angles(rays[0]))
    corners = rays[1:] @ rotation.T  # (4, 3) centred frame
    if corners[:, 2].min() <= 0:
        raise InputError(f"box {box} spans more than the half space before the camera; check the camera")
    extent = 2 * np.abs(corners[:, :2] / corners[:, 2:]).max()
    focal = size / (margin * extent)
    crop_intrinsics = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]], dtype=np.float64)
    return intrinsics @ rotation.T @ np.linalg.inv(crop_intrinsics) @ _mirror(side, size)


def box_before_camera(box_px: Array, camera: PinholeCamera) -> NDArray[np.float64]:
    """An estimated box of which there is a `perspective_crop`.

    Args:
        box_px: (4,) u0, v0, u1, v1 in pixels.
        camera: intrinsics; lens distortion is ignored.

    Returns:
        (4,) the same box; one with a corner nearly 90 degrees or more away from its centre is shrunk about the centre.

    Raises:
        InputError: the box is not finite or has no extent.
    """
    u0, v0, u1, v1 = box = _checked_box(box_px)
    rays = _box_rays(box, camera)
    nearest = (rays[1:] @ rays[0]).min() / (rays[0] @ rays[0])  # a corner's depth; linear in how far out it is
    if nearest >= _LEAST_DEPTH:
        return np.array(box)
    share = (1 - _LEAST_DEPTH) / (1 - nearest)
    middle, half = np.array([u0 + u1, v0 + v1]) / 2, np.array([u1 - u0, v1 - v0]) / 2
    return np.concatenate([middle - share * half, middle + share * half])


def image_from_rolled(camera: PinholeCamera, rolled_from_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """Homography (3, 3) from the pixels of a camera that is rolled about its line of sight to those of the same camera
    upright.

    Args:
        camera: intrinsics of both; lens distortion is ignored.
        rolled_from_camera: (3, 3), `rotation.rotation_about_z`.
    """
    intrinsics = intrinsic_matrix(camera)
    return intrinsics @ np.transpose(rolled_from_camera) @ np.linalg.inv(intrinsics)


def upright_roll_deg(joints_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far a camera is to be rolled about its line of sight to see a hand with its fingers up.

    Args:
        joints_px: (..., 21, 2) pixels.

    Returns:
        (...,) degrees, -180..180, for `rotation.rotation_about_z`: then the middle finger's knuckle is above the wrist.
    """
    return roll_up_deg(joints_px[..., ROOT, :] - joints_px[..., WRIST, :])


def roll_up_deg(along_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """(...,) how far a camera is to be rolled to see directions (..., 2) of its picture point up, as
    `upright_roll_deg`."""
    degrees = -90 - np.degrees(np.arctan2(along_px[..., 1], along_px[..., 0]))
    return (degrees + 180) % 360 - 180


def upright_crop(joints_px: NDArray[np.float64], *, size: int, margin: float) -> NDArray[np.float64]:
    """A square around a hand, turned so that the fingers point up (`upright_roll_deg`).

    Args:
        joints_px: (21, 2) pixels.
        size: side of the crop in its own pixels.
        margin: side of the square over the larger side of the hand's box in it.

    Returns:
        image_from_crop: (3, 3), for pixels that are not mirrored; of joints that are all in one place, one that shows
        the pixel there.
    """
    along_px = joints_px[ROOT] - joints_px[WRIST]
    upright = joints_px @ _image_from_upright(along_px)
    low, high = upright.min(axis=0), upright.max(axis=0)
    middle_px = _image_from_upright(along_px) @ ((low + high) / 2)
    return upright_square(middle_px, along_px, margin * max(float((high - low).max()), 1.0), size)


def upright_square(
    middle_px: NDArray[np.float64], along_px: NDArray[np.float64], side_px: float, size: int
) -> NDArray[np.float64]:
    """image_from_crop (3, 3) of a square crop of `size` pixels a side, `side_px` of the picture, around a middle (2,),
    turned so that a direction (2,) of the picture points up."""
    image_from_upright, scale = _image_from_upright(along_px), side_px / size
    corner = middle_px - image_from_upright @ np.full(2, side_px / 2)
    return np.vstack([np.column_stack([scale * image_from_upright, corner]), [0.0, 0.0, 1.0]])


def _image_from_upright(along_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2, 2) turn of a picture in which a direction (2,) points up back to where it points."""
    return rotation_about_z(math.radians(-float(roll_up_deg(along_px))))[:2, :2]


def near_box(points_px: NDArray[np.float64], box_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) how near to a box's middle (4,) points (N, 2) are: 1 there, 1/e at `_NEAR` of its longer sides."""
    off = np.linalg.norm(points_px - (box_px[:2] + box_px[2:]) / 2, axis=1)
    return np.exp(-((off / (_NEAR * max((box_px[2:] - box_px[:2]).max(), 1e-9))) ** 2))


def ellipse_in(box_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (16, 2) on the ellipse that touches the sides of a box (4,)."""
    angles = np.arange(16) * (np.pi / 8)
    half = (box_px[2:] - box_px[:2]) / 2
    return box_px[:2] + half * (1 + np.stack([np.cos(angles), np.sin(angles)], axis=-1))


def rolled_box(
    points_px: NDArray[np.float64],
    image_size: tuple[int, int],
    from_rolled: NDArray[np.float64],
    valid: NDArray[np.bool_] | None = None,
) -> NDArray[np.float64]:
    """Tight box of a hand as a rolled camera sees it, of the part that the upright camera's picture shows.

    Args:
        points_px: (..., N, 2) pixels of the picture; those beyond its edge count as on it.
        image_size: (H, W) of the picture.
        from_rolled: (3, 3) homography, `image_from_rolled`.
        valid: (..., N) bool, which points count; None for all.

    Returns:
        (..., 4) u0, v0, u1, v1 in pixels of the rolled camera; NaN where no point is left.
    """
    inside = np.minimum(np.maximum(points_px, 0), np.array(image_size[::-1], np.float64))
    return np.asarray(box_from_points(apply_homography(np.linalg.inv(from_rolled), inside), valid), np.float64)


def apply_homography(homography: Array, points: Array) -> Array:
    """Map points through a homography.

    Args:
        homography: (..., 3, 3), scaled so that the third coordinate is positive in front of the camera, as in our
            crops and their inverses (`numpy.linalg.inv`).
        points: (..., N, 2) pixels.

    Returns:
        (..., N, 2) pixels; NaN for points behind the camera.
    """
    xp, homography, points = float_arrays(homography, points)
    points = xp.concat([points, xp.ones_like(points[..., :1])], axis=-1)
    with np.errstate(invalid="ignore"):  # an infinite point has no place on the other side: NaN
        mapped = xp.matmul(points, xp.matrix_transpose(homography))  # (..., N, 3)
    in_front = mapped[..., 2:] > 0
    depth = xp.where(in_front, mapped[..., 2:], xp.ones_like(mapped[..., 2:]))
    return xp.where(in_front, mapped[..., :2] / depth, xp.nan)


def points_from_crops(
    image_from_crop: NDArray[np.float64], points: NDArray[np.float64], size: int
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Points found in crops, as pixels of the picture, all of them finite.

    Args:
        image_from_crop: (B, 3, 3), of `square_crop` or `perspective_crop`, also behind `image_from_rolled`.
        points: (B, N, 2) pixels of the crops.
        size: side of the crops in their own pixels.

    Returns:
        (B, N, 2) pixels of the picture, and (B, N) bool, whether that is where they were found: the crop of a wide
        camera reaches beyond what has a pixel, and a point there is moved towards the crop's centre until it has one.
    """
    centre = np.full(2, size / 2)
    depth = np.concatenate([points, np.ones_like(points[..., :1])], axis=-1) @ image_from_crop[:, 2, :, None]
    depth = depth / (image_from_crop[:, 2] @ [*centre, 1.0])[:, None, None]  # (B, N, 1), 1 at the centre
    found = depth >= _LEAST_DEPTH
    share = (1 - _LEAST_DEPTH) / np.where(found, 1.0, 1 - depth)
    points = np.where(found, points, centre + share * (points - centre))
    return np.asarray(apply_homography(image_from_crop, points)), found[..., 0]


def warp_image(
    image: Array,
    image_from_crop: NDArray[np.float64],
    size: int,
    *,
    interpolation: Literal["linear", "nearest"] = "linear",
) -> Array:
    """Cut a crop out of an image.

    Args:
        image: (H, W) or (H, W, C), uint8 or float32, at most 4 channels.
        image_from_crop: (3, 3) crop pixels to image pixels, (0, 0) being outer corners on both sides.
        size: side of the crop in pixels.
        interpolation: "linear" for pictures, "nearest" for labels.

    Returns:
        (size, size[, C]), the image's dtype; 0 outside the image. Where a pixel of the crop covers several of the
        image, "linear" takes their mean: of a photograph's millions of pixels a hand would else be shown by a few, with
        all their noise.
    """
    if interpolation == "linear":
        image, image_from_crop = _reduced(image, image_from_crop, size)
    centre_from_corner = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]], dtype=np.float64)
    # OpenCV counts from the first pixel's centre, we from its outer corner.
    matrix = centre_from_corner @ image_from_crop @ np.linalg.inv(centre_from_corner)
    flags = (cv2.INTER_LINEAR if interpolation == "linear" else cv2.INTER_NEAREST) | cv2.WARP_INVERSE_MAP
    return cv2.warpPerspective(image, matrix, (size, size), flags=flags, borderMode=cv2.BORDER_CONSTANT, borderValue=0)


def _reduced(image: Array, image_from_crop: NDArray[np.float64], size: int) -> tuple[Array, NDArray[np.float64]]:
    """The part of an image that a crop shows, with pixels about as large as the crop's at its centre, and the way there
    from the crop; image and matrix as they are where the image's pixels are over two thirds as large."""
    depth = image_from_crop[2] @ [size / 2, size / 2, 1.0]
    area = np.abs(np.linalg.det(image_from_crop) / depth**3)  # of the crop's central pixel, in pixels of the image
    block = round(float(np.sqrt(area))) if np.isfinite(area) else 1
    if block < 2:
        return image, image_from_crop
    height, width = image.shape[:2]
    corners = apply_homography(image_from_crop, np.array([[0.0, 0], [size, 0], [0, size], [size, size]]))
    ends = (0, 0, width, height)  # of a crop that reaches behind the camera
    if np.isfinite(corners).all():
        ends = box_in_picture(corners, width, height)
    left, top, right, bottom = (float(end) for end in ends)
    (u0, u1), (v0, v1) = _blocks(left, right, block, width), _blocks(top, bottom, block, height)
    part: NDArray[Any] = np.asarray(image[v0:v1, u0:u1])
    rows, columns = -(-len(part) // block), -(-part.shape[1] // block)
    below, beside = rows * block - len(part), columns * block - part.shape[1]
    part = np.asarray(cv2.copyMakeBorder(part, 0, below, 0, beside, cv2.BORDER_CONSTANT, value=0))
    small = cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA)
    small_from_image = np.array([[1 / block, 0, -u0 / block], [0, 1 / block, -v0 / block], [0, 0, 1.0]])
    return small, small_from_image @ image_from_crop


def _blocks(low: float, high: float, block: int, whole: int) -> tuple[int, int]:
    """Where the blocks of a row of `whole` pixels begin and end that hold what lies between `low` and `high`, with one
    block more on either side; at least one pixel."""
    first = int(min(max(low - block, 0), whole - 1)) // block * block
    return first, int(min(max(high + block, first + 1), whole))


def _box_rays(box_px: tuple[float, float, float, float], camera: PinholeCamera) -> NDArray[np.float64]:
    """(5, 3) rays through a box's centre and its four corners, camera frame, scaled to z = 1, without distortion."""
    u0, v0, u1, v1 = box_px
    points = np.array([[(u0 + u1) / 2, (v0 + v1) / 2], [u0, v0], [u1, v0], [u0, v1], [u1, v1]])
    return np.asarray(unproject(points, replace(camera, distortion=())))


def _checked_box(box_px: Array) -> tuple[float, float, float, float]:
    u0, v0, u1, v1 = (float(value) for value in box_px)
    if not (np.isfinite([u0, v0, u1, v1]).all() and u1 >= u0 and v1 >= v0 and max(u1 - u0, v1 - v0) > 0):
        raise InputError(f"a crop needs a finite box (u0, v0, u1, v1) with some extent, got {(u0, v0, u1, v1)}")
    return u0, v0, u1, v1


def mirrored_columns(size: int) -> NDArray[np.float64]:
    """(3, 3) homography of a picture `size` pixels wide to itself, left to right: u becomes size - u."""
    return np.array([[-1, 0, size], [0, 1, 0], [0, 0, 1]], dtype=np.float64)


def _mirror(side: int, size: int) -> NDArray[np.float64]:
    if side not in (LEFT, RIGHT):
        raise InputError(f"side must be LEFT ({LEFT}) or RIGHT ({RIGHT}), got {side}")
    return mirrored_columns(size) if side == RIGHT else np.eye(3)
