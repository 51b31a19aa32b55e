"""Which candidate is which hand, in a clip: what this picture says, and what is known of the sides of hands that were
in these places (`inference.side_keeping`)."""

from __future__ import annotations

from typing import Final

import numpy as np

from twohands.geometry.segmentation import log_odds
from twohands.inference.decision import FIRST_FEATURES, DecisionConfig
from twohands.inference.handedness import (
    ANSWERS,
    Assignment,
    Evidence,
    answer_scores,
    best_answer,
    first_features,
    probabilities,
    weight_vector,
)
from twohands.inference.side_keeping import SIGNS, SideMemory
from twohands.inference.trail import Trail
from twohands.skeleton import LEFT, RIGHT

_BEFORE: Final = [FIRST_FEATURES.index(name) for name in ("was_present", "held", "held_other")]
_SOURCES: Final = np.array(ANSWERS)


def assign_in_clip(
    evidence: Evidence, seen_px: np.ndarray, config: DecisionConfig, memory: SideMemory
) -> tuple[Assignment, np.ndarray]:
    """As `handedness.assign_handedness`, where an answer has the chance besides that hands in these places are of its
    sides.

    Args:
        evidence: of the candidates.
        seen_px: (2, 4) boxes of the joints that are seen in them, as the hands of earlier frames have; NaN for none.
        config: of the card.
        memory: of the clip.

    Returns:
        The assignment, and (2,) log-odds that its hands are of their sides and not of the other, as this picture alone
        says; NaN for an absent one.
    """
    features, weights = first_features(evidence), weight_vector(config.first, FIRST_FEATURES)
    known = memory.left_logits(seen_px)
    scores = answer_scores(features, weights) + _side_scores(known, evidence.merged_pose is not None)
    assignment = best_answer(scores)
    weights[_BEFORE] = 0.0
    said = left_logits(probabilities(answer_scores(features, weights)))
    sides = np.where(assignment.source >= 0, SIGNS * said[assignment.source], np.nan)
    return assignment, sides


def known_assignment(trail: Trail, present: np.ndarray) -> Assignment:
    """Every hand of those that are known, (2,) bool, is itself, as surely as when HandSegNet saw it."""
    source = np.where(present, [LEFT, RIGHT], -1)
    return Assignment(source, np.where(present, log_odds(known_scores(trail)), np.nan))


def known_scores(trail: Trail) -> np.ndarray:
    """(2,) of the hands as HandSegNet saw them; even chances where there is none."""
    return np.array([0.5 if hand.score is None else hand.score for hand in trail.seen.hands])


def left_logits(chances: np.ndarray) -> np.ndarray:
    """(2,) log-odds that each candidate, if it is a hand, is the left one, from the answers' chances (7,)."""
    left, right = (
        np.array([chances[_SOURCES[:, side] == candidate].sum() for candidate in range(2)]) for side in (LEFT, RIGHT)
    )
    return np.log((left + 1e-6) / (right + 1e-6))


def _side_scores(known: np.ndarray, merged: bool) -> np.ndarray:
    """(7,) what the answers gain by what is known, (2,) log-odds of either candidate's being the left hand: 0 where
    nothing is. Of a pair, the difference counts: two candidates in the place of one remembered hand are no less likely
    a pair for that, and only one of them is that hand. Of candidates that are `merged` a hand alone is both together:
    of it is known what is of the one of which more is."""
    scores = np.zeros(len(ANSWERS))
    together = known[np.argmax(np.abs(known))]
    for number, (left, right) in enumerate(ANSWERS):
        hands = np.full(2, together) if merged and -1 in (left, right) else known
        if left >= 0 or right >= 0:
            lead = (hands[left] if left >= 0 else 0.0) - (hands[right] if right >= 0 else 0.0)
            scores[number] = np.log(2.0) - np.logaddexp(0.0, -lead)
    return scores
