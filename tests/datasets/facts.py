"""What must hold for every hand of every data set, and the pictures of their fakes."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np

from twohands.geometry.camera import project
from twohands.geometry.canonical import canonical_from_camera
from twohands.geometry.projection import project_global
from twohands.skeleton import JOINT_NAMES, LEFT, RIGHT, ROOT
from twohands.types import HandSample

UP, DOWN = (1, 2, 3, 4), (4, 3, 2, 1)


def by_name(names: list[str]) -> list[int]:
    """Our index of every joint of another order, spelled by name: theirs = ours[by_name(their_names)]."""
    assert sorted(names) == sorted(JOINT_NAMES)
    return [JOINT_NAMES.index(name) for name in names]


def side_from_shape(joints: np.ndarray) -> int:
    """LEFT or RIGHT from the 3D joints (21, 3) alone: fingers bend towards the palm, and the thumb lies before it.

    (index MCP - wrist) x (little MCP - wrist) leaves a right hand through its palm, a left hand through its back.
    """
    normal = np.cross(joints[5] - joints[0], joints[17] - joints[0])
    bend = float(((joints[1:5] - joints[0]) @ normal).sum())
    for base in (5, 9, 13, 17):
        first = joints[base + 1] - joints[base]
        rest = joints[base + 3] - joints[base + 1]
        bend += (rest - first * (rest @ first) / (first @ first)) @ normal
    return RIGHT if bend > 0 else LEFT


def curled_hand(side: int, root: tuple[float, float, float]) -> np.ndarray:
    """(21, 3) metres: palm to the camera, fingers up and bent towards it, |wrist - root| = 0.09 m.

    The right hand's thumb then points to +x, the left hand's to -x.
    """
    joints = np.zeros((21, 3))
    joints[0] = (0.0, 0.09, 0.0)
    for finger, base in enumerate((1, 5, 9, 13, 17)):
        joints[base] = (0.04, 0.06, -0.01) if finger == 0 else (0.02 * (2 - finger), 0.004 * abs(2 - finger), 0.0)
        for bone, (length, bend) in enumerate(((0.04, 0.2), (0.025, 0.6), (0.018, 0.9))):
            step = (length * 0.5 if finger == 0 else 0.0, -length * np.cos(bend), -length * np.sin(bend))
            joints[base + bone + 1] = joints[base + bone] + step
    return joints * ([1, 1, 1] if side == RIGHT else [-1, 1, 1]) + root


def check_hands(sample: HandSample, reprojection_px: float = 1e-9, *, anatomy: bool = True) -> None:
    """Reprojection, handedness, joint order, and the global projection from the sample's own labels."""
    assert sample.joints_px.shape == (2, 21, 2) and sample.joints_m.shape == (2, 21, 3)
    assert sample.image.shape == (sample.camera.height, sample.camera.width, 3) and sample.image.dtype == np.uint8
    for side in (LEFT, RIGHT):
        if not sample.present[side]:
            assert not sample.valid[side].any() and np.isnan(sample.joints_m[side]).all()
            continue
        joints_m = sample.joints_m[side]
        assert sample.valid[side].all()
        assert 0.1 < joints_m[ROOT, 2] < 3.0  # metres in front of the camera
        assert 0.02 < np.linalg.norm(joints_m[0] - joints_m[ROOT]) < 0.13
        seen = project(joints_m, sample.camera)
        assert np.abs(seen - sample.joints_px[side]).max() < reprojection_px
        if anatomy:
            assert side_from_shape(joints_m) == side
            for base in (1, 5, 9, 13, 17):  # bones of a finger become shorter towards the tip, knuckles lie at the base
                bones = np.linalg.norm(np.diff(joints_m[base : base + 4], axis=0), axis=1)
                assert bones[0] > bones[2] or base == 1
                assert bones.min() > 0.01 and bones.max() < 0.08
        canonical = canonical_from_camera(joints_m)
        for method in ("all-joints", "keybone"):
            pose = project_global(canonical.joints, seen, sample.camera, canonical.hand_length_m, method=method)
            assert pose.valid and np.abs(pose.joints_m - joints_m).max() < 1e-6


def write_picture(path: Path, width: int, height: int, colour: tuple[int, int, int] = (200, 100, 50)) -> None:
    """One colour, RGB; PNG or JPEG after the name."""
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.full((height, width, 3), colour[::-1], np.uint8))


def cut_off(path: Path, keep: float) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data))])


def huge_png(data: bytes) -> bytes:
    """The same PNG with a header of 60,000 by 60,000 pixels, and that header's checksum."""
    header = b"IHDR" + struct.pack(">II", 60_000, 60_000) + data[24:29]
    return data[:12] + header + struct.pack(">I", zlib.crc32(header)) + data[33:]


def huge_jpeg(data: bytes) -> bytes:
    """The same JPEG with a header of 60,000 by 60,000 pixels."""
    size = data.index(b"\xff\xc0") + 5
    return data[:size] + struct.pack(">HH", 60_000, 60_000) + data[size + 4 :]
