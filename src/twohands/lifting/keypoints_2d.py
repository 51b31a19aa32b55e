"""Trackers that know the picture alone: OpenPose, MMPose, rtmlib. Their hands need a shape from elsewhere.

All count pixels from the first pixel's centre: 0.5 is added.

- OpenPose's `--write_json`: `people` with `hand_left_keypoints_2d` and `hand_right_keypoints_2d`, 21 times u, v, score.
- MMPose's predictions: instances with `keypoints` and `keypoint_scores`; rtmlib's arrays under `keypoints` (or
  `keypoints_2d`) and `scores`. 133 joints are COCO-WholeBody, both hands in it; 21 are one hand whose side nobody says.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from twohands.errors import DataFormatError
from twohands.lifting.foreign import ForeignHand, check_in_picture, field, has, is_list, numbers
from twohands.skeleton import LEFT, N_JOINTS, RIGHT, SIDES
from twohands.types import PinholeCamera

WHOLE_BODY: Final = 133
_HAND_STARTS: Final = {LEFT: 91, RIGHT: 112}
"""Where the hands begin in COCO-WholeBody."""
_TO_CORNER: Final = 0.5


def is_openpose_frame(record: Any) -> bool:
    """Whether a record is what OpenPose writes for one picture."""
    return isinstance(record, Mapping) and is_list(record.get("people"))


def openpose_hands(record: Any, camera: PinholeCamera) -> tuple[ForeignHand, ...]:
    """Hands of all people of one picture; those without a found joint are left out.

    Raises:
        DataFormatError: a key is missing or holds something else.
    """
    found: list[ForeignHand] = []
    for person in record["people"]:
        for side, word in enumerate(SIDES):
            name = f"hand_{word}_keypoints_2d"
            values = field(person, name)
            if values is None:
                raise DataFormatError(f"{name}: missing; OpenPose writes it with --hand")
            if not is_list(values) or len(values) not in (0, 3 * N_JOINTS):
                count = len(values) / 3 if is_list(values) else 0
                raise DataFormatError(f"{name}: {N_JOINTS} joints of u, v, score expected, got {count:g}")
            if len(values):
                points = numbers(name, values, (3 * N_JOINTS,)).reshape(N_JOINTS, 3)
                found += _scored(name, side, points[:, :2], points[:, 2], camera)
    return tuple(found)


def is_mmpose_frame(record: Any) -> bool:
    """Whether a record is MMPose's list of instances, or rtmlib's arrays, of one picture."""
    if is_list(record):
        return len(record) > 0 and all(isinstance(one, Mapping) and has(one, "keypoints") for one in record)
    return has(record, "keypoints") and has(record, "scores", "keypoint_scores")


def mmpose_hands(record: Any, camera: PinholeCamera, side: int | None) -> tuple[ForeignHand, ...]:
    """Hands of one picture.

    Args:
        record: MMPose's instances, or rtmlib's arrays.
        camera: of the picture.
        side: of the hands of a model of single hands; None where nobody says.

    Raises:
        DataFormatError: a key is missing or holds something else, or the side is needed.
    """
    found: list[ForeignHand] = []
    for points, scores in _instances(record):
        if len(points) == WHOLE_BODY:
            for which, start in _HAND_STARTS.items():
                rows = slice(start, start + N_JOINTS)
                found += _scored("keypoints", which, points[rows], scores[rows], camera)
        elif len(points) == N_JOINTS:
            if side is None:
                raise DataFormatError("keypoints: 21 joints of one hand, and nobody says of which; give --side")
            found += _scored("keypoints", side, points, scores, camera)
        else:
            raise DataFormatError(
                f"keypoints: {N_JOINTS} joints (a hand) or {WHOLE_BODY} (whole body) expected, got {len(points)}"
            )
    return tuple(found)


def _instances(record: Any) -> list[tuple[np.ndarray, np.ndarray]]:
    """Joints (K, 2) and scores (K,) of everybody in the picture."""
    if is_list(record):
        return [pair for one in record for pair in _instances(one)]
    points = field(record, "keypoints_2d", "keypoints")
    scores = field(record, "keypoint_scores", "scores")
    if not is_list(points):
        raise DataFormatError("keypoints: a list of joints expected")
    if not len(points):
        return []
    many = np.ndim(points[0]) == 2
    array = numbers("keypoints", points, (None, None, None) if many else (None, None))
    array = array if many else array[None]
    if array.shape[-1] != 2:
        raise DataFormatError(
            f"keypoints: u and v expected for each joint, got {array.shape[-1]} numbers; 3D models' pictures are not "
            "where their keypoints are: give their 2D joints"
        )
    if scores is None:
        raise DataFormatError("keypoint_scores: missing")
    scored = numbers("keypoint_scores", scores, (None,) * (2 if many else 1))
    scored = scored if many else scored[None]
    if scored.shape != array.shape[:2]:
        raise DataFormatError(f"keypoint_scores: shape {array.shape[:2]} expected, as of keypoints, got {scored.shape}")
    return list(zip(array, scored, strict=True))


def _scored(name: str, side: int, points: np.ndarray, scores: np.ndarray, camera: PinholeCamera) -> list[ForeignHand]:
    """A hand with its scores; none where no joint was found."""
    known = scores > 0
    if not known.any():
        return []
    pixels = np.where(known[:, None], points + _TO_CORNER, np.nan)
    check_in_picture(name, pixels, camera)
    joint_scores = np.clip(scores, 0.0, 1.0)
    return [ForeignHand(side, pixels, None, float(joint_scores.mean()), joint_scores)]
