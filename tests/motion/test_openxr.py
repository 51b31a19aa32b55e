"""OpenXR's 26 joints: the clip's own in their places, and five that are derived."""

import json

import numpy as np
import pytest
from tests.motion.moving import moving_hands

from twohands.geometry.quaternions import rotations
from twohands.motion.clip import HandMotion
from twohands.motion.fit import fit_motion
from twohands.motion.openxr import DERIVED, METACARPAL_WAY, NAMES, openxr_joints, openxr_lines
from twohands.skeleton import JOINT_NAMES

OURS = {
    "wrist": 0, "thumb_metacarpal": 1, "thumb_proximal": 2, "thumb_distal": 3, "thumb_tip": 4,
    "index_proximal": 5, "index_intermediate": 6, "index_distal": 7, "index_tip": 8,
    "middle_proximal": 9, "middle_tip": 12, "ring_proximal": 13, "ring_distal": 15, "little_proximal": 17,
    "little_tip": 20,
}  # fmt: skip


def test_the_order_is_that_of_xr_hand_joint_ext():
    """XR_HAND_JOINT_PALM_EXT 0, WRIST 1, THUMB_METACARPAL 2, THUMB_TIP 5, INDEX_METACARPAL 6, MIDDLE_METACARPAL 11,
    RING_METACARPAL 16, LITTLE_METACARPAL 21, LITTLE_TIP 25."""
    assert len(NAMES) == 26
    said = {
        0: "palm",
        1: "wrist",
        2: "thumb_metacarpal",
        5: "thumb_tip",
        6: "index_metacarpal",
        11: "middle_metacarpal",
    }
    assert {number: NAMES[number] for number in said} == said
    assert (NAMES[16], NAMES[21], NAMES[25]) == ("ring_metacarpal", "little_metacarpal", "little_tip")
    assert DERIVED == ("palm", "index_metacarpal", "middle_metacarpal", "ring_metacarpal", "little_metacarpal")


def test_our_joints_keep_their_places():
    joints = np.random.default_rng(0).normal(0, 0.1, (4, 21, 3))
    found = openxr_joints(joints)
    for name, joint in OURS.items():
        np.testing.assert_array_equal(found[:, NAMES.index(name)], joints[:, joint] * [1, -1, -1])
    assert len(JOINT_NAMES) + len(DERIVED) == len(NAMES)


def test_derived_joints_by_hand():
    """Wrist at the origin, middle knuckle 10 cm above: its metacarpal begins at 3.19 cm, the palm is at 6.595 cm."""
    joints = np.zeros((21, 3))
    joints[9], joints[17] = [0, -0.1, 0], [-0.04, -0.09, 0.01]
    found = openxr_joints(joints)
    np.testing.assert_allclose(found[NAMES.index("middle_metacarpal")], [0, 0.0319, 0], atol=1e-12)
    np.testing.assert_allclose(found[NAMES.index("palm")], [0, 0.06595, 0], atol=1e-12)
    np.testing.assert_allclose(
        found[NAMES.index("little_metacarpal")], 0.439 * np.array([-0.04, 0.09, -0.01]), atol=1e-12
    )


def test_metacarpals_are_those_of_the_generator_s_bodies():
    body = pytest.importorskip("twohands.synth.scene.body")
    asset = body.load_asset()
    ways = []
    for shape in [None, *asset.coefficients[::100]]:
        person = asset.body(shape)
        for side in range(2):
            joints = person.joints[side, 1:]
            for number, knuckle in enumerate(METACARPAL_WAY, 1):
                foot = person.heads[body.bone(f"metacarpal{number}", side)] - joints[0]
                bone = joints[knuckle] - joints[0]
                ways.append(foot @ bone / (bone @ bone))
    np.testing.assert_allclose(np.mean(np.reshape(ways, (-1, 4)), axis=0), list(METACARPAL_WAY.values()), atol=0.003)


def test_orientations_are_those_of_openxr():
    """-z along the bone that begins in a joint, y out of the back of the hand; of tips, as the bone before."""
    motion = moving_hands(6)
    for line in list(openxr_lines(motion, fit_motion(motion)))[1:]:
        for hand in json.loads(line)["hands"].values():
            places, turns = np.array(hand["joints_m"]), rotations(np.array(hand["orientations"]))
            forward = -turns[:, :, 2]
            for number, name in enumerate(NAMES):
                if name in ("palm", "wrist"):
                    continue
                at = number - 1 if name.endswith("_tip") else number
                bone = places[at + 1] - places[at]
                np.testing.assert_allclose(forward[number], bone / np.linalg.norm(bone), atol=1e-3, err_msg=name)
            np.testing.assert_allclose(turns[0], turns[NAMES.index("middle_metacarpal")], atol=1e-9)
            back = np.cross(places[6 + 1] - places[1], places[21 + 1] - places[1])
            back = back / np.linalg.norm(back)
            assert abs(turns[1, :, 1] @ back) > 0.9


def test_the_back_of_the_hand_is_up():
    """A left hand seen from its back, fingers up in the picture: y towards the camera, +z of the space."""
    joints = np.zeros((21, 3))
    for base, x in ((1, 0.05), (5, 0.03), (9, 0.0), (13, -0.02), (17, -0.04)):
        joints[base : base + 4] = [[x, -0.1 - 0.03 * i, 0] for i in range(4)]
    joints += [0.0, 0.0, 0.5]
    for side, up in ((0, 1.0), (1, -1.0)):
        both = np.full((1, 2, 21, 3), np.nan)
        both[0, side] = joints
        valid = np.array([[side == 0, side == 1]])
        motion = HandMotion(np.zeros(1), np.zeros(1, int), both, valid, moving_hands(1).camera, "")
        line = json.loads(list(openxr_lines(motion, fit_motion(motion)))[1])
        turns = rotations(np.array(line["hands"][("left", "right")[side]]["orientations"]))
        for name in ("palm", "wrist", "index_metacarpal", "index_proximal", "little_tip"):
            np.testing.assert_allclose(turns[NAMES.index(name)][:, 1], [0, 0, up], atol=1e-5, err_msg=name)


def test_the_lines_say_what_is_derived_and_who_is_away():
    motion = moving_hands(3, valid=np.array([[True, False], [False, False], [True, True]]))
    header, *frames = (json.loads(line) for line in openxr_lines(motion, fit_motion(motion)))
    assert tuple(header["names"]) == NAMES and tuple(header["derived"]) == DERIVED and header["version"] == 1
    assert [[hand["valid"] for hand in frame["hands"].values()] for frame in frames] == motion.valid.tolist()
    assert frames[1]["hands"]["left"] == {"valid": False}
    np.testing.assert_allclose(frames[2]["hands"]["right"]["joints_m"], openxr_joints(motion.joints_m[2, 1]), atol=1e-6)
