"""Whose hand is it, if any: HandSegNet's candidates, judged by PoseNet2D.

Ours; the paper trusts the energy's peak. HandSegNet sees the whole picture at low resolution. PoseNet2D sees one
candidate at high resolution, as cut and, if that looks wrong, mirrored: a left hand in the mirror is a right one.
"""

from __future__ import annotations

import itertools
from typing import Final

import numpy as np

from twohands.geometry.boxes import box_iou
from twohands.geometry.segmentation import PERHAPS, log_odds
from twohands.skeleton import LEFT, RIGHT, ROOT, WRIST

CANDIDATE_THRESHOLD: Final = 0.2
"""HandSegNet's score (`geometry.segmentation.hand_scores`) from which on PoseNet2D looks at a candidate.

This and the next four were chosen together, with earlier weights, on generated pictures that are neither trained nor
tested on, and on the photographs that training puts behind hands; 0.3, as it was then, misses two more of 2,722 hands
(docs/experiments.md, *Who shows one hand mostly shows both*).
"""
TURN_BELOW: Final = 0.0
"""Log-odds of PoseNet2D for any candidate below which it looks at the mirror images too: at 1 % of the candidates at an
egocentric view. Of two candidates at both: 3,072 instead of 3,069 of 3,282 hands are then known for what they are."""
SEG_WEIGHT: Final = 0.7
"""Weight of HandSegNet's log-odds in the decision; PoseNet2D's have the rest. HandSegNet sees the person."""
SEG_LIMIT: Final = 3.0
"""HandSegNet's log-odds are limited to this size: it may be sure and wrong."""
TURN_COST: Final = 1.0
"""Log-odds taken off where a hand is on the other side than HandSegNet says: most often it is right."""
ONE_PLACE: Final = 0.1
"""Two candidates that are less than this from each other (`palms_apart`) are in one place."""
ONE_PLACE_COST: Final = 1.0
"""Log-odds taken off where two hands are in one place: of 58 such pairs in generated pictures 16 were two hands."""
WHOLE_SEG_WEIGHT: Final = 0.4
"""As `SEG_WEIGHT`, where two candidates in one place are taken for one hand and PoseNet2D sees the whole of it. With
earlier weights the parts alone told the side of 91 % of 86 such hands in photographs, the whole of 94 %, HandSegNet of
67 %. In generated pictures 0.2 to 0.5 are alike; the photographs had a say in this choice and in `TURN_BELOW`'s."""
APART: Final = 0.4
"""Two candidates at least this far from each other (`palms_apart`) are not one hand found twice. The real crops had a
say in this choice: nearer ones are doubles there more often than in generated pictures."""
SECOND_HAND: Final = 0.75
"""Log-odds given to a candidate `APART` from another that is a hand: who shows one hand mostly shows both. Chosen with
`PROVISIONAL` and `SCORE_MIDDLE` on 1,400 pictures of preset wild, neither trained nor tested on: docs/experiments.md,
*The last word comes last*."""
PROVISIONAL: Final = 1.0
"""Log-odds below 0 down to which a candidate that no other is near may still be taken for a hand by the last word,
which knows more: it gives a hand of which all is certain 0.9, and takes what PoseNet2D says in a better crop."""
SCORE_WEIGHT: Final = 4.0
"""Log-odds for the mean score, 0..1, of a hand's joints in the last look at it, less `SCORE_MIDDLE`: the joints of what
is no hand are nowhere in particular. Chosen, with 0.8 in the middle, on 4,384 hands in generated pictures and videos,
of which it costs 10 (9 of the 693 of preset wild), and 114 places in photographs and procedural backgrounds that both
networks of preset `fast` had taken for hands, of which 67 remain; two videos of the test set gave the idea. 3 to 6 are
alike."""
SCORE_MIDDLE: Final = 0.775
"""Mean score that speaks neither for nor against a hand."""
REMEMBERED_THRESHOLD: Final = 0.1
"""As `CANDIDATE_THRESHOLD`, for a hand that was there one frame of a video before."""
MEMORY: Final = 0.5
"""Log-odds given to a hand that was there one frame before, and taken off one that was not: hands seldom come or go.
In 2,100 frames of generated video, not trained or tested on, hands came or went 45 times without and 29 times with it,
20 times in truth; 41 and 33 were missed, 50 and 52 invented. Twice as much keeps hands and clutter alike."""


