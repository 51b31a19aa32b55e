"""Light read from a background."""

import numpy as np
import pytest

from twohands.synth.backgrounds.panoramas import Surroundings, directions, turn
from twohands.synth.render.lighting import EXPOSURE, KEY_DISTANCE_M, lit_by, lit_inside
from twohands.synth.scene.appearance import sample_lighting
from twohands.synth.scene.config import SynthConfig
from twohands.types import PinholeCamera

CAMERA = PinholeCamera.ego3dhands(480, 270)
LIGHTS = sample_lighting(SynthConfig(), np.random.default_rng(0))


def test_a_middle_grey_background_leaves_the_light_as_it_is():
    grey = np.full((270, 480, 3), round(255 * 0.18 ** (1 / 2.2)), np.uint8)
    lit = lit_by(LIGHTS, grey, CAMERA)
    for name in ("positions", "colours", "sky", "ground"):
        np.testing.assert_allclose(getattr(lit, name), getattr(LIGHTS, name), rtol=0.02)


def test_a_blue_sky_over_sand_tints_light_from_above_and_below():
    scene = np.zeros((270, 480, 3), np.uint8)
    scene[:135], scene[135:] = (110, 140, 220), (200, 170, 120)
    lit = lit_by(LIGHTS, scene, CAMERA)
    above, below = lit.sky / LIGHTS.sky, lit.ground / LIGHTS.ground
    assert above[2] > above[0] and below[0] > below[2]


def test_a_lamp_in_the_picture_becomes_a_light_in_its_direction():
    dark = np.full((270, 480, 3), 25, np.uint8)
    dark[30:60, 360:420] = 255  # around (390, 45)
    lit = lit_by(LIGHTS, dark, CAMERA)
    assert np.linalg.norm(lit.positions[0]) == pytest.approx(KEY_DISTANCE_M)
    u, v = lit.positions[0, :2] / lit.positions[0, 2] * CAMERA.fx + [CAMERA.cx, CAMERA.cy]
    assert (u, v) == (pytest.approx(390, abs=20), pytest.approx(45, abs=20))
    np.testing.assert_array_equal(lit.positions[1:], LIGHTS.positions[1:])


def spot(row, column, radiance, rest=0.1):
    """A grey panorama (64, 128, 3) with one bright cell."""
    light = np.full((64, 128, 3), rest)
    light[row, column] = radiance
    return light


def test_cells_of_a_panorama_cover_the_sphere():
    towards, solid = directions(64)
    assert solid.sum() == pytest.approx(4 * np.pi)
    np.testing.assert_allclose(np.linalg.norm(towards, axis=-1), 1)
    np.testing.assert_allclose(towards[31, 63], [0, 0, 1], atol=0.04)  # the middle looks ahead
    np.testing.assert_allclose(towards[31, 95], [1, 0, 0], atol=0.04)  # three quarters: to the right
    np.testing.assert_allclose(towards[0, 0], [0, -1, 0], atol=0.04)  # the top: up


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_bright_spot_lights_from_its_direction_in_the_camera_frame(mirrored):
    """The spot is 90 degrees to the right; a camera turned 30 degrees to the right has it 60 degrees to its right, and
    to its left where the picture is mirrored."""
    world_from_camera = turn(np.radians(30), 0, 0) @ np.diag([-1.0 if mirrored else 1.0, 1, 1])
    lit = lit_inside(LIGHTS, Surroundings(spot(31, 95, 300.0), world_from_camera))
    brightest = lit.positions[lit.colours.sum(1).argmax()]
    expected = KEY_DISTANCE_M * np.array([np.sin(np.radians(60)), 0, np.cos(np.radians(60))])
    np.testing.assert_allclose(brightest, expected * [-1 if mirrored else 1, 1, 1], atol=0.1)
    assert lit.colours.sum(1).max() > 100 * np.sort(lit.colours.sum(1))[-2]


def test_a_lamp_gives_what_its_place_gives():
    """One cell of radiance L at elevation 0 gives a surface that faces it L dw / π, less the rest of 0.3 that stays
    ambient; that rest is 0.3 from above and below. The exposure is then in range and stays."""
    radiance, cell = 1000.0, (np.pi / 64) * (2 * np.pi / 128)
    lit = lit_inside(LIGHTS, Surroundings(spot(31, 95, radiance, rest=0.3), np.eye(3)))
    brightest = lit.colours.max(0)
    np.testing.assert_allclose(brightest / KEY_DISTANCE_M**2, (radiance - 0.3) * cell / np.pi, rtol=0.01)
    np.testing.assert_allclose(lit.sky, 0.3, rtol=0.01)
    np.testing.assert_allclose(lit.ground, 0.3, rtol=0.01)
    level = brightest[0] / KEY_DISTANCE_M**2 + 0.3
    assert EXPOSURE[0] < level < EXPOSURE[1]


def test_even_light_has_no_lamps_and_a_camera_upside_down_has_the_sky_below():
    even = lit_inside(LIGHTS, Surroundings(np.full((64, 128, 3), 0.5), np.eye(3)))
    assert even.colours.max() < 1e-5
    np.testing.assert_array_equal(even.positions, LIGHTS.positions)
    sky = np.full((64, 128, 3), 0.4)
    sky[:32, :, 2] = 0.8  # blue above
    upright = lit_inside(LIGHTS, Surroundings(sky, np.eye(3)))
    upside_down = lit_inside(LIGHTS, Surroundings(sky, turn(0, 0, np.pi)))
    np.testing.assert_allclose(upright.sky, upside_down.ground, rtol=1e-6)
    assert upright.sky[2] > upright.sky[0] and upright.ground[2] <= upright.ground[0] * 1.001


@pytest.mark.parametrize(("rest", "level"), [(0.01, EXPOSURE[0]), (30.0, EXPOSURE[1])])
def test_a_camera_would_be_set_otherwise_in_the_dark_and_in_the_sun(rest, level):
    lit = lit_inside(LIGHTS, Surroundings(np.full((64, 128, 3), rest), np.eye(3)))
    np.testing.assert_allclose(lit.sky, level, rtol=0.01)
