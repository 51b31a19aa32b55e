"""Synthetic motions with known answers, made without the code under test."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from tests.builders import open_hand

from twohands.inference.clip_files import frame_line, header_line
from twohands.motion.clip import HandMotion
from twohands.skeleton import RIGHT
from twohands.types import HandPose, PinholeCamera, TwoHandPose

CAMERA = PinholeCamera(500.0, 510.0, 320.0, 250.0, 640, 480)
ABSENT = HandPose(present=False)


def turn_about(axis: np.ndarray, angle: float) -> np.ndarray:
    """(3, 3) rotation by Rodrigues' formula."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def bent_hand(curls: np.ndarray, side: int) -> np.ndarray:
    """(21, 3) metres, a hand of 10 cm whose finger joints are bent by the angles (5, 3) about the row of knuckles."""
    hand = open_hand()
    across = hand[5] - hand[17]
    for finger in range(5):
        base = 1 + 4 * finger
        for i in range(3):
            turn = turn_about(across, -curls[finger, i])
            pivot = hand[base + i].copy()
            hand[base + i + 1 : base + 4] = (hand[base + i + 1 : base + 4] - pivot) @ turn.T + pivot
    return 0.1 * hand * ([-1, 1, 1] if side == RIGHT else [1, 1, 1])


def moving_hands(
    frames: int, seed: int = 0, valid: np.ndarray | None = None, times: np.ndarray | None = None
) -> HandMotion:
    """Both hands turn, move and bend; bones keep their lengths exactly.

    Args:
        frames: how many.
        seed: of the motion.
        valid: (F, 2) bool; all if not given.
        times: (F,) seconds; 30 a second if not given.
    """
    rng = np.random.default_rng(seed)
    valid = np.ones((frames, 2), bool) if valid is None else valid
    joints = np.full((frames, 2, 21, 3), np.nan)
    for side in range(2):
        axis, start, curl = rng.standard_normal(3), rng.uniform(-1, 1), rng.uniform(0.1, 0.6, (5, 3))
        for frame in range(frames):
            phase = frame / 10
            hand = bent_hand(curl * (1 + np.sin(phase)), side) @ turn_about(axis, start + phase).T
            joints[frame, side] = hand + np.array([0.3 * side - 0.15, 0.05 * np.sin(phase), 0.5 + 0.1 * np.cos(phase)])
    joints[~valid] = np.nan
    times = np.arange(frames) / 30 if times is None else times
    return HandMotion(times, np.arange(frames), joints, valid, CAMERA, "made up")


def pose_of(joints: np.ndarray | None) -> HandPose:
    """A hand with these joints (21, 3), camera frame, metres; an absent one of None."""
    if joints is None:
        return ABSENT
    return HandPose(
        present=True,
        score=0.9,
        box_px=np.array([1.0, 2.0, 3.0, 4.0]),
        joints_px=np.zeros((21, 2)),
        joint_scores=np.ones(21),
        canonical=np.zeros((21, 3)),
        joints_m=joints,
        range_m=float(np.linalg.norm(joints[9])),
        theta_deg=0.0,
        phi_deg=0.0,
        key_bone="wrist",
        method="fitted",
        valid=True,
    )


def poses_of(motion: HandMotion) -> list[TwoHandPose]:
    """The frames of a motion."""
    return [
        TwoHandPose(
            *(pose_of(joints[s] if valid[s] else None) for s in range(2)), motion.camera, index=index, time_s=time_s
        )
        for joints, valid, index, time_s in zip(
            motion.joints_m, motion.valid, motion.index.tolist(), motion.time_s.tolist(), strict=True
        )
    ]


def write_jsonl(motion: HandMotion, path: Path) -> Path:
    """The motion as hands.jsonl."""
    header = header_line(motion.camera, source=motion.source, weights="none", hand_length_m=0.1)
    path.write_text("\n".join([header, *map(frame_line, poses_of(motion))]) + "\n", encoding="utf-8")
    return path
