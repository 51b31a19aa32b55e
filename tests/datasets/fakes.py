"""Tiny datasets in the Ego3DHands layout, made from the codec and a flat rendering, for tests of readers only."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from twohands.formats import ego3dhands as fmt
from twohands.geometry.camera import project
from twohands.geometry.canonical import canonical_from_camera
from twohands.skeleton import LEFT, RIGHT, ROOT, part_label
from twohands.types import PinholeCamera

WIDTH, HEIGHT = 96, 54
SKIN = {LEFT: (200, 150, 120), RIGHT: (120, 150, 200)}


def hand_joints_m(root: tuple[float, float, float]) -> np.ndarray:
    """(22, 3) an open hand with |wrist - root| = 0.10 m and its elbow, fingers pointing up."""
    joints = [(0.0, 0.30, 0.0), (0.0, 0.10, 0.0)]  # elbow, wrist
    for finger in range(5):
        joints += [(0.02 * (finger - 2), -0.02 * bone, 0.001 * bone) for bone in range(4)]
    joints = np.array(joints)
    joints[1 + ROOT] = 0.0
    return joints + np.array(root)


def write_instance(
    folder: Path, *, left: bool = True, right: bool = True, size: tuple[int, int] = (WIDTH, HEIGHT)
) -> np.ndarray:
    """Writes a consistent instance: a disc of depth 5 mm before every joint.

    Returns:
        (2, 22, 3) joints in metres.
    """
    folder.mkdir(parents=True)
    width, height = size
    camera = PinholeCamera.ego3dhands(width, height)
    joints_m = np.stack([hand_joints_m((-0.1, 0.02, 0.30)), hand_joints_m((0.08, 0.0, 0.35))])
    joints_m[[not left, not right]] = np.nan
    joints_px = project(joints_m, camera)
    depth, labels = np.zeros((height, width)), np.zeros((height, width), np.uint8)
    rgba = np.zeros((height, width, 4), np.uint8)
    for side in (LEFT, RIGHT):
        for index, (point, joint) in enumerate(zip(joints_px[side], joints_m[side], strict=True)):
            if not np.isfinite(point).all():
                continue
            disc = np.zeros((height, width), np.uint8)
            cv2.circle(disc, tuple(int(x) for x in np.floor(point)), 2, 1, -1)
            nearer = (disc > 0) & ((depth == 0) | (joint[2] - 0.005 < depth))
            depth[nearer] = joint[2] - 0.005
            labels[nearer] = part_label(side, 0 if index < 2 else 2 + (index - 2) // 4)
            rgba[nearer] = (*SKIN[side], 255)
    canonical = np.full((2, 22, 3), np.nan)
    canonical[:, 1:] = canonical_from_camera(joints_m[:, 1:]).joints
    canonical[:, 0] = np.where(np.isfinite(joints_m[:, 0]), 1.0, np.nan)  # the elbow's entry is not checked
    image = np.where(rgba[..., 3:] > 0, rgba[..., :3], np.uint8(40))
    write_png(folder / fmt.COLOR_FILE, rgba)
    write_png(folder / fmt.IMAGE_FILE, image)
    write_png(folder / fmt.LABELS_FILE, fmt.encode_labels(labels))
    write_png(folder / fmt.DEPTH_FILE, fmt.encode_depth(depth))
    np.save(folder / fmt.JOINTS_2D_FILE, fmt.encode_joints_px(joints_px, width, height))
    np.save(folder / fmt.JOINTS_3D_FILE, fmt.encode_joints_m(joints_m))
    np.save(folder / fmt.CANONICAL_FILE, fmt.encode_canonical(canonical))
    return joints_m


def write_png(path: Path, pixels: np.ndarray) -> None:
    """RGB or RGBA."""
    order = cv2.COLOR_RGB2BGR if pixels.shape[2] == 3 else cv2.COLOR_RGBA2BGRA
    assert cv2.imwrite(str(path), cv2.cvtColor(pixels, order))
