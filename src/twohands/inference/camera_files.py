"""Intrinsics from files: our JSON, or the YAML that OpenCV's calibration writes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from twohands.errors import DataFormatError, InputError
from twohands.types import PinholeCamera

_KEYS = ("fx", "fy", "cx", "cy", "width", "height")
MOST_COEFFICIENTS = 8
"""Distortion coefficients that `PinholeCamera` knows: OpenCV's k1, k2, p1, p2, k3 to k6."""


def read_camera(path: str | Path) -> PinholeCamera:
    """Read a camera file.

    Args:
        path: `.json` with fx, fy, cx, cy, width, height and optionally distortion (OpenCV's k1, k2, p1, p2, ...); or
            `.yaml`/`.yml` as OpenCV writes it, with camera_matrix, distortion_coefficients, image_width, image_height.
            OpenCV counts from the first pixel's centre: 0.5 is added to its cx and cy.

    Raises:
        InputError: the file is missing, or a value is not finite or not positive.
        DataFormatError: the file holds something else.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such camera file") from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: camera file cannot be read: {error}") from error
    try:
        values = _from_json(text) if path.suffix.lower() == ".json" else _from_opencv_yaml(text)
        return PinholeCamera(**values)
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
        raise InputError(
            f"camera is for {camera.width}x{camera.height}, the image is {width}x{height}: another aspect ratio; "
            "give the camera of this image size"
        )
    return camera.resized(width, height)


def _from_json(text: str) -> dict[str, Any]:
    try:
        record = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise DataFormatError(f"not JSON: {error}") from error
    if not isinstance(record, dict):
        raise DataFormatError(f"camera: a JSON object expected, found {type(record).__name__}")
    return _numbers(record, record.get("distortion") or ())


def _from_opencv_yaml(text: str) -> dict[str, Any]:
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        matrix = storage.getNode("camera_matrix").mat()
        distortion = storage.getNode("distortion_coefficients").mat()
        size = {name: storage.getNode(f"image_{name}") for name in ("width", "height")}
        record = {name: node.real() for name, node in size.items() if not node.empty()}
        fisheye = storage.getNode("fisheye_model")
        fisheye = not fisheye.empty() and fisheye.real() != 0
    except (cv2.error, SystemError) as error:
        raise DataFormatError("not a camera file of OpenCV (YAML that begins with %YAML)") from error
    if fisheye:
        raise DataFormatError("camera: a fisheye lens; only pinhole cameras with k1, k2, p1, p2, ... are known")
    if matrix is None or matrix.shape != (3, 3):
        raise DataFormatError("camera_matrix: a 3x3 matrix expected")
    record |= {"fx": matrix[0, 0], "fy": matrix[1, 1], "cx": matrix[0, 2] + 0.5, "cy": matrix[1, 2] + 0.5}
    return _numbers(record, () if distortion is None else np.ravel(distortion).tolist())


def _numbers(record: dict[str, Any], distortion: Any) -> dict[str, Any]:
    """Arguments of PinholeCamera, each checked to be there and to be a number."""
    missing = [name for name in _KEYS if name not in record]
    if missing:
        raise DataFormatError(f"camera: {', '.join(missing)} missing; needed: {', '.join(_KEYS)}")
    try:
        values: dict[str, Any] = {name: float(record[name]) for name in _KEYS}
        coefficients = tuple(float(value) for value in distortion)
    except (TypeError, ValueError, OverflowError) as error:
        raise DataFormatError(f"camera: numbers expected: {error}") from error
    while len(coefficients) > MOST_COEFFICIENTS and coefficients[-1] == 0:
        coefficients = coefficients[:-1]  # OpenCV pads those of its larger models
    for name in ("width", "height"):
        if not values[name].is_integer():
            raise DataFormatError(f"camera: {name} must be a whole number, got {record[name]}")
        values[name] = int(values[name])
    return {**values, "distortion": coefficients if any(coefficients) else ()}
