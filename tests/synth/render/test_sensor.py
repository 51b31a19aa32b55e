"""Cameras: an ideal one changes nothing; blur keeps places, noise keeps means."""

import dataclasses

import numpy as np
import pytest

from twohands.synth.render.sensor import IDEAL, expose, sample_sensor


def rng():
    return np.random.default_rng(0)


@pytest.fixture
def picture():
    return np.random.default_rng(1).integers(40, 200, (54, 96, 3), dtype=np.uint8)


def test_no_strength_is_an_ideal_camera_that_changes_nothing(picture):
    assert sample_sensor(0.0, rng()) is IDEAL
    assert expose(picture, IDEAL, rng()) is picture


def test_same_draws_same_picture(picture):
    for strength in (0.3, 1.0):
        sensor = sample_sensor(strength, rng())
        np.testing.assert_array_equal(expose(picture, sensor, rng()), expose(picture, sensor, rng()))


def test_doubling_the_light_by_hand():
    grey = np.full((4, 4, 3), 100, np.uint8)
    brighter = expose(grey, dataclasses.replace(IDEAL, gain=np.array([2.0, 1.0, 0.5])), rng())
    expected = 255 * (np.array([2.0, 1.0, 0.5]) * (100 / 255) ** 2.2) ** (1 / 2.2)
    np.testing.assert_allclose(brighter[0, 0], expected, atol=0.51)


@pytest.mark.parametrize("change", [{"defocus_px": 3.0}, {"shake_px": np.array([9.0, 4.0])}])
def test_blur_keeps_the_place_of_a_spot(change):
    spot = np.zeros((101, 480, 3), np.uint8)
    spot[49:52, 199:202] = 255
    blurred = expose(spot, dataclasses.replace(IDEAL, **change), rng()).astype(float).sum(-1)
    assert blurred.max() < 3 * 255 / 2
    v, u = (np.indices(blurred.shape) * blurred).sum((1, 2)) / blurred.sum()
    assert (u, v) == (pytest.approx(200, abs=0.3), pytest.approx(50, abs=0.3))


def test_noise_grows_with_light_and_keeps_the_mean():
    sensor = dataclasses.replace(IDEAL, read_noise=2.0, shot_noise=6.0)
    spread = []
    for level in (30, 200):
        flat = np.full((200, 200, 3), level, np.uint8)
        noisy = expose(flat, sensor, rng()).astype(float)
        assert noisy.mean() == pytest.approx(level, abs=0.2)
        spread.append(noisy.std())
        assert spread[-1] == pytest.approx(2 + 6 * np.sqrt(level / 255), rel=0.05)


def test_compression_changes_little():
    smooth = np.tile(np.linspace(20, 230, 96).astype(np.uint8)[None, :, None], (54, 1, 3))
    packed = expose(smooth, dataclasses.replace(IDEAL, jpeg_quality=90), rng())
    assert 0 < np.abs(packed.astype(int) - smooth).max() < 12
