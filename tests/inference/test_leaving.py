"""Hands that leave a picture are carried on at their velocity, and no others."""

import dataclasses
import math

import numpy as np
import pytest
from tests.builders import CENTRED_CAMERA, open_hand

from twohands.errors import InputError
from twohands.geometry.camera import project, unproject
from twohands.geometry.canonical import camera_from_canonical
from twohands.geometry.rotation import centring_angles
from twohands.inference.leaving import LeavingHand
from twohands.inference.tracker import PREDICTED, HandTracker, RangeSmoothing
from twohands.skeleton import ROOT
from twohands.types import HandPose, TwoHandPose

ABSENT = HandPose(present=False)
RANGE_M, LENGTH_M = 0.4, 0.09
HAND_PX = np.stack(np.meshgrid(np.linspace(0, 60, 7), np.linspace(0, 20, 3)), axis=-1).reshape(21, 2)
"""Joints in a grid of 60 x 20 pixels, with its upper left corner at 0."""
HAND_PX[[0, ROOT]] = HAND_PX[[ROOT, 0]]


def grid_at(left_px, top_px=100.0):
    """The joints with the grid's corner there."""
    return HAND_PX + np.array([left_px, top_px])


def hand_at(left_px, top_px=100.0):
    """A hand with these joints."""
    joints_px = grid_at(left_px, top_px)
    theta, phi = (float(angle) for angle in centring_angles(unproject(joints_px[ROOT], CENTRED_CAMERA)))
    return HandPose(
        present=True,
        score=0.9,
        box_px=np.array([left_px, top_px, left_px + 60, top_px + 20]),
        joints_px=joints_px,
        joint_scores=np.full(21, 0.8),
        canonical=open_hand(),
        joints_m=camera_from_canonical(open_hand(), LENGTH_M, RANGE_M, theta, phi),
        range_m=RANGE_M,
        theta_deg=math.degrees(theta),
        phi_deg=math.degrees(phi),
        key_bone="wrist",
        method="all-joints",
        valid=True,
    )


def carried_after(hands, frames=1, times=None):
    """What one hand's tracker says of the given hands, frame by frame."""
    leaving = LeavingHand(frames)
    times = range(len(hands)) if times is None else times
    return [leaving.update(hand, time, CENTRED_CAMERA) for hand, time in zip(hands, times, strict=True)]


LEAVING = [hand_at(370.0), hand_at(390.0), hand_at(410.0), hand_at(430.0)]
"""20 pixels a frame to the right; the picture ends at 480. The next place is 450: columns 450, 460 and 470 of the grid
are inside."""


def test_a_leaving_hand_is_carried_on_at_its_velocity():
    before = carried_after(LEAVING)
    assert all(given is found for given, found in zip(LEAVING, before, strict=True))
    found = carried_after([*LEAVING, ABSENT])[-1]
    np.testing.assert_allclose(found.joints_px, grid_at(450))
    np.testing.assert_allclose(found.box_px, [450, 100, 480, 120])  # cut to the picture
    ray = unproject(found.joints_px[ROOT], CENTRED_CAMERA)
    np.testing.assert_allclose(np.radians([found.theta_deg, found.phi_deg]), centring_angles(ray))
    assert found.present and found.valid is False and found.joints_m is None and found.range_m is None
    assert found.canonical is LEAVING[-1].canonical and found.score == 0.9


def test_the_velocity_is_the_mean_of_the_last_three_frames():
    """370, 376, 400, 430: (430 - 370) / 3 = 20 a frame; what was before does not count."""
    found = carried_after([hand_at(100.0), hand_at(370.0), hand_at(376.0), hand_at(400.0), hand_at(430.0), ABSENT])[-1]
    np.testing.assert_allclose(found.joints_px, grid_at(450))


def test_two_frames_are_enough_and_one_is_not():
    assert carried_after([*LEAVING[-2:], ABSENT])[-1].present
    assert carried_after([*LEAVING[-1:], ABSENT])[-1] is ABSENT


@pytest.mark.parametrize(
    "hands",
    [
        [hand_at(200.0), hand_at(220.0)],  # 240 next: in the middle of the picture
        [hand_at(420.0), hand_at(460.0)],  # 500 next: gone
        [hand_at(430.0, 300.0), hand_at(440.0, 300.0)],  # below the picture all the time
    ],
)
def test_a_hand_that_is_not_leaving_stays_absent(hands):
    assert carried_after([*hands, ABSENT])[-1] is ABSENT


@pytest.mark.parametrize("frames", [0, 1, 2])
def test_a_hand_is_carried_for_so_many_frames(frames):
    """At 5 pixels a frame from 435 on, joints would be inside for nine frames."""
    found = carried_after([hand_at(430.0), hand_at(435.0), *[ABSENT] * 4], frames)
    assert [hand.present for hand in found[2:]] == [True] * frames + [False] * (4 - frames)
    for step, hand in enumerate(found[2 : 2 + frames], 1):
        np.testing.assert_allclose(hand.joints_px, grid_at(435 + 5 * step))


