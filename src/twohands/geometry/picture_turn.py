"""By how many quarters an upright picture was turned: what the maps of a network say of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

TURNS = 4
"""Quarters by which a picture may be turned, none included."""
TURN_AREAS = 3
"""The picture has so many rows and columns of areas, each with maps of its own that say how it is turned."""
TURN_MAPS = TURN_AREAS**2 * TURNS
"""Maps in all: for every area one of every turn."""


def turn_logits(maps: np.ndarray) -> np.ndarray:
    """Log-odds, against each other, that a picture is an upright one turned by 0 to 3 quarters, counter-clockwise.

    Ours. Where heads, arms and floors are tells how a camera was held.

    Args:
        maps: (TURN_MAPS, h, w).

    Returns:
        (TURNS,) sums over areas of the means of their own maps.
    """
    means = area_means(maps)
    return np.sum([row[TURNS * area : TURNS * (area + 1)] for area, row in enumerate(means)], axis=0)


def area_means(maps: np.ndarray) -> NDArray[np.float64]:
    """Means of maps (C, h, w) in areas of the picture, in rows from its upper left: (TURN_AREAS^2, C); 0 in an area
    without a cell."""
    rows, columns = (np.arange(TURN_AREAS + 1) * size // TURN_AREAS for size in maps.shape[1:])
    means: NDArray[np.float64] = np.zeros((TURN_AREAS**2, len(maps)))
    for number in range(TURN_AREAS**2):
        i, j = divmod(number, TURN_AREAS)
        area = maps[:, rows[i] : rows[i + 1], columns[j] : columns[j + 1]]
        if area.size:
            means[number] = area.mean(axis=(1, 2))
    return means
