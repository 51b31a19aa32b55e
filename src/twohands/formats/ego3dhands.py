"""The Ego3DHands file layout as pure array functions: one codec for the reader and the writer.

No files are touched here. The layout's own terms (centimetres, axis order (row, col, depth), coordinates as fractions
of the image, zeros for an absent hand) exist only on one side of these functions; on the other side are the
conventions of the house: metres, (x right, y down, z forward), pixels with (0, 0) at the outer corner, NaN for an
absent hand.

Source: the dataset's README and its official sample; docs/dataset-format.md.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from twohands.errors import DataFormatError
from twohands.plausibility import LARGEST_NUMBER
from twohands.skeleton import N_JOINTS, N_PART_LABELS

COLOR_FILE: Final = "color.png"
"""RGBA, hands and arms only, straight alpha, black where alpha is 0."""
IMAGE_FILE: Final = "color_new.png"
"""RGB, the same hands on a background: what a network sees."""
LABELS_FILE: Final = "gt_seg.png"
"""RGB with three equal channels, each pixel its part label 0..14."""
DEPTH_FILE: Final = "depth.png"
"""RGB, planar depth in base-100 digits (`encode_depth`)."""
JOINTS_2D_FILE: Final = "location_2d.npy"
"""(2, 22, 2) float64, (row, col) as fractions of height and width. Its presence makes a folder an instance."""
JOINTS_3D_FILE: Final = "location_3d_global.npy"
"""(2, 22, 3) float64, (row, col, depth) in centimetres, camera frame."""
CANONICAL_FILE: Final = "location_3d_canonical.npy"
"""(2, 22, 3) float64, (row, col, depth), root joint 0, |wrist - root| = 1, centred frame."""
CAMERA_FILE: Final = "camera.json"
"""Ours: {"fx", "fy", "cx", "cy"} in pixels, where the camera is not the official one (`PinholeCamera.ego3dhands`)."""
AMODAL_FILE: Final = "gt_amodal.png"
"""Ours, where a set has it: grey, 1 where the left arm is or would be if nothing hid it, plus 2 for the right arm."""

N_JOINTS_WITH_ELBOW: Final = N_JOINTS + 1
"""Every array holds (elbow, 21 hand joints) per hand."""
HAND_LENGTH_M: Final = 0.10
"""|wrist - root| of every hand of the official data: its 3D is scaled to this length."""
MAX_DEPTH_M: Final = 2.559999
"""Largest depth that `encode_depth` can write: 255 + 0.99 + 0.0099 cm."""


def instance_name(index: int) -> str:
    """Folder name of an instance: five digits, more where they are needed."""
    return f"{index:05d}"


def encode_depth(depth_m: np.ndarray) -> np.ndarray:
    """Depth map to the pixels of `depth.png`.

    Centimetres are written in base-100 digits, depth_cm = B + 0.01 G + 0.0001 R: one unit of R is a micrometre.
    Rounding is to the nearest micrometre, and it carries (2.99996 cm is 3, 0, 0).

    Args:
        depth_m: (H, W) planar depth in metres, 0 for background, at most `MAX_DEPTH_M`.

    Returns:
        (H, W, 3) uint8 in RGB order.

    Raises:
        DataFormatError: a depth is negative, not finite, or too large for the format.
    """
    depth = np.asarray(depth_m)
    covered = np.flatnonzero(depth)  # often a tenth of the picture; NaN is not zero
    micrometres = np.rint(depth.reshape(-1)[covered].astype(np.float64) * 1e6)
    if not np.all((micrometres >= 0) & (micrometres <= round(MAX_DEPTH_M * 1e6))):  # False for NaN too
        raise DataFormatError(
            f"depth must be finite and within 0..{MAX_DEPTH_M} m to be written as {DEPTH_FILE}, "
            f"got {np.min(depth_m)}..{np.max(depth_m)}"
        )
    units = micrometres.astype(np.int32)
    pixels = np.zeros((depth.size, 3), np.uint8)
    pixels[covered] = np.stack([units % 100, units // 100 % 100, units // 10_000], axis=-1)
    return pixels.reshape(*depth.shape, 3)  # (H, W, 3)


def decode_depth(rgb: np.ndarray) -> np.ndarray:
    """Pixels of `depth.png` to a depth map; undoes `encode_depth` exactly.

    Args:
        rgb: (H, W, 3) uint8 in RGB order (cv2 reads BGR: reverse it first).

    Returns:
        (H, W) float32 planar depth in metres, 0 for background.

    Raises:
        DataFormatError: not an (H, W, 3) uint8 array.
    """
    if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != np.uint8:
        raise DataFormatError(f"{DEPTH_FILE}: expected (H, W, 3) uint8, got {rgb.shape} {rgb.dtype}")
    weights = np.array([1.0, 100.0, 10_000.0])
    return (rgb.astype(np.float64) @ weights / 1e6).astype(np.float32)


def encode_labels(labels: np.ndarray) -> np.ndarray:
    """Part labels to the pixels of `gt_seg.png`.

    Args:
        labels: (H, W) integers 0..14.

    Returns:
        (H, W, 3) uint8 with three equal channels.

    Raises:
        DataFormatError: a label is outside 0..14.
    """
    _check_labels(labels)
    return np.repeat(labels.astype(np.uint8)[..., None], 3, axis=-1)


def decode_labels(pixels: np.ndarray) -> np.ndarray:
    """Pixels of `gt_seg.png` to part labels.

    Args:
        pixels: (H, W, 3) uint8 with equal channels, or one channel (H, W).

    Returns:
        (H, W) uint8, 0..14.

    Raises:
        DataFormatError: a label is outside 0..14 or the channels differ.
    """
    labels = pixels
    if pixels.ndim == 3:
        labels = pixels[..., 0]
        if not np.array_equal(pixels, np.broadcast_to(labels[..., None], pixels.shape)):
            raise DataFormatError(f"{LABELS_FILE}: expected equal channels, but they differ")
    _check_labels(labels)
    return labels.astype(np.uint8)


def encode_joints_px(joints_px: np.ndarray, width: int, height: int) -> np.ndarray:
    """Pixels to the contents of `location_2d.npy`.

    Args:
        joints_px: (2, 22, 2) (u, v) pixels; an absent hand is all NaN.
        width, height: image size in pixels.

    Returns:
        (2, 22, 2) float64 (row / height, col / width); an absent hand is all zeros.

    Raises:
        DataFormatError: wrong shape, or a hand is neither all finite nor all NaN.
    """
    return _zeros_from_nan(joints_px, 2)[..., ::-1] / np.array([height, width], dtype=np.float64)


def decode_joints_px(location_2d: np.ndarray, width: int, height: int) -> np.ndarray:
    """Contents of `location_2d.npy` to pixels; undoes `encode_joints_px`.

    Args:
        location_2d: (2, 22, 2) (row / height, col / width); an absent hand is all zeros.
        width, height: image size in pixels.

    Returns:
        (2, 22, 2) float64 (u, v) pixels; an absent hand is all NaN.

    Raises:
        DataFormatError: wrong shape or not finite.
    """
    return _nan_from_zeros(location_2d, 2, JOINTS_2D_FILE)[..., ::-1] * np.array([width, height], dtype=np.float64)


def encode_joints_m(joints_m: np.ndarray) -> np.ndarray:
    """Camera-frame joints to the contents of `location_3d_global.npy`.

    Args:
        joints_m: (2, 22, 3) (x, y, z) metres; an absent hand is all NaN.

    Returns:
        (2, 22, 3) float64 (row, col, depth) centimetres; an absent hand is all zeros.

    Raises:
        DataFormatError: wrong shape, or a hand is neither all finite nor all NaN.
    """
    return _swap_row_col(_zeros_from_nan(joints_m, 3)) * 100.0


def decode_joints_m(location_3d_global: np.ndarray) -> np.ndarray:
    """Contents of `location_3d_global.npy` to camera-frame joints; undoes `encode_joints_m`.

    Args:
        location_3d_global: (2, 22, 3) (row, col, depth) centimetres; an absent hand is all zeros.

    Returns:
        (2, 22, 3) float64 (x, y, z) metres; an absent hand is all NaN.

    Raises:
        DataFormatError: wrong shape or not finite.
    """
    return _swap_row_col(_nan_from_zeros(location_3d_global, 3, JOINTS_3D_FILE)) / 100.0


def encode_canonical(canonical: np.ndarray) -> np.ndarray:
    """Canonical joints to the contents of `location_3d_canonical.npy`: the axes swap, units stay.

    Args:
        canonical: (2, 22, 3) (x, y, z), unitless; an absent hand is all NaN.

    Returns:
        (2, 22, 3) float64 (row, col, depth); an absent hand is all zeros.

    Raises:
        DataFormatError: wrong shape, or a hand is neither all finite nor all NaN.
    """
    return _swap_row_col(_zeros_from_nan(canonical, 3))


def decode_canonical(location_3d_canonical: np.ndarray) -> np.ndarray:
    """Contents of `location_3d_canonical.npy` to canonical joints; undoes `encode_canonical`.

    Args:
        location_3d_canonical: (2, 22, 3) (row, col, depth), unitless; an absent hand is all zeros.

    Returns:
        (2, 22, 3) float64 (x, y, z); an absent hand is all NaN.

    Raises:
        DataFormatError: wrong shape or not finite.
    """
    return _swap_row_col(_nan_from_zeros(location_3d_canonical, 3, CANONICAL_FILE))


def _swap_row_col(points: np.ndarray) -> np.ndarray:
    """(x, y, z) <-> (row, col, depth) = (y, x, z); its own inverse."""
    return points[..., [1, 0, 2]]


def _zeros_from_nan(points: np.ndarray, dims: int) -> np.ndarray:
    _check_shape(points, dims, "joints")
    absent = np.asarray(np.isnan(points).all(axis=(1, 2)))  # (2,)
    if not np.isfinite(points[~absent]).all():
        raise DataFormatError("the Ego3DHands layout knows whole hands only: a hand must be all finite or all NaN")
    return np.where(absent[:, None, None], 0.0, points).astype(np.float64)


def _nan_from_zeros(points: np.ndarray, dims: int, name: str) -> np.ndarray:
    _check_shape(points, dims, name)
    if not np.isfinite(points).all():
        raise DataFormatError(f"{name}: expected finite numbers, found NaN or infinity")
    if (largest := float(np.abs(points.astype(np.float64)).max())) > LARGEST_NUMBER:
        raise DataFormatError(f"{name}: a number of {largest:.3g}; at most {LARGEST_NUMBER:g} can be one of a joint")
    absent = np.asarray((points == 0).all(axis=(1, 2)))  # (2,)
    return np.where(absent[:, None, None], np.nan, points.astype(np.float64))


def _check_shape(points: np.ndarray, dims: int, name: str) -> None:
    expected = (2, N_JOINTS_WITH_ELBOW, dims)
    if points.shape != expected:
        raise DataFormatError(f"{name}: expected shape {expected}, got {points.shape}")


def _check_labels(labels: np.ndarray) -> None:
    if labels.ndim != 2:
        raise DataFormatError(f"{LABELS_FILE}: expected (H, W) part labels, got shape {labels.shape}")
    low, high = int(labels.min(initial=0)), int(labels.max(initial=0))
    if low < 0 or high >= N_PART_LABELS:
        raise DataFormatError(f"{LABELS_FILE}: labels must be 0..{N_PART_LABELS - 1}, found {low}..{high}")
