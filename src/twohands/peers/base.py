"""What the harness asks of another system, and how its hands are given their sides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any, Literal, Protocol

import numpy as np

from twohands.skeleton import LEFT, RIGHT
from twohands.types import HandSample, TwoHandPose

Handedness = Literal["own", "matched"]
"""Whose word counts on which hand is which: the system's own, or the labels' (an oracle, to tell errors apart)."""


class Peer(Protocol):
    """Another system. It may use picture, intrinsics and hand length of a sample, and labels only where it says so."""

    @property
    def name(self) -> str:
        """What identifies the system and its version."""
        ...

    @property
    def settings(self) -> dict[str, Any]:
        """Everything else needed to repeat the run, as JSON values, use of labels included."""
        ...

    def __call__(self, sample: HandSample) -> TwoHandPose:
        """Estimates one picture."""
        ...


@dataclass(frozen=True, slots=True)
class DetectedHand:
    """One hand as a system found it.

    Attributes:
        side: LEFT or RIGHT, in its own opinion, of an unmirrored picture.
        score: 0..1, of that opinion.
        joints_px: (21, 2) pixels.
        shape_m: (21, 3) metres of its own, any origin, seen by a camera that looks at the hand.
    """

    side: int
    score: float
    joints_px: np.ndarray
    shape_m: np.ndarray


def by_own_handedness(hands: Sequence[DetectedHand]) -> tuple[DetectedHand | None, DetectedHand | None]:
    """(LEFT, RIGHT) by the system's own opinion; of two with one side, the less certain takes the other side.

    Without that favour a system that finds both hands and errs on one of them would be charged twice.
    """
    sides: list[DetectedHand | None] = [None, None]
    for hand in sorted(hands, key=lambda hand: -hand.score):
        for side in (hand.side, 1 - hand.side):
            if sides[side] is None:
                sides[side] = hand
                break
    return sides[LEFT], sides[RIGHT]


def by_labels(
    hands: Sequence[DetectedHand], joints_px: np.ndarray, present: np.ndarray
) -> tuple[DetectedHand | None, DetectedHand | None]:
    """(LEFT, RIGHT) by the labels: the assignment with the smallest sum of mean 2D distances.

    Args:
        hands: the two best scored count.
        joints_px: (2, 21, 2) labelled pixels, NaN where unknown.
        present: (2,) bool. A detection that has no labelled hand left keeps the free side: it is false there too.
    """
    best = sorted(hands, key=lambda hand: -hand.score)[:2]
    candidates: list[DetectedHand | None] = [*best, None, None]

    def cost(pair: tuple[DetectedHand | None, ...]) -> tuple[int, float]:
        idle, total = 0, 0.0
        for side, hand in enumerate(pair):
            if not present[side]:
                continue
            if hand is None:
                idle += 1
                continue
            distance = np.linalg.norm(hand.joints_px - joints_px[side], axis=-1)
            total += float(np.nanmean(distance)) if np.isfinite(distance).any() else 0.0
        return idle, total

    def placed(pair: tuple[DetectedHand | None, ...]) -> bool:
        return sum(hand is not None for hand in pair) == len(best)

    left, right = min((pair for pair in permutations(candidates, 2) if placed(pair)), key=cost)
    return left, right
