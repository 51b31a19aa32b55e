"""Which of two pairs of pose networks knows a hand, and what is asked of which."""

import argparse
import dataclasses
from functools import partial

import cv2
import numpy as np
import pytest
from scripts import fit_second_look
from scripts.fit_second_look import Both
from tests.datasets.photographed import write_digits
from tests.inference.test_following import surely
from tests.oracles import Oracle, drawn_hands, make_card

from twohands.geometry.body import Body
from twohands.geometry.boxes import apply_homography, upright_roll_deg
from twohands.geometry.canonical import canonical_from_camera
from twohands.geometry.rotation import rotation_about_z
from twohands.inference.decision import SECOND_FEATURES, DecisionConfig
from twohands.inference.detection import Detection, HandFinder
from twohands.inference.estimator import HandEstimator
from twohands.inference.keypoints import Keypoints
from twohands.inference.placement import refine
from twohands.inference.range_sigma import with_sources
from twohands.inference.second_look import knows_better, second_features, seen_twice
from twohands.inference.stages import StageTruth
from twohands.inference.trail import Trail
from twohands.skeleton import LEFT, RIGHT, ROOT, WRIST
from twohands.types import HandCrop, TwoHandPose

SAMPLE = drawn_hands(7)
LENGTH_M = 0.1
TRUSTED = {"second": {"second": 1.8, "first_doubt": 1.0}}
"""Where the first pair's joints have a mean score below .84."""
NEVER = {"second": {"second": -1.0}}


def keypoints(scores, logits, shift_px=0.0) -> Keypoints:
    """Of hands 100 pixels large, their joints moved to the right."""
    count = len(scores)
    joints_px = np.tile(np.linspace([0.0, 0.0], [100.0, 50.0], 21), (count, 1, 1)) + np.array([shift_px, 0.0])
    crop = HandCrop(np.zeros((8, 8, 3), np.uint8), np.eye(3), LEFT, False)
    scores = np.repeat(np.array(scores)[:, None], 21, axis=1)
    return Keypoints([crop] * count, [np.zeros((21, 2, 2))] * count, joints_px, scores, np.array(logits))


def test_what_speaks_for_the_second_pair_by_hand():
    (values,) = second_features(keypoints([0.9], [2.0]), keypoints([0.5], [-9.0], shift_px=8.0))
    first, second, apart = np.log(0.11), np.log(0.51), np.log(0.02 + 0.08)
    named = dict(zip(SECOND_FEATURES, values, strict=True))
    assert named == pytest.approx(
        {
            "second": 1,
            "first_doubt": first,
            "second_doubt": second,
            "first_pose": 2,
            "second_pose": -6,  # log-odds are limited
            "second_passed": 0,
            "apart": apart,
            "first_doubt_apart": first * apart,
            "second_doubt_apart": second * apart,
        }
    )
    (surer,) = second_features(keypoints([0.9], [2.0]), keypoints([0.5], [5.0]))
    assert surer[SECOND_FEATURES.index("second_passed")] == 2, "3 is enough"


@pytest.mark.parametrize(
    ("second_px", "better", "twice"),
    [
        ([0.0, 100.0], [0, 1], [False, False]),  # each where the first pair has it
        ([0.0, 8.0], [0, 1], [False, True]),  # both on the left one
        ([92.0, 100.0], [0, 1], [True, False]),  # both on the right one
        ([92.0, 100.0], [1], [False, False]),  # of which the left one does not count
        ([0.0, 30.0], [0, 1], [False, False]),  # near each other
    ],
)
def test_a_hand_is_not_seen_where_the_other_one_is(second_px, better, twice):
    """Named case: of touching hands the second pair saw the nearer one twice, and the other one changed sides. Hands of
    100 pixels, the first pair's 100 apart."""
    first, second = (keypoints([0.9, 0.9], [2.0, 2.0], shift_px=0.0) for _ in range(2))
    for seen, shifts in ((first, [0.0, 100.0]), (second, second_px)):
        seen.joints_px[...] = seen.joints_px[:1]
        seen.joints_px[..., 0] += np.array(shifts)[:, None]
    assert seen_twice(first, second, np.array([0, 1]), np.array(better)).tolist() == twice
    alone = first.rows([0])
    assert not seen_twice(alone, second.rows([0]), np.array([0]), np.array([0])).any()


