"""Numbers of camera files in all their wrappings: plain, in lists of lists, and OpenCV's matrices, packed ones too."""

from __future__ import annotations

import base64
import binascii
import math
import re
from typing import Any, Final

import numpy as np

from twohands.errors import DataFormatError

_PACKED: Final = {"d": "<f8", "f": "<f4", "i": "<i4"}
"""What OpenCV's letters for types of numbers stand for."""


def numbers_of(value: Any, key: str, levels: int = 4) -> tuple[list[float], tuple[int, ...]]:
    """All numbers of a list, a nested list or a matrix of OpenCV's, in order, and their shape.

    Args:
        value: of a file.
        key: it stands under, for messages.
        levels: of lists in lists that are looked into.

    Raises:
        DataFormatError: something else than numbers, or as many as the matrix does not say.
    """
    if value is None:
        return [], (0,)
    if isinstance(value, dict) and is_matrix(value):
        data = value.get("data")
        flat = _packed_numbers(data, key) if isinstance(data, str) else numbers_of(data, key, levels - 1)[0]
        rows, columns = (number_of(value.get(name), f"{key}.{name}") for name in ("rows", "cols"))
        if rows * columns != len(flat):
            raise DataFormatError(f"camera: {key}: {rows:g}x{columns:g} numbers announced, found {len(flat)}")
        return flat, (int(rows), int(columns))
    if levels and isinstance(value, list) and any(isinstance(row, list) for row in value):
        rows = [
            numbers_of(row, key, levels - 1)[0] if isinstance(row, list) else [number_of(row, key)] for row in value
        ]
        lengths = {len(row) for row in rows}
        shape = (len(rows), *lengths) if len(lengths) == 1 else (sum(map(len, rows)),)
        return [number for row in rows for number in row], shape
    if isinstance(value, list):
        return [number_of(item, key) for item in value], (len(value),)
    return [number_of(value, key)], (1,)


def _packed_numbers(text: str, key: str) -> list[float]:
    """Numbers as OpenCV's FileStorage writes them with WRITE_BASE64: their type in 24 letters, then their bytes.

    Raises:
        DataFormatError: it is something else.
    """
    try:
        data = base64.b64decode("".join(text.removeprefix("$base64$").split()), validate=True)
        kind = _PACKED[data[:24].decode("ascii").strip().removeprefix("1")]
        return np.frombuffer(data[24:], kind).astype(float).tolist()
    except (binascii.Error, ValueError, KeyError):
        raise DataFormatError(f"camera: {key}: numbers expected, got {in_words(text)}") from None


def is_matrix(value: Any) -> bool:
    """Whether a value is a matrix as OpenCV and ROS write it."""
    return isinstance(value, dict) and "data" in value and set(value) <= {"type_id", "rows", "cols", "dt", "data"}


def number_of(value: Any, key: str) -> float:
    """A number, which may be no finite one.

    Raises:
        DataFormatError: it is none.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise DataFormatError(f"camera: {key}: numbers expected, got {in_words(value)}")
    try:
        return float(value)
    except OverflowError:
        return math.inf


def in_words(value: Any) -> str:
    """A value in a few words."""
    return f"{str(value)[:40]!r}" if isinstance(value, str | bool) or value is None else type(value).__name__


def plain_key(key: str) -> str:
    """A key's letters and digits, in small letters."""
    return re.sub(r"[^a-z0-9]", "", key.lower())
