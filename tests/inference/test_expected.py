"""Where hands will be in the frame that comes, by what each pair of pose networks has seen of them."""

from dataclasses import replace

import numpy as np
from tests.oracles import drawn_hands

from twohands.inference.expected import FARTHEST, Expected, as_expected, strayed
from twohands.inference.trail import Trail
from twohands.skeleton import LEFT, RIGHT
from twohands.types import HandPose, TwoHandPose

SAMPLE = drawn_hands(1)


def pose_at(index: int, shift=(0.0, 0.0), present=(True, True), time_s: float | None = None) -> TwoHandPose:
    """The true joints, moved by `shift` pixels."""
    left, right = (
        HandPose(True, 0.9, joints_px=SAMPLE.joints_px[side] + shift) if present[side] else HandPose(present=False)
        for side in range(2)
    )
    return TwoHandPose(left, right, SAMPLE.camera, None, index, time_s)


def trail_of(*poses: TwoHandPose) -> Trail:
    return Trail(poses[-2:], poses[-1], may_rest=True)


def test_hands_move_on_as_they_did():
    moving = trail_of(pose_at(0), pose_at(1, (3.0, -2.0)))
    np.testing.assert_allclose(Expected.of(moving, 2).joints_px, SAMPLE.joints_px + np.array([6.0, -4.0]))
    np.testing.assert_allclose(Expected.of(trail_of(pose_at(0)), 1).joints_px, SAMPLE.joints_px)
    timed = trail_of(pose_at(0, time_s=0.0), pose_at(1, (3.0, -2.0), time_s=0.1))
    np.testing.assert_allclose(Expected.of(timed, 0.15).joints_px, SAMPLE.joints_px + np.array([4.5, -3.0]))


def test_nothing_is_expected_after_a_pause_or_of_a_hand_that_was_not_there():
    moving = trail_of(pose_at(0), pose_at(1, (3.0, -2.0)))
    assert np.isnan(Expected.of(moving, 3).joints_px).all()
    coming = trail_of(pose_at(0, present=(False, False)), pose_at(1, (9.0, 9.0), present=(True, False)))
    expected = Expected.of(coming, 2).joints_px
    np.testing.assert_allclose(expected[0], SAMPLE.joints_px[0] + 9.0)
    assert np.isnan(expected[1]).all()


def test_each_pair_expects_hands_where_it_saw_them_itself():
    """Named case: two pairs that see the joints elsewhere, and count by turns, were never where they were expected."""
    off_px = 0.5 * np.ptp(SAMPLE.joints_px[LEFT], axis=0).max()
    other_px = SAMPLE.joints_px[LEFT] + np.array([off_px, 0.0])

    def seen(index, pair):
        pose, shift = pose_at(index), np.array([index * 2.0, 0.0])
        by_pair = [SAMPLE.joints_px[LEFT] + shift, other_px + shift]
        left = replace(pose.left, joints_px=by_pair[pair], other_px=by_pair[1 - pair], pair=pair)
        return replace(pose, left=left)

    trail = trail_of(seen(0, 0), seen(1, 1))
    expected = Expected.of(trail, 2)
    np.testing.assert_allclose(expected.seen_px[0, LEFT], SAMPLE.joints_px[LEFT] + np.array([4.0, 0.0]))
    np.testing.assert_allclose(expected.seen_px[1, LEFT], other_px + np.array([4.0, 0.0]))
    np.testing.assert_allclose(expected.joints_px[LEFT], expected.seen_px[1, LEFT])
    assert expected.pairs.tolist() == [1, 0] and np.isnan(expected.seen_px[1, RIGHT]).all()
    assert as_expected(seen(2, 0), trail) and as_expected(seen(2, 1), trail)


def test_a_pair_that_saw_one_frame_expects_the_hand_to_move_as_the_other_saw_it():
    """Named case: a hand that the second pair took over was expected to stand still, and lost at once."""
    step = np.array([9.0, -4.0])

    def seen(index, pair, **more):
        pose = pose_at(index, index * step)
        return replace(pose, left=replace(pose.left, pair=pair, **more))

    now = seen(1, 1, other_px=SAMPLE.joints_px[LEFT] + step)
    for last in (now, seen(1, 1)):
        expected = Expected.of(trail_of(seen(0, 0), last), 2)
        np.testing.assert_allclose(expected.joints_px[LEFT], SAMPLE.joints_px[LEFT] + 2 * step)


def test_what_is_known_of_ranges_is_that_of_the_last_frame():
    pose = pose_at(0)
    expected = Expected.of(trail_of(replace(pose, left=replace(pose.left, range_shares=(1.25, 0.1, 0.7)))), 1)
    np.testing.assert_allclose(expected.ranges[LEFT], [1.25, 0.1, 0.7])
    assert np.isnan(expected.ranges[RIGHT]).all()


def test_hands_are_as_expected_where_they_moved_on_as_they_did():
    """The second pair's may lie anywhere; another hand than before is not expected."""
    size_px = np.ptp(SAMPLE.joints_px, axis=1).max(axis=1).min()
    far_px = 2 * FARTHEST[0] * size_px
    trail = trail_of(pose_at(0), pose_at(1, (3.0, 0.0)))
    assert as_expected(pose_at(2, (6.0, 0.0)), trail) and not as_expected(pose_at(2), None)
    astray = pose_at(2, (6.0 + far_px, 0.0))
    assert not as_expected(astray, trail)
    left, right = (replace(hand, pair=1) for hand in astray.hands)
    assert as_expected(replace(astray, left=left, right=right), trail)
    assert not as_expected(pose_at(2, (6.0, 0.0), present=(True, False)), trail)
    assert not as_expected(pose_at(2), trail_of(pose_at(0), pose_at(1, present=(True, False))))


def test_how_far_a_hand_has_strayed():
    """From a hand 100 pixels long all joints are 6 and 8 pixels away: a tenth."""
    expected_px = np.zeros((1, 21, 2))
    expected_px[0, 0] = 100, 40
    np.testing.assert_allclose(strayed(expected_px, expected_px + np.array([6.0, 8.0])), [0.1])
