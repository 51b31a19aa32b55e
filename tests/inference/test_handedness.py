"""Which candidate is which hand."""

import numpy as np
import pytest

from twohands.geometry.segmentation import log_odds, probability
from twohands.inference.decision import DecisionConfig
from twohands.inference.detection import corrected_masks
from twohands.inference.handedness import Candidates, assign_handedness, palm_distance, rescore

RULES = DecisionConfig()
POSE_WEIGHT = 1 - RULES.seg_weight
MERGED_WEIGHT = 1 - RULES.merged_seg_weight
BESIDE, FAR = 0.2, np.inf
"""Distances of candidates that are neither in one place nor apart, and that are."""
NO = np.nan
MEETING = np.array([[1, 0, 4, 1], [3, 0, 5, 1.0]])
APART = np.array([[1, 0, 3, 1], [3, 0, 5, 1.0]])
SURE = [0.95, 0.95]


def answer(seg_scores, logits, mirrored, *, merged=None, distance=BESIDE, was_present=None, rules=RULES):
    """source and logits of `assign_handedness`."""
    given = Candidates(np.array(seg_scores), logits, mirrored, merged, distance, was_present)
    found = assign_handedness(given, rules)
    return found.source, found.logits


def test_log_odds_by_hand():
    np.testing.assert_allclose(log_odds(np.array([0.5, 0.75, 0.1])), [0, np.log(3), -np.log(9)])
    assert np.isfinite(log_odds(np.array([0.0, 1.0]))).all()
    np.testing.assert_allclose(probability(np.array([0, np.log(3), -np.log(9)])), [0.5, 0.75, 0.1])


@pytest.mark.parametrize(
    ("seg_scores", "own", "mirrored", "source"),
    [
        (SURE, [6, 6], [NO, NO], [0, 1]),  # two good hands
        (SURE, [6, -10], [NO, -9], [0, -1]),  # the right one is nothing
        ([0.95, 0.5], [6, -6], [NO, 5], [0, -1]),  # the right one is a ghost of the left one, which is there already
        ([0.4, 0.95], [-1, -6], [-2, 6], [1, -1]),  # a left hand, best seen where the right one was expected
        ([0.1, 0.95], [NO, -6], [NO, 6], [1, -1]),  # the same, and nothing was found for the left one
        (SURE, [-6, -6], [6, 6], [1, 0]),  # the two are swapped
        (SURE, [-8, -8], [-8, -8], [-1, -1]),  # no hands at all
        ([0.35, 0.01], [4, NO], [NO, NO], [0, -1]),  # HandSegNet was in doubt, PoseNet2D is not
    ],
)
def test_the_most_probable_answer(seg_scores, own, mirrored, source):
    found, values = answer(seg_scores, np.array(own, float), np.array(mirrored, float))
    assert found.tolist() == source
    assert np.isfinite(values[found >= 0]).all() and np.isnan(values[found < 0]).all()


def test_mirrored_evidence_gives_the_mirrored_answer():
    rng = np.random.default_rng(0)
    for i in range(200):
        scores, own, mirrored = rng.random(2), *rng.normal(0, 4, (2, 2))
        source, values = answer(scores, own, mirrored, distance=FAR if i < 100 else BESIDE)
        swapped, swapped_values = answer(scores[::-1], own[::-1], mirrored[::-1], distance=FAR if i < 100 else BESIDE)
        assert swapped.tolist() == np.array([1, 0, -1])[source[::-1]].tolist()
        np.testing.assert_array_equal(swapped_values, values[::-1])


def test_two_hands_in_one_place_need_more_evidence():
    """Seen merged, it is one left hand, as probable as the left one of two."""
    half_the_cost = 0.5 * RULES.same_place_cost / POSE_WEIGHT
    scores, mirrored = np.array([0.5, 0.5]), np.full(2, NO)
    merged = np.array([4.0 * POSE_WEIGHT / MERGED_WEIGHT, -9.0])
    doubtful, clear = np.array([4.0, half_the_cost]), np.array([4.0, 3 * half_the_cost])
    assert answer(scores, doubtful, mirrored)[0].tolist() == [0, 1]
    assert answer(scores, doubtful, mirrored, merged=merged)[0].tolist() == [0, -1]
    assert answer(scores, clear, mirrored, merged=merged)[0].tolist() == [0, 1]


def test_the_second_hand_needs_less_evidence_where_it_stands_apart():
    half = 0.5 * RULES.second_hand_bonus / POSE_WEIGHT
    scores, mirrored = np.array([0.5, 0.5]), np.full(2, NO)
    beside_a_hand, beside_a_ghost = np.array([-half, 0.1]), np.array([-half, -0.1])
    assert answer(scores, beside_a_hand, mirrored)[0].tolist() == [-1, 1]
    source, values = answer(scores, beside_a_hand, mirrored, distance=FAR)
    assert source.tolist() == [0, 1]
    np.testing.assert_allclose(values, [0.5 * RULES.second_hand_bonus, 0.1 * POSE_WEIGHT])
    ghosts, values = answer(scores, beside_a_ghost, mirrored, distance=FAR)
    assert ghosts.tolist() == [0, 1]  # for the last word to decide
    np.testing.assert_allclose(values, [-0.5 * RULES.second_hand_bonus, -0.1 * POSE_WEIGHT])
    too_little = -half - (RULES.provisional_logit + RULES.second_hand_bonus) / POSE_WEIGHT
    assert answer(scores, np.array([too_little, 6.0]), mirrored, distance=FAR)[0].tolist() == [-1, 1]


