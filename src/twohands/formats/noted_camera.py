"""The camera that a photograph itself tells of: EXIF's FocalLengthIn35mmFilm.

It is the focal length with which film of 36 x 24 mm sees the same angle along the diagonal; telephones and most cameras
note it, in whole millimetres, digital zoom included. Cutting a picture afterwards leaves it wrong: where EXIF's own
size has another aspect than the picture, it does not count.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

from twohands.formats.picture_kinds import AVIF, HEIC, JPEG, PNG, TIFF, WEBP, kind_of, metadata_chunk, tiff_tags
from twohands.types import PinholeCamera

FILM_DIAGONAL_MM: Final = math.hypot(36.0, 24.0)
_EXIF: Final = 34665
_FOCAL_35MM, _WIDTH, _HEIGHT = 41989, 40962, 40963
_MOST_BYTES: Final = 1 << 29


def noted_camera(path: Path, width: int, height: int) -> PinholeCamera | None:
    """The camera of a photograph, from what its file notes.

    Args:
        path: of a picture that can be read.
        width, height: of the upright picture, pixels.

    Returns:
        Square pixels, the principal point in the middle, no distortion; None where nothing is noted, or nothing that
        fits the picture.
    """
    try:
        with path.open("rb") as file:
            focal_mm = noted_focal_mm(file.read(_MOST_BYTES), width, height)
    except OSError:
        return None
    if focal_mm is None:
        return None
    focal_px = focal_mm / FILM_DIAGONAL_MM * math.hypot(width, height)
    return PinholeCamera(focal_px, focal_px, width / 2, height / 2, width, height)


def noted_focal_mm(data: bytes, width: int, height: int) -> float | None:
    """EXIF's FocalLengthIn35mmFilm of a picture file's content, millimetres; None where it is not noted, or for a
    picture of another aspect."""
    block = _exif_block(data)
    if block is None:
        return None
    pointer = (tiff_tags(block) or {}).get(_EXIF)
    tags = tiff_tags(block, pointer[0]) if pointer else None
    if not tags or not tags.get(_FOCAL_35MM) or not tags[_FOCAL_35MM][0]:
        return None
    noted = sorted(tags[name][0] for name in (_WIDTH, _HEIGHT) if tags.get(name))
    if len(noted) == 2 and noted[0] > 0:
        short, long = sorted((width, height))
        if abs(noted[0] * long - noted[1] * short) > max(noted[1], long):  # more than rounding to whole pixels
            return None
    return float(tags[_FOCAL_35MM][0])


def _exif_block(data: bytes) -> bytes | None:
    """EXIF as a TIFF file of its own; None where there is none."""
    kind = kind_of(data)
    if kind is TIFF:
        return data
    if kind in (PNG, WEBP):
        return metadata_chunk(data)
    if kind in (JPEG, HEIC, AVIF):
        for start in (b"Exif\0\0II*\0", b"Exif\0\0MM\0*"):
            if (at := data.find(start)) >= 0:
                return data[at + 6 :]
    return None