def test_the_second_pair_counts_where_its_weights_say_so():
    first, second = keypoints([0.9, 0.5], [0.0, 0.0]), keypoints([0.7, 0.7], [0.0, 0.0])
    config = DecisionConfig(second={"first_doubt": 1.0, "second_doubt": -1.0})
    assert knows_better(first, second, config).tolist() == [False, True]
    assert not knows_better(first, second, DecisionConfig()).any(), "without weights the first pair counts"


@pytest.mark.parametrize("weight", [1.0, -1.0])
@pytest.mark.parametrize(
    ("first_off", "second_off", "second_logit", "second_counts"),
    [
        (0.3, 0.1, 0.1, True),
        (0.1, 0.3, 9.0, False),
        (0.1, 0.1, 9.0, None),
        (0.3, 0.3, 9.0, None),
        (np.nan, np.nan, 9.0, None),
        (np.nan, 0.1, 9.0, True),
        (0.3, 0.1, -0.1, None),  # it sees no hand
    ],
)
def test_in_a_clip_the_pair_counts_that_alone_sees_a_hand_where_it_was(
    first_off, second_off, second_logit, second_counts, weight
):
    """Else the weights say so, here always the same; hands are 100 pixels large."""
    first, second = keypoints([0.9], [0.0]), keypoints([0.9], [second_logit], shift_px=300.0)
    off_px = 100 * np.array([first_off, second_off])[:, None, None, None] * [1.0, 0.0]
    expected_px = np.stack([first.joints_px, second.joints_px]) + off_px
    config = DecisionConfig(second={"second": weight})
    counts = weight > 0 if second_counts is None else second_counts
    assert knows_better(first, second, config, expected_px).tolist() == [counts]


class Two:
    """An estimator whose two pairs know the answer; the first is off by 3 pixels and has the scores that are given.
    `seen` are the crops of either pair; the second one `shrinks` hands in the picture, or sees them where
    `sees` says, and is sure of crops that it `knows`."""

    def __init__(self, scores=(0.5, 0.9), decision=TRUSTED, second_logit=4.0, shrinks=1.0, **second_card) -> None:
        self.seen: tuple[list[HandCrop], list[HandCrop]] = ([], [])
        self.shrinks, self.sees, self.knows = shrinks, None, lambda crop: True
        self.hand_logits = (4.0, second_logit)
        card = make_card(hand_logit=True)
        card = dataclasses.replace(card, decision=dataclasses.replace(card.decision, **decision))
        plain = self.staged(0, card, scores)
        second = self.staged(1, make_card(crop_size=96, **second_card), (0.95, 0.95))
        self.estimator = HandEstimator(plain[0], card, dataclasses.replace(plain[1], second=second[1]))

    def staged(self, pair, card, scores):
        oracle = Oracle(SAMPLE, card)
        plain = oracle.estimator.stages

        def crop(*arguments):
            return dataclasses.replace(plain.crop(*arguments), pair=pair)

        def locate(crops):
            self.seen[pair].extend(crops)
            return oracle.true_maps(crops), np.full(len(crops), self.hand_logits[pair])

        def read_out(maps, crops):
            joints_px, _ = plain.read_out(maps, crops)
            off_px = np.array([3.0 * (1 - pair), 0.0])
            if pair:
                root_px = joints_px[:, ROOT, None]
                joints_px = root_px + self.shrinks * (joints_px - root_px)
                joints_px = joints_px if self.sees is None else np.array([self.sees(crop.side) for crop in crops])
            sure = np.array([np.full(21, scores[crop.side]) for crop in crops])
            for row, crop in enumerate(crops if pair else []):
                if not self.knows(crop):
                    joints_px[row], sure[row] = upwards(crop), 0.4
            return joints_px + off_px, sure

        def lift(hands):
            assert set(hands.pairs.tolist()) == {pair}
            rolls = [rotation_about_z(np.radians(crop.roll_deg)) for crop in hands.crops]
            joints_m = [SAMPLE.joints_m[crop.side] @ roll.T for crop, roll in zip(hands.crops, rolls, strict=True)]
            return canonical_from_camera(np.array(joints_m)).joints

        stages = dataclasses.replace(plain, crop=crop, locate=locate, read_out=read_out, lift=lift)
        return oracle.estimator.networks, stages

    def estimate(self, previous=None, index=0):
        return self.estimator.estimate(SAMPLE.image, SAMPLE.camera, LENGTH_M, index=index, previous=previous)


