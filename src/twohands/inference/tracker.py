"""The range of each hand smoothed over video: one queue of recent root radii per hand, polynomial regression.

Source: paper section 4.4 (last paragraph but one). Only the radius is smoothed, because it is the noisy part of a
camera-space pose: direction and canonical pose are the current frame's, and the hand moves along its line of sight.
Hands that leave the picture are carried on for a moment (`inference.leaving`, ours). Everything is causal: a result
never changes when later frames come.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre

from twohands.errors import InputError
from twohands.geometry.canonical import camera_from_canonical
from twohands.inference.leaving import CARRIED_FRAMES, LeavingHand
from twohands.skeleton import ROOT, WRIST
from twohands.types import HandPose, PinholeCamera, TwoHandPose

PREDICTED = "predicted"
"""`HandPose.method` of a hand whose range is the queue's prediction."""

_MAD_TO_SIGMA = 1.4826
"""Standard deviation of Gaussian noise over its median absolute deviation."""

_FEWEST = 3
"""Radii below which there is no regression (docs/paper-map.md, *Smoothing*)."""

_SPARE_FOR_SCALE = 3
"""Radii beyond the coefficients of the fit, below which the residuals say nothing about their own scale."""


@dataclass(frozen=True, slots=True)
class RangeSmoothing:
    """How the range is smoothed. The paper gives no number, and its regression counts all radii alike (`fade` 1); the
    defaults were chosen on made sequences at 30 frames a second: as accurate as unsmoothed ranges, with little over
    half of their radial acceleration error. `twohands eval sweep` compares them with queues that do not fade.

    Raises:
        InputError: a value is out of its range.
    """

    length: int = 8
    "Radii in the queue, the current one included; 1 or 2 turn smoothing off."
    degree: int = 1
    "Degree of the polynomial; lower while the queue fills."
    fade: float = 0.65
    "What a radius counts in the regression beside the next newer one."
    gate: float = 3.0
    "Largest deviation from the prediction, in its robust standard deviations; inf accepts all."
    scale_floor: float = 0.08
    "Smallest standard deviation the gate reckons with, as a fraction of the range: a fast reach is no gross error."
    jump_frames: int = 3
    "So many radii refused in a row are no outliers: the queue starts again with them."
    missing_frames: int = 5
    "The queue is dropped when so many frames in a row have added nothing to it."
    max_gap_s: float = 0.5
    "The queue is dropped when its newest radius is older, in seconds. Frames without time stamps ignore this."

    def __post_init__(self) -> None:
        for name, low in (("length", 1), ("degree", 0), ("jump_frames", 1), ("missing_frames", 1)):
            if getattr(self, name) < low:
                raise InputError(f"range smoothing: {name} must be at least {low}, got {getattr(self, name)}")
        for name in ("gate", "max_gap_s"):
            if not getattr(self, name) > 0:
                raise InputError(f"range smoothing: {name} must be above 0, got {getattr(self, name)}")
        if not 0 < self.fade <= 1:
            raise InputError(f"range smoothing: fade must be above 0 and at most 1, got {self.fade}")
        if not 0 <= self.scale_floor < math.inf:
            raise InputError(f"range smoothing: scale_floor must be finite and not negative, got {self.scale_floor}")


DEFAULT_SMOOTHING = RangeSmoothing()


def polynomial_weights(times: np.ndarray, degree: int, at: np.ndarray | float, fade: float = 1.0) -> np.ndarray:
    """Weights w with which the least-squares polynomial's value is w @ values, whatever the values.

    The weights of a fit sum to 1. For values with independent noise of standard deviation 1, that of the fitted value
    is |w|: the noise factor.

    Args:
        times: (N,) finite, any unit, in any order.
        degree: of the polynomial, 0 or more.
        at: (...) or a number, where the polynomial is read; same unit.
        fade: above 0 to 1; the squared deviation of each value counts so much beside that of the one after it, in the
            order given.

    Returns:
        (..., N) float64, unitless.

    Raises:
        InputError: fewer than degree + 1 different times, or a time that is not finite.

    Times are counted from the middle of their span, in units of half of it, and the basis is Legendre's: clocks that
    count from 1970 do as well as clocks that count from 0.
    """
    times, at = np.asarray(times, np.float64), np.asarray(at, np.float64)
    if times.ndim != 1 or not np.isfinite(times).all() or not np.isfinite(at).all():
        raise InputError(f"polynomial regression: finite times of shape (N,) expected, got shape {times.shape}")
    count, different = len(times), len(set(times.tolist()))
    if not 0 <= degree < different:
        raise InputError(f"polynomial regression: degree {degree} needs {degree + 1} different times, got {different}")
    low, high = times.min(), times.max()
    middle, half = (high + low) / 2, (high - low) / 2 or 1.0
    basis = legendre.legvander((np.concatenate([times, at.ravel()]) - middle) / half, degree)  # (N + ..., degree + 1)
    counts = fade ** (np.arange(count)[::-1] / 2)
    fit = np.linalg.pinv(counts[:, None] * basis[:count]) * counts  # values -> coefficients
    return (basis[count:] @ fit).reshape(*at.shape, count)


