"""Kinds of picture files, told by their first bytes: their endings, their size, and whether they are all there.

Decoders fill what is missing with grey without a word, and ask for as much memory as a header says: completeness and
size must be known before them. Only headers are looked at here; nothing is decoded.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple


class Extent(NamedTuple):
    """What a decoded picture would take: width and height in pixels, and bytes per pixel."""

    width: int
    height: int
    pixel_bytes: int = 3


@dataclass(frozen=True, slots=True)
class PictureKind:
    """One kind of picture file.

    Attributes:
        name: for people.
        suffixes: endings of its files' names, in small letters.
        starts: whether a file's first bytes are of this kind; 12 are enough.
        is_complete: whether a file is all there, as far as its structure tells.
        extent: what its header says; None where it says nothing that can be read.
    """

    name: str
    suffixes: tuple[str, ...]
    starts: Callable[[bytes], bool]
    is_complete: Callable[[bytes], bool]
    extent: Callable[[bytes], Extent | None]


def _png_is_complete(data: bytes) -> bool:
    """Every chunk up to IEND is there and its checksum is right."""
    at = 8
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        end = at + 12 + length
        if end > len(data):
            return False
        (checksum,) = struct.unpack_from(">I", data, end - 4)
        if zlib.crc32(memoryview(data)[at + 4 : end - 4]) != checksum:
            return False
        if kind == b"IEND":
            return True
        at = end
    return False


def _png_extent(data: bytes) -> Extent | None:
    if len(data) < 29 or data[12:16] != b"IHDR":
        return None
    width, height, depth = struct.unpack_from(">IIB", data, 16)
    return Extent(width, height, 8 if depth == 16 else 4)


def _jpeg_segments(data: bytes) -> Iterator[tuple[int, int]]:
    """(marker, place behind it) of every segment and scan up to the end-of-image marker; a thumbnail's own marker lies
    inside a segment."""
    at = 2
    while True:
        at = data.find(b"\xff", at)
        if at < 0 or at + 2 > len(data):
            return
        marker = data[at + 1]
        if marker == 0xD9:
            yield marker, at + 2
            return
        if marker == 0xFF:  # fill byte
            at += 1
        elif marker in (0x00, 0x01) or 0xD0 <= marker <= 0xD8:  # stuffed byte, or a marker without content
            at += 2
        else:
            if at + 4 > len(data):
                return
            yield marker, at + 2
            at += 2 + struct.unpack_from(">H", data, at + 2)[0]


def _jpeg_is_complete(data: bytes) -> bool:
    return any(marker == 0xD9 for marker, _ in _jpeg_segments(data))


def _jpeg_extent(data: bytes) -> Extent | None:
    for marker, at in _jpeg_segments(data):
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC) and at + 7 <= len(data):
            height, width = struct.unpack_from(">HH", data, at + 3)
            return Extent(width, height)
    return None


def _webp_is_complete(data: bytes) -> bool:
    """As long as its header says."""
    return len(data) >= 12 and len(data) >= 8 + struct.unpack_from("<I", data, 4)[0]


def _webp_extent(data: bytes) -> Extent | None:
    if len(data) < 30:
        return None
    if data[12:16] == b"VP8X":
        return Extent(1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little"), 4)
    if data[12:16] == b"VP8L":
        bits = int.from_bytes(data[21:25], "little")
        return Extent(1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF), 4)
    width, height = struct.unpack_from("<HH", data, 26)
    return Extent(width & 0x3FFF, height & 0x3FFF)


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


def _bmp_extent(data: bytes) -> Extent | None:
    if len(data) < 26:
        return None
    width, height = struct.unpack_from("<ii", data, 18)
    return Extent(abs(width), abs(height), 4)


_TIFF_SIZES: Final = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 16: 8, 17: 8, 18: 8}
"""Bytes of TIFF's types of numbers."""
_TIFF_WORDS: Final = {1: "B", 3: "H", 4: "I", 16: "Q"}
_RAW_COLOURS: Final = (32803, 34892)
"""Photometric interpretations of DNG: a filter array, and what becomes of it."""
_MOST_TIFF_NUMBERS: Final = 1 << 20