def test_both_pairs_look_and_the_weights_say_which_counts():
    two = Two()
    pose = two.estimate()
    assert all({crop.side for crop in crops} == {LEFT, RIGHT} for crops in two.seen)
    assert {crop.image.shape for crop in two.seen[1]} == {(96, 96, 3)}, "crops of its own size"
    for side, off_px in ((LEFT, 0.0), (RIGHT, 3.0)):
        hand = pose.hands[side]
        np.testing.assert_allclose(hand.joints_px, SAMPLE.joints_px[side] + [off_px, 0], atol=0.3)
        np.testing.assert_allclose(hand.canonical, canonical_from_camera(SAMPLE.joints_m[side]).joints, atol=0.05)
    assert pose.left.joint_scores.mean() == pytest.approx(0.95)
    ignored = Two(decision=NEVER)
    np.testing.assert_allclose(ignored.estimate().left.joints_px, SAMPLE.joints_px[LEFT] + [3.0, 0], atol=0.3)
    assert ignored.seen[1]
    unasked = Two(decision={"second": {}})
    np.testing.assert_allclose(unasked.estimate().left.joints_px, ignored.estimate().left.joints_px, atol=0.3)
    assert not unasked.seen[1], "without weights it would never count"


def test_of_a_hand_on_the_mask_of_the_other_the_second_pair_is_asked():
    """Named case: of touching hands the first pair's joints counted, mixed up as they were."""
    two = Two(scores=(0.5, 0.5))
    masks, boxes = two.estimator.segment(SAMPLE.image)
    finder = HandFinder(two.estimator.stages, two.estimator.card, SAMPLE.image, SAMPLE.camera)
    crops = finder.crops(masks, boxes.boxes_px, np.array([LEFT, RIGHT]))
    mixed_up = np.where(masks > 0, 1 + RIGHT, 0).astype(np.uint8)
    found = Detection(mixed_up, boxes, finder.looked(masks, boxes.boxes_px, crops))
    assert finder.seen_better(found, boxes.boxes_px).keypoints.pairs.tolist() == [1, 1]


def test_whether_it_is_a_hand_is_said_by_the_first_pair():
    """Named case: log-odds of both pairs in one decision, which knows those of the first, invented hands."""
    believed, refused = Two().estimate().left, Two(second_logit=-9.0).estimate().left
    assert refused.present and refused.score == believed.score
    np.testing.assert_allclose(refused.joints_px, believed.joints_px)


def test_the_second_pair_has_its_own_crops_with_the_fingers_up():
    """The left hand leans by 49 degrees."""
    two = Two(upright_within_deg=25.0)
    pose = two.estimate()
    rolled = [crop for crop in two.seen[1] if crop.roll_deg]
    assert [crop.side for crop in rolled] == [LEFT] and not any(crop.roll_deg for crop in two.seen[0])
    in_crop = apply_homography(np.linalg.inv(rolled[0].image_from_crop), SAMPLE.joints_px[LEFT])
    along = in_crop[ROOT] - in_crop[WRIST]
    assert abs(np.degrees(np.arctan2(along[0], -along[1]))) < 15
    np.testing.assert_allclose(pose.left.joints_px, SAMPLE.joints_px[LEFT], atol=0.3)
    np.testing.assert_allclose(pose.left.canonical, canonical_from_camera(SAMPLE.joints_m[LEFT]).joints, atol=0.05)


