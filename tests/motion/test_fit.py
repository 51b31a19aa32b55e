"""The fit of fixed bones: exact where bones are fixed, near where they are not, and the same at rest as an avatar."""

import numpy as np
import pytest
from tests.builders import open_hand
from tests.motion.moving import bent_hand, moving_hands, turn_about

from twohands.motion.clip import UPRIGHT_FROM_CAMERA
from twohands.motion.fit import PALM, fit_hand, fit_motion, fit_skeleton, pose_hand
from twohands.skeleton import LEFT, N_JOINTS, PARENTS, RIGHT

BONES = [(PARENTS[joint], joint) for joint in range(1, N_JOINTS)]


def lengths(joints):
    return np.stack([np.linalg.norm(joints[..., b, :] - joints[..., a, :], axis=-1) for a, b in BONES], axis=-1)


def t_pose(side: int) -> np.ndarray:
    """(21, 3) upright frame: fingers outwards along x, back of the hand up, thumb forward at 45 degrees."""
    out = -1.0 if side == LEFT else 1.0
    hand = np.zeros((21, 3))
    for joint, z in ((5, -0.03), (9, 0.0), (13, 0.02), (17, 0.04)):
        for i in range(4):
            hand[joint + i] = [out * (0.1 + 0.03 * i), 0.0, z]
    for i in range(4):
        hand[1 + i] = [out * (0.03 + 0.02 * i), 0.0, -0.03 - 0.02 * i]
    return hand


def test_fixed_bones_are_fitted_exactly():
    motion = moving_hands(40, valid=np.random.default_rng(1).random((40, 2)) < 0.8)
    for side, hand in fit_motion(motion).items():
        assert hand.distance_m.max() < 1e-12
        np.testing.assert_array_equal(hand.rows, np.flatnonzero(motion.valid[:, side]))
        np.testing.assert_allclose(hand.joints_m @ UPRIGHT_FROM_CAMERA, motion.joints_m[hand.rows, side], atol=1e-12)


def test_forward_kinematics_and_rotations():
    for hand in fit_motion(moving_hands(10)).values():
        np.testing.assert_allclose(
            hand.turns @ np.swapaxes(hand.turns, -1, -2), np.eye(3)[None, None] + 0 * hand.turns, atol=1e-12
        )
        np.testing.assert_allclose(np.linalg.det(hand.turns), 1.0)
        np.testing.assert_allclose(hand.skeleton.joints(hand.joints_m[:, 0], hand.turns), hand.joints_m, atol=1e-12)
        turns, local = np.empty_like(hand.turns), hand.local_turns_of()
        for joint, parent in enumerate(PARENTS):
            turns[:, joint] = local[:, joint] if parent < 0 else turns[:, parent] @ local[:, joint]
        np.testing.assert_allclose(turns, hand.turns, atol=1e-12)


def test_bones_keep_their_length_where_the_clip_s_do_not():
    """Bones that vary by 6 %: each is as long as its median, and the fit lies about as far off as they vary."""
    motion = moving_hands(60)
    noisy = motion.joints_m + np.random.default_rng(0).normal(0, 0.002, motion.joints_m.shape)
    for side in range(2):
        hand = fit_hand(noisy[:, side], motion.valid[:, side], side)
        assert np.ptp(lengths(hand.joints_m), axis=0).max() < 1e-12
        fingers = [n for n, (parent, joint) in enumerate(BONES) if joint not in PALM]
        medians = np.median(lengths(noisy[:, side]), axis=0)
        np.testing.assert_allclose(lengths(hand.joints_m)[0, fingers], medians[fingers], atol=1e-12)
        assert hand.distance_m.mean() < 0.0035
        true = motion.joints_m[:, side] @ UPRIGHT_FROM_CAMERA.T
        assert np.linalg.norm(hand.joints_m - true, axis=-1).mean() < 0.0035


def test_few_wild_frames_change_no_bone():
    motion = moving_hands(40)
    wild = motion.joints_m.copy()
    wild[5, LEFT] *= 1.5
    wild[17, LEFT] = np.random.default_rng(0).normal(0, 1, (21, 3))
    hand = fit_hand(wild[:, LEFT], motion.valid[:, LEFT], LEFT)
    calm = fit_hand(motion.joints_m[:, LEFT], motion.valid[:, LEFT], LEFT)
    np.testing.assert_allclose(hand.skeleton.rest_m, calm.skeleton.rest_m, atol=1e-6)


@pytest.mark.parametrize("side", [LEFT, RIGHT])
def test_an_avatar_s_t_pose_is_the_rest_pose(side):
    """No rotation anywhere, and moved and turned as a whole, that rotation at the wrist alone."""
    rest = t_pose(side)
    hand = fit_hand((rest @ UPRIGHT_FROM_CAMERA)[None], np.array([True]), side)
    np.testing.assert_allclose(hand.skeleton.rest_m, rest, atol=1e-12)
    np.testing.assert_allclose(hand.turns[0], np.tile(np.eye(3), (21, 1, 1)), atol=1e-9)
    turn = turn_about(np.array([1.0, 2.0, -0.5]), 2.0)
    moved = fit_hand(((rest @ turn.T + [0.1, 0.2, -0.5]) @ UPRIGHT_FROM_CAMERA)[None], np.array([True]), side)
    np.testing.assert_allclose(moved.local_turns_of()[0, 0], turn, atol=1e-9)
    np.testing.assert_allclose(moved.local_turns_of()[0, 1:], np.tile(np.eye(3), (20, 1, 1)), atol=1e-9)


