"""Anatomical joints of the generator's own hand."""

import numpy as np

from twohands.geometry.anatomy import HAND_LENGTH, KNUCKLES, anatomical_joints, skeleton_joints
from twohands.geometry.rotation import rotation_from_angles
from twohands.skeleton import ROOT, WRIST
from twohands.synth.scene.body import load_asset


def rest_hand() -> np.ndarray:
    return load_asset().body().joints[0, 1:]


def length(joints: np.ndarray, a: int, b: int) -> float:
    return float(np.linalg.norm(joints[a] - joints[b]))


def test_only_wrist_and_knuckles_move_and_they_move_along_the_palm():
    joints = rest_hand()
    moved = anatomical_joints(joints)
    changed = np.flatnonzero((moved != joints).any(axis=1))
    assert changed.tolist() == [WRIST, *KNUCKLES]
    for knuckle in KNUCKLES:
        np.testing.assert_allclose(
            np.cross(moved[knuckle] - joints[WRIST], joints[knuckle] - joints[WRIST]), 0, atol=1e-9
        )


def test_the_hand_length_is_that_of_the_new_points():
    joints = rest_hand()
    ratio = length(anatomical_joints(joints), WRIST, ROOT) / length(joints, WRIST, ROOT)
    assert abs(ratio - HAND_LENGTH) < 1e-9


def test_proportions_are_those_of_bones():
    joints = anatomical_joints(rest_hand())
    for knuckle, expected in zip(KNUCKLES, (1.7, 1.55, 1.5, 1.75), strict=True):
        phalanges = [length(joints, knuckle + i, knuckle + i + 1) for i in range(3)]
        assert abs(phalanges[0] / phalanges[1] - expected) < 0.12, knuckle
    finger = sum(length(joints, ROOT + i, ROOT + i + 1) for i in range(3))
    assert abs(length(joints, WRIST, ROOT) / finger - 0.82) < 0.04


def test_it_does_not_matter_where_and_in_which_unit_the_hand_is():
    joints = rest_hand()
    rotation, offset = rotation_from_angles(0.4, -0.8), np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(
        anatomical_joints(100 * joints @ rotation.T + offset), 100 * anatomical_joints(joints) @ rotation.T + offset
    )


def test_the_skeleton_comes_back_from_the_anatomical_joints():
    joints = rest_hand()
    np.testing.assert_allclose(skeleton_joints(anatomical_joints(joints)), joints, atol=1e-12)
    np.testing.assert_allclose(skeleton_joints(anatomical_joints(joints[None, :, :2])), joints[None, :, :2], atol=1e-12)


def test_half_of_the_way_is_the_middle():
    joints = rest_hand()
    halfway = anatomical_joints(joints, 0.5)
    np.testing.assert_allclose(halfway, (joints + anatomical_joints(joints)) / 2, atol=1e-12)
    np.testing.assert_allclose(skeleton_joints(halfway, 0.5), joints, atol=1e-12)