def test_a_hand_that_is_not_known_is_looked_for_in_every_quarter_turn():
    """Named case: of people's hands with the fingers to the side or down the second pair saw what was not there, with
    the fingers up, and the first pair counted."""
    searching, content = (Two(upright_within_deg=25.0, search_below_score=below) for below in (0.8, 0.3))
    for two in (searching, content):
        two.knows = lambda crop: abs(upright_roll_deg(SAMPLE.joints_px)[crop.side] - crop.roll_deg) < 45
    pose = searching.estimate()
    content.estimate()
    upright_deg = upright_roll_deg(SAMPLE.joints_px)[LEFT]
    rolls = [crop.roll_deg for crop in searching.seen[1] if crop.side == LEFT]
    assert rolls[:4] == [0, 90, 180, -90] and rolls[4] == pytest.approx(upright_deg, abs=5) and len(rolls) == 5
    assert [crop.roll_deg for crop in searching.seen[1] if crop.side == RIGHT] == [0], "it is known at once"
    np.testing.assert_allclose(pose.left.joints_px, SAMPLE.joints_px[LEFT], atol=0.3)
    assert max(abs(crop.roll_deg) for crop in content.seen[1]) < 45


def test_each_of_two_hands_is_looked_for_in_its_own_turn():
    """LEFT is known a quarter from the picture's turn, RIGHT half a turn from it, both where their fingers point up."""
    two = Two(scores=(0.5, 0.5), upright_within_deg=25.0, search_below_score=0.8)
    upright_deg = upright_roll_deg(SAMPLE.joints_px)

    def knows(crop):
        places = ((90.0, 180.0)[crop.side], upright_deg[crop.side])
        return any(abs((crop.roll_deg - place + 180) % 360 - 180) < 5 for place in places)

    two.knows = knows
    for hand, joints_px in zip(two.estimate().hands, SAMPLE.joints_px, strict=True):
        np.testing.assert_allclose(hand.joints_px, joints_px, atol=0.3)


def test_a_known_box_outside_the_picture_is_not_looked_for():
    """Named case: one beyond a corner left a crop without extent."""
    two = Two(scores=(0.5, 0.5), upright_within_deg=25.0, search_below_score=0.8)
    two.knows = lambda crop: False
    outside = StageTruth(boxes_px=np.array([[-60.0, -60, -10, -10], [np.nan] * 4]))
    two.estimator.estimate(SAMPLE.image, SAMPLE.camera, LENGTH_M, truth=outside)
    assert len(two.seen[1]) <= 1


def test_in_a_clip_the_second_pair_begins_with_the_turn_in_which_it_saw_a_hand_last():
    two = Two(upright_within_deg=25.0)
    first = two.estimate()
    two.seen[1].clear()
    again = two.estimate(Trail((first,), first), 1)
    assert not again.followed and again.left.pair == 1
    rolls = [crop.roll_deg for crop in two.seen[1] if crop.side == LEFT]
    assert rolls == pytest.approx([upright_roll_deg(SAMPLE.joints_px)[LEFT]], abs=1)


def test_the_second_pair_begins_with_the_turn_of_the_bodys_hand_that_is_there():
    two = Two(upright_within_deg=25.0)
    masks, boxes = two.estimator.segment(SAMPLE.image)
    palms_px = (boxes.boxes_px[:, :2] + boxes.boxes_px[:, 2:]) / 2
    along_px = SAMPLE.joints_px[:, ROOT] - SAMPLE.joints_px[:, WRIST]
    body = Body(palms_px, boxes.boxes_px, np.array([0.9, 0.3]), np.zeros((2, 2)), along_px, *np.zeros((2, 3)))
    finder = HandFinder(two.estimator.stages, two.estimator.card, SAMPLE.image, SAMPLE.camera, body=lambda: body)
    finder.second_looked(masks, boxes.boxes_px, np.array([LEFT, RIGHT]), None)
    rolls = [crop.roll_deg for crop in two.seen[1]]
    assert rolls == pytest.approx([upright_roll_deg(SAMPLE.joints_px)[LEFT], 0.0]), "of a hidden wrist nothing is known"


