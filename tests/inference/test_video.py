"""One estimator over a clip: what it is told, sides that hands keep, and that a clip leaves nothing behind."""

from dataclasses import replace

import numpy as np
import pytest
from tests.oracles import drawn_hands

from twohands.errors import InputError
from twohands.geometry.boxes import box_from_points
from twohands.inference.decision import DecisionConfig
from twohands.inference.following import LONGEST_REST
from twohands.inference.side_keeping import NOTHING_KNOWN, SideKeeper, with_sides_exchanged
from twohands.inference.video import VideoEstimator
from twohands.skeleton import LEFT, ROOT
from twohands.types import HandPose, TwoHandPose

SAMPLE = drawn_hands(1)
ABSENT = HandPose(present=False)


def pose_of(index: int, *, exchanged: bool = False, present=(True, True), shift=(0.0, 0.0)) -> TwoHandPose:
    """True hands of the drawn picture, moved by `shift` pixels."""
    hands = [
        HandPose(True, 0.9, joints_px=SAMPLE.joints_px[s] + shift, joints_m=SAMPLE.joints_m[s], valid=True,
                 range_m=float(np.linalg.norm(SAMPLE.joints_m[s, ROOT]))) if present[s] else ABSENT
        for s in range(2)
    ]  # fmt: skip
    pose = TwoHandPose(hands[0], hands[1], SAMPLE.camera, np.array([[0, 1, 2]], np.uint8), index, index / 30)
    return with_sides_exchanged(pose) if exchanged else pose


def is_left(hand: HandPose, shift=(0.0, 0.0)) -> bool:
    return hand.joints_px is not None and bool(np.allclose(hand.joints_px, SAMPLE.joints_px[LEFT] + shift))


def test_exchanging_twice_changes_nothing_and_masks_follow():
    pose = replace(pose_of(0), crop_masks=np.arange(5, dtype=np.uint8)[None])
    once = with_sides_exchanged(pose)
    assert once.left is pose.right and once.masks is not None and once.masks.tolist() == [[0, 2, 1]]
    assert once.crop_masks is not None and once.crop_masks.tolist() == [[0, 2, 1, 4, 3]]
    assert with_sides_exchanged(once).left is pose.left


def updated(keeper: SideKeeper, pose: TwoHandPose) -> TwoHandPose:
    """One frame through a keeper."""
    kept = keeper.kept(pose)
    keeper.remember(kept)
    return kept


def test_frames_with_exchanged_hands_are_put_right():
    keeper = SideKeeper()
    for index in range(16):
        kept = updated(keeper, pose_of(index, exchanged=index in (7, 11, 12)))
        assert is_left(kept.left), index
    assert keeper.changes == 0


def test_one_hand_alone_keeps_its_side():
    keeper = SideKeeper()
    for index in range(10):
        kept = updated(keeper, pose_of(index, present=(True, False), exchanged=index in (6, 8)))
        assert is_left(kept.left) and not kept.right.present


def test_whoever_insists_is_believed_and_both_changes_count():
    keeper = SideKeeper()
    for index in range(20):
        updated(keeper, pose_of(index))
    sides = [is_left(updated(keeper, pose_of(20 + i, exchanged=True)).left) for i in range(20)]
    held = sides.index(False)
    assert held == int(1 / DecisionConfig().side_trust) == 3, "the fourth contrary frame changes it"
    assert not any(sides[held:])
    assert keeper.changes == 2


def test_the_longer_a_side_was_said_the_longer_it_is_kept():
    def held(frames: int) -> int:
        keeper = SideKeeper()
        for index in range(frames):
            updated(keeper, pose_of(index))
        return [is_left(updated(keeper, pose_of(frames + i, exchanged=True)).left) for i in range(20)].index(False)

    assert held(1) < held(4) <= held(40) == held(400)


def test_hands_that_come_go_or_move_are_no_exchange():
    keeper = SideKeeper()
    step = np.ptp(SAMPLE.joints_px[LEFT], axis=0).max() / 4
    for index in range(10):
        pose = pose_of(index, present=(index != 4, index > 2), shift=(index * step, 0.0))
        assert updated(keeper, pose) is pose
    assert keeper.changes == 0


def test_hands_that_pass_each_other_keep_their_sides():
    """Two hands that move through each other's place are told apart by how they move."""
    keeper, start = SideKeeper(), pose_of(0)
    apart = (SAMPLE.joints_px[1] - SAMPLE.joints_px[0]).mean(axis=0)
    for index in range(21):
        left, right = (
            replace(hand, joints_px=hand.joints_px + sign * apart * index / 20)
            for hand, sign in zip(start.hands, (1, -1), strict=True)
        )
        pose = replace(start, left=left, right=right, index=index, time_s=index / 30)
        assert updated(keeper, pose) is pose, index
    assert keeper.changes == 0


def test_a_place_is_forgotten_after_a_while():
    """A hand that comes back where the other one was long ago is that which it is said to be."""
    keeper = SideKeeper()
    for index in range(5):
        updated(keeper, pose_of(index, present=(True, False)))
    for index in range(5, 11):
        updated(keeper, pose_of(index, present=(False, False)))
    assert not updated(keeper, pose_of(20, present=(True, False), exchanged=True)).left.present
    assert keeper.changes == 0


def test_a_hand_that_is_not_seen_is_forgotten_as_fast_as_others_are_learnt():
    """By hand: 6 is known, and seven tenths of it for every frame without the hand, until a single frame may say more
    (0.3 of 6)."""
    memory = NOTHING_KNOWN
    for index in range(8):
        memory = memory.after(pose_of(index, present=(True, False)))
    box_px = np.array([box_from_points(SAMPLE.joints_px[LEFT])])
    for expected in (6.0, 4.2, 2.94, 2.058, 0.0):
        np.testing.assert_allclose(memory.left_logits(box_px), [expected])
        memory = memory.after(replace(pose_of(9), left=ABSENT, right=ABSENT))


