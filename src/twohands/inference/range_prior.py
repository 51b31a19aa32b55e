"""How far hands are from a camera before one looks, and what is most likely after.

Ours; the paper takes the range as the projection gives it. An estimated range is in error by a share of itself, and the
more, the less certain the 2D joints are. Hands are mostly within reach of what they do and of each other, so an
uncertain range is drawn towards what is usual and towards the other hand's. Measured in docs/experiments.md, *What is
usual, and the other hand*.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

USUAL_RANGE_M: Final = 0.47
"""Towards which uncertain ranges are drawn. The geometric mean over the hands of preset wild is 0.39; over those that
are uncertain, more."""
USUAL_SPREAD: Final = 0.35
"""Standard deviation of the logarithm of the range, over hands of preset wild."""
ALIKE: Final = 0.41
"""Correlation of the logarithms of both ranges, over pairs of hands of preset wild."""
LOWER_SCORE: Final = 0.8
"""Mean score for which the second of the errors given to `likely_ranges` is."""


def likely_ranges(radius_m: np.ndarray, joint_scores: np.ndarray, errors: tuple[float, float]) -> np.ndarray:
    """The most likely ranges of the hands of one picture.

    The logarithms of the ranges are taken for normal, of known mean and covariance, and so are the errors of their
    estimates, independent of each other: the result is the mean of what remains possible.

    Args:
        radius_m: (B,) estimated distances of the root joints from the pinhole, metres, of one hand or of both; NaN
            where unknown.
        joint_scores: (B, 21) 0..1.
        errors: standard deviations of the logarithm of an estimated range where the joints' mean score is 1, and where
            it is `LOWER_SCORE`; others follow as powers.

    Returns:
        (B,) metres; NaN where it was.
    """
    known = np.isfinite(radius_m)
    highest, lower = errors
    part = (1 - joint_scores[known].mean(axis=-1)) / (1 - LOWER_SCORE)
    error = highest ** (1 - part) * lower**part
    covariance = USUAL_SPREAD**2 * np.where(np.eye(len(error)), 1.0, ALIKE)
    usual = math.log(USUAL_RANGE_M)
    off = np.linalg.solve(covariance + np.diag(error**2), np.log(radius_m[known]) - usual)
    likely = np.array(radius_m, np.float64)
    likely[known] = np.exp(usual + covariance @ off)
    return likely
