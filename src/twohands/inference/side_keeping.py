"""Hands keep their sides over video: a hand that was the left one is not the right one in the next frame.

An estimator looks at single pictures, and now and then takes a left hand for a right one. A hand seen where the other
side's hand was a moment ago is that hand still, unless the estimator says otherwise for several frames in a row.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from twohands.skeleton import LEFT, RIGHT
from twohands.types import HandPose, TwoHandPose

INSIST_FRAMES: Final = 5
"""Frames in a row in which the estimator must say so before a hand changes its side."""
_SAME_PLACE: Final = 0.6
"""Farthest that a hand moves between two frames, in sizes of its box: farther off it may be another hand."""
_CLEARLY: Final = 0.25
"""How much nearer, in sizes of its box, a hand must be to where the other side's was, before its side is doubted."""


class SideKeeper:
    """State: where either hand was last, for how many frames that has been so, and for how many frames the estimator
    has insisted on other sides.

    Args:
        insist_frames: frames in a row after which the estimator is believed; 1 believes it always.
        memory_frames: frames after which an unseen hand's place is forgotten.

    Attributes:
        changes: how often hands have changed their sides.
    """

    def __init__(self, insist_frames: int = INSIST_FRAMES, memory_frames: int = 5) -> None:
        self._insist_frames = insist_frames
        self._memory_frames = memory_frames
        self.changes = 0
        self.reset()

    def reset(self) -> None:
        """Forget where hands were; `changes` stays."""
        self._places: list[tuple[np.ndarray, float] | None] = [None, None]
        self._unseen = [0, 0]
        self._insisted = 0

    def update(self, pose: TwoHandPose) -> TwoHandPose:
        """One frame, after the last one.

        Returns:
            The same hands, on the sides that they had.
        """
        keeps = pose
        if self._exchanged(pose):
            self._insisted += 1
            if self._insisted < self._insist_frames:
                keeps = with_sides_exchanged(pose)
            else:
                self.changes += 1
                self._insisted = 0
        else:
            self._insisted = 0
        self._remember(keeps)
        return keeps

    def _exchanged(self, pose: TwoHandPose) -> bool:
        """Whether the hands are clearly where those of the other sides were."""
        as_said, exchanged, moved = 0.0, 0.0, False
        for side, hand in enumerate(pose.hands):
            place = _place(hand)
            if place is None:
                continue
            own, other = (self._distance(place, which) for which in (side, 1 - side))
            as_said += own
            exchanged += other
            moved |= other < _SAME_PLACE
        return moved and exchanged + _CLEARLY < as_said

    def _distance(self, place: tuple[np.ndarray, float], side: int) -> float:
        """From where a hand was, in sizes of its box; a hand that was not there is farther than any jump, but not by
        much: two hands that come are no exchange."""
        before = self._places[side]
        if before is None:
            return 2 * _SAME_PLACE
        distance = float(np.linalg.norm(place[0] - before[0])) / max(before[1], 1.0)
        return min(distance, 2 * _SAME_PLACE)

    def _remember(self, pose: TwoHandPose) -> None:
        for side, hand in enumerate(pose.hands):
            place = _place(hand)
            self._unseen[side] = 0 if place is not None else self._unseen[side] + 1
            if place is not None or self._unseen[side] > self._memory_frames:
                self._places[side] = place


def with_sides_exchanged(pose: TwoHandPose) -> TwoHandPose:
    """The left hand as the right one and the other way round, in the masks as well."""
    masks = pose.masks
    if masks is not None:
        masks = np.array([0, RIGHT + 1, LEFT + 1], masks.dtype)[masks]
    return replace(pose, left=pose.right, right=pose.left, masks=masks)


def _place(hand: HandPose) -> tuple[np.ndarray, float] | None:
    """Middle (2,) of a hand's joints in pixels, and the longer side of their box; None where it was not seen."""
    if not hand.present or hand.joints_px is None or not np.isfinite(hand.joints_px).any():
        return None
    known = hand.joints_px[np.isfinite(hand.joints_px).all(axis=-1)]
    return known.mean(axis=0), float(np.ptp(known, axis=0).max())
