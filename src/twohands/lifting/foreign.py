"""What any hand tracker says, in one form, and the checks that every adapter shares.

Conventions: pixels (u, v) from the outer corner of the first pixel; shapes x right, y down, z away from the camera.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from twohands.errors import DataFormatError
from twohands.geometry.lifting import View
from twohands.skeleton import LEFT, N_JOINTS, RIGHT
from twohands.types import PinholeCamera

LARGEST: Final = 1e9
"""No pixel and no joint is larger, in any unit; beyond, products overflow."""


@dataclass(frozen=True, slots=True)
class ForeignHand:
    """One hand as another tracker found it.

    Attributes:
        side: LEFT or RIGHT, the person's own, in an unmirrored picture.
        joints_px: (21, 2) pixels of the camera's picture; NaN for a joint that was not found.
        joints_3d: (21, 3) shape of any unit and origin; None for a tracker that knows only the picture.
        score: 0..1, of the hand; None where nothing is said.
        joint_scores: (21,) 0..1; None where nothing is said.
    """

    side: int
    joints_px: np.ndarray
    joints_3d: np.ndarray | None = None
    score: float | None = None
    joint_scores: np.ndarray | None = None


@dataclass(frozen=True, slots=True)
class ForeignFrame:
    """What was found in one picture.

    Attributes:
        hands: any number of each side.
        index: position in the source.
        time_s: seconds; None where it is not known.
        file: the picture's name; None for frames of a video.
    """

    hands: tuple[ForeignHand, ...]
    index: int
    time_s: float | None = None
    file: str | None = None


@dataclass(frozen=True, slots=True)
class ForeignHands:
    """All that was read from one source.

    Attributes:
        system: the tracker, in words.
        view: whose axes its shapes have (`geometry.lifting.View`).
        bone_ratio: distance from wrist to middle knuckle where this tracker puts them, in hand lengths of ours.
        frames: in the order of the source.
    """

    system: str
    view: View
    bone_ratio: float
    frames: tuple[ForeignFrame, ...]


def field(record: Any, *names: str) -> Any:
    """The first of several names that a dictionary holds or an object has; None where there is none."""
    for name in names:
        if isinstance(record, Mapping):
            if name in record:
                return record[name]
        elif not isinstance(record, str | bytes | Sequence | np.ndarray) and hasattr(record, name):
            return getattr(record, name)
    return None


def has(record: Any, *names: str) -> bool:
    """Whether one of the names is there."""
    return field(record, *names) is not None


def is_list(value: Any) -> bool:
    """A sequence of things: list, tuple, array, repeated field of a protocol buffer; no text, no dictionary."""
    return hasattr(value, "__len__") and hasattr(value, "__getitem__") and not isinstance(value, str | bytes | Mapping)


def numbers(name: str, values: Any, shape: tuple[int | None, ...], *, finite: bool = True) -> np.ndarray:
    """An array of numbers of the wanted shape; a torch tensor will do.

    Args:
        name: of the key, for the message.
        values: nested lists, an array or a tensor.
        shape: None for any size.
        finite: refuse NaN and infinity.

    Raises:
        DataFormatError: something else is there; says what was expected.
    """
    wanted = "(" + ", ".join("N" if size is None else str(size) for size in shape) + ("," * (len(shape) == 1)) + ")"
    try:
        array = np.asarray(values.detach().cpu() if hasattr(values, "detach") else values)
        if array.dtype.kind not in "fiub":  # text that reads as a number, None, dictionaries
            raise ValueError
        array = array.astype(np.float64)
    except (TypeError, ValueError, OverflowError):
        raise DataFormatError(f"{name}: numbers of shape {wanted} expected") from None
    if array.ndim != len(shape) or any(want not in (None, got) for want, got in zip(shape, array.shape, strict=True)):
        raise DataFormatError(f"{name}: shape {wanted} expected, got {array.shape}")
    if finite and not np.isfinite(array).all():
        raise DataFormatError(f"{name}: {int((~np.isfinite(array)).sum())} of {array.size} numbers are not finite")
    if (abs(array) > LARGEST).any():
        raise DataFormatError(f"{name}: numbers up to {LARGEST:g} expected, got one of {np.nanmax(abs(array)):g}")
    return array


def joints(name: str, values: Any, width: int) -> np.ndarray:
    """(21, width) finite numbers.

    Raises:
        DataFormatError: another number of joints, or of numbers for each.
    """
    count = len(values) if is_list(values) else 0
    if count and count != N_JOINTS:
        raise DataFormatError(f"{name}: {N_JOINTS} joints expected, got {count}")
    return numbers(name, values, (N_JOINTS, width))


def share(name: str, value: Any) -> float:
    """A score, 0..1; one that float32 has rounded to a little above is 1.

    Raises:
        DataFormatError: no such number.
    """
    score = float(numbers(name, value, ()))
    if not -1e-3 <= score <= 1.001:
        raise DataFormatError(f"{name}: a number from 0 to 1 expected, got {score:g}")
    return min(max(score, 0.0), 1.0)


def side_of(name: str, is_right: Any) -> int:
    """LEFT or RIGHT of a flag such as MANO's `is_right`: 0 or 1.

    Raises:
        DataFormatError: another value.
    """
    value = float(numbers(name, np.squeeze(is_right) if is_list(is_right) else is_right, ()))
    if value not in (0.0, 1.0):
        raise DataFormatError(f"{name}: 0 (left) or 1 (right) expected, got {value:g}")
    return RIGHT if value else LEFT


def check_picture_size(name: str, width: float, height: float, camera: PinholeCamera) -> None:
    """That a file speaks of pictures of the camera's size.

    Raises:
        DataFormatError: it speaks of others.
    """
    if (round(width), round(height)) != (camera.width, camera.height):
        raise DataFormatError(
            f"{name}: pictures of {width:g}x{height:g}, but the camera is for {camera.width}x{camera.height}; "
            "give the camera of this size"
        )


def check_in_picture(name: str, joints_px: np.ndarray, camera: PinholeCamera) -> None:
    """That pixels can be those of this camera: the middle of a found hand lies in the picture, or near it.

    Raises:
        DataFormatError: it lies farther away than the picture is large, or all joints lie within one pixel.
    """
    known = joints_px[np.isfinite(joints_px).all(axis=-1)]
    if not len(known):
        return
    if np.ptp(known, axis=0).max() <= 1 and len(known) > 1:
        raise DataFormatError(f"{name}: pixels expected, got joints within one pixel of each other")
    size = np.array([camera.width, camera.height])
    middle = np.median(known, axis=0)
    if (middle < -size / 2).any() or (middle > 1.5 * size).any():
        raise DataFormatError(
            f"{name}: a hand at ({middle[0]:.0f}, {middle[1]:.0f}) px, but the camera is for "
            f"{camera.width}x{camera.height}; give the camera of these pictures"
        )
