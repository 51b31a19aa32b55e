"""Which detection is which hand: by the system's word with one favour, or by the labels."""

import numpy as np

from twohands.peers.base import DetectedHand, by_labels, by_own_handedness
from twohands.skeleton import LEFT, RIGHT

NOWHERE = np.full((2, 21, 2), np.nan)


def detected(side: int, score: float, u: float = 0.0) -> DetectedHand:
    return DetectedHand(side, score, np.full((21, 2), u), np.zeros((21, 3)))


def labelled(left: float, right: float) -> np.ndarray:
    return np.stack([np.full((21, 2), left), np.full((21, 2), right)])


def test_own_word() -> None:
    left, right = detected(LEFT, 0.6), detected(RIGHT, 0.9)
    assert by_own_handedness([right, left]) == (left, right)
    assert by_own_handedness([right]) == (None, right)
    assert by_own_handedness([]) == (None, None)


def test_of_two_with_one_side_the_less_certain_gives_way() -> None:
    sure, unsure = detected(RIGHT, 0.9), detected(RIGHT, 0.5)
    assert by_own_handedness([unsure, sure]) == (unsure, sure)


def test_labels_overrule_the_systems_word() -> None:
    near_left, near_right = detected(RIGHT, 0.9, u=12), detected(RIGHT, 0.8, u=95)
    present = np.array([True, True])
    assert by_labels([near_left, near_right], labelled(10, 100), present) == (near_left, near_right)
    assert by_labels([near_right], labelled(10, 100), present) == (None, near_right)
    assert by_labels([], labelled(10, 100), present) == (None, None)


def test_the_sum_decides_not_the_first_come() -> None:
    """Both lie nearer to the left hand, at 10; with the one at 40 on the right the sum is 5 + 60 < 30 + 85."""
    a, b = detected(LEFT, 0.9, u=40), detected(LEFT, 0.8, u=15)
    assert by_labels([a, b], labelled(10, 100), np.array([True, True])) == (b, a)


def test_a_detection_too_many_stays_a_false_find() -> None:
    near, far = detected(LEFT, 0.5, u=100), detected(LEFT, 0.9, u=300)
    joints = labelled(np.nan, 100)
    assert by_labels([far, near], joints, np.array([False, True])) == (far, near)
    assert by_labels([far], joints, np.array([False, True])) == (None, far)
    left, right = by_labels([far], NOWHERE, np.array([False, False]))
    assert (left, right).count(far) == 1


def test_only_the_two_best_count() -> None:
    hands = [detected(LEFT, 0.9, 10), detected(LEFT, 0.8, 100), detected(LEFT, 0.1, 100)]
    assert by_labels(hands, labelled(10, 100), np.array([True, True])) == (hands[0], hands[1])
