"""Light that belongs to the background, so that hands sit in the picture."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from twohands.synth.scene import Lighting
from twohands.types import PinholeCamera

GRID = (16, 9)
"""Columns and rows of the coarse picture that light is read from."""
MIDDLE_GREY = 0.18
KEY_DISTANCE_M = 2.0
KEY_CONTRAST = 2.5
"""A part of the picture this much brighter than the whole is a lamp or a window."""


def lit_by(lighting: Lighting, background: np.ndarray, camera: PinholeCamera) -> Lighting:
    """The lights, with the colour and about the brightness of a background, and its brightest part as one of them.

    Light from above takes the tint of the upper half of the picture, light from below that of the lower half; lamps
    take the tint of the whole. Differences are much reduced: a picture shows a small part of a room, and cameras
    balance colours.

    Args:
        lighting: drawn without regard to the background.
        background: (H, W, 3) uint8 RGB.
        camera: of the picture.

    Returns:
        New lights in the camera frame.
    """
    linear = (cv2.resize(background, GRID, interpolation=cv2.INTER_AREA) / 255.0) ** 2.2
    whole = linear.mean((0, 1)) + 1e-3
    level = np.clip((whole.mean() / MIDDLE_GREY) ** 0.5, 0.5, 1.6)

    def tint(part: np.ndarray) -> np.ndarray:
        mean = part.mean((0, 1)) + 1e-3
        return (mean / whole.mean()) ** 0.35

    half = GRID[1] // 2
    positions, colours = lighting.positions.copy(), lighting.colours * tint(linear) * level
    luminance = cv2.GaussianBlur(linear.mean(-1), (0, 0), 0.8)
    row, column = np.unravel_index(int(luminance.argmax()), luminance.shape)
    if luminance[row, column] > KEY_CONTRAST * whole.mean():
        u, v = (column + 0.5) / GRID[0] * camera.width, (row + 0.5) / GRID[1] * camera.height
        ray = np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0])
        strength = np.linalg.norm(colours[0]) * (KEY_DISTANCE_M / np.linalg.norm(positions[0])) ** 2
        positions[0] = ray / np.linalg.norm(ray) * KEY_DISTANCE_M
        colours[0] = strength * linear[row, column] / max(np.linalg.norm(linear[row, column]), 1e-3)
    return replace(
        lighting,
        positions=positions,
        colours=colours,
        sky=lighting.sky * tint(linear[:half]) * level,
        ground=lighting.ground * tint(linear[-half:]) * level,
    )
