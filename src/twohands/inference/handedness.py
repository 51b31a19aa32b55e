"""Whose hand is it, if any: the decision, from what both networks say of HandSegNet's candidates.

Ours; the paper trusts the energy's peak. HandSegNet sees the whole picture at low resolution, PoseNet2D one candidate
at high resolution, as cut and, if that is not clear, mirrored: a left hand in the mirror is a right one. What they say,
where the arm comes from, and what was there one frame before are features of the answers; a conditional log-linear
model, whose weights the card holds, gives every answer its probability: p(answer) ~ exp(weights . features(answer)).
It is asked twice: which candidate is which hand (`assign_handedness`), and, after the last view of these hands, which
of them are hands (`rescore`).

Every feature is the same for a picture and its mirror image with the sides exchanged. Features in, decisions out;
`inference.detection` gathers what is known and carries the decisions out, scripts/fit_handedness.py fits the weights.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from twohands.geometry.body import Body
from twohands.geometry.boxes import box_iou
from twohands.geometry.segmentation import BoxEvidence, box_around, log_odds
from twohands.inference.decision import FIRST_FEATURES, LAST_FEATURES, DecisionConfig
from twohands.skeleton import LEFT, RIGHT, ROOT, WRIST
from twohands.types import TwoHandPose

ANSWERS: Final = ((-1, -1), (0, -1), (1, -1), (-1, 0), (-1, 1), (0, 1), (1, 0))
"""Every answer: the candidate that is the LEFT hand and the one that is the RIGHT hand, -1 for none."""
KEPT: Final = ((False, False), (True, False), (False, True), (True, True))
"""Every last answer: whether LEFT and RIGHT are hands."""
LOGIT_LIMIT: Final = 6.0
"""Log-odds are limited to this size as features: a network may be sure and wrong."""
UNCHECKED: Final = np.full(2, np.nan)
"""HandCheck's log-odds of two hands at which it did not look."""
PASSED: Final = 3.0
"""Log-odds from which on a hand is one, by what has seen real hands: HandCheck, which needs no more, and the published
layer of the second pose networks."""
_USUAL_SCORE: Final = 0.8
"""Joint scores are counted from here; the weight of "hand" makes up for any other value."""


@dataclass(frozen=True, slots=True)
class Before:
    """What was found one frame before.

    Attributes:
        boxes_px: (2, 4) of LEFT and RIGHT; NaN for a hand that was absent.
        logits: (2,) log-odds that it was there; NaN for one that was absent.
    """

    boxes_px: np.ndarray
    logits: np.ndarray

    @classmethod
    def of(cls, pose: TwoHandPose) -> Before:
        """What an estimate says; a hand without a score or box counts as there, and nowhere in particular."""
        boxes_px, logits = np.full((2, 4), np.nan), np.full(2, np.nan)
        for side, hand in enumerate(pose.hands):
            if hand.present:
                logits[side] = 0.0 if hand.score is None else log_odds(np.array(hand.score))
                if hand.box_px is not None:
                    boxes_px[side] = hand.box_px
        return cls(boxes_px, logits)


