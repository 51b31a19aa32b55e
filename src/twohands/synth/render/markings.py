"""Veins, creases, freckles and moles of one person's arms, painted on the chart (`chart.py`); both arms have the same,
mirrored.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np

from twohands.synth.render.chart import chart

TEXEL_M = 0.0004
LOW, HIGH = np.array([-0.096, -0.288]), np.array([0.104, 0.224])
"""Corners of the painted part of the chart, x and y, metres."""
BACK, PALM = 0, 1
"""Sheets of a painting."""
FINGER_HALF_WIDTH_M = np.array([0.0085, 0.0075, 0.0077, 0.0072, 0.0062])
"""Thumb to little finger, at the middle joint."""


def paint_markings(pattern: int) -> np.ndarray:
    """Everything small on the skin of the person with this number.

    Returns:
        (2, H, W, 4) uint8: sheets (back, palm side); rows from `LOW` upwards in y, columns in x; how far a vein stands
        out, how deep a crease is, how dark freckles and moles are, 0 none to 255 the most.
    """
    rng = np.random.default_rng(pattern)
    veins, creases, freckles, moles = ((_Sheet(), _Sheet()) for _ in range(4))
    _paint_veins(*veins, rng)
    _paint_knuckles(creases[BACK], rng)
    _paint_finger_creases(creases[PALM], rng)
    _paint_palm_lines(creases[PALM], rng)
    _paint_spots(freckles, rng, 1400, 0.0006, 0.0016)
    _paint_spots(moles, rng, 7, 0.0010, 0.0022)
    softened = [
        [sheet.softened(sigma) for sheet in pair]
        for pair, sigma in ((veins, 0.0011), (creases, 0.00035), (freckles, 0.0004), (moles, 0.0004))
    ]
    return np.ascontiguousarray(np.moveaxis(np.array(softened), 0, -1))


def on_painting(points: np.ndarray) -> np.ndarray:
    """Places (..., 2) on the chart, metres, as fractions of a painting's width and height."""
    return (points - LOW) / (HIGH - LOW)


class _Sheet:
    """A sheet of the chart that lines are drawn on, where they cross the stronger one wins."""

    def __init__(self) -> None:
        width, height = np.rint((HIGH - LOW) / TEXEL_M).astype(int)
        self.picture = np.zeros((height, width), np.uint8)

    def line(self, points: np.ndarray, width_m: float, strength: np.ndarray | float) -> None:
        """A smooth line through points (N, 2), metres, whose strength (N,) or for all, 0..1, changes on the way."""
        steps = max(2, 3 * len(points))
        where = np.linspace(0, len(points) - 1, steps)
        path = _smooth(points, where)
        strengths = np.interp(where, np.arange(len(points)), np.broadcast_to(strength, len(points)))
        texels = np.rint((path - LOW) / TEXEL_M * 16 - 8).astype(np.int32)
        layer = np.zeros_like(self.picture)
        thickness = max(1, round(width_m / TEXEL_M))
        for (a, b), value in zip(pairwise(texels), strengths[1:], strict=True):
            cv2.line(layer, a.tolist(), b.tolist(), float(255 * value), thickness, cv2.LINE_AA, 4)
        np.maximum(self.picture, layer, out=self.picture)

    def spot(self, centre: np.ndarray, radii_m: np.ndarray, turn: float, strength: float) -> None:
        """An ellipse about a place (2,), metres, with radii (2,) and its first axis turned by `turn` degrees."""
        place, axes = (np.rint(np.array(part) / TEXEL_M * 16).astype(int) for part in (centre - LOW, radii_m))
        cv2.ellipse(self.picture, (place - 8).tolist(), axes.tolist(), turn, 0, 360, 255 * strength, -1, cv2.LINE_AA, 4)

    def softened(self, sigma_m: float) -> np.ndarray:
        """(H, W) uint8 after a Gaussian blur."""
        return np.asarray(cv2.GaussianBlur(self.picture, (0, 0), sigma_m / TEXEL_M))


def _smooth(points: np.ndarray, where: np.ndarray) -> np.ndarray:
    """(M, 2) places of the Catmull-Rom spline through points (N, 2) at the fractional numbers `where` (M,)."""
    padded = np.concatenate([2 * points[:1] - points[1:2], points, 2 * points[-1:] - points[-2:-1]])
    first = np.minimum(where.astype(int), len(points) - 2)
    t = (where - first)[:, None]
    a, b, c, d = (padded[first + i] for i in range(4))
    return 0.5 * (2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - a - 3 * c + d) * t**3)


def _between(a: np.ndarray, b: np.ndarray, share: float) -> np.ndarray:
    return a + (b - a) * share


