"""VMC over a real socket: every frame's bundle comes, and its bones make the fitted hand again."""

import socket

import numpy as np
import pytest
from tests.motion.moving import moving_hands, poses_of

pytest.importorskip("pythonosc")
from pythonosc.osc_bundle import OscBundle

from twohands.errors import InputError
from twohands.geometry.quaternions import rotations
from twohands.motion.clip import UPRIGHT_FROM_CAMERA
from twohands.motion.fit import fit_skeleton, pose_hand
from twohands.motion.vmc import LEARNT_FRAMES, SteadyBones, VmcSender, bone_names
from twohands.skeleton import PARENTS

UNITY_FROM_CAMERA = np.array([1.0, -1.0, 1.0])


def noisy_motion(frames: int = 20):
    valid = np.ones((frames, 2), bool)
    valid[5:9, 1] = valid[3, 0] = False
    valid[4] = False
    motion = moving_hands(frames, valid=valid)
    motion.joints_m[:] += np.random.default_rng(0).normal(0, 0.002, motion.joints_m.shape)
    return motion


def received(motion) -> list[list[tuple[str, list]]]:
    """Messages of each bundle that comes, when a motion is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listening:
        listening.bind(("127.0.0.1", 0))
        listening.settimeout(300)
        sender = VmcSender("127.0.0.1", listening.getsockname()[1])
        bundles = []
        for pose in poses_of(motion):
            sender.send(pose)
            bundle = OscBundle(listening.recv(65536))
            bundles.append([(message.address, message.params) for message in bundle])
    return bundles


def bones(messages) -> dict[str, np.ndarray]:
    return {values[0]: np.array(values[1:]) for address, values in messages if address == "/VMC/Ext/Bone/Pos"}


def forward_kinematics(found: dict[str, np.ndarray], side: int) -> dict[int, np.ndarray]:
    """Places of the joints in Unity's axes, as an avatar's program would have them."""
    places, turns = {}, {}
    for joint, name in bone_names(side).items():
        place, turn = found[name][:3], rotations(found[name][3:])
        above = (np.zeros(3), np.eye(3)) if joint == 0 else (places[PARENTS[joint]], turns[PARENTS[joint]])
        places[joint], turns[joint] = above[0] + above[1] @ place, above[1] @ turn
    return places


def test_all_bundles_come_and_make_the_fit_again():
    motion = noisy_motion()
    bundles = received(motion)
    assert len(bundles) == len(motion.time_s)
    fits = (SteadyBones(0), SteadyBones(1))
    for frame, messages in enumerate(bundles):
        assert messages[:3] == [
            ("/VMC/Ext/OK", [1]),
            ("/VMC/Ext/T", [pytest.approx(motion.time_s[frame], abs=1e-6)]),
            ("/VMC/Ext/Root/Pos", ["root", 0, 0, 0, 0, 0, 0, 1]),
        ]
        found = bones(messages)
        assert len(found) == 16 * motion.valid[frame].sum()
        for side in np.flatnonzero(motion.valid[frame]):
            fit = fits[side].pose(motion.joints_m[frame, side])
            in_unity = fit.joints_m[0] @ UPRIGHT_FROM_CAMERA * UNITY_FROM_CAMERA
            for joint, place in forward_kinematics(found, side).items():
                np.testing.assert_allclose(place, in_unity[joint], atol=1e-4)
            assert fit.distance_m.mean() < 0.005


def test_names_are_unity_s():
    names = bone_names(1)
    assert len(names) == 16 and names[0] == "RightHand" and names[3] == "RightThumbDistal"
    assert names[6] == "RightIndexIntermediate" and names[17] == "RightLittleProximal" and 4 not in names


def test_an_avatar_at_rest_does_not_turn():
    """A hand held as in the T-pose: the identity for every bone, places as they are in Unity."""
    hand = np.zeros((21, 3))
    for base, forward in ((5, 0.03), (9, 0.0), (13, -0.02), (17, -0.04)):
        hand[base : base + 4] = [[-0.1 - 0.03 * i, 0, forward] for i in range(4)]
    hand[1:5] = [[-0.03 - 0.02 * i, 0, 0.03 + 0.02 * i] for i in range(4)]
    motion = moving_hands(1, valid=np.array([[True, False]]))
    motion.joints_m[0, 0] = hand + np.array([0.1, 0.2, 0.5])  # Unity's axes are the camera's, but for y
    found = bones(received(motion)[0])
    for joint, name in bone_names(0).items():
        np.testing.assert_allclose(np.abs(found[name][3:]), [0, 0, 0, 1], atol=1e-6)
        expected = [0.1, -0.2, 0.5] if joint == 0 else (hand[joint] - hand[PARENTS[joint]]) * UNITY_FROM_CAMERA
        np.testing.assert_allclose(found[name][:3], expected, atol=1e-6)


def test_a_bent_index_turns_as_in_unity():
    """Bent down by 90 degrees: in left-handed axes, of the left hand, whose fingers point along -x, about z by -90."""
    hand = np.zeros((21, 3))
    for base, forward in ((5, 0.03), (9, 0.0), (13, -0.02), (17, -0.04)):
        hand[base : base + 4] = [[-0.1 - 0.03 * i, 0, forward] for i in range(4)]
    hand[1:5] = [[-0.03 - 0.02 * i, 0, 0.03 + 0.02 * i] for i in range(4)]
    hand[7], hand[8] = hand[6] + [0, 0.03, 0], hand[6] + [0, 0.06, 0]  # y is down in the camera frame
    motion = moving_hands(1, valid=np.array([[True, False]]))
    motion.joints_m[0, 0] = hand + np.array([0.0, 0.0, 0.5])
    found = bones(received(motion)[0])
    half = np.sqrt(0.5)
    np.testing.assert_allclose(found["LeftIndexIntermediate"][3:], [0, 0, half, half], atol=1e-6)
    turned = rotations(found["LeftIndexIntermediate"][3:]) @ [-1, 0, 0]
    np.testing.assert_allclose(turned, [0, -1, 0], atol=1e-6)


def test_bones_settle_and_a_new_clip_begins_anew():
    motion = moving_hands(LEARNT_FRAMES + 10)
    noisy = motion.joints_m[:, 0] + np.random.default_rng(0).normal(0, 0.002, (LEARNT_FRAMES + 10, 21, 3))
    steady = SteadyBones(0)
    fits = [steady.pose(joints) for joints in noisy]
    last = fits[LEARNT_FRAMES - 1].skeleton
    assert all(fit.skeleton is last for fit in fits[LEARNT_FRAMES - 1 :]) and fits[0].skeleton is not fits[1].skeleton
    upright = noisy[:LEARNT_FRAMES] @ UPRIGHT_FROM_CAMERA.T
    np.testing.assert_allclose(last.rest_m, fit_skeleton(upright, 0).rest_m)
    np.testing.assert_allclose(
        fits[-1].joints_m, pose_hand(last, noisy[-1:] @ UPRIGHT_FROM_CAMERA.T, np.zeros(1, int)).joints_m
    )
    sender = VmcSender("127.0.0.1", 9)
    before = sender._bones
    sender.begin()
    assert sender._bones is not before


def test_nobody_listens_and_nothing_happens():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    sender = VmcSender("127.0.0.1", port)
    for pose in poses_of(moving_hands(3)):
        sender.send(pose)


def test_no_such_host():
    with pytest.raises(InputError, match="--osc no such host:39539: "):
        VmcSender("no such host", 39539)
