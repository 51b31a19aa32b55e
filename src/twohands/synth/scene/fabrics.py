"""A user's own fabrics: tileable pictures that sleeves and gloves are made of."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from twohands.synth.backgrounds.pictures import PictureFolder, read_picture

LARGEST_TILE = 512
"""Pixels of a tile's longer side: finer than any picture of a sleeve."""
PERIOD_M = (0.05, 0.25)
"""Range of a tile's width on the body, even in the logarithm."""
RECOLOURED = 0.5
"""Share of fabrics that get another colour than their picture's."""
MOST_CHANGED = 3.0
"""Largest factor on a fabric's red, green and blue."""


@dataclass(frozen=True, slots=True, eq=False)
class Tile:
    """A picture that continues itself on all sides.

    Attributes:
        picture: (H, W, 3) uint8 RGB.
        mean: (3,) linear RGB, never quite black.
    """

    picture: np.ndarray
    mean: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Fabric:
    """What one person's sleeves and gloves are made of.

    Attributes:
        tile: its picture.
        albedo: (3,) mean linear RGB, the tile's own or another.
        period_m: width of the tile on the body.
        turn: of the tile, radians.
    """

    tile: Tile
    albedo: np.ndarray
    period_m: float
    turn: float


class FabricFolder(PictureFolder[Tile]):
    """Tileable pictures of a folder and its subfolders.

    Args:
        folder: see `PictureFolder`.
        keep: how many tiles to keep in memory, at most 0.8 MB each.

    Raises:
        InputError: see `PictureFolder`.
    """

    def __init__(self, folder: Path, keep: int = 64) -> None:
        super().__init__(folder, "fabric", _read_tile, keep)

    def sample(self, rng: np.random.Generator, colour: np.ndarray) -> Fabric:
        """A random fabric, in its own colours or about the given one (3,), linear RGB.

        Raises:
            InputError: no picture can be read any more.
        """
        _, tile = self.pick(rng)
        near = np.clip(colour, tile.mean / MOST_CHANGED, tile.mean * MOST_CHANGED)
        albedo = near if rng.random() < RECOLOURED else tile.mean
        return Fabric(tile, albedo, float(np.exp(rng.uniform(*np.log(PERIOD_M)))), rng.uniform(0, 2 * np.pi))


def linear(picture: np.ndarray) -> np.ndarray:
    """Linear values of sRGB ones, 0..1 for 0..255, near enough for cloth: squares, as the shader has them."""
    return (picture / 255.0) ** 2


def _read_tile(path: Path) -> Tile | None:
    picture = read_picture(path)
    if picture is None:
        return None
    scale = LARGEST_TILE / max(picture.shape[:2])
    if scale < 1:
        picture = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return Tile(np.ascontiguousarray(picture), np.maximum(linear(picture).mean((0, 1)), 0.003))
