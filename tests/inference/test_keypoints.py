"""Joints and scores from heatmaps."""

import numpy as np
import pytest
from tests.oracles import make_card

from twohands.geometry.heatmaps import WINDOW_RADIUS, decode_softargmax, encode_heatmaps
from twohands.inference.keypoints import read_joints, read_out
from twohands.types import HandCrop


def maps_of(joints, sigma=2.0):
    """(1, N, 32, 32) Gaussians at joints (N, 2) in cells, without a cut-off."""
    return encode_heatmaps(np.asarray(joints, float)[None], crop_size=32, sigma=sigma, cutoff=0.0)


@pytest.mark.parametrize("sigma", [1.0, 2.0, 4.0])
def test_subpixel_is_exact_for_a_gaussian_of_any_width(sigma):
    joints = np.random.default_rng(0).uniform(1, 31, (21, 2))
    found, scores = read_joints(maps_of(joints, sigma), "subpixel")
    np.testing.assert_allclose(found[0], joints, atol=1e-6)
    assert (scores > 0.75).all() and (scores <= 1).all()


def test_softargmax_is_nearly_exact_well_inside_the_map():
    joints = np.random.default_rng(1).uniform(8, 24, (21, 2))
    found, scores = read_joints(maps_of(joints), "softargmax")
    np.testing.assert_allclose(found[0], joints, atol=0.02)
    assert (scores > 0.98).all()


def test_the_window_shuts_out_stray_mass_that_drags_the_plain_mean_away():
    maps = maps_of([[10.0, 10.0]])
    maps[0, 0, 26:30, 26:30] = 0.2  # 3.2 of the map's 25 + 3.2
    plain = decode_softargmax(maps)[0][0, 0]
    found, scores = read_joints(maps, "softargmax")
    assert np.abs(plain - 10).max() > 1.5
    np.testing.assert_allclose(found[0, 0], [10, 10], atol=0.02)
    assert scores[0, 0] == pytest.approx(25.1 / (25.1 + 3.2), abs=0.01)


def test_near_the_border_the_window_is_cut():
    """The mean of the column's cells 0 to 7 and of the row's 10 to 22: a peak in column 1, row 16."""
    maps = np.full((1, 1, 32, 32), 1.0)
    maps[0, 0, 16, 1] = 1.001
    found, scores = read_joints(maps, "softargmax")
    np.testing.assert_allclose(found[0, 0], [4.0, 16.5], atol=0.001)
    assert scores[0, 0] == pytest.approx(8 * 13 / 32**2, abs=1e-3)


def test_softargmax_does_not_depend_on_the_maps_scale():
    maps = maps_of(np.random.default_rng(2).uniform(5, 27, (21, 2)))
    np.testing.assert_allclose(read_joints(maps, "softargmax")[0], read_joints(37 * maps, "softargmax")[0], rtol=1e-12)


def test_scores_tell_a_sharp_map_from_a_flat_one():
    """A uniform map has (2 * 6 + 1)^2 / 32^2 of its mass in a full window, and a peak that says nothing."""
    sharp = maps_of([[16.0, 16.0]])
    flat = np.full_like(sharp, 1e-3)
    flat[0, 0, 16, 16] *= 1.001
    (_, high), (_, low) = read_joints(sharp, "softargmax"), read_joints(flat, "softargmax")
    assert high[0, 0] > 0.99
    assert low[0, 0] == pytest.approx((2 * WINDOW_RADIUS + 1) ** 2 / 32**2, abs=1e-3)
    assert read_joints(flat, "subpixel")[1][0, 0] == pytest.approx(1e-3, rel=1e-2)


@pytest.mark.parametrize("decoder", ["subpixel", "softargmax"])
def test_a_batch_is_a_loop_and_nothing_is_changed(decoder):
    maps = np.random.default_rng(3).random((2, 21, 32, 32)) ** 8
    before = maps.copy()
    joints, scores = read_joints(maps, decoder)
    assert joints.shape == (2, 21, 2) and scores.shape == (2, 21)
    for i in range(2):
        alone = read_joints(maps[i : i + 1], decoder)
        np.testing.assert_array_equal(joints[i], alone[0][0])
        np.testing.assert_array_equal(scores[i], alone[1][0])
    np.testing.assert_array_equal(maps, before)


def test_empty_maps_have_score_zero():
    for decoder in ("subpixel", "softargmax"):
        joints, scores = read_joints(np.zeros((1, 21, 32, 32)), decoder)
        assert np.isfinite(joints).all() and (scores == 0).all()


def test_maps_of_the_middle_of_a_crop_are_read_in_pixels_of_the_picture():
    """Maps of 32 cells show the middle 128 of 192 pixels; the crop is twice as fine as the picture."""
    joints = np.random.default_rng(3).uniform(5, 27, (21, 2))
    crop = HandCrop(np.zeros((192, 192, 3), np.uint8), np.array([[0.5, 0, 10], [0, 0.5, 20], [0, 0, 1]]), 0, False)
    card = make_card(crop_size=192, surround=32)
    found_px, scores = read_out(card, maps_of(joints), [crop])
    np.testing.assert_allclose(found_px[0], (4 * joints + 32) / 2 + [10, 20], atol=1e-5)
    assert (scores > 0.75).all()
