"""Results of WiLoR, WiLoR-mini and HaMeR: MANO's joints of crops.

Two states of the same numbers are met:

- as the networks return them (HaMeR and WiLoR's `out`, with `right`, `box_center` and `box_size` of the batch): every
  hand is a right one, 2D joints are fractions of the crop, -0.5..0.5 about its middle;
- as WiLoR-mini returns them, list of hands with `is_right` and `wilor_preds`: left hands are turned back, and 2D joints
  are pixels of the picture.

The focal length behind their `pred_cam_t` is assumed (5000 / 256 of the picture's longer side), so the place it tells
is not used.
"""

from __future__ import annotations

from typing import Any, Final

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
    numbers,
    side_of,
)
from twohands.skeleton import RIGHT
from twohands.types import PinholeCamera

BONE_RATIO: Final = 0.85
"""MANO's distance from wrist to middle knuckle beside our hand length: that of its mean hand beside 0.6 of the mean
hand's length. Both of its ends lie in the bones."""

_FOCAL_PER_SIDE: Final = 5000 / 256
_SHAPE: Final = "pred_keypoints_3d"
_PIXELS: Final = "pred_keypoints_2d"
_RIGHT: Final = ("is_right", "right")


def is_frame(record: Any) -> bool:
    """Whether a record is WiLoR's or HaMeR's result for one picture: hands in a list, or arrays of N hands."""
    if is_list(record):
        return len(record) > 0 and all(has(hand, "wilor_preds", _SHAPE) for hand in record)
    return has(record, "wilor_preds", _SHAPE)


def hands(record: Any, camera: PinholeCamera) -> tuple[ForeignHand, ...]:
    """Hands of one picture.

    Args:
        record: a list of hands, one hand, or a dictionary of arrays (N, ...), numpy or torch.
        camera: of the picture.

    Raises:
        DataFormatError: a key is missing or holds something else, or the picture had another size.
    """
    if is_list(record):
        return tuple(found for hand in record for found in hands(hand, camera))
    inner = field(record, "wilor_preds") or record
    shapes, pixels = field(inner, _SHAPE), field(inner, _PIXELS)
    right = field(record, *_RIGHT)
    for name, value in ((_SHAPE, shapes), (_PIXELS, pixels), ("is_right", right)):
        if value is None:
            raise DataFormatError(f"{name}: missing; needed: {_SHAPE}, {_PIXELS}, is_right")
    shapes, pixels = (_batch(name, value) for name, value in ((_SHAPE, shapes), (_PIXELS, pixels)))
    count = len(shapes)
    sides = [side_of("is_right", value) for value in np.ravel(numbers("is_right", _flat(right), (None,)))]
    if len(sides) != count or len(pixels) != count:
        raise DataFormatError(
            f"is_right and {_PIXELS}: {count} hands expected, as of {_SHAPE}, got {len(sides)} and {len(pixels)}"
        )
    _check_size(record, inner, camera)
    turned = np.array([1.0 if side == RIGHT else -1.0 for side in sides])
    joints_3d = [joints(_SHAPE, shape, 3) for shape in shapes]
    joints_px = [joints(_PIXELS, points, 2) for points in pixels]
    if has(record, "box_center"):
        centre = numbers("box_center", _rows(field(record, "box_center"), 2), (count, 2))
        size = numbers("box_size", _flat(field(record, "box_size")), (count,))
        joints_3d = [shape * [turn, 1, 1] for shape, turn in zip(joints_3d, turned, strict=True)]
        joints_px = [
            points * [turn, 1] * size[i] + centre[i]
            for i, (points, turn) in enumerate(zip(joints_px, turned, strict=True))
        ]
    elif any(abs(points).max() <= 1 for points in joints_px):
        raise DataFormatError(
            f"{_PIXELS}: fractions of the crop; box_center, box_size and right of the batch are needed"
        )
    for points in joints_px:
        check_in_picture(_PIXELS, points, camera)
    return tuple(ForeignHand(*parts) for parts in zip(sides, joints_px, joints_3d, strict=True))


def _check_size(record: Any, inner: Any, camera: PinholeCamera) -> None:
    """That the picture had the camera's size, where the record says so."""
    size, focal = field(record, "img_size"), field(inner, "scaled_focal_length")
    if size is not None:
        for width, height in numbers("img_size", _rows(size, 2), (None, 2)):
            check_picture_size("img_size", width, height, camera)
    elif focal is not None:
        longer = float(np.ravel(numbers("scaled_focal_length", _flat(focal), (None,)))[0]) / _FOCAL_PER_SIDE
        if abs(longer - max(camera.width, camera.height)) > 1:
            raise DataFormatError(
                f"scaled_focal_length: of pictures {longer:.0f} px along the longer side, but the camera is for "
                f"{camera.width}x{camera.height}; give the camera of this size"
            )


def _batch(name: str, values: Any) -> np.ndarray:
    """(N, joints, axes), of one hand or of many."""
    array = numbers(name, values, (None,) * (3 if np.ndim(_plain(values)) == 3 else 2))
    return array if array.ndim == 3 else array[None]


def _rows(values: Any, width: int) -> np.ndarray:
    array = np.asarray(_plain(values))
    return array.reshape(-1, width) if array.dtype.kind in "fiu" and array.size % width == 0 else array


def _flat(values: Any) -> Any:
    return np.ravel(np.asarray(_plain(values)))


def _plain(values: Any) -> Any:
    return values.detach().cpu().numpy() if hasattr(values, "detach") else values