def polynomial_value(
    times: np.ndarray, values: np.ndarray, degree: int, at: np.ndarray | float, fade: float = 1.0
) -> np.ndarray:
    """Value of the polynomial that fits values over times best in the sense of least squares.

    Args:
        times, degree, at, fade: as `polynomial_weights`.
        values: (N,) any unit.

    Returns:
        (...) shape of `at`, unit of the values.

    Raises:
        InputError: as `polynomial_weights`.

    Source: paper section 4.4 ("polynomial regression").
    """
    return polynomial_weights(times, degree, at, fade) @ np.asarray(values, np.float64)


class RangeFilter:
    """Smoothed range of one hand.

    State: the queue (`times`, `radii_m`), the radii refused since its last entry, and the number of frames since then.

    A radius is refused if it deviates from the prediction, the queue's polynomial carried on to the current time, by
    more than `gate` standard deviations of that difference: sigma sqrt(1 + |w|^2), where w are the prediction's weights
    and sigma is the robust scale of the queue's residuals (median absolute deviation, corrected for the coefficients
    fitted) or the floor. While the queue holds fewer than degree + 4 radii nothing is refused. An outlier thus leaves
    no trace. A true jump is refused `jump_frames` - 1 times; then the queue starts again with the refused radii, and
    the result rests on nothing older (with the default 3 it is the raw radius in the third frame).

    Args:
        smoothing: length, degree and limits.
    """

    def __init__(self, smoothing: RangeSmoothing = DEFAULT_SMOOTHING) -> None:
        self.smoothing = smoothing
        self._queue: deque[tuple[float, float]] = deque(maxlen=smoothing.length)
        self._refused: list[tuple[float, float]] = []
        self._barren_frames = 0
        self._now = -math.inf

    @property
    def times(self) -> np.ndarray:
        """(n,) times of the queue, oldest first."""
        return np.array([time for time, _ in self._queue])

    @property
    def radii_m(self) -> np.ndarray:
        """(n,) raw radii of the queue, metres."""
        return np.array([radius for _, radius in self._queue])

    @property
    def predicting(self) -> bool:
        """Whether the last frame added nothing to the queue, so that its result, if any, was the prediction."""
        return self._barren_frames > 0

    def reset(self) -> None:
        """Forget everything, the clock included."""
        self._restart([])
        self._now = -math.inf

    def update(self, time: float, radius_m: float | None) -> float | None:
        """Take one frame.

        Args:
            time: of this frame, later than the last one's; seconds, or frames (then with `max_gap_s` inf).
            radius_m: raw radius of this frame in metres. None, not finite or not positive: there is none.

        Returns:
            The smoothed radius, metres, positive: the polynomial through queue and current radius. The prediction where
            there is no radius or it was refused; None if there is none either.

        Raises:
            InputError: time does not advance.
        """
        self.check_time(time)
        self._now = time
        if self._queue and time - self._queue[-1][0] > self.smoothing.max_gap_s:
            self._restart([])
        if radius_m is None or not (math.isfinite(radius_m) and radius_m > 0):
            self._barren_frames += 1
            if self._barren_frames >= self.smoothing.missing_frames:
                self._restart([])
            return self.prediction(time)
        if not self._refuses(time, radius_m):
            self._restart([*self._queue, (time, radius_m)])
            return self._smoothed()
        self._barren_frames += 1
        self._refused.append((time, radius_m))
        if len(self._refused) >= self.smoothing.jump_frames or self._barren_frames >= self.smoothing.missing_frames:
            self._restart(self._refused)
            return self._smoothed()
        return self.prediction(time)

    def check_time(self, time: float) -> None:
        """See whether a frame of this time may come next; changes nothing.

        Raises:
            InputError: time does not advance.
        """
        if not (math.isfinite(time) and time > self._now):
            raise InputError(
                f"range smoothing: frame time {time} does not follow {self._now}; frames need increasing time_s or "
                "index, and reset() comes before another video"
            )

    def prediction(self, time: float) -> float | None:
        """The queue's polynomial at another time; changes nothing.

        Its degree leaves one radius to spare: a parabola through three noisy points says little about the fourth.

        Returns:
            Radius in metres, positive; None with fewer than 3 radii, or where the polynomial is not positive.
        """
        if len(self._queue) < _FEWEST:
            return None
        radius = self._value(self._predicting_degree(), time)
        return radius if radius > 0 else None

    def _restart(self, queue: list[tuple[float, float]]) -> None:
        """Go on with this queue; what was refused or missing until now is settled."""
        self._queue = deque(queue, maxlen=self.smoothing.length)
        self._refused = []
        self._barren_frames = 0

    def _smoothed(self) -> float:
        """Value of the polynomial at the newest radius, which it includes."""
        newest_time, newest = self._queue[-1]
        if len(self._queue) < _FEWEST:
            return newest
        degree = min(self.smoothing.degree, len(self._queue) - 1)
        radius = self._value(degree, newest_time)
        return radius if radius > 0 else newest

    def _value(self, degree: int, time: float) -> float:
        """The queue's polynomial at a time."""
        return float(polynomial_value(self.times, self.radii_m, degree, time, self.smoothing.fade))

    def _refuses(self, time: float, radius_m: float) -> bool:
        """Whether a radius is an outlier to the queue."""
        spare = len(self._queue) - self.smoothing.degree - 1
        if spare < _SPARE_FOR_SCALE:
            return False
        times, radii = self.times, self.radii_m
        at = np.append(times, time)
        weights = polynomial_weights(times, self._predicting_degree(), at, self.smoothing.fade)  # (n + 1, n)
        fitted = weights @ radii
        residuals, prediction = radii - fitted[:-1], float(fitted[-1])
        if prediction <= 0:
            return False
        scale = _MAD_TO_SIGMA * float(np.median(np.abs(residuals))) * math.sqrt(len(radii) / spare)
        scale = max(scale, self.smoothing.scale_floor * prediction)
        spread = math.hypot(1.0, float(np.linalg.norm(weights[-1])))
        return abs(radius_m - prediction) > self.smoothing.gate * scale * spread

    def _predicting_degree(self) -> int:
        return min(self.smoothing.degree, len(self._queue) - 2)


