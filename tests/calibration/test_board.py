"""The board: what is printed is what is found again, at its true size."""

import re

import cv2
import numpy as np
import pytest
from tests.calibration.rendered import board_pose, picture_of_board, printed

from twohands.calibration.board import (
    COLUMNS,
    MARKER_M,
    N_CORNERS,
    PAPER_M,
    ROWS,
    RULE_M,
    SQUARE_M,
    board_pdf,
    corners_m,
    find_board,
    printed_areas,
)
from twohands.geometry.camera import project
from twohands.types import PinholeCamera

CAMERA = PinholeCamera(500.0, 510.0, 326.0, 174.0, 640, 360, (0.08, -0.15, 0.001, -0.0005))


def test_the_printed_areas_are_opencv_s_own_picture_of_the_board():
    """7x9 squares of 200 pixels: every pixel is that of CharucoBoard.generateImage, but for the margin that we add."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    board = cv2.aruco.CharucoBoard((COLUMNS, ROWS), SQUARE_M, MARKER_M, dictionary)
    theirs = board.generateImage((COLUMNS * 200, ROWS * 200)) > 128
    assert ((printed()[120:-120, 120:-120] > 128) == theirs).mean() > 0.999


def test_corners_lie_where_four_squares_meet():
    corners = corners_m()
    assert corners.shape == (N_CORNERS, 3)
    np.testing.assert_allclose(corners[0], [SQUARE_M, SQUARE_M, 0], atol=1e-7)
    np.testing.assert_allclose(corners[-1], [(COLUMNS - 1) * SQUARE_M, (ROWS - 1) * SQUARE_M, 0], atol=1e-7)


def test_the_page_is_a4_and_everything_on_it_has_its_size():
    page = board_pdf().decode()
    assert page.startswith("%PDF-1.4") and page.rstrip().endswith("%%EOF")
    assert "/MediaBox [0 0 595.2756 841.8898]" in page
    areas = [list(map(float, words)) for words in re.findall(r"^([\d.]+) ([\d.]+) ([\d.]+) ([\d.]+) re$", page, re.M)]
    assert len(areas) == sum(map(len, printed_areas()))
    metres = np.array(areas) / 72 * 0.0254
    np.testing.assert_allclose(metres[0, 2:], SQUARE_M, atol=1e-6)
    x, y, width, height = metres.T
    assert x.min() > 0.01 and (x + width).max() < PAPER_M[0] - 0.01
    assert y.min() > 0.01 and (y + height).max() < PAPER_M[1] - 0.01
    x0, y0, x1, y1 = next(map(float, words) for words in re.findall(r"([\d.]+) ([\d.]+) m ([\d.]+) ([\d.]+) l S", page))
    assert y0 == y1 and x1 - x0 == pytest.approx(RULE_M / 0.0254 * 72, abs=1e-3)


def test_every_cross_reference_of_the_pdf_leads_to_its_object():
    page = board_pdf()
    table = page.index(b"xref\n0 6\n")
    assert page.endswith(b"startxref\n%d\n%%%%EOF\n" % table)
    starts = [int(line[:10]) for line in page[table:].splitlines()[3:8]]
    for number, start in enumerate(starts, 1):
        assert page[start:].startswith(b"%d 0 obj" % number)


def test_corners_are_found_to_a_tenth_of_a_pixel_through_a_lens():
    rotation, translation = board_pose((20, -15), 10, np.array([0.02, 0.01, 0.42]))
    view = find_board(picture_of_board(CAMERA, rotation, translation, np.random.default_rng(0)))
    assert view is not None and view.size == (640, 360) and len(view.ids) > 40
    assert (np.diff(view.ids) > 0).all()
    true = project(view.corners_m @ rotation.T + translation, CAMERA, distort=True)
    off = view.corners_px - true
    assert abs(off).max() < 0.4 and abs(off.mean(axis=0)).max() < 0.03, "no half pixel is lost"


def test_a_picture_without_a_board_has_none():
    noise = np.random.default_rng(0).integers(0, 256, (200, 300, 3), dtype=np.uint8)
    assert find_board(noise) is None and find_board(np.zeros((64, 64, 3), np.uint8)) is None
