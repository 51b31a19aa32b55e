"""Backgrounds made of other backgrounds: in other colours, darker or overexposed, two in one.

A few hundred photographs show what they show in its own colours. White things in full light and whole pictures of one
tint are rare among them, so a network may take such a thing for a hand and be sure of it. Ours; the paper has the
photographs as they are.
"""

from __future__ import annotations

import cv2
import numpy as np

from twohands.synth.backgrounds.base import ChangedBackgrounds
from twohands.types import PinholeCamera


class RemixedBackgrounds(ChangedBackgrounds):
    """Remixes a share of another source's backgrounds: all of these are recoloured, half of them joined before."""

    change = "remixed"

    def changed(self, picture: np.ndarray, rng: np.random.Generator, camera: PinholeCamera) -> np.ndarray:
        """See `ChangedBackgrounds.changed`."""
        if rng.random() < 0.5:
            picture = joined(picture, self.source.sample(rng, camera).picture, rng)
        return recoloured(picture, rng)


def joined(picture: np.ndarray, other: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Two pictures (H, W, 3) uint8 in one: on either side of a line, or `other` small within `picture`, which may be
    upside down there."""
    height, width = picture.shape[:2]
    if rng.random() < 0.5:
        angle = rng.uniform(0, 2 * np.pi)
        across = np.array([np.cos(angle), np.sin(angle)], np.float32)
        offset = float((rng.uniform(0.2, 0.8, 2) * [width, height]) @ across)
        columns, rows = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
        nearer = (columns * across[0] + rows * across[1] < offset).astype(np.uint8)
        return np.asarray(cv2.copyTo(picture, nearer, other.copy()))
    scale = rng.uniform(0.25, 0.75)
    small = cv2.resize(other, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    left, top = rng.integers(0, width - small.shape[1] + 1), rng.integers(0, height - small.shape[0] + 1)
    result = picture.copy()
    result[top : top + small.shape[0], left : left + small.shape[1]] = small[:: -1 if rng.random() < 0.3 else 1]
    return result


def recoloured(picture: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The picture (H, W, 3) uint8 with its colours mixed or nearly grey, and darker or overexposed."""
    mix = np.eye(3)
    if rng.random() < 0.6:
        strength = rng.uniform(0.2, 1)
        mix = (1 - strength) * mix + strength * mix[rng.permutation(3)]
    if rng.random() < 0.3:
        mix = 0.3 * mix + 0.7 / 3
    gain = np.exp(rng.normal(0.15, 0.5) + rng.normal(0, 0.1, 3))
    return np.asarray(cv2.transform(picture, mix * gain[:, None]))