def tiff_tags(data: bytes, start: int | None = None) -> dict[int, list[int]] | None:
    """Whole numbers of a TIFF file's tags; None where they are not all there.

    Args:
        data: the file's content.
        start: where the tags begin; those of the first picture if None.
    """
    order = "<" if data[:2] == b"II" else ">"
    big = data[2:4] in (b"+\0", b"\0+")
    entry, count_word, offset_word = (20, "Q", "Q") if big else (12, "H", "I")
    try:
        (at,) = (start,) if start is not None else struct.unpack_from(order + offset_word, data, 8 if big else 4)
        (entries,) = struct.unpack_from(order + count_word, data, at)
        at += struct.calcsize(order + count_word)
        tags: dict[int, list[int]] = {}
        for place in range(at, at + entry * min(entries, 4096), entry):
            tag, kind, count = struct.unpack_from(f"{order}HH{offset_word}", data, place)
            inline = place + 4 + struct.calcsize(order + offset_word)
            size = _TIFF_SIZES.get(kind, 1) * count
            value = (
                inline if size <= entry - (inline - place) else struct.unpack_from(order + offset_word, data, inline)[0]
            )
            if value + size > len(data) or count > _MOST_TIFF_NUMBERS:
                return None
            if kind in _TIFF_WORDS:
                tags[tag] = list(struct.unpack_from(f"{order}{count}{_TIFF_WORDS[kind]}", data, value))
    except (struct.error, OverflowError):
        return None
    return tags


def metadata_chunk(data: bytes) -> bytes | None:
    """EXIF of a complete PNG or WebP file, as a TIFF file of its own; None where there is none."""
    png = data.startswith(b"\x89PNG")
    at, layout, head, tail = (8, ">I4s", b"eXIf", 4) if png else (12, "<4sI", b"EXIF", 0)
    while at + 8 <= len(data):
        fields = struct.unpack_from(layout, data, at)
        length, kind = fields if png else fields[::-1]
        if kind == head:
            return data[at + 8 : at + 8 + length].removeprefix(b"Exif\0\0")
        at += 8 + length + tail + (0 if png else length & 1)
    return None


def noted_orientation(data: bytes) -> int:
    """EXIF's number for how the camera of a complete PNG or WebP file was held, 1 to 8; 1 where nothing is noted."""
    tags = tiff_tags(metadata_chunk(data) or b"") or {}
    (orientation, *_) = tags.get(274) or [1]
    return orientation if 1 <= orientation <= 8 else 1


def is_raw(data: bytes) -> bool:
    """Whether a TIFF is the raw file of a camera: its first picture is a small preview, or sensor values that are no
    colours yet (DNG, CR2, NEF, ARW, ...)."""
    if data[8:10] == b"CR":
        return True
    tags = tiff_tags(data) or {}
    return bool((tags.get(254) or [0])[0] & 1) or (tags.get(262) or [0])[0] in _RAW_COLOURS


def _tiff_is_complete(data: bytes) -> bool:
    """The tags of its first picture are there, and all strips or tiles that they announce."""
    tags = tiff_tags(data)
    if tags is None:
        return False
    starts, sizes = (tags.get(273, tags.get(324, [])), tags.get(279, tags.get(325, [])))
    ends = [start + size for start, size in zip(starts, sizes, strict=False)]
    return bool(ends) and len(starts) == len(sizes) and max(ends) <= len(data)


