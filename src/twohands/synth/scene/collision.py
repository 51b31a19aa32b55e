"""Interpenetration test on capsules: cheap enough to reject bad poses, close enough to keep hands out of each other."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from twohands.synth.scene.body import JOINT_BONES, Body, load_asset
from twohands.synth.scene.pose import dot

_SEGMENTS = np.array(
    [(0, 1)]  # forearm; 22-joint indices (elbow, wrist, thumb..little)
    + [(1, 2 + 4 * f) for f in range(1, 5)]  # palm, wrist to the knuckles
    + [(2 + 4 * f + i, 3 + 4 * f + i) for f in range(5) for i in range(3)]
)
N_SEGMENTS = len(_SEGMENTS)
PALM_RADIUS_M = 0.0135
"""Of the four capsules that fill the palm of the average hand."""
FINGERS_TOUCH, PALM_TOUCH, HANDS_TOUCH = 0.72, 0.9, 0.98
"""Two capsules collide when nearer than this share of their radii's sum: fingers lie side by side with their flesh
pressed together, the palm yields little, two hands may just touch."""


def _finger_of(segment: int) -> int:
    """Finger of a phalanx segment, -1 for forearm and palm."""
    return -1 if segment < 5 else (segment - 5) // 3


def _self_pairs() -> tuple[np.ndarray, np.ndarray]:
    """Pairs (N, 2) of segments of one hand that must not enter each other, and the share (N,) at which they do.

    Phalanges of different fingers, and everything beyond the first phalanx with palm and forearm. First phalanges of
    neighbours touch at rest, and the thumb's second segment begins in the palm.
    """
    pairs, shares = [], []
    for a in range(N_SEGMENTS):
        for b in range(a + 1, N_SEGMENTS):
            fa, fb, first_a, beyond_b = _finger_of(a), _finger_of(b), (a - 5) % 3 == 0, (b - 5) % 3
            if fa >= 0 and fb >= 0 and fa != fb and not (first_a and beyond_b == 0):
                pairs.append((a, b))
                shares.append(FINGERS_TOUCH)
            elif fa < 0 and beyond_b >= (2 if fb == 0 else 1) and fb >= 0:
                pairs.append((a, b))
                shares.append(PALM_TOUCH)
    return np.array(pairs), np.array(shares)


_SELF_PAIRS, _SELF_SHARES = _self_pairs()
_SELF_STARTS, _SELF_ENDS = (_SEGMENTS[_SELF_PAIRS, end] for end in (0, 1))  # (N, 2) joints


@lru_cache(maxsize=1)
def _radii() -> np.ndarray:
    """(20,) capsule radii in hand lengths: median distance of a bone's vertices from its segment, average body."""
    asset = load_asset()
    body = asset.body()
    joints = body.joints[0]
    strongest = np.take_along_axis(asset.bone_index, asset.bone_weight.argmax(1)[:, None], 1)[:, 0]
    radii = np.empty(N_SEGMENTS)
    for i, (a, b) in enumerate(_SEGMENTS):
        if i == 0:
            bones = [JOINT_BONES[0, 0], JOINT_BONES[0, 0] + 1]
        elif i < 5:
            radii[i] = PALM_RADIUS_M
            continue
        else:
            bones = [JOINT_BONES[0, a]]
        points = body.vertices[np.isin(strongest, bones)]
        axis = (joints[b] - joints[a]) / np.linalg.norm(joints[b] - joints[a])
        offset = points - joints[a]
        radii[i] = np.median(np.linalg.norm(offset - np.outer(offset @ axis, axis), axis=1))
    radii[0] *= 1.1
    return radii / body.hand_length_m


def segment_distance(a0: np.ndarray, a1: np.ndarray, b0: np.ndarray, b1: np.ndarray) -> np.ndarray:
    """(...) smallest distances between segments a0-a1 and b0-b1, all (..., 3), in the unit of the input."""
    u, v, w = a1 - a0, b1 - b0, a0 - b0
    uu, uv, vv, uw, vw = dot(u, u), dot(u, v), dot(v, v), dot(u, w), dot(v, w)
    det = uu * vv - uv * uv
    s = _clipped(np.where(det > 1e-12, (uv * vw - vv * uw) / np.maximum(det, 1e-12), 0.0))
    t = _clipped((uv * s + vw) / np.maximum(vv, 1e-12))
    s = _clipped((uv * t - uw) / np.maximum(uu, 1e-12))
    apart = w + s[..., None] * u - t[..., None] * v
    return np.sqrt(dot(apart, apart))


def _clipped(share: np.ndarray) -> np.ndarray:
    """Into [0, 1]; `np.clip` costs more on small arrays."""
    return np.minimum(np.maximum(share, 0.0), 1.0)


def _sized_radii(body: Body) -> np.ndarray:
    return _radii() * body.hand_length_m


def capsules(body: Body, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The bones of hands and forearms as capsules.

    Args:
        body: the person.
        joints: (H, 22, 3) posed joints of H hands.

    Returns:
        (20 H, 3) starts and ends in the unit of `joints`, and (20 H,) radii in the body's metres.
    """
    starts, ends = joints[:, _SEGMENTS[:, 0]], joints[:, _SEGMENTS[:, 1]]
    return starts.reshape(-1, 3), ends.reshape(-1, 3), np.tile(_sized_radii(body), len(joints))


def hand_enters_itself(body: Body, joints: np.ndarray) -> np.ndarray:
    """(...) bool, whether a finger enters the palm, the forearm or another finger by more than the flesh yields.

    Args:
        body: the person.
        joints: (..., 22, 3) posed joints of one arm in the body's metres.
    """
    starts, ends = joints[..., _SELF_STARTS, :], joints[..., _SELF_ENDS, :]  # (..., N, 2, 3)
    gap = segment_distance(starts[..., 0, :], ends[..., 0, :], starts[..., 1, :], ends[..., 1, :])
    return (gap < _SELF_SHARES * _sized_radii(body)[_SELF_PAIRS].sum(-1)).any(-1)


def hands_collide(body: Body, joints: np.ndarray, touch: float | np.ndarray = HANDS_TOUCH) -> np.ndarray:
    """(...) bool, whether a hand or forearm enters the other.

    Args:
        body: the person.
        joints: (..., 2, 22, 3) posed joints in the body's metres.
        touch: they do where nearer than this share of their radii's sum; of all pairs, or (20, 20) of each.
    """
    radii = _sized_radii(body)
    low, high = joints.min(-2), joints.max(-2)  # (..., 2, 3)
    apart = np.maximum(low[..., 0, :] - high[..., 1, :], low[..., 1, :] - high[..., 0, :]).max(-1)
    collide = np.asarray(apart < 2 * radii.max())  # whose boxes are farther apart need no closer look
    starts, ends = joints[collide][:, :, _SEGMENTS[:, 0]], joints[collide][:, :, _SEGMENTS[:, 1]]  # (M, 2, 20, 3)
    gap = segment_distance(starts[:, 0, :, None], ends[:, 0, :, None], starts[:, 1, None], ends[:, 1, None])
    collide[collide] = (gap < touch * (radii[:, None] + radii)).any((-2, -1))
    return collide[()]
