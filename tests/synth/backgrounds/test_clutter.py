"""Things laid over backgrounds: they belong to the background, and look like things."""

from __future__ import annotations

import numpy as np
import pytest

from twohands.synth.backgrounds.clutter import ClutteredBackgrounds, _lighting, cluttered, skin_toned
from twohands.synth.backgrounds.procedural import ProceduralBackgrounds
from twohands.types import PinholeCamera

CAMERA = PinholeCamera(100.0, 100.0, 80.0, 45.0, 160, 90)


@pytest.mark.parametrize("seed", range(20))
def test_a_thing_covers_a_part_of_the_picture_and_leaves_the_rest(seed):
    picture = np.full((90, 160, 3), (20, 200, 220), np.uint8)
    before = picture.copy()
    found = cluttered(picture, np.random.default_rng(seed))
    assert found.shape == picture.shape
    assert found.dtype == np.uint8
    assert np.array_equal(picture, before)
    changed = (found != picture).any(axis=-1).mean()
    assert changed < 0.95


def test_most_pictures_change():
    picture = np.full((90, 160, 3), (20, 200, 220), np.uint8)
    changed = [(cluttered(picture, np.random.default_rng(seed)) != picture).mean() > 0.005 for seed in range(50)]
    assert sum(changed) > 35


def test_things_are_brighter_on_the_side_of_the_light():
    """A smooth thing is lit: its brightness varies far more than its colour's noise."""
    picture = np.zeros((90, 160, 3), np.uint8)
    spreads = []
    for seed in range(30):
        found = cluttered(picture, np.random.default_rng(seed))
        inside = found[found.sum(axis=-1) > 60].astype(float)
        if len(inside) > 200:
            spreads.append(inside.mean(axis=-1).std())
    assert len(spreads) > 10
    assert np.median(spreads) > 10


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_the_share_decides(share):
    plain = ProceduralBackgrounds()
    source = ClutteredBackgrounds(plain, share)
    same = [
        np.array_equal(
            source.sample(np.random.default_rng(seed), CAMERA).picture,
            plain.sample(np.random.default_rng(seed), CAMERA).picture,
        )
        for seed in range(20)
    ]
    assert all(same) if share == 0 else sum(same) < 5
    assert source.name == f"procedural + clutter {share:g}"


@pytest.mark.filterwarnings("error")
def test_a_thing_that_fills_its_rectangle_is_lit_evenly():
    """Found by a warning in training: nothing around it, so the distance to its edge was boundless."""
    light = _lighting(np.full((20, 30), 255, np.uint8), np.array([0.0, 0.0, 1.0]), np.random.default_rng(0))
    assert np.isfinite(light).all()
    assert light.min() > 0.3


@pytest.mark.filterwarnings("error")
def test_small_pictures_do():
    for seed in range(50):
        assert cluttered(np.full((8, 8, 3), 128, np.uint8), np.random.default_rng(seed)).shape == (8, 8, 3)


def test_a_skin_toned_picture_is_reddish_and_keeps_its_shading():
    picture = np.zeros((2, 2, 3), np.uint8)
    picture[..., 2] = [[40, 80], [120, 160]]  # shades of blue
    for seed in range(20):
        toned = skin_toned(picture, np.random.default_rng(seed)).astype(int)
        assert (toned[..., 0] > picture[..., 0]).all()
        assert (np.diff(toned.sum(-1).ravel()) > 0).all()