def test_the_card_says_how_sides_add_up():
    """An estimator that is never trusted changes nothing; one trusted wholly needs a single frame."""
    deaf, quick = (SideKeeper(DecisionConfig(side_trust=trust)) for trust in (0.0, 1.0))
    for keeper, held in ((deaf, True), (quick, True)):
        updated(keeper, pose_of(0))
        assert is_left(updated(keeper, pose_of(1)).left) == held
    assert deaf.memory.tracks[LEFT].logit == 0.0 and quick.memory.tracks[LEFT].logit == 6.0


def test_an_estimator_that_knows_how_sure_it_is_has_decided_itself():
    """Its hands stay as they are; what every frame says adds up in part, and a followed frame says nothing."""
    memory, trust = NOTHING_KNOWN, DecisionConfig().side_trust

    def said(pose, logit):
        left, right = (replace(hand, side_logit=logit) for hand in pose.hands)
        return replace(pose, left=left, right=right)

    memory = memory.after(said(pose_of(0), 2.0))
    boxes_px = np.array([box_from_points(SAMPLE.joints_px[side]) for side in range(2)])
    once = trust * 2.0
    np.testing.assert_allclose(memory.left_logits(boxes_px), once * np.array([1, -1]), atol=0.05)
    memory = memory.after(said(pose_of(1), -1.0))
    twice = once - trust
    np.testing.assert_allclose(memory.left_logits(boxes_px), twice * np.array([1, -1]), atol=0.05)
    rested = memory.after(replace(pose_of(2), followed=True))
    np.testing.assert_allclose(rested.left_logits(boxes_px), memory.left_logits(boxes_px))
    assert not memory.left_logits(boxes_px + 1000).any(), "nothing is known of a hand in another place"
    keeper = SideKeeper()
    keeper.memory = memory
    pose = said(pose_of(2, exchanged=True), 0.1)
    assert keeper.kept(pose) is pose


def test_the_estimator_is_told_what_was_found_before():
    video, told = VideoEstimator(), []

    def estimate(previous, index):
        told.append(previous)
        return pose_of(index)

    for index in range(3):
        video.update(lambda previous, index=index: estimate(previous, index))
    assert told[0] is None and len(told[1].last) == 1 and not told[1].sides.left_logits(np.full((1, 4), np.nan)).any()
    assert [pose.index for pose in told[2].last] == [0, 1] and told[2].seen.index == 1
    video.reset()
    video.update(lambda previous: estimate(previous, 0))
    assert told[3] is None, "another clip begins"


def test_segmentation_rests_for_so_many_frames_at_most():
    """And not before hands were once where they were expected."""
    longest, seen = LONGEST_REST[0][1], []
    video = VideoEstimator()
    for index in range(4 + 2 * longest):

        def estimate(trail, index=index):
            rests = trail is not None and trail.may_rest
            seen.append(None if trail is None else trail.seen.index)
            return replace(pose_of(index), followed=rests)

        video.update(estimate)
    assert seen == [None, 0, *[1] * (longest + 1), *[longest + 2] * (longest + 1)]
    assert (video.frames, video.rested) == (4 + 2 * longest, 2 * longest)


def test_segmentation_does_not_rest_where_hands_stray_or_one_is_missed():
    """Those of the second pair are looked for nevertheless. A hand that is alone is followed once the other one, which
    was there, is forgotten."""
    video, rests = VideoEstimator(), []

    def run(index, pair, **how):
        pose = pose_of(index, **how)
        left, right = (replace(hand, pair=pair) if hand.present else hand for hand in pose.hands)

        def estimate(trail):
            rests.append(trail is not None and trail.may_rest)
            return replace(pose, left=left, right=right)

        video.update(estimate)

    for pair in (1, 0):
        video.reset()
        rests.clear()
        for index, right_px in enumerate((30.0, -30.0, 0.0, 0.0, 0.0, 0.0)):
            run(index, pair, shift=(right_px, 0.0))
        strays = [pair > 0] * 3
        assert rests == [False, False, *strays, True], "hands move on as they did, says the frame before"
    for index in range(6, 20):
        run(index, 1, present=(True, False))
    assert not any(rests[7:10]) and rests[-1]


def test_ranges_are_smoothed_unless_that_is_switched_off():
    def run(video):
        ranges = []
        for index in range(12):
            pose = pose_of(index)
            assert pose.left.range_m is not None and pose.left.joints_m is not None
            noisy = pose.left.range_m * (1 + 0.03 * (-1) ** index)
            scaled = replace(pose.left, range_m=noisy, joints_m=pose.left.joints_m * noisy / pose.left.range_m)
            pose = replace(pose, left=scaled)
            ranges.append(video.update(lambda _, pose=pose: pose).left.range_m)
        return np.array(ranges)

    rough, smooth = run(VideoEstimator(None)), run(VideoEstimator())
    assert abs(np.diff(rough)).mean() > 2 * abs(np.diff(smooth[3:])).mean()


def test_a_frame_that_is_refused_leaves_no_trace():
    video = VideoEstimator()
    first = video.update(lambda _: pose_of(0))

    def refused(previous):
        raise InputError("no")

    with pytest.raises(InputError):
        video.update(refused)
    again = video.update(lambda previous: pose_of(1) if previous is not None else pose_of(99))
    assert again.index == 1 and again.left.range_m == pytest.approx(first.left.range_m)
