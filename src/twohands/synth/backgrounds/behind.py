"""The room behind people: upright as they are, and out of focus where they are not."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import cv2
import numpy as np

from twohands.synth.backgrounds.base import Background, Backgrounds
from twohands.synth.backgrounds.interiors import interior
from twohands.types import PinholeCamera

DRAWN: Final = 0.6
"""Share of rooms that are drawn, with parts of the source's pictures in them; the others are those pictures."""
BLURRED: Final = 0.4
"""Share of rooms that are out of focus."""
BLUR: Final = (0.0015, 0.016)
"""Standard deviation of that, as a share of the picture's width."""


def room_behind(source: Backgrounds, rng: np.random.Generator, camera: PinholeCamera, turns: int) -> Background:
    """A background for a camera that lies turned.

    Args:
        source: of backgrounds.
        rng: the only source of randomness.
        camera: of the picture.
        turns: quarter turns, counter-clockwise, by which the room stands turned in it.
    """
    upright = camera
    if turns % 2:
        upright = PinholeCamera(camera.fy, camera.fx, camera.cy, camera.cx, camera.height, camera.width)
    background = source.sample(rng, upright)
    if rng.random() < DRAWN:
        background = Background(interior(rng, upright.width, upright.height, background.picture))
    picture = np.ascontiguousarray(np.rot90(background.picture, turns))
    if rng.random() < BLURRED:
        sigma = camera.width * float(np.exp(rng.uniform(*np.log(BLUR))))
        picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma))
    return replace(background, picture=picture)
