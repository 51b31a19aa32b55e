"""Hands followed without HandSegNet: where they should be, what is asked of the networks, and when it is not enough."""

from dataclasses import replace

import numpy as np
import pytest
from tests.inference.test_expected import SAMPLE, pose_at, trail_of
from tests.oracles import Oracle, drawn_hands, make_card, restaged

from twohands.geometry.boxes import upright_roll_deg
from twohands.geometry.palm import Palm
from twohands.inference.expected import FARTHEST
from twohands.inference.following import EMPTY_REST, LONGEST_REST, WATCHED_REST, followed_boxes, longest_rest
from twohands.inference.side_keeping import NOTHING_KNOWN, SideMemory
from twohands.inference.trail import Trail
from twohands.types import HandPose, TwoHandPose

CARD = make_card(hand_logit=True)
SIZE = SAMPLE.image.shape[:2]
LENGTH_M = 0.1


class Follower:
    """An estimator whose networks know the answer; `looks` counts HandSegNet's pictures, `crops` are PoseNet2D's."""

    def __init__(self, sample=SAMPLE, seen_logit: float = 4.0, blind: bool = False, card=CARD) -> None:
        oracle = Oracle(sample, card)
        self.looks, self.crops, self.sample = 0, [], sample

        def look(image):
            self.looks += 1
            return oracle.estimator.stages.hand_maps(image)

        def locate(crops):
            self.crops.append(crops)
            maps = oracle.true_maps(crops)
            return np.zeros_like(maps) if blind and not self.looks else maps, np.full(len(crops), seen_logit)

        self.estimator = restaged(
            oracle.estimator,
            hand_maps=look,
            locate=locate,
            lift=lambda keypoints: oracle.canonical[keypoints.sides],
        )

    def estimate(self, trail: Trail | None, index: int = 1) -> TwoHandPose:
        sample = self.sample
        return self.estimator.estimate(sample.image, sample.camera, LENGTH_M, index=index, previous=trail)


def test_how_long_segmentation_rests():
    """By the pair that needs it sooner; never without a hand."""

    def seen(*pairs, watched=False):
        hands = [HandPose(False) if pair is None else replace(pose_at(0).left, pair=pair) for pair in pairs]
        return longest_rest(replace(pose_at(0), left=hands[0], right=hands[1]), watched)

    (alone, both), (second_alone, both_second) = LONGEST_REST
    assert seen(0, 0) == seen(1, 0) == seen(0, 1) == both and seen(1, 1) == both_second
    assert seen(0, None) == seen(None, 0) == alone and seen(1, None) == seen(None, 1) == second_alone
    assert seen(None, None) == 0 and seen(None, None, watched=True) == EMPTY_REST
    assert [seen(pair, None, watched=True) for pair in (0, 1)] == list(WATCHED_REST)
    assert seen(0, 1, watched=True) == both and (alone, second_alone) < WATCHED_REST


@pytest.mark.parametrize(
    ("palms", "follows"), [(("own",), True), (("own", "own"), True), ((), False), (("own", "other"), False)]
)
def test_a_hand_alone_is_followed_for_long_while_the_palm_detector_sees_it_and_no_other(palms, follows):
    """Nobody asks it before."""
    sample, asked = drawn_hands(2, present=(True, False)), []
    follower = Follower(sample)
    own_px = sample.joints_px[0].mean(axis=0)
    middles = {"own": own_px, "other": own_px + np.array([200.0, 0.0])}
    seen = tuple(Palm(1.0, middles[which], np.array([0.0, -30.0]), 60.0) for which in palms)
    follower.estimator = restaged(follower.estimator, palms=lambda image: asked.append(1) or seen)
    first = follower.estimate(None, 0)
    trail = Trail((first,), first, may_rest=True)
    asked.clear()
    assert follower.estimate(trail).followed and not asked
    assert follower.estimate(replace(trail, rested=longest_rest(first))).followed == follows and asked


@pytest.mark.parametrize(("palms", "rests"), [((), True), (None, False), ("one", False)])
def test_where_there_is_no_hand_segmentation_rests_while_the_palm_detector_sees_none(palms, rests):
    """Without a palm detector nobody watches."""
    empty, follower = replace(pose_at(0), left=HandPose(False), right=HandPose(False)), Follower()
    seen = (Palm(1.0, np.array([60.0, 60.0]), np.array([0.0, -30.0]), 60.0),) if palms == "one" else ()
    follower.estimator = restaged(follower.estimator, palms=None if palms is None else lambda image: seen)
    pose = follower.estimate(Trail((empty,), empty, may_rest=True))
    assert pose.followed == rests == (not follower.looks)
    assert pose.left.present == pose.right.present == (not rests)


def test_a_hand_that_leaves_and_hands_in_one_place_are_not_followed():
    trail = trail_of(pose_at(0))
    boxes = followed_boxes(trail, SAMPLE.joints_px, SIZE, CARD)
    assert boxes is not None and boxes.present.all()
    np.testing.assert_allclose(boxes.scores, 0.9)
    gone = SAMPLE.joints_px - [[[0, 0]], [[0, 10 * SIZE[0]]]]
    assert followed_boxes(trail, gone, SIZE, CARD) is None
    assert followed_boxes(trail, np.stack([SAMPLE.joints_px[0]] * 2), SIZE, CARD) is None
    assert followed_boxes(trail, np.full((2, 21, 2), np.nan), SIZE, CARD) is None


