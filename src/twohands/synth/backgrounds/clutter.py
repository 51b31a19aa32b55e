"""Things in front of a background that could be taken for hands, and are none.

A few hundred photographs hold little of what misleads a network in other rooms: table legs, wooden slats, lamps, faces.
So training lays rounded, lit things over some backgrounds: sticks that bend and taper as arms do, blobs and boards, in
the colours of skin and wood, white as a hand in full light, or covered with a piece of the photograph itself; and some
of these pictures are toned like skin as a whole, for horses, fruit and furniture are no hands either. Ours; the paper
has photographs alone.
"""

from __future__ import annotations

import cv2
import numpy as np

from twohands.synth.backgrounds.base import ChangedBackgrounds
from twohands.synth.backgrounds.procedural import SKIN_RGB, skin_like
from twohands.types import PinholeCamera

MOST_THINGS = 5
"""At most so many things in a picture."""
SKIN_TONED = 0.35
"""Share of the pictures with things that take on the colours of skin first."""


class ClutteredBackgrounds(ChangedBackgrounds):
    """Lays things over a share of another source's backgrounds."""

    change = "clutter"

    def changed(self, picture: np.ndarray, rng: np.random.Generator, camera: PinholeCamera) -> np.ndarray:
        """See `ChangedBackgrounds.changed`."""
        if rng.random() < SKIN_TONED:
            picture = skin_toned(picture, rng)
        return cluttered(picture, rng)


