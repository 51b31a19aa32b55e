"""Hands keep their sides over video: what single frames say of a hand's side adds up while the hand moves on.

A picture alone often leaves it open whose hand it is, and an estimator of single pictures then changes its mind from
frame to frame. A hand seen where a hand was a moment ago is that hand; the log-odds of its side are those of before,
of which a part is forgotten, and what this frame says. So a side changes only after several frames have said so.
Ours; the paper's networks see every frame alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from twohands.geometry.boxes import box_from_points
from twohands.skeleton import LEFT, RIGHT
from twohands.types import HandPose, TwoHandPose

KEPT_SHARE: Final = 0.95
"""Of the log-odds of before, in the next frame that says anything. With `TRUST` it makes a side that was said for long
hold against four frames that are sure of the other one, and change with the fifth; scripts/fit_sides.py compares other
values."""
TRUST: Final = 0.3
"""Of a frame's log-odds: the frames of a clip err alike, so that they say less together than apart."""
SAID_LOGIT: Final = 4.0
"""Log-odds of a side that an estimator names without saying how sure it is; more is not believed of any frame."""
LOGIT_LIMIT: Final = 6.0
"""Log-odds grow to this size, so that no side is certain for ever."""
REACH: Final = 0.35
"""Standard deviation of where a hand is seen from where it was expected, in sizes of its box."""
MEMORY_FRAMES: Final = 5
"""Frames after which an unseen hand is forgotten."""

SIGNS: Final = (1.0, -1.0)
"""Of log-odds that a hand is the left one, for LEFT and RIGHT."""
_SAME: Final = 0.5
"""Nearness from which on a hand is the one that was expected there."""


@dataclass(frozen=True, slots=True)
class _Track:
    """One hand of a clip.

    Attributes:
        middle: (2,) of its box where it was last seen, pixels.
        size: longer side of that box.
        step: (2,) how far it had moved from the frame before; 0 where that is not known.
        logit: log-odds that it is of its side and not of the other.
        unseen: frames since then.
    """

    middle: np.ndarray
    size: float
    step: np.ndarray
    logit: float
    unseen: int = 0

    def nearness(self, middle: np.ndarray) -> float:
        """0..1, how well a hand that is seen here agrees with where this one should be in the next frame."""
        expected = self.middle + self.step * (1 + self.unseen)
        return math.exp(-0.5 * float(((middle - expected) ** 2).sum()) / (REACH * max(self.size, 1.0)) ** 2)


