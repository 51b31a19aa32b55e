"""The focal length that photographs note."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from twohands.formats.noted_camera import noted_camera, noted_focal_mm
from twohands.formats.pictures import decode_image


def exif(focal_35mm: int | None, size: tuple[int, int] | None = None, order: str = "<") -> bytes:
    """A block of EXIF: orientation, then the EXIF tags proper."""
    tags = [] if focal_35mm is None else [(41989, 3, focal_35mm)]
    tags += [] if size is None else [(40962, 4, size[0]), (40963, 4, size[1])]

    def entry(tag: int, kind: int, value: int) -> bytes:
        return struct.pack(order + "HHI", tag, kind, 1) + struct.pack(order + ("H2x" if kind == 3 else "I"), value)

    first = (
        struct.pack(order + "H", 2) + entry(274, 3, 1) + entry(34665, 4, 8 + 2 + 24 + 4) + struct.pack(order + "I", 0)
    )
    second = struct.pack(order + "H", len(tags)) + b"".join(entry(*tag) for tag in sorted(tags)) + b"\0\0\0\0"
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", 8)
    return head + first + second


def jpeg(block: bytes, width: int = 640, height: int = 480) -> bytes:
    plain = cv2.imencode(".jpg", np.full((height, width, 3), 90, np.uint8))[1].tobytes()
    segment = b"Exif\0\0" + block
    return plain[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + plain[2:]


def png(block: bytes, width: int = 640, height: int = 480) -> bytes:
    plain = cv2.imencode(".png", np.full((height, width, 3), 90, np.uint8))[1].tobytes()
    chunk = struct.pack(">I", len(block)) + b"eXIf" + block + struct.pack(">I", zlib.crc32(b"eXIf" + block))
    return plain[:33] + chunk + plain[33:]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("wrap", [jpeg, png])
def test_the_focal_length_counts_along_the_diagonal(wrap, order, tmp_path: Path):
    """26 mm on film of 43.27 mm diagonal; 640x480 has a diagonal of 800 pixels: 480.7 pixels."""
    path = tmp_path / "photo"
    path.write_bytes(wrap(exif(26, (4032, 3024), order)))
    camera = noted_camera(path, 640, 480)
    assert camera is not None and camera.fx == camera.fy == pytest.approx(26 / 43.2666 * 800, rel=1e-5)
    assert (camera.cx, camera.cy, camera.width, camera.height) == (320, 240, 640, 480)


def test_a_telephone_held_upright_has_the_same_lens():
    data = jpeg(exif(26, (4032, 3024)))
    assert noted_focal_mm(data, 480, 640) == noted_focal_mm(data, 640, 480) == 26


def test_a_cut_picture_has_none():
    assert noted_focal_mm(jpeg(exif(26, (4032, 3024))), 480, 480) is None


@pytest.mark.parametrize(
    "data", [jpeg(exif(None)), jpeg(exif(0)), jpeg(b"II*\0\xff\xff\xff\xff"), b"", b"\xff\xd8\xff"]
)
def test_nothing_noted_is_nothing(data: bytes):
    assert noted_focal_mm(data, 640, 480) is None


def test_the_pictures_are_still_read():
    assert decode_image(jpeg(exif(26))).shape == decode_image(png(exif(26))).shape == (480, 640, 3)


def test_no_damage_to_the_notes_raises():
    rng = np.random.default_rng(0)
    whole = exif(26, (640, 480))
    for _ in range(300):
        block = bytearray(whole)
        for at in rng.integers(0, len(block), 3):
            block[at] = rng.integers(256)
        noted_focal_mm(jpeg(bytes(block[: rng.integers(4, len(block) + 1)]), 32, 32), 640, 480)