class HandTracker:
    """Both hands over video: takes the poses of any estimator, frame by frame, and gives them back with smooth ranges,
    and a hand that leaves the picture for some frames longer.

    State: one `RangeFilter`, one `LeavingHand` and the last known hand length per side. The hands do not influence each
    other.

    Args:
        smoothing: the same for both hands.
        carried_frames: for how many frames a leaving hand is carried on; 0 for never.
    """

    def __init__(self, smoothing: RangeSmoothing = DEFAULT_SMOOTHING, carried_frames: int = CARRIED_FRAMES) -> None:
        self.smoothing = smoothing
        self._leaving = tuple(LeavingHand(carried_frames) for _ in range(2))
        self.reset()

    def reset(self) -> None:
        """Forget everything; call it before another video or another person."""
        self._hand_length_m: list[float | None] = [None, None]
        self._start(timed=True)

    def update(self, pose: TwoHandPose) -> TwoHandPose:
        """Smooth the ranges of one frame.

        Args:
            pose: of the frame that follows the last one. Its clock is `time_s`, or `index` where that is None; a change
                from one to the other drops the queues.

        Returns:
            The same pose with `range_m` and `joints_m` of valid hands smoothed: joints moved rigidly along the root's
            line of sight; where the range was refused as an outlier, to the prediction, with `method` "predicted". A
            present hand without a valid range is placed at the queue's prediction, with `valid` True and that `method`,
            if the queue has one and the hand has a canonical pose, a direction and a length known from an earlier
            frame. An absent hand that is leaving the picture (`LeavingHand`) is present, placed likewise. Everything
            else is as it came: pixels, directions, and other absent hands altogether.

        Raises:
            InputError: neither time nor index advances; the frame is then as if it had not come.
        """
        timed = pose.time_s is not None
        time = float(pose.index if pose.time_s is None else pose.time_s)
        clock = self._filters[0] if timed == self._timed else RangeFilter()
        clock.check_time(time)
        if timed != self._timed:
            self._start(timed)
        left, right = (self._update(side, hand, time, pose.camera) for side, hand in enumerate(pose.hands))
        return replace(pose, left=left, right=right)

    def _start(self, timed: bool) -> None:
        self._timed = timed
        smoothing = self.smoothing if timed else replace(self.smoothing, max_gap_s=math.inf)
        self._filters = (RangeFilter(smoothing), RangeFilter(smoothing))
        for leaving in self._leaving:
            leaving.reset()

    def _update(self, side: int, hand: HandPose, time: float, camera: PinholeCamera) -> HandPose:
        hand = self._leaving[side].update(hand, time, camera)
        solved = hand.present and bool(hand.valid) and hand.joints_m is not None
        radius = self._filters[side].update(time, hand.range_m if solved else None)
        if solved:
            self._hand_length_m[side] = _hand_length(hand) or self._hand_length_m[side]
        if radius is None or not hand.present:
            return hand
        if not solved:
            return placed_at_range(hand, radius, self._hand_length_m[side])
        moved = moved_to_range(hand, radius)
        return replace(moved, method=PREDICTED) if self._filters[side].predicting and moved is not hand else moved


