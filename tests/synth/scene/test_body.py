"""Laws of the body asset, its kinematics and skinning."""

import numpy as np
import pytest

from twohands.errors import DataFormatError
from twohands.skeleton import LEFT, PARENTS, RIGHT, ROOT, WRIST
from twohands.synth.scene.body import (
    BONE_NAMES,
    BONE_PARENTS,
    BONES_PER_SIDE,
    forward_kinematics,
    load_asset,
    part_labels,
    posed_joints,
    skin,
)
from twohands.synth.scene.pose import rotation_about

MIRROR = np.array([-1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def body():
    return load_asset().body()


def random_rotations(rng, amount=0.6):
    out = np.tile(np.eye(3), (len(BONE_NAMES), 1, 1))
    for i in range(len(out)):
        axis = rng.normal(size=3)
        out[i] = rotation_about(axis / np.linalg.norm(axis), rng.uniform(-amount, amount))
    return out


def test_asset_is_small_and_complete():
    asset = load_asset()
    from twohands.synth.scene.body import ASSET

    assert ASSET.stat().st_size < 8e6
    assert asset.faces.max() == asset.n_vertices - 1
    assert asset.faces.shape[1] == 3 and len(asset.faces) > 8000
    assert asset.uv_faces.max() == len(asset.uv) - 1
    assert np.all((asset.uv >= 0) & (asset.uv <= 1))


def test_weights_are_a_partition_of_unity():
    asset = load_asset()
    total = asset.bone_weight.sum(1)
    assert np.all(asset.bone_weight >= 0)
    assert np.all(total <= 1 + 1e-6)
    # Only at the shoulder does the resting torso take part.
    hand = np.isin(part_labels(asset), [2, 3, 4, 5, 6, 7, 9, 10, 11, 12, 13, 14])
    assert total[hand].min() > 1 - 1e-6


def test_parents_come_before_children():
    assert all(parent < child for child, parent in enumerate(BONE_PARENTS))
    assert [BONE_NAMES[i] for i, p in enumerate(BONE_PARENTS) if p < 0] == ["upperarm01.L", "upperarm01.R"]


def test_rest_pose_is_the_identity(body):
    transforms = forward_kinematics(body, np.tile(np.eye(3), (48, 1, 1)))
    np.testing.assert_allclose(transforms, np.tile(np.eye(3, 4), (48, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(skin(body, transforms), body.vertices, atol=1e-6)
    np.testing.assert_allclose(posed_joints(body, transforms), body.joints, atol=1e-12)


def test_left_is_at_negative_x_and_the_body_is_symmetric(body):
    joints = body.joints
    assert (joints[LEFT, :, 0] < 0).all() and (joints[RIGHT, :, 0] > 0).all()
    np.testing.assert_allclose(joints[LEFT] * MIRROR, joints[RIGHT], atol=2e-4)


def test_moving_the_arms_keeps_every_bone_length(body):
    rng = np.random.default_rng(0)
    rest = body.joints[:, 1:]
    for _ in range(20):
        posed = posed_joints(body, forward_kinematics(body, random_rotations(rng)))[:, 1:]
        for child, parent in enumerate(PARENTS):
            # A knuckle hangs on a metacarpal that starts beyond the wrist: only phalanges are rigid bones of the hand.
            if parent <= 0 or parent in (WRIST,):
                continue
            before = np.linalg.norm(rest[:, child] - rest[:, parent], axis=-1)
            after = np.linalg.norm(posed[:, child] - posed[:, parent], axis=-1)
            np.testing.assert_allclose(after, before, rtol=1e-9)


def test_a_rotated_shoulder_moves_its_whole_arm_rigidly_and_leaves_the_other(body):
    rotations = np.tile(np.eye(3), (48, 1, 1))
    turn = rotation_about(np.array([0.0, 0.0, 1.0]), 0.7)
    rotations[0] = turn
    joints = posed_joints(body, forward_kinematics(body, rotations))
    shoulder = body.heads[0]
    np.testing.assert_allclose(joints[LEFT], (body.joints[LEFT] - shoulder) @ turn.T + shoulder, atol=1e-9)
    np.testing.assert_allclose(joints[RIGHT], body.joints[RIGHT], atol=1e-12)


def test_elbow_by_hand(body):
    """Bending the elbow by a right angle about z moves the wrist to the hand-computed place."""
    rotations = np.tile(np.eye(3), (48, 1, 1))
    index = BONE_NAMES.index("lowerarm01.L")
    rotations[index] = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    joints = posed_joints(body, forward_kinematics(body, rotations))[LEFT]
    elbow, wrist = body.joints[LEFT, 0], body.joints[LEFT, 1]
    dx, dy, dz = wrist - elbow
    np.testing.assert_allclose(joints[1], elbow + np.array([-dy, dx, dz]), atol=1e-9)


def test_shape_changes_size_and_keeps_sides_equal():
    asset = load_asset()
    lengths = []
    for coefficients in asset.coefficients[:40]:
        joints = asset.body(coefficients).joints
        left, right = np.linalg.norm(joints[:, 1 + WRIST] - joints[:, 1 + ROOT], axis=-1)
        assert abs(left - right) < 1e-3 * left
        lengths.append(left)
    assert min(lengths) > 0.06 and max(lengths) < 0.17
    assert np.std(lengths) > 0.005


def test_every_label_is_used_and_belongs_to_its_side():
    asset = load_asset()
    labels = part_labels(asset)
    assert set(labels) == set(range(1, 15))
    assert ((labels > 7) == (asset.side == 1)).all()
    assert np.bincount(asset.side).tolist() == [asset.n_vertices // 2] * 2


def test_damaged_asset_is_named(tmp_path):
    path = tmp_path / "arms.npz"
    path.write_bytes(b"nothing")
    with pytest.raises(DataFormatError, match=r"arms\.npz"):
        load_asset.__wrapped__(path)


def test_bones_per_side():
    assert BONES_PER_SIDE == 24 and len(BONE_NAMES) == 48
