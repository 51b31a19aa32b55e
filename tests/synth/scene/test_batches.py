"""Poses come singly or in arrays: an array of hands is posed, drawn and judged as its hands one by one."""

import numpy as np
import pytest

from twohands.skeleton import LEFT, RIGHT
from twohands.synth.scene.body import arm_kinematics, carried, forward_kinematics, load_asset, posed_joints
from twohands.synth.scene.collision import hand_enters_itself, hands_collide, segment_distance
from twohands.synth.scene.motion import STATE_SIZE, Arm, enters_head, in_picture
from twohands.synth.scene.pose import (
    ANGLE_LIMITS,
    ArmAnatomy,
    HandAngles,
    cross,
    dot,
    frame,
    rotation_about,
    signed_angle,
    unit,
)
from twohands.synth.scene.sampling import inside_image, sample_angles
from twohands.types import PinholeCamera

CAMERA = PinholeCamera.ego3dhands(480, 270)
BATCH = (3, 20)


@pytest.fixture(scope="module")
def body():
    asset = load_asset()
    return asset.body(asset.coefficients[5, :24])


def random_arms(body, side, seed=0):
    """(3, 20, ...) rotations of arms, some out of reach, and whether they reach."""
    rng = np.random.default_rng(seed)
    anatomy = ArmAnatomy(body, side)
    vectors = rng.uniform(*ANGLE_LIMITS.T, (*BATCH, 24))
    targets = anatomy.shoulder + rng.uniform([-0.4, -0.4, -0.1], [0.4, 0.4, 0.6], (*BATCH, 3))
    swivels = rng.uniform(-0.2, 1.3, BATCH)
    return anatomy, vectors, targets, swivels


def one_by_one(function, *arrays):
    """The function on every element of the two leading dimensions."""
    return np.array([[function(*(a[i, j] for a in arrays)) for j in range(BATCH[1])] for i in range(BATCH[0])])


@pytest.mark.parametrize(
    ("function", "shapes"),
    [
        (dot, [(3,), (3,)]),
        (unit, [(3,)]),
        (cross, [(3,), (3,)]),
        (frame, [(3,), (3,)]),
        (lambda axis, angle: rotation_about(unit(axis), angle), [(3,), ()]),
        (lambda a, b, axis: signed_angle(a, b, unit(axis)), [(3,), (3,), (3,)]),
        (segment_distance, [(3,)] * 4),
    ],
)
def test_vector_functions(function, shapes):
    rng = np.random.default_rng(1)
    arrays = [rng.normal(size=(*BATCH, *shape)) for shape in shapes]
    np.testing.assert_allclose(function(*arrays), one_by_one(function, *arrays), atol=1e-12)


def test_cross_and_dot_are_those_of_numpy():
    a, b = np.random.default_rng(2).normal(size=(2, 7, 3))
    np.testing.assert_allclose(cross(a, b), np.cross(a, b), atol=1e-15)
    np.testing.assert_allclose(dot(a, b), np.diag(a @ b.T), atol=1e-15)


@pytest.mark.parametrize("side", [LEFT, RIGHT])
def test_arms(body, side):
    anatomy, vectors, targets, swivels = random_arms(body, side)

    def rotations_of(vector, target, swivel):
        rotations = anatomy.hand_rotations(HandAngles.from_vector(vector))
        return rotations, anatomy.reach(rotations, target, swivel)

    rotations, reached = rotations_of(vectors, targets, swivels)
    assert 0.2 < reached.mean() < 0.95  # those out of reach are left as they were, beside those that are not
    np.testing.assert_array_equal(reached, one_by_one(lambda *a: rotations_of(*a)[1], vectors, targets, swivels))
    single = one_by_one(lambda *a: rotations_of(*a)[0], vectors, targets, swivels)
    np.testing.assert_allclose(rotations, single, atol=1e-12)
    np.testing.assert_allclose(anatomy.joints(rotations), one_by_one(anatomy.joints, rotations), atol=1e-12)
    np.testing.assert_allclose(anatomy.wrist_before(targets), one_by_one(anatomy.wrist_before, targets), atol=1e-12)


def test_one_arm_moves_as_it_does_in_the_whole_rig(body):
    both = np.stack(
        [ArmAnatomy(body, s).hand_rotations(sample_angles(np.random.default_rng(s), BATCH)) for s in (0, 1)], 2
    )
    rotations = both.reshape(*BATCH, 48, 3, 3)
    transforms = forward_kinematics(body, rotations)
    np.testing.assert_allclose(transforms, one_by_one(lambda r: forward_kinematics(body, r), rotations), atol=1e-12)
    joints = posed_joints(body, transforms)
    np.testing.assert_allclose(joints, one_by_one(lambda t: posed_joints(body, t), transforms), atol=1e-12)
    for side in (LEFT, RIGHT):
        alone = carried(body.joints[side], arm_kinematics(body.heads.reshape(2, 24, 3)[side], both[:, :, side]))
        np.testing.assert_allclose(alone, joints[:, :, side], atol=1e-12)


