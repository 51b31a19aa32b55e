"""Hands keep their sides over video: what single frames say of a hand's side adds up while the hand moves on.

A picture alone often leaves it open whose hand it is, and an estimator of single pictures then changes its mind from
frame to frame. A hand seen where a hand was a moment ago is that hand; the log-odds of its side are those of before
and, in part, what this frame says. So a side changes only after several frames have said so. Its three numbers are in
`DecisionConfig`. Ours; the paper's networks see every frame alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from twohands.geometry.boxes import box_from_points
from twohands.geometry.segmentation import UNCERTAIN
from twohands.inference.decision import DecisionConfig
from twohands.skeleton import LEFT, RIGHT
from twohands.types import HandPose, TwoHandPose

SIGNS: Final = (1.0, -1.0)
"""Of log-odds that a hand is the left one, for LEFT and RIGHT."""
SURE_SIDE: Final = 3.0
"""Log-odds of a hand's side from which on a clip need not ask a picture (docs/decision.md, *Beside the decision*)."""
_SAME: Final = 0.5
"""Nearness from which on a hand is rather the one that was expected there than another."""


@dataclass(frozen=True, slots=True)
class Track:
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

    def nearness(self, middles: np.ndarray, reach: float) -> np.ndarray:
        """(N,) 0..1, how well hands with these middles (N, 2) agree with where this one should be in the next frame;
        0 for a middle that is NaN."""
        off = middles - (self.middle + self.step * (1 + self.unseen))
        return np.nan_to_num(np.exp(-0.5 * (off**2).sum(axis=1) / (reach * max(self.size, 1.0)) ** 2))


@dataclass(frozen=True, slots=True)
class SideMemory:
    """Where the hands of a clip were, and how surely of which side."""

    config: DecisionConfig = field(default_factory=DecisionConfig)
    tracks: tuple[Track | None, Track | None] = (None, None)

    @property
    def misses_one(self) -> bool:
        """Whether a hand that was there, and is not forgotten, was not seen in the last frame."""
        return any(track is not None and track.unseen > 0 for track in self.tracks)

    @property
    def sure(self) -> np.ndarray:
        """(2,) bool, whether LEFT and RIGHT are surely that hand (`SURE_SIDE`)."""
        return np.array([track is not None and track.logit >= SURE_SIDE for track in self.tracks])

    def nearness(self, boxes_px: np.ndarray) -> np.ndarray:
        """(N, 2) 0..1, how well each hand of the next frame, boxes (N, 4), agrees with where LEFT and RIGHT should be;
        0 where there is no hand, or none was."""
        middles, reach = (boxes_px[:, :2] + boxes_px[:, 2:]) / 2, self.config.side_reach
        near = [np.zeros(len(boxes_px)) if track is None else track.nearness(middles, reach) for track in self.tracks]
        return np.stack(near, axis=1)

    def left_logits(self, boxes_px: np.ndarray) -> np.ndarray:
        """What is known of hands before the frame is looked at.

        Args:
            boxes_px: (N, 4) u0, v0, u1, v1 of hands in the next frame; NaN for none.

        Returns:
            (N,) log-odds that each is the left hand; 0 where no hand was.
        """
        logits = [0.0 if track is None else sign * track.logit for sign, track in zip(SIGNS, self.tracks, strict=True)]
        return self.nearness(boxes_px) @ np.array(logits)

    def after(self, pose: TwoHandPose) -> SideMemory:
        """What is known after one more frame. Where HandSegNet rested, hands move and nothing is said of their sides.

        Args:
            pose: of the frame, hands on the sides that they are to have, `HandPose.side_logit` as the frame says.
        """
        boxes_px = boxes_of(pose)
        known, near = self.left_logits(boxes_px), self.nearness(boxes_px)
        tracks: list[Track | None] = []
        for side, (hand, box_px) in enumerate(zip(pose.hands, boxes_px, strict=True)):
            track = self.tracks[side]
            if not np.isfinite(box_px).all():
                tracks.append(self._unseen(side, near[1 - side]))
                continue
            middle, size = (box_px[:2] + box_px[2:]) / 2, float((box_px[2:] - box_px[:2]).max())
            step = np.zeros(2) if track is None or track.unseen else middle - track.middle
            kept = None if track is None or not pose.followed else track.logit
            logit = SIGNS[side] * known[side] + self.said(hand) if kept is None else kept
            tracks.append(Track(middle, size, step, self._limited(logit)))
        return replace(self, tracks=(tracks[LEFT], tracks[RIGHT]))

    def said(self, hand: HandPose) -> float:
        """What a frame adds to the log-odds that a hand is of its side; the most where it does not say how surely."""
        limit = self.config.side_limit
        return self.config.side_trust * (limit if hand.side_logit is None else self._limited(hand.side_logit))

    def changed(self, pose: TwoHandPose) -> int:
        """How many hands of the next frame are clearly where the other side's hand should be."""
        near = self.nearness(boxes_of(pose))
        own, other = near.diagonal(), near[:, ::-1].diagonal()
        return int(((other > _SAME) & (other > 2 * own)).sum())

    def _limited(self, logit: float) -> float:
        return float(min(max(logit, -self.config.side_limit), self.config.side_limit))

    def _unseen(self, side: int, other: np.ndarray) -> Track | None:
        """A hand that this frame does not show, forgotten as fast as others are learnt; None where it has become the
        other one, whose `nearness` is (2,), or where a single frame may say more."""
        track, trust = self.tracks[side], self.config.side_trust
        if track is None or other[side] > max(_SAME, other[1 - side]):
            return None
        logit = track.logit * (1 - trust)
        if abs(logit) < trust * self.config.side_limit:
            return None
        return replace(track, unseen=track.unseen + 1, logit=logit)