@dataclass(frozen=True, slots=True)
class SideMemory:
    """Where the hands of a clip were, and how surely of which side."""

    tracks: tuple[_Track | None, _Track | None] = (None, None)

    def left_logits(self, boxes_px: np.ndarray) -> np.ndarray:
        """What is known of hands before the frame is looked at.

        Args:
            boxes_px: (N, 4) u0, v0, u1, v1 of hands in the next frame; NaN for none.

        Returns:
            (N,) log-odds that each is the left hand; 0 where no hand was.
        """
        logits = np.zeros(len(boxes_px))
        for row, box_px in enumerate(boxes_px):
            if np.isfinite(box_px).all():
                middle = (box_px[:2] + box_px[2:]) / 2
                for sign, track in zip(SIGNS, self.tracks, strict=True):
                    if track is not None:
                        logits[row] += sign * track.logit * track.nearness(middle)
        return KEPT_SHARE * logits

    def after(self, pose: TwoHandPose) -> SideMemory:
        """What is known after one more frame. Where HandSegNet rested, hands move and nothing is said of their sides.

        Args:
            pose: of the frame, hands on the sides that they are to have, `HandPose.side_logit` as the frame says.
        """
        boxes_px = np.array([_box(hand) for hand in pose.hands])
        known = self.left_logits(boxes_px)
        tracks: list[_Track | None] = []
        for side, (hand, box_px) in enumerate(zip(pose.hands, boxes_px, strict=True)):
            track = self.tracks[side]
            if not np.isfinite(box_px).all():
                tracks.append(self._unseen(side, boxes_px[1 - side]))
                continue
            middle, size = (box_px[:2] + box_px[2:]) / 2, float((box_px[2:] - box_px[:2]).max())
            step = np.zeros(2) if track is None or track.unseen else middle - track.middle
            if pose.followed and track is not None:
                logit = track.logit
            else:
                said = SAID_LOGIT if hand.side_logit is None else hand.side_logit
                logit = SIGNS[side] * known[side] + TRUST * _limited(said, SAID_LOGIT)
            tracks.append(_Track(middle, size, step, _limited(logit, LOGIT_LIMIT)))
        return SideMemory((tracks[LEFT], tracks[RIGHT]))

    def changed(self, pose: TwoHandPose) -> int:
        """How many hands of the next frame are clearly where the other side's hand should be."""
        changes = 0
        for side, hand in enumerate(pose.hands):
            box_px = _box(hand)
            if np.isfinite(box_px).all():
                middle = (box_px[:2] + box_px[2:]) / 2
                own, other = (
                    0.0 if track is None else track.nearness(middle)
                    for track in (self.tracks[side], self.tracks[1 - side])
                )
                changes += other > _SAME and other > 2 * own
        return changes

    def _unseen(self, side: int, other_px: np.ndarray) -> _Track | None:
        """A hand that this frame does not show; None where it is forgotten, or has become the other one."""
        track = self.tracks[side]
        if track is None or track.unseen >= MEMORY_FRAMES:
            return None
        if np.isfinite(other_px).all():
            middle, rival = (other_px[:2] + other_px[2:]) / 2, self.tracks[1 - side]
            if track.nearness(middle) > (_SAME if rival is None else max(_SAME, rival.nearness(middle))):
                return None
        return replace(track, unseen=track.unseen + 1)


NOTHING_KNOWN: Final = SideMemory()
"""At the beginning of a clip, and of a picture alone."""


class SideKeeper:
    """Gives hands the sides that they had, and counts how often they change.

    The hands of an estimator that says of every hand how sure its side is (`HandPose.side_logit`) stay as they are: it
    has been told what was before. Those of another change places where all frames together say so.

    State: `memory`.

    Attributes:
        changes: how often a hand has taken the other side, over all clips.
        memory: of the clip.
    """

    def __init__(self) -> None:
        self.changes = 0
        self.reset()

    def reset(self) -> None:
        """Forget the clip; `changes` stays."""
        self.memory = NOTHING_KNOWN

    def kept(self, pose: TwoHandPose) -> TwoHandPose:
        """The hands of the next frame, on their sides."""
        there = [side for side, hand in enumerate(pose.hands) if hand.present]
        if not there or any(pose.hands[side].side_logit is not None for side in there):
            return pose
        known = self.memory.left_logits(np.array([_box(hand) for hand in pose.hands]))
        if sum(SIGNS[side] * known[side] + TRUST * SAID_LOGIT for side in there) >= 0:
            return pose
        left, right = (replace(hand, side_logit=-SAID_LOGIT) if hand.present else hand for hand in pose.hands)
        return with_sides_exchanged(replace(pose, left=left, right=right))

    def remember(self, pose: TwoHandPose) -> None:
        """Take the next frame, hands on their sides."""
        self.changes += self.memory.changed(pose)
        self.memory = self.memory.after(pose)


def with_sides_exchanged(pose: TwoHandPose) -> TwoHandPose:
    """The left hand as the right one and the other way round, in the masks as well."""
    masks = pose.masks
    if masks is not None:
        masks = np.array([0, RIGHT + 1, LEFT + 1], masks.dtype)[masks]
    return replace(pose, left=pose.right, right=pose.left, masks=masks)


def _box(hand: HandPose) -> np.ndarray:
    """(4,) u0, v0, u1, v1 of a hand, of its joints where it has no box; NaN where it was not seen."""
    if not hand.present:
        return np.full(4, np.nan)
    if hand.box_px is not None:
        return np.asarray(hand.box_px, np.float64)
    return np.full(4, np.nan) if hand.joints_px is None else np.asarray(box_from_points(hand.joints_px))


def _limited(logit: float, limit: float) -> float:
    return float(min(max(logit, -limit), limit))
