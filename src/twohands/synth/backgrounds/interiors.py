"""Rooms that people are seen in, drawn: plain and papered walls, windows, curtains, doors, shelves, pictures, screens.

Photographs of a folder show all the world; most pictures of people with their hands up show a wall a metre or two
behind them. Ours; the paper knows no people.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import cv2
import numpy as np

MARGIN: Final = 1.5
"""Size of the wall over that of the picture, which is then seen askew."""
ASKEW: Final = (0.1, 0.04)
"""By how much one side of the picture sees more of the wall than the other, at most: left and right, top and bottom;
shares of the wall's size."""


def interior(rng: np.random.Generator, width: int, height: int, photograph: np.ndarray) -> np.ndarray:
    """A random room.

    Args:
        rng: the only source of randomness.
        width, height: of the picture.
        photograph: (H, W, 3) uint8 RGB, parts of which hang on the wall and are seen through windows.

    Returns:
        (height, width, 3) uint8 RGB.
    """
    wide, high = round(MARGIN * width), round(MARGIN * height)
    room = _Room(rng, wide, high, photograph)
    for _ in range(int(rng.integers(0, 8))):
        room.furnish()
    shade = cv2.resize(room.shade, (wide, high), interpolation=cv2.INTER_LINEAR)[..., None]
    lit = room.canvas * (1 - 0.45 * shade) * _light(rng, wide, high)
    sides, ends = rng.uniform(-1, 1, 2) * ASKEW
    askew = np.array([[ends, sides], [-ends, -sides], [ends, sides], [-ends, -sides]])
    corners = np.array([[0.2, 0.2], [0.8, 0.2], [0.8, 0.8], [0.2, 0.8]]) + askew + rng.normal(0, 0.006, (4, 2))
    target = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    view = cv2.getPerspectiveTransform((corners * [wide, high]).astype(np.float32), target)
    seen = cv2.warpPerspective(
        np.clip(lit, 0, 255).astype(np.uint8),
        view,
        (width, height),
        flags=cv2.INTER_AREA,
        borderMode=cv2.BORDER_REFLECT,
    )
    return np.asarray(cv2.GaussianBlur(seen, (0, 0), 0.0012 * width + 0.3))


def _light(rng: np.random.Generator, width: int, height: int) -> np.ndarray:
    """(height, width, 3) factors: light falls off unevenly and has a tint."""
    coarse = np.exp(rng.normal(0, 0.16, (3, 4, 1)) + rng.normal(0, 0.02, (3, 4, 3)))
    coarse = coarse * np.exp(rng.normal(-0.15, 0.25) + rng.normal(0, 0.06) * np.array([1.0, 0.1, -1.0]))
    return cv2.resize(coarse.astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC)


def paint(rng: np.random.Generator) -> np.ndarray:
    """(3,) colour of a wall, 0..255: mostly white, grey or beige, now and then strong."""
    level = rng.uniform(120, 240) if rng.random() < 0.8 else rng.uniform(30, 120)
    warm = np.array([1.0, 0.97, 0.9]) if rng.random() < 0.5 else np.ones(3)
    strength = 0.25 if rng.random() < 0.2 else 0.03
    return np.clip(level * warm * np.exp(rng.normal(0, strength, 3)), 8, 250)


