"""Which candidate is which hand."""

import dataclasses
import itertools

import numpy as np
import pytest

from twohands.geometry.body import Body
from twohands.geometry.segmentation import BoxEvidence, box_evidence, class_leads, log_odds, probability
from twohands.inference.decision import FIRST_FEATURES, LAST_FEATURES, DecisionConfig
from twohands.inference.handedness import (
    ANSWERS,
    KEPT,
    Before,
    Evidence,
    LastLook,
    assign_handedness,
    first_features,
    last_features,
    palm_distance,
    probabilities,
    rescore,
)
from twohands.inference.segmenter import corrected_masks
from twohands.types import HandPose, PinholeCamera, TwoHandPose

NO = np.nan
SIZE = (100, 200)
MEETING = np.array([[1, 0, 4, 1], [3, 0, 5, 1.0]])
APART = np.array([[1, 0, 3, 1], [3, 0, 5, 1.0]])
BOXES = np.array([[20.0, 10, 60, 50], [120, 20, 140, 30]])
NOTHING = BoxEvidence(*np.zeros((4, 2, 2)))
RULES = DecisionConfig({"pose": 1.0, "swapped": -1.0, "merged_pose": 1.0, "both": -0.5}, {"first": 1.0})


def known(own, mirrored=(NO, NO), boxes_px=BOXES, **more) -> Evidence:
    """Evidence of PoseNet2D alone."""
    pose = np.array([[own[0], mirrored[1]], [mirrored[0], own[1]]], float)
    return Evidence(SIZE, boxes_px, NOTHING, pose, np.where(np.isnan(pose), NO, 0.8), **more)


def random_evidence(rng, *, merged: bool, alone: bool) -> Evidence:
    """Of everything."""
    pose = rng.normal(0, 4, (2, 2))
    low = rng.uniform(0, 50, (2, 2))
    boxes_px = np.concatenate([low, low + rng.uniform(5, 50, (2, 2))], axis=1)
    if alone:
        pose[:, 1], boxes_px[1] = NO, NO
    maps = BoxEvidence(*rng.normal(0, 2, (2, 2, 2)), rng.uniform(0, 1, (2, 2)), rng.normal(0, 1, (2, 2)))
    together = (rng.normal(0, 4, 2), rng.uniform(0.5, 1, 2)) if merged else (None, None)
    before = Before(boxes_px[::-1] + rng.normal(0, 3, (2, 4)), np.array([rng.normal(), NO]))
    joints = np.where(np.isnan(pose), NO, 0.9 * pose**2 / (1 + pose**2))
    body = Body(
        rng.uniform(0, 100, (2, 2)), np.zeros((2, 4)), rng.uniform(0, 1, 2), *np.zeros((2, 2, 2)), *np.zeros((2, 3))
    )
    check, palm = rng.normal(0, 4, (3, 2)), rng.normal(3, 2, (3, 3))
    said = check[:2], check[2], palm, body
    return Evidence(SIZE, boxes_px, maps, pose, joints, *together, rng.uniform(0, 1.5), before, *said)


def mirrored_boxes(boxes_px):
    """Of the mirror image, sides exchanged."""
    flipped = boxes_px[::-1].copy()
    flipped[:, [0, 2]] = SIZE[1] - flipped[:, [2, 0]]
    return flipped


def mirrored_body(body: Body) -> Body:
    palms_px = body.palms_px[::-1] * [-1, 1] + [SIZE[1], 0]
    return body._replace(palms_px=palms_px, visible=body.visible[::-1])


def mirrored(given: Evidence) -> Evidence:
    """Of the mirror image: left is right in everything."""
    maps, before = given.maps, given.before
    return dataclasses.replace(
        given,
        boxes_px=mirrored_boxes(given.boxes_px),
        maps=BoxEvidence(
            *(values[::-1, ::-1] for values in (maps.energy, maps.lead, maps.share)), maps.arm[::-1] * [-1, 1]
        ),
        pose=given.pose[::-1, ::-1],
        joints=given.joints[::-1, ::-1],
        merged_pose=None if given.merged_pose is None else given.merged_pose[::-1],
        merged_joints=None if given.merged_joints is None else given.merged_joints[::-1],
        check=given.check[::-1] * [1, -1],
        merged_check=given.merged_check * [1, -1],
        palm=given.palm[[1, 0, 2]] * [1, 1, -1],
        body=None if given.body is None else mirrored_body(given.body),
        before=None if before is None else Before(mirrored_boxes(before.boxes_px), before.logits[::-1]),
    )