def test_what_no_other_candidate_is_near_may_wait_for_the_last_word():
    least = -RULES.provisional_logit / POSE_WEIGHT
    scores, mirrored, below, above = np.array([0.5, 0.5]), np.full(2, NO), least - 0.1, least + 0.1
    assert answer(scores, np.array([np.nan, above]), mirrored, distance=FAR)[0].tolist() == [-1, 1]
    assert answer(scores, np.array([np.nan, below]), mirrored, distance=FAR)[0].tolist() == [-1, -1]
    assert answer(scores, np.array([above, above]), mirrored, distance=FAR)[0].tolist() == [0, 1]
    assert answer(scores, np.array([above, below]), mirrored, distance=FAR)[0].tolist() == [0, -1]
    assert answer(scores, np.array([above, above]), mirrored)[0].tolist() == [-1, -1]
    _, values = answer(scores, np.array([np.nan, above]), mirrored, distance=FAR)
    np.testing.assert_allclose(values, [np.nan, above * POSE_WEIGHT])


def test_whose_hand_it_is_alone_is_told_by_the_merged_of_it():
    """Both parts look like hands, more so the one found as the right one; seen merged, it is a left hand."""
    scores, own, mirrored = np.array([0.5, 0.5]), np.array([1.0, 3.0]), np.full(2, NO)
    assert answer(scores, own, mirrored, merged=own)[0].tolist() == [-1, 1]
    source, values = answer(scores, own, mirrored, merged=np.array([4.5, -2.0]))
    assert source.tolist() == [0, -1]
    np.testing.assert_allclose(values, [MERGED_WEIGHT * 4.5, NO])
    two = answer(scores, np.full(2, 6.0), mirrored, merged=np.array([3.0, -2.0]))
    assert two[0].tolist() == [0, 1]
    assert answer(scores, own, mirrored, merged=np.full(2, -5.0))[0].tolist() == [0, 1]
    assert answer(scores, -own, mirrored, merged=np.full(2, -5.0))[0].tolist() == [-1, -1]


def test_a_hand_that_was_there_before_needs_less_evidence_and_a_new_one_more():
    half = 0.5 * RULES.was_present_logit / POSE_WEIGHT
    doubtful = np.array([0.5, 0.5]), np.array([-half, half]), np.full(2, NO)
    assert answer(*doubtful)[0].tolist() == [-1, 1]
    source, values = answer(*doubtful, was_present=np.array([True, False]))
    assert source.tolist() == [0, -1]
    np.testing.assert_allclose(values, [0.5 * RULES.was_present_logit, NO])
    assert answer(*doubtful, was_present=np.array([True, True]))[0].tolist() == [0, 1]


def test_the_last_view_is_scored_again():
    """0.3 of what PoseNet2D takes back, and 4 for each unit of the joints' mean score beside 0.775."""
    logits, first, last = np.full(4, 0.5), np.full(4, 1.0), np.array([1.0, -1.0, 1.0, 3.0])
    scores = np.repeat([[0.775], [0.775], [0.575], [0.875]], 21, axis=1)
    np.testing.assert_allclose(rescore(logits, first, last, scores, RULES), [0.5, -0.1, -0.3, 1.5])


def test_how_far_palms_are_apart():
    joints_px = np.random.default_rng(0).uniform(0, 100, (2, 21, 2))  # fingers may be anywhere
    joints_px[1, [0, 9]] = joints_px[0, [0, 9]] + [[3.0, 4.0], [0.0, 15.0]]
    boxes_px = np.array([[0, 0, 100, 80], [0, 0, 50, 50.0]])
    assert palm_distance(joints_px, boxes_px) == pytest.approx(0.1)
    assert palm_distance(joints_px[::-1], boxes_px[::-1]) == pytest.approx(0.1)


MASKS = np.array([[0, 1, 1, 2, 2, 0]], np.uint8)


@pytest.mark.parametrize(
    ("source", "boxes_px", "expected"),
    [
        ([0, 1], MEETING, [0, 1, 1, 2, 2, 0]),
        ([0, -1], MEETING, [0, 1, 1, 1, 1, 0]),  # the ghost's pixels belong to the hand that it was
        ([0, -1], APART, [0, 1, 1, 0, 0, 0]),
        ([1, -1], MEETING, [0, 1, 1, 1, 1, 0]),
        ([1, -1], APART, [0, 0, 0, 1, 1, 0]),
        ([1, 0], APART, [0, 2, 2, 1, 1, 0]),
        ([-1, -1], MEETING, [0, 0, 0, 0, 0, 0]),
    ],
)
def test_masks_follow_the_answer(source, boxes_px, expected):
    masks = corrected_masks(MASKS, np.array(source), boxes_px)
    assert masks[0].tolist() == expected and masks.dtype == np.uint8
    assert (masks is MASKS) == (source == [0, 1])


@pytest.mark.parametrize(
    ("source", "boxes_px", "expected"),
    [
        ([0, 1], MEETING, [3, 1, 2, 4]),
        ([0, -1], MEETING, [3, 1, 1, 3]),
        ([0, -1], APART, [3, 1, 0, 0]),
        ([1, 0], APART, [4, 2, 1, 3]),
    ],
)
def test_what_is_perhaps_a_hands_goes_with_the_hand(source, boxes_px, expected):
    masks = corrected_masks(np.array([[3, 1, 2, 4]], np.uint8), np.array(source), boxes_px)
    assert masks[0].tolist() == expected


def test_masks_of_a_lone_candidate():
    alone, box_px = np.array([[0, 1, 1, 0]], np.uint8), np.array([[1, 0, 3, 1], [NO] * 4])
    assert corrected_masks(alone, np.array([0, -1]), box_px) is alone  # nothing to look at again
    assert corrected_masks(alone, np.array([-1, 0]), box_px).tolist() == [[0, 2, 2, 0]]
    assert corrected_masks(alone, np.array([-1, -1]), box_px).tolist() == [[0, 0, 0, 0]]
