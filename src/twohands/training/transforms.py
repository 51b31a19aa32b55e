"""Random changes of training pictures and masks. Pure functions of their input and a random generator."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from twohands.errors import InputError
from twohands.synth.render.sensor import streak


@dataclass(frozen=True)
class PhotometricConfig:
    """How strongly colours are changed; 0 everywhere leaves a picture as it is."""

    brightness: float = 0.0
    """Largest shift of all channels, as a fraction of 255."""
    contrast: float = 0.0
    """Largest relative change of contrast about mid-grey."""
    gamma: float = 0.0
    """Largest change of log2 of the gamma exponent: 1 allows 0.5 to 2."""
    hue: float = 0.0
    """Largest turn of the hue, as a fraction of the circle."""
    saturation: float = 0.0
    """Largest relative change of saturation."""
    blur: float = 0.0
    """Largest Gaussian blur, standard deviation in pixels of the network's input."""
    motion: float = 0.0
    """Longest streak of motion blur, in pixels of the network's input."""
    coarse: float = 0.0
    """Largest log2 of the factor by which a picture is shrunk and enlarged again, as by a webcam far away."""
    noise: float = 0.0
    """Largest standard deviation of sensor noise, as a fraction of 255."""
    texture: float = 0.0
    """Largest amplitude of multiplicative multi-scale texture, relative."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value >= 0:
                raise InputError(f"photometric: {name} must not be negative, got {value}")


@dataclass(frozen=True)
class MaskConfig:
    """How masks are spoilt, because at inference they are predictions; 0 everywhere keeps the true masks."""

    coarse: float = 0.0
    """Probability that borders are as rough as if predicted at a third of the crop's size."""
    border: float = 0.0
    """Largest growth of the border as a fraction of the crop's side; it shrinks by half of that, to keep fingers."""
    holes: float = 0.0
    """Probability that a piece of the primary hand is missing."""
    spill: float = 0.0
    """Probability that a piece of background counts as primary hand."""
    confusion: float = 0.0
    """Probability that a piece of one hand is labelled as the other."""
    no_arm: float = 0.0
    """Probability that the forearm is cut off, fully or in part."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0 <= value <= 1:
                raise InputError(f"mask imperfections: {name} must lie in 0..1, got {value}")


def jitter_colours(image: np.ndarray, config: PhotometricConfig, rng: np.random.Generator) -> np.ndarray:
    """A picture under other light, another camera, slightly out of focus.

    Args:
        image: (H, W, 3) uint8 RGB.
        config: the strengths; every amount is drawn uniformly between nothing and its largest value.
        rng: source of randomness.

    Returns:
        (H, W, 3) uint8, a new array.
    """

    def signed(limit: float) -> float:
        return float(rng.uniform(-limit, limit))

    out = image
    if config.hue or config.saturation:
        hsv = cv2.cvtColor(out, cv2.COLOR_RGB2HSV)
        turn, gain = signed(config.hue), 1 + signed(config.saturation)
        hsv[..., 0] = (hsv[..., 0].astype(np.int16) + round(180 * turn)) % 180
        hsv[..., 1] = cv2.convertScaleAbs(hsv[..., 1], alpha=gain)
        out = cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)

    levels = np.arange(256) / 255.0  # gamma, contrast, brightness and white balance as one table per channel
    levels = levels ** (2.0 ** signed(config.gamma))
    levels = (levels - 0.5) * (1 + signed(config.contrast)) + 0.5 + signed(config.brightness)
    balance = 1 + rng.uniform(-1, 1, 3) * 0.5 * config.brightness
    table = np.clip(levels[:, None] * balance * 255, 0, 255).round().astype(np.uint8)
    out = cv2.LUT(np.ascontiguousarray(out), table[None])

    if config.texture and rng.random() < 0.5:
        field = _noise_field(out.shape[:2], rng) * rng.uniform(0, config.texture)
        out = cv2.multiply(out, cv2.merge([1 + field] * 3), dtype=cv2.CV_8U)  # saturates
    if config.blur and rng.random() < 0.5:
        out = cv2.GaussianBlur(out, (0, 0), rng.uniform(0.2, 0.2 + config.blur))
    if config.motion and rng.random() < 0.3:
        length, angle = rng.uniform(1, 1 + config.motion), rng.uniform(0, np.pi)
        out = cv2.filter2D(out, -1, streak(length * np.array([np.cos(angle), np.sin(angle)])))
    if config.coarse and rng.random() < 0.3:
        height, width = out.shape[:2]
        factor = 2.0 ** rng.uniform(0, config.coarse)
        small = cv2.resize(out, (round(width / factor), round(height / factor)), interpolation=cv2.INTER_AREA)
        out = cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR)
    if config.noise and rng.random() < 0.5:
        sigma = rng.uniform(0, config.noise) * 255
        noise = rng.standard_normal(out.shape, dtype=np.float32) * np.float32(sigma)
        out = cv2.add(out, noise, dtype=cv2.CV_8U)  # saturates
    return out


def in_two_tones(image: np.ndarray, classes: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """One of two hands, arm and all, darker or lighter and in another hue than the other: lit otherwise, or, as in
    Ego3DHands, simply so.

    Args:
        image: (H, W, 3) uint8 RGB.
        classes: (H, W) uint8, 0 background, 1 left, 2 right.
        rng: source of randomness.

    Returns:
        (H, W, 3) uint8, a new array; of a picture that does not show both hands, as it is.
    """
    if not all((classes == hand).any() for hand in (1, 2)):
        return image.copy()
    gain = 2.0 ** (rng.normal(0, 0.6) + rng.normal(0, 0.2, 3))
    table = np.clip(np.arange(256)[:, None] * gain, 0, 255).round().astype(np.uint8)
    return np.where((classes == rng.integers(1, 3))[..., None], cv2.LUT(image, table[None]), image)


def spoil_masks(classes: np.ndarray, arm: np.ndarray, side: int, config: MaskConfig, rng: np.random.Generator):
    """Class masks of a crop as a segmentation network might have predicted them.

    Args:
        classes: (S, S) uint8, 0 background, 1 left, 2 right.
        arm: (S, S) bool, where the primary hand's forearm is.
        side: LEFT or RIGHT, the primary hand.
        config: probabilities and sizes.
        rng: source of randomness.

    Returns:
        (S, S) uint8, a new array.
    """
    out = classes.copy()
    primary, secondary = side + 1, 2 - side
    size = out.shape[0]
    if rng.random() < config.no_arm:
        cut = arm & (out == primary)
        if cut.any() and rng.random() < 0.5:  # keep the part of the forearm that is near the hand
            rows, cols = np.nonzero(cut)
            direction = rng.normal(size=2)
            along = rows * direction[0] + cols * direction[1]
            keep = along < np.quantile(along, rng.uniform(0.2, 0.8))
            cut[rows[keep], cols[keep]] = False
        out[cut] = 0
    if config.border:
        grows = rng.random() < 0.6
        radius = round(rng.uniform(0, 1 if grows else 0.5) * config.border * size)
        if radius:
            kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
            hand = (out == primary).astype(np.uint8)
            changed = cv2.dilate(hand, kernel) if grows else cv2.erode(hand, kernel)
            out[(changed == 0) & (out == primary)] = 0
            out[(changed == 1) & (out == 0)] = primary
    if rng.random() < config.holes:
        out[_blob(out == primary, rng, 0.12) & (out == primary)] = 0
    if rng.random() < config.spill:
        grown = cv2.dilate((out == primary).astype(np.uint8), np.ones((size // 8 | 1,) * 2, np.uint8)) == 1
        out[_blob(grown & (out == 0), rng, 0.15) & (out == 0)] = primary
    if rng.random() < config.confusion and (out == secondary).any():
        taken, given = (primary, secondary) if rng.random() < 0.5 else (secondary, primary)
        out[_blob(out == taken, rng, 0.12) & (out == taken)] = given
    if rng.random() < config.coarse:
        small = max(8, round(size / rng.uniform(1.5, 4.0)))
        shown = nearest_cells(small, size)[nearest_cells(size, small)]
        out = out[np.ix_(shown, shown)]
    return out


def nearest_cells(count: int, of: int) -> np.ndarray:
    """(count,) int: for each of `count` cells in a row, which of `of` cells along the same length holds its middle.

    cv2.INTER_NEAREST takes the cell's corner instead, which moves labels right and down.
    """
    return ((np.arange(count) + 0.5) * of / count).astype(int)


def _noise_field(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """(H, W) float32 of multi-scale noise, standard deviation about 1."""
    height, width = shape
    field = np.zeros(shape, np.float32)
    for cells in (4, 8, 16, 32):
        grid = rng.standard_normal((cells, cells), dtype=np.float32)
        field += cv2.resize(grid, (width, height), interpolation=cv2.INTER_LINEAR) * 0.6
    return field


def _blob(where: np.ndarray, rng: np.random.Generator, largest: float) -> np.ndarray:
    """A random ellipse (bool mask) centred on a random pixel of `where`; half-axes up to `largest` of the side."""
    mask = np.zeros(where.shape, np.uint8)
    spots = np.flatnonzero(where)
    if len(spots):
        row, col = divmod(int(spots[rng.integers(len(spots))]), where.shape[1])
        axes = np.maximum(1, rng.uniform(0.02, largest, 2) * where.shape[0]).astype(int)
        cv2.ellipse(mask, (col, row), (int(axes[0]), int(axes[1])), float(rng.uniform(0, 180)), 0, 360, 1, -1)
    return mask == 1