def upwards(crop: HandCrop) -> np.ndarray:
    """(21, 2) joints on a line from the bottom of a crop to its top."""
    line = np.stack([np.full(21, 48.0), np.linspace(80, 16, 21)], axis=-1)
    return np.asarray(apply_homography(crop.image_from_crop, line))


def test_joints_are_the_second_pairs_and_ranges_the_first_pairs():
    """Named case: in crops of real hands the second pair's joints were nearer, and its ranges twice as far off. Here it
    sees hands too small by a fifth, which makes them farther by a quarter; followed ones as well."""
    two = Two(shrinks=0.8)
    first = two.estimate()
    again = two.estimate(Trail((first,), first, may_rest=True), 1)
    assert again.followed and not first.followed
    root_px, range_m = SAMPLE.joints_px[LEFT][ROOT], np.linalg.norm(SAMPLE.joints_m[LEFT][ROOT])
    for pose in (first, again):
        assert pose.left.pair == 1
        np.testing.assert_allclose(pose.left.joints_px, root_px + 0.8 * (SAMPLE.joints_px[LEFT] - root_px), atol=0.3)
        assert pose.left.range_m == pytest.approx(range_m, rel=0.02)
        assert np.linalg.norm(pose.left.joints_m[ROOT]) == pytest.approx(pose.left.range_m)


def followed(two: Two, last: TwoHandPose) -> TwoHandPose:
    return two.estimate(Trail((last,), last, may_rest=True), last.index + 1)


def placed_by(two: Two, **placement) -> Two:
    """The same with such numbers of `PlacementConfig`."""
    card = two.estimator.card
    card = dataclasses.replace(card, placement=dataclasses.replace(card.placement, **placement))
    stages = dataclasses.replace(two.estimator.stages, card=card, refine=partial(refine, card.placement))
    two.estimator = HandEstimator(two.estimator.networks, card, stages)
    return two


def test_a_followed_hands_range_is_as_doubtful_as_when_it_was_found():
    """Named case: the second pair, which follows it, is surer of its joints than the first one, whose word the range
    is; so it jumped back from where doubt had drawn it, to 2.5 times the true range of a hand of 24 pixels."""
    two = placed_by(Two(scores=(0.5, 0.5)), range_errors=(0.02, 0.3), usual_range_m=2.0, usual_spread=0.3)
    pose = two.estimate()
    plain = Two(scores=(0.5, 0.5)).estimate()
    found_m = [hand.range_m for hand in pose.hands]
    assert all(one > 1.2 * other.range_m for one, other in zip(found_m, plain.hands, strict=True))
    for _ in range(3):
        pose = followed(two, pose)
        assert pose.followed and [hand.pair for hand in pose.hands] == [1, 1]
        np.testing.assert_allclose([hand.range_m for hand in pose.hands], found_m, rtol=0.02)


def test_what_is_assumed_does_not_add_up_while_a_hand_is_followed():
    """Named case: the doubt about an assumed hand length was taken for the estimate's own, and added in every frame."""
    two = placed_by(Two(shrinks=0.8), range_sigma=(0.04, 0.7, 0.4, 1.5))
    pose, shares = two.estimate(), []
    for _ in range(4):
        shares.append(pose.left.range_sigma_m / pose.left.range_m)
        pose = followed(two, with_sources(pose, "assumed", "assumed"))
        assert pose.followed and pose.left.pair == 1
    np.testing.assert_allclose(shares, shares[0])


def test_a_followed_hand_of_the_second_pair_that_moved_otherwise_is_seen_once_more():
    """Where it was found: it is still the hand if it is seen there then, and not if it is somewhere else again."""
    two = Two()
    first = two.estimate()
    size_px = np.ptp(SAMPLE.joints_px[LEFT], axis=0).max()
    elsewhere = dataclasses.replace(first.left, joints_px=first.left.joints_px - [0.25 * size_px, 0.0])
    last = dataclasses.replace(first, left=elsewhere)
    two.seen[1].clear()
    again = followed(two, last)
    assert again.followed and [crop.side for crop in two.seen[1]] == [LEFT, LEFT]
    np.testing.assert_allclose(again.left.joints_px, SAMPLE.joints_px[LEFT], atol=0.3)
    steps = iter(np.arange(9.0))
    two.sees = lambda side: SAMPLE.joints_px[side] + np.array([0.2 * size_px * next(steps), 0.0])
    assert not followed(two, last).followed


