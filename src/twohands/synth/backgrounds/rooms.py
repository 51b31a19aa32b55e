"""Procedural rooms, seen by a head that moves in them."""

from __future__ import annotations

import cv2
import numpy as np

from twohands.synth.backgrounds.base import Background
from twohands.synth.backgrounds.panoramas import rays, turned
from twohands.synth.backgrounds.photographs import Look
from twohands.synth.backgrounds.procedural import procedural_picture
from twohands.synth.backgrounds.wandering import Head, Wander
from twohands.types import PinholeCamera


class RoomBackgrounds:
    """Single views into procedural rooms, such as are behind sequences: every one another room."""

    name = "rooms"
    unreadable = ()

    def sample(self, rng: np.random.Generator, camera: PinholeCamera) -> Background:
        """A random background for a camera."""
        return Background(Room(rng, 1.0, camera, Look(rng)).frame(0))


class Room:
    """A head that turns and moves in a box-shaped room with six procedural walls: a background with parallax where no
    folder is given."""

    def __init__(self, rng: np.random.Generator, fps: float, camera: PinholeCamera, look: Look) -> None:
        self.rays, self.look = rays(camera), look
        self.head = Head(rng, fps)
        self.half = rng.uniform([1.5, 1.1, 1.5], [3.5, 1.6, 3.5]).astype(np.float32)
        amplitude = rng.uniform(0.1, 0.5, 3) * [1.0, 0.2, 1.0]
        self.place = Wander(rng, amplitude, amplitude * 0.8, fps)
        size = max(int(0.8 * camera.width), 32)
        shade = np.array([0.85, 0.95, 0.6, 1.1, 1.0, 0.9], np.float32) * rng.uniform(0.85, 1.1, 6)  # -x +x -y +y -z +z
        greys = np.arange(256, dtype=np.float32)
        tiles = [cv2.LUT(_wall(rng, size), np.clip(greys * s, 0, 255).astype(np.uint8)) for s in shade]
        # Pixels are repeated around every tile, so that no tile bleeds into the next one.
        self.atlas = np.concatenate(
            [cv2.copyMakeBorder(tile, 2, 2, 2, 2, cv2.BORDER_REPLICATE) for tile in tiles], axis=1
        )

    def frame(self, index: int) -> np.ndarray:
        toward = turned(self.rays, self.head.rotation(index))
        place = self.place.at(index).astype(np.float32)
        # Distance along the ray to the wall it meets on each axis, were there no other.
        reach = [
            np.where(ray < 0, -half - start, half - start) / np.where(ray == 0, np.float32(1e-9), ray)
            for ray, half, start in zip(toward, self.half, place, strict=True)
        ]
        nearest = np.minimum(np.minimum(reach[0], reach[1]), reach[2])
        on_x, on_y = reach[0] == nearest, reach[1] == nearest
        # -1..1 on the wall: it is spanned by z and y, by x and z, or by x and y.
        hit = [(start + ray * nearest) / half for ray, half, start in zip(toward, self.half, place, strict=True)]
        across, down = np.where(on_x, hit[2], hit[0]), np.where(on_y & ~on_x, hit[2], hit[1])
        positive = np.where(on_x, toward[0], np.where(on_y, toward[1], toward[2])) > 0
        tile = 2 * np.where(on_x, 0, np.where(on_y, 1, 2)) + positive
        half_size = np.float32(self.atlas.shape[0] / 2 - 2)
        column = tile.astype(np.float32) * (2 * half_size + 4) + (np.clip(across, -1, 1) + 1) * half_size
        row = (np.clip(down, -1, 1) + 1) * half_size
        shift = np.float32(2 - 0.5)  # the tile's rim, and from outer corners to pixel centres
        view = cv2.remap(self.atlas, column + shift, row + shift, cv2.INTER_LINEAR)
        return self.look.apply(view)

    def surroundings(self, index: int) -> None:
        return None


def _wall(rng: np.random.Generator, size: int) -> np.ndarray:
    """(size, size, 3) uint8: a procedural picture with smaller ones hung on it, for detail at all scales."""
    wall = procedural_picture(rng, size, size).copy()
    for _ in range(int(rng.integers(2, 7))):
        width, height = (int(n) for n in rng.integers(size // 12, size // 3, 2))
        x, y = int(rng.integers(0, size - width)), int(rng.integers(0, size - height))
        wall[y : y + height, x : x + width] = procedural_picture(rng, width, height)
    return wall
