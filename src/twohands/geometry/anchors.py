"""Anchors: the places in its input from which a published detector counts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def anchor_middles(size: int, strides: Sequence[tuple[int, int]]) -> NDArray[np.float64]:
    """(A, 2) middles of the anchors in pixels of the input, in the order of the outputs.

    Args:
        size: rows and columns of the input.
        strides: pixels from one anchor to the next, and how many lie in one place.
    """
    rows: list[NDArray[np.float64]] = []
    for stride, count in strides:
        places = np.asarray((np.arange(size // stride) + 0.5) * stride, np.float64)
        v, u = np.meshgrid(places, places, indexing="ij")
        rows.append(np.repeat(np.column_stack([u.ravel(), v.ravel()]), count, axis=0))
    return np.concatenate(rows)