def test_a_followed_hand_is_not_one_that_is_outside_the_picture_or_where_the_other_one_was():
    """Named cases: joints outside the picture were cut from the old box again, and so agreed with themselves; hands
    that each look found in the place of the other one changed sides, and nobody saw it."""
    two = Two(scores=(0.5, 0.5))
    first = two.estimate()
    assert followed(two, first).followed and {hand.pair for hand in first.hands} == {1}
    along = SAMPLE.joints_px[RIGHT, ROOT] - SAMPLE.joints_px[LEFT, ROOT]
    across = 10 * np.array([along[1], -along[0]])  # out of the picture, and no nearer to the other hand
    for sees, there in (
        (lambda side: SAMPLE.joints_px[side] + np.array([8.0, 6.0]), True),
        (lambda side: SAMPLE.joints_px[1 - side], False),
        (lambda side: SAMPLE.joints_px[side] + across, False),
    ):
        two.sees = sees
        assert followed(two, first).followed == there


def test_where_nothing_is_known_of_a_followed_hands_range_segmentation_looks():
    two = Two()
    first = two.estimate()
    unknown = dataclasses.replace(first.left, range_shares=None)
    assert followed(two, first).followed
    assert not followed(two, dataclasses.replace(first, left=unknown)).followed


def test_a_range_by_a_lost_look_does_not_go_on():
    """Here the first pair sees the hand a tenth of its size from where it was expected, and the second takes over."""
    first = Two(decision=NEVER).estimate()
    size_px = np.ptp(SAMPLE.joints_px[LEFT], axis=0).max()
    moved = dataclasses.replace(first.left, joints_px=SAMPLE.joints_px[LEFT] - [0.1 * size_px, 0.0])
    again = followed(Two(decision=NEVER), dataclasses.replace(first, left=moved))
    assert again.followed and [hand.pair for hand in again.hands] == [1, 0]
    assert again.left.range_shares is None and again.right.range_shares is not None
    assert not followed(Two(decision=NEVER), again).followed


def test_a_picture_alone_is_looked_at_again_as_the_second_pairs_card_says():
    """Also by the first pair, for the range; of a clip the next frame is the next look."""
    two = Two(tta_rolls_deg=(15.0, -15.0))
    first = two.estimate()

    def rolls(pair, side):
        return sorted({crop.roll_deg for crop in two.seen[pair] if crop.side == side})

    assert rolls(0, LEFT) == rolls(1, LEFT) == [-15, 0, 15]
    assert rolls(0, RIGHT) == rolls(1, RIGHT) == [0], "its joints are the first pair's, whose card has no rolls"
    np.testing.assert_allclose(first.left.joints_px, SAMPLE.joints_px[LEFT], atol=0.3)
    assert first.left.range_m == pytest.approx(np.linalg.norm(SAMPLE.joints_m[LEFT][ROOT]), rel=0.02)
    for crops in two.seen:
        crops.clear()
    again = two.estimate(Trail((first,), first), 1)
    assert again.left.pair == 1 and rolls(0, LEFT) == rolls(1, LEFT) == [0]


def test_a_hand_that_the_first_pair_cannot_place_is_where_the_second_has_it():
    two = Two(shrinks=0.8)
    plain = two.estimator.stages

    def place(canonical, joints_px, joint_scores, camera, lengths_m):
        placed = plain.place(canonical, joints_px, joint_scores, camera, lengths_m)
        lost = joint_scores.mean(axis=-1) < 0.8
        return dataclasses.replace(placed, valid=placed.valid & ~lost, radius_m=np.where(lost, np.nan, placed.radius_m))

    two.estimator = HandEstimator(two.estimator.networks, two.estimator.card, dataclasses.replace(plain, place=place))
    range_m = np.linalg.norm(SAMPLE.joints_m[LEFT][ROOT])
    pose = two.estimate()
    assert pose.left.pair == 1 and pose.left.valid
    assert pose.left.range_m == pytest.approx(range_m / 0.8, rel=0.05)


