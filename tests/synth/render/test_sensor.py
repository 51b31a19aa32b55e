"""Cameras: an ideal one changes nothing; blur keeps places, noise keeps means."""

import dataclasses

import numpy as np
import pytest

from twohands.synth.render.sensor import IDEAL, expose, sample_sensor, sample_webcam, streak


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


def test_a_webcam_without_faults_is_ideal():
    assert sample_webcam(0.0, np.random.default_rng(0)) is IDEAL


@pytest.mark.parametrize("seed", range(12))
def test_a_webcams_picture_keeps_its_size_and_its_shapes(seed):
    """A square stays where it is, within the width of a blurred edge."""
    image = np.full((135, 241, 3), 40, np.uint8)
    image[40:90, 80:160] = 220
    rng = np.random.default_rng(seed)
    sensor = dataclasses.replace(sample_webcam(1.0, rng), shake_px=np.zeros(2))
    taken = expose(image, sensor, rng).astype(float).mean(-1)
    assert taken.shape == (135, 241)
    inside, outside = taken[50:80, 95:145].mean(), np.r_[taken[:25].ravel(), taken[-25:].ravel()].mean()
    assert inside > outside + 5
    bright = taken - outside > (inside - outside) / 2
    middle = np.array(np.nonzero(bright)).mean(1)
    assert np.abs(middle - [64.5, 119.5]).max() < 4


def test_sharpening_draws_halos_and_shrinking_takes_detail():
    image = np.full((60, 80, 3), 100, np.uint8)
    image[:, 40:] = 180
    sharp = expose(image, dataclasses.replace(IDEAL, sharpening=1.0), np.random.default_rng(0))
    assert sharp[30, 40, 0] > 180 and sharp[30, 39, 0] < 100
    lines = np.zeros((60, 80, 3), np.uint8)
    lines[:, ::2] = 255
    small = expose(lines, dataclasses.replace(IDEAL, shrink=0.5), np.random.default_rng(0))
    assert small.std() < 20 < lines.std()


def test_a_streak_is_an_even_move():
    """Along eight pixels each cell gets an eighth, the two at the ends half of that; a turn exchanges rows and columns,
    and the kernel leaves brightness and middle as they are."""
    across = streak(np.array([8.0, 0.0]))
    np.testing.assert_allclose(across[4], np.array([1, 2, 2, 2, 2, 2, 2, 2, 1]) / 16, atol=0.01)
    assert across.sum() == pytest.approx(1) and not np.delete(across, 4, axis=0).any()
    np.testing.assert_allclose(streak(np.array([0.0, 8.0])), across.T, atol=1e-6)
    slanted = streak(np.array([5.0, -3.0]))
    rows, columns = np.indices(slanted.shape) - len(slanted) // 2
    assert slanted.sum() == pytest.approx(1)
    np.testing.assert_allclose([(slanted * rows).sum(), (slanted * columns).sum()], 0, atol=1e-5)
    assert (slanted * rows * columns).sum() < 0
