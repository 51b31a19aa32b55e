"""From heatmaps to joints with scores."""

from __future__ import annotations

import numpy as np

from twohands.geometry import heatmaps as codec


def read_joints(maps: np.ndarray, decoder: str) -> tuple[np.ndarray, np.ndarray]:
    """Read one joint from every heatmap.

    Args:
        maps: (..., 21, M, M), not negative where it matters.
        decoder: "subpixel" for maps with linear output: a parabola through the logarithm about the peak, exact for a
            Gaussian of any width; the score is the peak's value. "softargmax" for probability maps: the mean within
            a window round the peak; the score is the share of the map's mass inside that window.

    Returns:
        (..., 21, 2) u, v in map cells, (0, 0) the outer corner, and (..., 21) scores 0..1.

    Source: SPEC 3. The paper does not say how it reads its maps.
    """
    if decoder == "subpixel":
        joints, peaks = codec.decode_subpixel(maps)
        return joints, np.clip(peaks, 0.0, 1.0)
    return codec.decode_windowed(np.asarray(maps, np.float64))
