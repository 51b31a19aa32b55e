"""Pictures from files, strictly: what is cut off, or damaged where the format lets one see it, is refused.

The one front door for every picture that somebody brings; what it accepts is listed in docs/inputs.md. The pixels of a
JPEG carry no checksum: damage within them cannot be told from a picture.
"""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from twohands.errors import InputError, MissingExtraError
from twohands.files import read_file
from twohands.formats.picture_kinds import (
    AVIF,
    BMP,
    HEIC,
    JPEG,
    KINDS,
    PNG,
    SUFFIXES,
    TIFF,
    WEBP,
    PictureKind,
    is_raw,
    iso_properties,
    kind_of,
    noted_orientation,
    other_kind_of,
)

IMAGE_SUFFIXES: Final = SUFFIXES
MIN_SIDE: Final = 32
"""Smaller pictures cannot show a hand: 21 joints would fall on a handful of pixels."""
MAX_PIXELS: Final = 200_000_000
"""Of a picture; no telephone has more."""
MAX_DECODED_BYTES: Final = 1 << 30
"""That a picture may take while it is decoded."""
MAX_FILE_BYTES: Final = 1 << 29
_ROWS: Final = 512
"""Converted at a time, so that a picture needs little more memory than its pixels."""


@dataclass(frozen=True, slots=True)
class FolderContent:
    """What a folder holds; what is hidden does not count.

    Attributes:
        pictures: by their endings or first bytes, in natural order (frame2 before frame10).
        others: the rest, in the same order; links to nowhere and pipes, too.
        folders: in it, which are not looked into, in the same order.
    """

    pictures: list[Path]
    others: list[Path]
    folders: list[Path]

    def left_out(self) -> list[str]:
        """Lines that count and name what it holds beside pictures; none where that is nothing."""
        kinds = ((self.others, "no pictures that can be read"), (self.folders, "folders are not looked into"))
        return [
            f"{len(paths)} left out, {why}: " + ", ".join([path.name for path in paths[:5]] + ["..."][: len(paths) > 5])
            for paths, why in kinds
            if paths
        ]


def look_through(folder: Path) -> FolderContent:
    """Finds the pictures of a folder.

    Raises:
        InputError: the folder cannot be read.
    """
    try:
        found = sorted(
            (path for path in folder.iterdir() if not path.name.startswith(".")),
            key=lambda path: natural_key(path.name),
        )
        folders = [path for path in found if path.is_dir()]
    except OSError as error:
        raise InputError(f"{folder}: cannot be read: {error.strerror}") from error
    files = [path for path in found if path not in set(folders)]
    pictures = [
        path for path in files if path.is_file() and (path.suffix.lower() in IMAGE_SUFFIXES or _begins_as_picture(path))
    ]
    known = set(pictures)
    return FolderContent(pictures, [path for path in files if path not in known], folders)


def list_images(folder: Path) -> list[Path]:
    """Pictures of a folder, in natural order; hidden files are left out.

    Raises:
        InputError: the folder cannot be read or holds no picture.
    """
    content = look_through(folder)
    if not content.pictures:
        within = f"; folders in it are not looked into: {content.folders[0].name}, ..." if content.folders else ""
        raise InputError(f"{folder}: no image in this folder (looked for {', '.join(IMAGE_SUFFIXES)}){within}")
    return content.pictures