def test_followed_hands_are_found_without_segmentation():
    follower = Follower()
    first = follower.estimate(None, 0)
    assert follower.looks == 1 and not first.followed and first.masks is not None
    again = follower.estimate(Trail((first,), first, may_rest=True))
    assert follower.looks == 1 and again.followed and again.masks is None and again.index == 1
    for side, hand in enumerate(again.hands):
        assert hand.joints_px is not None
        np.testing.assert_allclose(hand.joints_px, SAMPLE.joints_px[side], atol=0.1)
        assert hand.range_m == pytest.approx(first.hands[side].range_m, rel=2e-3)
        assert hand.score == pytest.approx(first.hands[side].score, abs=0.05)


def test_hands_are_followed_with_their_fingers_up_where_the_card_says_so():
    card = make_card(hand_logit=True, upright_within_deg=20.0)
    follower, plain = Follower(card=card), Follower().estimate(None, 0)
    again = follower.estimate(Trail((plain,), plain, may_rest=True))
    assert follower.looks == 0 and again.followed
    for crop in follower.crops[-1]:
        assert crop.roll_deg == pytest.approx(float(upright_roll_deg(SAMPLE.joints_px[crop.side])), abs=3)
        np.testing.assert_allclose(again.hands[crop.side].joints_px, SAMPLE.joints_px[crop.side], atol=0.1)


def test_segmentation_looks_where_it_may_not_rest_or_a_hand_is_in_doubt():
    first = Follower().estimate(None, 0)
    trail = Trail((first,), first, may_rest=True)
    awake = Follower()
    assert not awake.estimate(replace(trail, may_rest=False)).followed and awake.looks == 1
    blind = Follower(blind=True)
    assert not blind.estimate(trail).followed and blind.looks == 1
    strayed_from = replace(first, left=replace(first.left, joints_px=SAMPLE.joints_px[0] + FARTHEST[0] * 200))
    startled = Follower()
    assert not startled.estimate(replace(trail, last=(strayed_from,))).followed and startled.looks == 1
    alone = Follower()
    assert not alone.estimate(Trail((first, replace(first, index=1)), first, may_rest=True), 5).followed
    assert alone.looks == 1, "after a pause"


def surely(first: TwoHandPose) -> SideMemory:
    """What is known of the sides of hands that have been there for a while."""
    memory = NOTHING_KNOWN
    for _ in range(5):
        memory = memory.after(first)
    return memory


def test_hands_that_segmentation_sees_in_their_places_are_not_decided_anew():
    """One look at either hand, none at its mirror image or at the body; the picture says nothing of sides."""

    def body(image, around_px):
        raise AssertionError("looked for a body")

    first = Follower(seen_logit=2.0).estimate(None, 0)
    follower = Follower(seen_logit=2.0)
    follower.estimator = restaged(follower.estimator, body=body)
    again = follower.estimate(Trail((first,), first, sides=surely(first)))
    assert follower.looks == 1 and not again.followed and again.masks is not None
    assert [len(crops) for crops in follower.crops] == [2]
    for side, hand in enumerate(again.hands):
        assert hand.side_logit == 0 and hand.range_m == pytest.approx(first.hands[side].range_m, rel=2e-3)
        np.testing.assert_allclose(hand.joints_px, SAMPLE.joints_px[side], atol=0.1)


def test_hands_are_decided_where_sides_are_unsure_or_a_candidate_is_elsewhere():
    first = Follower(seen_logit=2.0).estimate(None, 0)
    size_px = np.ptp(SAMPLE.joints_px[0], axis=0).max()
    strayed_from = replace(first, left=replace(first.left, joints_px=SAMPLE.joints_px[0] + size_px))
    alone = replace(first, right=HandPose(False))
    missed = surely(first).after(alone)
    for trail in (
        Trail((first,), first),
        Trail((strayed_from,), first, sides=surely(first)),
        Trail((alone,), first, sides=surely(alone)),
        Trail((first,), first, sides=missed),
    ):
        follower = Follower(seen_logit=2.0)
        again = follower.estimate(trail)
        assert again.left.side_logit != 0 and len(follower.crops) > 1, "mirrored, too"


def test_two_candidates_in_the_place_of_one_hand_are_that_hand():
    """Named case: a hand held up alone looks like both, and was decided anew whenever HandSegNet looked."""
    one = Follower(drawn_hands(1, present=(True, False)), seen_logit=2.0)
    first = one.estimate(None, 0)
    assert not first.right.present
    plain = one.estimator.stages.boxes

    def boxes(*known):
        seen = plain(*known)
        return replace(seen, boxes_px=seen.boxes_px[[0, 0]] + [[0.0], [2.0]], present=np.array([True, True]))

    one.estimator = restaged(one.estimator, boxes=boxes)
    again = one.estimate(Trail((first,), first, sides=surely(first)))
    assert again.left.side_logit == 0 and not again.right.present


def test_weights_whose_decision_is_not_learnt_never_follow():
    card = make_card()
    oracle = Oracle(SAMPLE, card)
    first = oracle.estimator.estimate(SAMPLE.image, SAMPLE.camera, LENGTH_M)
    oracle.calls.clear()
    again = oracle.estimator.estimate(
        SAMPLE.image, SAMPLE.camera, LENGTH_M, index=1, previous=Trail((first,), first, may_rest=True)
    )
    assert not again.followed and oracle.calls[0] == "hand_seg_net"
