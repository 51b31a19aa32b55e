"""Tileable pictures that people's clothes and hair are drawn with: wrinkles, strands, motifs."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from twohands.synth.scene.looks import MOTIFS


@lru_cache(maxsize=1)
def wrinkle_map(size: int = 512) -> np.ndarray:
    """(size, size, 3) uint8, tileable: slopes of creased cloth along both axes about 128, and how deep it lies.

    Folds are long, soft ridges, most of them lengthwise; fine creases lie between them.
    """
    rng = np.random.default_rng(7)
    height = np.zeros((3 * size, 3 * size))
    for count, length, width, tall in ((16, 0.55, 0.030, 1.0), (45, 0.28, 0.013, 0.45), (120, 0.12, 0.006, 0.16)):
        layer = np.zeros_like(height)
        for _ in range(count):
            turn = np.pi / 2 + rng.normal(0, 0.55)
            steps = np.linspace(-0.5, 0.5, 24)
            bend = rng.normal(0, 0.25, 2)
            angle = turn + bend[0] * 2 * steps + bend[1] * 8 * steps**2
            path = np.cumsum(np.stack([np.cos(angle), np.sin(angle)], 1), axis=0) * length * rng.uniform(0.5, 1.2) / 24
            path = (path - path.mean(0) + rng.uniform(0, 1, 2)) * size
            strength = tall * rng.uniform(0.4, 1.0) * rng.choice([-0.6, 1.0])
            fade = strength * np.cos(np.pi * steps) ** 0.7
            for dx in (0, 1, 2):
                for dy in (0, 1, 2):
                    at = path + np.array([dx, dy]) * size
                    if (at.max(0) < 0).any() or (at.min(0) > 3 * size).any():
                        continue
                    for (x0, y0), (x1, y1), value in zip(at, at[1:], fade[1:], strict=False):
                        ends = (round(x0), round(y0)), (round(x1), round(y1))
                        cv2.line(layer, *ends, float(value), max(1, round(width * size)))
        height += cv2.GaussianBlur(layer, (0, 0), 0.55 * width * size)
    height = height[size : 2 * size, size : 2 * size]
    height = (height - height.mean()) / height.std()
    slope = [np.roll(height, -1, axis) - np.roll(height, 1, axis) for axis in (1, 0)]
    scale = 3.5 * np.std(slope)
    planes = [*(np.clip(127.5 + 127.5 * s / scale, 0, 255) for s in slope), np.clip(100 - 70 * height, 0, 255)]
    return np.stack(planes, -1).astype(np.uint8)


@lru_cache(maxsize=1)
def strand_map(size: int = 256) -> np.ndarray:
    """(size, size, 4) uint8, tileable: strands of hair that run along the rows: brightness, length, lean, and the
    brightness of whole locks."""
    rng = np.random.default_rng(11)

    def smooth(sigma_x: float, sigma_y: float) -> np.ndarray:
        noise = np.fft.fft2(rng.normal(size=(size, size)))
        fy, fx = (np.fft.fftfreq(size)[:, None], np.fft.fftfreq(size)[None])
        kernel = np.exp(-2 * np.pi**2 * ((fx * sigma_x) ** 2 + (fy * sigma_y) ** 2))
        out = np.real(np.fft.ifft2(noise * kernel))
        rank = out.ravel().argsort().argsort().reshape(out.shape)
        return rank / out.size

    fine, lock = smooth(0.9, 24), smooth(7, 40)
    planes = [0.75 * fine + 0.25 * lock, 0.55 * smooth(1.0, 60) + 0.45 * lock, smooth(2, 20), smooth(9, 60)]
    return np.clip(255 * np.stack(planes, -1), 0, 255).astype(np.uint8)


@lru_cache(maxsize=1)
def motif_map(size: int = 128) -> np.ndarray:
    """(4 size, 4 size, 1) uint8: sixteen motifs as they are printed on shirts: lettering, stripes, rings, shapes."""
    rng = np.random.default_rng(23)
    sheet = np.zeros((4 * size, 4 * size), np.uint8)
    letters = "ABCDEFGHIKLMNOPRSTUVWXYZ0123456789"
    for number in range(MOTIFS):
        tile = np.zeros((size, size), np.uint8)
        middle = size // 2
        if number % 4 in (0, 1):
            lines = 1 + number % 3
            for line in range(lines):
                text = "".join(rng.choice(list(letters), rng.integers(3, 8)))
                font, thickness = int(rng.integers(0, 5)), int(rng.integers(2, 7))
                (width, height), _ = cv2.getTextSize(text, font, 1.0, thickness)
                grown = 0.88 * size / width
                at = int(0.06 * size), int(middle + (line - (lines - 1) / 2) * 0.3 * size + grown * height / 2)
                cv2.putText(tile, text, at, font, grown, 255.0, thickness, cv2.LINE_AA)
        if number % 4 in (1, 2):
            for _ in range(int(rng.integers(1, 4))):
                radius = int(rng.uniform(0.1, 0.45) * size)
                thickness = int(rng.choice([-1, 2, 5, 9]))
                cv2.circle(tile, (middle, middle), radius, float(rng.choice([90, 170, 255])), thickness, cv2.LINE_AA)
        if number % 4 == 3:
            corners = rng.uniform(0.08, 0.92, (int(rng.integers(3, 9)), 2)) * size
            cv2.fillPoly(tile, [corners.astype(np.int32)], 255.0, cv2.LINE_AA)
        row, column = divmod(number, 4)
        sheet[row * size : (row + 1) * size, column * size : (column + 1) * size] = tile
    return sheet[..., None]
