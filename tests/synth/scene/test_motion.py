"""Motion: continuous to the second derivative, within the limits of joints and speeds, hands apart."""

import numpy as np
import pytest

from twohands.errors import InputError
from twohands.skeleton import LEFT, RIGHT
from twohands.synth.scene.body import load_asset
from twohands.synth.scene.collision import hand_enters_itself, hands_collide
from twohands.synth.scene.config import SynthConfig
from twohands.synth.scene.motion import (
    ANGLES,
    HEAD_CENTRE,
    HEAD_RADIUS,
    MAX_LAG,
    STATE_SIZE,
    SWIVEL,
    WRIST_PART,
    Arm,
    HandMotion,
    MotionConfig,
    enters_head,
    in_picture,
    minimum_jerk,
    plan_motion,
)
from twohands.synth.scene.pose import ANGLE_LIMITS, ArmAnatomy, HandAngles
from twohands.synth.scene.sampling import sample_angles
from twohands.types import PinholeCamera

CAMERA = PinholeCamera.ego3dhands(480, 270)
AHEAD = np.eye(3, 4)
MOTION = MotionConfig(leave_rate=0.15)
TIMES = np.arange(75) / 30


def make_arms():
    body = load_asset().body()
    return Arm(body, ArmAnatomy(body, LEFT)), Arm(body, ArmAnatomy(body, RIGHT))


@pytest.fixture(scope="module")
def arms():
    return make_arms()


@pytest.fixture(scope="module")
def hands(arms):
    return plan_motion(SynthConfig(), MOTION, arms, CAMERA, AHEAD, TIMES, np.random.default_rng(4))


@pytest.fixture(scope="module")
def joints(arms, hands):
    """(2, N, 22, 3)"""
    return np.stack([arm.joints(motion.states(TIMES))[0] for arm, motion in zip(arms, hands, strict=True)])


def test_minimum_jerk_by_hand():
    np.testing.assert_allclose(minimum_jerk(np.array([-1.0, 0.0, 0.5, 1.0, 3.0])), [0, 0, 0.5, 1, 1])
    # 10/64 - 15/256 + 6/1024 = (160 - 60 + 6) / 1024
    assert minimum_jerk(np.array([0.25]))[0] == pytest.approx(106 / 1024)
    u = np.linspace(0, 1, 2001)
    speed = np.gradient(minimum_jerk(u), u)
    assert speed.max() == pytest.approx(1.875, abs=1e-5)
    assert np.gradient(speed, u)[2:-2].max() == pytest.approx(10 / np.sqrt(3), abs=1e-3)


def third_differences(values, step):
    """Largest |x(t+3h) - 3 x(t+2h) + 3 x(t+h) - x(t)| / h^2: the change of acceleration over one step."""
    return np.abs(np.diff(values, 3, axis=0)).max() / step**2


def test_motion_is_continuous_to_the_second_derivative(hands):
    """The change of acceleration over a step falls with the step; a jump anywhere would stay as it is."""
    for motion in hands:
        jumps = []
        for step in (4e-3, 1e-3):
            jumps.append(third_differences(motion.states(np.arange(0, 2, step)), step))
        assert jumps[1] < 0.35 * jumps[0]


def test_the_check_of_continuity_can_fail():
    """Smooth-step, 3 u^2 - 2 u^3, starts with a jump of its acceleration."""

    def smooth_step(t):
        u = np.clip((t - 0.5) / 0.8, 0, 1)
        return u**2 * (3 - 2 * u)

    jumps = [third_differences(smooth_step(np.arange(0, 4, step)), step) for step in (4e-3, 1e-3)]
    assert jumps[1] > 0.9 * jumps[0]


def test_joints_in_the_picture_move_without_jerks(joints):
    """Finite differences of the posed joints at 30 frames a second: nothing teleports, nothing freezes."""
    speed = np.linalg.norm(np.diff(joints, axis=1), axis=-1) * 30
    acceleration = np.linalg.norm(np.diff(joints, 2, axis=1), axis=-1) * 30**2
    assert speed.max() < 4.0 and acceleration.max() < 50.0
    assert (speed[:, :, 1:].max((0, 2)) > 1e-3).all()


def test_limits_hold_in_every_frame(hands):
    times = np.linspace(0, TIMES[-1], 1000)
    for motion in hands:
        angles = motion.states(times)[:, ANGLES]
        assert (angles >= ANGLE_LIMITS[:, 0] - 1e-9).all() and (angles <= ANGLE_LIMITS[:, 1] + 1e-9).all()


def test_speeds_are_human(hands):
    step = 1e-3
    for motion in hands:
        states = motion.states(np.arange(0, TIMES[-1], step))
        first, second = np.diff(states, axis=0) / step, np.diff(states, 2, axis=0) / step**2
        assert np.linalg.norm(first[:, WRIST_PART], axis=1).max() <= MOTION.max_speed
        assert np.linalg.norm(second[:, WRIST_PART], axis=1).max() <= MOTION.max_acceleration
        assert np.degrees(np.abs(first[:, SWIVEL:]).max()) <= MOTION.max_angular_speed
        assert np.degrees(np.abs(second[:, SWIVEL:]).max()) <= MOTION.max_angular_acceleration
        # ... and not those of a statue.
        assert np.linalg.norm(first[:, WRIST_PART], axis=1).max() > 0.2
        assert np.degrees(np.abs(first[:, ANGLES]).max()) > 60


