"""How cameras see people: webcams and phones, across a room, over a shoulder, from above a table.

Axes: gravity along y, the person faces along z, x is the person's right; origin between the eyes at rest, metres.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Final

import numpy as np

from twohands.synth.scene.config import PeopleView, SynthConfig
from twohands.synth.scene.pose import rotation_about, unit
from twohands.synth.scene.sampling import looking_from
from twohands.types import PinholeCamera

SHARES: Final[dict[PeopleView, float]] = {"webcam": 0.54, "room": 0.24, "selfie": 0.06, "shoulder": 0.07, "above": 0.09}
"""Of the views, where all of them are asked for."""
FOV: Final = (45.0, 95.0)
"""Degrees across the picture."""
WEBCAM_M, ROOM_M, SELFIE_M = (0.3, 1.5), (1.0, 4.0), (0.38, 0.62)
"""Distances from the eyes (webcam, selfie) or the chest (room)."""
SMALLEST_HAND: Final = 0.05
"""A hand's length at least, as a share of the picture's width, where a view lies that far off: 24 of 480 pixels."""
HAND_M: Final = 0.165
FACE, CHEST = np.array([0.0, 0.05, -0.05]), np.array([0.0, 0.32, -0.05])


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoint:
    """A camera before a person.

    Attributes:
        style: which of `config.PEOPLE_VIEWS`.
        camera: intrinsics.
        rotation: (3, 3) into the camera's frame.
        place: (3,) of the pinhole.
        side: whose hand holds the camera, where one does; else -1.
    """

    style: PeopleView
    camera: PinholeCamera
    rotation: np.ndarray
    place: np.ndarray
    side: int = -1

    @property
    def view(self) -> np.ndarray:
        """(3, 4) transform into the camera's frame."""
        return np.concatenate([self.rotation, -(self.rotation @ self.place)[:, None]], axis=1)


def sample_roll(rng: np.random.Generator) -> float:
    """Radians by which a camera is turned about its axis: mostly a little; some lie on their side or hang head down."""
    kind = rng.random()
    if kind < 0.85:
        return np.radians(rng.normal(0, 3.5))
    if kind < 0.91:
        return np.radians(rng.choice([-90, 90]) + rng.normal(0, 4))
    return np.radians(180 + rng.normal(0, 5)) if kind < 0.955 else rng.uniform(-np.pi, np.pi)


def around(anchor: np.ndarray, distance: float, azimuth: float, below: float) -> np.ndarray:
    """(3,) place so far from `anchor` (3,), `azimuth` to the person's right of straight ahead and `below` lower,
    degrees."""
    a, b = np.radians([azimuth, below])
    return anchor + distance * np.array([np.sin(a) * np.cos(b), np.sin(b), np.cos(a) * np.cos(b)])


def sample_viewpoint(config: SynthConfig, rng: np.random.Generator) -> Viewpoint:
    """A random camera of a random style.

    Args:
        config: views and picture size; `intrinsics` and `principal_shift` hold, `fov` only where narrower than `FOV`.
        rng: the only source of randomness.
    """
    shares = np.array([SHARES[style] for style in config.people_views])
    style = config.people_views[int(rng.choice(len(shares), p=shares / shares.sum()))]
    camera = _camera(config, rng)
    roll, side = sample_roll(rng), -1
    shift = rng.normal(0, 0.13, 2)
    if style == "webcam":
        distance = float(np.exp(rng.uniform(*np.log(WEBCAM_M))))
        place, anchor = around(FACE, distance, rng.normal(0, 14), np.clip(rng.normal(9, 11), -20, 35)), FACE
        at = np.array([0.5, rng.uniform(0.18, 0.5)]) + shift * [1.0, 0.5]
    elif style == "selfie":
        side = int(rng.integers(2))
        azimuth = rng.uniform(0, 30) * (1 if side else -1)
        place, anchor = around(FACE, rng.uniform(*SELFIE_M), azimuth, rng.uniform(-25, 12)), FACE
        at = np.array([0.5, 0.42]) + shift
    elif style == "room":
        focal = camera.fx / camera.width
        farthest = min(ROOM_M[1], max(focal * HAND_M / SMALLEST_HAND, ROOM_M[0] * 1.2))
        distance = float(np.exp(rng.uniform(*np.log([ROOM_M[0], farthest]))))
        azimuth = rng.normal(0, 25) if rng.random() < 0.9 else rng.uniform(-180, 180)
        place, anchor = around(CHEST, distance, azimuth, np.clip(rng.normal(0, 11), -35, 25)), CHEST
        at = np.array([0.5, 0.48]) + shift * [1.5, 0.8]
    elif style == "shoulder":
        place = rng.uniform([0.17, -0.38, -0.32], [0.42, -0.04, 0.02]) * [rng.choice([-1, 1]), 1, 1]
        anchor, at = rng.uniform([-0.08, 0.28, 0.3], [0.08, 0.45, 0.42]), np.array([0.5, 0.5]) + shift * 0.5
    else:
        place = rng.uniform([-0.4, -0.4, 0.2], [0.4, 0.1, 0.8])
        anchor, at = rng.uniform([-0.1, 0.38, 0.26], [0.1, 0.44, 0.44]), np.array([0.5, 0.5]) + shift * 0.5
    at = np.clip(at, 0.06, 0.94)
    rotation = rotation_about(np.array([0.0, 0.0, 1.0]), roll) @ looking_from(place, anchor)
    return Viewpoint(style, camera, _towards(camera, at) @ rotation, place, side)


def _camera(config: SynthConfig, rng: np.random.Generator) -> PinholeCamera:
    if config.intrinsics is not None:
        camera = PinholeCamera(*config.intrinsics, config.width, config.height)
    else:
        low, high = FOV if config.fov is None else (max(FOV[0], config.fov[0]), min(FOV[1], config.fov[1]))
        fov = rng.uniform(low, max(low, high))
        camera = PinholeCamera.from_fov(fov, config.width, config.height)
    if config.principal_shift:
        shift = rng.uniform(-config.principal_shift, config.principal_shift, 2) * [config.width, config.height]
        camera = dataclasses.replace(camera, cx=camera.cx + shift[0], cy=camera.cy + shift[1])
    return camera


def _towards(camera: PinholeCamera, at: np.ndarray) -> np.ndarray:
    """(3, 3) rotation that takes the optical axis to the fraction `at` (2,) of the picture."""
    u, v = at * [camera.width, camera.height]
    ray = unit(np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0]))
    axis = np.cross([0.0, 0.0, 1.0], ray)
    sine = float(np.linalg.norm(axis))
    return rotation_about(axis / max(sine, 1e-9), np.arctan2(sine, ray[2]))


def quarter_turns(view: np.ndarray) -> int:
    """By how many quarter turns, counter-clockwise, 0..3, an upright person stands turned in the picture of a camera
    with the view (3, 4)."""
    return int(np.rint(np.arctan2(view[0, 1], view[1, 1]) / (np.pi / 2))) % 4
