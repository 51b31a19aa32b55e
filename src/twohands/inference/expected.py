"""Where the hands of a video will be in the frame that comes: they move on as they did, without changing their pose.

Ours; the paper's networks see every frame alone.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from twohands.inference.leaving import LONGEST_STEP
from twohands.inference.trail import Trail
from twohands.skeleton import LEFT, N_JOINTS, RIGHT
from twohands.types import HandPose, TwoHandPose

FARTHEST: Final = (0.08, 0.15)
"""How far, as a share of the hand's size, its joints may lie on average from where they were expected, as the first and
as the second pair of pose networks see them; farther, and HandSegNet looks, or the second pair once more (docs/history/
journal.md, *What segmentation at rest cost*, *Real hands followed* and *Hands followed farther*)."""


class Expected(NamedTuple):
    """What is expected of a frame, LEFT and RIGHT.

    Attributes:
        seen_px: (2, 2, 21, 2) where each pair of pose networks would see the hands; NaN where it did not see a hand in
            the last frame, and of all after a pause.
        pairs: (2,) the pair of pose networks whose joints counted in the last frame; the first where none of ours did.
        bodies_m: (2,) the `HandPose.body_range_m` of the last frame; NaN where they are not known.
        ranges: (2, 3) the `HandPose.range_shares` of the last frame; NaN where they are not known.
    """

    seen_px: np.ndarray
    pairs: np.ndarray
    ranges: np.ndarray
    bodies_m: np.ndarray

    @classmethod
    def of(cls, trail: Trail, time: float) -> Expected:
        """Of the frame that comes.

        Args:
            trail: of the clip.
            time: of the frame, on the clip's clock: `TwoHandPose.time_s`, or `index` where that is None.
        """
        newest = trail.last[-1]
        seen_px, pairs = _seen(newest), _pairs(newest)
        ranges = np.array([hand.range_shares or (np.nan,) * 3 for hand in newest.hands])
        bodies_m = np.array([np.nan if hand.body_range_m is None else hand.body_range_m for hand in newest.hands])
        if len(trail.last) < 2:
            return cls(seen_px, pairs, ranges, bodies_m)
        step, passed = clock(newest) - clock(trail.last[-2]), time - clock(newest)
        if not 0 < passed <= LONGEST_STEP * step:
            return cls(np.full_like(seen_px, np.nan), pairs, ranges, bodies_m)
        moved = (seen_px - _seen(trail.last[-2])).mean(axis=2, keepdims=True)
        for known in (moved[::-1], (joints_of(newest) - joints_of(trail.last[-2])).mean(axis=1, keepdims=True)):
            moved = np.where(np.isfinite(moved), moved, known)  # of a pair that saw one of both frames
        return cls(seen_px + np.nan_to_num(moved) * (passed / step), pairs, ranges, bodies_m)

    @property
    def joints_px(self) -> np.ndarray:
        """(2, 21, 2) where the hands will be, as the pair would see them whose joints counted."""
        return self.seen_px[self.pairs, [LEFT, RIGHT]]

    @property
    def present(self) -> np.ndarray:
        """(2,) bool, which hands are expected."""
        return np.asarray(np.isfinite(self.joints_px).all(axis=(1, 2)))


def as_expected(pose: TwoHandPose, trail: Trail | None) -> bool:
    """Whether hands may be followed from this frame on: the same sides are there as before, and hands that the first
    pair of pose networks sees are where they were expected, without which following them would most likely have
    failed. The second pair looks for its hands elsewhere, too."""
    if trail is None:
        return False
    pairs, expected, found_px = _pairs(pose), Expected.of(trail, clock(pose)), joints_of(pose)
    known = expected.present
    if (known != np.isfinite(found_px).all(axis=(1, 2))).any():
        return False
    first_px = np.where(np.isfinite(expected.seen_px[0]), expected.seen_px[0], expected.joints_px)
    there = (pairs > 0) | (strayed(first_px, found_px) <= FARTHEST[0])
    return bool(there[known].all())


def strayed(expected_px: np.ndarray, joints_px: np.ndarray) -> np.ndarray:
    """(B,) how far joints (B, 21, 2) lie from those expected, on average, as a share of the hands' size: the longer
    side of the box of those expected."""
    size_px = np.ptp(expected_px, axis=1).max(axis=-1)
    return np.linalg.norm(joints_px - expected_px, axis=-1).mean(axis=-1) / np.maximum(size_px, 1e-9)


def clock(pose: TwoHandPose) -> float:
    """When a frame was, on the clip's clock."""
    return float(pose.index if pose.time_s is None else pose.time_s)


def joints_of(pose: TwoHandPose) -> np.ndarray:
    """(2, 21, 2) the hands' joints in pixels, NaN for one that is not there."""
    return np.array([_joints(hand) for hand in pose.hands])


def _pairs(pose: TwoHandPose) -> np.ndarray:
    """(2,) the pair of pose networks that saw each hand; the first where none of ours did."""
    return np.array([hand.pair or 0 for hand in pose.hands])


def _seen(pose: TwoHandPose) -> np.ndarray:
    """(2, 2, 21, 2) the hands' joints in pixels as each pair of pose networks saw them, NaN where it did not."""
    seen_px = np.full((2, 2, N_JOINTS, 2), np.nan)
    for side, hand in enumerate(pose.hands):
        pair = hand.pair or 0
        seen_px[pair, side] = _joints(hand)
        if hand.present and hand.other_px is not None:
            seen_px[1 - pair, side] = hand.other_px
    return seen_px


def _joints(hand: HandPose) -> np.ndarray:
    known = hand.present and hand.joints_px is not None
    return np.asarray(hand.joints_px, np.float64) if known else np.full((N_JOINTS, 2), np.nan)
