"""Interpenetration test on capsules: cheap enough to reject bad poses, close enough to keep hands out of each other."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from twohands.skeleton import FINGERTIPS
from twohands.synth.body import JOINT_BONES, Body, load_asset

_SEGMENTS = np.array(
    [(0, 1)]  # forearm; 22-joint indices (elbow, wrist, thumb..little)
    + [(1, 2 + 4 * f) for f in range(1, 5)]  # palm, wrist to the knuckles
    + [(2 + 4 * f + i, 3 + 4 * f + i) for f in range(5) for i in range(3)]
)
N_SEGMENTS = len(_SEGMENTS)


def _finger_of(segment: int) -> int:
    """Finger of a phalanx segment, -1 for forearm and palm."""
    return -1 if segment < 5 else (segment - 5) // 3


def _self_pairs() -> np.ndarray:
    """Pairs of segments of one hand that must not touch: phalanges of different fingers, and tips with the palm."""
    pairs = []
    for a in range(N_SEGMENTS):
        for b in range(a + 1, N_SEGMENTS):
            fa, fb = _finger_of(a), _finger_of(b)
            if fa >= 0 and fb >= 0 and fa != fb:
                # Neighbours touch along their first phalanges at rest.
                if (a - 5) % 3 == 0 and (b - 5) % 3 == 0:
                    continue
                pairs.append((a, b))
            elif (1 <= a <= 4 and fb >= 1 and (b - 5) % 3 >= 1) or (a == 0 and fb >= 0 and (b - 5) % 3 >= 1):
                pairs.append((a, b))
    return np.array(pairs)


_SELF_PAIRS = _self_pairs()
_CROSS_PAIRS = np.stack(np.meshgrid(np.arange(N_SEGMENTS), np.arange(N_SEGMENTS), indexing="ij"), -1).reshape(-1, 2)


@lru_cache(maxsize=1)
def _radii() -> np.ndarray:
    """(20,) capsule radii in metres on the average body: median distance of a bone's vertices from its segment."""
    asset = load_asset()
    body = asset.body()
    joints = body.joints[0]
    strongest = np.take_along_axis(asset.bone_index, asset.bone_weight.argmax(1)[:, None], 1)[:, 0]
    radii = np.empty(N_SEGMENTS)
    for i, (a, b) in enumerate(_SEGMENTS):
        if i == 0:
            bones = [JOINT_BONES[0, 0], JOINT_BONES[0, 0] + 1]
        elif i < 5:
            radii[i] = 0.011
            continue
        else:
            bones = [JOINT_BONES[0, a]]
        points = body.vertices[np.isin(strongest, bones)]
        axis = (joints[b] - joints[a]) / np.linalg.norm(joints[b] - joints[a])
        offset = points - joints[a]
        radii[i] = np.median(np.linalg.norm(offset - np.outer(offset @ axis, axis), axis=1))
    radii[0] *= 1.1
    return radii


def segment_distance(a0: np.ndarray, a1: np.ndarray, b0: np.ndarray, b1: np.ndarray) -> np.ndarray:
    """Smallest distance between segments a0-a1 and b0-b1, all (N, 3); (N,) in the unit of the input."""
    u, v, w = a1 - a0, b1 - b0, a0 - b0
    uu, uv, vv = (u * u).sum(-1), (u * v).sum(-1), (v * v).sum(-1)
    uw, vw = (u * w).sum(-1), (v * w).sum(-1)
    det = uu * vv - uv * uv
    s = np.clip(np.where(det > 1e-12, (uv * vw - vv * uw) / np.maximum(det, 1e-12), 0.0), 0, 1)
    t = np.clip((uv * s + vw) / np.maximum(vv, 1e-12), 0, 1)
    s = np.clip((uv * t - uw) / np.maximum(uu, 1e-12), 0, 1)
    return np.linalg.norm(w + s[:, None] * u - t[:, None] * v, axis=-1)


def hands_collide(body: Body, transforms: np.ndarray, joints: np.ndarray, present: np.ndarray) -> bool:
    """Whether any finger enters the palm, another finger, or the other hand or forearm.

    Args:
        body: the person.
        transforms: (48, 3, 4) pose, unused bones included.
        joints: (2, 22, 3) posed joints in the body's metres.
        present: (2,) bool; absent arms cannot collide.

    Returns:
        True if two capsules overlap by more than the flesh yields.
    """
    del transforms
    radii = _radii() * (body.hand_length_m / load_asset().body().hand_length_m)
    starts, ends = joints[:, _SEGMENTS[:, 0]].copy(), joints[:, _SEGMENTS[:, 1]].copy()
    # The forearm capsule starts a little before the wrist, where the palm's capsules take over.
    for side in np.flatnonzero(present):
        a, b = _SELF_PAIRS.T
        gap = segment_distance(starts[side][a], ends[side][a], starts[side][b], ends[side][b])
        if (gap < 0.72 * (radii[a] + radii[b])).any():
            return True
    if present.all():
        a, b = _CROSS_PAIRS.T
        gap = segment_distance(starts[0][a], ends[0][a], starts[1][b], ends[1][b])
        if (gap < 1.02 * (radii[a] + radii[b])).any():
            return True
    return False


__all__ = ["FINGERTIPS", "hands_collide", "segment_distance"]
