"""The result drawn over the picture: tinted masks, skeletons, one label per hand."""

from __future__ import annotations

import cv2
import numpy as np

from twohands.skeleton import BONES, FINGERTIPS, ROOT, WRIST
from twohands.types import HandPose, TwoHandPose
from twohands.visualization.palette import HAND_COLOURS, HAND_INITIALS, joint_colour

_SHIFT = 4
"""Fractional bits of OpenCV's drawing coordinates."""
_REFERENCE_DIAGONAL = 1100.0
"""Diagonal, in pixels, of a picture on which sizes below hold as they stand."""
_DRAWING_DIAGONAL = 2200.0
"""Smaller pictures are enlarged to about this before drawing, so that lines may be thinner than a pixel."""
_ROWS = 256
"""Of a picture that are tinted at a time."""
_TINT = 0.22
_OUTLINE = 0.6
_INK = (24, 24, 28)

Rectangle = tuple[int, int, int, int]
"""left, top, right, bottom in pixels."""


def draw_overlay(image: np.ndarray, pose: TwoHandPose) -> np.ndarray:
    """Draw both hands over their picture.

    Bones are drawn from far to near, in the colours of `palette`; sizes follow the picture's. A hand whose range could
    not be solved is labelled so.

    Args:
        image: (H, W, 3) uint8 RGB; left unchanged.
        pose: what was estimated in it.

    Returns:
        (H, W, 3) uint8 RGB.
    """
    height, width = image.shape[:2]
    diagonal = float(np.hypot(height, width))
    tinted = image if pose.masks is None else _tinted(image, pose.masks, max(0.6, diagonal / _REFERENCE_DIAGONAL))
    # Enlarging by whole pixels and averaging back leaves every pixel that is not drawn on as it was.
    zoom = int(np.clip(np.ceil(_DRAWING_DIAGONAL / diagonal), 1, 8))
    canvas = tinted.repeat(zoom, axis=0).repeat(zoom, axis=1)
    scale = max(0.62, diagonal / _REFERENCE_DIAGONAL) * zoom
    hands = [(side, hand) for side, hand in enumerate(pose.hands) if hand.present and hand.joints_px is not None]
    for side, hand in sorted(hands, key=lambda item: -(item[1].range_m or 0.0)):
        _draw_skeleton(canvas, zoom * np.asarray(hand.joints_px), hand.canonical, side, scale)
    joints = [zoom * np.asarray(hand.joints_px) for _, hand in hands]
    plates: list[Rectangle] = []
    for (side, hand), own in zip(hands, joints, strict=True):
        plates.append(_draw_label(canvas, hand, side, scale, own, np.concatenate(joints), plates))
    return cv2.resize(canvas, (width, height), interpolation=cv2.INTER_AREA)


def _tinted(image: np.ndarray, masks: np.ndarray, sigma: float) -> np.ndarray:
    """The picture with each mask's area tinted and its outline drawn, both with soft borders.

    Some rows at a time, with as many beside them as the softness reaches: in floating point the whole of a telephone's
    picture would take gigabytes. Rows that no mask reaches stay as they are.
    """
    result = image.copy()
    reach = int(np.ceil(4 * sigma)) + 2
    for start in range(0, len(image), _ROWS):
        end = min(start + _ROWS, len(image))
        top = max(0, start - reach)
        around = masks[top : end + reach]
        if around.any():
            result[start:end] = _tinted_rows(image[start:end], around, start - top, sigma)
    return result


def _tinted_rows(rows: np.ndarray, around: np.ndarray, above: int, sigma: float) -> np.ndarray:
    """Rows of the picture, tinted; `around` are the rows of the masks that reach them, `above` of these before them."""
    result = rows.astype(np.float32)
    for side, colour in enumerate(HAND_COLOURS):
        mask = (around == side + 1).astype(np.float32)
        soft = cv2.GaussianBlur(mask, (0, 0), sigma)[above : above + len(rows)]
        outline = _OUTLINE * np.clip(4.0 * soft * (1.0 - soft), 0.0, 1.0)
        weight = np.maximum(_TINT * soft, outline)[..., None]
        result = (1.0 - weight) * result + weight * np.array(colour, np.float32)
    return np.clip(np.rint(result), 0, 255).astype(np.uint8)


