"""What a user has measured once, kept under a name: a camera, a hand length, and how each came to be known.

A profile is a JSON file, twohands/profiles/NAME.json in $XDG_CONFIG_HOME or ~/.config::

    {"version": 1, "camera": {"fx", "fy", "cx", "cy", "width", "height"[, "distortion"]} or null,
     "intrinsics_source": "board", "hand_length_m": 0.112 or null, "scale_source": "distance"}
"""

from __future__ import annotations

import json
import math
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, get_args

from twohands.errors import DataFormatError, InputError
from twohands.formats.structured import read_json
from twohands.types import PinholeCamera

VERSION: Final = 1
ScaleSource = Literal["typed", "board", "distance", "assumed"]
"""How a hand length came to be known: said by the user, beside the printed board, at a taped distance, or not."""
IntrinsicsSource = Literal["file", "fov", "board", "exif", "assumed"]
"""How a camera came to be known: a camera file or object, a field of view that the user said, the printed board, what
the picture itself notes, or not."""

_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_KEYS: Final = ("camera", "intrinsics_source", "hand_length_m", "scale_source")
_CAMERA_KEYS: Final = ("fx", "fy", "cx", "cy", "width", "height")


@dataclass(frozen=True, slots=True)
class Profile:
    """What is known.

    Attributes:
        camera: None where it is not.
        intrinsics_source: None where there is no camera.
        hand_length_m: |wrist - middle knuckle| in metres; None where it is not known. One from a taped distance holds
            together with this camera alone.
        scale_source: None where there is no length.
    """

    camera: PinholeCamera | None = None
    intrinsics_source: IntrinsicsSource | None = None
    hand_length_m: float | None = None
    scale_source: ScaleSource | None = None


def profile_path(name: str) -> Path:
    """Where the profile of a name lies; it need not exist.

    Raises:
        InputError: a name with other signs than letters, digits, dot, minus and underscore.
    """
    if not _NAME.fullmatch(name):
        raise InputError(f"--profile {name[:60]!r}: a name of letters, digits, '.', '-' and '_' expected, at most 64")
    home = os.environ.get("XDG_CONFIG_HOME", "")
    folder = Path(home) if os.path.isabs(home) else Path(os.path.expanduser("~")) / ".config"
    return folder / "twohands" / "profiles" / f"{name}.json"


def profile_bytes(profile: Profile) -> bytes:
    """The content of a profile's file."""
    camera = profile.camera
    record: dict[str, Any] = {"version": VERSION, "camera": None if camera is None else camera_record(camera)}
    record |= {name: getattr(profile, name) for name in _KEYS[1:]}
    return (json.dumps(record, indent=1) + "\n").encode()


def camera_record(camera: PinholeCamera) -> dict[str, Any]:
    """A camera as our camera files have it: cx and cy from the outer corner of the first pixel."""
    record: dict[str, Any] = {name: getattr(camera, name) for name in _CAMERA_KEYS}
    return record | ({"distortion": list(camera.distortion)} if camera.distortion else {})


def read_profile(name: str) -> Profile:
    """Reads the profile of a name.

    Raises:
        InputError: there is none of this name, or it cannot be read.
        DataFormatError: the file holds something else.
    """
    path = profile_path(name)
    if not path.is_file():
        raise InputError(f"no profile '{name}' ({path}); make one: twohands calibrate camera CLIP --profile {name}")
    record = read_json(path, dict, "profile")
    try:
        return _profile(record)
    except (InputError, KeyError, TypeError, ValueError) as error:
        raise DataFormatError(f"{path}: not a profile of version {VERSION} ({error}); make it again") from None


def _profile(record: dict[str, Any]) -> Profile:
    if record.get("version") != VERSION or set(record) != {"version", *_KEYS}:
        raise ValueError(f"keys {', '.join(sorted(record))}")
    camera = record["camera"]
    if camera is not None:
        numbers = {name: camera[name] for name in _CAMERA_KEYS}
        camera = PinholeCamera(**numbers, distortion=tuple(camera.get("distortion", ())))
    length, intrinsics, scale = (record[name] for name in ("hand_length_m", "intrinsics_source", "scale_source"))
    if length is not None and not (isinstance(length, float) and math.isfinite(length) and length > 0):
        raise ValueError(f"hand_length_m of {length}")
    if intrinsics not in (None, *get_args(IntrinsicsSource)) or scale not in (None, *get_args(ScaleSource)):
        raise ValueError(f"sources {intrinsics} and {scale}")
    if (camera is None) != (intrinsics is None) or (length is None) != (scale is None):
        raise ValueError("a camera or length without its source")
    return Profile(camera, intrinsics, length, scale)
