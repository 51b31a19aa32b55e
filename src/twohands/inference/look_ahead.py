"""Ranges smoothed with what comes after: for clips, where a short wait costs nothing.

The causal filter of `tracker` must choose between noise and lag. Here each range is read from a straight line through
those before *and* after it, so that there is no lag to choose. Ours; the paper smooths causally.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np

from twohands.errors import InputError
from twohands.inference.tracker import moved_to_range
from twohands.types import HandPose, TwoHandPose

_GATE = 3.0
"""Largest deviation from the line, in robust standard deviations; what is farther off does not count."""
_LEAST_SIGMA = 0.01
"""Smallest standard deviation that the gate reckons with, as a share of the range."""
_MAD_TO_SIGMA = 1.4826
_FEWEST = 3


class LookAhead:
    """Holds frames back until those that come within `seconds` after them are known.

    State: the frames held back, and the ranges of those given out within the last `seconds`.

    Args:
        seconds: how far to look, forwards as well as back.

    Raises:
        InputError: the time is no positive number.
    """

    def __init__(self, seconds: float) -> None:
        if not (math.isfinite(seconds) and seconds > 0):
            raise InputError(f"look-ahead must be a positive number of seconds, got {seconds:g}")
        self._seconds = seconds
        self._held: deque[TwoHandPose] = deque()
        self._ranges: deque[tuple[float, tuple[float, float]]] = deque()

    def push(self, pose: TwoHandPose) -> list[TwoHandPose]:
        """One more frame.

        Args:
            pose: of a later time than the last one, not smoothed.

        Returns:
            Frames that are known now, in their order, ranges smoothed; maybe none.
        """
        time = _time(pose)
        self._held.append(pose)
        self._ranges.append((time, (_range(pose.left), _range(pose.right))))
        known = []
        while self._held and _time(self._held[0]) + self._seconds < time:
            known.append(self._smoothed(self._held.popleft()))
        return known

    def finish(self) -> list[TwoHandPose]:
        """The frames that are still held back; the clip has ended."""
        rest = [self._smoothed(pose) for pose in self._held]
        self._held.clear()
        self._ranges.clear()
        return rest

    def _smoothed(self, pose: TwoHandPose) -> TwoHandPose:
        time = _time(pose)
        while self._ranges[0][0] < time - self._seconds:
            self._ranges.popleft()
        near = [(at, ranges) for at, ranges in self._ranges if at <= time + self._seconds]
        times = np.array([at - time for at, _ in near])
        left, right = (
            _moved(hand, times, np.array([ranges[side] for _, ranges in near])) for side, hand in enumerate(pose.hands)
        )
        return replace(pose, left=left, right=right)


def line_at_zero(times: np.ndarray, values: np.ndarray, reach: float) -> float:
    """Value at time 0 of the straight line through values, those nearer in time counting more; outliers do not count.

    Args:
        times: (N,) seconds, -reach..reach.
        values: (N,) positive; NaN where unknown.
        reach: where a value's weight falls to zero, seconds.

    Returns:
        The value; NaN with fewer than 3 known ones.
    """
    known = np.isfinite(values)
    times, values = times[known], values[known]
    if len(values) < _FEWEST:
        return math.nan
    weights = np.maximum(1 - (times / (1.001 * reach)) ** 2, 1e-3)
    kept = np.ones(len(values), bool)
    for _ in range(2):  # once with all, once without those far off
        slope, middle = _line(times[kept], values[kept], weights[kept])
        off = abs(values - (middle + slope * times))
        sigma = max(_MAD_TO_SIGMA * float(np.median(off)), _LEAST_SIGMA * abs(middle))
        kept = off <= _GATE * sigma
        if kept.sum() < _FEWEST:
            return math.nan
    return middle


def _line(times: np.ndarray, values: np.ndarray, weights: np.ndarray) -> tuple[float, float]:
    """Slope and value at 0 of the weighted least-squares line; slope 0 where all times are one."""
    total = weights.sum()
    mean_t, mean_v = (weights * times).sum() / total, (weights * values).sum() / total
    spread = (weights * (times - mean_t) ** 2).sum()
    slope = 0.0 if spread <= 0 else float((weights * (times - mean_t) * (values - mean_v)).sum() / spread)
    return slope, float(mean_v - slope * mean_t)


def _moved(hand: HandPose, times: np.ndarray, ranges: np.ndarray) -> HandPose:
    """The hand at its smoothed range; as it is where there is none."""
    if not math.isfinite(_range(hand)):
        return hand
    smooth = line_at_zero(times, ranges, float(abs(times).max()))
    return moved_to_range(hand, smooth) if math.isfinite(smooth) and smooth > 0 else hand


def _range(hand: HandPose) -> float:
    known = hand.present and hand.valid and hand.range_m is not None
    return float(hand.range_m) if known and hand.range_m is not None else math.nan


def _time(pose: TwoHandPose) -> float:
    return float(pose.index if pose.time_s is None else pose.time_s)