def read_image(path: str | Path) -> np.ndarray:
    """Read a picture as 8-bit RGB.

    Grey is repeated over the channels, 16 bits are scaled by 1/257, and the orientation noted by a camera is applied.
    Transparency of PNG, WebP, TIFF and AVIF is put on black instead; such pictures come from no camera.

    Args:
        path: a PNG, JPEG, WebP, BMP, TIFF or AVIF file, or HEIC with the extra `heic`; its content decides, not its
            name. Of several pictures in one file, the first.

    Returns:
        (H, W, 3) uint8 RGB.

    Raises:
        InputError: the file is missing, empty, not an image, damaged, cut off, smaller than MIN_SIDE, or larger than
            MAX_PIXELS.
        MissingExtraError: it is HEIC, and nothing is there that decodes it.
    """
    path = Path(path)
    data = read_file(path, MAX_FILE_BYTES)
    try:
        return decode_image(data)
    except MissingExtraError as error:
        raise MissingExtraError(f"{path}: {error.feature}", error.extra) from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def decode_image(data: bytes) -> np.ndarray:
    """Decode the bytes of an image file; see `read_image`.

    Raises:
        InputError: as `read_image`.
        MissingExtraError: as `read_image`.
    """
    kind = _kind(data)
    if not kind.is_complete(data):
        raise InputError("the image is cut off or damaged")
    check_size(data, kind)
    if kind is HEIC:
        pixels = _decode_heic(data)
    else:
        # IMREAD_COLOR turns a JPEG upright and drops transparency, which a BMP may call total without meaning it.
        # Of TIFF, OpenCV always applies the orientation; of AVIF never; of PNG and WebP not in every version.
        plain = kind in (JPEG, BMP)
        pixels = _decoded(data, cv2.IMREAD_COLOR if plain else cv2.IMREAD_UNCHANGED)
        if kind is AVIF and pixels is not None and pixels.dtype == np.uint16:  # 10 or 12 bits, not scaled to 16
            pixels = _decoded(data, cv2.IMREAD_COLOR)
        if kind is AVIF and pixels is not None:
            pixels = _turned(pixels, iso_properties(data))
        if kind in (PNG, WEBP) and pixels is not None:
            pixels = _upright(pixels, noted_orientation(data))
    if pixels is None:
        raise InputError(f"the image is damaged, or a {kind.name} of a kind that cannot be decoded")
    if min(pixels.shape[:2]) < MIN_SIDE:
        raise InputError(
            f"too small: {pixels.shape[1]}x{pixels.shape[0]} pixels, at least {MIN_SIDE}x{MIN_SIDE} needed"
        )
    return _to_rgb8(pixels)


def check_size(data: bytes, kind: PictureKind) -> None:
    """Refuses, by its header, a picture that would take too much memory.

    Raises:
        InputError: it is too large, or its header says nothing.
    """
    extent = kind.extent(data)
    if extent is None:
        raise InputError("the image is damaged: its header says no size")
    if extent.width * extent.height > MAX_PIXELS:
        raise InputError(
            f"too large: {extent.width}x{extent.height} pixels, at most {MAX_PIXELS // 1_000_000} million can be read"
        )
    if extent.width * extent.height * extent.pixel_bytes > MAX_DECODED_BYTES:
        raise InputError(
            f"too large: {extent.width}x{extent.height} pixels of {extent.pixel_bytes} bytes, at most "
            f"{MAX_DECODED_BYTES >> 20} MiB can be read"
        )


def decode_pixels(data: bytes, flags: int) -> np.ndarray | None:
    """Pixels as OpenCV has them; None where it cannot decode them, they would take too much memory, or the file is cut
    off: decoders ask for as much memory as each part announces.

    Args:
        data: a picture file's content.
        flags: OpenCV's, how to decode it; HEIC comes out as (H, W, 3) uint8 BGR whatever they say.
    """
    kind = kind_of(data)
    if kind is None or not kind.is_complete(data) or (kind is TIFF and is_raw(data)):  # of a raw file, a preview
        return None
    try:
        check_size(data, kind)
        return _decode_heic(data) if kind is HEIC else _decoded(data, flags)
    except (InputError, MissingExtraError):
        return None


def _decoded(data: bytes, flags: int) -> np.ndarray | None:
    """Pixels of a complete picture as OpenCV has them; None where it cannot decode them."""
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        return None


def read_pixels(path: Path, flags: int) -> np.ndarray | None:
    """Pixels of a picture file as OpenCV has them; None where it is missing, cut off, too large, or none that OpenCV
    decodes.

    Args:
        path: the file.
        flags: OpenCV's, how to decode it.
    """
    try:
        data = read_file(path, MAX_FILE_BYTES)
    except InputError:
        return None
    return decode_pixels(data, flags) if len(data) <= MAX_FILE_BYTES else None


def is_complete(data: bytes) -> bool:
    """Whether a picture file is all there, as far as its structure tells; False where it is none."""
    kind = kind_of(data)
    return kind is not None and kind.is_complete(data)


