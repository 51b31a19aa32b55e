"""Infinite numbers are unknown ones: no warning (pytest makes errors of warnings), and the other hands stay as they
are."""

import numpy as np
import pytest

from twohands.geometry.boxes import apply_homography
from twohands.geometry.camera import project
from twohands.geometry.canonical import (
    camera_from_canonical,
    canonical_from_camera,
    cartesian_alignment,
    spherical_alignment,
    unrolled_canonical,
)
from twohands.geometry.projection import project_global, pull_to_rays
from twohands.geometry.rotation import centring_angles, rotate, rotation_about_z, rotation_from_angles
from twohands.skeleton import ROOT, WRIST
from twohands.types import PinholeCamera

CAMERA = PinholeCamera.ego3dhands(480, 270)
JOINTS_M = np.random.default_rng(1).normal([0.0, 0.0, 0.4], 0.05, (3, 21, 3))
POSE = canonical_from_camera(JOINTS_M)
JOINTS_PX = np.asarray(project(JOINTS_M, CAMERA))
THETA, PHI = (np.asarray(angle) for angle in centring_angles(JOINTS_M[:, ROOT]))
RADIUS = np.linalg.norm(JOINTS_M[:, ROOT], axis=-1)
CANONICAL, LENGTH = np.asarray(POSE.joints), np.asarray(POSE.hand_length_m)
TURNED = np.asarray(rotation_from_angles(THETA, PHI))


def _drawn(to, canonical, joints_px, length):
    place = project_global(to(CANONICAL), to(JOINTS_PX), CAMERA, to(LENGTH))
    return pull_to_rays(canonical, joints_px, CAMERA, length, place, 0.5)


FUNCTIONS = {
    "canonical_from_camera": (lambda to, joints_m: canonical_from_camera(joints_m).joints, [JOINTS_M]),
    "camera_from_canonical": (
        lambda to, *given: camera_from_canonical(*given),
        [CANONICAL, LENGTH, RADIUS, THETA, PHI],
    ),
    "spherical_alignment": (lambda to, *given: spherical_alignment(*given), [CANONICAL, LENGTH, JOINTS_M]),
    "cartesian_alignment": (lambda to, *given: cartesian_alignment(*given), [CANONICAL, LENGTH, JOINTS_M]),
    "unrolled_canonical": (
        lambda to, *given: unrolled_canonical(*given, to(rotation_about_z(0.2))),
        [CANONICAL, JOINTS_M[:, ROOT]],
    ),
    "rotate": (lambda to, *given: rotate(*given), [TURNED, JOINTS_M]),
    "rotation_from_angles": (lambda to, *given: rotation_from_angles(*given), [THETA, PHI]),
    "apply_homography": (lambda to, *given: apply_homography(*given), [np.stack([np.eye(3)] * 3), JOINTS_PX]),
    "pull_to_rays": (_drawn, [CANONICAL, JOINTS_PX, LENGTH]),
    "project": (lambda to, joints_m: project(joints_m, CAMERA), [JOINTS_M]),
}


@pytest.mark.parametrize("value", [np.inf, -np.inf])
@pytest.mark.parametrize("joint", [WRIST, 4, ROOT])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_infinite_input_gives_no_warning_and_disturbs_no_other_hand(to, name, joint, value):
    function, arguments = FUNCTIONS[name]
    expected = np.asarray(function(to, *map(to, arguments)))
    for changed in range(len(arguments)):
        given = [argument.copy() for argument in arguments]
        if given[changed].ndim == 3:
            given[changed][1, joint % given[changed].shape[1], 0] = value
        else:
            given[changed][1, ...] = value
        found = np.asarray(function(to, *map(to, given)))
        np.testing.assert_array_equal(found[[0, 2]], expected[[0, 2]])