def _draw_skeleton(
    canvas: np.ndarray, points: np.ndarray, canonical: np.ndarray | None, side: int, scale: float
) -> None:
    """Bones and joints of one hand, far ones first, each with a dark rim that keeps it apart from any background."""
    depth = np.zeros(len(points)) if canonical is None else np.nan_to_num(canonical[:, 2])
    line, rim = 2.3 * scale, 1.0 * scale
    for start, end in sorted(BONES, key=lambda bone: -(depth[bone[0]] + depth[bone[1]])):
        if not np.isfinite(points[[start, end]]).all():
            continue
        _line(canvas, points[start], points[end], _INK, line + 2 * rim)
        _line(canvas, points[start], points[end], joint_colour(side, end), line)
        for joint in (start, end):
            radius = scale * (3.6 if joint in (WRIST, ROOT) else 2.9 if joint in FINGERTIPS else 2.4)
            _disc(canvas, points[joint], _INK, radius + rim)
            _disc(canvas, points[joint], joint_colour(side, joint), radius)
            if joint == ROOT:
                _disc(canvas, points[joint], (255, 255, 255), 0.5 * radius)


def _draw_label(
    canvas: np.ndarray,
    hand: HandPose,
    side: int,
    scale: float,
    own: np.ndarray,
    joints: np.ndarray,
    plates: list[Rectangle],
) -> Rectangle:
    """A plate such as "L 34.1 cm" beside the hand; returns its rectangle."""
    distance = "range ?" if hand.range_m is None else f"{100 * hand.range_m:.1f} cm"
    text = f"{HAND_INITIALS[side]} {distance}"
    font, size, weight = cv2.FONT_HERSHEY_DUPLEX, 0.58 * scale, max(1, round(0.7 * scale))
    (text_width, text_height), _ = cv2.getTextSize(text, font, size, weight)
    pad, bar = round(0.6 * text_height), round(3.5 * scale)
    size_px = (text_width + 2 * pad + bar, text_height + 2 * pad)
    left, top, right, bottom = _place(size_px, canvas.shape, own, joints, plates)
    plate = canvas[max(top, 0) : bottom, max(left, 0) : right]
    plate[:] = np.rint(0.25 * plate + 0.75 * np.array(_INK)).astype(np.uint8)
    cv2.rectangle(canvas, (left, top), (left + bar - 1, bottom - 1), HAND_COLOURS[side], -1)
    origin = (left + bar + pad, top + pad + text_height)
    cv2.putText(canvas, text, origin, font, size, (255, 255, 255), weight, cv2.LINE_AA)
    return left, top, right, bottom


def _place(
    size: tuple[int, int], shape: tuple[int, ...], own: np.ndarray, joints: np.ndarray, plates: list[Rectangle]
) -> Rectangle:
    """Where a plate of this (width, height) hides the fewest joints and is nearer to its own hand than to the other."""
    width, height = size
    u0, v0 = np.nanmin(own, axis=0)
    u1, v1 = np.nanmax(own, axis=0)
    gap = 0.7 * height
    columns = ((u0 + u1 - width) / 2, u0 - width / 2, u1 - width / 2, u0 - gap - width, u1 + gap)
    rows = (v0 - gap - height, v1 + gap, (v0 + v1 - height) / 2)
    places = [(u, v) for v in rows for u in columns]
    best: tuple[float, Rectangle] | None = None
    for u, v in places:
        left = round(float(np.clip(u, 0, max(0, shape[1] - width))))
        top = round(float(np.clip(v, 0, max(0, shape[0] - height))))
        plate = (left, top, left + width, top + height)
        margin = 0.3 * height
        hidden = (
            (joints[:, 0] > left - margin)
            & (joints[:, 0] < left + width + margin)
            & (joints[:, 1] > top - margin)
            & (joints[:, 1] < top + height + margin)
        )
        nearest = joints[np.nanargmin(np.hypot(*(joints - (left + width / 2, top + height / 2)).T))]
        foreign = not (own == nearest).all(axis=1).any()
        cost = float(hidden.sum()) + 4.0 * foreign + 100.0 * sum(_overlap(plate, other) for other in plates)
        if best is None or cost < best[0]:
            best = cost, plate
    assert best is not None
    return best[1]


def _overlap(a: Rectangle, b: Rectangle) -> bool:
    """Whether two rectangles share a pixel."""
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _line(canvas: np.ndarray, a: np.ndarray, b: np.ndarray, colour: tuple[int, int, int], width: float) -> None:
    cv2.line(canvas, _fixed(a), _fixed(b), colour, max(1, round(width)), cv2.LINE_AA, _SHIFT)


def _disc(canvas: np.ndarray, centre: np.ndarray, colour: tuple[int, int, int], radius: float) -> None:
    cv2.circle(canvas, _fixed(centre), round(radius * (1 << _SHIFT)), colour, -1, cv2.LINE_AA, _SHIFT)


def _fixed(point: np.ndarray) -> tuple[int, int]:
    """A point in OpenCV's fixed-point coordinates, whose origin is the first pixel's centre; ours is its corner."""
    u, v = np.clip(np.rint((point - 0.5) * (1 << _SHIFT)), -(2**24), 2**24)
    return int(u), int(v)
