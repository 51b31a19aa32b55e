"""Which part of a picture HandSegNet sees closer, and what becomes of its maps."""

import dataclasses

import numpy as np
import pytest

from twohands.inference.decision import ViewConfig
from twohands.inference.segmenter import HandMaps, closer_part, scored, with_part

VIEWS = ViewConfig(closer_below_share=0.5, closer_margin=2.0, closer_smallest=0.2, closer_lead=0.0)


def maps_with(rows: slice, columns: slice, shape=(48, 64)) -> HandMaps:
    """Maps in which a left arm is certain in a rectangle, and nothing anywhere else."""
    seg_logits, energy_logits = np.zeros((3, *shape), np.float32), np.full((2, *shape), -6, np.float32)
    seg_logits[0] = 4
    seg_logits[1, rows, columns] = 8
    return scored(seg_logits, energy_logits)


def test_the_part_is_the_box_with_its_margin_in_pixels_of_the_picture():
    # Rows 12..24 of 48 are 120..240 of 480, 120 high: twice that about 180 is 60..300; columns 16..24 are 160..240.
    part = closer_part(maps_with(slice(12, 24), slice(16, 24)), (480, 640), VIEWS)
    assert part == (slice(60, 300), slice(120, 280))


def test_a_part_ends_with_the_picture_and_is_never_tiny():
    part = closer_part(maps_with(slice(0, 4), slice(60, 64)), (480, 640), VIEWS)
    # 4 of 48 rows, twice as many are 80 px, less than a fifth of 480: 96 about 20, from 0 on
    assert part == (slice(0, 68), slice(556, 640))


@pytest.mark.parametrize("maps", [maps_with(slice(0, 0), slice(0, 0)), maps_with(slice(4, 44), slice(4, 60))])
def test_nothing_is_seen_closer_where_nothing_or_nearly_all_is_arms(maps):
    assert closer_part(maps, (480, 640), VIEWS) is None


def test_a_share_of_0_never_looks_closer():
    views = dataclasses.replace(VIEWS, closer_below_share=0.0)
    assert closer_part(maps_with(slice(12, 24), slice(16, 24)), (480, 640), views) is None


def test_closer_maps_stand_where_their_part_is_at_their_resolution():
    whole = maps_with(slice(12, 24), slice(16, 24))
    closer = scored(np.full((3, 48, 32), 1.0, np.float32), np.full((2, 48, 32), 2.0, np.float32))
    merged = with_part(whole, closer, (slice(60, 300), slice(120, 280)), (480, 640))
    # 48 cells for 240 rows: 5 px a cell, 96 x 128 cells for the picture
    assert merged.seg_logits.shape == (3, 96, 128) and merged.energies.shape == (2, 96, 128)
    inside = merged.energies[:, 12:60, 24:56]
    np.testing.assert_array_equal(inside, closer.energies)
    np.testing.assert_array_equal(merged.seg_logits[:, 12:60, 24:56], closer.seg_logits)
    outside = np.ones((96, 128), bool)
    outside[12:60, 24:56] = False
    assert (merged.energies[:, outside] < 0.01).all()
    np.testing.assert_allclose(merged.scores, closer.scores, atol=1e-6)
