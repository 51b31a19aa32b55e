"""The hand's length from the board's plane."""

import numpy as np
import pytest
from tests.calibration.rendered import board_pose, picture_of_board
from tests.calibration.test_board import CAMERA

from twohands.calibration.board import BoardView, corners_m, find_board
from twohands.calibration.hand import JOINT_HEIGHT, length_on_board
from twohands.calibration.hand import board_pose as pose_of_board
from twohands.errors import InputError
from twohands.geometry.camera import project
from twohands.skeleton import ROOT

LENGTH_M = 0.112


def flat_hand(rotation, translation, angle_deg=30.0, corner=(0.2, 0.08)) -> np.ndarray:
    """(21, 2) pixels of wrist and knuckle at their height above the paper, beside the board; others at the wrist."""
    along = np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])
    joints = np.zeros((21, 3))
    joints[:, :2], joints[:, 2] = corner, -JOINT_HEIGHT * LENGTH_M
    joints[ROOT, :2] += LENGTH_M * along
    return project(joints @ rotation.T + translation, CAMERA, distort=True)


@pytest.mark.parametrize("tilt_deg", [(0, 0), (25, -20), (-35, 10)])
def test_a_flat_hand_beside_a_rendered_board_has_its_length(tilt_deg):
    rotation, translation = board_pose(tilt_deg, 15.0, np.array([-0.08, 0.0, 0.45]))
    view = find_board(picture_of_board(CAMERA, rotation, translation, np.random.default_rng(0)))
    assert view is not None
    found = length_on_board(flat_hand(rotation, translation), view, CAMERA)
    assert found == pytest.approx(LENGTH_M, rel=0.005)


def test_the_board_is_placed_where_it_is_and_a_printer_s_scale_scales_all():
    rotation, translation = board_pose((10, 20), 5.0, np.array([0.0, 0.0, 0.4]))
    pixels = project(corners_m() @ rotation.T + translation, CAMERA, distort=True)
    view = BoardView(np.arange(len(pixels)), pixels, (640, 360))
    turned, moved = pose_of_board(view, CAMERA)
    np.testing.assert_allclose(turned, rotation, atol=1e-4)
    np.testing.assert_allclose(moved, translation, atol=1e-4)
    joints = flat_hand(rotation, translation)
    assert length_on_board(joints, view, CAMERA) == pytest.approx(LENGTH_M, rel=1e-4)
    assert length_on_board(joints, view, CAMERA, scale=0.97) == pytest.approx(0.97 * LENGTH_M, rel=1e-4)


def test_too_little_of_the_board_is_refused():
    view = BoardView(np.arange(4), np.array([[10.0, 10], [20, 10], [30, 10], [40, 10]]), (640, 360))
    with pytest.raises(InputError, match="only 4 of the board's corners"):
        length_on_board(np.zeros((21, 2)), view, CAMERA)


def test_a_hand_beyond_the_paper_s_horizon_is_refused():
    """Of a table seen nearly edge on, lines of sight above its horizon never meet it."""
    rotation, translation = board_pose((-80, 0), 0.0, np.array([0.0, 0.1, 0.5]))
    pixels = project(corners_m() @ rotation.T + translation, CAMERA, distort=True)
    joints = np.full((21, 2), 320.0)
    joints[:, 1] = 2.0
    view = BoardView(np.arange(len(pixels)), pixels, (640, 360))
    with pytest.raises(InputError, match="not seen on the paper"):
        length_on_board(joints, view, CAMERA)
