"""Quaternions: there and back, signs over time, and the way between two."""

import numpy as np
from tests.builders import random_rotations

from twohands.geometry.quaternions import between, quaternions, rotations, without_jumps

HALF = np.sqrt(0.5)


def test_hand_computed():
    quarter_about_z = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(quaternions(quarter_about_z), [0, 0, HALF, HALF], atol=1e-15)
    np.testing.assert_allclose(quaternions(np.eye(3)), [0, 0, 0, 1])
    for axis in range(3):  # half turns, where w is 0
        np.testing.assert_allclose(np.abs(quaternions(2 * np.diag(np.eye(3)[axis]) - np.eye(3))), np.eye(4)[axis])


def test_there_and_back():
    turns = random_rotations(500, np.random.default_rng(0)).reshape(100, 5, 3, 3)
    found = quaternions(turns)
    assert (found[..., 3] >= 0).all()
    np.testing.assert_allclose(rotations(found), turns, atol=1e-14)
    np.testing.assert_allclose(rotations(-found), turns, atol=1e-14)


def test_no_jumps_over_time():
    angles = np.linspace(0, 4 * np.pi, 60)
    about_x = np.stack([np.sin(angles / 2), 0 * angles, 0 * angles, np.cos(angles / 2)], axis=-1)
    steady = without_jumps(quaternions(rotations(about_x)))
    assert ((steady[1:] * steady[:-1]).sum(axis=-1) > 0).all()
    np.testing.assert_allclose(rotations(steady), rotations(about_x), atol=1e-14)


def test_half_way_between():
    none, quarter = np.array([0, 0, 0, 1.0]), np.array([HALF, 0, 0, HALF])
    eighth = [np.sin(np.pi / 8), 0, 0, np.cos(np.pi / 8)]
    np.testing.assert_allclose(between(none, quarter, np.array(0.5)), eighth, atol=1e-15)
    np.testing.assert_allclose(between(none, -quarter, np.array(0.5)), eighth, atol=1e-15)
    several = between(np.stack([none, none]), np.stack([quarter, none]), np.array([1.0, 0.3]))
    np.testing.assert_allclose(several, [quarter, none], atol=1e-15)
