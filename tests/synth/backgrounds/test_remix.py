"""Remixed backgrounds hold what their sources hold, in other colours."""

from __future__ import annotations

import numpy as np
import pytest

from twohands.synth.backgrounds.procedural import ProceduralBackgrounds
from twohands.synth.backgrounds.remix import RemixedBackgrounds, joined, recoloured
from twohands.types import PinholeCamera

CAMERA = PinholeCamera(100.0, 100.0, 80.0, 45.0, 160, 90)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_the_share_decides(share):
    plain = ProceduralBackgrounds()
    source = RemixedBackgrounds(plain, share)
    same = [
        np.array_equal(
            source.sample(np.random.default_rng(seed), CAMERA).picture,
            plain.sample(np.random.default_rng(seed), CAMERA).picture,
        )
        for seed in range(20)
    ]
    assert all(same) if share == 0 else not any(same)
    assert source.name == f"procedural + remixed {share:g}"


def test_a_joined_picture_shows_both_and_nothing_else():
    picture, other = np.full((2, 90, 160, 3), [[[[10, 20, 30]]], [[[200, 210, 220]]]], np.uint8)
    shares = []
    for seed in range(50):
        found = joined(picture, other, np.random.default_rng(seed))
        assert found.shape == picture.shape and found.dtype == np.uint8
        of_other = (found == other).all(-1)
        assert (of_other | (found == picture).all(-1)).all()
        shares.append(of_other.mean())
    assert min(shares) > 0.03 and max(shares) < 0.97  # 0.25 x 0.25 of the area is the least of an inset
    assert (picture == [10, 20, 30]).all()


def test_recolouring_keeps_black_and_greys_apart():
    """It is linear: black stays black, what was brighter is no darker, until the end of the range."""
    greys = np.repeat(np.arange(0, 256, 5, dtype=np.uint8)[None, :, None], 3, axis=2)
    brightest = []
    for seed in range(50):
        found = recoloured(greys, np.random.default_rng(seed))
        assert found.shape == greys.shape and found.dtype == np.uint8
        assert not found[0, 0].any()
        assert (np.diff(found.astype(int), axis=1) >= 0).all()
        brightest.append(found[0, 25].mean() / greys[0, 25].mean())
    assert min(brightest) < 0.8 and max(brightest) > 1.5


def test_colours_change_places():
    red = np.full((1, 1, 3), (200, 0, 0), np.uint8)
    others = [recoloured(red, np.random.default_rng(seed))[0, 0, 1:].max() for seed in range(50)]
    assert max(others) > 100 and min(others) == 0