def wood(rng: np.random.Generator, width: int, height: int, upright: bool) -> np.ndarray:
    """(height, width, 3) boards with a grain."""
    base = np.array([150.0, 105, 65]) * rng.uniform(0.35, 1.5) * np.exp(rng.normal(0, 0.06, 3))
    lines = rng.normal(0, 1, (2, max(width // 3, 2)) if upright else (max(height // 3, 2), 2)).astype(np.float32)
    return np.clip(base * np.exp(0.1 * cv2.resize(lines, (width, height)))[..., None], 0, 255)


class _Room:
    """A wall with what stands before it, seen straight on."""

    def __init__(self, rng: np.random.Generator, width: int, height: int, photograph: np.ndarray) -> None:
        self.rng, self.width, self.height, self.photograph = rng, width, height, photograph
        self.canvas = np.empty((height, width, 3), np.float32)
        self.shade = np.zeros((height // 4, width // 4), np.float32)
        self.canvas[:] = paint(rng)
        if rng.random() < 0.3:
            self._paper()
        if rng.random() < 0.4:  # a second wall round the corner
            self.canvas[:, int(rng.uniform(0.15, 0.85) * width) :] *= rng.uniform(0.7, 1.1)
        if rng.random() < 0.35:
            edge = int(rng.uniform(0.15, 0.35) * height)
            self.canvas[:edge] = paint(rng) if rng.random() < 0.3 else rng.uniform(170, 245)
            self.canvas[edge - 2 : edge + 2] *= rng.uniform(0.7, 1.1)
        if rng.random() < 0.25:
            edge = int(rng.uniform(0.68, 0.85) * height)
            floor = wood(rng, width, height - edge, False) if rng.random() < 0.6 else paint(rng) * 0.6
            self.canvas[edge:] = floor
        self.kinds = [self._frame, self._window, self._door, self._cupboard, self._shelf, self._screen, self._curtain]
        self.kinds += [self._lamp, self._switch, self._seat, self._plant, self._photograph]

    def furnish(self) -> None:
        """Puts one more thing into the room."""
        self.kinds[int(self.rng.integers(len(self.kinds)))]()

    def _paper(self) -> None:
        side = int(self.rng.integers(6, 40))
        tile = cv2.GaussianBlur(self.rng.normal(0, 1, (side, side, 1)).astype(np.float32), (0, 0), side / 8)
        tile = tile / (np.abs(tile).max() + 1e-6) * self.rng.uniform(0.03, 0.2)
        if self.rng.random() < 0.4:
            tile[:] = tile.mean(0, keepdims=True) * 2  # stripes
        reps = self.height // side + 1, self.width // side + 1, 1
        self.canvas *= np.exp(np.tile(tile.reshape(side, side, 1), reps)[: self.height, : self.width])

    def _place(
        self, low: tuple[float, float], high: tuple[float, float], bottom: float | None = None
    ) -> tuple[int, ...]:
        """Left, top, right and bottom of a thing of random size (shares of the wall's height) at a random place."""
        w, h = (self.rng.uniform(low, high) * self.height).astype(int)
        left = int(self.rng.uniform(-0.3 * w, self.width - 0.7 * w))
        top = int(self.rng.uniform(0.1, 0.8) * self.height - h / 2) if bottom is None else int(bottom * self.height - h)
        box = max(left, 0), max(top, 0), min(left + w, self.width), min(top + h, self.height)
        return box if box[2] - box[0] > 6 and box[3] - box[1] > 6 else (0, 0, 8, 8)

    def _fill(self, box: tuple[int, ...], colours: np.ndarray | float) -> None:
        left, top, right, bottom = box
        self.canvas[top:bottom, left:right] = colours

    def _shadow(self, box: tuple[int, ...]) -> None:
        away = int(self.rng.uniform(2, 10))
        mask = np.zeros_like(self.shade)
        left, top, right, bottom = (value // 4 for value in box)
        mask[top + away // 4 : bottom + away // 2, left - (left > 1) : right + away // 3] = self.rng.uniform(0.3, 0.9)
        mask = cv2.GaussianBlur(mask, (0, 0), away / 2)
        mask[top:bottom, left:right] = 0
        self.shade = np.maximum(self.shade, mask)

    def _picture(self, box: tuple[int, ...]) -> np.ndarray:
        """A part of the photograph, of the size of the box."""
        size, full = (box[2] - box[0], box[3] - box[1]), self.photograph.shape
        part = self.rng.uniform(0.2, 1.0)
        w, h = max(int(full[1] * part), 8), max(int(full[0] * part), 8)
        u, v = self.rng.integers(0, full[1] - w + 1), self.rng.integers(0, full[0] - h + 1)
        return cv2.resize(self.photograph[v : v + h, u : u + w], size, interpolation=cv2.INTER_AREA).astype(np.float32)

    def _inset(self, box: tuple[int, ...], by: int) -> tuple[int, ...]:
        left, top, right, bottom = box
        by = min(by, (right - left) // 2 - 1, (bottom - top) // 2 - 1)
        return left + by, top + by, right - by, bottom - by

    def _frame(self) -> None:
        box = self._place((0.1, 0.1), (0.4, 0.35))
        self._shadow(box)
        self._fill(box, paint(self.rng) * self.rng.uniform(0.1, 1.0))
        inner = self._inset(box, int(self.rng.integers(1, 9)))
        self._fill(inner, self._picture(inner))

    def _window(self) -> None:
        box = self._place((0.35, 0.4), (0.9, 0.9))
        self._fill(box, self.rng.uniform(190, 250))
        columns, bar = int(self.rng.integers(1, 4)), int(self.rng.integers(3, 8))
        step = (box[2] - box[0]) / columns
        for k in range(columns):
            pane = int(box[0] + k * step) + bar, box[1] + bar, int(box[0] + (k + 1) * step) - bar, box[3] - bar
            if pane[2] - pane[0] > 4 and pane[3] - pane[1] > 4:
                outside = self._picture(pane) * self.rng.uniform(0.6, 2.2) + self.rng.uniform(0, 120)
                self._fill(pane, outside if self.rng.random() < 0.7 else 255.0)

    def _door(self) -> None:
        box = self._place((0.3, 0.7), (0.45, 0.95), bottom=self.rng.uniform(0.85, 1.2))
        white = self.rng.random() < 0.5
        size = box[2] - box[0], box[3] - box[1]
        self._shadow(box)
        self._fill(box, paint(self.rng) if white else wood(self.rng, *size, True))
        middle = (box[1] + box[3]) // 2
        for top, bottom in ((box[1], middle), (middle, box[3])):
            panel = self._inset((box[0], top, box[2], bottom), size[0] // 6)
            self.canvas[panel[1] : panel[3], panel[0] : panel[2]] *= self.rng.uniform(0.85, 1.08)
            edge = self._inset(panel, 2)
            self.canvas[panel[1] : edge[1], panel[0] : panel[2]] *= 0.75

    def _cupboard(self) -> None:
        box = self._place((0.4, 0.3), (1.2, 0.9), bottom=self.rng.uniform(0.5, 1.15))
        size = box[2] - box[0], box[3] - box[1]
        self._shadow(box)
        self._fill(box, wood(self.rng, *size, True) if self.rng.random() < 0.6 else paint(self.rng))
        for x in np.linspace(box[0], box[2], int(self.rng.integers(2, 6)))[:-1].astype(int):
            self.canvas[box[1] : box[3], x : x + 2] *= 0.5
        for y in np.linspace(box[1], box[3], int(self.rng.integers(2, 4)))[:-1].astype(int):
            self.canvas[y : y + 2, box[0] : box[2]] *= 0.5

    def _shelf(self) -> None:
        box = self._place((0.3, 0.2), (0.9, 0.8))
        size = box[2] - box[0], box[3] - box[1]
        self._shadow(box)
        self._fill(box, wood(self.rng, *size, False) * 0.7)
        rows = np.linspace(box[1], box[3], int(self.rng.integers(2, 5))).astype(int)
        for top, bottom in pairwise(rows):
            x = box[0] + 3
            while x < box[2] - 4:
                thick = int(self.rng.integers(3, 14))
                tall = int((bottom - top) * self.rng.uniform(0.5, 0.9))
                colour = self.rng.uniform(20, 220) + self.rng.uniform(-60, 60, 3) * self.rng.random()
                self.canvas[max(bottom - 4 - tall, top) : bottom - 4, x : min(x + thick, box[2] - 3)] = colour
                x += thick + (1 if self.rng.random() < 0.9 else int(self.rng.integers(5, 40)))

    def _screen(self) -> None:
        box = self._place((0.2, 0.15), (0.6, 0.4))
        self._shadow(box)
        self._fill(box, self.rng.uniform(8, 40))
        inner = self._inset(box, int(self.rng.integers(2, 6)))
        self._fill(inner, self._picture(inner) if self.rng.random() < 0.5 else self.rng.uniform(10, 50))

    def _curtain(self) -> None:
        box = self._place((0.15, 0.8), (0.6, 1.2), bottom=self.rng.uniform(0.9, 1.2))
        x = np.arange(box[2] - box[0])
        wave = np.sin(x / self.rng.uniform(2, 8) + 2 * np.sin(x / self.rng.uniform(10, 30)))
        self._fill(box, (paint(self.rng) * np.exp(0.16 * wave)[:, None])[None])

    def _lamp(self) -> None:
        box = self._place((0.05, 0.04), (0.25, 0.15))
        centre = ((box[0] + box[2]) / 2, (box[1] + box[3]) / 2)
        v, u = np.ogrid[: self.height, : self.width]
        far = ((u - centre[0]) / (box[2] - box[0])) ** 2 + ((v - centre[1]) / (box[3] - box[1])) ** 2
        glow = np.exp(-far / self.rng.uniform(1, 4)).astype(np.float32)[..., None]
        self.canvas += glow * np.array([200.0, 180, 140]) * self.rng.uniform(0.2, 0.8)
        self.canvas[far < 0.25] = 255

    def _switch(self) -> None:
        box = self._place((0.02, 0.02), (0.07, 0.05))
        self._shadow(box)
        self._fill(box, self.rng.uniform(200, 250))

    def _seat(self) -> None:
        box = self._place((0.4, 0.25), (1.2, 0.6), bottom=self.rng.uniform(0.9, 1.2))
        mask = np.zeros((self.height, self.width), np.uint8)
        r = max(min(box[2] - box[0], box[3] - box[1]) // 5, 1)
        cv2.rectangle(mask, (box[0] + r, box[1] + r), (box[2] - r, box[3] - r), 1, 2 * r)
        cv2.rectangle(mask, (box[0] + r, box[1] + r), (box[2] - r, box[3] - r), 1, -1)
        fall = np.linspace(1.15, 0.6, self.height, dtype=np.float32)[:, None, None]
        self.canvas = np.where(mask[..., None] > 0, paint(self.rng).astype(np.float32) * 0.7 * fall, self.canvas)

    def _plant(self) -> None:
        box = self._place((0.2, 0.2), (0.5, 0.5))
        centre = np.array([(box[0] + box[2]) / 2, (box[1] + box[3]) / 2])
        for _ in range(int(self.rng.integers(12, 40))):
            at = centre + self.rng.normal(0, 0.22, 2) * [box[2] - box[0], box[3] - box[1]]
            axes = int(self.rng.uniform(4, 26)), int(self.rng.uniform(2, 7))
            green = np.array([60.0, 110, 45]) * self.rng.uniform(0.3, 1.6)
            cv2.ellipse(
                self.canvas, at.astype(int).tolist(), axes, self.rng.uniform(0, 180), 0, 360, green.tolist(), -1
            )

    def _photograph(self) -> None:
        """Clutter: a part of the photograph as it is."""
        box = self._place((0.2, 0.15), (0.8, 0.5), bottom=self.rng.uniform(0.7, 1.2))
        self._fill(box, self._picture(box))
