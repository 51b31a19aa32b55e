"""Light that belongs to the background, so that hands sit in the picture."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from twohands.synth.backgrounds.panoramas import Surroundings, directions
from twohands.synth.scene.spec import Lighting
from twohands.types import PinholeCamera

GRID = (16, 9)
"""Columns and rows of the coarse picture that light is read from."""
MIDDLE_GREY = 0.18
KEY_DISTANCE_M = 2.0
KEY_CONTRAST = 2.5
"""A part of the picture this much brighter than the whole is a lamp or a window."""

LAMP_CONE = np.cos(np.radians(25))
"""Light from within 25 degrees is taken for one lamp: a window, a part of the sky."""
LAMP_GRID = (16, 8)
"""Columns and rows in which the next lamp is looked for."""
TINT = 0.6
"""Share of a panorama's colours that light keeps: cameras balance the rest away where a hand fills the picture."""
EXPOSURE = (0.35, 1.6)
"""Range of the brightness of a white ball among the lights; beyond it, a camera would be set otherwise."""


def lit_by(lighting: Lighting, background: np.ndarray, camera: PinholeCamera) -> Lighting:
    """The lights, with the colour and about the brightness of a background, and its brightest part as one of them.

    Light from above takes the tint of the upper half of the picture, light from below that of the lower half; lamps
    take the tint of the whole. Differences are much reduced: a picture shows a small part of a room, and cameras
    balance colours.

    Args:
        lighting: drawn without regard to the background.
        background: (H, W, 3) uint8 RGB.
        camera: of the picture.

    Returns:
        New lights in the camera frame.
    """
    linear = (cv2.resize(background, GRID, interpolation=cv2.INTER_AREA) / 255.0) ** 2.2
    whole = linear.mean((0, 1)) + 1e-3
    level = np.clip((whole.mean() / MIDDLE_GREY) ** 0.5, 0.5, 1.6)

    def tint(part: np.ndarray) -> np.ndarray:
        mean = part.mean((0, 1)) + 1e-3
        return (mean / whole.mean()) ** 0.35

    half = GRID[1] // 2
    positions, colours = lighting.positions.copy(), lighting.colours * tint(linear) * level
    luminance = cv2.GaussianBlur(linear.mean(-1), (0, 0), 0.8)
    row, column = np.unravel_index(int(luminance.argmax()), luminance.shape)
    if luminance[row, column] > KEY_CONTRAST * whole.mean():
        u, v = (column + 0.5) / GRID[0] * camera.width, (row + 0.5) / GRID[1] * camera.height
        ray = np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0])
        strength = np.linalg.norm(colours[0]) * (KEY_DISTANCE_M / np.linalg.norm(positions[0])) ** 2
        positions[0] = ray / np.linalg.norm(ray) * KEY_DISTANCE_M
        colours[0] = strength * linear[row, column] / max(np.linalg.norm(linear[row, column]), 1e-3)
    return replace(
        lighting,
        positions=positions,
        colours=colours,
        sky=lighting.sky * tint(linear[:half]) * level,
        ground=lighting.ground * tint(linear[-half:]) * level,
    )


def lit_inside(lighting: Lighting, surroundings: Surroundings) -> Lighting:
    """The light of a panorama: its brightest places as lamps, the rest as light from above and below.

    No light is lost: what a lamp takes is no part of the rest, and lamps give a surface that faces them the light of
    their place.

    Args:
        lighting: as many lamps are wanted; where there are no more bright places, its own lamps stay, without light.
        surroundings: the light, and where the camera looks.

    Returns:
        New lights in the camera frame.
    """
    towards, solid = directions(len(surroundings.radiance))
    grey = surroundings.radiance.mean(-1, keepdims=True)
    rest, places, powers = grey + TINT * (surroundings.radiance - grey), [], []
    for old in lighting.positions:
        rest, place, power = _without_lamp(rest, towards, solid)
        places.append(old if place is None else KEY_DISTANCE_M * place @ surroundings.world_from_camera)
        powers.append(power * (places[-1] @ places[-1]))
    up = -surroundings.world_from_camera[:, 1]  # y points down in both frames
    facing = np.stack([np.maximum(towards @ side, 0) * solid for side in (up, -up)])
    sky, ground = np.einsum("sij,ijc->sc", facing, rest) / np.pi
    lamps = sum(power / (place @ place) for power, place in zip(powers, places, strict=True))
    level = float(np.mean(lamps + (sky + ground) / 2))
    factor = np.clip(level, *EXPOSURE) / max(level, 1e-6)
    faintest = 1e-6  # a lamp has a colour
    return Lighting(np.array(places), np.array(powers) * factor + faintest, sky * factor, ground * factor)


def _without_lamp(
    radiance: np.ndarray, towards: np.ndarray, solid: np.ndarray
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray]:
    """Takes the brightest place out of a panorama (H, W, 3).

    Returns:
        What is left; the direction (3,) of the place, None where nothing is brighter than the rest; and its (3,)
        irradiance over pi, which is the radiance of a white surface that faces it.
    """
    brightness = radiance.mean(-1)
    floor = np.average(np.minimum(brightness, np.average(brightness, weights=solid)), weights=solid)
    share = np.maximum(1 - floor / np.maximum(brightness, 1e-9), 0)
    excess = share * brightness * solid
    if excess.sum() < 1e-6 * (brightness * solid).sum() + 1e-12:
        return radiance, None, np.zeros(3)
    coarse = cv2.resize(excess, LAMP_GRID, interpolation=cv2.INTER_AREA)
    row, column = np.unravel_index(int(coarse.argmax()), coarse.shape)
    near = directions(LAMP_GRID[1])[0][row, column]
    for _ in range(2):  # from the middle of the cell to that of the light
        cone = towards @ near > LAMP_CONE
        near = np.tensordot(excess * cone, towards, axes=2)
        near = near / np.linalg.norm(near)
    share = (share * (towards @ near > LAMP_CONE))[..., None]
    return radiance * (1 - share), near, np.tensordot(solid, radiance * share, axes=2) / np.pi
