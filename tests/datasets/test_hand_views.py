"""Where the hands of a labelled picture are."""

import dataclasses

import numpy as np
import pytest
from tests.datasets.drawn import sample

from twohands.datasets.hand_views import boxes_inside, hand_box, hand_classes
from twohands.skeleton import LEFT, RIGHT


def test_hand_classes_put_the_arm_with_its_hand():
    labels = np.array([[0, 1, 2, 7, 8, 9, 14]], np.uint8)
    assert hand_classes(labels).tolist() == [[0, 1, 1, 1, 2, 2, 2]]
    assert hand_classes(labels).dtype == np.uint8


def test_hand_box_is_tight_and_clipped_to_the_picture():
    original = sample()
    points = original.joints_px.copy()
    box = hand_box(original, LEFT)
    assert np.allclose(box, [*points[LEFT].min(axis=0), *points[LEFT].max(axis=0)])
    points[LEFT, 0] = [-50, 500]
    box = hand_box(dataclasses.replace(original, joints_px=points), LEFT)
    assert (box[0], box[3]) == (0, original.image.shape[0])


def test_hand_box_of_absent_and_outside_hands():
    assert hand_box(sample(present=(True, False)), RIGHT) is None
    original = sample()
    away = dataclasses.replace(original, joints_px=original.joints_px - [1000, 0])
    assert hand_box(away, LEFT) is None


@pytest.mark.parametrize(("left", "there"), [(20.0, True), (-50.0, True), (-85.0, False), (-200.0, False)])
def test_a_hand_of_which_a_sliver_is_left_is_absent(left, there):
    """100 pixels wide: half of it inside is a hand, 15 % are none."""
    hand = np.array([[left, 10.0], [left + 100, 10.0], [left + 100, 60.0], [np.nan, np.nan]])
    boxes, present = boxes_inside(hand[None], 240, 135)
    assert present.tolist() == [there]
    assert boxes[0].tolist() == ([max(left, 0), 10, left + 100, 60] if there else [0, 0, 0, 0])
