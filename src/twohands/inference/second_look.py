"""Which of two pairs of pose networks knows a hand.

Ours. Networks that have learnt from renderings alone place the joints of rendered hands best; networks on an encoder
that has seen real hands know those of people better. A preset may have both: the second pair looks at every hand as
well, and a logistic model whose weights the card holds says whose joints count. Which hands are there, and whose, the
first pair has said before: what the two say of that is not to be compared. Features in, decisions out;
scripts/fit_second_look.py fits the weights.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from twohands.inference.decision import SECOND_FEATURES, DecisionConfig
from twohands.inference.expected import FARTHEST, strayed
from twohands.inference.handedness import LOGIT_LIMIT, PASSED, weight_vector
from twohands.inference.keypoints import Keypoints

TWICE: Final = 0.2
"""Mean distance of corresponding joints, in sizes of the larger hand, below which two hands are one that is seen twice
(docs/history/journal.md, *Bodies*)."""
_LEAST_DOUBT: Final = 0.01
"""Added to what the mean score of a hand's joints lacks, before its logarithm is taken."""
_LEAST_APART: Final = 0.02
"""The same of how far the two pairs see the joints apart, in sizes of the hand."""


def second_features(first: Keypoints, second: Keypoints) -> np.ndarray:
    """What speaks for the second pair.

    Args:
        first, second: what the two pairs see of the same B hands.

    Returns:
        (B, F) values of `SECOND_FEATURES`: 1; the logarithm of what the mean scores of the joints lack, of either; the
        log-odds of a hand, of either; how far the second's exceed `PASSED`; the logarithm of the mean distance of the
        joints, in sizes of the hand; and its products with the second and third.
    """
    size_px = np.maximum(np.ptp(first.joints_px, axis=1).max(axis=-1), 1e-9)
    apart = np.linalg.norm(first.joints_px - second.joints_px, axis=-1).mean(axis=-1) / size_px
    apart = np.log(_LEAST_APART + np.minimum(apart, 1.0))
    doubts = [np.log(_LEAST_DOUBT + 1 - seen.joint_scores.mean(axis=-1)) for seen in (first, second)]
    poses = [np.clip(seen.hand_logits, -LOGIT_LIMIT, LOGIT_LIMIT) for seen in (first, second)]
    passed = np.maximum(poses[1] - PASSED, 0.0)
    values = [np.ones(len(apart)), *doubts, *poses, passed, apart, doubts[0] * apart, doubts[1] * apart]
    return np.stack(values, axis=-1)


def knows_better(
    first: Keypoints, second: Keypoints, config: DecisionConfig, expected_px: np.ndarray | None = None
) -> np.ndarray:
    """Whether the second pair knows a hand better.

    Args:
        first, second: what the two pairs see of the same B hands.
        config: of the card.
        expected_px: (2, B, 21, 2) where either pair is expected to see the joints in a clip, NaN where it did not look
            in the last frame; the pair that alone sees a hand there, within the second one's `FARTHEST`, knows it
            better.

    Returns:
        (B,) bool.
    """
    better = second_features(first, second) @ weight_vector(config.second, SECOND_FEATURES) > 0
    if expected_px is None:
        return better
    both = zip(expected_px, (first, second), strict=True)
    there = [strayed(px, seen.joints_px) <= FARTHEST[1] for px, seen in both]
    there[1] &= second.hand_logits >= 0
    return np.where(there[0] == there[1], better, there[1])


def seen_twice(first: Keypoints, second: Keypoints, rows: np.ndarray, better: np.ndarray) -> np.ndarray:
    """Which hands the second pair sees where the other hand is. Joints of two hands, one mirrored, seldom lie one on
    the other; of touching hands the nearer one is easily seen twice, and is the one that the first pair sees there.

    Args:
        first: both hands, or one.
        second: what the second pair sees of B of these, in `rows`, (B,).
        better: which of `second` count.

    Returns:
        (B,) bool, at most one of `better`.
    """
    twice = np.zeros(len(rows), bool)
    if len(first.sides) < 2 or not len(better):
        return twice
    seen_px = first.joints_px.copy()
    seen_px[rows[better]] = second.joints_px[better]
    apart_px = np.linalg.norm(seen_px[0] - seen_px[1], axis=-1).mean()
    if apart_px < TWICE * np.ptp(seen_px, axis=1).max():
        moved_px = np.linalg.norm(first.joints_px - seen_px, axis=-1).mean(axis=-1)
        twice[better] = rows[better] == int(np.argmax(moved_px))
    return twice
