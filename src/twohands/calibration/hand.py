"""One length of the hand, |wrist - middle knuckle| of our skeleton, from a picture in which it lies flat beside the
printed board: the board's plane gives the scale. The other way, by a tape, is `tape`."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from twohands.calibration.board import BoardView
from twohands.errors import InputError
from twohands.geometry.camera import unproject
from twohands.skeleton import ROOT, WRIST
from twohands.types import PinholeCamera

JOINT_HEIGHT: Final = 0.217
"""Of wrist and middle knuckle above the palm's skin, in hand lengths: mean over 40 of the generator's adults."""
_ROUNDS: Final = 8
"""Of finding the length at the height that the length before gave; each brings a tenth of the error."""


def board_pose(view: BoardView, camera: PinholeCamera, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Where the board lies.

    Args:
        view: of the board.
        camera: at the picture's size.
        scale: length of the printed rule over what it should be.

    Returns:
        Rotation (3, 3) and translation (3,) metres, from the board's axes (x right, y down, z into the paper) to the
        camera frame.

    Raises:
        InputError: too few corners are seen.
    """
    rays = unproject(view.corners_px, camera)
    known = np.isfinite(rays).all(axis=-1)
    if known.sum() >= 6:
        solved, turn, shift = cv2.solvePnP(view.corners_m[known] * scale, rays[known, None, :2], np.eye(3), None)
        if solved and shift[2, 0] > 0:
            return cv2.Rodrigues(turn)[0], np.ravel(shift)
    raise InputError(f"only {int(known.sum())} of the board's corners are seen; show more of it")


def length_on_board(
    joints_px: np.ndarray, view: BoardView, camera: PinholeCamera, *, scale: float = 1.0, height: float = JOINT_HEIGHT
) -> float:
    """The length of a hand whose palm lies on the board or on the table beside it.

    Args:
        joints_px: (21, 2) pixels.
        view: of the board in the same picture.
        camera: at its size.
        scale: length of the printed rule over what it should be.
        height: of wrist and knuckle above the paper, in hand lengths.

    Returns:
        |wrist - middle knuckle| in metres.

    Raises:
        InputError: too little of the board is seen, or a joint is not above the paper.
    """
    rotation, translation = board_pose(view, camera, scale)
    rays = unproject(joints_px[[WRIST, ROOT]], camera) @ rotation
    start = -translation @ rotation
    length = 0.0
    for _ in range(_ROUNDS):
        away = (-height * length - start[2]) / rays[:, 2]
        wrist, root = start + away[:, None] * rays
        if not (np.isfinite(away).all() and (away > 0).all()):
            raise InputError("the hand is not seen on the paper; lay it flat beside the board")
        length = float(np.linalg.norm(wrist - root))
    return length
