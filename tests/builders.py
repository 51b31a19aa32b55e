"""Hand-made poses and scenes for the tests: built without the code under test."""

from __future__ import annotations

import cv2
import numpy as np

from twohands.skeleton import LEFT, LITTLE_MCP, PARENTS, RIGHT, ROOT, WRIST, part_label
from twohands.types import HandSample, PinholeCamera

CENTRED_CAMERA = PinholeCamera.ego3dhands()
"""The paper's: f = 187.9 px, 480x270."""
OFF_CENTRE_CAMERA = PinholeCamera(822.79, 818.5, 290.47, 255.31, 640, 480)
"""Unequal focal lengths and a principal point far from the middle."""


def open_hand() -> np.ndarray:
    """(21, 3) relaxed left hand, unitless: root at 0, |wrist - root| = 1, |little MCP - root| = 0.38, fingers up."""
    knuckles = {
        1: (0.45, 0.75, -0.1),
        5: (0.24, 0.02, 0.0),
        9: (0.0, 0.0, 0.0),
        13: (-0.2, 0.05, 0.02),
        17: (-0.36, 0.12, 0.05),
    }
    steps = {
        1: (0.15, -0.3, -0.08),
        5: (0.05, -0.3, -0.1),
        9: (0.0, -0.33, -0.12),
        13: (-0.04, -0.3, -0.1),
        17: (-0.08, -0.24, -0.08),
    }
    hand = np.zeros((21, 3))
    hand[WRIST] = (0.0, 0.96, 0.28)
    for base, start in knuckles.items():
        for i in range(4):
            hand[base + i] = np.array(start) + i * np.array(steps[base])
    return hand


def random_rotations(n: int, rng: np.random.Generator) -> np.ndarray:
    """(n, 3, 3) uniformly distributed rotations."""
    q, r = np.linalg.qr(rng.standard_normal((n, 3, 3)))
    q = q * np.sign(np.diagonal(r, axis1=-2, axis2=-1))[:, None, :]
    q[np.linalg.det(q) < 0, :, 0] *= -1
    return q


def random_hands(n: int, camera: PinholeCamera, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Hands of random size, shape and rotation, with the root anywhere in the image.

    The first nine roots are the principal point, two points of its column, two of its row, and the image's corners.

    Returns:
        joints_m (n, 21, 3), joints_px (n, 21, 2), hand_length_m (n,); every joint lies in front of the camera.
    """
    u = rng.uniform(0, camera.width, n)
    v = rng.uniform(0, camera.height, n)
    w, h = camera.width, camera.height
    u[:9] = (camera.cx, camera.cx, camera.cx, 0.1 * w, 0.9 * w, 0, w, 0, w)[:n]
    v[:9] = (camera.cy, 0.1 * h, 0.9 * h, camera.cy, camera.cy, 0, 0, h, h)[:n]
    ray = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(n)], axis=-1)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    joints_m = np.zeros((n, 21, 3))
    length = np.zeros(n)
    todo = np.arange(n)
    while todo.size:  # draw again where a finger would reach behind the camera
        m = todo.size
        shape = open_hand() + 0.08 * rng.standard_normal((m, 21, 3))
        shape -= shape[:, ROOT : ROOT + 1]
        shape /= np.linalg.norm(shape[:, WRIST], axis=-1)[:, None, None]
        length[todo] = rng.uniform(0.06, 0.12, m)
        hand = shape @ random_rotations(m, rng) * length[todo, None, None]
        joints_m[todo] = hand + (ray[todo] * rng.uniform(0.15, 0.8, (m, 1)))[:, None]
        todo = todo[joints_m[todo, :, 2].min(axis=1) < 0.02]
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    return joints_m, joints_m[..., :2] / joints_m[..., 2:] * focal + centre, length


def sees_little_longer(joints_px: np.ndarray) -> np.ndarray:
    """(...) bool: the little MCP's 2D distance to the root is not below the wrist's."""
    across = np.linalg.norm(joints_px - joints_px[..., ROOT : ROOT + 1, :], axis=-1)
    return across[..., WRIST] <= across[..., LITTLE_MCP]


def make_hand(rng: np.random.Generator, side: int = LEFT) -> np.ndarray:
    """(21, 3) `open_hand` with noise, turned by up to 70 degrees, root at 0, |wrist - root| = 1; right: mirrored."""
    hand = open_hand() + 0.03 * rng.standard_normal((21, 3))
    axis = rng.standard_normal(3)
    turn, _ = cv2.Rodrigues(axis / np.linalg.norm(axis) * rng.uniform(0, 1.2))
    hand = (hand - hand[ROOT]) @ turn.T / np.linalg.norm(hand[WRIST] - hand[ROOT])
    return hand * [-1, 1, 1] if side == RIGHT else hand


def make_sample(
    rng: np.random.Generator,
    *,
    width: int = 240,
    height: int = 135,
    present: tuple[bool, bool] = (True, True),
    hand_length_m: float = 0.1,
) -> HandSample:
    """A picture of two hands drawn as coloured bones, with labels; all joints inside the picture."""
    camera = PinholeCamera.ego3dhands(width, height)
    image = rng.integers(40, 90, (height, width, 3), dtype=np.uint8)
    labels = np.zeros((height, width), np.uint8)
    joints_px, joints_m = np.full((2, 21, 2), np.nan), np.full((2, 21, 3), np.nan)
    for side in (LEFT, RIGHT):
        if not present[side]:
            continue
        hand = hand_length_m * make_hand(rng, side)
        while True:
            root = rng.uniform([0.05, -0.08, 0.3], [0.2, 0.1, 0.5]) * [1 if side == RIGHT else -1, 1, 1]
            points = camera.fx * (root + hand)[:, :2] / (root + hand)[:, 2:] + [camera.cx, camera.cy]
            if (points > 2).all() and (points < [width - 2, height - 2]).all():
                break
        joints_px[side], joints_m[side] = points, root + hand
        thickness = max(3, round(0.012 * camera.fx / root[2]))
        for joint in range(20, 0, -1):
            part = 1 if joint % 4 == 1 else 2 + (joint - 1) // 4
            ends = [tuple(int(v) for v in points[i]) for i in (PARENTS[joint], joint)]
            colour = (220 - 8 * joint, 90 + 7 * joint, 60 + 60 * side)
            cv2.line(image, ends[0], ends[1], colour, thickness)
            cv2.line(labels, ends[0], ends[1], part_label(side, part), thickness)
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