@dataclass(frozen=True, slots=True)
class Evidence:
    """What is known of HandSegNet's candidates 0 and 1, found as LEFT and RIGHT; either may be missing.

    Attributes:
        image_size: (H, W) of the picture.
        boxes_px: (2, 4) of the candidates; NaN for one that is missing.
        maps: what HandSegNet's maps say in these boxes.
        pose: (side, candidate) PoseNet2D's log-odds that the candidate is a hand of that side; NaN where it did not
            look.
        joints: (side, candidate) mean score of the joints in the same view, 0..1; NaN where it did not look.
        merged_pose, merged_joints: (2,) where the candidates are in one place, the same of both together seen as one
            LEFT or RIGHT hand (`geometry.segmentation.as_one_hand`); None where they are not.
        palm_distance: `palm_distance`, infinite for a candidate that is alone.
        before: the frame before; None where nothing is known.
        check: (candidate, 2) HandCheck's log-odds that the candidate is a hand, and that it is a LEFT one if it is a
            hand; NaN where it did not look.
        merged_check: (2,) the same of both together.
        palm: (3, 3) of the palm where a candidate is, or both together: how near it is, 0..1, and what HandCheck says
            of it, as `check`; NaN where there is none, and where nobody looked.
        body: of the person; None where there is none, or nobody looked.
    """

    image_size: tuple[int, int]
    boxes_px: np.ndarray
    maps: BoxEvidence
    pose: np.ndarray
    joints: np.ndarray
    merged_pose: np.ndarray | None = None
    merged_joints: np.ndarray | None = None
    palm_distance: float = math.inf
    before: Before | None = None
    check: np.ndarray = field(default_factory=lambda: np.full((2, 2), np.nan))
    merged_check: np.ndarray = field(default_factory=lambda: np.full(2, np.nan))
    palm: np.ndarray = field(default_factory=lambda: np.full((3, 3), np.nan))
    body: Body | None = None

    def surest(self, row: int) -> float:
        """PoseNet2D's largest log-odds of a hand, of either side, in the place of a row of `palm`; of candidates in one
        place the largest of both, and of both together."""
        if self.merged_pose is None:
            return float(np.nanmax(self.pose[:, row]))
        return float(np.nanmax([*self.pose.ravel(), *self.merged_pose]))

    def checks(self, source: np.ndarray) -> np.ndarray:
        """(2,) HandCheck's log-odds that the hands of an answer, `Assignment.source`, are hands; NaN for an absent one
        and where it did not look. Of two in one place a crop of either shows the other, too: what is said of both
        together counts where it is surer."""
        said = self.check[source, 0]
        if self.merged_pose is not None:
            alone = (source >= 0).sum() == 1
            said = np.full(2, self.merged_check[0]) if alone else np.fmax(said, self.merged_check[0])
        return np.where(source >= 0, said, np.nan)


@dataclass(frozen=True, slots=True)
class Assignment:
    """Which hand is which candidate.

    Attributes:
        source: (2,) int, for LEFT and RIGHT the candidate that it is; -1 for an absent hand.
        logits: (2,) log-odds that the hand is there and is that candidate; NaN for an absent one.
    """

    source: np.ndarray
    logits: np.ndarray


@dataclass(frozen=True, slots=True)
class LastLook:
    """What is known of an assignment's hands, LEFT and RIGHT, after the last view of them; NaN for an absent one.

    Attributes:
        source: (2,) int and
        first: (2,) log-odds, as in `Assignment`.
        pose: (2,) PoseNet2D's log-odds in the last view.
        joints: (2,) mean score of the joints in it, 0..1.
        size: (2,) longer side of the hand's box as a share of the picture's longer side.
        palm_distance: `palm_distance` of both hands, infinite for a hand that is alone.
        check: (2,) HandCheck's log-odds that they are hands; NaN also where it did not look.
    """

    source: np.ndarray
    first: np.ndarray
    pose: np.ndarray
    joints: np.ndarray
    size: np.ndarray
    palm_distance: float = math.inf
    check: np.ndarray = field(default_factory=UNCHECKED.copy)


def assign_handedness(evidence: Evidence, config: DecisionConfig) -> Assignment:
    """Which candidate is which hand, before `rescore`."""
    return best_answer(answer_scores(first_features(evidence), weight_vector(config.first, FIRST_FEATURES)))


def best_answer(scores: np.ndarray) -> Assignment:
    """The answer that is expected to be right of the most sides, from the scores (7,) of all: several answers may agree
    that a hand is there, each less probable than that none is (minimum Bayes risk)."""
    chances, sources = probabilities(scores), np.array(ANSWERS)
    alike = sources[:, None] == sources  # (answer, truth, side)
    agreed = np.einsum("atf,t->af", alike, chances)
    best = int(np.argmax(np.where(np.isfinite(scores), agreed.sum(axis=1), -np.inf)))
    return Assignment(sources[best], np.where(sources[best] >= 0, log_odds(agreed[best]), np.nan))


def rescore(look: LastLook, config: DecisionConfig) -> tuple[np.ndarray, np.ndarray]:
    """Which of the hands of an assignment are hands, after the last view of them.

    Returns:
        (2,) bool, which hands are rather there than not, and (2,) their log-odds; NaN for one that was absent before.
    """
    chances = probabilities(answer_scores(last_features(look), weight_vector(config.last, LAST_FEATURES)))
    kept = np.array(KEPT)
    logits = log_odds(np.array([chances[kept[:, side]].sum() for side in (LEFT, RIGHT)]))
    return (look.source >= 0) & (logits > 0), np.where(look.source >= 0, logits, np.nan)


