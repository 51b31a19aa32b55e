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
    cv2.copyTo(rgb, cv2.inRange(alpha, 255, 255), out)
    edge = partly_covered(alpha)  # few pixels: blending the others would change nothing
    weight = alpha.ravel()[edge, None].astype(np.uint16)
    mixed = rgb.reshape(-1, 3)[edge] * weight + background.reshape(-1, 3)[edge] * (255 - weight)
    out.reshape(-1, 3)[edge] = (mixed + 127) // 255
    return out


def partly_covered(alpha: np.ndarray) -> np.ndarray:
    """(N,) flat indices of the pixels of `alpha` (H, W) uint8 that are neither 0 nor 255."""
    return np.flatnonzero(alpha - np.uint8(1) < 254)  # 0 wraps round to 255


def compose_frame(frame: RenderedFrame, background: np.ndarray) -> np.ndarray:
    """`compose` on a rendered frame."""
    return compose(frame.rgb, frame.alpha, background)
