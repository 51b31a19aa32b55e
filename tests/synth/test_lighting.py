"""Light read from a background."""

import numpy as np
import pytest

from twohands.synth.config import SynthConfig
from twohands.synth.lighting import KEY_DISTANCE_M, lit_by
from twohands.synth.scene import sample_lighting
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
