"""hands.json, version 1: results as plain JSON, and back.

Layout::

    {"version": 1, "source": ..., "weights": ..., "config": ..., "hand_length_m": ..., "frames": [
        {"index": 0, "file": ..., "time_s": null,
         "camera": {"fx", "fy", "cx", "cy", "width", "height"},
         "hands": {"left": H, "right": H}, "between_hands_m": [3], "overlap"}]}

    H = {"present", "score", "box_px": [u0, v0, u1, v1], "joints_px": [21][2], "joint_scores": [21],
         "canonical": [21][3], "joints_m": [21][3], "range_m", "theta_deg", "phi_deg", "key_bone", "method", "valid",
         "range_sigma_m", "scale_source", "intrinsics_source"}

`config` holds every hand-tuned number behind the results, `WeightsCard.settings`; null where they are not known.
`file` is the picture's name, null for frames of a video; `index` is its position among all pictures of the source,
those that were skipped included. An absent hand has `present` false and null elsewhere. Where `valid` is false,
`joints_m` and `range_m` are null. A camera with lens distortion carries the further key `distortion`. Numbers are
rounded to DECIMALS; JSON has no NaN, so NaN is null.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from twohands.errors import DataFormatError, TwoHandsError
from twohands.skeleton import N_JOINTS
from twohands.types import HandPose, PinholeCamera, TwoHandPose

VERSION = 1
DECIMALS = 6
"""A micrometre, a millionth of a pixel: below anything a measurement can tell."""

_FOR_VIDEOS = ("side_logit", "pair", "other_px", "range_shares", "body_range_m")
_KEYS = tuple(f.name for f in fields(HandPose) if f.name not in _FOR_VIDEOS)
"""Of a hand; the others are for the next frame."""
_NEWER = ("range_sigma_m", "scale_source", "intrinsics_source")
"""Fields that files from before them lack."""
_SHAPES: dict[str, tuple[int, ...]] = {
    "box_px": (4,),
    "joints_px": (N_JOINTS, 2),
    "joint_scores": (N_JOINTS,),
    "canonical": (N_JOINTS, 3),
    "joints_m": (N_JOINTS, 3),
}


def to_dict(
    poses: Sequence[TwoHandPose],
    *,
    source: str,
    weights: str,
    config: dict[str, Any] | None = None,
    hand_length_m: float | None = None,
    files: Sequence[str] | Mapping[int, str] | None = None,
) -> dict[str, Any]:
    """Results as a JSON-ready dictionary.

    Args:
        poses: one per frame.
        source: the file or folder they come from.
        weights: name of the weights.
        config: `WeightsCard.settings`; None where they are not known.
        hand_length_m: |wrist - middle knuckle| that all lengths scale with, metres; None where it is not known.
        files: names of the source's pictures, by `TwoHandPose.index`; None where there are none.
    """
    return {
        "version": VERSION,
        "source": source,
        "weights": weights,
        "config": config,
        "hand_length_m": hand_length_m,
        "frames": [
            {
                "index": pose.index,
                "file": None if files is None else files[pose.index],
                "time_s": _number(pose.time_s),
                "camera": _camera_to_dict(pose.camera),
                "hands": {"left": _hand_to_dict(pose.left), "right": _hand_to_dict(pose.right)},
                "between_hands_m": _plain(pose.between_hands_m),
                "overlap": _number(pose.overlap),
            }
            for pose in poses
        ],
    }


def from_dict(record: dict[str, Any]) -> list[TwoHandPose]:
    """Read results back; masks are not part of the record.

    Raises:
        DataFormatError: another version, or a key that is missing or holds something else.
    """
    if not isinstance(record, dict) or record.get("version") != VERSION:
        found = record.get("version") if isinstance(record, dict) else type(record).__name__
        raise DataFormatError(f"hands.json: version {VERSION} expected, found {found!r}")
    try:
        return [
            TwoHandPose(
                left=_hand_from_dict(frame["hands"]["left"]),
                right=_hand_from_dict(frame["hands"]["right"]),
                camera=_camera_from_dict(frame["camera"]),
                index=int(frame["index"]),
                time_s=frame["time_s"],
            )
            for frame in record["frames"]
        ]
    except KeyError as error:
        raise DataFormatError(f"hands.json: key {error} is missing") from error
    except (TypeError, ValueError, TwoHandsError) as error:
        raise DataFormatError(f"hands.json: {error}") from error


def _camera_to_dict(camera: PinholeCamera) -> dict[str, Any]:
    record: dict[str, Any] = {name: _number(getattr(camera, name)) for name in ("fx", "fy", "cx", "cy")}
    record |= {"width": int(camera.width), "height": int(camera.height)}
    if camera.distortion:
        record["distortion"] = list(camera.distortion)
    return record


def _camera_from_dict(record: dict[str, Any]) -> PinholeCamera:
    intrinsics = (record[name] for name in ("fx", "fy", "cx", "cy", "width", "height"))
    return PinholeCamera(*intrinsics, distortion=tuple(record.get("distortion", ())))


def _hand_to_dict(hand: HandPose) -> dict[str, Any]:
    return {name: _plain(getattr(hand, name)) for name in _KEYS}


def _hand_from_dict(record: dict[str, Any]) -> HandPose:
    values: dict[str, Any] = {name: record.get(name) if name in _NEWER else record[name] for name in _KEYS}
    for name, shape in _SHAPES.items():
        if values[name] is not None:
            values[name] = np.array(values[name], np.float64)  # null inside an array becomes NaN
            if values[name].shape != shape:
                raise ValueError(f"{name} must have shape {shape}, found {values[name].shape}")
    return HandPose(**values)


def _plain(value: Any) -> Any:
    """A field of HandPose as JSON knows it."""
    if isinstance(value, np.ndarray):
        return [_plain(item) for item in value.tolist()]
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return _number(value) if isinstance(value, float) else value


def _number(value: float | None) -> float | None:
    """Rounded; None where there is no finite number."""
    return round(value, DECIMALS) if value is not None and math.isfinite(value) else None
