"""Draws forearms for hands that were cut out of pictures: bare, or in a sleeve of cloth."""

from __future__ import annotations

import cv2
import numpy as np

STRIP = (96, 32)
"""Size of a strip's picture: along the arm, across it."""
PATTERNED = 0.45
"""Share of sleeves that are striped, checked or knitted."""


def arm_path(
    start_px: np.ndarray, along: np.ndarray, unit_px: float, far_px: float, rng: np.random.Generator
) -> np.ndarray:
    """A forearm and the upper arm behind it, which leaves the picture.

    Args:
        start_px: (2,) where the forearm begins.
        along: (2,) unit vector, its direction.
        unit_px: distance from the hand's wrist to its middle knuckle.
        far_px: a distance that leads out of the picture from anywhere in it.
        rng: draws the forearm's length as it is seen, and the bend of the elbow.

    Returns:
        (K, 2) points on its axis, in pixels.
    """
    forearm = unit_px * rng.uniform(1.8, 3.0)
    bend = np.radians(rng.normal(0, 25))
    turn = np.array([[np.cos(bend), -np.sin(bend)], [np.sin(bend), np.cos(bend)]])
    elbow, beyond = start_px + along * forearm, turn @ along
    corner = 0.35 * forearm
    return np.stack(
        [
            start_px,
            elbow - along * corner,
            (2 * elbow - along * corner * 0.5 + beyond * corner * 0.5) / 2,
            elbow + beyond * corner,
            elbow + beyond * (corner + far_px),
        ]
    )


