"""The canonical pose and the two alignments (paper Eq. 1, section 5.1)."""

import numpy as np
import pytest
from tests.builders import CENTRED_CAMERA, OFF_CENTRE_CAMERA, random_hands, random_rotations

from twohands.geometry.canonical import (
    camera_from_canonical,
    canonical_from_camera,
    cartesian_alignment,
    spherical_alignment,
    unrolled_canonical,
)
from twohands.geometry.rotation import centring_angles, rotation_about_z
from twohands.skeleton import ROOT, WRIST


@pytest.fixture(scope="module")
def hands():
    return random_hands(300, OFF_CENTRE_CAMERA, np.random.default_rng(3))


def test_definition(to, hands):
    joints_m, _, length = hands
    canonical = canonical_from_camera(to(joints_m))
    assert np.asarray(canonical.valid).all()
    joints = np.asarray(canonical.joints)
    assert np.all(joints[:, ROOT] == 0)
    np.testing.assert_allclose(np.linalg.norm(joints[:, WRIST], axis=-1), 1.0)
    np.testing.assert_allclose(np.asarray(canonical.hand_length_m), length)
    np.testing.assert_array_equal(np.asarray(canonical.root_cam), joints_m[:, ROOT])
    distances = np.linalg.norm(joints[:, :, None] - joints[:, None], axis=-1)  # a rotation keeps the shape
    truth = np.linalg.norm(joints_m[:, :, None] - joints_m[:, None], axis=-1) / length[:, None, None]
    np.testing.assert_allclose(distances, truth, atol=1e-13)


def test_round_trip(to, hands):
    joints_m = hands[0]
    canonical = canonical_from_camera(to(joints_m))
    radius = to(np.linalg.norm(joints_m[:, ROOT], axis=-1))
    back = camera_from_canonical(
        canonical.joints, canonical.hand_length_m, radius, *centring_angles(canonical.root_cam)
    )
    np.testing.assert_allclose(np.asarray(back), joints_m, atol=1e-15)


def test_canonical_pose_is_the_same_anywhere(to):
    """The same centred hand, seen in three places and two sizes, has one canonical pose: what the network can learn."""
    rng = np.random.default_rng(4)
    hand = random_hands(1, CENTRED_CAMERA, rng)[0][0]
    centred = np.asarray(canonical_from_camera(hand).joints)
    theta, phi = np.array([0.0, 0.4, -0.5]), np.array([0.0, -0.6, 0.8])
    placed = camera_from_canonical(
        to(centred), to(np.array([0.1, 0.08, 0.1])), to(np.array([0.4, 0.7, 0.3])), to(theta), to(phi)
    )
    again = np.asarray(canonical_from_camera(placed).joints)
    np.testing.assert_allclose(again, np.broadcast_to(centred, (3, 21, 3)), atol=1e-14)


def test_mirror(to, hands):
    joints_m = hands[0]
    mirrored = np.asarray(canonical_from_camera(to(joints_m * [-1, 1, 1])).joints)
    np.testing.assert_allclose(mirrored, np.asarray(canonical_from_camera(joints_m).joints) * [-1, 1, 1], atol=1e-14)


def test_spherical_alignment_of_the_truth_is_the_truth(to, hands):
    joints_m, _, length = hands
    canonical = canonical_from_camera(to(joints_m))
    np.testing.assert_allclose(
        np.asarray(spherical_alignment(canonical.joints, to(length), to(joints_m))), joints_m, atol=1e-14
    )


def test_cartesian_alignment_keeps_the_rotation(to, hands):
    """Only the root agrees; the rest is off by the rotation between the camera and the centred frame."""
    joints_m, _, length = hands
    canonical = canonical_from_camera(to(joints_m))
    aligned = np.asarray(cartesian_alignment(canonical.joints, to(length), to(joints_m)))
    np.testing.assert_array_equal(aligned[:, ROOT], joints_m[:, ROOT])
    expected = np.asarray(canonical.joints) * length[:, None, None] + joints_m[:, ROOT : ROOT + 1]
    np.testing.assert_allclose(aligned, expected)
    off_axis = np.abs(aligned - joints_m).max(axis=(1, 2))
    assert off_axis[0] < 1e-15 < 1e-3 < off_axis[5:9].min()  # principal point; image corners


def test_absent_hands(to, hands):
    joints_m = hands[0][:7].copy()
    joints_m[0] = np.nan
    joints_m[1] = 0.0
    joints_m[2, 7, 1] = np.nan
    joints_m[3, 4] = np.inf
    joints_m[4, WRIST] = joints_m[4, ROOT]
    joints_m[5] -= joints_m[5, ROOT]
    canonical = canonical_from_camera(to(joints_m))
    assert np.asarray(canonical.valid).tolist() == [False] * 6 + [True]
    for values in (canonical.joints, canonical.hand_length_m, canonical.root_cam):
        known = np.isfinite(np.asarray(values)).reshape(7, -1)
        assert not known[:6].any() and known[6].all()
    for align in (spherical_alignment, cartesian_alignment):
        aligned = np.asarray(align(to(np.ones((7, 21, 3))), 0.1, to(joints_m)))
        assert np.isnan(aligned[[0, 1, 5]]).all() and np.isfinite(aligned[[2, 3, 4, 6]]).all()  # these roots are known


def test_batch_is_loop_and_inputs_stay(to, hands):
    joints_m = hands[0][:12]
    given = to(joints_m.reshape(3, 4, 21, 3))
    batch = np.asarray(canonical_from_camera(given).joints)
    assert np.array_equal(np.asarray(given), joints_m.reshape(3, 4, 21, 3))
    loop = np.stack([np.asarray(canonical_from_camera(to(hand)).joints) for hand in joints_m])
    np.testing.assert_allclose(batch.reshape(12, 21, 3), loop, atol=1e-15)


def test_gradients():
    torch = pytest.importorskip("torch")
    rng = np.random.default_rng(5)
    joints = torch.tensor(random_hands(2, CENTRED_CAMERA, rng)[0], requires_grad=True)
    assert torch.autograd.gradcheck(lambda j: canonical_from_camera(j).joints, joints)
    truth = torch.tensor(random_rotations(1, rng)[0] @ np.ones((3, 1))).T.expand(21, 3)
    assert torch.autograd.gradcheck(lambda j: spherical_alignment(j, 0.1, truth), joints)


def test_an_absent_hand_does_not_spoil_gradients(hands):
    torch = pytest.importorskip("torch")
    joints = torch.tensor(hands[0][:3])
    joints[1] = 0.0
    joints[2] = float("nan")
    joints.requires_grad_()
    canonical_from_camera(joints).joints[0].square().sum().backward()
    assert torch.isfinite(joints.grad).all() and (joints.grad[1:] == 0).all() and (joints.grad[0] != 0).any()


@pytest.mark.parametrize("degrees", [-170, -20, 0, 15, 90])
def test_a_rolled_camera_sees_the_same_hand(to, hands, degrees):
    """Its canonical pose is another one, wherever the hand is; unrolled it is the camera's own."""
    joints_m, _, _ = hands
    roll = rotation_about_z(np.radians(degrees))
    upright, rolled = (canonical_from_camera(to(joints)).joints for joints in (joints_m, joints_m @ roll.T))
    found = unrolled_canonical(rolled, to(3.0 * joints_m[:, ROOT]), to(roll))
    np.testing.assert_allclose(np.asarray(found), np.asarray(upright), atol=1e-12)
    assert degrees == 0 or not np.allclose(rolled, upright, atol=0.1)