def test_slower_bounds_make_slower_hands(arms):
    slow = MotionConfig(max_speed=0.4, max_angular_speed=100)
    motion, _ = plan_motion(SynthConfig(), slow, arms, CAMERA, AHEAD, TIMES[:30], np.random.default_rng(1))
    speed = np.linalg.norm(np.diff(motion.states(np.arange(0, 1, 1e-3))[:, WRIST_PART], axis=0), axis=1) / 1e-3
    assert speed.max() <= 0.4


def test_nothing_enters_anything(joints):
    body = load_asset().body()
    for k in range(len(TIMES)):
        seen = [in_picture(joints[side, k, 1:], CAMERA) for side in (LEFT, RIGHT)]
        assert any(seen)
        assert not (all(seen) and hands_collide(body, joints[:, k]))
        for side in (LEFT, RIGHT):
            assert not hand_enters_itself(body, joints[side, k])
            assert not enters_head(joints[side, k])
            assert not seen[side] or joints[side, k, 1:, 2].min() >= 0.05


def test_hands_leave_and_return(arms):
    motion, times = MotionConfig(leave_rate=0.8, duration=(0.35, 0.4), pause=(0.01, 0.02)), np.arange(30) / 10
    left, _ = plan_motion(SynthConfig(), motion, arms, CAMERA, AHEAD, times, np.random.default_rng(0))
    seen = in_picture(arms[LEFT].joints(left.states(times))[0][:, 1:], CAMERA)
    changes = np.diff(seen.astype(int))
    assert seen[0] and -1 in changes
    gone = int(np.flatnonzero(changes == -1)[0])
    assert 1 in changes[gone:]


def test_hands_move_independently(hands):
    left, right = hands
    assert len(left.starts) >= 2 and len(right.starts) >= 2
    assert not np.array_equal(left.starts[:2], right.starts[:2])


def test_same_generator_same_motion():
    times = TIMES[:20]
    one, two, other = (
        plan_motion(SynthConfig(), MOTION, make_arms(), CAMERA, AHEAD, times, np.random.default_rng(seed))
        for seed in (4, 4, 5)
    )
    for side in (LEFT, RIGHT):
        np.testing.assert_array_equal(one[side].states(times), two[side].states(times))
        assert not np.array_equal(other[side].keys[0], one[side].keys[0])


def test_a_single_time_needs_no_other(hands):
    whole = hands[LEFT].states(TIMES)
    np.testing.assert_array_equal(hands[LEFT].states(TIMES[57:58])[0], whole[57])


def test_overlapping_movements_by_hand():
    """Keys 0 -> 1 -> 3 with half-overlapping movements of effective length 1 s, no lag, no drift."""
    span = 1 / (1 - MAX_LAG)
    still = np.zeros((3, STATE_SIZE))
    keys = np.outer([0.0, 1.0, 3.0], np.ones(STATE_SIZE))
    motion = HandMotion(
        keys, np.array([0.0, 0.75]), np.full(2, span), np.zeros((2, STATE_SIZE)), np.zeros(3, bool), still, still, still
    )
    # At 1 s the first has ended and the second is a quarter through: 1 + 2 * 106 / 1024.
    np.testing.assert_allclose(motion.states([0.0, 0.5, 1.0, 9.0])[:, 0], [0, 0.5, 1 + 212 / 1024, 3])


def test_head_is_a_sphere():
    joints = np.tile([0.0, 0.0, 0.5], (22, 1))
    assert not enters_head(joints)
    joints[5] = HEAD_CENTRE + np.array([0, 0, HEAD_RADIUS - 0.01])
    assert enters_head(joints)


def test_angles_as_a_vector_and_back():
    angles = sample_angles(np.random.default_rng(3))
    again = HandAngles.from_vector(angles.as_vector())
    assert again.pronation == angles.pronation and again.cup == angles.cup
    np.testing.assert_array_equal(again.thumb, angles.thumb)
    np.testing.assert_array_equal(again.fingers, angles.fingers)


def test_random_angles_lie_within_the_limits_but_for_their_tails():
    angles = sample_angles(np.random.default_rng(0), (4000,)).as_vector()
    outside = (angles < ANGLE_LIMITS[:, 0] - 1e-9) | (angles > ANGLE_LIMITS[:, 1] + 1e-9)
    assert outside.mean(0).max() < 0.01
    span = angles.max(0) - angles.min(0)
    assert (span > 0.75 * (ANGLE_LIMITS[:, 1] - ANGLE_LIMITS[:, 0])).all()


def test_impossible_box_is_one_clear_error(arms):
    config = SynthConfig(box_min=(-0.2, -0.1, 1.5), box_max=(0.2, 0.1, 1.6))
    with pytest.raises(InputError, match="left hand fits the hand box"):
        plan_motion(config, MotionConfig(), arms, CAMERA, AHEAD, TIMES[:3], np.random.default_rng(0))


@pytest.mark.parametrize(
    "changes",
    [
        {"duration": (1.0, 0.5)},
        {"duration": (0.0, 0.5)},
        {"pause": (-1.0, 0.5)},
        {"leave_rate": 1.5},
        {"arm_only_rate": 0.6, "hand_only_rate": 0.6},
        {"max_speed": 0.0},
        {"max_angular_acceleration": 1.0},
        {"drift": 0.5},
    ],
)
def test_nonsense_is_refused(changes):
    with pytest.raises(InputError, match="motion"):
        MotionConfig(**changes)
