"""Pictures of the printed board, seen by known cameras from known places."""

from __future__ import annotations

import functools

import cv2
import numpy as np

from twohands.calibration.board import COLUMNS, ROWS, SQUARE_M, printed_areas
from twohands.geometry.camera import intrinsic_matrix
from twohands.types import PinholeCamera

MARGIN_M = 0.015
"""Of white paper around the board."""
_PX_PER_M = 8000
_FINER = 2
"""Each pixel is the mean of so many squared."""


@functools.cache
def printed() -> np.ndarray:
    """The board and its margin from straight above, 8 pixels a millimetre, grey."""
    sides = np.array([COLUMNS, ROWS]) * SQUARE_M + 2 * MARGIN_M
    width, height = np.round(sides * _PX_PER_M).astype(int)
    paper = np.full((height, width), 235, np.uint8)
    for areas, grey in zip(printed_areas(), (25, 235), strict=True):
        for x0, y0, x1, y1 in np.round((areas + MARGIN_M) * _PX_PER_M).astype(int):
            paper[y0:y1, x0:x1] = grey
    return paper


def board_pose(tilt_deg: tuple[float, float], roll_deg: float, centre_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and translation (3,) from the board to the camera.

    Args:
        tilt_deg: about the camera's x and y; (0, 0) faces it.
        roll_deg: in its own plane, first.
        centre_m: where the board's middle is, camera frame.
    """
    x, y, z = np.radians([*tilt_deg, roll_deg])
    turns = [cv2.Rodrigues(np.array(axis, np.float64))[0] for axis in ((x, 0, 0), (0, y, 0), (0, 0, z))]
    rotation = turns[1] @ turns[0] @ turns[2]
    middle = np.array([COLUMNS, ROWS, 0]) * SQUARE_M / 2
    return rotation, np.asarray(centre_m) - rotation @ middle


def picture_of_board(
    camera: PinholeCamera,
    rotation: np.ndarray,
    translation: np.ndarray,
    rng: np.random.Generator,
    *,
    blur_px: float = 0.6,
    noise: float = 2.0,
) -> np.ndarray:
    """(H, W, 3) uint8 RGB: the board before grey, through the camera's lens, with a little blur and noise."""
    paper = printed()
    fine = camera.resized(camera.width * _FINER, camera.height * _FINER)
    columns, rows = np.meshgrid(np.arange(fine.width) + 0.5, np.arange(fine.height) + 0.5)
    rays = _rays(np.stack([columns, rows], axis=-1), fine) @ rotation  # in the board's axes
    start = -translation @ rotation
    away = -start[2] / rays[..., 2]
    place = (start[:2] + away[..., None] * rays[..., :2] + MARGIN_M) * _PX_PER_M - 0.5
    place = np.where((away > 0)[..., None], place, -1e4).astype(np.float32)
    seen = cv2.remap(paper, place[..., 0], place[..., 1], cv2.INTER_LINEAR, borderValue=120.0)
    seen = cv2.resize(seen, (camera.width, camera.height), interpolation=cv2.INTER_AREA).astype(np.float32)
    seen = cv2.GaussianBlur(seen, (0, 0), blur_px) + rng.normal(0, noise, seen.shape)
    return np.repeat(np.clip(np.round(seen), 0, 255).astype(np.uint8)[..., None], 3, axis=-1)


def _rays(points_px: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """As `geometry.camera.unproject`, by OpenCV: an answer of somebody else, and a quick one."""
    lens = np.array(camera.distortion or (0.0,) * 4)
    steps = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-9)
    plain = cv2.undistortPoints(points_px.reshape(-1, 1, 2), intrinsic_matrix(camera), lens, criteria=steps)
    return np.concatenate([plain.reshape(points_px.shape), np.ones((*points_px.shape[:-1], 1))], axis=-1)


def views(camera: PinholeCamera, count: int, seed: int = 0, tilt_deg: float = 40.0) -> list[np.ndarray]:
    """Pictures of the board at all kinds of places and tilts, nearly always whole in the picture."""
    rng = np.random.default_rng(seed)
    pictures = []
    for _ in range(count):
        tilt = tuple(rng.uniform(-tilt_deg, tilt_deg, 2))
        distance = rng.uniform(0.28, 0.6) * camera.fx / camera.width * 1.1
        reach = np.array([camera.width / camera.fx, camera.height / camera.fy]) / 2
        offset = rng.uniform(-0.65, 0.65, 2) * reach * distance
        pose = board_pose(tilt, float(rng.uniform(-30, 30)), np.array([*offset, distance]))
        pictures.append(picture_of_board(camera, *pose, rng))
    return pictures
