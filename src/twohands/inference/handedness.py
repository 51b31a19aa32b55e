"""Whose hand is it, if any: the decision, from what both networks say of HandSegNet's candidates.

Ours; the paper trusts the energy's peak. HandSegNet sees the whole picture at low resolution. PoseNet2D sees one
candidate at high resolution, as cut and, if that looks wrong, mirrored: a left hand in the mirror is a right one.

Features in, decisions out; `inference.detection` gathers the features and carries the decisions out.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from twohands.geometry.segmentation import log_odds
from twohands.inference.decision import DecisionConfig
from twohands.skeleton import ROOT, WRIST


@dataclass(frozen=True, slots=True)
class Candidates:
    """What is known of HandSegNet's candidates LEFT and RIGHT, one of which may be missing.

    Attributes:
        seg_scores: (2,) HandSegNet's scores, 0..1.
        logits: (2,) PoseNet2D's log-odds that candidate LEFT is a left hand, candidate RIGHT a right one; NaN for none.
        mirrored_logits: (2,) its log-odds that candidate LEFT is a right hand, candidate RIGHT a left one; NaN where it
            did not look.
        merged_logits: (2,) where the candidates are in one place, its log-odds that both together are one left hand, or
            one right hand (`geometry.segmentation.as_one_hand`); what it says of one candidate counts for two hands
            only then. None where they are not.
        palm_distance: `palm_distance`, infinite for a candidate that is alone.
        was_present: (2,) bool, which hands were there one frame before; None where nothing is known.
    """

    seg_scores: np.ndarray
    logits: np.ndarray
    mirrored_logits: np.ndarray
    merged_logits: np.ndarray | None = None
    palm_distance: float = math.inf
    was_present: np.ndarray | None = None


@dataclass(frozen=True, slots=True)
class Assignment:
    """Which hand is which candidate.

    Attributes:
        source: (2,) int, for LEFT and RIGHT the candidate that it is; -1 for an absent hand.
        logits: (2,) log-odds that the hand is there; NaN for an absent one.
    """

    source: np.ndarray
    logits: np.ndarray


def assign_handedness(candidates: Candidates, config: DecisionConfig) -> Assignment:
    """The most probable answer to which candidate is which hand, before `rescore`.

    Every candidate is the hand that it was found as, the other one, or none; each hand is at most one of them. The
    answer maximises the sum of the log-odds of the hands that are there; with `provisional_logit` more for each of them
    where the candidates are apart.
    """
    was, merged = candidates.was_present, candidates.merged_logits
    seg = np.clip(log_odds(candidates.seg_scores), -config.seg_limit, config.seg_limit)
    own, mirrored = candidates.logits, candidates.mirrored_logits
    pose = np.array([[own[0], mirrored[1]], [mirrored[0], own[1]]], np.float64)  # [side, candidate]
    before = np.zeros((2, 1))
    if was is not None:
        before = np.where(was, config.was_present_logit, -config.was_present_logit)[:, None]
    values = config.seg_weight * seg + (1 - config.seg_weight) * pose - config.swap_cost * (1 - np.eye(2)) + before
    values = np.where(np.isnan(values), -np.inf, values)
    alone = values  # of a hand without the other one
    if merged is not None:
        either = config.merged_seg_weight * seg + (1 - config.merged_seg_weight) * merged
        alone = np.where(np.eye(2) > 0, either + before, -np.inf)
    apart = candidates.palm_distance >= config.apart_distance
    provisional = config.provisional_logit if apart else 0.0
    best, answer, logits = 0.0, (-1, -1), [np.nan, np.nan]
    for sources in itertools.product((-1, 0, 1), repeat=2):
        if sources[0] == sources[1] != -1:
            continue
        both = min(sources) >= 0
        table = values if both else alone
        terms = [float(table[side, c]) if c >= 0 else np.nan for side, c in enumerate(sources)]
        if both and apart and max(terms) > 0:
            terms[int(np.argmin(terms))] += config.second_hand_bonus
        total = np.nansum(terms) + provisional * np.isfinite(terms).sum()
        if both and merged is not None:
            total -= config.same_place_cost
        if total > best:
            best, answer, logits = total, sources, terms
    return Assignment(np.array(answer), np.array(logits))


def rescore(
    logits: np.ndarray,
    first_logits: np.ndarray,
    last_logits: np.ndarray,
    joint_scores: np.ndarray,
    config: DecisionConfig,
) -> np.ndarray:
    """Log-odds of hands that `assign_handedness` has decided for, after the last view of them.

    Args:
        logits: (B,) log-odds of `assign_handedness`.
        first_logits: (B,) PoseNet2D's log-odds that went into them.
        last_logits: (B,) its log-odds in the last view, which counts in place of the first.
        joint_scores: (B, 21) scores of the joints in the last view, 0..1.
        config: the weights.

    Returns:
        (B,) log-odds; of 0 or less, it is no hand.
    """
    scores = joint_scores.mean(axis=-1)
    taken_back = (1 - config.seg_weight) * (last_logits - first_logits)
    return logits + taken_back + config.joint_score_weight * (scores - config.joint_score_middle)


def palm_distance(joints_px: np.ndarray, boxes_px: np.ndarray) -> float:
    """How far the palms of two candidates are from each other: the mean of wrist and root joint, as a share of the
    larger box's longer side.

    Args:
        joints_px: (2, 21, 2) joints of both candidates, each found as the hand that HandSegNet took it for.
        boxes_px: (2, 4) their boxes.
    """
    apart = np.linalg.norm(np.diff(joints_px[:, [WRIST, ROOT]], axis=0), axis=-1).mean()
    return float(apart / (boxes_px[:, 2:] - boxes_px[:, :2]).max())
