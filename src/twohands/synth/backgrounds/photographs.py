"""Photographs behind the hands, cut, mirrored and coloured at random; panoramas among them bring their light."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from twohands.synth.backgrounds.base import Background
from twohands.synth.backgrounds.panoramas import (
    Surroundings,
    is_panorama,
    light_file,
    light_of,
    rays,
    turn,
    unreadable_light,
    view,
)
from twohands.synth.backgrounds.pictures import PictureFolder, read_picture
from twohands.types import PinholeCamera


class BackgroundFolder(PictureFolder[tuple[np.ndarray, np.ndarray | None]]):
    """Photographs of a folder and its subfolders, with random crop, flip and colour augmentation (paper 3.1).

    Panoramas (`panoramas.is_panorama`) are seen through the camera of the hands, turned anywhere, and bring their
    light.

    Args:
        folder: see `PictureFolder`.
        keep: how many decoded pictures to keep in memory, 1.5 MB each, panoramas 6 MB.

    Raises:
        InputError: see `PictureFolder`.
    """

    def __init__(self, folder: Path, keep: int = 1024) -> None:
        super().__init__(folder, "background", _read_background, keep, _light_beside)

    def sample(self, rng: np.random.Generator, camera: PinholeCamera) -> Background:
        """A random background for a camera.

        Raises:
            InputError: no picture can be read any more.
        """
        path, (picture, light) = self.pick(rng)
        if light is None:
            return Background(augment(picture, rng, camera.width, camera.height))
        if unreadable_light(path):
            self.note(path, part="light of ")
        return _panorama_view(picture, light, rng, camera)


def augment(picture: np.ndarray, rng: np.random.Generator, width: int, height: int) -> np.ndarray:
    """Random crop of the target's aspect ratio, horizontal flip, and random brightness, contrast and tint."""
    h, w = picture.shape[:2]
    largest = min(w / width, h / height)
    scale = largest * rng.uniform(0.6, 1.0)
    cw, ch = max(int(width * scale), 1), max(int(height * scale), 1)
    x, y = int(rng.integers(0, w - cw + 1)), int(rng.integers(0, h - ch + 1))
    crop = picture[y : y + ch, x : x + cw]
    if rng.random() < 0.5:
        crop = crop[:, ::-1]
    crop = cv2.resize(np.ascontiguousarray(crop), (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.LUT(crop, _colour_table(rng)[1]))


def _colour_table(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Random brightness, contrast and tint: the (3,) factors of the colours, and a (1, 256, 3) uint8 table of all."""
    gain = np.exp(rng.normal(0, 0.18) + rng.normal(0, 0.06, 3))
    contrast, pivot = np.exp(rng.normal(0, 0.12)), rng.uniform(90, 150)
    table = np.clip((np.arange(256)[:, None] * gain - pivot) * contrast + pivot, 0, 255).astype(np.uint8)
    return gain, np.ascontiguousarray(table[None])


class Look:
    """Colour and mirroring of a view or a clip; strengths as in `augment`."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.flip = bool(rng.random() < 0.5)
        self.gain, self.table = _colour_table(rng)

    def apply(self, picture: np.ndarray) -> np.ndarray:
        """(H, W, 3) uint8 of the same size."""
        if self.flip:
            picture = picture[:, ::-1]
        return np.asarray(cv2.LUT(np.ascontiguousarray(picture), self.table))

    def surroundings(self, light: np.ndarray, world_from_camera: np.ndarray) -> Surroundings:
        """The light (H, 2 H, 3), linear, around a camera with that rotation (3, 3), as the changed picture has it."""
        mirror = np.diag([-1.0 if self.flip else 1.0, 1.0, 1.0])
        return Surroundings(light * self.gain**2.2, world_from_camera @ mirror)


def _panorama_view(
    panorama: np.ndarray, light: np.ndarray, rng: np.random.Generator, camera: PinholeCamera
) -> Background:
    """A view to any side, rather downwards, as people look at their hands."""
    look = Look(rng)
    world_from_camera = turn(rng.uniform(-np.pi, np.pi), *np.radians(rng.normal([-12, 0], [10, 3])))
    picture = look.apply(view(panorama, rays(camera), world_from_camera))
    return Background(picture, look.surroundings(light, world_from_camera))


def _light_beside(path: Path) -> str:
    return " with light" if light_file(path).is_file() else ""


def _read_background(path: Path) -> tuple[np.ndarray, np.ndarray | None] | None:
    """A picture, and the light from all directions where it is a panorama; None if it cannot be read."""
    picture = read_picture(path)
    if picture is None:
        return None
    return picture, light_of(picture, path) if is_panorama(*picture.shape[1::-1]) else None