def test_a_hand_is_followed_by_the_pair_that_saw_it():
    two = Two(scores=(0.79, 0.9), upright_within_deg=25.0)
    first = two.estimate()
    for crops in two.seen:
        crops.clear()
    again = two.estimate(Trail((first,), first, may_rest=True), 1)
    assert again.followed and [hand.pair for hand in again.hands] == [1, 0]
    (crop,) = two.seen[1]
    assert [other.side for other in two.seen[0]] == [RIGHT], "the range goes on as the first pair had it"
    assert crop.side == LEFT and crop.roll_deg, "with the fingers up at once: where they are is known"
    np.testing.assert_allclose(again.left.joints_px, SAMPLE.joints_px[LEFT], atol=0.3)


def test_hands_in_their_places_are_seen_by_both_pairs_and_not_mirrored():
    two = Two(scores=(0.79, 0.9), upright_within_deg=25.0)
    first = two.estimate()
    for crops in two.seen:
        crops.clear()
    again = two.estimate(Trail((first,), first, sides=surely(first)), 1)
    assert not again.followed and [hand.pair for hand in again.hands] == [1, 0] and again.left.side_logit == 0
    assert [crop.side for crop in two.seen[1]] == [LEFT]
    assert [crop.side for crop in two.seen[0]] == [LEFT, RIGHT]
    assert again.left.range_m == pytest.approx(first.left.range_m, rel=0.01) and again.left.range_shares is not None


@pytest.mark.parametrize(("second_logit", "follows"), [(0.1, True), (-0.1, False)])
def test_the_second_pair_says_whether_what_it_follows_is_still_a_hand(second_logit, follows):
    first = Two().estimate()
    trail = Trail((first,), first, may_rest=True)
    assert first.left.pair == 1 and Two(second_logit=second_logit).estimate(trail, 1).followed == follows


@pytest.mark.parametrize(("second_logit", "follows"), [(4.0, True), (2.9, False), (-4.0, False)])
def test_a_hand_that_the_first_pair_loses_is_followed_by_a_sure_second(second_logit, follows):
    """Named case: the first pair sees the joints of real hands elsewhere in every frame, so that these were never
    followed. Here it is a tenth of the hand's size, and three pixels more, from where they were expected. Named case:
    rendered hands that it lost went over to a second pair that hardly knew them, and cost half of what rest costs."""
    first = Two(decision=NEVER).estimate()
    assert first.left.pair == 0
    size_px = np.ptp(SAMPLE.joints_px[LEFT], axis=0).max()
    moved = dataclasses.replace(first.left, joints_px=SAMPLE.joints_px[LEFT] - [0.1 * size_px, 0.0])
    first = dataclasses.replace(first, left=moved)
    again = Two(decision=NEVER, second_logit=second_logit).estimate(Trail((first,), first, may_rest=True), 1)
    assert again.followed == follows
    if follows:
        assert [hand.pair for hand in again.hands] == [1, 0]
        np.testing.assert_allclose(again.left.joints_px, SAMPLE.joints_px[LEFT], atol=0.3)


def test_of_a_hand_that_the_first_pair_goes_on_to_see_the_second_is_not_asked():
    """Named case: the second pair looked at every hand of every frame, also where the first had known it better."""
    two = Two(decision=NEVER)
    first = two.estimate()
    two.seen[1].clear()
    again = two.estimate(Trail((first,), first), 1)
    assert not again.followed and not two.seen[1] and again.left.present
    moved = dataclasses.replace(first.left, joints_px=first.left.joints_px + 0.5 * np.ptp(first.left.joints_px))
    two.estimate(Trail((dataclasses.replace(first, left=moved),), first), 1)
    assert {crop.side for crop in two.seen[1]} == {LEFT}, "where it is not where it was expected"
    by_second = Two()
    seen = by_second.estimate()
    by_second.seen[1].clear()
    by_second.estimate(Trail((seen,), seen), 1)
    assert seen.left.pair == 1 and LEFT in {crop.side for crop in by_second.seen[1]}, "whose it was"