def random_rules(rng) -> DecisionConfig:
    names = (FIRST_FEATURES, LAST_FEATURES)
    return DecisionConfig(*(dict(zip(of, rng.normal(size=len(of)), strict=True)) for of in names))


def test_log_odds_by_hand():
    np.testing.assert_allclose(log_odds(np.array([0.5, 0.75, 0.1])), [0, np.log(3), -np.log(9)])
    assert np.isfinite(log_odds(np.array([0.0, 1.0]))).all()
    np.testing.assert_allclose(probability(np.array([0, np.log(3), -np.log(9)])), [0.5, 0.75, 0.1])


def test_chances_by_hand():
    chances = probabilities(np.array([0.0, np.log(2.0), -np.inf, np.log(5.0)]))
    np.testing.assert_allclose(chances, [1 / 8, 2 / 8, 0, 5 / 8])
    assert np.isfinite(probabilities(np.array([0.0, 2000.0]))).all()


@pytest.mark.parametrize(
    ("own", "other", "source"),
    [
        ([6, 6], [NO, NO], [0, 1]),  # two good hands
        ([6, -6], [NO, NO], [0, -1]),  # the right one is nothing
        ([6, -6], [-6, 5], [0, -1]),  # the right one is a ghost of the left one, which is there already
        ([-1, -6], [-2, 6], [1, -1]),  # a left hand, best seen where the right one was expected
        ([-6, -6], [6, 6], [1, 0]),  # the two are swapped
        ([-6, -6], [-6, -6], [-1, -1]),  # no hands at all
        ([-6, -6], [0.5, -6], [-1, -1]),  # being on the other side costs 1
        ([0.2, 0.2], [NO, NO], [-1, -1]),  # two cost 0.5: either is there by 2.13 of 4.35
        ([0.6, 0.4], [NO, NO], [0, 1]),  # by 3.47 and 3.14 of 5.96, though LEFT alone is the most probable answer
    ],
)
def test_the_answer_that_is_right_of_the_most_sides(own, other, source):
    found = assign_handedness(known(own, other), RULES)
    assert found.source.tolist() == source
    assert np.isfinite(found.logits[found.source >= 0]).all() and np.isnan(found.logits[found.source < 0]).all()


def test_scores_and_chances_by_hand():
    """Nobody, LEFT of 1, RIGHT of 2, and both of 1 + 2 - 0.5: LEFT is there in two of four answers."""
    weights = np.exp([0.0, 1.0, 2.0, 2.5])
    found = assign_handedness(known([1, 2]), RULES)
    assert found.source.tolist() == [0, 1]
    left, right = (weights[[1, 3]].sum(), weights[[0, 2]].sum()), (weights[2:].sum(), weights[:2].sum())
    np.testing.assert_allclose(found.logits, [np.log(left[0] / left[1]), np.log(right[0] / right[1])])


def test_features_of_a_hand_by_hand():
    """A LEFT candidate of 40 pixels in a picture of 200 by 100, at its left; the other side's log-odds exceed 6."""
    maps = BoxEvidence(
        np.array([[1.0, 0], [-2, 0]]),
        np.array([[3.0, 0], [9, 0]]),
        np.array([[0.48, 0], [0.08, 0]]),
        np.array([[-0.5, 0.8], [0, 0]]),
    )
    pose, joints = np.array([[5.0, NO], [8.0, NO]]), np.array([[0.9, NO], [0.7, NO]])
    boxes_px = np.array([[20.0, 10, 60, 50], [NO] * 4])
    before = Before(np.array([[20.0, 10, 60, 30], [200.0, 0, 210, 9]]), np.array([2.0, 9.0]))
    palms_px = np.array([[40.0, 30], [40, 54]])  # in the middle of the box, and a share of .6 of its side beside it
    body = Body(palms_px, np.zeros((2, 4)), np.array([0.5, 0.9]), *np.zeros((2, 2, 2)), *np.zeros((2, 3)))
    rows = first_features(Evidence(SIZE, boxes_px, maps, pose, joints, before=before, body=body))
    of = dict(zip(FIRST_FEATURES, rows[ANSWERS.index((0, -1))], strict=True))
    expected = {"hand": 1, "energy": 1, "energy_other": -2, "lead": 3, "lead_other": 6, "share": np.log(5)}
    expected |= {
        "swapped": 0,
        "pose": 5,
        "pose_contrast": -1,
        "mirror_unseen": 0,
        "joints": 0.1,
        "joints_contrast": 0.2,
        "size": 0,
    }
    expected |= {"arm_outside": 0.5, "arm_below": 0.8, "arm_outside_below": 0.4, "outside": 0.3}
    expected |= {"body": 0.5, "body_side": 0.5 - 0.9 / np.e, "body_both": 0.9 / np.e}
    expected |= {"was_present": 1, "held": 1.0, "held_other": 0, "check_unseen": 1}
    assert of == pytest.approx(dict.fromkeys(FIRST_FEATURES, 0.0) | expected)
    assert np.isnan(rows[[i for i, source in enumerate(ANSWERS) if 1 in source]]).all()
    assert (rows[0] == 0).all()


