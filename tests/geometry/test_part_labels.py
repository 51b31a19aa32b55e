"""What part labels say: whose hand a pixel shows, and how much of a hand is in view."""

import numpy as np

from twohands.geometry.part_labels import hand_classes, visible_share
from twohands.skeleton import LEFT, RIGHT, part_label


def test_the_arm_belongs_to_its_hand():
    labels = np.arange(15, dtype=np.uint8).reshape(3, 5)
    assert hand_classes(labels).ravel().tolist() == [0] + 7 * [1] + 7 * [2]
    assert hand_classes(labels).dtype == np.uint8


def test_joints_count_on_their_own_hand_or_arm_alone():
    """Left half a left finger, right half the right arm; the third joint is on the border's right, the last outside."""
    labels = np.zeros((10, 10), np.uint8)
    labels[:, :5] = part_label(LEFT, 2)
    labels[:, 5:] = part_label(RIGHT, 0)
    points = np.array([[1.0, 1.0], [4.9, 9.9], [5.0, 1.0], [-1.0, 2.0]])
    assert visible_share(points, labels, LEFT) == 0.5
    assert visible_share(points, labels, RIGHT) == 0.25
    assert np.isnan(visible_share(points, None, LEFT))


def test_unknown_joints_and_those_beside_the_picture_are_hidden():
    labels = np.full((4, 6), part_label(RIGHT, 1), np.uint8)
    points = np.array([[np.nan, np.nan], [6.0, 1.0], [1.0, 4.0], [-0.1, 1.0], [5.9, 3.9]])
    assert visible_share(points, labels, RIGHT) == 0.2
    assert visible_share(points, labels, LEFT) == 0
