"""Our own results and tables, read back: to place them again with another camera or hand length, or to lift the joints
of a tracker that no adapter knows.

- `hands.json` and `hands.jsonl` of `track` and `lift`: 2D joints and canonical pose;
- `.npz` with `joints_px` (F, 2, 21, 2) and one of `canonical`, `joints_3d`, `joints_m` (F, 2, 21, 3), NaN for what is
  absent; further `present` (F, 2), `joint_scores` (F, 2, 21), `score` (F, 2), `index`, `time_s`, `files` (F,);
- `.csv` with a row for each joint: frame, hand, joint, u_px, v_px, x_m, y_m, z_m; further time_s, file, score,
  joint_score. x_m, y_m, z_m are in the axes of the camera, in any unit and about any origin.

Axis of hands: LEFT, RIGHT. Pixels from the outer corner of the first pixel.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from twohands.errors import DataFormatError
from twohands.lifting.foreign import (
    ForeignFrame,
    ForeignHand,
    check_in_picture,
    check_picture_size,
    joints,
    numbers,
    share,
)
from twohands.skeleton import N_JOINTS, SIDES
from twohands.types import PinholeCamera

SHAPES: Final = {"canonical": "centred", "joints_3d": "centred", "joints_m": "camera"}
"""Arrays that tell a hand's shape, best first, and whose axes they have."""
_COLUMNS: Final = ("frame", "hand", "joint", "u_px", "v_px", "x_m", "y_m", "z_m")


def is_frame(record: Any) -> bool:
    """Whether a record is a frame of hands.json."""
    said = record.get("hands") if isinstance(record, Mapping) else None
    return isinstance(said, Mapping) and all(side in said for side in SIDES)


def hands(record: Any, camera: PinholeCamera) -> tuple[ForeignHand, ...]:
    """Hands of a frame of hands.json that are present and have a pose.

    Raises:
        DataFormatError: a key is missing or holds something else, or the picture had another size.
    """
    size = record.get("camera")
    if isinstance(size, Mapping) and "width" in size and "height" in size:
        shape = [float(numbers(f"camera {name}", size[name], ())) for name in ("width", "height")]
        check_picture_size("camera", shape[0], shape[1], camera)
    found = []
    for side, word in enumerate(SIDES):
        said = record["hands"][word]
        if not isinstance(said, Mapping):
            raise DataFormatError(f"{word}: an object expected, got {type(said).__name__}")
        if not said.get("present") or said.get("canonical") is None or said.get("joints_px") is None:
            continue
        pixels = _with_gaps(f"{word} joints_px", said["joints_px"])
        check_in_picture(f"{word} joints_px", pixels, camera)
        scores = said.get("joint_scores")
        found.append(
            ForeignHand(
                side,
                pixels,
                joints(f"{word} canonical", said["canonical"], 3),
                None if said.get("score") is None else share(f"{word} score", said["score"]),
                None if scores is None else np.clip(numbers(f"{word} joint_scores", scores, (N_JOINTS,)), 0.0, 1.0),
            )
        )
    return tuple(found)


def frames_of_arrays(stored: Mapping[str, np.ndarray], camera: PinholeCamera) -> tuple[tuple[ForeignFrame, ...], str]:
    """Frames of an npz, and whose axes their shapes have.

    Raises:
        DataFormatError: an array is missing, or has another shape.
    """
    shape_name = next((name for name in SHAPES if name in stored), None)
    if shape_name is None:
        raise DataFormatError(f"lacks the hands' shape: one of {', '.join(SHAPES)} is needed beside joints_px")
    pixels = numbers("joints_px", stored["joints_px"], (None, 2, N_JOINTS, 2), finite=False)
    count = len(pixels)
    shapes = numbers(shape_name, stored[shape_name], (count, 2, N_JOINTS, 3), finite=False)
    scores = _optional(stored, "score", (count, 2))
    joint_scores = _optional(stored, "joint_scores", (count, 2, N_JOINTS))
    present = _optional(stored, "present", (count, 2))
    index = _optional(stored, "index", (count,))
    times = _optional(stored, "time_s", (count,))
    files = stored.get("files")
    if files is not None and files.shape != (count,):
        raise DataFormatError(f"files: shape ({count},) expected, got {files.shape}")
    frames = []
    for row in range(count):
        found = []
        for side in range(2):
            there = np.isfinite(shapes[row, side]).all() and np.isfinite(pixels[row, side]).any()
            if not there or (present is not None and not present[row, side]):
                continue
            check_in_picture(f"joints_px, row {row}", pixels[row, side], camera)
            score = np.nan if scores is None else scores[row, side]
            found.append(
                ForeignHand(
                    side,
                    pixels[row, side],
                    shapes[row, side],
                    share(f"score, row {row}", score) if np.isfinite(score) else None,
                    None if joint_scores is None else np.clip(joint_scores[row, side], 0.0, 1.0),
                )
            )
        time = None if times is None or not np.isfinite(times[row]) else float(times[row])
        name = None if files is None else str(files[row]) or None
        number = row if index is None or not np.isfinite(index[row]) else int(index[row])
        frames.append(ForeignFrame(tuple(found), number, time, name))
    return tuple(frames), SHAPES[shape_name]