def test_answers_never_use_one_candidate_twice_and_name_no_missing_one():
    assert all(a != b or a == -1 for a, b in ANSWERS) and len(set(ANSWERS)) == len(ANSWERS) == 7
    rng = np.random.default_rng(1)
    for merged, alone in ((False, False), (False, True), (True, False)):
        for _ in range(30):
            given = random_evidence(rng, merged=merged, alone=alone)
            source = assign_handedness(given, random_rules(rng)).source
            assert source[0] != source[1] or source[0] == -1
            assert not (alone and 1 in source)


@pytest.mark.parametrize(("merged", "alone"), [(False, False), (False, True), (True, False)])
def test_the_mirror_image_has_the_mirrored_answer(merged, alone):
    rng = np.random.default_rng(0)
    for _ in range(50):
        given, rules = random_evidence(rng, merged=merged, alone=alone), random_rules(rng)
        copied = mirrored(mirrored(given))
        np.testing.assert_array_equal(given.pose, copied.pose)
        one, other = assign_handedness(given, rules), assign_handedness(mirrored(given), rules)
        assert other.source.tolist() == np.array([1, 0, -1])[one.source[::-1]].tolist()
        np.testing.assert_allclose(other.logits, one.logits[::-1], rtol=1e-9, atol=1e-9)


def test_the_mirror_image_has_the_mirrored_last_answer():
    rng = np.random.default_rng(0)
    for _ in range(50):
        rules = random_rules(rng)
        look = LastLook(np.array([0, 1]), *rng.normal(0, 2, (2, 2)), *rng.uniform(0.1, 1, (2, 2)), rng.uniform(0, 1.2))
        swapped = [values[::-1] for values in (look.first, look.pose, look.joints, look.size)]
        other = LastLook(np.array([0, 1]), *swapped, look.palm_distance)
        (kept, logits), (other_kept, other_logits) = rescore(look, rules), rescore(other, rules)
        assert kept.tolist() == other_kept[::-1].tolist()
        np.testing.assert_allclose(logits, other_logits[::-1], rtol=1e-9, atol=1e-9)


def test_one_hand_of_two_candidates_in_one_place_is_told_by_both_together():
    """Both parts look like hands, more so the one found as the right one; seen merged, it is a left hand."""
    parts = known([1.0, 3.0], merged_pose=np.array([4.5, -2.0]), merged_joints=np.array([0.8, 0.8]))
    careful = dataclasses.replace(RULES, first={**RULES.first, "both_in_one_place": -2.0})
    assert assign_handedness(known([1.0, 3.0]), careful).source.tolist() == [0, 1]
    assert assign_handedness(parts, careful).source.tolist() == [0, -1]
    possible = np.isfinite(first_features(parts)[:, 0])
    assert [ANSWERS[i] for i in np.flatnonzero(possible)] == [(-1, -1), (0, -1), (-1, 1), (0, 1)]


def test_what_was_in_a_place_before_stays_there_until_the_evidence_outweighs_it():
    rules = dataclasses.replace(RULES, first={**RULES.first, "held": 1.0, "held_other": -1.0})
    was = np.array([BOXES[0], [NO] * 4])
    alone = np.array([BOXES[0], [NO] * 4])
    for surely, side in ((0.5, 1), (2.0, 0)):  # now as likely RIGHT as LEFT, but for 2
        given = known([1.0, NO], [4.0, NO], boxes_px=alone, before=Before(was, np.array([surely, NO])))
        source = assign_handedness(given, rules).source
        assert source.tolist() == ([0, -1] if side == 0 else [-1, 0])


def test_the_frame_before_in_words_of_an_estimate():
    box_px = np.array([1.0, 2, 3, 4])
    camera = PinholeCamera.from_fov(60, 200, 100)
    before = Before.of(TwoHandPose(HandPose(present=True, score=0.75, box_px=box_px), HandPose(present=False), camera))
    np.testing.assert_allclose(before.logits, [np.log(3), NO])
    np.testing.assert_array_equal(before.boxes_px, [box_px, [NO] * 4])
    assert Before.of(TwoHandPose(HandPose(present=True), HandPose(present=False), camera)).logits[0] == 0


