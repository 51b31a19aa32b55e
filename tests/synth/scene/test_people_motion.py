"""Arms of whole people in motion: they meet their gestures, smoothly, and enter nothing on the way."""

import numpy as np
import pytest

from twohands.synth.scene.body import bone
from twohands.synth.scene.collision import hand_enters_itself, hands_collide
from twohands.synth.scene.config import PEOPLE
from twohands.synth.scene.figures import outline_of
from twohands.synth.scene.motion import MotionConfig
from twohands.synth.scene.people_motion import CHECKED_S, Drift, plan_people_motion
from twohands.synth.scene.posed_arms import Contact
from twohands.synth.scene.whole_people import sample_subject

STILL = MotionConfig(angular_drift=0.0)
SECONDS = 4.0


def planned(seed, motion=STILL):
    rng = np.random.default_rng(seed)
    subject, first = sample_subject(PEOPLE, False, rng)
    return first, plan_people_motion(PEOPLE, motion, subject, first, SECONDS, rng)


@pytest.fixture(scope="module")
def motions():
    return [planned(seed) for seed in range(4)]


def test_arms_begin_with_their_gesture_and_rest_in_the_last_one(motions):
    for first, motion in motions:
        np.testing.assert_allclose(motion.at(0.0).joints, first.joints, atol=1e-9)
        assert motion.end > 0 and len(motion.keys) == 1 + len(motion.starts)
        np.testing.assert_allclose(motion.at(motion.end + 1).joints, motion.at(motion.end + 9).joints, atol=1e-9)


def test_a_movement_begins_when_both_arms_rest(motions):
    for _, motion in motions:
        ends = (motion.starts + motion.durations).max(axis=1)
        assert (motion.starts[1:].min(axis=1) >= ends[:-1] - 1e-9).all()
        assert (motion.durations >= STILL.duration[0]).all()


def test_nothing_jumps_and_wrists_keep_their_speed(motions):
    """Between frames 1/240 s apart; the bound on speed holds for a straight way times a detour."""
    for _, motion in motions:
        joints = np.stack([motion.at(float(time)).joints for time in np.arange(0, motion.end, 1 / 240)])
        speed = 240 * np.linalg.norm(np.diff(joints, axis=0), axis=-1)
        assert speed[..., 1].max() < 1.5 * STILL.max_speed
        assert speed.max() < 4 * STILL.max_speed, "fingertips turn with forearm and hand"
        assert np.abs(np.diff(speed, axis=0)).max() < 0.5


def test_nothing_enters_anything_on_the_way(motions):
    for _, motion in motions:
        person = motion.subject.person
        outline = outline_of(person, motion.subject.posture)
        for start, end in zip(motion.starts.min(axis=1), (motion.starts + motion.durations).max(axis=1), strict=True):
            for time in np.arange(start, end, CHECKED_S):
                arms = motion.at(float(time))
                assert not hands_collide(person.body, arms.joints, 0.9 * arms.contact.near)
                assert not hand_enters_itself(person.body, arms.joints).all()
                depth = outline.depth(arms.joints[:, 2:]).max(axis=1)
                assert (depth < arms.contact.presses_m + 0.01).all()


def test_one_arm_may_move_alone(motions):
    """Then the other one's key, collar bone and all, is the one before."""
    apart = np.concatenate([np.abs(np.diff(motion.keys, axis=0)).max(axis=(2, 3)) for _, motion in motions])
    assert ((apart < 1e-9).sum(axis=1) < 2).all(), "some arm moves"
    alone = [planned(seed)[1] for seed in range(20, 26)]
    apart = np.concatenate([np.abs(np.diff(motion.keys, axis=0)).max(axis=(2, 3)) for motion in alone])
    assert 0 < ((apart < 1e-9).any(axis=1)).sum() < len(apart)


def test_the_same_draws_give_the_same_motion():
    (_, one), (_, other) = planned(1), planned(1)
    np.testing.assert_array_equal(one.keys, other.keys)
    np.testing.assert_array_equal(one.starts, other.starts)


def test_what_is_held_still_drifts_a_little_for_ever():
    drift = Drift.of((2, 3), np.radians(1.0), np.random.default_rng(0))
    turned = np.stack([drift.at(time) for time in np.linspace(0, 20, 200)])
    angles = np.degrees(np.arccos(np.clip((np.trace(turned, axis1=-2, axis2=-1) - 1) / 2, -1, 1)))
    assert 0.3 < angles.max() < np.sqrt(3) and (np.ptp(angles, axis=0) > 0.1).all()
    np.testing.assert_allclose(
        turned @ np.swapaxes(turned, -1, -2), np.broadcast_to(np.eye(3), turned.shape), atol=1e-12
    )


def test_head_and_arms_drift_trunk_and_legs_do_not():
    _, motion = planned(2, MotionConfig())
    turns = np.stack([motion.at(time).turns for time in (0.0, 0.7)])
    moved = np.abs(np.diff(turns, axis=0)[0]).max(axis=(1, 2)) > 1e-6
    assert moved.any() and moved.sum() <= 3 + 2
    wrist = bone("wrist", 0)
    assert (
        np.abs(motion.at(motion.end + 1).rotations[0][wrist] - motion.at(motion.end + 2).rotations[0][wrist]).max() > 0
    )


def test_on_the_way_hands_may_touch_what_either_gesture_touches():
    one = Contact(0.98, np.array([0.0, 0.03]), np.array([False, False]))
    other = Contact(np.full((20, 20), 0.5), np.array([0.02, 0.0]), np.array([True, False]))
    both = one | other
    np.testing.assert_array_equal(both.near, other.near)
    np.testing.assert_array_equal(both.presses_m, [0.02, 0.03])
    np.testing.assert_array_equal(both.hidden, [True, False])
    assert other.together and both.together and not one.together


def test_a_key_is_what_the_arms_then_do():
    """Quaternions of rotations and back: the arms of the first key, with no share of the way covered."""
    first, motion = planned(3)
    np.testing.assert_allclose(motion.at(-1.0).rotations, first.rotations, atol=1e-9)