NOTHING_KNOWN: Final = SideMemory()
"""At the beginning of a clip, and of a picture alone."""


class SideKeeper:
    """Gives hands the sides that they had, and counts how often they change.

    The hands of an estimator that says of every hand how sure its side is (`HandPose.side_logit`) stay as they are: it
    has been told what was before. Those of another change places where all frames together say so.

    State: `memory`.

    Args:
        config: how what frames say adds up.

    Attributes:
        changes: how often a hand has taken the other side, over all clips.
        memory: of the clip.
    """

    def __init__(self, config: DecisionConfig | None = None) -> None:
        self._nothing_known = NOTHING_KNOWN if config is None else SideMemory(config)
        self.changes = 0
        self.reset()

    def reset(self) -> None:
        """Forget the clip; `changes` stays."""
        self.memory = self._nothing_known

    def kept(self, pose: TwoHandPose) -> TwoHandPose:
        """The hands of the next frame, on their sides."""
        there = [side for side, hand in enumerate(pose.hands) if hand.present]
        if not there or any(pose.hands[side].side_logit is not None for side in there):
            return pose
        known = self.memory.left_logits(boxes_of(pose))
        if sum(SIGNS[side] * known[side] + self.memory.said(pose.hands[side]) for side in there) >= 0:
            return pose
        limit = self.memory.config.side_limit
        left, right = (replace(hand, side_logit=-limit) if hand.present else hand for hand in pose.hands)
        return with_sides_exchanged(replace(pose, left=left, right=right))

    def remember(self, pose: TwoHandPose) -> None:
        """Take the next frame, hands on their sides."""
        self.changes += self.memory.changed(pose)
        self.memory = self.memory.after(pose)


def with_sides_exchanged(pose: TwoHandPose) -> TwoHandPose:
    """The left hand as the right one and the other way round, in the masks as well."""
    other = np.array([0, RIGHT + 1, LEFT + 1, RIGHT + 1 + UNCERTAIN, LEFT + 1 + UNCERTAIN], np.uint8)
    masks, crop_masks = (None if known is None else other[known] for known in (pose.masks, pose.crop_masks))
    return replace(pose, left=pose.right, right=pose.left, masks=masks, crop_masks=crop_masks)


def boxes_of(pose: TwoHandPose) -> np.ndarray:
    """(2, 4) u0, v0, u1, v1 of the hands, of their joints where they have no box; NaN where they were not seen."""
    return np.array([_box(hand) for hand in pose.hands])


def _box(hand: HandPose) -> np.ndarray:
    if not hand.present:
        return np.full(4, np.nan)
    if hand.box_px is not None:
        return np.asarray(hand.box_px, np.float64)
    return np.full(4, np.nan) if hand.joints_px is None else np.asarray(box_from_points(hand.joints_px))