def test_the_last_look_by_hand():
    """LEFT -1 + 2 * 0.1 and RIGHT 3: only RIGHT stays; the chances are those of four answers."""
    rules = DecisionConfig(last={"pose": 1.0, "joints": 2.0, "both_near": -1.0})
    look = LastLook(np.array([0, 1]), np.zeros(2), np.array([-1.0, 3.0]), np.array([0.9, 0.8]), np.ones(2), 0.5)
    kept, logits = rescore(look, rules)
    weights = np.exp([0.0, -0.8, 3.0, 2.2 - np.log(2)])
    assert kept.tolist() == [False, True]
    chances = [weights[[1, 3]].sum(), weights[2:].sum()] / weights.sum()
    np.testing.assert_allclose(logits, log_odds(np.array(chances)))
    alone = dataclasses.replace(look, source=np.array([0, -1]), palm_distance=np.inf)
    kept, logits = rescore(alone, rules)
    assert kept.tolist() == [False, False]
    np.testing.assert_allclose(logits, [-0.8, NO])
    assert np.isnan(last_features(alone)[[i for i, (_, right) in enumerate(KEPT) if right]]).all()


def test_what_goes_in_stays_as_it_is():
    rng = np.random.default_rng(3)
    given, rules = random_evidence(rng, merged=True, alone=False), random_rules(rng)
    arrays = [given.boxes_px, given.pose, given.joints, given.maps.energy, given.maps.arm, given.before.boxes_px]
    copies = [array.copy() for array in arrays]
    first, second = assign_handedness(given, rules), assign_handedness(given, rules)
    np.testing.assert_array_equal(first.logits, second.logits)
    for array, copy in itertools.zip_longest(arrays, copies):
        np.testing.assert_array_equal(array, copy)


def test_what_maps_say_in_a_box_by_hand():
    """Map cells of 10 pixels; the left hand fills four cells, the arm below it two more, and a box shows both sides."""
    seg_logits, energies = np.zeros((3, 6, 8)), np.full((2, 6, 8), 0.1)
    seg_logits[0] = 2.0
    seg_logits[1, 1:5, 1:3] = 5.0
    seg_logits[1, 3:5, 2] = 0.0  # the arm is one column
    energies[0, 2, 2], energies[1, 1, 1] = 0.75, 0.5
    boxes_px = np.array([[10.0, 10, 30, 30], [NO] * 4])
    found = box_evidence(energies, class_leads(seg_logits), boxes_px, (60, 80))
    np.testing.assert_allclose(found.energy, [[np.log(3), 0], [0, 0]])
    np.testing.assert_allclose(found.lead, [[3, 0], [-5, 0]])
    np.testing.assert_allclose(found.share, [[1, 0], [0, 0]])
    np.testing.assert_allclose(found.arm, [[(15 - 20) / 20, (40 - 20) / 20], [0, 0]])


def test_where_maps_show_a_hand_does_not_change_what_they_say():
    """Only the part of the maps that shows anything is looked at: moved by whole cells, or beside a region that does
    not reach into the box, everything stays, and a box that meets no region has no arm."""
    rng = np.random.default_rng(0)
    small = np.where(rng.random((2, 7, 9)) < 0.6, rng.uniform(0, 4, (2, 7, 9)), -3).astype(np.float32)
    found = []
    for top, left in ((0, 0), (11, 3), (23, 31)):
        leads, energies = np.full((2, 30, 40), -5, np.float32), np.full((2, 30, 40), 0.1)
        leads[:, top : top + 7, left : left + 9] = small
        boxes_px = np.array([[left + 2, top + 1, left + 6, top + 4], [20.0, 0, 24, 5]])
        found.append(box_evidence(energies, leads, boxes_px, (30, 40)))
        leads[:, 8, 38] = 6.0  # another region
        found.append(box_evidence(energies, leads, boxes_px, (30, 40)))
    assert np.abs(found[0].arm[0]).min() > 0
    for other in found:
        np.testing.assert_allclose(other.arm, found[0].arm)
        np.testing.assert_array_equal(other.share, found[0].share)
        np.testing.assert_array_equal(other.lead, found[0].lead)
        assert not other.arm[1].any() and not other.share[:, 1].any()


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