def test_angles_have_the_asked_shape_and_go_through_vectors():
    angles = sample_angles(np.random.default_rng(0), BATCH)
    vectors = angles.as_vector()
    assert vectors.shape == (*BATCH, 24)
    np.testing.assert_array_equal(HandAngles.from_vector(vectors).fingers, angles.fingers)
    np.testing.assert_array_equal(vectors, one_by_one(lambda v: HandAngles.from_vector(v).as_vector(), vectors))
    assert sample_angles(np.random.default_rng(0)).as_vector().shape == (24,)
    assert len(np.unique(vectors[..., 0])) == np.prod(BATCH)  # every hand is another


def test_judgements(body):
    """Collisions, the head and the picture: both answers occur, and a batch is answered as its hands."""
    joints = []
    for side in (LEFT, RIGHT):
        anatomy, vectors, targets, swivels = random_arms(body, side, seed=3)
        targets = np.array([0.0, 0.1, 0.3]) + np.random.default_rng(4 + side).uniform(-0.25, 0.2, targets.shape)
        rotations = anatomy.hand_rotations(HandAngles.from_vector(vectors))
        anatomy.reach(rotations, targets, swivels)
        joints.append(anatomy.joints(rotations))
    pairs = np.stack(joints, axis=2)  # (3, 20, 2, 22, 3)
    for judge, argument in [
        (lambda j: hand_enters_itself(body, j), joints[0]),
        (lambda j: hands_collide(body, j), pairs),
        (enters_head, joints[0]),
        (lambda j: in_picture(j[..., 1:, :], CAMERA), joints[0]),
    ]:
        answers = judge(argument)
        assert answers.shape == BATCH and 0 < answers.mean() < 1
        np.testing.assert_array_equal(answers, one_by_one(judge, argument))
    inside = inside_image(joints[0], CAMERA, 0.02)
    np.testing.assert_array_equal(inside, one_by_one(lambda j: inside_image(j, CAMERA, 0.02), joints[0]))


def test_hands_far_apart_are_not_looked_at_closely_but_judged_the_same(body):
    """The quick test on boxes around the hands drops no collision: shift one hand through the other."""
    joints = np.stack([body.joints[LEFT], body.joints[LEFT]])
    shifts = np.zeros((200, 2, 1, 3))
    shifts[:, 1, 0] = np.random.default_rng(0).uniform(-0.4, 0.4, (200, 3))
    found = hands_collide(body, joints + shifts)
    near = [
        np.linalg.norm((joints[0, :, None] - (joints[1] + shift[1])[None]), axis=-1).min() < 0.01 for shift in shifts
    ]
    assert 0 < found.mean() < 1 and found[near].all()
    np.testing.assert_array_equal(found, hands_collide(body, (joints + shifts)[:, ::-1]))


def test_states_of_an_arm(body):
    rng = np.random.default_rng(0)
    arm = Arm(body, ArmAnatomy(body, RIGHT))
    states = np.concatenate(
        [arm.anatomy.shoulder + rng.uniform(-0.5, 0.5, (*BATCH, 3)), rng.uniform(0, 1, (*BATCH, STATE_SIZE - 3))],
        axis=-1,
    )
    joints, reached = arm.joints(states)
    assert 0 < reached.mean() < 1
    np.testing.assert_allclose(joints, one_by_one(lambda s: arm.joints(s)[0], states), atol=1e-12)
    np.testing.assert_array_equal(reached, one_by_one(lambda s: arm.joints(s)[1], states))


def test_gestures_are_hands_with_stretched_and_curled_fingers():
    def share(gestures):
        """Of hands with a straight finger beside a curled one."""
        fingers = sample_angles(np.random.default_rng(0), (4000,), gestures).fingers
        bend = fingers[..., 1] + fingers[..., 2]
        return ((bend < np.radians(45)).any(-1) & (bend > np.radians(95)).any(-1)).mean()

    assert share(1.0) > 0.7  # of the others most have the thumb out alone, or all five fingers
    assert share(0.0) < share(0.15) < share(0.5) < share(1.0)


def test_half_of_the_gestures_stretch_the_thumb():
    def straight(gestures):
        """Share of hands with a thumb straight and far from the palm."""
        thumb = sample_angles(np.random.default_rng(0), (4000,), gestures).thumb
        return ((thumb[:, 0] > np.radians(36)) & (np.abs(thumb[:, 2:]) < np.radians(14.1)).all(-1)).mean()

    assert straight(0.0) < 0.05
    assert 0.5 < straight(1.0) < 0.55


def test_a_fist_is_possible(body):
    """Fingers of a fist lie side by side; bent about the arch of the knuckles, they met and 1 fist of 20 remained."""
    anatomy = ArmAnatomy(body, LEFT)
    angles = sample_angles(np.random.default_rng(0), (4000,), gestures=0.15)
    enters = hand_enters_itself(body, anatomy.joints(anatomy.hand_rotations(angles)))
    fists = (angles.fingers[..., 1] + angles.fingers[..., 2] > np.radians(110)).all(-1)
    assert fists.mean() > 0.15
    assert (~enters[fists]).mean() > 0.3