def assign_sides(
    seg_scores: np.ndarray,
    own: np.ndarray,
    turned: np.ndarray,
    *,
    whole: np.ndarray | None = None,
    apart: bool = False,
    remembered: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """The most probable answer to which candidate is which hand, before `last_word`.

    Every candidate is the hand that it was found as, the other one, or none; each hand is at most one of them. The
    answer maximises the sum of the log-odds of the hands that are there; with `PROVISIONAL` more for each of them where
    the candidates are apart.

    Args:
        seg_scores: (2,) HandSegNet's scores of the candidates LEFT and RIGHT, 0..1.
        own: (2,) PoseNet2D's log-odds that candidate LEFT is a left hand, candidate RIGHT a right one; NaN for none.
        turned: (2,) its log-odds that candidate LEFT is a right hand, candidate RIGHT a left one; NaN where it did not
            look.
        whole: (2,) where the candidates are in `ONE_PLACE`, PoseNet2D's log-odds that they are one left hand, or one
            right hand (`geometry.segmentation.as_one_hand`); what it says of one candidate counts for two hands only
            then. None where they are not.
        apart: whether the candidates are `APART`; a candidate that is alone is, too.
        remembered: (2,) bool, which hands were there one frame before; None where nothing is known.

    Returns:
        source (2,) int: for LEFT and RIGHT the candidate that it is, -1 for an absent hand; and log-odds (2,) of the
        answer for each hand, NaN for an absent one.
    """
    seg = np.clip(log_odds(seg_scores), -SEG_LIMIT, SEG_LIMIT)
    judged = np.array([[own[0], turned[1]], [turned[0], own[1]]], np.float64)  # [side, candidate]
    memory = np.zeros((2, 1)) if remembered is None else np.where(remembered, MEMORY, -MEMORY)[:, None]
    values = SEG_WEIGHT * seg + (1 - SEG_WEIGHT) * judged - TURN_COST * (1 - np.eye(2)) + memory
    values = np.where(np.isnan(values), -np.inf, values)
    alone = values  # of a hand without the other one
    if whole is not None:
        either = WHOLE_SEG_WEIGHT * seg + (1 - WHOLE_SEG_WEIGHT) * whole
        alone = np.where(np.eye(2) > 0, either + memory, -np.inf)
    provisional = PROVISIONAL if apart else 0.0
    best, answer, logits = 0.0, (-1, -1), [np.nan, np.nan]
    for sources in itertools.product((-1, 0, 1), repeat=2):
        if sources[0] == sources[1] != -1:
            continue
        both = min(sources) >= 0
        table = values if both else alone
        terms = [float(table[side, c]) if c >= 0 else np.nan for side, c in enumerate(sources)]
        if both and apart and max(terms) > 0:
            terms[int(np.argmin(terms))] += SECOND_HAND
        total = np.nansum(terms) + provisional * np.isfinite(terms).sum()
        if both and whole is not None:
            total -= ONE_PLACE_COST
        if total > best:
            best, answer, logits = total, sources, terms
    return np.array(answer), np.array(logits)


def last_word(
    answer: np.ndarray, first_logits: np.ndarray, last_logits: np.ndarray, joint_scores: np.ndarray
) -> np.ndarray:
    """Log-odds of hands that `assign_sides` has decided for, after the last look at them.

    Args:
        answer: (B,) log-odds of `assign_sides`.
        first_logits: (B,) PoseNet2D's log-odds that went into them.
        last_logits: (B,) its log-odds in the last look, which counts in place of the first.
        joint_scores: (B, 21) scores of the joints in the last look, 0..1.

    Returns:
        (B,) log-odds; of 0 or less, it is no hand.
    """
    scores = joint_scores.mean(axis=-1)
    return answer + (1 - SEG_WEIGHT) * (last_logits - first_logits) + SCORE_WEIGHT * (scores - SCORE_MIDDLE)


def palms_apart(joints_px: np.ndarray, boxes_px: np.ndarray) -> float:
    """How far the palms of two candidates are from each other: the mean of wrist and root joint, as a share of the
    larger box's longer side.

    Args:
        joints_px: (2, 21, 2) joints of both candidates, each found as the hand that HandSegNet took it for.
        boxes_px: (2, 4) their boxes.
    """
    apart = np.linalg.norm(np.diff(joints_px[:, [WRIST, ROOT]], axis=0), axis=-1).mean()
    return float(apart / (boxes_px[:, 2:] - boxes_px[:, :2]).max())


def corrected_masks(masks: np.ndarray, source: np.ndarray, boxes_px: np.ndarray) -> np.ndarray:
    """Masks that agree with the answer.

    Args:
        masks: (H, W) uint8, as `masks_from_logits` gives them, by HandSegNet's candidates.
        source: (2,) as `assign_sides` gives it.
        boxes_px: (2, 4) u0, v0, u1, v1 of the candidates; NaN where there was none.

    Returns:
        The same array if nothing changes; else a new one, in which each candidate's pixels bear the class of the hand
        that it is. The pixels of a candidate that is no hand go to a hand whose box meets its own, else to the
        background.
    """
    classes = np.arange(1 + 2 * PERHAPS, dtype=np.uint8)
    for candidate in np.flatnonzero(np.isfinite(boxes_px).all(axis=1)):
        owners, others = np.flatnonzero(source == candidate), np.flatnonzero(source == 1 - candidate)
        if len(owners):
            classes[1 + candidate] = 1 + owners[0]
        elif len(others) and box_iou(*boxes_px) > 0:
            classes[1 + candidate] = 1 + others[0]
        else:
            classes[1 + candidate] = 0
    for known in (1 + LEFT, 1 + RIGHT):
        classes[known + PERHAPS] = classes[known] + PERHAPS if classes[known] else 0
    return masks if classes.tolist() == list(range(len(classes))) else classes[masks]