def _tiff_extent(data: bytes) -> Extent | None:
    tags = tiff_tags(data) or {}
    if not tags.get(256) or not tags.get(257):
        return None
    depth, channels = max(tags.get(258) or [8]), max(tags.get(277) or [1])
    return Extent(tags[256][0], tags[257][0], max(4, channels * ((depth + 7) // 8)))


def boxes(data: bytes, start: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """(kind, start, end) of the contents of the ISO boxes in a part of a file; the end is beyond the file's where that
    is cut off."""
    while start + 8 <= end:
        size, kind = struct.unpack_from(">I4s", data, start)
        head = 8
        if size == 1 and start + 16 <= end:
            (size,) = struct.unpack_from(">Q", data, start + 8)
            head = 16
        if size == 0:  # to the end
            size = end - start
        if size < head:
            return
        yield kind, start + head, start + size
        start += size


def _iso_is_complete(data: bytes) -> bool:
    """Its boxes of descriptions and of data are all there."""
    found = {kind: end for kind, _, end in boxes(data, 0, len(data))}
    return b"meta" in found and max(found[b"meta"], found.get(b"mdat", 0)) <= len(data)


def iso_properties(data: bytes) -> dict[bytes, list[bytes]]:
    """Contents of the properties of an AVIF or HEIC file's items, by their kind."""
    found: dict[bytes, list[bytes]] = {}

    def look(start: int, end: int, path: tuple[bytes, ...]) -> None:
        for kind, at, to in boxes(data, start, min(end, len(data))):
            if path and kind == path[0]:
                look(at + 4 * (kind == b"meta"), to, path[1:])  # meta has a version and flags first
            elif not path:
                found.setdefault(kind, []).append(data[at:to])

    look(0, len(data), (b"meta", b"iprp", b"ipco"))
    return found


def _iso_extent(data: bytes) -> Extent | None:
    sizes = [struct.unpack_from(">II", each, 4) for each in iso_properties(data).get(b"ispe", []) if len(each) >= 12]
    return Extent(*max(sizes, key=lambda size: size[0] * size[1]), 8) if sizes else None


def _is_iso(*brands: bytes) -> Callable[[bytes], bool]:
    return lambda data: data[4:8] == b"ftyp" and data[8:12] in brands


PNG: Final = PictureKind(
    "PNG", (".png",), lambda data: data.startswith(b"\x89PNG\r\n\x1a\n"), _png_is_complete, _png_extent
)
JPEG: Final = PictureKind(
    "JPEG",
    (".jpg", ".jpeg", ".jfif", ".jpe", ".jif"),
    lambda data: data.startswith(b"\xff\xd8\xff"),
    _jpeg_is_complete,
    _jpeg_extent,
)
WEBP: Final = PictureKind(
    "WebP",
    (".webp",),
    lambda data: data.startswith(b"RIFF") and data[8:12] == b"WEBP",
    _webp_is_complete,
    _webp_extent,
)
BMP: Final = PictureKind("BMP", (".bmp", ".dib"), lambda data: data.startswith(b"BM"), _bmp_is_complete, _bmp_extent)
TIFF: Final = PictureKind(
    "TIFF",
    (".tif", ".tiff"),
    lambda data: data.startswith((b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")),
    _tiff_is_complete,
    _tiff_extent,
)
AVIF: Final = PictureKind("AVIF", (".avif",), _is_iso(b"avif", b"avis"), _iso_is_complete, _iso_extent)
HEIC: Final = PictureKind(
    "HEIC",
    (".heic", ".heif", ".hif"),
    _is_iso(b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1"),
    _iso_is_complete,
    _iso_extent,
)
KINDS: Final = (PNG, JPEG, WEBP, BMP, TIFF, AVIF, HEIC)
SUFFIXES: Final = tuple(suffix for kind in KINDS for suffix in kind.suffixes)


_OTHERS: Final[tuple[tuple[bytes, str], ...]] = (
    (b"GIF8", "a GIF"),
    (b"\0\0\0\x0cjP  ", "a JPEG 2000"),
    (b"\xff\x4f\xff\x51", "a JPEG 2000"),
    (b"\0\0\0\x0cJXL ", "a JPEG XL"),
    (b"\xff\x0a", "a JPEG XL"),
    (b"8BPS", "a Photoshop file"),
    (b"v/1\x01", "an OpenEXR"),
    (b"#?RADIANCE", "a Radiance HDR"),
    (b"\0\0\1\0", "an icon"),
    (b"FUJIFILMCCD-RAW", "a camera's raw picture"),
    (b"IIRO", "a camera's raw picture"),
    (b"IIU\0", "a camera's raw picture"),
    (b"%PDF", "a PDF"),
    (b"%!PS", "a PostScript file"),
    (b"<svg", "an SVG"),
    (b"P3", "a PNM"),
    (b"P5", "a PNM"),
    (b"P6", "a PNM"),
    (b"\x1a\x45\xdf\xa3", "a video"),
)
"""First bytes of pictures and documents that are not read."""


def other_kind_of(data: bytes) -> str | None:
    """What a file that is no picture of ours is, by its first bytes, with its article; None where they do not tell."""
    if data[4:8] == b"ftyp":
        return "a camera's raw picture" if data[8:12] == b"crx " else "a video"
    return next((name for start, name in _OTHERS if data.startswith(start)), None)


def kind_of(data: bytes) -> PictureKind | None:
    """The kind that a file's first bytes tell; None for no picture."""
    return next((kind for kind in KINDS if kind.starts(data)), None)