@pytest.mark.parametrize("side", [LEFT, RIGHT])
@pytest.mark.parametrize("angle", [0.3, 1.2, 2.5])
def test_a_bent_finger_turns_about_its_hinge_alone(side, angle):
    """Bent down by an angle at the second joint of the middle finger: a rotation about z of the avatar, of the left
    hand counter-clockwise, as its finger points along -x."""
    hand = t_pose(side)
    out = -1.0 if side == LEFT else 1.0
    for i in (1, 2):
        hand[10 + i] = hand[10] + 0.03 * i * np.array([out * np.cos(angle), -np.sin(angle), 0.0])
    local = pose_hand(fit_skeleton(t_pose(side)[None], side), hand[None], np.zeros(1, int)).local_turns_of()[0]
    np.testing.assert_allclose(local[10], turn_about(np.array([0, 0, 1.0]), -out * angle), atol=1e-9)
    others = [joint for joint in range(21) if joint != 10]
    np.testing.assert_allclose(local[others], np.tile(np.eye(3), (20, 1, 1)), atol=1e-9)


def test_a_mirrored_motion_has_the_mirrored_fit():
    motion = moving_hands(15)
    noisy = motion.joints_m[:, LEFT] + np.random.default_rng(0).normal(0, 0.003, (15, 21, 3))
    valid = np.ones(15, bool)
    left, right = fit_hand(noisy, valid, LEFT), fit_hand(noisy * [-1, 1, 1], valid, RIGHT)
    mirror = np.diag([-1.0, 1.0, 1.0])
    np.testing.assert_allclose(right.skeleton.rest_m, left.skeleton.rest_m * [-1, 1, 1], atol=1e-9)
    np.testing.assert_allclose(right.turns, mirror @ left.turns @ mirror, atol=1e-9)


def test_it_moves_with_the_hand():
    """Turned and moved as a whole, the fit turns and moves as well; frames do not know of each other's order."""
    motion = moving_hands(12)
    noisy = motion.joints_m[:, RIGHT] + np.random.default_rng(3).normal(0, 0.003, (12, 21, 3))
    turn, valid = turn_about(np.array([1.0, 1.0, 0.0]), 0.7), np.ones(12, bool)
    hand, moved = fit_hand(noisy, valid, RIGHT), fit_hand((noisy @ turn.T + 0.1)[::-1], valid, RIGHT)
    there = (hand.joints_m @ UPRIGHT_FROM_CAMERA @ turn.T + 0.1) @ UPRIGHT_FROM_CAMERA.T
    np.testing.assert_allclose(moved.joints_m[::-1], there, atol=1e-9)


def test_each_bone_ends_as_near_as_its_length_allows():
    """The second joint of a finger, pulled away by 1 cm along the bone: the fit ends on the way there."""
    hand = bent_hand(np.zeros((5, 3)), LEFT) @ UPRIGHT_FROM_CAMERA.T
    skeleton = fit_skeleton(hand[None], LEFT)
    pulled = hand.copy()
    step = (hand[6] - hand[5]) / np.linalg.norm(hand[6] - hand[5])
    pulled[6:9] += 0.01 * step
    posed = pose_hand(skeleton, pulled[None], np.zeros(1, int))
    np.testing.assert_allclose(posed.joints_m[0, 6], hand[6], atol=1e-9)
    assert posed.distance_m[0, 6] == pytest.approx(0.01)


@pytest.mark.parametrize("joints", [np.zeros((21, 3)), np.arange(21)[:, None] * [[0.0, 0.001, 0.0]], np.ones((21, 3))])
def test_what_is_no_hand_gets_rotations_all_the_same(joints):
    hand = fit_hand(np.stack([joints, joints]), np.ones(2, bool), LEFT)
    assert np.isfinite(hand.turns).all() and np.isfinite(hand.joints_m).all()
    np.testing.assert_allclose(np.linalg.det(hand.turns), 1.0)


def test_our_own_hand_lies_in_the_rest_pose_as_an_avatar_s():
    """Of the open hand: fingers outwards, thumb and index forwards, little finger backwards."""
    hand = fit_hand(0.1 * open_hand()[None] + [0, 0, 0.5], np.array([True]), LEFT)
    rest = hand.skeleton.rest_m
    assert rest[9, 0] == pytest.approx(-0.1) and np.abs(rest[9, 1:]).max() < 1e-9
    assert rest[5, 2] < 0 < rest[17, 2] and rest[1, 2] < rest[5, 2]
