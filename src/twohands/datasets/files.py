"""Reads a data set's files completely, or names the one that cannot be read in one line."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from twohands.errors import DataFormatError, InputError
from twohands.files import read_file
from twohands.formats import structured
from twohands.formats.pictures import decode_pixels, is_complete

MAX_BYTES: Final = 4 << 30
"""Of a file of labels: InterHand2.6M's joints take a gigabyte."""
_SUFFIXES: Final = (".png", ".jpg")
_TO_RGB: Final = {3: cv2.COLOR_BGR2RGB, 4: cv2.COLOR_BGRA2RGBA}


def existing_folder(path: str | os.PathLike[str]) -> Path:
    """The folder, if there is one.

    Raises:
        InputError: there is none.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    return folder


def read_bytes(path: Path) -> bytes:
    """The file's content.

    Raises:
        DataFormatError: the file is missing, cannot be read, or is empty.
    """
    try:
        data = read_file(path, MAX_BYTES)
    except InputError as error:
        raise DataFormatError(str(error)) from None
    if len(data) > MAX_BYTES:
        raise DataFormatError(f"{path}: more than {MAX_BYTES >> 30} GiB")
    if not data:
        raise DataFormatError(f"{path}: zero bytes")
    return data


def read_json(path: Path, kind: type) -> Any:
    """Reads a JSON file.

    Args:
        path: the file.
        kind: type of its top level, `dict` or `list`.

    Raises:
        DataFormatError: the file is missing, cut off, not JSON, or of another kind.
    """
    try:
        return structured.read_json(path, kind, limit=MAX_BYTES)
    except InputError as error:
        raise DataFormatError(str(error)) from None


def read_picture(path: Path, channels: int = 3) -> np.ndarray:
    """Reads an 8-bit PNG or JPEG; pixels are those of the file, its EXIF orientation is not applied.

    Args:
        path: the file, `.png` or `.jpg`.
        channels: 1 for grey, 3 for RGB, 4 for RGBA.

    Returns:
        (H, W, channels) uint8, or (H, W) for one channel.

    Raises:
        DataFormatError: the file is missing, empty, cut off, damaged, not 8-bit, or has other channels.
    """
    if path.suffix not in _SUFFIXES:
        raise DataFormatError(f"{path}: expected a file name that ends in {' or '.join(_SUFFIXES)}")
    data = read_bytes(path)
    if not is_complete(data):
        raise DataFormatError(f"{path}: not a complete {path.suffix[1:].upper()} file")
    return decode_bytes(data, channels, str(path), path.suffix[1:].upper())


def decode_bytes(data: bytes, channels: int, where: str, kind: str) -> np.ndarray:
    """Pixels of a complete 8-bit picture.

    Args:
        data: the file's content, at least one byte.
        channels: 1 for grey, 3 for RGB, 4 for RGBA.
        where, kind: the file's name and its format, for messages.

    Returns:
        (H, W, channels) uint8, or (H, W) for one channel.

    Raises:
        DataFormatError: it cannot be decoded, is not 8-bit, or has other channels.
    """
    pixels = decode_picture(data)
    if pixels is None:
        raise DataFormatError(f"{where}: not a {kind} file that can be decoded")
    found = pixels.shape[2] if pixels.ndim == 3 else 1
    if pixels.dtype != np.uint8 or found != channels:
        raise DataFormatError(f"{where}: expected {channels} channels of 8 bits, got {found} of {pixels.dtype}")
    return pixels if channels == 1 else cv2.cvtColor(pixels, _TO_RGB[channels])


def decode_picture(data: bytes) -> np.ndarray | None:
    """Pixels of a picture as OpenCV has them, of its own depth and channels; None where it cannot be decoded.

    Args:
        data: the file's content, at least one byte.
    """
    return decode_pixels(data, cv2.IMREAD_UNCHANGED)


def reason(error: BaseException) -> str:
    """What an exception says, on one line."""
    return " ".join(str(error).split()) or type(error).__name__