def test_once_given_up_a_hand_must_be_seen_twice_again():
    found = carried_after([*LEAVING, ABSENT, ABSENT, hand_at(440.0), ABSENT])
    assert [hand.present for hand in found[4:]] == [True, False, True, False]


def test_a_hand_found_again_is_a_new_one():
    """The carried place is no sighting, nor is what was before it."""
    found = carried_after([*LEAVING, ABSENT, hand_at(440.0), ABSENT])
    assert found[-1] is ABSENT


def test_time_may_be_counted_in_any_unit():
    seconds = [1e5 + i / 30 for i in range(5)]
    found = carried_after([*LEAVING, ABSENT], times=seconds)[-1]
    np.testing.assert_allclose(found.joints_px, grid_at(450), rtol=1e-6)


def test_a_pause_is_not_bridged():
    assert carried_after([*LEAVING, ABSENT], times=[0, 1, 2, 3, 4.4])[-1].present
    assert carried_after([*LEAVING, ABSENT], times=[0, 1, 2, 3, 4.6])[-1] is ABSENT


def test_a_pause_between_two_sightings_ends_what_was_before():
    """Seen in frames 0 and 1, then in 100, 101: the velocity is that of the last two alone."""
    hands = [hand_at(100.0), hand_at(120.0), hand_at(425.0), hand_at(435.0), ABSENT]
    np.testing.assert_allclose(carried_after(hands, times=[0, 1, 100, 101, 102])[-1].joints_px, grid_at(445))
    assert carried_after([*hands[:3], ABSENT], times=[0, 1, 100, 101])[-1] is ABSENT


def test_another_camera_is_another_video():
    """At half the size, the same pixels would lie across the border."""
    larger = CENTRED_CAMERA.resized(960, 540)
    leaving = LeavingHand()
    for time, hand in enumerate((hand_at(400.0), hand_at(440.0))):
        leaving.update(hand, time, larger)
    assert leaving.update(ABSENT, 2, CENTRED_CAMERA) is ABSENT


def test_other_systems_may_give_no_joints_in_the_picture():
    bare = dataclasses.replace(LEAVING[-1], joints_px=None)
    assert carried_after([bare, bare, ABSENT])[-1] is ABSENT


def test_forgotten_is_forgotten():
    leaving = LeavingHand()
    for time, hand in enumerate(LEAVING):
        leaving.update(hand, time, CENTRED_CAMERA)
    leaving.reset()
    assert leaving.update(ABSENT, 4, CENTRED_CAMERA) is ABSENT


def tracked(hands, **settings):
    """The left hand through `HandTracker`."""
    tracker = HandTracker(**settings)
    frames = [TwoHandPose(hand, ABSENT, CENTRED_CAMERA, None, i, None) for i, hand in enumerate(hands)]
    return [tracker.update(pose) for pose in frames]


def test_the_tracker_places_a_leaving_hand_at_the_predicted_range():
    poses = tracked([*LEAVING, ABSENT, ABSENT])
    found = poses[4].left
    assert found.valid and found.method == PREDICTED and not poses[4].right.present
    np.testing.assert_allclose(found.range_m, RANGE_M)
    np.testing.assert_allclose(np.linalg.norm(found.joints_m[ROOT]), RANGE_M)
    np.testing.assert_allclose(project(found.joints_m[ROOT], CENTRED_CAMERA), found.joints_px[ROOT])
    assert poses[5].left is ABSENT


def test_the_tracker_carries_no_hand_if_it_is_told_so():
    assert tracked([*LEAVING, ABSENT], carried_frames=0)[-1].left is ABSENT


def test_a_hand_without_a_queue_is_carried_without_a_range():
    found = tracked([*LEAVING[-2:], ABSENT])[-1].left  # two radii predict nothing
    assert found.present and not found.valid and found.joints_m is None


def test_a_frame_that_is_refused_leaves_no_trace():
    """Named case: a time stamp that came twice counted as a pause, and the leaving hand was not carried on."""
    tracker = HandTracker()
    for i, hand in enumerate(LEAVING):
        pose = TwoHandPose(hand, ABSENT, CENTRED_CAMERA, None, i, None)
        tracker.update(pose)
    with pytest.raises(InputError, match="does not follow"):
        tracker.update(pose)
    assert tracker.update(TwoHandPose(ABSENT, ABSENT, CENTRED_CAMERA, None, len(LEAVING), None)).left.present


def test_the_tracker_forgets_leaving_hands_too():
    tracker = HandTracker(RangeSmoothing())
    for i, hand in enumerate(LEAVING):
        tracker.update(TwoHandPose(hand, ABSENT, CENTRED_CAMERA, None, i, None))
    tracker.reset()
    assert not tracker.update(TwoHandPose(ABSENT, ABSENT, CENTRED_CAMERA, None, 0, None)).left.present
