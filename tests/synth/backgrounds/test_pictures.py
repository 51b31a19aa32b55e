"""Folders of pictures of which some cannot be read: those are skipped and named."""

import struct
import zlib

import cv2
import numpy as np

from twohands.synth.backgrounds.clip_sources import find_clips, unusable
from twohands.synth.backgrounds.pictures import PictureFolder, read_picture


def chunk(kind: bytes, content: bytes) -> bytes:
    body = kind + content
    return struct.pack(">I", len(content)) + body + struct.pack(">I", zlib.crc32(body))


def gigapixel() -> bytes:
    """A PNG of more than 2^30 pixels by its header, for which OpenCV raises instead of answering None."""
    header = struct.pack(">IIBBBBB", 40000, 30000, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")


def test_a_picture_of_too_many_pixels_is_skipped_and_named(tmp_path):
    (tmp_path / "a_panorama.png").write_bytes(gigapixel())
    cv2.imwrite(str(tmp_path / "b.png"), np.full((60, 80, 3), 90, np.uint8))
    folder = PictureFolder(tmp_path, "background", read_picture, keep=2)
    rng = np.random.default_rng(0)
    assert {folder.pick(rng)[0].name for _ in range(8)} == {"b.png"}
    assert folder.unreadable == ["background a_panorama.png cannot be read"]


def test_among_clips_it_is_unusable(tmp_path):
    (tmp_path / "a_panorama.png").write_bytes(gigapixel())
    (source,) = find_clips(tmp_path)
    assert unusable(source) == "not a picture that can be read"
