"""Pictures made of nothing: gradients, smooth noise, shapes and grain, where there are no photographs."""

from __future__ import annotations

from statistics import NormalDist

import cv2
import numpy as np

from twohands.synth.backgrounds.base import Background
from twohands.types import PinholeCamera


class ProceduralBackgrounds:
    """Gradients, smooth noise, and random shapes with edges, stripes and grain: nothing to download, never the same."""

    name = "procedural"
    unreadable = ()

    def sample(self, rng: np.random.Generator, camera: PinholeCamera) -> Background:
        """A random background for a camera."""
        return Background(procedural_picture(rng, camera.width, camera.height))


def procedural_picture(rng: np.random.Generator, width: int, height: int) -> np.ndarray:
    """A random (height, width, 3) uint8 RGB background."""
    canvas = _wash(rng, width, height)
    _draw_shapes(canvas, rng, int(rng.integers(4, 26)))
    texture = _smooth_noise(rng, width, height, cells=int(rng.integers(20, 80)), strength=rng.uniform(0, 30))
    canvas = _plus(canvas, cv2.resize(_offset(texture), (width, height), interpolation=cv2.INTER_CUBIC))
    # Most rooms are rather grey; a few are garish.
    colour = rng.beta(1.2, 2.2)
    canvas = cv2.transform(canvas, np.full((3, 3), (1 - colour) / 3) + colour * np.eye(3))
    canvas = _plus(canvas, _grain(rng, width, height, sigma=rng.uniform(0, 6)))
    if rng.random() < 0.5:
        canvas = _blurred(canvas, rng.uniform(0.5, 3.0) * width / 480)
    return np.asarray(canvas)


def _wash(rng: np.random.Generator, width: int, height: int) -> np.ndarray:
    """(height, width, 3) uint8: a gradient between four colours, and clouds a few of which fill the picture."""
    corners = rng.uniform(10, 245, (1, 1, 3)) + rng.normal(0, 45, (2, 2, 3))
    clouds = _smooth_noise(rng, width, height, cells=int(rng.integers(2, 6)), strength=rng.uniform(20, 90))
    small = (max(width // 8, 2), max(height // 8, 2))  # nothing here is finer than a tenth of the picture
    wash = cv2.resize(corners.astype(np.float32), small, interpolation=cv2.INTER_LINEAR)
    wash += cv2.resize(clouds, small, interpolation=cv2.INTER_CUBIC)
    wash = np.clip(wash, 0, 255).astype(np.uint8)
    return np.asarray(cv2.resize(wash, (width, height), interpolation=cv2.INTER_CUBIC))


def _smooth_noise(rng: np.random.Generator, width: int, height: int, cells: int, strength: float) -> np.ndarray:
    """(rows, cells, 3) float32 noise about 0, one value for every square cell of the picture; its colours are
    related."""
    grid = rng.normal(0, 0.5, (max(cells * height // width, 2), cells, 3)).astype(np.float32)
    return (grid.mean(-1, keepdims=True) * 0.8 + grid * 0.35) * np.float32(strength)


_NORMAL_QUANTILES = np.array([NormalDist().inv_cdf((i + 0.5) / 256) for i in range(256)])


def _grain(rng: np.random.Generator, width: int, height: int, sigma: float) -> np.ndarray:
    """(height, width, 3) normal noise as `_offset`: random bytes look its values up in a table of quantiles."""
    count = height * width * 3
    places = rng.integers(2**64, size=-(-count // 8), dtype=np.uint64).view(np.uint8)[:count]
    return np.asarray(cv2.LUT(places.reshape(height, width, 3), _offset(_NORMAL_QUANTILES * sigma)))


def _offset(difference: np.ndarray) -> np.ndarray:
    """Differences of grey levels as uint8, 128 for none."""
    return np.clip(np.rint(difference + 128), 0, 255).astype(np.uint8)


def _plus(picture: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """The uint8 picture with an `_offset` of the same shape, cut to 0..255."""
    return np.asarray(cv2.addWeighted(picture, 1.0, offset, 1.0, -128.0))


def _blurred(picture: np.ndarray, sigma: float) -> np.ndarray:
    """The picture after a Gaussian blur; a wide one is done on a smaller picture, whose reduction and enlargement blur
    by a quarter of the factor squared themselves."""
    height, width = picture.shape[:2]
    factor = max(int(sigma), 1)
    if factor == 1:
        return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma))
    small = cv2.resize(picture, (-(-width // factor), -(-height // factor)), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), np.sqrt(sigma**2 - factor**2 / 4) / factor)
    return np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR))


SKIN_RGB = np.array([200.0, 150.0, 120.0])
"""A colour of skin."""


def skin_like(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 3) RGB colours about those of skin, light to dark, up to 260 or so."""
    return SKIN_RGB * rng.uniform(0.25, 1.2, (count, 1)) + rng.normal(0, 12, (count, 3))


def _draw_shapes(canvas: np.ndarray, rng: np.random.Generator, count: int) -> None:
    """Polygons, ellipses and bars; some in skin colours, so that colour alone does not give a hand away."""
    height, width = canvas.shape[:2]
    skin = skin_like(rng, count)
    colours = np.where(rng.random((count, 1)) < 0.3, skin, rng.uniform(0, 255, (count, 3)))
    centres = rng.uniform(-0.1, 1.1, (count, 2)) * [width, height]
    sizes = np.exp(rng.uniform(np.log(0.02), np.log(0.5), count)) * width
    angles, slimness = rng.uniform(0, 180, count), rng.random(count)
    corners = rng.normal(0, 0.5, (count, 6, 2)) * sizes[:, None, None] + centres[:, None]
    n_corners, kinds = rng.integers(3, 7, count), rng.integers(4, size=count)
    ends = centres + 1.5 * sizes[:, None] * np.stack([np.cos(np.radians(angles)), np.sin(np.radians(angles))], axis=1)
    for i in range(count):
        colour, centre, size, slim = (
            tuple(colours[i].tolist()),
            centres[i].tolist(),
            float(sizes[i]),
            float(slimness[i]),
        )
        start = (int(centre[0]), int(centre[1]))
        if kinds[i] == 0:
            axes = (int(size / 2) + 1, int(size * (0.1 + 0.4 * slim)) + 1)
            cv2.ellipse(canvas, start, axes, float(angles[i]), 0, 360, colour, -1, cv2.LINE_AA)
        elif kinds[i] == 1:
            cv2.fillPoly(canvas, [corners[i, : n_corners[i]].astype(np.int32)], colour, cv2.LINE_AA)
        elif kinds[i] == 2:
            box = cv2.boxPoints((centre, (size, size * (0.05 + 0.95 * slim)), float(angles[i])))
            cv2.fillPoly(canvas, [np.asarray(box).astype(np.int32)], colour, cv2.LINE_AA)
        else:
            thick = int(max(1, width * (0.002 + 0.058 * slim)))
            cv2.line(canvas, start, (int(ends[i, 0]), int(ends[i, 1])), colour, thick, cv2.LINE_AA)
