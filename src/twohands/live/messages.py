"""What clients send: pictures, the beginning and end of a clip, a hand at a taped distance (docs/stream.md).

Anything else is refused.
"""

from __future__ import annotations

import json
import math
import struct
from dataclasses import dataclass
from typing import Any, Final, get_args

import numpy as np

from twohands.errors import InputError, MissingExtraError
from twohands.formats.picture_kinds import kind_of
from twohands.formats.pictures import decode_image
from twohands.formats.profiles import ScaleSource

MAX_BYTES: Final = 2_000_000
"""Of a message."""
MAX_PICTURE_PIXELS: Final = 16_000_000
"""Of a picture: few bytes may decode to many."""
TAPE_RANGE_M: Final = (0.1, 5.0)
"""Distances that can be taped."""
_MAX_SOURCE: Final = 200
_TIME: Final = struct.Struct("<d")
_TIME_AND_AGE: Final = struct.Struct("<dd")


@dataclass(frozen=True, slots=True)
class Settings:
    """Of one clip.

    Attributes:
        source: its name, for people.
        hand_length_m: |wrist - middle knuckle|, metres.
        fov_deg: horizontal field of view; None where it is not known.
        mirrored: pictures are turned back before anything else.
        scale_source: how the hand length is known.
    """

    source: str
    hand_length_m: float
    fov_deg: float | None = None
    mirrored: bool = False
    scale_source: ScaleSource = "typed"


@dataclass(frozen=True, slots=True)
class Begin:
    """A clip begins."""

    settings: Settings


@dataclass(frozen=True, slots=True)
class End:
    """The client's clip is over."""


@dataclass(frozen=True, slots=True)
class Measure:
    """One hand is held at a distance from the lens, metres; None: no more."""

    distance_m: float | None


def parse_text(text: str) -> Begin | End | Measure:
    """A text message: `{"begin": {...}}`, `{"end": true}` or `{"measure": {"distance_m": ...}}`.

    Raises:
        InputError: it is something else, or a value cannot be.
    """
    try:
        record = json.loads(text)
    except (ValueError, RecursionError):
        raise InputError("text messages are JSON") from None
    if record == {"end": True}:
        return End()
    word = next(iter(record), None) if isinstance(record, dict) and len(record) == 1 else None
    if word not in ("begin", "measure") or not isinstance(record[word], dict):
        raise InputError('{"begin": {...}}, {"measure": {...}} or {"end": true} expected')
    return _begin(record["begin"]) if word == "begin" else _measure(record["measure"])


def _begin(given: dict[str, Any]) -> Begin:
    _refuse_others("begin", given, {"source", "hand_length_m", "fov_deg", "mirrored", "scale_source"})
    source, mirrored = given.get("source", "stream"), given.get("mirrored", False)
    scale_source = given.get("scale_source", "typed")
    if not isinstance(source, str):
        raise InputError("begin: source must be text")
    if not isinstance(mirrored, bool):
        raise InputError("begin: mirrored must be true or false")
    if scale_source not in get_args(ScaleSource):
        raise InputError(f"begin: scale_source must be one of {', '.join(get_args(ScaleSource))}")
    length_m = _number("begin", given, "hand_length_m")
    if length_m is None or not 0 < length_m < 1:
        raise InputError(f"begin: hand_length_m must be metres between 0 and 1, got {length_m}")
    fov_deg = _number("begin", given, "fov_deg")
    if fov_deg is not None and not 1 <= fov_deg <= 179:
        raise InputError(f"begin: fov_deg must lie between 1 and 179 degrees, got {fov_deg:g}")
    name = "".join(filter(str.isprintable, source))[:_MAX_SOURCE]
    return Begin(Settings(name, length_m, fov_deg, mirrored, scale_source))


def _measure(given: dict[str, Any]) -> Measure:
    _refuse_others("measure", given, {"distance_m"})
    distance_m = _number("measure", given, "distance_m")
    if distance_m is not None and not TAPE_RANGE_M[0] <= distance_m <= TAPE_RANGE_M[1]:
        raise InputError(
            f"measure: distance_m must lie between {TAPE_RANGE_M[0]:g} and {TAPE_RANGE_M[1]:g} m, got {distance_m:g}"
        )
    return Measure(distance_m)


def parse_picture(data: bytes) -> tuple[float, np.ndarray]:
    """A binary message: the picture's time in seconds as a little-endian double, then a JPEG, PNG or WebP file.

    Returns:
        The time, and (H, W, 3) uint8 RGB.

    Raises:
        InputError: it is too short or too large, the time is not finite, or the picture cannot be read.
    """
    if len(data) > MAX_BYTES:
        raise InputError(f"a message may have {MAX_BYTES} bytes")
    if len(data) <= _TIME.size:
        raise InputError("a picture's message is its time, 8 bytes, and the picture")
    (time_s,) = _TIME.unpack_from(data)
    if not (math.isfinite(time_s) and abs(time_s) < 1e9):
        raise InputError("a picture's time must be a finite number of seconds")
    content = data[_TIME.size :]
    kind = kind_of(content)
    if kind is None or kind.name not in ("JPEG", "PNG", "WebP"):
        raise InputError("a picture is a JPEG, PNG or WebP file")
    extent = kind.extent(content)
    if extent is not None and extent.width * extent.height > MAX_PICTURE_PIXELS:
        raise InputError(f"a picture may have {MAX_PICTURE_PIXELS} pixels")
    try:
        return time_s, decode_image(content)
    except MissingExtraError as error:
        raise InputError(str(error)) from None


def picture_message(jpeg: bytes, time_s: float, age_s: float) -> bytes:
    """What is sent before a frame's line to clients that want pictures: time and age in seconds as little-endian
    doubles, then the picture file."""
    return _TIME_AND_AGE.pack(time_s, age_s) + jpeg


def picture_of(message: bytes) -> bytes:
    """The picture file in a message that a client has sent."""
    return message[_TIME.size :]


def _refuse_others(word: str, given: dict[str, Any], known: set[str]) -> None:
    if unknown := sorted(set(given) - known):
        raise InputError(f"{word}: unknown key {unknown[0][:40]!r}")


def _number(word: str, record: dict[str, Any], name: str) -> float | None:
    value = record.get(name)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{word}: {name} must be a number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InputError(f"{word}: {name} must be a finite number")
    return number
