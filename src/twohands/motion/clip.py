"""Both hands over a clip as arrays, read from hands.jsonl: what every writer of this room begins with."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from twohands.errors import DataFormatError, InputError
from twohands.inference.clip_files import read_clip
from twohands.skeleton import N_JOINTS, SIDES
from twohands.types import HandPose, PinholeCamera

MOST_METRES: Final = 1000.0
"""From the camera; beyond it nothing is a hand, and 32 bits would be coarser than 0.1 mm."""
MOST_SECONDS: Final = 1e9
UPRIGHT_FROM_CAMERA: Final = np.diag([1.0, -1.0, -1.0])
"""Rotation from the camera frame (x right, y down, z forward) to the upright one (x right, y up, z backward), which
glTF, BVH and OpenXR speak."""


@dataclass(frozen=True, slots=True, eq=False)
class HandMotion:
    """Both hands over F frames, F >= 1.

    Attributes:
        time_s: (F,) seconds, increasing: the clip's own times.
        index: (F,) int, positions in the clip.
        joints_m: (F, 2, 21, 3) camera frame, metres, hands LEFT, RIGHT; NaN where not valid.
        valid: (F, 2) bool: placed in metres.
        camera: of all frames.
        source: what the clip was made from.
    """

    time_s: np.ndarray
    index: np.ndarray
    joints_m: np.ndarray
    valid: np.ndarray
    camera: PinholeCamera
    source: str

    @property
    def sides(self) -> tuple[int, ...]:
        """Of the hands that are valid somewhere: LEFT, RIGHT."""
        return tuple(side for side in range(2) if self.valid[:, side].any())


def read_motion(path: Path) -> HandMotion:
    """Reads hands.jsonl, version 2.

    Raises:
        DataFormatError: it is no such file, a time is missing or does not increase, or a joint is no place.
        InputError: there is no frame in it, or in none of them a hand has metres.
    """
    header, poses = read_clip(path)
    times: list[float] = []
    index: list[int] = []
    hands: list[np.ndarray] = []
    camera = None
    for pose in poses:
        times.append(_time(path, pose.index, pose.time_s, times[-1] if times else -math.inf))
        index.append(pose.index)
        hands.append(np.stack([_joints(path, pose.index, s, hand) for s, hand in zip(SIDES, pose.hands, strict=True)]))
        camera = camera or pose.camera
    if camera is None:
        raise InputError(f"{path}: no frame in it, so there is nothing to export")
    joints = np.stack(hands)
    valid = np.asarray(np.isfinite(joints).all(axis=(-2, -1)))
    if not valid.any():
        raise InputError(f"{path}: no hand has metres in any of its {len(times)} frames, so there is nothing to export")
    return HandMotion(np.array(times), np.array(index), joints, valid, camera, str(header.get("source", "")))


def _time(path: Path, index: int, time_s: float | None, before: float) -> float:
    known = isinstance(time_s, int | float) and not isinstance(time_s, bool) and abs(time_s) < MOST_SECONDS
    if time_s is None or not known:
        raise DataFormatError(f"{path}: frame {index}: time_s must be a number of seconds, found {time_s!r:.40}")
    if not time_s > before:
        raise DataFormatError(f"{path}: frame {index}: time_s {time_s:g} does not come after {before:g}")
    return float(time_s)


def _joints(path: Path, index: int, side: str, hand: HandPose) -> np.ndarray:
    """(21, 3) camera frame, metres; NaN where the hand is not valid."""
    if not (hand.present is True and hand.valid is True):
        return np.full((N_JOINTS, 3), np.nan)
    joints = hand.joints_m
    if joints is None or not (np.abs(joints) <= MOST_METRES).all():
        raise DataFormatError(
            f"{path}: frame {index}: {side} joints_m must be 21 places within {MOST_METRES:g} m, as the hand is valid"
        )
    return joints