def skin_toned(picture: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The picture (H, W, 3) uint8 RGB in shades of one skin colour, which leave 0 to 60 % of its own colours."""
    colour = SKIN_RGB + rng.normal(0, 12, 3)
    strength = rng.uniform(0.4, 1)
    shades = np.outer(colour / colour.mean(), [0.299, 0.587, 0.114])  # of the picture's brightness
    return np.asarray(cv2.transform(picture, (1 - strength) * np.eye(3) + strength * shades))


def cluttered(picture: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The picture with 1 to `MOST_THINGS` things in it.

    Args:
        picture: (H, W, 3) uint8 RGB; stays as it is.
        rng: source of randomness.

    Returns:
        (H, W, 3) uint8 RGB.
    """
    result = picture.copy()
    towards_light = rng.normal(0, 1, 3) * [1, 0.6, 0.3] + [0, -0.4, 0.8]
    towards_light /= np.linalg.norm(towards_light)
    for _ in range(rng.integers(1, MOST_THINGS + 1)):
        _lay(result, picture, towards_light, rng)
    return result


def _lay(canvas: np.ndarray, picture: np.ndarray, towards_light: np.ndarray, rng: np.random.Generator) -> None:
    """One thing onto the canvas, lit from a direction (x right, y down, z towards the viewer)."""
    mask = np.zeros(canvas.shape[:2], np.uint8)
    angle = (_stick, _blob, _board)[rng.choice(3, p=[0.6, 0.2, 0.2])](mask, rng)
    left, top, width, height = cv2.boundingRect(mask)
    if width < 4 or height < 4:
        return
    part = np.s_[top : top + height, left : left + width]
    mask = mask[part]
    light = _lighting(mask, towards_light, rng)
    kind = (_skin, _wood, _piece, _white)[rng.choice(4, p=[0.4, 0.2, 0.25, 0.15])]
    colour = kind(picture, height, width, angle, rng)
    alpha = cv2.GaussianBlur(mask, (0, 0), 0.7)[..., None] / np.float32(255)
    thing = np.clip(colour * light[..., None], 0, 255)
    canvas[part] = np.rint(canvas[part] * (1 - alpha) + thing * alpha).astype(np.uint8)


def _stick(mask: np.ndarray, rng: np.random.Generator) -> float:
    """A bent, tapering row of capsules; returns its direction in radians."""
    height, width = mask.shape
    place = rng.uniform(-0.05, 1.05, 2) * [width, height]
    direction = start = rng.uniform(0, 2 * np.pi)
    radius = np.exp(rng.uniform(np.log(0.008), np.log(0.09))) * width
    for _ in range(rng.integers(1, 5)):
        end = place + rng.uniform(1.5, 6) * radius * np.array([np.cos(direction), np.sin(direction)])
        narrower = radius * rng.uniform(0.65, 1.1)
        across = np.array([-np.sin(direction), np.cos(direction)])
        sides = [place + radius * across, end + narrower * across, end - narrower * across, place - radius * across]
        cv2.fillConvexPoly(mask, np.rint(sides).astype(np.int32), 255)
        for centre, size in ((place, radius), (end, narrower)):
            cv2.circle(mask, tuple(np.rint(centre).astype(int).tolist()), max(1, round(size)), 255, -1)
        place, radius = end, narrower
        direction += rng.normal(0, 0.5)
    return start


def _blob(mask: np.ndarray, rng: np.random.Generator) -> float:
    """An ellipse; returns the direction of its long axis in radians."""
    height, width = mask.shape
    centre = (rng.uniform(0, 1, 2) * [width, height]).astype(int)
    size = np.exp(rng.uniform(np.log(0.02), np.log(0.2))) * width
    angle = rng.uniform(0, 180)
    axes = (max(2, int(size)), max(2, int(size * rng.uniform(0.4, 1))))
    cv2.ellipse(mask, tuple(centre.tolist()), axes, angle, 0, 360, 255, -1)
    return float(np.radians(angle))


def _board(mask: np.ndarray, rng: np.random.Generator) -> float:
    """A rectangle; returns the direction of its long side in radians."""
    height, width = mask.shape
    centre = (rng.uniform(0, 1, 2) * [width, height]).tolist()
    size = np.exp(rng.uniform(np.log(0.05), np.log(0.6))) * width
    angle = rng.uniform(0, 180)
    corners = cv2.boxPoints((centre, (size, size * rng.uniform(0.05, 0.5)), angle))
    cv2.fillConvexPoly(mask, np.rint(corners).astype(np.int32), 255)
    return float(np.radians(angle))


def _lighting(mask: np.ndarray, towards_light: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(h, w) float32 brightness of a rounded thing with that outline, about 0.3 to 1.3."""
    depth = cv2.distanceTransform(cv2.copyMakeBorder(mask, 1, 1, 1, 1, cv2.BORDER_REPLICATE), cv2.DIST_L2, 3)
    depth = np.minimum(depth[1:-1, 1:-1], max(mask.shape))  # boundless where the thing fills its rectangle
    round_over = max(1.0, float(depth.max()) * rng.uniform(0.4, 1))
    inner = 1 - np.clip(depth / round_over, 0, 1)
    heights = cv2.GaussianBlur(np.sqrt(1 - inner**2) * round_over, (0, 0), 1.0)
    slope_u, slope_v = (cv2.Sobel(heights, cv2.CV_32F, *axis, scale=0.125) for axis in ((1, 0), (0, 1)))
    facing = towards_light[2] - slope_u * towards_light[0] - slope_v * towards_light[1]
    facing /= np.sqrt(1 + slope_u**2 + slope_v**2)
    ambient = rng.uniform(0.3, 0.7)
    return np.asarray(ambient + (1.2 - ambient) * np.clip(facing, 0, 1), np.float32)


def _skin(picture: np.ndarray, height: int, width: int, angle: float, rng: np.random.Generator) -> np.ndarray:
    """(height, width, 3) float32: a colour like skin, a little blotchy."""
    blotches = rng.normal(0, rng.uniform(0, 10), (max(2, height // 12), max(2, width // 12), 3)).astype(np.float32)
    return skin_like(rng, 1)[0].astype(np.float32) + cv2.resize(blotches, (width, height))


def _white(picture: np.ndarray, height: int, width: int, angle: float, rng: np.random.Generator) -> np.ndarray:
    """(height, width, 3) float32: white of any tint, up to overexposed."""
    return np.full((height, width, 3), rng.uniform(200, 400) + rng.normal(0, 15, 3), np.float32)


def _wood(picture: np.ndarray, height: int, width: int, angle: float, rng: np.random.Generator) -> np.ndarray:
    """(height, width, 3) float32: brown with a grain along the thing."""
    colour = np.array([150.0, 105.0, 68.0]) * rng.uniform(0.4, 1.6) + rng.normal(0, 8, 3)
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    across = rows * np.cos(angle) - columns * np.sin(angle)
    along = rows * np.sin(angle) + columns * np.cos(angle)
    swing = rng.uniform(0, 4) * np.sin(along * rng.uniform(0.01, 0.06) + rng.uniform(0, 6))
    grain = rng.normal(0, 1, 256).astype(np.float32)
    fine = rng.uniform(0.3, 1.2)
    stripes = cv2.remap(
        grain[None], np.mod((across + swing) * fine, 255).astype(np.float32), np.zeros_like(rows), cv2.INTER_LINEAR
    )
    return np.asarray(colour * (1 + rng.uniform(0.03, 0.2) * stripes[..., None]), np.float32)


def _piece(picture: np.ndarray, height: int, width: int, angle: float, rng: np.random.Generator) -> np.ndarray:
    """(height, width, 3) float32: a piece of the picture, enlarged."""
    scale = rng.uniform(0.3, 1)
    rows, columns = max(1, int(height * scale)), max(1, int(width * scale))
    top, left = rng.integers(picture.shape[0] - rows + 1), rng.integers(picture.shape[1] - columns + 1)
    piece = cv2.resize(picture[top : top + rows, left : left + columns], (width, height))
    return np.asarray(piece, np.float32) * np.float32(rng.uniform(0.7, 1.4))
