"""Anatomy: zero is straight, positive bends the way a hand does, left and right mirror each other."""

import numpy as np
import pytest

from twohands.skeleton import LEFT, RIGHT
from twohands.synth.scene.body import forward_kinematics, load_asset, posed_joints
from twohands.synth.scene.config import SynthConfig
from twohands.synth.scene.pose import ArmAnatomy, HandAngles, rotation_about, signed_angle
from twohands.synth.sets.instances import sample_scene

MIRROR = np.array([-1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def body():
    return load_asset().body()


def angles(**changes):
    values = {
        "pronation": 0.0,
        "wrist_flexion": 0.0,
        "wrist_deviation": 0.0,
        "cup": 0.0,
        "thumb": np.zeros(4),
        "fingers": np.zeros((4, 4)),
    }
    return HandAngles(**{**values, **changes})


def pose_hand(body, side, **changes):
    anatomy = ArmAnatomy(body, side)
    rotations = np.tile(np.eye(3), (48, 1, 1))
    rotations[anatomy.first : anatomy.first + 24] = anatomy.hand_rotations(angles(**changes))
    return posed_joints(body, forward_kinematics(body, rotations))[side, 1:], anatomy


def bend(a, b, c):
    """Angle between bones a-b and b-c, radians."""
    u, v = b - a, c - b
    return np.arccos(np.clip(u @ v / np.linalg.norm(u) / np.linalg.norm(v), -1, 1))


@pytest.mark.parametrize("side", [LEFT, RIGHT])
@pytest.mark.parametrize("finger", range(4))
@pytest.mark.parametrize("flexion", [0.0, 0.5, 1.2])
def test_a_flexed_finger_bends_by_that_angle_towards_the_palm(body, side, finger, flexion):
    fingers = np.zeros((4, 4))
    fingers[finger, 2] = flexion
    joints, anatomy = pose_hand(body, side, fingers=fingers)
    mcp, pip, dip = joints[5 + 4 * finger : 8 + 4 * finger]
    axis = anatomy.finger_axes[finger]
    # Knuckle and wrist have moved the hand; measure in the plane the finger bends in.
    assert bend(mcp, pip, dip) == pytest.approx(flexion, abs=0.12)
    straight, _ = pose_hand(body, side)
    inward = (joints - straight)[8 + 4 * finger] @ _palm_normal(straight, side)
    assert inward > 0.005 if flexion else abs(inward) < 1e-9
    assert np.linalg.norm(axis) == pytest.approx(1)


def _palm_normal(joints, side):
    across = np.cross(joints[9] - joints[0], joints[5] - joints[17])
    return across / np.linalg.norm(across) * (1 if side == LEFT else -1)


@pytest.mark.parametrize("side", [LEFT, RIGHT])
def test_a_flexed_wrist_moves_the_fingers_palmwards(body, side):
    straight, _ = pose_hand(body, side)
    flexed, _ = pose_hand(body, side, wrist_flexion=0.6)
    assert (flexed[9] - straight[9]) @ _palm_normal(straight, side) > 0.03
    np.testing.assert_allclose(flexed[0], straight[0], atol=1e-12)


@pytest.mark.parametrize("side", [LEFT, RIGHT])
def test_a_deviated_wrist_moves_the_fingers_towards_the_thumb(body, side):
    straight, _ = pose_hand(body, side)
    deviated, _ = pose_hand(body, side, wrist_deviation=0.3)
    assert (deviated[9] - straight[9]) @ (straight[5] - straight[17]) > 0


@pytest.mark.parametrize("side", [LEFT, RIGHT])
def test_spread_opens_towards_the_thumb(body, side):
    fingers = np.zeros((4, 4))
    straight, _ = pose_hand(body, side)
    fingers[0, 0] = 0.2
    spread, _ = pose_hand(body, side, fingers=fingers)
    assert (spread[8] - straight[8]) @ (straight[5] - straight[17]) > 0
    np.testing.assert_allclose(spread[12], straight[12], atol=1e-12)


@pytest.mark.parametrize("side", [LEFT, RIGHT])
@pytest.mark.parametrize(("radial", "palmar"), [(0.0, 0.0), (0.5, 0.0), (0.2, 0.7), (0.9, 0.4)])
def test_the_thumbs_metacarpal_points_where_it_is_told(body, side, radial, palmar):
    joints, _ = pose_hand(body, side, thumb=np.array([radial, palmar, 0.0, 0.0]))
    bone = joints[2] - joints[1]
    normal = _palm_normal(joints, side)
    assert np.arcsin(bone @ normal / np.linalg.norm(bone)) == pytest.approx(palmar, abs=0.06)
    along = joints[9] - joints[0]
    outward = np.cross(normal, along) * (1 if side == LEFT else -1)
    outward *= np.sign(outward @ (joints[5] - joints[17]))
    angle = np.arctan2(bone @ outward / np.linalg.norm(outward), bone @ along / np.linalg.norm(along))
    assert angle == pytest.approx(radial, abs=0.06)


@pytest.mark.parametrize("side", [LEFT, RIGHT])
def test_opposition_brings_the_thumb_out_of_the_palm_not_to_the_wrist(body, side):
    """Named case: opposition once swung the tip back towards the wrist."""
    flat, _ = pose_hand(body, side, thumb=np.array([0.5, 0.0, 0.2, 0.2]))
    opposed, _ = pose_hand(body, side, thumb=np.array([0.3, 0.8, 0.2, 0.2]))
    assert (opposed[4] - flat[4]) @ _palm_normal(flat, side) > 0.02
    hand_length = np.linalg.norm(opposed[9] - opposed[0])
    assert np.linalg.norm(opposed[4] - opposed[0]) > 0.6 * hand_length


@pytest.mark.parametrize("side", [LEFT, RIGHT])
def test_a_bent_thumb_comes_nearer_to_the_little_finger(body, side):
    straight, _ = pose_hand(body, side, thumb=np.array([0.5, 0.4, 0.0, 0.0]))
    bent, _ = pose_hand(body, side, thumb=np.array([0.5, 0.4, 0.6, 0.8]))
    assert np.linalg.norm(bent[4] - bent[17]) < np.linalg.norm(straight[4] - straight[17]) - 0.01


def test_random_thumbs_are_where_peoples_are():
    """Tip relative to the middle knuckle in palm widths; people (96 photographs): along -0.2..0.4, out 0.2..1.2."""
    tips = []
    for i in range(60):
        scene = sample_scene(SynthConfig(width=480, height=270), 31, i)
        for side in np.flatnonzero(scene.present):
            joints = scene.joints_m[side, 1:]
            width = np.linalg.norm(joints[5] - joints[17])
            along = (joints[9] - joints[0]) / np.linalg.norm(joints[9] - joints[0])
            tip = (joints[4] - joints[9]) / width
            tips.append([tip @ along, tip @ _palm_normal(joints, side)])
    along, out = np.median(tips, axis=0)
    assert -0.35 < along < 0.35
    assert 0.3 < out < 1.1


def test_pronation_turns_both_palms_down(body):
    for side in (LEFT, RIGHT):
        neutral, _ = pose_hand(body, side)
        turned, _ = pose_hand(body, side, pronation=1.0)
        # y points down.
        assert _palm_normal(turned, side)[1] > _palm_normal(neutral, side)[1]


def test_left_and_right_mirror_each_other(body):
    rng = np.random.default_rng(3)
    for _ in range(10):
        changes = {
            "pronation": rng.uniform(-1, 1),
            "wrist_flexion": rng.uniform(-1, 1),
            "wrist_deviation": rng.uniform(-0.3, 0.3),
            "cup": rng.uniform(0, 0.2),
            "thumb": rng.uniform(-0.3, 0.8, 4),
            "fingers": rng.uniform(-0.2, 1.2, (4, 4)),
        }
        left, _ = pose_hand(body, LEFT, **changes)
        right, _ = pose_hand(body, RIGHT, **changes)
        np.testing.assert_allclose(left * MIRROR, right, atol=1e-3)


@pytest.mark.parametrize("side", [LEFT, RIGHT])
def test_the_arm_reaches_its_target_with_lengths_kept(body, side):
    rng = np.random.default_rng(4)
    anatomy = ArmAnatomy(body, side)
    reached = 0
    for _ in range(50):
        target = anatomy.shoulder + rng.uniform([-0.3, -0.3, 0.0], [0.3, 0.3, 0.5])
        rotations = np.tile(np.eye(3), (48, 1, 1))
        arm = anatomy.hand_rotations(angles(pronation=rng.uniform(-1, 1)))
        before = arm.copy()
        if not anatomy.reach(arm, target, rng.uniform(0, 1)):
            np.testing.assert_array_equal(arm, before)
            assert np.linalg.norm(target - anatomy.shoulder) > 0.9 * anatomy.max_reach or (
                np.linalg.norm(target - anatomy.shoulder) < 0.1
            )
            continue
        reached += 1
        rotations[anatomy.first : anatomy.first + 24] = arm
        joints = posed_joints(body, forward_kinematics(body, rotations))[side]
        # The forearm twists about a bone that lies a little beside the line from elbow to wrist.
        np.testing.assert_allclose(joints[1], target, atol=1e-3)
        assert np.linalg.norm(joints[0] - joints[1]) == pytest.approx(anatomy.lower_length, abs=1e-3)
    assert reached > 20


def test_rotation_and_signed_angle_by_hand():
    z = np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(rotation_about(z, np.pi / 2) @ [1.0, 0, 0], [0, 1, 0], atol=1e-15)
    assert signed_angle(np.array([1.0, 0, 5]), np.array([0, 2.0, -1]), z) == pytest.approx(np.pi / 2)
    assert signed_angle(np.array([0, 2.0, -1]), np.array([1.0, 0, 5]), z) == pytest.approx(-np.pi / 2)
