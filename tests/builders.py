"""Hand-made hands and pictures for the tests."""

from __future__ import annotations

import cv2
import numpy as np

from twohands.geometry.camera import project
from twohands.skeleton import LEFT, PARENTS, RIGHT, ROOT, WRIST, part_label
from twohands.types import HandSample, PinholeCamera

FINGER_LENGTHS = ((0.35, 0.45, 0.35, 0.3), (1.0, 0.45, 0.27, 0.22), (1.0, 0.5, 0.3, 0.23), (0.95, 0.45, 0.28, 0.23),
                  (0.9, 0.36, 0.22, 0.2))  # fmt: skip
"""Lengths of the four bones of each finger, thumb to little, in hand lengths."""


def make_hand(rng: np.random.Generator, side: int = LEFT) -> np.ndarray:
    """A bent hand: (21, 3), root at 0, |wrist - root| = 1, randomly turned; left and right are mirror images."""
    joints = np.zeros((21, 3))
    for finger, lengths in enumerate(FINGER_LENGTHS):
        spread = np.radians(40 - 20 * finger + (25 if finger == 0 else 0))
        flexion = rng.uniform(0, 0.6)
        for k, length in enumerate(lengths):
            joint = 1 + 4 * finger + k
            bend = flexion * k
            direction = [np.sin(spread) * np.cos(bend), -np.cos(spread) * np.cos(bend), np.sin(bend)]
            joints[joint] = joints[PARENTS[joint]] + length * np.array(direction)
    if side == RIGHT:
        joints[:, 0] *= -1
    axis, angle = rng.normal(size=3), rng.uniform(0, 1.2)
    turn, _ = cv2.Rodrigues(axis / np.linalg.norm(axis) * angle)
    joints = joints @ turn.T
    joints -= joints[ROOT].copy()
    return joints / np.linalg.norm(joints[WRIST])


def make_sample(
    rng: np.random.Generator,
    *,
    width: int = 240,
    height: int = 135,
    present: tuple[bool, bool] = (True, True),
    hand_length_m: float = 0.1,
) -> HandSample:
    """A picture of two hands drawn as bones and blobs, with labels; all joints inside the picture."""
    camera = PinholeCamera.ego3dhands(width, height)
    image = rng.integers(40, 90, (height, width, 3), dtype=np.uint8)
    labels = np.zeros((height, width), np.uint8)
    joints_px, joints_m = np.full((2, 21, 2), np.nan), np.full((2, 21, 3), np.nan)
    for side in (LEFT, RIGHT):
        if not present[side]:
            continue
        canonical = make_hand(rng, side)
        while True:
            root = np.array([rng.uniform(0.05, 0.2) * (1 if side else -1), rng.uniform(-0.08, 0.1), rng.uniform(0.3, 0.5)])
            points = project(root + hand_length_m * canonical, camera)
            if np.isfinite(points).all() and (points > 2).all() and (points < [width - 2, height - 2]).all():
                break
        joints_px[side], joints_m[side] = points, root + hand_length_m * canonical
        thickness = max(3, round(0.012 * camera.fx / root[2]))
        for joint in range(20, 0, -1):
            part = 1 if joint % 4 == 1 else 2 + (joint - 1) // 4
            ends = [tuple(int(v) for v in points[i]) for i in (PARENTS[joint], joint)]
            colour = (220 - 8 * joint, 90 + 7 * joint, 60 + 60 * side)
            cv2.line(image, ends[0], ends[1], colour, thickness)
            cv2.line(labels, ends[0], ends[1], part_label(side, part), thickness)  # type: ignore[call-overload]
    return HandSample(
        image=image,
        camera=camera,
        present=np.array(present),
        joints_px=joints_px,
        joints_m=joints_m,
        valid=np.isfinite(joints_px).all(axis=-1),
        labels=labels,
        source="hand-made",
    )


def make_samples(count: int, seed: int = 0, **options) -> list[HandSample]:
    """`count` pictures, the same for the same seed."""
    return [make_sample(np.random.default_rng([seed, i]), **options) for i in range(count)]