def _wandering(points: Sequence[np.ndarray | list[float]], rng: np.random.Generator, sideways: float) -> np.ndarray:
    """(2 N - 1, 2) the points and those half-way, all but the ends moved by a normal distance, metres."""
    path = np.array(points)
    out = np.empty((2 * len(path) - 1, 2))
    out[::2], out[1::2] = path, (path[1:] + path[:-1]) / 2
    out[1:-1] += rng.normal(0, sideways, out[1:-1].shape)
    return out


def _paint_veins(back: _Sheet, palm: _Sheet, rng: np.random.Generator) -> None:
    """The network on the back of the hand, which gathers between the knuckles and runs to both edges of the forearm,
    and the straighter, flatter veins on the forearm's palm side."""
    joints = chart().joints
    knuckles = joints[[6, 10, 14, 18]]
    webs = [knuckles[0] + [0.010, 0.004], *((a + b) / 2 + [0, 0.006] for a, b in pairwise(knuckles))]
    arch = [_between(web, np.array([0.004, 0.012]), rng.uniform(0.45, 0.62)) for web in webs]
    for web, foot in zip(webs, arch, strict=True):
        if rng.random() < 0.85:
            strength = np.array([0.15, rng.uniform(0.6, 1.0), 0.9])
            back.line(_wandering([web, foot], rng, 0.0022), rng.uniform(0.0016, 0.0026), strength)
    for a, b in pairwise(arch):
        if rng.random() < 0.7:
            back.line(_wandering([a, b], rng, 0.0018), 0.0018, rng.uniform(0.4, 0.9))
    to_thumb_side = [[0.017, 0.022], [0.022, -0.03], [0.030, -0.12], [0.026, -0.21]]
    to_little_side = [[-0.016, 0.015], [-0.020, -0.05], [-0.030, -0.13], [-0.030, -0.2]]
    between = [[0.002, 0.0], [0.004, -0.05], [0.018, -0.1]]
    for start, way, strongest in (
        (arch[0], to_thumb_side, 1.0),
        (arch[-1], to_little_side, 0.85),
        (arch[1], between, 0.6),
    ):
        path = [start, *way]
        strength = np.interp(np.arange(2 * len(path) - 1), [0, 2, 2 * len(path) - 2], [0.9, 0.7, 0.1])
        back.line(_wandering(path, rng, 0.003), rng.uniform(0.002, 0.003), strength * strongest * rng.uniform(0.5, 1.0))
    for x, far in ((0.012, 0.020), (-0.004, 0.002), (-0.016, -0.020)):
        path = [[x, -0.005], [x * 1.1, -0.07], [far, -0.15], [far * 1.1, -0.23]]
        strength = rng.uniform(0.2, 0.7) * np.array([0.6, 1, 1, 0.8, 0.7, 0.6, 0.4])
        palm.line(_wandering(path, rng, 0.003), 0.0022, strength)


def _paint_spots(
    sheets: tuple[_Sheet, _Sheet], rng: np.random.Generator, count: int, smallest_m: float, largest_m: float
) -> None:
    """Round spots in loose groups, all over the back and on the forearm's palm side."""
    groups = rng.uniform(LOW, HIGH, (40, 2))
    centres = groups[rng.integers(len(groups), size=count)] + rng.normal(0, 0.02, (count, 2))
    for centre in centres:
        sheet = int(rng.integers(2))
        radius = smallest_m * (largest_m / smallest_m) ** rng.beta(1, 2)
        if sheet == BACK or centre[1] < -0.02:
            radii = radius * np.array([1.0, rng.uniform(0.6, 1.0)])
            sheets[sheet].spot(centre, radii, rng.uniform(0, 180), rng.uniform(0.3, 1.0))


def _paint_knuckles(sheet: _Sheet, rng: np.random.Generator) -> None:
    """Wrinkles across the backs of the finger joints: several at the middle ones, few at the last ones, faint at the
    knuckles."""
    joints = chart().joints
    for finger in range(5):
        base = 2 + 4 * finger
        places = [(base, 3, 0.22), (base + 1, 5, 1.0), (base + 2, 3, 0.6)]
        if finger == 0:
            places = [(base + 1, 2, 0.35), (base + 2, 4, 0.8)]
        for joint, lines, strength in places:
            along, across, half = _finger_axes(finger, joint)
            for offset in np.linspace(-1, 1, lines) * 0.0010 * lines:
                # Arcs of an oval: the farther from the joint, the more curved and the shorter.
                reach = half * (0.95 - 0.3 * abs(offset) / 0.005) * rng.uniform(0.7, 1.0)
                ends = np.linspace(-1, 1, 5)[:, None]
                path = joints[joint] + along * offset * (1 - 0.35 * ends**2) + across * ends * reach
                path = path + rng.normal(0, 0.0002, path.shape)
                depth = strength * rng.uniform(0.45, 1.0) * np.array([0.2, 0.9, 1.0, 0.9, 0.2])
                sheet.line(path, rng.uniform(0.0005, 0.0009), depth)


