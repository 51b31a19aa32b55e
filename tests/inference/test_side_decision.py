"""Which candidate is which hand in a clip: what was known joins what the picture says."""

import numpy as np
import pytest
from tests.inference.test_handedness import BOXES, RULES, known, random_evidence, random_rules

from twohands.inference.decision import DecisionConfig
from twohands.inference.handedness import assign_handedness
from twohands.inference.side_decision import assign_in_clip
from twohands.inference.side_keeping import NOTHING_KNOWN, SideMemory
from twohands.skeleton import LEFT, RIGHT
from twohands.types import HandPose, PinholeCamera, TwoHandPose

CAMERA = PinholeCamera.from_fov(60, 200, 100)


def remembered(boxes_px, logits, frames: int = 30) -> SideMemory:
    """Of hands that stood in these places and were said to be LEFT and RIGHT with these log-odds."""
    left, right = (
        HandPose(True, 0.9, box_px=box, side_logit=logit) for box, logit in zip(boxes_px, logits, strict=True)
    )
    memory = NOTHING_KNOWN
    for index in range(frames):
        memory = memory.after(TwoHandPose(left, right, CAMERA, index=index))
    return memory


def test_without_memory_it_is_the_decision_of_single_pictures():
    rng = np.random.default_rng(0)
    for number in range(60):
        evidence = random_evidence(rng, merged=number % 3 == 0, alone=number % 5 == 0)
        rules = random_rules(rng)
        expected, (found, sides) = (
            assign_handedness(evidence, rules),
            assign_in_clip(evidence, evidence.boxes_px, rules, NOTHING_KNOWN),
        )
        np.testing.assert_array_equal(found.source, expected.source)
        np.testing.assert_allclose(found.logits, expected.logits, atol=1e-9)
        assert (np.isnan(sides) == (found.source < 0)).all()


def test_what_was_known_outweighs_a_single_contrary_picture():
    """Both hands look a little more like the other one."""
    evidence = known((1.0, 1.0), (2.0, 2.0))
    assert assign_in_clip(evidence, evidence.boxes_px, RULES, NOTHING_KNOWN)[0].source.tolist() == [
        LEFT,
        RIGHT,
    ]  # "swapped" costs 1
    contrary = known((1.0, 1.0), (4.0, 4.0))
    assert assign_in_clip(contrary, contrary.boxes_px, RULES, NOTHING_KNOWN)[0].source.tolist() == [RIGHT, LEFT]
    memory = remembered(BOXES, (2.0, 2.0))
    assignment, sides = assign_in_clip(contrary, contrary.boxes_px, RULES, memory)
    assert assignment.source.tolist() == [LEFT, RIGHT]
    assert (sides < 0).all(), "the picture alone says otherwise, and that is what is remembered"


def test_a_hand_whose_side_is_known_is_hardly_more_present():
    """Certainty of the side replaces even chances: twice as likely, no more."""
    evidence = known((2.0, np.nan), (np.nan, np.nan), np.array([BOXES[0], [np.nan] * 4]))
    fresh = assign_in_clip(evidence, evidence.boxes_px, RULES, NOTHING_KNOWN)[0]
    assignment, sides = assign_in_clip(evidence, evidence.boxes_px, RULES, remembered(BOXES, (4.0, 4.0)))
    assert assignment.source.tolist() == fresh.source.tolist() == [0, -1]
    assert assignment.logits[LEFT] == pytest.approx(fresh.logits[LEFT] + np.log(2), abs=0.01)
    assert sides[LEFT] > 0 and np.isnan(sides[RIGHT])


def test_a_second_hand_in_the_place_of_a_known_one_is_not_lost():
    """Hands that touch: both candidates stand where the left hand was, and the picture is sure of both."""
    near = np.array([BOXES[0], BOXES[0] + [4, 0, 4, 0]])
    evidence = known((2.0, 2.0), (-2.0, -2.0), near)
    memory = remembered(np.array([BOXES[0], [np.nan] * 4]), (4.0, np.nan))
    assert (memory.left_logits(near) > 1).all()
    assert assign_in_clip(evidence, evidence.boxes_px, RULES, memory)[0].source.tolist() == [LEFT, RIGHT]


def test_a_hand_elsewhere_is_judged_afresh():
    memory = remembered(BOXES + 1000, (4.0, 4.0))
    evidence = known((1.0, 1.0), (4.0, 4.0))
    assert assign_in_clip(evidence, evidence.boxes_px, RULES, memory)[0].source.tolist() == [RIGHT, LEFT]


def test_a_hand_is_where_its_joints_are_not_where_its_mask_is():
    """Named case: of a left hand HandSegNet made two candidates, the second with the whole arm in its box, so that
    nobody knew that it was the same hand: where the picture liked the second a little more, it became the right one."""
    with_arm = np.array([BOXES[0], [0.0, 0.0, 200.0, 100.0]])
    evidence, rules = known((1.0, 3.0), boxes_px=with_arm), DecisionConfig({"pose": 1.0, "both": -20.0})
    memory = remembered(np.array([BOXES[0], [np.nan] * 4]), (4.0, np.nan))
    assert assign_in_clip(evidence, with_arm, rules, memory)[0].source.tolist() == [-1, 1]
    seen_px = np.array([BOXES[0], BOXES[0]])
    assert assign_in_clip(evidence, seen_px, rules, memory)[0].source.tolist() == [0, -1]


def test_of_two_candidates_that_are_one_hand_is_known_what_is_of_either():
    """Named case: a still left hand, its side unsure in every picture, was missed and then the right one: the joints of
    the second candidate lay on its arm, where less was known, and that counted for both together as the right hand."""
    evidence = known(
        (-9.0, -9.0), boxes_px=BOXES[[0, 0]], merged_pose=np.array([1.0, 3.0]), merged_joints=np.array([0.8, 0.8])
    )
    rules = DecisionConfig({"merged_pose": 1.0, "both": -20.0})
    seen_px = np.array([BOXES[0], BOXES[0] + [500, 0, 500, 0]])
    memory = remembered(np.array([BOXES[0], [np.nan] * 4]), (4.0, np.nan))
    assert abs(memory.left_logits(seen_px)[1]) < 0.01
    assert assign_handedness(evidence, rules).source.tolist() == [-1, 1]
    assert assign_in_clip(evidence, seen_px, rules, memory)[0].source.tolist() == [0, -1]
