"""Puts rendered hands in front of a background."""

from __future__ import annotations

import numpy as np

from twohands.types import RenderedFrame


def compose(rgb: np.ndarray, alpha: np.ndarray, background: np.ndarray) -> np.ndarray:
    """Straight-alpha "over".

    Args:
        rgb: (H, W, 3) uint8, straight colour of the hands.
        alpha: (H, W) uint8.
        background: (H, W, 3) uint8.

    Returns:
        (H, W, 3) uint8; exactly `rgb` where alpha is 255 and `background` where it is 0.
    """
    weight = alpha[..., None].astype(np.uint16)
    mixed = rgb * weight + background * (255 - weight)
    return ((mixed + 127) // 255).astype(np.uint8)


def compose_frame(frame: RenderedFrame, background: np.ndarray) -> np.ndarray:
    """`compose` on a rendered frame."""
    return compose(frame.rgb, frame.alpha, background)