def moved_to_range(hand: HandPose, range_m: float) -> HandPose:
    """The hand moved rigidly along its root's line of sight.

    The same as `camera_from_canonical` at the new radius, but needs neither canonical pose nor hand length, so it suits
    poses of any origin.

    Args:
        hand: with `joints_m` and `range_m`.
        range_m: new distance of the root joint, metres.

    Returns:
        A new record; the given one if a joint would come to lie behind the camera.
    """
    if hand.joints_m is None or hand.range_m is None:
        return hand
    root = hand.joints_m[ROOT]
    direction = root / np.linalg.norm(root)
    joints_m = hand.joints_m + (range_m - hand.range_m) * direction
    if not (joints_m @ direction > 0).all():
        return hand
    return replace(hand, joints_m=joints_m, range_m=range_m)


def placed_at_range(hand: HandPose, range_m: float, hand_length_m: float | None) -> HandPose:
    """The hand's canonical pose placed in its direction at a given range, where the global projection found none.

    Args:
        hand: with `canonical`, `theta_deg` and `phi_deg`.
        range_m: distance of the root joint, metres.
        hand_length_m: |wrist - root|, metres.

    Returns:
        A new record with `valid` True and `method` "predicted"; the given one if something needed is unknown or a joint
        would come to lie behind the camera.

    Source: paper section 4.4; docs/paper-map.md, *Refused input*.
    """
    if hand.canonical is None or hand.theta_deg is None or hand.phi_deg is None or hand_length_m is None:
        return hand
    theta, phi = np.radians(hand.theta_deg), np.radians(hand.phi_deg)
    joints_m = camera_from_canonical(hand.canonical, hand_length_m, range_m, theta, phi)
    if not (range_m + hand_length_m * hand.canonical[:, 2] > 0).all() or not np.isfinite(joints_m).all():
        return hand
    return replace(hand, joints_m=joints_m, range_m=range_m, range_sigma_m=None, valid=True, method=PREDICTED)


def _hand_length(hand: HandPose) -> float | None:
    """The length that the estimator multiplied the canonical pose with, metres; None where it cannot be told."""
    if hand.canonical is None or hand.joints_m is None:
        return None  # another system's pose
    unit = float(np.linalg.norm(hand.canonical[WRIST] - hand.canonical[ROOT]))
    length = float(np.linalg.norm(hand.joints_m[WRIST] - hand.joints_m[ROOT]))
    return length / unit if unit > 0 and math.isfinite(length / unit) else None
