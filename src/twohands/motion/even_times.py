"""A clip's frames at even times, for formats that know no others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from twohands.errors import InputError

MOST_FRAMES: Final = 200_000
"""Almost two hours of 30 frames a second."""
_DEFAULT_STEP_S: Final = 1 / 30
"""Of a clip of one frame."""
_NEAR: Final = 1e-3
"""Of a step: times are rounded, and so near to a frame the frame itself is meant."""


@dataclass(frozen=True, slots=True, eq=False)
class EvenTimes:
    """Where each of E even frames lies among the N frames that a hand is in.

    Attributes:
        step_s: from frame to frame, seconds.
        before, after: (E,) int, the hand's frames, 0..N-1, on either side; equal where it stands still.
        share: (E,) of the way from `before` to `after`, 0..1.
        still: (E,) bool: the clip has the hand neither here nor on both sides, so it keeps its last place.
    """

    step_s: float
    before: np.ndarray
    after: np.ndarray
    share: np.ndarray
    still: np.ndarray


def even_times(time_s: np.ndarray, rows: np.ndarray) -> EvenTimes:
    """Even times from the clip's first frame to its last, as many as its usual distance of frames asks for.

    Between two successive frames of the clip that both have the hand it moves evenly; elsewhere it keeps the place it
    had last, and before its first frame that one.

    Args:
        time_s: (F,) of all frames, seconds, increasing.
        rows: (N,) int, the frames that have the hand, N >= 1.

    Raises:
        InputError: frames that would be too many.
    """
    steps = np.diff(time_s)
    step = float(np.median(steps)) if len(steps) else _DEFAULT_STEP_S
    length = float(time_s[-1] - time_s[0])
    if length / step > MOST_FRAMES:
        raise InputError(
            f"frames at even times would be {length / step:.3g} for {length:.6g} s in steps of {step:.3g} s; "
            f"at most {MOST_FRAMES} can be"
        )
    count = max(1, round(length / step)) if length else 0
    step = length / count if count else step
    even = time_s[0] + step * np.arange(count + 1)
    frame = np.clip(np.searchsorted(time_s, even + _NEAR * step, side="right") - 1, 0, len(time_s) - 1)
    following = np.minimum(frame + 1, len(time_s) - 1)
    place = np.full(len(time_s), -1)
    place[rows] = np.arange(len(rows))
    latest = np.maximum.accumulate(place)  # -1 before the first
    before = np.maximum(latest[frame], 0)
    moves = (place[frame] >= 0) & (place[following] >= 0)
    after = np.where(moves, place[following], before)
    gap = np.where(following > frame, time_s[following] - time_s[frame], 1.0)
    share = np.where(moves, np.clip((even - time_s[frame]) / gap, 0.0, 1.0), 0.0)
    still = place[frame] < 0
    return EvenTimes(step, before, after, share, still)
