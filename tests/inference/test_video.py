"""One estimator over a clip: what it is told, sides that hands keep, and that a clip leaves nothing behind."""

from dataclasses import replace

import numpy as np
import pytest
from tests.oracles import drawn_hands

from twohands.errors import InputError
from twohands.inference.side_keeping import INSIST_FRAMES, SideKeeper, with_sides_exchanged
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
    pose = pose_of(0)
    once = with_sides_exchanged(pose)
    assert once.left is pose.right and once.masks is not None and once.masks.tolist() == [[0, 2, 1]]
    assert with_sides_exchanged(once).left is pose.left


def test_a_frame_with_exchanged_hands_is_put_right():
    keeper = SideKeeper()
    for index in range(12):
        kept = keeper.update(pose_of(index, exchanged=index in (3, 7, 8)))
        assert is_left(kept.left), index
    assert keeper.changes == 0


def test_one_hand_alone_keeps_its_side():
    keeper = SideKeeper()
    for index in range(6):
        kept = keeper.update(pose_of(index, present=(True, False), exchanged=index in (2, 4)))
        assert is_left(kept.left) and not kept.right.present


def test_whoever_insists_is_believed_and_counted():
    keeper = SideKeeper()
    keeper.update(pose_of(0))
    sides = [is_left(keeper.update(pose_of(1 + i, exchanged=True)).left) for i in range(INSIST_FRAMES + 2)]
    assert sides == [True] * (INSIST_FRAMES - 1) + [False] * 3
    assert keeper.changes == 1


def test_hands_that_come_go_or_move_are_no_exchange():
    keeper = SideKeeper()
    step = np.ptp(SAMPLE.joints_px[LEFT], axis=0).max() / 4
    for index in range(10):
        pose = pose_of(index, present=(index != 4, index > 2), shift=(index * step, 0.0))
        assert keeper.update(pose) is pose
    assert keeper.changes == 0


def test_a_place_is_forgotten_after_a_while():
    """A hand that comes back where the other one was long ago is that which it is said to be."""
    keeper = SideKeeper(memory_frames=3)
    keeper.update(pose_of(0, present=(True, False)))
    for index in range(1, 6):
        keeper.update(pose_of(index, present=(False, False)))
    assert not keeper.update(pose_of(6, present=(True, False), exchanged=True)).left.present


def test_the_estimator_is_told_what_was_found_before():
    video, told = VideoEstimator(), []

    def estimate(previous, index):
        told.append(previous)
        return pose_of(index, exchanged=index == 1)

    for index in range(3):
        video.update(lambda previous, index=index: estimate(previous, index))
    assert told[0] is None and is_left(told[2].left), "of the hands on the sides that they keep"
    video.reset()
    video.update(lambda previous: estimate(previous, 0))
    assert told[3] is None, "another clip begins"


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