def frames_of_csv(text: str, camera: PinholeCamera) -> tuple[ForeignFrame, ...]:
    """Frames of a table with a row for each joint; frames without a row do not exist.

    Raises:
        DataFormatError: a column is missing, a cell is no number, or a hand lacks joints.
    """
    rows = csv.DictReader(text.splitlines())
    if missing := [name for name in _COLUMNS if name not in (rows.fieldnames or ())]:
        raise DataFormatError(f"column {missing[0]} is missing; needed: {', '.join(_COLUMNS)}")
    cells: dict[int, dict[int, dict[int, Mapping[str, str]]]] = {}
    about: dict[int, Mapping[str, str]] = {}
    for number, row in enumerate(rows, 2):
        frame = _whole(number, row, "frame")
        about.setdefault(frame, row)
        sides = cells.setdefault(frame, {})
        if row["hand"] not in SIDES:
            raise DataFormatError(f"line {number}: hand: left or right expected, got {row['hand']!r}")
        joint = _whole(number, row, "joint")
        if not 0 <= joint < N_JOINTS:
            raise DataFormatError(f"line {number}: joint: 0 to {N_JOINTS - 1} expected, got {joint}")
        hand = sides.setdefault(SIDES.index(row["hand"]), {})
        if joint in hand:
            raise DataFormatError(f"line {number}: joint {joint} of this hand is there twice")
        hand[joint] = row
    frames = []
    for frame, sides in cells.items():
        found = []
        for side, hand in sorted(sides.items()):
            if len(hand) != N_JOINTS:
                raise DataFormatError(f"frame {frame}, {SIDES[side]} hand: {N_JOINTS} joints expected, got {len(hand)}")
            ordered = [hand[joint] for joint in range(N_JOINTS)]
            values = {
                name: np.array([_number(row, name) for row in ordered]) for name in (*_COLUMNS[3:], "joint_score")
            }
            pixels = np.stack([values["u_px"], values["v_px"]], axis=-1)
            shape = np.stack([values[name] for name in ("x_m", "y_m", "z_m")], axis=-1)
            if not np.isfinite(shape).all() or not np.isfinite(pixels).any():
                continue
            check_in_picture(f"frame {frame}, {SIDES[side]} hand", pixels, camera)
            score, scores = _number(ordered[0], "score"), values["joint_score"]
            found.append(
                ForeignHand(
                    side,
                    pixels,
                    shape,
                    share(f"frame {frame}: score", score) if np.isfinite(score) else None,
                    np.clip(scores, 0.0, 1.0) if np.isfinite(scores).any() else None,
                )
            )
        time = _number(about[frame], "time_s")
        name = about[frame].get("file") or None
        frames.append(ForeignFrame(tuple(found), frame, time if np.isfinite(time) else None, name))
    return tuple(frames)


def _with_gaps(name: str, values: Any) -> np.ndarray:
    """(21, 2); null where a joint was not found."""
    plain = [[np.nan if v is None else v for v in row] if isinstance(row, list) else row for row in values]
    if len(plain) != N_JOINTS:
        raise DataFormatError(f"{name}: {N_JOINTS} joints expected, got {len(plain)}")
    return numbers(name, plain, (N_JOINTS, 2), finite=False)


def _optional(stored: Mapping[str, np.ndarray], name: str, shape: tuple[int, ...]) -> np.ndarray | None:
    return numbers(name, stored[name], shape, finite=False) if name in stored else None


def _whole(number: int, row: Mapping[str, str], name: str) -> int:
    try:
        return int(row[name])
    except (TypeError, ValueError):
        raise DataFormatError(f"line {number}: {name}: a whole number expected, got {row[name]!r}") from None


def _number(row: Mapping[str, str], name: str) -> float:
    """A cell's number; NaN where it is empty or the column is not there."""
    text = row.get(name)
    try:
        return float(text) if text else float("nan")
    except ValueError:
        raise DataFormatError(f"frame {row['frame']}: {name}: a number expected, got {text!r}") from None
