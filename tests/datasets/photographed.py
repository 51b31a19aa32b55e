"""A made-up photograph of a right hand before white paper, with its exact mask, and a folder of such photographs."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
from tests.builders import open_hand

from twohands.geometry.anatomy import anatomical_joints
from twohands.skeleton import BONES

SKIN = np.array([196.0, 146.0, 112.0])
SIZE = 100


def photograph(
    rng: np.random.Generator, shift: tuple[float, float] = (0, 0)
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Picture (100, 100, 3) with a shadow right of the hand, its mask (100, 100) bool, its joints (21, 2); the forearm
    leaves the picture below."""
    hand = anatomical_joints(open_hand()[:, :2])
    joints = hand * [-32, 38] + [48, 58] + np.array(shift)
    scale = 8
    mask = np.zeros((SIZE * scale, SIZE * scale), np.uint8)
    places = [tuple(np.rint(p * scale).astype(int).tolist()) for p in joints]
    for a, b in BONES:
        cv2.line(mask, places[a], places[b], 255, 6 * scale)
    cv2.fillConvexPoly(mask, cv2.convexHull(np.array([places[i] for i in (0, 1, 2, 5, 9, 13, 17)], np.int32)), 255)
    end = joints[0] + 3 * (joints[0] - joints[[5, 9, 13, 17]].mean(axis=0))
    cv2.line(mask, places[0], tuple(np.rint(end * scale).astype(int).tolist()), 255, 18 * scale)
    shadow = cv2.GaussianBlur(np.roll(mask, 3 * scale, axis=1), (0, 0), 1.5 * scale) / 255
    alpha = cv2.resize(mask, (SIZE, SIZE), interpolation=cv2.INTER_AREA)[..., None] / 255
    shadow = cv2.resize(shadow, (SIZE, SIZE), interpolation=cv2.INTER_AREA)[..., None]
    v, u = np.mgrid[:SIZE, :SIZE] / SIZE - 0.5
    paper = np.array([208.0, 210.0, 216.0]) * (1 - 0.6 * (u**2 + v**2))[..., None] * (1 - 0.6 * shadow)
    skin = SKIN * (1 - 0.2 * u[..., None])
    noise = rng.normal(0, 1.5, (SIZE, SIZE, 3))
    picture = np.clip(paper * (1 - alpha) + skin * alpha + noise, 0, 255)
    return np.rint(picture).astype(np.uint8), alpha[..., 0] > 0.5, joints


def write_digits(root: Path, persons: int = 5, digits: tuple[int, ...] = (0, 1, 5, 6)) -> None:
    """A folder of photographs as `datasets.digits.Digits` reads it."""
    rng = np.random.default_rng(0)
    (root / "images").mkdir(parents=True)
    labels, number = {}, 1118
    for _ in range(persons):
        for digit in digits:
            picture, _, joints = photograph(rng, tuple(rng.uniform(-3, 3, 2)))
            name = f"{digit}_IMG_{number}.jpg"
            cv2.imwrite(str(root / "images" / name), picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])
            labels[name] = {"digit": digit, "score": 0.98, "joints_px": joints.round(2).tolist()}
            number += 1
    (root / "pseudo_labels.json").write_text(json.dumps(labels))