def weight_vector(weights: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
    """Weights in the order of the features' names; 0 for one that has none."""
    return np.array([weights.get(name, 0.0) for name in names])


def answer_scores(features: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Scores (...) of answers with features (..., F); minus infinity for an answer that cannot be, whose are NaN."""
    scores = features @ weights
    return np.where(np.isnan(scores), -np.inf, scores)


def probabilities(scores: np.ndarray) -> np.ndarray:
    """Chances of the answers with these scores, along the last axis."""
    chances = np.exp(scores - scores.max(axis=-1, keepdims=True))
    return chances / chances.sum(axis=-1, keepdims=True)


def first_features(evidence: Evidence) -> np.ndarray:
    """Features of every answer.

    The features of an answer are the sums of those of its hands, and of the pair. Of a hand: 1 ("hand"); 1 if it is on
    the other side than HandSegNet says; HandSegNet's log-odds and lead for its side and for the other one, and the
    logarithm of the sides' shares in the box; PoseNet2D's log-odds, and by how much they are above those of the other
    side, or 1 for "mirror_unseen" if nobody looked; the same of the joints' score; HandCheck's log-odds that it is a
    hand, and one of this side, or 1 for "check_unseen"; by how much these are above `PASSED` where it looks at the palm
    in this place, and then those of this side, times how near that is (one palm is of one hand) and how far PoseNet2D
    is from being sure of a hand there; the logarithm of its size; from where the arm comes, and how far out in the
    picture it is, towards the hand's own side; and of the frame before whether the hand was there (1, -1, or 0 for
    unknown), and how surely it, or the other hand, was in this place. Where the candidates are in one place and only
    one hand is there, it is both together, with features of its own. Of the pair: 1 ("both"), how near each other their
    palms are, whether they are in one place, how much their boxes overlap, whether LEFT is on the left, and the lesser
    log-odds of PoseNet2D.

    Returns:
        (7, F) in the order of `ANSWERS` and `FIRST_FEATURES`; NaN for an answer that cannot be.
    """
    rows = np.full((len(ANSWERS), len(FIRST_FEATURES)), np.nan)
    for row, source in zip(rows, ANSWERS, strict=True):
        features = _first_of(evidence, source)
        if features is not None:
            row[:] = weight_vector(features, FIRST_FEATURES)
    return rows


def last_features(look: LastLook) -> np.ndarray:
    """Features of every last answer: sums over the hands that are kept, and of the pair.

    Of a hand: 1 ("hand"); the log-odds of the first decision; PoseNet2D's log-odds and the joints' score in the last
    view; the logarithm of its size; 1 if it is on the other side than HandSegNet says; what HandCheck's log-odds lack
    to be sure ("check_short"), or 1 for "check_unseen". Of the pair: 1 ("both"), and how near each other they are.

    Returns:
        (4, F) in the order of `KEPT` and `LAST_FEATURES`; NaN for an answer that cannot be.
    """
    rows = np.full((len(KEPT), len(LAST_FEATURES)), np.nan)
    for row, kept in zip(rows, KEPT, strict=True):
        hands = np.flatnonzero(kept)
        if (look.source[hands] < 0).any():
            continue
        features: dict[str, float] = dict.fromkeys(LAST_FEATURES, 0.0)
        for side in hands:
            features["hand"] += 1.0
            features["first"] += _limited(look.first[side])
            features["pose"] += _limited(look.pose[side])
            features["joints"] += look.joints[side] - _USUAL_SCORE
            features["size"] += _log_size(look.size[side])
            features["swapped"] += float(look.source[side] != side)
            unchecked = bool(np.isnan(look.check[side]))
            features["check_short"] += 0.0 if unchecked else min(0.0, _limited(look.check[side]) - PASSED)
            features["check_unseen"] += float(unchecked)
        if len(hands) == 2:
            features["both"], features["both_near"] = 1.0, _nearness(look.palm_distance)
        row[:] = weight_vector(features, LAST_FEATURES)
    return rows


def palm_distance(joints_px: np.ndarray, boxes_px: np.ndarray) -> float:
    """How far the palms of two hands are from each other: the mean of wrist and root joint, as a share of the larger
    box's longer side.

    Args:
        joints_px: (2, 21, 2) joints of both.
        boxes_px: (2, 4) their boxes.
    """
    apart = np.linalg.norm(np.diff(joints_px[:, [WRIST, ROOT]], axis=0), axis=-1).mean()
    return float(apart / (boxes_px[:, 2:] - boxes_px[:, :2]).max())


def box_sizes(boxes_px: np.ndarray, image_size: tuple[int, int]) -> np.ndarray:
    """(B,) longer sides of boxes (B, 4) as shares of the picture's longer side."""
    return (boxes_px[:, 2:] - boxes_px[:, :2]).max(axis=1) / max(image_size)


def _first_of(evidence: Evidence, source: tuple[int, int]) -> dict[str, float] | None:
    """Features of one answer; None where it cannot be."""
    hands = [(side, candidate) for side, candidate in enumerate(source) if candidate >= 0]
    if len(hands) == 1 and evidence.merged_pose is not None:
        side, candidate = hands[0]
        return _of_merged(evidence, side) if side == candidate else None
    if len(hands) == 2:
        evidence = replace(evidence, palm=_each_once(evidence.palm))
    features: dict[str, float] = dict.fromkeys(FIRST_FEATURES, 0.0)
    for side, candidate in hands:
        if np.isnan(evidence.pose[side, candidate]):
            return None
        for name, value in _of_hand(evidence, side, candidate).items():
            features[name] += value
    if len(hands) == 2:
        middles = (evidence.boxes_px[:, 0] + evidence.boxes_px[:, 2]) / 2
        features["both"] = 1.0
        features["both_near"] = _nearness(evidence.palm_distance)
        features["both_in_one_place"] = float(evidence.merged_pose is not None)
        features["both_overlap"] = float(box_iou(*evidence.boxes_px))
        features["both_uncrossed"] = float(np.sign(middles[source[RIGHT]] - middles[source[LEFT]]))
        features["both_weaker"] = min(_limited(evidence.pose[side, candidate]) for side, candidate in hands)
    return features


def _of_hand(evidence: Evidence, side: int, candidate: int) -> dict[str, float]:
    """Features of a candidate as a hand of a side."""
    maps, other, outwards = evidence.maps, 1 - side, _outwards(side)
    pose, joints = evidence.pose[:, candidate], evidence.joints[:, candidate]
    unseen = np.isnan(pose[other])
    box_px, width = evidence.boxes_px[candidate], evidence.image_size[1]
    arm_outside, arm_below = outwards * maps.arm[candidate, 0], maps.arm[candidate, 1]
    return {
        "hand": 1.0,
        "swapped": float(side != candidate),
        "energy": _limited(maps.energy[side, candidate]),
        "energy_other": _limited(maps.energy[other, candidate]),
        "lead": _limited(maps.lead[side, candidate]),
        "lead_other": _limited(maps.lead[other, candidate]),
        "share": _log_ratio(maps.share[side, candidate], maps.share[other, candidate]),
        "pose": _limited(pose[side]),
        "pose_contrast": 0.0 if unseen else _limited(pose[side]) - _limited(pose[other]),
        "mirror_unseen": float(unseen),
        "joints": joints[side] - _USUAL_SCORE,
        "joints_contrast": 0.0 if unseen else joints[side] - joints[other],
        **_of_check(evidence.check[candidate], side, "check"),
        "check_unseen": float(np.isnan(evidence.check[candidate, 0])),
        **_of_palm(evidence, side, candidate, "palm"),
        **_of_body(evidence.body, side, box_px, "body"),
        "size": _log_size(box_sizes(box_px[None], evidence.image_size)[0]),
        "arm_outside": float(np.clip(arm_outside, -2, 2)),
        "arm_below": float(np.clip(arm_below, -2, 2)),
        "arm_outside_below": float(np.clip(arm_outside * arm_below, -2, 2)),
        "outside": outwards * ((box_px[0] + box_px[2]) / 2 - width / 2) / width,
        **_of_before(evidence.before, side, box_px),
    }


def _of_merged(evidence: Evidence, side: int) -> dict[str, float]:
    """Features of both candidates in one place as one hand of a side."""
    pose, joints, maps, other = evidence.merged_pose, evidence.merged_joints, evidence.maps, 1 - side
    assert pose is not None and joints is not None
    box_px = box_around(evidence.boxes_px)
    energies = [_limited(maps.energy[hand].max()) for hand in (side, other)]
    return {
        "merged": 1.0,
        "merged_energy": energies[0] - energies[1],
        "merged_share": _log_ratio(maps.share[side].mean(), maps.share[other].mean()),
        "merged_pose": _limited(pose[side]),
        "merged_pose_contrast": _limited(pose[side]) - _limited(pose[other]),
        "merged_joints": joints[side] - _USUAL_SCORE,
        "merged_size": _log_size(box_sizes(box_px[None], evidence.image_size)[0]),
        **_of_check(evidence.merged_check, side, "merged_check"),
        **_of_palm(evidence, side, 2, "merged_palm"),
        **_of_body(evidence.body, side, box_px, "merged_body"),
        **_of_before(evidence.before, side, box_px),
    }


def _of_check(check: np.ndarray, side: int, name: str) -> dict[str, float]:
    """What HandCheck's log-odds (2,) say of a hand of a side; nothing where it did not look."""
    hand, left = np.nan_to_num(check)
    return {name: _limited(hand), f"{name}_side": _limited(left if side == LEFT else -left)}


def _each_once(palm: np.ndarray) -> np.ndarray:
    """Palms, as in `Evidence.palm`, of two candidates that are two hands: one palm, of which HandCheck says the same
    twice, is of the nearer one alone."""
    if not (palm[0, 1:] == palm[1, 1:]).all():
        return palm
    alone = palm.copy()
    alone[np.argmin(palm[:2, 0])] = np.nan
    return alone


def _of_palm(evidence: Evidence, side: int, row: int, name: str) -> dict[str, float]:
    """What the palm of a row of `Evidence.palm` says of a hand of a side: nothing where it does not pass as one, and
    less the surer PoseNet2D is of a hand there."""
    near, hand, left = np.nan_to_num(evidence.palm[row])
    passed = max(_limited(hand - PASSED), 0.0)
    if passed == 0:
        return {}
    counts = near * (1 - max(_limited(evidence.surest(row)), 0.0) / LOGIT_LIMIT)
    return {name: counts * passed, f"{name}_side": counts * _limited(left if side == LEFT else -left)}


def _of_body(body: Body | None, side: int, box_px: np.ndarray, name: str) -> dict[str, float]:
    """What a person's body says of a hand of a side in this box; nothing where nobody is."""
    if body is None:
        return {}
    near = body.near(box_px)
    return {
        name: float(near.max()),
        f"{name}_side": float(near[side] - near[1 - side]),
        f"{name}_both": float(near.min()),
    }


def _of_before(before: Before | None, side: int, box_px: np.ndarray) -> dict[str, float]:
    """What the frame before says of a hand in this box."""
    if before is None:
        return {}
    there = np.isfinite(before.logits)
    overlap = np.nan_to_num(box_iou(before.boxes_px, np.stack([box_px, box_px])))
    held = overlap * np.clip(np.nan_to_num(before.logits), 0.0, LOGIT_LIMIT)
    return {"was_present": 1.0 if there[side] else -1.0, "held": float(held[side]), "held_other": float(held[1 - side])}


def _outwards(side: int) -> float:
    """Direction in a picture of a person before the camera's back, u to the right: -1 for LEFT, 1 for RIGHT."""
    return -1.0 if side == LEFT else 1.0


def _limited(logit: float) -> float:
    return float(min(max(logit, -LOGIT_LIMIT), LOGIT_LIMIT))


def _log_ratio(share: float, other: float) -> float:
    """Logarithm of the ratio of two shares, 0..1, finite where either is 0."""
    return math.log((share + 0.02) / (other + 0.02))


def _log_size(size: float) -> float:
    """Logarithm of a size as a share of the picture, from a fifth of it."""
    return math.log(max(size, 1e-3) / 0.2)


def _nearness(distance: float) -> float:
    """0 for palms that are a hand or more from each other, more the nearer they are."""
    return -math.log(min(max(distance, 0.02), 1.0))