def draw_strip(
    image: np.ndarray, labels: np.ndarray, label: int, points: np.ndarray, widths: np.ndarray, strip: np.ndarray
) -> None:
    """Lays a strip of cloth or skin along a path.

    Args:
        image: (H, W, 3) uint8, changed.
        labels: (H, W) uint8, set to `label` where the strip covers more than half of a pixel.
        label: of the strip.
        points: (K, 2) its axis, in pixels.
        widths: (K,) there, in pixels.
        strip: (rows, columns, 3) uint8, along and across.
    """
    slope = np.gradient(points, axis=0)
    across = np.stack([-slope[:, 1], slope[:, 0]], axis=1) / np.maximum(np.linalg.norm(slope, axis=1), 1e-9)[:, None]
    sides = points[:, None] + across[:, None] * np.array([-0.5, 0.5])[:, None] * widths[:, None, None]  # (K, 2, 2)
    window = window_of(sides.reshape(-1, 2), labels.shape)
    if window is None:
        return
    left, top, right, bottom = window
    local = (sides - [left, top]).astype(np.float32)
    size = (right - left, bottom - top)
    drawn, cover = np.zeros((size[1], size[0], 3), np.uint8), np.zeros((size[1], size[0]), np.uint8)
    lengths = np.array([0, *np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    rows = lengths / lengths[-1] * strip.shape[0]
    for i in range(len(points) - 1):
        _draw_quad(drawn, local[i], local[i + 1], strip, rows[i], rows[i + 1])
    outline = np.concatenate([local[:, 0], local[::-1, 1]])
    cv2.fillPoly(cover, [np.rint((outline - 0.5) * 16).astype(np.int32)], 255, cv2.LINE_AA, 4)
    blend(image[top:bottom, left:right], drawn, cover)
    labels[top:bottom, left:right][cover > 127] = label


def blend(canvas: np.ndarray, colour: np.ndarray, alpha: np.ndarray) -> None:
    """Lays a picture with straight alpha over a part of another, in place; all uint8."""
    weight = cv2.merge([alpha] * 3)
    mixed = cv2.multiply(colour, weight, scale=1 / 255)
    rest = cv2.multiply(canvas, cv2.bitwise_not(weight), scale=1 / 255)
    np.copyto(canvas, cv2.add(mixed, rest))


def window_of(points: np.ndarray, shape: tuple[int, ...]) -> tuple[int, int, int, int] | None:
    """left, top, right, bottom of the pixels around points, two more on every side, inside a picture; None outside."""
    low, high = points.min(axis=0), points.max(axis=0)
    low, high = (np.clip(end, 0, shape[1::-1]).astype(int) for end in (np.floor(low) - 2, np.ceil(high) + 2))
    return None if (high <= low).any() else (int(low[0]), int(low[1]), int(high[0]), int(high[1]))


def skin_strip(profile: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Skin that goes on as it ends.

    Args:
        profile: (N, 3) uint8 RGB, the colours across the end of a forearm.
        rng: draws its blotches.
    """
    rows, columns = STRIP
    smooth = cv2.GaussianBlur(profile[None].astype(np.float32), (0, 0), max(len(profile) / 16, 0.3))
    line = cv2.resize(smooth, (columns, 1), interpolation=cv2.INTER_LINEAR)
    blotches = rng.normal(0, 0.03, (12, 5)).astype(np.float32)
    along = np.linspace(0, rng.uniform(-0.25, 0.1), rows, dtype=np.float32)[:, None]
    shade = 1 + cv2.resize(blotches, (columns, rows), interpolation=cv2.INTER_CUBIC) + along
    return np.clip(line * shade[..., None], 0, 255).astype(np.uint8)


def cloth_strip(rng: np.random.Generator) -> np.ndarray:
    """A sleeve of any colour, some with a pattern, lit from a side, with folds and a hem at its beginning."""
    rows, columns = STRIP
    v, u = np.mgrid[0 : 1 : rows * 1j, -1 : 1 : columns * 1j].astype(np.float32)
    colour = _cloth_colour(rng)
    cloth = np.broadcast_to(colour, (rows, columns, 3)).astype(np.float32)
    if rng.random() < PATTERNED:
        count = rng.uniform(6, 40)
        stripes = np.stack([np.sin(np.pi * count * v), np.sin(np.pi * count / 4 * u)])
        kind = rng.integers(4)
        amount = (stripes[0] > 0, stripes[1] > 0, (stripes > 0).mean(axis=0), np.prod(stripes, axis=0) * 0.5 + 0.5)[
            kind
        ]
        cloth = cloth + (_cloth_colour(rng) - cloth) * np.float32(rng.uniform(0.2, 1)) * amount[..., None]
    light, ambient = rng.uniform(-0.8, 0.8), rng.uniform(0.35, 0.8)
    facing = np.clip(np.cos(1.35 * u - light), 0, 1)
    folds = cv2.resize(rng.normal(0, 1, (10, 3)).astype(np.float32), (columns, rows), interpolation=cv2.INTER_CUBIC)
    shade = (ambient + (1 - ambient) * facing) * (1 + rng.uniform(0.03, 0.16) * folds)
    hem = rng.uniform(0.015, 0.05)
    shade = np.where(np.abs(v - hem) < 0.006, shade * rng.uniform(0.6, 1), shade)
    return np.clip(cloth * shade[..., None], 0, 255).astype(np.uint8)


def _cloth_colour(rng: np.random.Generator) -> np.ndarray:
    """(3,) RGB: half of all cloth is black, grey, white or navy, the rest of any colour."""
    value = rng.uniform(15, 245)
    if rng.random() < 0.5:
        return np.clip(value + rng.normal(0, 6, 3) + [0, 0, rng.exponential(8)], 5, 250)
    hsv = np.array([[[rng.integers(180), rng.uniform(40, 230), value]]], np.uint8)
    return cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)[0, 0].astype(np.float64)


def _draw_quad(
    drawn: np.ndarray, near: np.ndarray, far: np.ndarray, strip: np.ndarray, first: float, last: float
) -> None:
    """The part of a strip between two of its cross-sections (2, 2)."""
    corners = np.stack([near[0], near[1], far[1], far[0]])
    window = window_of(corners, drawn.shape)
    if window is None or last - first < 1e-6:
        return
    left, top, right, bottom = window
    columns = strip.shape[1]
    source = np.array([[0, first], [columns, first], [columns, last], [0, last]], np.float32) - 0.5
    target = corners - np.array([left, top], np.float32)
    matrix = cv2.getPerspectiveTransform(source, (target - 0.5).astype(np.float32))
    size = (right - left, bottom - top)
    piece = cv2.warpPerspective(strip, matrix, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    inside = np.zeros((size[1], size[0]), np.uint8)
    quad = np.rint((target - 0.5) * 16).astype(np.int32)
    cv2.fillConvexPoly(inside, quad, 255, cv2.LINE_8, 4)
    cv2.polylines(inside, [quad], True, 255, 3, cv2.LINE_8, 4)
    cv2.copyTo(piece, inside, drawn[top:bottom, left:right])
