"""Puts rendered hands in front of a background."""

from __future__ import annotations

import cv2
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
    out = background.copy()
    cv2.copyTo(rgb, np.where(alpha == 255, alpha, 0), out)
    edge = (alpha > 0) & (alpha < 255)  # few pixels: blending the others would change nothing
    weight = alpha[edge][:, None].astype(np.uint16)
    mixed = rgb[edge] * weight + background[edge] * (255 - weight)
    out[edge] = (mixed + 127) // 255
    return out


def compose_frame(frame: RenderedFrame, background: np.ndarray) -> np.ndarray:
    """`compose` on a rendered frame."""
    return compose(frame.rgb, frame.alpha, background)
