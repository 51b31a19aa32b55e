"""Hands cut out of white paper."""

import numpy as np
import pytest
from tests.datasets.photographed import photograph

from twohands.datasets.cutting import cut_out


def test_the_mask_is_the_hand_without_its_shadow():
    picture, mask, joints = photograph(np.random.default_rng(1))
    cut = cut_out(picture, joints)
    found = cut.alpha > 127
    assert cut.flaw == "" and cut.on_hand.all()
    assert (found & mask).sum() / (found | mask).sum() > 0.95
    far = ~cv_dilated(mask, 5)
    assert cut.alpha[far].max() == 0


def test_the_edge_has_the_colour_of_the_hand():
    picture, _, joints = photograph(np.random.default_rng(2))
    cut = cut_out(picture, joints)
    edge = (cut.alpha > 25) & (cut.alpha < 230)
    red, _, blue = cut.colour[edge].mean(axis=0)
    assert red / blue == pytest.approx(196 / 112, rel=0.06)
    paper_there = picture[edge].mean(axis=0)
    assert paper_there[0] / paper_there[2] < 1.5  # as it is in the picture


def test_the_forearm_ends_at_the_border():
    picture, _, joints = photograph(np.random.default_rng(3))
    cut = cut_out(picture, joints)
    forearm = joints[0] - joints[[5, 9, 13, 17]].mean(axis=0)
    assert cut.along @ forearm / np.linalg.norm(forearm) > 0.99
    assert 93 < cut.end_px[1] < 100
    away = cut.end_px - joints[0]
    assert abs(away[0] * forearm[1] - away[1] * forearm[0]) / np.linalg.norm(forearm) < 2  # on the forearm's axis
    assert cut.width_px == pytest.approx(18, abs=3)


def test_the_same_photograph_gives_the_same_cut():
    picture, _, joints = photograph(np.random.default_rng(4))
    a, b = cut_out(picture, joints), cut_out(picture, joints)
    np.testing.assert_array_equal(a.colour, b.colour)
    np.testing.assert_array_equal(a.alpha, b.alpha)


def test_what_is_wrong_is_said():
    picture, _, joints = photograph(np.random.default_rng(5))
    grey = np.repeat(picture[..., 1:2], 3, axis=2)
    assert cut_out(grey, joints).flaw == "hand and paper have nearly the same colour"
    assert cut_out(np.zeros_like(picture), joints).flaw == "too dark, or no paper in sight"
    beside = joints.copy()
    beside[[8, 12, 16], 1] -= 12
    assert cut_out(picture, beside).flaw == "joints beside the mask"


def cv_dilated(mask: np.ndarray, radius: int) -> np.ndarray:
    """The mask grown by so many pixels in every direction."""
    padded = np.pad(mask, radius)
    size = 2 * radius + 1
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, (size, size)).any(axis=(2, 3)))
