"""The result drawn over a frame of a video, fast: skeletons, ranges, and an inset with two views of the hands.

Drawn by OpenCV straight into the picture, without the enlarging, tinting and figures that `overlay` and `views` give to
single pictures: a few milliseconds instead of hundreds.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from twohands.skeleton import BONES, ROOT
from twohands.types import HandPose, TwoHandPose
from twohands.visualization.palette import HAND_COLOURS, HAND_INITIALS, joint_colour

_SHIFT: Final = 4
_INK: Final = (24, 24, 28)
_REFERENCE_DIAGONAL: Final = 1100.0
"""Diagonal, in pixels, of a picture on which sizes below hold as they stand."""
_DEPTHS_M: Final = (0.5, 1.0, 2.0, 4.0, 8.0)
"""How far the inset's views may reach; the first that holds all hands."""
_INSET: Final = 0.24
"""Side of a view of the inset, as a share of the picture's shorter side."""


def draw_live(image: np.ndarray, pose: TwoHandPose, *, inset: bool = True) -> np.ndarray:
    """Draws both hands over a frame.

    Args:
        image: (H, W, 3) uint8 RGB; left unchanged.
        pose: what was estimated in it.
        inset: draw the views from above and from the side.

    Returns:
        (H, W, 3) uint8 RGB.
    """
    canvas = image.copy()
    scale = max(0.5, float(np.hypot(*image.shape[:2])) / _REFERENCE_DIAGONAL)
    shown = [(side, hand) for side, hand in enumerate(pose.hands) if hand.present and hand.joints_px is not None]
    for side, hand in sorted(shown, key=lambda item: -(item[1].range_m or 0.0)):
        _draw_hand(canvas, hand, side, scale)
    if inset and min(image.shape[:2]) >= 120:
        _draw_inset(canvas, pose, scale)
    return canvas


def _draw_hand(canvas: np.ndarray, hand: HandPose, side: int, scale: float) -> None:
    points = np.asarray(hand.joints_px)
    depth = np.zeros(len(points)) if hand.canonical is None else np.nan_to_num(hand.canonical[:, 2])
    width = max(2, round(2.2 * scale))
    places = _fixed(points)
    for start, end in sorted(BONES, key=lambda bone: -(depth[bone[0]] + depth[bone[1]])):
        a, b = places[start], places[end]
        if a is not None and b is not None:
            cv2.line(canvas, a, b, _INK, width + 2, cv2.LINE_AA, _SHIFT)
            cv2.line(canvas, a, b, joint_colour(side, end), width, cv2.LINE_AA, _SHIFT)
    for joint, place in enumerate(places):
        if place is not None:
            radius = round((3.2 if joint == ROOT else 2.2) * scale * (1 << _SHIFT))
            cv2.circle(canvas, place, radius, joint_colour(side, joint), -1, cv2.LINE_AA, _SHIFT)
    distance = "range ?" if hand.range_m is None else f"{100 * hand.range_m:.1f} cm"
    known = points[np.isfinite(points).all(axis=-1)]
    if len(known):
        u, v = known[:, 0].mean(), known[:, 1].max() + 16 * scale
        _write(canvas, f"{HAND_INITIALS[side]} {distance}", u - 40 * scale, v, scale, HAND_COLOURS[side])


def _draw_inset(canvas: np.ndarray, pose: TwoHandPose, scale: float) -> None:
    """From above (x to the right, away upwards) and from the side (away to the right, y downwards), camera at the
    middle of the near edge."""
    height, width = canvas.shape[:2]
    size, gap = round(_INSET * min(height, width)), round(4 * scale)
    placed = [(side, hand.joints_m) for side, hand in enumerate(pose.hands) if hand.joints_m is not None]
    farthest = max((float(joints[:, 2].max()) for _, joints in placed), default=0.0)
    reach = next((depth for depth in _DEPTHS_M if depth >= farthest), _DEPTHS_M[-1])
    top, left = gap, width - size - gap
    views = (("above", top), ("side", top + size + gap))
    for name, row in views:
        view = canvas[row : row + size, left : left + size]
        if view.shape[0] < size:
            return
        view[:] = view // 4
        cv2.rectangle(view, (0, 0), (size - 1, size - 1), (90, 90, 96), 1)
        for side, joints in placed:
            across, away = joints[:, 0 if name == "above" else 1] / reach, joints[:, 2] / reach
            if name == "above":
                points = np.stack([0.5 + across, 1 - away], axis=-1) * size
            else:
                points = np.stack([away, 0.5 + across], axis=-1) * size
            places = _fixed(points)
            for start, end in BONES:
                a, b = places[start], places[end]
                if a is not None and b is not None:
                    cv2.line(view, a, b, joint_colour(side, end), 1, cv2.LINE_AA, _SHIFT)
        _write(view, f"{name} {reach:g} m", 3 * scale, size - 5 * scale, 0.7 * scale, (210, 210, 214))


def _write(canvas: np.ndarray, text: str, u: float, v: float, scale: float, colour: tuple[int, int, int]) -> None:
    font, size, weight = cv2.FONT_HERSHEY_SIMPLEX, max(0.4, 0.55 * scale), max(1, round(scale))
    (width, height), _ = cv2.getTextSize(text, font, size, weight)
    origin = (
        round(min(max(u, 0), max(canvas.shape[1] - width, 0))),
        round(min(max(v, height), canvas.shape[0] - 2)),
    )
    cv2.putText(canvas, text, origin, font, size, _INK, weight + 1, cv2.LINE_AA)
    cv2.putText(canvas, text, origin, font, size, colour, weight, cv2.LINE_AA)


def _fixed(points: np.ndarray) -> list[tuple[int, int] | None]:
    """Points (N, 2) in OpenCV's fixed-point coordinates, whose origin is the first pixel's centre, ours its corner;
    None for one that is not finite."""
    known = np.asarray(np.isfinite(points).all(axis=1)).tolist()
    cells = np.clip(np.rint((np.nan_to_num(points) - 0.5) * (1 << _SHIFT)), -(2**24), 2**24).astype(int).tolist()
    return [(u, v) if finite else None for finite, (u, v) in zip(known, cells, strict=True)]
