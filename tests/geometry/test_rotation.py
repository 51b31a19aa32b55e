"""Laws of the two centring angles (docs/conventions.md; docs/paper-map.md, *The printed angle*)."""

import math

import numpy as np
import pytest

from twohands.geometry.camera import unproject
from twohands.geometry.rotation import centring_angles, paper_angles, rotate, rotation_from_angles
from twohands.types import PinholeCamera


def test_rotation_brings_the_point_onto_the_axis(to):
    points = np.random.default_rng(0).standard_normal((500, 3))
    points[:4] = [(0, 0, 2), (0, 1, 1), (1, 0, 1), (-3, 0, 0.5)]
    rotation = rotation_from_angles(*centring_angles(to(points)))
    centred = np.asarray(rotate(rotation, to(points)[:, None])[:, 0])
    expected = np.stack([np.zeros(500), np.zeros(500), np.linalg.norm(points, axis=-1)], axis=-1)
    np.testing.assert_allclose(centred, expected, atol=1e-14)


def test_rotation_is_a_rotation(to):
    angles = np.random.default_rng(1).uniform(-3, 3, (2, 4, 5))
    rotation = np.asarray(rotation_from_angles(to(angles[0]), to(angles[1])))
    assert rotation.shape == (4, 5, 3, 3)
    np.testing.assert_allclose(
        rotation @ np.swapaxes(rotation, -1, -2), np.broadcast_to(np.eye(3), (4, 5, 3, 3)), atol=1e-15
    )
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0)


def test_hand_computed_angles():
    theta, phi = centring_angles(np.array([math.sqrt(2.0), 1.0, 1.0]))
    assert math.isclose(theta, math.pi / 4)  # atan2(1, 1)
    assert math.isclose(phi, math.pi / 4)  # atan2(sqrt 2, hypot(1, 1))


def test_theta_turns_first():
    """R_y(phi) R_x(theta), written as two textbook rotations."""
    rotation = rotation_from_angles(0.3, 0.4)
    c, s, cp, sp = math.cos(0.3), math.sin(0.3), math.cos(0.4), math.sin(0.4)
    about_x = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    about_y = np.array([[cp, 0, -sp], [0, 1, 0], [sp, 0, cp]])
    np.testing.assert_allclose(rotation, about_y @ about_x, atol=1e-16)


@pytest.mark.parametrize(
    ("offset_px", "expected_deg"), [((16, 0), 0.0), ((0, 16), 0.0), ((180, 60), 1.4), ((240, 135), 5.9)]
)
def test_printed_angles_miss_off_the_axes(offset_px, expected_deg):
    """The table of docs/paper-map.md, *The printed angle*: direction error of paper Eq. 3 in its own camera."""
    camera = PinholeCamera.ego3dhands()
    ray = unproject(np.array([camera.cx + offset_px[0], camera.cy + offset_px[1]]), camera)
    looked_at = rotation_from_angles(*paper_angles(ray))[2]  # third row: the centred camera's z axis
    error = math.degrees(math.acos(min(1.0, looked_at @ ray / np.linalg.norm(ray))))
    assert error == pytest.approx(expected_deg, abs=0.05)


def test_angles_keep_dtype(to):
    theta, phi = centring_angles(to(np.ones((2, 3), dtype=np.float32)))
    assert str(theta.dtype).endswith("float32") and str(phi.dtype).endswith("float32")