def test_crops_of_both_pairs_come_back_in_their_order():
    two = Two()
    stages = two.estimator.stages
    masks, boxes = two.estimator.segment(SAMPLE.image)
    crops = [
        stages.of_pair(pair).crop(SAMPLE.image, masks, boxes.boxes_px[side], side, SAMPLE.camera)
        for pair, side in ((1, RIGHT), (0, LEFT), (1, LEFT), (0, RIGHT))
    ]
    seen = stages.keypoints(crops)
    assert [(crop.pair, crop.side) for crop in seen.crops] == [(1, RIGHT), (0, LEFT), (1, LEFT), (0, RIGHT)]
    np.testing.assert_allclose(seen.joint_scores.mean(axis=1), [0.95, 0.5, 0.95, 0.9])
    assert [len(maps) for maps in seen.heatmaps] == [21] * 4


# The fit ------------------------------------------------------------------------------------------------------------


def hands(count: int, rng) -> list[Both]:
    """Of which the second pair is better where its joints are surer; the others' features say nothing."""
    features = rng.normal(size=(count, len(SECOND_FEATURES)))
    features[:, 0] = 1
    better = features[:, 1] - features[:, 2] > 0.5
    return [
        Both("drawn", scene, features[scene], 0.2 if better[scene] else 0.1, 0.1 if better[scene] else 0.2)
        for scene in range(count)
    ]


def test_the_fit_finds_where_the_second_pair_is_better_and_says_so_of_hands_held_out():
    drawn = hands(400, np.random.default_rng(0))
    weights = fit_second_look.fit(drawn)
    assert weights[1] > 0 > weights[2] and np.abs(weights[3:]).max() < 0.2 * weights[1]
    says, true = fit_second_look.held_out(drawn), np.array([hand.second < hand.first for hand in drawn])
    assert (says == true).mean() > 0.93


def test_a_hand_counts_as_much_as_the_errors_differ():
    """Of two like hands the one with the larger difference wins."""
    features = np.eye(len(SECOND_FEATURES))[0]
    small, large = Both("", 0, features, 0.11, 0.10), Both("", 1, features, 0.1, 0.4)
    assert fit_second_look.fit([small, small, large])[0] < 0 < fit_second_look.fit([small])[0]


def test_real_hands_count_half_of_all_others():
    """Of the same features. By hand: 30 of 40 rendered hands say the opposite of the others and of a real one; what is
    left of them, twenty of forty, is what the real one counts."""
    features = np.eye(len(SECOND_FEATURES))[0]
    against = [Both("people", scene, features, 0.10, 0.11) for scene in range(30)]
    speaking = [Both("people", 30 + scene, features, 0.11, 0.10) for scene in range(10)]
    real = Both("digits", 40, features, 0.2, 0.1)
    assert fit_second_look.fit([*against, *speaking])[0] < -0.1
    assert fit_second_look.fit([*against, *speaking, real])[0] == pytest.approx(0, abs=1e-6)
    assert fit_second_look.fit([*against, *speaking[:-1], real])[0] < 0


def test_photographed_hands_are_put_before_other_backgrounds_the_same_each_time(tmp_path):
    write_digits(tmp_path / "digits", persons=10)
    (tmp_path / "rooms").mkdir()
    cv2.imwrite(str(tmp_path / "rooms" / "one.png"), np.full((180, 320, 3), 90, np.uint8))
    options = argparse.Namespace(digits=tmp_path / "digits", backgrounds=[tmp_path / "rooms"], pasted=3, seed=1)
    first, again = ([of() for _, of in fit_second_look.pasted(options)] for _ in range(2))
    assert len(first) == 3 and {kind for kind, _ in fit_second_look.pasted(options)} == {"digits, pasted"}
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.image, other.image)
        assert any(one.present) and np.isfinite(one.joints_px[np.array(one.present)]).all()
    assert fit_second_look.pasted(argparse.Namespace(digits=None, backgrounds=options.backgrounds)) == []
