"""Results of MediaPipe Hands: the legacy solution, the Tasks API, tasks-vision of the browser.

They are one thing under three sets of names: joints as fractions of the picture, "world" joints in metres about the
hand's middle, seen by a camera that looks at the hand, and a label. The legacy solution names hands as in a mirrored
(selfie) picture; the Tasks API, Python and browser, names the person's own. Measured on clips of signers and of an open
palm: where 0.10.21 says `Left` by `mp.solutions.hands`, it says `Right` by its own Tasks API, and so does 1.2.2.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final, Literal

import numpy as np

from twohands.errors import DataFormatError
from twohands.lifting.foreign import (
    ForeignHand,
    check_in_picture,
    check_picture_size,
    field,
    has,
    is_list,
    joints,
    share,
)
from twohands.skeleton import LEFT, RIGHT
from twohands.types import PinholeCamera

Names = Literal["own", "mirrored"]
"""What a tracker's "Left" means: the person's left hand, or what would be it if the picture were mirrored."""

_LEGACY_JOINTS: Final = ("multi_hand_landmarks", "multiHandLandmarks")
_JOINTS: Final = ("hand_landmarks", "landmarks", *_LEGACY_JOINTS)
_WORLD: Final = (
    "hand_world_landmarks",
    "worldLandmarks",
    "world_landmarks",
    "multi_hand_world_landmarks",
    "multiHandWorldLandmarks",
)
_SIDES: Final = ("handedness", "handednesses", "multi_handedness", "multiHandedness")
_LABEL: Final = ("category_name", "categoryName", "label")


def is_frame(record: Any) -> bool:
    """Whether a record is MediaPipe's result for one picture."""
    if not has(record, *_JOINTS) and not (has(record, *_SIDES) and has(record, *_WORLD)):
        # the legacy solution's Python object holds None where it found nothing
        return not isinstance(record, dict) and any(hasattr(record, name) for name in _LEGACY_JOINTS)
    return is_list(field(record, *_JOINTS))


def hands(record: Any, camera: PinholeCamera, names: Names | None = None) -> tuple[ForeignHand, ...]:
    """Hands of one picture.

    Args:
        record: a result as MediaPipe returns it, or as JSON holds it.
        camera: of the picture; fractions become its pixels.
        names: what "Left" means; None for what this API is known for.

    Raises:
        DataFormatError: a key is missing or holds something else.
    """
    marks = field(record, *_JOINTS) or ()
    world, sides = field(record, *_WORLD), field(record, *_SIDES)
    if len(marks) and not is_list(world):
        raise DataFormatError("worldLandmarks: missing; 21 joints in metres expected for each hand")
    if len(marks) and not is_list(sides):
        raise DataFormatError("handedness: missing; one label expected for each hand")
    for name, values in (("worldLandmarks", world), ("handedness", sides)):
        if len(marks) and len(values) != len(marks):
            raise DataFormatError(f"{name}: {len(marks)} hands expected, as of landmarks, got {len(values)}")
    if has(record, "width") and has(record, "height"):
        check_picture_size("width, height", record["width"], record["height"], camera)
    mirrored = has(record, *_LEGACY_JOINTS) if names is None else names == "mirrored"
    return _one_of_each(
        [_hand(*parts, camera, mirrored) for parts in zip(marks, world or (), sides or (), strict=True)]
    )


def _one_of_each(found: list[ForeignHand]) -> tuple[ForeignHand, ...]:
    """Of two hands with one side, the less certain is the other one: MediaPipe looks at each hand alone, and two hands
    in a picture are mostly one person's."""
    if len(found) == 2 and found[0].side == found[1].side:
        doubted = min((0, 1), key=lambda i: (found[i].score or 0.0, -i))
        found[doubted] = replace(found[doubted], side=1 - found[doubted].side)
    return tuple(found)


def _hand(marks: Any, world: Any, side: Any, camera: PinholeCamera, mirrored: bool) -> ForeignHand:
    side = field(side, "classification") or side  # a message of the legacy solution
    best = side[0] if is_list(side) and len(side) else side
    label = field(best, *_LABEL)
    if label not in ("Left", "Right"):
        raise DataFormatError(f"handedness: 'Left' or 'Right' expected, got {label!r}")
    score = field(best, "score")
    joints_px = _points("landmarks", marks, ("x", "y")) * [camera.width, camera.height]
    check_in_picture("landmarks", joints_px, camera)
    return ForeignHand(
        side=LEFT if (label == "Left") != mirrored else RIGHT,
        joints_px=joints_px,
        joints_3d=_points("worldLandmarks", world, ("x", "y", "z")),
        score=None if score is None else share("handedness score", score),
    )


def _points(name: str, marks: Any, axes: tuple[str, ...]) -> np.ndarray:
    """(21, axes) of landmarks that are objects with x, y, z or lists of these."""
    marks = field(marks, "landmark") or marks
    if not is_list(marks):
        raise DataFormatError(f"{name}: a list of 21 joints expected, got {type(marks).__name__}")
    plain = [list(mark)[: len(axes)] if is_list(mark) else [field(mark, axis) for axis in axes] for mark in marks]
    return joints(name, plain, len(axes))
