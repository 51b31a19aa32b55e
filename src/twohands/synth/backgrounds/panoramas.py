"""Panoramas of all directions: how to recognise one, a camera's view into it, and the light that comes from it.

A panorama is equirectangular: its top row is straight up, its middle column straight ahead (+z of the world frame, x to
the right and y down), columns go once round to the right.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from twohands.types import PinholeCamera

ASPECT, MIN_WIDTH = 2.0, 1024
"""A picture twice as wide as high (within 1 %) and at least this wide is taken for a panorama."""
LIGHT_SIZE = (128, 64)
"""Columns and rows of the light read from a picture."""
WHITE, HIDDEN = 0.9, 5.0
"""Linear values of a picture above WHITE are clipped lamps and sky, taken for HIDDEN times as bright."""

Rays = tuple[np.ndarray, np.ndarray]
"""(1, W) x and (H, 1) y of the directions through the pixels' centres, z = 1; float32."""


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """Light from all directions, and how a camera stands in it.

    Attributes:
        radiance: (H, 2 H, 3) linear RGB, equirectangular; 1 is white in the picture that the camera takes.
        world_from_camera: (3, 3), a rotation, or one with x mirrored where the picture is.
    """

    radiance: np.ndarray
    world_from_camera: np.ndarray


def is_panorama(width: int, height: int) -> bool:
    """Whether a picture of this size is taken for a panorama."""
    return width >= MIN_WIDTH and abs(width / height - ASPECT) < 0.01 * ASPECT


def rays(camera: PinholeCamera) -> Rays:
    """The directions through a camera's pixels."""
    u = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    v = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    return u.astype(np.float32)[None], v.astype(np.float32)[:, None]


def turned(through: Rays, rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, y, z (H, W) of rays after a rotation (3, 3)."""
    u, v = through
    x, y, z = (row[0] * u + (row[1] * v + row[2]) for row in rotation.astype(np.float32))
    return x, y, z


def view(panorama: np.ndarray, through: Rays, world_from_camera: np.ndarray) -> np.ndarray:
    """What a camera sees.

    Args:
        panorama: (h, w, 3) uint8.
        through: the camera's pixels.
        world_from_camera: (3, 3) rotation.

    Returns:
        (H, W, 3) uint8.
    """
    height, width = (np.float32(n) for n in panorama.shape[:2])
    x, y, z = turned(through, world_from_camera)
    column = (np.arctan2(x, z) / np.float32(2 * np.pi) + np.float32(0.5)) * width - np.float32(0.5)
    row = (np.arctan2(y, np.sqrt(x * x + z * z)) / np.float32(np.pi) + np.float32(0.5)) * height - np.float32(0.5)
    return np.asarray(cv2.remap(panorama, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP))


def directions(height: int) -> tuple[np.ndarray, np.ndarray]:
    """(H, 2 H, 3) unit vectors to the middles of a panorama's cells, world frame, and (H, 2 H) their solid angles."""
    down = ((np.arange(height) + 0.5) / height - 0.5) * np.pi
    right = ((np.arange(2 * height) + 0.5) / height - 1.0) * np.pi
    down, right = np.meshgrid(down, right, indexing="ij")
    vectors = np.stack([np.cos(down) * np.sin(right), np.sin(down), np.cos(down) * np.cos(right)], axis=-1)
    edges = np.sin((np.arange(height + 1) / height - 0.5) * np.pi)
    return vectors, np.repeat((np.diff(edges) * np.pi / height)[:, None], 2 * height, axis=1)


def turn(yaw: float, pitch: float, roll: float) -> np.ndarray:
    """(3, 3) rotation from the frame of a camera that is turned right, up, and clockwise, radians, to the world."""
    turns = ([0.0, yaw, 0.0], [pitch, 0.0, 0.0], [0.0, 0.0, roll])
    about_y, about_x, about_z = (np.asarray(cv2.Rodrigues(np.array(angles))[0]) for angles in turns)
    return about_y @ about_x @ about_z


def light_file(picture: Path) -> Path:
    """Where the measured light of a panorama FOLDER/NAME.jpg lies if there is any: FOLDER/../light/NAME.npy."""
    return picture.parent.parent / "light" / f"{picture.stem}.npy"


def unreadable_light(picture: Path) -> bool:
    """Whether the panorama has measured light that cannot be used."""
    return light_file(picture).is_file() and _read_light(light_file(picture)) is None


def light_of(panorama: np.ndarray, path: Path) -> np.ndarray:
    """The light from all directions: measured where there is a file beside the picture, else the picture's own.

    Measured light has any unit: it is scaled until its median is the picture's.

    Args:
        panorama: (h, w, 3) uint8 RGB.
        path: of the picture.

    Returns:
        (H, 2 H, 3) float linear RGB, for `Surroundings`.
    """
    small = cv2.resize(panorama, (4 * LIGHT_SIZE[0], 4 * LIGHT_SIZE[1]), interpolation=cv2.INTER_AREA)
    linear = (small / 255.0) ** 2.2
    linear = np.where(linear.max(-1, keepdims=True) > WHITE, HIDDEN * linear, linear)
    own = cv2.resize(linear, LIGHT_SIZE, interpolation=cv2.INTER_AREA)
    measured = _read_light(light_file(path)) if light_file(path).is_file() else None
    if measured is None:
        return own
    return measured * (np.median(own.mean(-1)) + 1e-3) / np.median(measured.mean(-1))


def _read_light(path: Path) -> np.ndarray | None:
    """(H, 2 H, 3) float; None if it is no such array, or has no light in most directions."""
    try:
        light = np.load(path, allow_pickle=False)
    except Exception:  # a damaged archive fails in many ways
        return None
    if light.ndim != 3 or light.shape[1:] != (2 * light.shape[0], 3) or light.dtype.kind != "f":
        return None
    light = light.astype(np.float64)
    return light if np.isfinite(light).all() and (light >= 0).all() and np.median(light.mean(-1)) > 0 else None
