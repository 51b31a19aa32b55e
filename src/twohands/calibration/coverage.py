"""Where in the picture a camera's calibration saw the board, and how well it agrees there."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from twohands.calibration.camera import CameraFit

WIDTH_PX: Final = 960
_PAPER: Final = (250, 250, 250)
_THIRDS: Final = (205, 205, 205)
_OUTLINE: Final = (176, 196, 222)
_GOOD: Final = np.array([30.0, 110.0, 60.0])
_BAD: Final = np.array([200.0, 40.0, 30.0])
_BAD_ERROR_PX: Final = 1.0


def coverage_picture(fit: CameraFit) -> np.ndarray:
    """(H, W, 3) uint8 RGB: all corners, green where their view agrees with the camera to the pixel, red from 1 px on;
    with each view's outline and the thirds of the picture.

    Args:
        fit: the calibration.
    """
    scale = WIDTH_PX / fit.camera.width
    height = round(fit.camera.height * scale)
    picture = np.full((height, WIDTH_PX, 3), _PAPER, np.uint8)
    for third in (1, 2):
        x, y = round(third * WIDTH_PX / 3), round(third * height / 3)
        cv2.line(picture, (x, 0), (x, height), _THIRDS, 1)
        cv2.line(picture, (0, y), (WIDTH_PX, y), _THIRDS, 1)
    corners = [np.round(view.corners_px * scale).astype(np.int32) for view in fit.views]
    for points in corners:
        cv2.polylines(picture, [cv2.convexHull(points)], True, _OUTLINE, 1, cv2.LINE_AA)
    for points, error in zip(corners, fit.errors_px, strict=True):
        part = min(float(error) / _BAD_ERROR_PX, 1.0)
        colour = tuple(int(value) for value in (1 - part) * _GOOD + part * _BAD)
        for x, y in points.tolist():
            cv2.circle(picture, (x, y), 2, colour, -1, cv2.LINE_AA)
    return picture
