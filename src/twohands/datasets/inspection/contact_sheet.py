"""A picture of many samples at once, with their labels drawn in: the quickest check of any dataset."""

from __future__ import annotations

import math

import cv2
import numpy as np

from twohands.datasets.base import HandDataset
from twohands.skeleton import BONES, JOINT_NAMES, LEFT, RIGHT, SIDES
from twohands.types import HandSample

_BONE_COLORS = {
    "thumb": (255, 176, 59),
    "index": (120, 220, 60),
    "middle": (60, 200, 255),
    "ring": (150, 120, 255),
    "little": (255, 90, 190),
}
_SIDE_COLORS = {LEFT: (255, 255, 255), RIGHT: (255, 230, 0)}
_OVERSAMPLING_BITS = 4
"""cv2 draws at 1/16 px when coordinates are given as fixed-point numbers."""


def contact_sheet(dataset: HandDataset, count: int = 24, *, columns: int = 4, tile_width: int = 480) -> np.ndarray:
    """Samples spread evenly over the dataset, skeletons drawn on their images.

    Args:
        dataset: what to show.
        count: number of samples, at most the dataset's length.
        columns: tiles per row.
        tile_width: width of a tile in pixels; heights follow the first image's shape.

    Returns:
        (H, W, 3) uint8 RGB.
    """
    count = min(count, len(dataset))
    indices = np.unique(np.linspace(0, len(dataset) - 1, count).round().astype(int))
    tiles = [_tile(dataset[int(index)], tile_width) for index in indices]
    columns = min(columns, len(tiles))
    rows = math.ceil(len(tiles) / columns)
    tile_height = max(tile.shape[0] for tile in tiles)
    sheet = np.zeros((rows * tile_height, columns * tile_width, 3), np.uint8)
    for position, tile in enumerate(tiles):
        row, column = divmod(position, columns)
        top, left = row * tile_height, column * tile_width
        sheet[top : top + tile.shape[0], left : left + tile_width] = tile
    return sheet


def draw_joints(image: np.ndarray, joints_px: np.ndarray, side: int) -> np.ndarray:
    """A copy of an image with one hand's skeleton.

    Args:
        image: (H, W, 3) uint8 RGB.
        joints_px: (21, 2) pixels of this image; bones with an unknown (NaN) end are left out.
        side: LEFT or RIGHT; decides the colour of the joints and the letter at the wrist.

    Returns:
        (H, W, 3) uint8 RGB.
    """
    canvas = image.copy()
    thickness = max(1, round(image.shape[1] / 400))
    fixed = [_fixed_point(point) for point in joints_px]
    for parent, child in BONES:
        start, end = fixed[parent], fixed[child]
        if start is not None and end is not None:
            color = _BONE_COLORS[JOINT_NAMES[child].split("_")[0]]
            cv2.line(canvas, start, end, color, thickness, cv2.LINE_AA, _OVERSAMPLING_BITS)
    radius = round(1.5 * thickness * 2**_OVERSAMPLING_BITS)
    for point in fixed:
        if point is not None:
            cv2.circle(canvas, point, radius, _SIDE_COLORS[side], -1, cv2.LINE_AA, _OVERSAMPLING_BITS)
    if np.isfinite(joints_px[0]).all() and np.abs(joints_px[0]).max() < 1e5:
        corner = int(joints_px[0, 0]) + 4 * thickness, int(joints_px[0, 1])
        _text(canvas, SIDES[side][0].upper(), corner, 0.5 * thickness)
    return canvas


def _tile(sample: HandSample, width: int) -> np.ndarray:
    """(h, width, 3): the sample at tile size with skeletons and its name."""
    scale = width / sample.image.shape[1]
    height = max(1, round(sample.image.shape[0] * scale))
    tile = cv2.resize(sample.image, (width, height), interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    for side in (LEFT, RIGHT):
        if sample.present[side]:
            tile = draw_joints(tile, sample.joints_px[side] * scale, side)
    _text(tile, sample.source[-40:], (6, height - 8), 0.45)
    return tile


def _fixed_point(point_px: np.ndarray) -> tuple[int, int] | None:
    """cv2's fixed-point coordinates; its (0, 0) is the centre of the first pixel, ours the outer corner."""
    if not (np.isfinite(point_px).all() and np.abs(point_px).max() < 1e5):
        return None
    u, v = np.rint((point_px - 0.5) * 2**_OVERSAMPLING_BITS).astype(int)
    return int(u), int(v)


def _text(canvas: np.ndarray, text: str, corner: tuple[int, int], scale: float) -> None:
    for color, thickness in (((0, 0, 0), 3), ((255, 255, 255), 1)):
        cv2.putText(canvas, text, corner, cv2.FONT_HERSHEY_SIMPLEX, scale, color, thickness, cv2.LINE_AA)
