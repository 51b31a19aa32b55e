"""Pictures from files, strictly: what is cut off, or damaged where the format lets one see it, is refused.

The pixels of a JPEG carry no checksum: damage within them cannot be told from a picture.
"""

from __future__ import annotations

import re
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np

from twohands.errors import InputError

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".bmp")
MIN_SIDE = 32
"""Smaller pictures cannot show a hand: 21 joints would fall on a handful of pixels."""


def list_images(folder: Path) -> list[Path]:
    """Image files of a folder by suffix, in natural order (frame2 before frame10); hidden files are left out.

    Raises:
        InputError: the folder cannot be read or holds no image file.
    """
    try:
        images = [
            path
            for path in folder.iterdir()
            if path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".") and path.is_file()
        ]
    except OSError as error:
        raise InputError(f"{folder}: cannot be read: {error.strerror}") from error
    if not images:
        raise InputError(f"{folder}: no image in this folder (looked for {', '.join(IMAGE_SUFFIXES)})")
    return sorted(images, key=lambda path: _natural_key(path.name))


def read_image(path: str | Path) -> np.ndarray:
    """Read a picture as 8-bit RGB.

    Grey is repeated over the channels, 16 bits are scaled by 1/257, and the orientation noted by a camera (EXIF) is
    applied. Transparency of PNG and WebP is put on black instead; such pictures come from no camera.

    Args:
        path: a PNG, JPEG, WebP or BMP file; its content decides, not its name.

    Returns:
        (H, W, 3) uint8 RGB.

    Raises:
        InputError: the file is missing, empty, not an image, damaged, cut off, or smaller than MIN_SIDE.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    try:
        return decode_image(data)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def decode_image(data: bytes) -> np.ndarray:
    """Decode the bytes of an image file; see `read_image`.

    Raises:
        InputError: as `read_image`.
    """
    if not data:
        raise InputError("the file is empty")
    complete = _completeness_check(data)
    if not complete(data):
        raise InputError("the image is cut off or damaged")
    # IMREAD_COLOR applies a camera's orientation and drops transparency, which a BMP may call total without meaning it.
    content, plain = np.frombuffer(data, np.uint8), complete in (_jpeg_is_complete, _bmp_is_complete)
    try:
        pixels = cv2.imdecode(content, cv2.IMREAD_COLOR if plain else cv2.IMREAD_UNCHANGED)
        if not plain and (b"eXIf" in data or b"EXIF" in data) and pixels is not None and pixels.shape[2:] != (4,):
            pixels = cv2.imdecode(content, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    except cv2.error as error:
        raise InputError(f"the image cannot be decoded: {error.err}") from error
    if pixels is None:
        raise InputError("the image is damaged or of an unknown kind")
    if min(pixels.shape[:2]) < MIN_SIDE:
        raise InputError(
            f"too small: {pixels.shape[1]}x{pixels.shape[0]} pixels, at least {MIN_SIDE}x{MIN_SIDE} needed"
        )
    return _to_rgb8(pixels)


def _to_rgb8(pixels: np.ndarray) -> np.ndarray:
    """What OpenCV decoded, grey, BGR or BGRA of 8 or 16 bits, as (H, W, 3) uint8 RGB."""
    if pixels.dtype == np.uint16:
        pixels = ((pixels.astype(np.uint32) + 128) // 257).astype(np.uint8)
    if pixels.dtype != np.uint8:
        raise InputError(f"8 or 16 bits per channel expected, found {pixels.dtype}")
    if pixels.ndim == 2 or pixels.shape[2] == 1:
        return cv2.cvtColor(pixels, cv2.COLOR_GRAY2RGB)
    if pixels.shape[2] == 4:
        alpha = pixels[..., 3:].astype(np.uint16)
        pixels = ((pixels[..., :3] * alpha + 127) // 255).astype(np.uint8)
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)


def _completeness_check(data: bytes):
    """The check for this file's kind. Decoders fill what is missing with grey, so it must come before them."""
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        return _png_is_complete
    if data.startswith(b"\xff\xd8\xff"):
        return _jpeg_is_complete
    if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
        return _webp_is_complete
    if data.startswith(b"BM"):
        return _bmp_is_complete
    for start in (b"\x89PNG", b"\xff\xd8", b"RIFF"):
        if data[: len(start)] == start[: len(data)]:
            return lambda data: False
    raise InputError("not an image (PNG, JPEG, WebP or BMP)")


def _png_is_complete(data: bytes) -> bool:
    """Every chunk up to IEND is there and its checksum is right."""
    at = 8
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        end = at + 12 + length
        if end > len(data):
            return False
        (checksum,) = struct.unpack_from(">I", data, end - 4)
        if zlib.crc32(data[at + 4 : end - 4]) != checksum:
            return False
        if kind == b"IEND":
            return True
        at = end
    return False


def _jpeg_is_complete(data: bytes) -> bool:
    """Walk the segments and scans to the end-of-image marker; a thumbnail's own marker lies inside a segment."""
    at = 2
    while True:
        at = data.find(b"\xff", at)
        if at < 0 or at + 2 > len(data):
            return False
        marker = data[at + 1]
        if marker == 0xD9:
            return True
        if marker == 0xFF:  # fill byte
            at += 1
        elif marker in (0x00, 0x01) or 0xD0 <= marker <= 0xD8:  # stuffed byte, or a marker without content
            at += 2
        else:
            if at + 4 > len(data):
                return False
            at += 2 + struct.unpack_from(">H", data, at + 2)[0]


def _webp_is_complete(data: bytes) -> bool:
    """As long as its header says."""
    return len(data) >= 8 + struct.unpack_from("<I", data, 4)[0]


def _bmp_is_complete(data: bytes) -> bool:
    """Long enough for the header and the rows of pixels that it announces."""
    if len(data) < 54:
        return False
    start, header = struct.unpack_from("<II", data, 10)
    if header < 40:
        return False
    width, height, _, depth, compression = struct.unpack_from("<iiHHI", data, 18)
    row = (abs(width) * depth + 31) // 32 * 4
    packed = compression in (1, 2)  # run-length encoded: only the announced file size is known
    size = struct.unpack_from("<I", data, 2)[0] if packed else start + row * abs(height)
    return len(data) >= size


def _natural_key(name: str) -> list[tuple[int, int | str]]:
    """Sort key under which numbers count as numbers."""
    return [(0, int(part)) if part.isdecimal() else (1, part.lower()) for part in re.split(r"(\d+)", name)]