def _kind(data: bytes) -> PictureKind:
    """The kind of a picture file.

    Raises:
        InputError: it is empty, none that is read, or too short to tell.
    """
    if not data:
        raise InputError("the file is empty")
    if len(data) > MAX_FILE_BYTES:
        raise InputError(f"too large: a file of more than {MAX_FILE_BYTES >> 20} MiB")
    kind = kind_of(data)
    if kind is None:
        begun = any(
            data[: len(start)] == start[: len(data)] for start in (b"\x89PNG", b"\xff\xd8", b"RIFF", b"II*", b"MM\0*")
        )
        if begun or (len(data) < 12 and data[:3] == b"\0\0\0" and b"ftyp".startswith(data[4:8])):
            raise InputError("the image is cut off or damaged")
        if (other := other_kind_of(data)) is not None:
            remedy = "videos are told by their names' endings" if other == "a video" else "make it a PNG or JPEG"
            raise InputError(f"{other}, no picture that can be read; {remedy}")
        raise InputError(f"not an image ({', '.join(kind.name for kind in KINDS)})")
    if kind is TIFF and is_raw(data):
        raise InputError("a camera's raw picture, of which only a small preview could be read; make it a PNG or JPEG")
    return kind


def _decode_heic(data: bytes) -> np.ndarray | None:
    """(H, W, 3) uint8 BGR of a HEIC file, turned as the camera noted; None where it cannot be decoded."""
    try:
        import pi_heif  # type: ignore[import-not-found]
    except ModuleNotFoundError:
        raise MissingExtraError("a HEIC picture", "heic") from None
    try:
        image = pi_heif.open_heif(io.BytesIO(data), convert_hdr_to_8bit=True)
        pixels: Any = np.asarray(image)
    except Exception:  # a damaged file fails in many ways
        return None
    if pixels.ndim not in (2, 3) or pixels.dtype != np.uint8:
        return None
    if pixels.ndim == 2 or pixels.shape[2] < 3:  # grey
        return np.repeat(pixels.reshape(*pixels.shape[:2], -1)[..., :1], 3, axis=2)
    return np.ascontiguousarray(pixels[..., 2::-1])


def _turned(pixels: np.ndarray, properties: dict[bytes, list[bytes]]) -> np.ndarray:
    """Pixels of an AVIF file, turned and mirrored as its camera noted."""
    for note in properties.get(b"irot", [])[:1]:
        pixels = np.rot90(pixels, note[0] & 3 if note else 0)
    for note in properties.get(b"imir", [])[:1]:
        pixels = np.flip(pixels, axis=note[0] & 1 if note else 0)  # 0: top and bottom change places
    return np.ascontiguousarray(pixels)


def _upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Pixels as the camera was held, by EXIF's number: 2, 4, 5 and 7 are mirrored, 3 upside down, 6 and 8 turned."""
    if orientation in (5, 6, 7, 8):
        pixels = np.swapaxes(pixels, 0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return np.ascontiguousarray(pixels)


def _to_rgb8(pixels: np.ndarray) -> np.ndarray:
    """What OpenCV decoded, grey, BGR or BGRA of 8 or 16 bits, as (H, W, 3) uint8 RGB; the memory of 8-bit BGR is used
    again."""
    if pixels.dtype not in (np.uint8, np.uint16):
        raise InputError(f"8 or 16 bits per channel expected, found {pixels.dtype}")
    again = (
        pixels.dtype == np.uint8 and pixels.shape[2:] == (3,) and pixels.flags.c_contiguous and pixels.flags.writeable
    )
    out = pixels if again else np.empty((*pixels.shape[:2], 3), np.uint8)
    for start in range(0, len(pixels), _ROWS):
        out[start : start + _ROWS] = _rows_to_rgb8(pixels[start : start + _ROWS])
    return out


def _rows_to_rgb8(pixels: np.ndarray) -> np.ndarray:
    if pixels.dtype == np.uint16:
        pixels = ((pixels.astype(np.uint32) + 128) // 257).astype(np.uint8)
    if pixels.ndim == 2 or pixels.shape[2] == 1:
        return cv2.cvtColor(pixels, cv2.COLOR_GRAY2RGB)
    if pixels.shape[2] == 4:
        alpha = pixels[..., 3:].astype(np.uint16)
        pixels = ((pixels[..., :3] * alpha + 127) // 255).astype(np.uint8)
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)


def _begins_as_picture(path: Path) -> bool:
    """Whether a file's first bytes are a picture's."""
    try:
        with path.open("rb") as file:
            return kind_of(file.read(16)) is not None
    except OSError:
        return False


def natural_key(name: str) -> list[tuple[int, int | str]]:
    """Sort key under which numbers count as numbers."""
    return [(0, int(part)) if part.isdecimal() else (1, part.lower()) for part in re.split(r"(\d+)", name)]
