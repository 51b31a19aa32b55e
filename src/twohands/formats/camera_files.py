"""Cameras from files, ours and those of the usual calibration tools; what is read is listed in docs/inputs.md.

Every key of a file is either used, or known to say nothing about the lens (`NO_MATTER`), or refused: a coefficient
under a name that a reader does not know would be lost, and every range with it be wrong. Another lens model than
OpenCV's pinhole with k1, k2, p1, p2, ... is refused by its name for the same reason.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from twohands.errors import DataFormatError, InputError
from twohands.formats.camera_keys import (
    COEFFICIENTS,
    CONTAINERS,
    FIELD_OF_KEY,
    FOCAL_ONLY_WHEN_STRAIGHT,
    FROM_PIXEL_CENTRES,
    LENS_IN_WORDS,
    NO_FISHEYE,
    NO_MATTER,
    OTHER_LENSES,
    PINHOLE,
    SLAM_FIELDS,
)
from twohands.formats.camera_numbers import in_words, is_matrix, number_of, numbers_of, plain_key
from twohands.formats.structured import decode_text, parse_json, parse_xml, parse_yaml, read_bytes
from twohands.types import PinholeCamera

MAX_CAMERA_BYTES: Final = 4 << 20
"""Of a camera file; OpenCV's may hold all points of its calibration."""
MOST_COEFFICIENTS: Final = 8
"""Distortion coefficients that `PinholeCamera` knows: OpenCV's k1, k2, p1, p2, k3 to k6."""
MOST_SKEW: Final = 1e-6
"""Of a camera matrix, over its focal length: rounding of whoever wrote it."""
MOST_BELOW: Final = 1e-8
"""Of a camera matrix's last row beside its last entry, over that: rounding, which moves no pixel by a thousandth."""
_OURS: Final = ("fx", "fy", "cx", "cy", "width", "height")
_COLMAP: Final[Mapping[str, tuple[str, ...]]] = {
    "SIMPLE_PINHOLE": ("focal", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("focal", "cx", "cy", "k1"),
    "RADIAL": ("focal", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}
"""Parameters of COLMAP's camera models, in its order."""
_NOTHING: Final[Mapping[str, str]] = MappingProxyType({})
_INI: Final = re.compile(r"(?:#[^\n]*\n\s*)*(?:\[[A-Za-z][\w ]*\]\s*\n|\w+ *= *\S)")
"""How such a file begins, behind its comments: with [section], or name = value."""
_COLMAP_LINE: Final = re.compile(r"\d+\s+([A-Z][A-Z_]+)\s+(\d+)\s+(\d+)\s+(.+)")


@dataclass(slots=True)
class _Found:
    """What has been read of a file so far.

    Attributes:
        values: by the name of its field, the value and the key that said so.
        models: names of lens models, as they stand in the file.
        words: by their keys, texts that may say by the way what the lens is.
        unknown: keys that are not known.
    """

    values: dict[str, tuple[Any, str]] = field(default_factory=dict)
    models: list[str] = field(default_factory=list)
    words: dict[str, str] = field(default_factory=dict)
    unknown: list[str] = field(default_factory=list)

    def add(self, name: str, value: Any, key: str) -> None:
        """Takes one value in.

        Raises:
            DataFormatError: another key has said something else about the same field.
        """
        if name in self.values and self.values[name][0] != value:
            raise DataFormatError(f"camera: {self.values[name][1]} and {key} both say what {name} is, differently")
        self.values[name] = (value, key)

    def get(self, name: str) -> Any:
        return self.values[name][0] if name in self.values else None


def read_camera(path: str | Path) -> PinholeCamera:
    """Read a camera file: ours, or one of OpenCV, ROS, Kalibr, COLMAP and others; see docs/inputs.md.

    Args:
        path: JSON, YAML, XML of OpenCV, or COLMAP's cameras.txt, as its content says; may be gzipped. Ours is JSON with
            fx, fy, cx, cy, width, height and optionally distortion (OpenCV's k1, k2, p1, p2[, k3[, k4, k5, k6]]). Under
            these names cx and cy count from the outer corner of the first pixel; in a camera matrix and in files of
            Kalibr, ROS, RealSense and ORB-SLAM from its centre: 0.5 is added to those.

    Raises:
        InputError: the file is missing, or a value is not finite or not positive.
        DataFormatError: the file holds something else, a lens of another model, or a key that is not known.
    """
    path = Path(path)
    data = read_bytes(path, "camera file", MAX_CAMERA_BYTES)
    try:
        return _camera(_record(data))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except DataFormatError as error:
        raise DataFormatError(f"{path}: {error}") from error


def camera_for_image(camera: PinholeCamera, width: int, height: int) -> PinholeCamera:
    """The camera at the size of a picture it took, which may have been resized since.

    Raises:
        InputError: the aspect ratios differ by more than rounding to whole pixels explains; the picture was cropped
            or comes from another camera.
    """
    if (camera.width, camera.height) == (width, height):
        return camera
    one_pixel = max(width, height, camera.width, camera.height)
    if abs(width * camera.height - height * camera.width) > one_pixel:
        turned = abs(height * camera.height - width * camera.width) <= one_pixel
        found = "a picture held upright, or its sides are exchanged" if turned else "another aspect ratio"
        raise InputError(
            f"camera is for {camera.width}x{camera.height}, the image is {width}x{height}: {found}; give the camera of "
            "this image size"
        )
    return camera.resized(width, height)


def _record(data: bytes) -> dict[str, Any]:
    """The keys and values of a camera file, whatever its format."""
    if data.startswith((b"PK\x03\x04", b"\x93NUMPY", b"MATLAB", b"\x80")):
        raise DataFormatError("a numpy, MATLAB or pickle file; write the camera as JSON or YAML (docs/inputs.md)")
    text = decode_text(data)
    start = text.lstrip()
    if _INI.match(start):
        raise DataFormatError("an INI or TOML file; write the camera as JSON or YAML (docs/inputs.md)")
    if start.startswith(("{", "[")):
        content = parse_json(text)
    elif start.startswith("<"):
        content = parse_xml(text)
    else:
        content = _colmap_file(text) or parse_yaml(text)
    if isinstance(content, list) and len(content) == 1:
        content = content[0]
    if not isinstance(content, dict):
        raise DataFormatError(f"camera: an object with keys expected, found {in_words(content)}")
    return content


def _colmap_file(text: str) -> dict[str, Any] | None:
    """The camera of COLMAP's cameras.txt; None for a text of another kind."""
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    match = _COLMAP_LINE.fullmatch(lines[0]) if lines else None
    if match is None:
        return None
    if len(lines) > 1:
        raise DataFormatError(f"camera: {len(lines)} cameras; a file of one is needed")
    try:
        params = [float(word) for word in match[4].split()]
        return {"model": match[1], "width": int(match[2][:20]), "height": int(match[3][:20]), "params": params}
    except ValueError as error:
        raise DataFormatError(f"camera: numbers expected: {error}") from None


def _camera(record: Mapping[str, Any]) -> PinholeCamera:
    """The camera that a record tells of."""
    found = _Found()
    name, only = next(iter(record.items())) if len(record) == 1 else ("", None)
    plain = plain_key(name)
    if isinstance(only, dict) and plain not in FIELD_OF_KEY and not _holds_a_record(plain):
        found.words[name] = name  # the camera's own, which may say what its lens is
        record = only
    _gather(record, found, depth=0)
    for model in found.models:
        _check_model(model, found)
    if found.unknown:
        raise DataFormatError(
            f"camera: unknown key '{found.unknown[0][:60]}'; if it says something about the lens, rename it "
            "(docs/inputs.md), else take it out"
        )
    _check_words(found)
    _expand(found)
    missing = [name for name in _OURS if name not in found.values]
    if missing:
        raise DataFormatError(f"camera: {', '.join(missing)} missing; needed: {', '.join(_OURS)}")
    values: dict[str, Any] = {name: number_of(*found.values[name]) for name in _OURS}
    for name in ("width", "height"):
        if not values[name].is_integer():
            raise DataFormatError(f"camera: {name} must be a whole number, got {found.get(name)!r}")
        values[name] = int(values[name])
    return PinholeCamera(**values, distortion=_distortion(found))


def _gather(record: Mapping[str, Any], found: _Found, depth: int, renamed: Mapping[str, str] = _NOTHING) -> None:
    """Sorts the keys of a record and of the records in it into the fields.

    Args:
        record: what the file holds, or a part of it.
        found: what has been read so far.
        depth: of the part.
        renamed: fields that mean something else in this part.

    Raises:
        DataFormatError: a key is said twice, or there are several cameras.
    """
    several = [key for key, value in record.items() if re.fullmatch(r"cam(era)?_?\d", key) and isinstance(value, dict)]
    if len(several) > 1:
        raise DataFormatError(f"camera: {len(several)} cameras ({', '.join(several)}); a file of one is needed")
    for key, value in record.items():
        plain = plain_key(key)
        if plain == "frames" and isinstance(value, list):
            _gather_frames(value, found)
            continue
        if _holds_a_record(plain) and isinstance(value, list) and any(isinstance(each, dict) for each in value):
            if len(value) > 1:
                raise DataFormatError(f"camera: {len(value)} cameras in '{key[:60]}'; a file of one is needed")
            value = value[0]
        if isinstance(value, dict) and not is_matrix(value) and _holds_a_record(plain) and depth < 4:
            _gather(value, found, depth + 1, FROM_PIXEL_CENTRES.get(plain, _NOTHING))
            continue
        name = FIELD_OF_KEY.get(plain)
        name = renamed.get(name or "", name)
        if (slam := re.fullmatch(f"camera1?({'|'.join(SLAM_FIELDS)})", plain)) is not None:
            name = SLAM_FIELDS[slam[1]]
        if name == "model":
            found.models.append(str(value))
        elif name in (*COEFFICIENTS, "matrix") and plain in COEFFICIENTS and is_matrix(value):
            raise DataFormatError(f"camera: '{key}' is one matrix of several; a file of one camera is needed")
        elif name is not None:
            found.add(name, value, key)
        elif not NO_MATTER.fullmatch(plain):
            found.unknown.append(key)
        elif isinstance(value, str | list) and LENS_IN_WORDS.fullmatch(plain):
            found.words[key] = str(value)


def _gather_frames(frames: list[Any], found: _Found) -> None:
    """What nerfstudio's list of pictures says of each one's lens: the same as of all, or there are several cameras.

    Raises:
        DataFormatError: a picture has a camera of its own.
    """
    for frame in frames:
        if isinstance(frame, dict):
            lens = {key: value for key, value in frame.items() if plain_key(key) in FIELD_OF_KEY}
            _gather(lens, found, depth=1)


def _holds_a_record(plain: str) -> bool:
    return plain in CONTAINERS or re.fullmatch(r"cam(era)?\d", plain) is not None


def _check_model(model: str, found: _Found) -> None:
    """Raises DataFormatError for a lens model that is not OpenCV's pinhole."""
    plain = plain_key(model).removeprefix("rs2")
    if plain in PINHOLE or plain == "false":
        return
    if plain in FOCAL_ONLY_WHEN_STRAIGHT and not any(_distortion(found)):
        return
    raise DataFormatError(
        f"camera: lens model '{model[:60]}'; only pinhole cameras with OpenCV's k1, k2, p1, p2, k3 to k6 are known, "
        "so undistort the pictures first and give the camera of those"
    )


def _check_words(found: _Found) -> None:
    """Raises DataFormatError where a description or flags name another lens than a pinhole, and nothing else says that
    the coefficients are a pinhole's; of pictures that were undistorted there are none."""
    if found.models or not any(_distortion(found)):
        return
    for key, text in found.words.items():
        if other := OTHER_LENSES.search(re.sub("[^a-z]", "", text.lower())):
            raise DataFormatError(
                f"camera: '{key[:60]}' names a lens that is no pinhole ({other[0]}); if the coefficients are OpenCV's "
                "k1, k2, p1, p2 all the same, say distortion_model: plumb_bob, else undistort the pictures first"
            )


def _expand(found: _Found) -> None:
    """Turns matrices, lists and names of other tools into fx, fy, cx, cy, width and height.

    Raises:
        DataFormatError: a value has another form.
    """
    if (params := found.get("params")) is not None:
        _expand_params(params, found)
    if (intrinsics := found.get("intrinsics")) is not None:
        values, shape = numbers_of(intrinsics, "intrinsics")
        if shape in ((3, 3), (9,)):
            found.add("matrix", intrinsics, found.values["intrinsics"][1])
        elif shape == (4,):
            for name, value in zip(("fx", "fy", "cx_opencv", "cy_opencv"), values, strict=True):
                found.add(name, value, "intrinsics")
        else:
            raise DataFormatError(
                f"camera: intrinsics: fx, fy, cx, cy or a 3x3 matrix expected, got {len(values)} values"
            )
    if (matrix := found.get("matrix")) is not None:
        for name, value in _from_matrix(matrix, found.values["matrix"][1]).items():
            found.add(name, value, found.values["matrix"][1])
    if (focal := found.get("focal")) is not None:
        values, _ = numbers_of(focal, "focal length")
        if len(values) not in (1, 2):
            raise DataFormatError(f"camera: focal length: one or two numbers expected, got {len(values)}")
        found.add("fx", values[0], found.values["focal"][1])
        found.add("fy", values[-1], found.values["focal"][1])
    for name in ("cx", "cy"):
        if (centre := found.get(f"{name}_opencv")) is not None:
            key = found.values[f"{name}_opencv"][1]
            found.add(name, number_of(centre, key) + 0.5, key)
    if (size := found.get("size")) is not None:
        values, _ = numbers_of(size, "image size")
        if len(values) != 2:
            raise DataFormatError(f"camera: image size: width and height expected, got {len(values)} numbers")
        found.add("width", values[0], found.values["size"][1])
        found.add("height", values[1], found.values["size"][1])
    _check_unused(found)


def _expand_params(params: Any, found: _Found) -> None:
    """Parameters in the order of COLMAP's camera model."""
    values, _ = numbers_of(params, "params")
    names = _COLMAP.get(found.models[0].upper() if found.models else "")
    if names is None or len(names) != len(values):
        raise DataFormatError(f"camera: params: those of a COLMAP model expected ({', '.join(_COLMAP)})")
    for name, value in zip(names, values, strict=True):
        found.add(name, value, "params")


def _check_unused(found: _Found) -> None:
    """Raises DataFormatError for what a camera of ours cannot say: skew, thin prisms, binning, a region of interest."""
    for name in ("skew", "s1", "s2", "s3", "s4"):
        if (value := found.get(name)) is not None and number_of(value, name) != 0:
            raise DataFormatError(f"camera: {name} of {value}; only 0 can be used")
    fisheye = found.get("fisheye")
    no_fisheye = isinstance(fisheye, str) and plain_key(fisheye) in NO_FISHEYE
    if fisheye is not None and fisheye not in (0, False) and not no_fisheye:
        raise DataFormatError(
            "camera: a fisheye lens; only pinhole cameras with OpenCV's k1, k2, p1, p2, k3 to k6 are known, so "
            "undistort the pictures first and give the camera of those"
        )
    if (binning := found.get("binning")) is not None and binning not in (0, 1):
        raise DataFormatError(f"camera: binning of {binning}; give the camera of the pictures as they are")
    roi = found.get("roi")
    if roi is not None and not (isinstance(roi, dict) and not any(roi.values())):
        raise DataFormatError("camera: a region of interest (roi); give the camera of the pictures as they are")


def _from_matrix(value: Any, key: str) -> dict[str, float]:
    """fx, fy, cx, cy of a camera matrix, which counts pixels from the centre of the first one.

    Raises:
        DataFormatError: it is no camera matrix, transposed, or has skew.
    """
    values, shape = numbers_of(value, key)
    if shape not in ((3, 3), (9,)):
        raise DataFormatError(f"camera: {key}: a 3x3 matrix expected, got shape {shape}")
    matrix = np.array(values, np.float64).reshape(3, 3)
    matrix[2, :2][abs(matrix[2, :2]) <= MOST_BELOW * abs(matrix[2, 2])] = 0
    below, beside = matrix[2, :2], matrix[:2, 2]
    if below.any() and not beside.any():
        raise DataFormatError(
            f"camera: {key} is transposed, as MATLAB and Open3D write it: its last column, not its last row, must be "
            "cx, cy, 1"
        )
    scale = matrix[2, 2]
    if below.any() or scale == 0:
        raise DataFormatError(
            f"camera: {key}: the last row of a camera matrix must be 0, 0, 1, got {matrix[2].tolist()}"
        )
    with np.errstate(all="ignore"):  # of absurd numbers, which are named below
        matrix = matrix / scale
    if not np.isfinite(matrix).all():
        raise DataFormatError(f"camera: {key}: the numbers of its matrix are too large")
    skew = max(abs(matrix[0, 1]), abs(matrix[1, 0]))
    if skew > MOST_SKEW * max(abs(matrix[0, 0]), abs(matrix[1, 1])):
        raise DataFormatError(
            f"camera: {key} has a skew of {skew:g}; calibrate without skew, as OpenCV does: only 0 can be used"
        )
    fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    return {"fx": float(fx), "fy": float(fy), "cx": float(cx) + 0.5, "cy": float(cy) + 0.5}


def _distortion(found: _Found) -> tuple[float, ...]:
    """OpenCV's coefficients; empty where all are 0.

    Raises:
        DataFormatError: they are no numbers, given in two ways, or one is there without those before it.
    """
    single = {name: number_of(*found.values[name]) for name in COEFFICIENTS if name in found.values}
    value = found.get("distortion")
    if value is not None and not isinstance(value, list | dict):
        raise DataFormatError(f"camera: distortion: a list of numbers expected, got {in_words(value)}")
    listed = [] if value is None else numbers_of(value, found.values["distortion"][1])[0]
    if any(single.values()) and any(listed):
        raise DataFormatError(f"camera: distortion both as {found.values['distortion'][1]} and as {', '.join(single)}")
    if single.get("k4") and not {"k5", "k6"} <= single.keys():
        raise DataFormatError("camera: k4 without k5 and k6 is none of OpenCV's pinhole models, rather a fisheye's")
    if any(single.values()):
        listed = [single.get(name, 0.0) for name in COEFFICIENTS]
        listed = listed[:4] if not any(listed[4:]) else listed[:5] if not any(listed[5:]) else listed
    while len(listed) > MOST_COEFFICIENTS and listed[-1] == 0:
        listed = listed[:-1]  # OpenCV pads those of its larger models
    return tuple(listed) if any(listed) else ()
