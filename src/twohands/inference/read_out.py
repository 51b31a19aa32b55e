"""From heatmaps to joints with scores."""

from __future__ import annotations

import numpy as np

from twohands.geometry import heatmaps as codec

WINDOW_RADIUS = 6
"""Half side, in map cells, of the window round the peak: three to four times the target's sigma of 1.5 to 2 cells."""


def read_joints(maps: np.ndarray, decoder: str) -> tuple[np.ndarray, np.ndarray]:
    """Read one joint from every heatmap.

    Args:
        maps: (..., 21, M, M), not negative where it matters.
        decoder: "subpixel" for maps with linear output: a parabola through the logarithm about the peak, exact for a
            Gaussian of any width; the score is the peak's value. "softargmax" for probability maps: the mean within
            a window round the peak; the score is the share of the map's mass inside that window.

    Returns:
        (..., 21, 2) u, v in map cells, (0, 0) the outer corner, and (..., 21) scores 0..1.

    Source: SPEC 3. The paper does not say how it reads its maps. The window is ours: the mean over the whole map is
    drawn towards the crop's centre by any stray mass. Near the border the window is cut: networks that learn from the
    mean allow for the tail that a wide map misses there.
    """
    if decoder == "subpixel":
        joints, peaks = codec.decode_subpixel(maps)
        return joints, np.clip(peaks, 0.0, 1.0)
    return _windowed_mean(maps)


def _windowed_mean(maps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean position within the window round each map's peak, and the window's share of the map's mass."""
    size = maps.shape[-1]
    mass = np.clip(maps, 0.0, None).astype(np.float64)
    peak = mass.reshape(*mass.shape[:-2], -1).argmax(axis=-1)  # (..., 21)
    columns, rows = _window(peak % size, size), _window(peak // size, size)  # (..., 21, M)
    inside = mass * columns[..., None, :] * rows[..., :, None]
    total = np.maximum(inside.sum(axis=(-2, -1)), 1e-12)
    centres = np.arange(size) + 0.5
    u = inside.sum(axis=-2) @ centres / total
    v = inside.sum(axis=-1) @ centres / total
    scores = inside.sum(axis=(-2, -1)) / np.maximum(mass.sum(axis=(-2, -1)), 1e-12)
    return np.stack([u, v], axis=-1), scores


def _window(peak: np.ndarray, size: int) -> np.ndarray:
    """Cells within reach of each peak along one axis: (...) indices -> (..., size) bool."""
    return np.abs(np.arange(size) - peak[..., None]) <= WINDOW_RADIUS