def _paint_finger_creases(sheet: _Sheet, rng: np.random.Generator) -> None:
    """Creases where fingers bend: one at the last joint, two at the middle one and at the base."""
    joints = chart().joints
    for finger in range(5):
        base = 2 + 4 * finger
        if finger == 0:
            places = [
                (joints[base + 1], base + 1, [-0.001, 0.004], 0.5),
                (joints[base + 2], base + 2, [-0.001, 0.0015], 0.8),
            ]
        else:
            web = _between(joints[base], joints[base + 1], 0.36)
            places = [
                (web, base, [-0.0012, 0.0012], 0.85),
                (joints[base + 1], base + 1, [-0.0012, 0.0012], 1.0),
                (joints[base + 2], base + 2, [-0.0008], 0.9),
            ]
        for centre, joint, offsets, strength in places:
            along, across, half = _finger_axes(finger, joint)
            for offset in offsets:
                ends = np.linspace(-1, 1, 4)[:, None]
                path = centre + along * (offset + rng.normal(0, 0.0004)) + across * ends * half * 1.05
                path = path + along * (0.0012 * (1 - ends**2) * rng.normal(0, 0.6)) + rng.normal(0, 0.00025, path.shape)
                depth = strength * rng.uniform(0.65, 1.0) * np.array([0.7, 1.0, 1.0, 0.7])
                sheet.line(path, rng.uniform(0.0006, 0.0010), depth)


def _finger_axes(finger: int, joint: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Unit vectors along and across a finger at one of the 22 joints, and half its width there, metres."""
    joints = chart().joints
    tip = 5 + 4 * finger
    along = joints[min(joint + 1, tip)] - joints[joint - 1 if joint > 2 + 4 * finger else joint]
    along = along / np.linalg.norm(along)
    taper = 1.0 - 0.1 * (joint - 3 - 4 * finger)
    return along, np.array([along[1], -along[0]]), float(FINGER_HALF_WIDTH_M[finger] * taper)


def _paint_palm_lines(sheet: _Sheet, rng: np.random.Generator) -> None:
    """Two lines across the palm, the one around the ball of the thumb, the wrist's bracelets, and short faint ones."""
    joints = chart().joints
    wrist, (index, middle, _, little) = joints[1], joints[[6, 10, 14, 18]]
    unit = np.linalg.norm(middle - wrist)

    def place(x: float, y: float) -> np.ndarray:
        return np.array([x, y]) * unit + rng.normal(0, 0.0018, 2)

    edge = np.array([index[0] - 0.002, 0.76 * unit]) + rng.normal(0, 0.001, 2)
    thenar = [edge, place(0.17, 0.66), place(0.05, 0.46), place(0.03, 0.26), place(0.06, 0.08)]
    proximal = [edge + rng.normal(0, [0.0005, 0.0022]), place(0.12, 0.71), place(-0.09, 0.60), place(-0.29, 0.44)]
    distal = [little - np.array([0.006, 0.018]), place(-0.20, 0.77), place(-0.01, 0.81), place(0.14, 0.95)]
    for path, fade in ((thenar, 0.45), (proximal, 0.25), (distal, 0.3)):
        strength = np.linspace(1.0, fade, len(path)) * rng.uniform(0.8, 1.0)
        sheet.line(np.array(path), rng.uniform(0.0008, 0.0013), strength)
    for offset in (-0.004, 0.003)[: int(rng.integers(1, 3))]:
        x = np.linspace(-1, 1, 5)
        path = wrist + np.stack([0.026 * x, offset - 0.0025 * (1 - x**2)], axis=1) + rng.normal(0, 0.0005, (5, 2))
        sheet.line(path, 0.0006, rng.uniform(0.25, 0.6))
    for _ in range(int(rng.integers(8, 16))):
        start = place(rng.uniform(-0.28, 0.25), rng.uniform(0.15, 0.85))
        turn, length = rng.normal(np.pi / 2, 0.6), rng.uniform(0.006, 0.022)
        end = start + length * np.array([np.cos(turn), np.sin(turn)])
        sheet.line(_wandering([start, end], rng, 0.0008), 0.0004, rng.uniform(0.1, 0.4))
