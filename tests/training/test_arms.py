"""Drawn arms."""

import numpy as np
import pytest

from twohands.training.arms import STRIP, arm_path, blend, cloth_strip, draw_strip, skin_strip, window_of


def test_a_strip_covers_what_its_widths_say():
    image, labels = np.zeros((60, 100, 3), np.uint8), np.zeros((60, 100), np.uint8)
    strip = np.full((*STRIP, 3), (10, 200, 30), np.uint8)
    draw_strip(
        image, labels, 8, np.array([[10.0, 30.0], [50.0, 30.0], [90.0, 30.0]]), np.array([10.0, 15.0, 20.0]), strip
    )
    assert np.count_nonzero(labels[:, 12]) == pytest.approx(10, abs=1)
    assert np.count_nonzero(labels[:, 88]) == pytest.approx(20, abs=1)
    assert np.count_nonzero(labels[:, :9]) == 0 and np.count_nonzero(labels[:, 92:]) == 0
    assert (image[labels == 8][:, 1] > 100).all() and image[0, 0].tolist() == [0, 0, 0]


def test_a_strip_outside_the_picture_draws_nothing():
    image, labels = np.zeros((20, 20, 3), np.uint8), np.zeros((20, 20), np.uint8)
    draw_strip(
        image, labels, 1, np.array([[50.0, 5.0], [90.0, 5.0]]), np.full(2, 8.0), cloth_strip(np.random.default_rng(0))
    )
    assert not image.any() and not labels.any()


def test_an_arm_begins_straight_and_leaves_the_picture():
    rng = np.random.default_rng(1)
    for _ in range(20):
        path = arm_path(np.array([50.0, 40.0]), np.array([0.0, 1.0]), 10.0, 500.0, rng)
        assert path[0].tolist() == [50, 40] and path[1, 0] == pytest.approx(50)
        assert np.linalg.norm(path[-1] - path[0]) > 300


def test_skin_goes_on_in_its_colours():
    profile = np.linspace([220, 170, 140], [110, 80, 60], 24).astype(np.uint8)
    strip = skin_strip(profile, np.random.default_rng(2))
    assert strip.shape == (*STRIP, 3)
    np.testing.assert_allclose(strip[0].mean(axis=0), profile.mean(axis=0), rtol=0.12)
    assert strip[0, 0, 0] > strip[0, -1, 0]


def test_blending():
    canvas = np.full((1, 3, 3), 100, np.uint8)
    blend(canvas, np.full((1, 3, 3), 200, np.uint8), np.array([[0, 51, 255]], np.uint8))
    assert canvas[0, :, 0].tolist() == [100, 120, 200]


def test_windows_stay_inside():
    assert window_of(np.array([[5.0, 6.0], [9.5, 7.0]]), (10, 20)) == (3, 4, 12, 9)
    assert window_of(np.array([[-50.0, 6.0], [-40.0, 7.0]]), (10, 20)) is None
