"""Results as arrays (npz) and as a table (csv).

hands.npz, F frames, axis of hands (LEFT, RIGHT), absent = NaN where the mask says no::

    version ()  source () weights ()  hand_length_m ()    camera (6,) fx fy cx cy width height    distortion (0..8,)
    index (F,)  time_s (F,)  files (F,)                   position, seconds, the picture's name ("" in a video)
    present (F, 2)  valid (F, 2)                          bool masks: found; placed in metres
    score  range_m  range_sigma_m  theta_deg  phi_deg (F, 2)   confidence 0..1, metres, degrees
    joints_m (F, 2, 21, 3)  canonical (F, 2, 21, 3)       camera frame, metres; unitless, centred frame
    joints_px (F, 2, 21, 2)  joint_scores (F, 2, 21)  box_px (F, 2, 4)
    method (F, 2)  scale_source (F, 2)  intrinsics_source (F, 2)   words, "" where nothing is known
    between_hands_m (F, 3)  overlap (F,)                  from the left root to the right one; share of boxes

hands.csv has a row for each joint of a present hand: CSV_COLUMNS; a cell is empty where nothing is known.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from twohands.skeleton import JOINT_NAMES, N_JOINTS, SIDES
from twohands.types import HandPose, PinholeCamera, TwoHandPose

VERSION: Final = 1
CSV_COLUMNS: Final = (
    "frame", "time_s", "file", "hand", "score", "range_m", "range_sigma_m", "valid", "joint", "name", "u_px", "v_px",
    "joint_score", "x_m", "y_m", "z_m", "scale_source", "intrinsics_source", "between_hands_x_m", "between_hands_y_m",
    "between_hands_z_m", "overlap",
)  # fmt: skip

WORDS: Final = ("method", "scale_source", "intrinsics_source")
"""Arrays of one word for each hand."""
_PER_HAND: Final[Mapping[str, tuple[int, ...]]] = {
    "score": (),
    "range_m": (),
    "range_sigma_m": (),
    "theta_deg": (),
    "phi_deg": (),
    "box_px": (4,),
    "joints_m": (N_JOINTS, 3),
    "canonical": (N_JOINTS, 3),
    "joints_px": (N_JOINTS, 2),
    "joint_scores": (N_JOINTS,),
}


def to_arrays(
    poses: Sequence[TwoHandPose],
    camera: PinholeCamera,
    *,
    source: str,
    weights: str,
    hand_length_m: float,
    files: Sequence[str] | None = None,
) -> dict[str, np.ndarray]:
    """Results as the arrays of hands.npz.

    Args:
        poses: one for each frame.
        camera: of all frames.
        source, weights: what they come from.
        hand_length_m: with which they were placed, metres.
        files: the pictures' names, one for each pose; None where there are none.
    """
    hands = [pose.hands for pose in poses]
    arrays: dict[str, np.ndarray] = {
        "version": np.array(VERSION),
        "source": np.array(source),
        "weights": np.array(weights),
        "hand_length_m": np.array(hand_length_m, np.float64),
        "camera": np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height], np.float64),
        "distortion": np.array(camera.distortion, np.float64),
        "index": np.array([pose.index for pose in poses], np.int64),
        "time_s": np.array([np.nan if pose.time_s is None else pose.time_s for pose in poses], np.float64),
        "files": np.array([""] * len(poses) if files is None else list(files), np.str_),
        "present": _masks(hands, "present"),
        "valid": _masks(hands, "valid"),
        "between_hands_m": _or_nan([pose.between_hands_m for pose in poses], (3,)),
        "overlap": _or_nan([pose.overlap for pose in poses], ()),
    }
    for name in WORDS:
        words = [[getattr(hand, name) or "" for hand in pair] for pair in hands]
        arrays[name] = np.array(words, np.str_).reshape(len(poses), 2)
    for name, shape in _PER_HAND.items():
        arrays[name] = np.full((len(poses), 2, *shape), np.nan)
        for row, pair in enumerate(hands):
            for side, hand in enumerate(pair):
                value = getattr(hand, name)
                if hand.present and value is not None:
                    arrays[name][row, side] = value
    return arrays


def npz_bytes(arrays: Mapping[str, np.ndarray]) -> bytes:
    """The content of an .npz file."""
    content = io.BytesIO()
    stored: dict[str, Any] = dict(arrays)
    np.savez_compressed(content, **stored)
    return content.getvalue()


def csv_text(poses: Iterable[TwoHandPose], files: Sequence[str] | None = None, *, header: bool = True) -> str:
    """Results as the rows of hands.csv, every number in full.

    Args:
        poses: one for each frame.
        files: the pictures' names, one for each pose; None where there are none.
        header: begin with the names of the columns.
    """
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    if header:
        rows.writerow(CSV_COLUMNS)
    for number, pose in enumerate(poses):
        apart = _apart(pose)
        for side, hand in zip(SIDES, pose.hands, strict=True):
            if hand.present:
                about = (pose.index, _cell(pose.time_s), "" if files is None else files[number], side)
                rows.writerows((*row, *apart) for row in _joint_rows(about, hand))
    return text.getvalue()


def _joint_rows(about: tuple[Any, ...], hand: HandPose) -> Iterable[tuple[Any, ...]]:
    valid = int(bool(hand.valid))
    sizes = [_cell(value) for value in (hand.score, hand.range_m, hand.range_sigma_m)]
    for joint, name in enumerate(JOINT_NAMES):
        pixel = (None, None) if hand.joints_px is None else hand.joints_px[joint]
        point = (None, None, None) if hand.joints_m is None else hand.joints_m[joint]
        score = None if hand.joint_scores is None else hand.joint_scores[joint]
        numbers = [_cell(value) for value in (*pixel, score, *point)]
        yield (*about, *sizes, valid, joint, name, *numbers, hand.scale_source or "", hand.intrinsics_source or "")


def _apart(pose: TwoHandPose) -> list[str]:
    """How both hands of a frame lie to each other."""
    between = (None, None, None) if pose.between_hands_m is None else pose.between_hands_m
    return [_cell(value) for value in (*between, pose.overlap)]


def _cell(value: Any) -> str:
    """A number in full; nothing where it is unknown."""
    return "" if value is None or not math.isfinite(value) else repr(float(value))


def _masks(hands: Sequence[tuple[HandPose, HandPose]], name: str) -> np.ndarray:
    return np.array([[bool(getattr(hand, name)) for hand in pair] for pair in hands], bool).reshape(len(hands), 2)


def _or_nan(values: Sequence[Any], shape: tuple[int, ...]) -> np.ndarray:
    """(F, *shape), NaN where there is no value."""
    rows = [np.full(shape, np.nan) if value is None else value for value in values]
    return np.array(rows, np.float64).reshape(len(values), *shape)
