"""The camera from views of the board: right where they tell it, refused where they do not."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from tests.calibration.rendered import board_pose, views
from tests.calibration.test_board import CAMERA

from twohands.calibration.board import BoardView, corners_m, find_board
from twohands.calibration.camera import LEAST_VIEWS, fit_camera, is_new, unseen_areas, usable
from twohands.calibration.coverage import WIDTH_PX, coverage_picture
from twohands.errors import InputError
from twohands.geometry.camera import project


@functools.cache
def seen() -> tuple[BoardView, ...]:
    """Of 25 rendered pictures."""
    found = [find_board(picture) for picture in views(CAMERA, 25)]
    return tuple(view for view in found if view is not None)


def exact_view(tilt_deg, distance=0.45, roll_deg=0.0, noise_px=0.02, seed=0) -> BoardView:
    """As a camera sees it, without a picture."""
    rotation, translation = board_pose(tilt_deg, roll_deg, np.array([0.0, 0.0, distance]))
    pixels = project(corners_m() @ rotation.T + translation, CAMERA, distort=True)
    noise = np.random.default_rng(seed).normal(0, noise_px, pixels.shape)
    inside = ((pixels > 0) & (pixels < [640, 360])).all(axis=1)
    return BoardView(np.flatnonzero(inside), (pixels + noise)[inside], (640, 360))


def around(count: int) -> list[BoardView]:
    tilts = [(25, 0), (-25, 0), (0, 25), (0, -25), (25, 25), (-25, 25), (25, -25), (-25, -25), (10, 30), (-30, 5)]
    return [exact_view(tilts[i % 10], 0.4 + 0.01 * i, 7.0 * i, seed=i) for i in range(count)]


def test_25_rendered_views_give_the_focal_length_to_half_a_percent():
    fit = fit_camera(seen())
    assert fit.camera.fx == pytest.approx(CAMERA.fx, rel=0.005) and fit.camera.fy == pytest.approx(CAMERA.fy, rel=0.005)
    assert abs(fit.camera.cx - CAMERA.cx) < 2 and abs(fit.camera.cy - CAMERA.cy) < 2
    assert fit.camera.distortion[0] == pytest.approx(CAMERA.distortion[0], abs=0.02)
    assert fit.rms_px < 0.2 and fit.focal_sigma < 0.005 and len(fit.errors_px) == len(fit.views)
    assert abs(fit.camera.fx / CAMERA.fx - 1) < 4 * fit.focal_sigma + 1e-3, "the error it admits is the error it has"


def test_coverage_shows_every_corner_in_the_picture_s_form():
    fit = fit_camera(seen())
    picture = coverage_picture(fit)
    assert picture.shape == (540, WIDTH_PX, 3) and picture.dtype == np.uint8
    corner = np.round(fit.views[0].corners_px[0] * WIDTH_PX / 640).astype(int)
    assert picture[corner[1], corner[0]].max() < 240


def test_a_board_seen_seldom_is_refused_with_the_number():
    with pytest.raises(InputError, match=f"in 7 different views, at least {LEAST_VIEWS}"):
        fit_camera(around(7))
    with pytest.raises(InputError, match="in 0 different views"):
        fit_camera([])


def test_views_from_one_side_are_refused_and_the_missing_ones_named():
    one_side = [exact_view((20 + i, 20 + i), 0.4 + 0.02 * i, 5.0 * i, seed=i) for i in range(12)]
    with pytest.raises(InputError, match=r"missing: .*edge towards the camera.*edge towards the camera"):
        fit_camera(one_side)
    facing = [exact_view((0, 0), 0.35 + 0.03 * i, 10.0 * i, seed=i) for i in range(12)]
    with pytest.raises(InputError, match=r"tilted|no camera explains|focal length"):
        fit_camera(facing)


@pytest.mark.parametrize(
    ("tilt_deg", "words"),
    [((30, 0), "upper"), ((-30, 0), "lower"), ((0, 30), "right"), ((0, -30), "left")],
)
def test_the_words_for_tilts_are_what_a_person_sees(tilt_deg, words):
    """Without the views tilted so, exactly that tilt is missing; and the edge so named is really nearer."""
    rotation, translation = board_pose(tilt_deg, 0.0, np.array([0.0, 0.0, 0.4]))
    depth = (corners_m() @ rotation.T + translation)[:, 2]
    grid = corners_m()
    edges = {"upper": grid[:, 1].min(), "lower": grid[:, 1].max()}
    edge = (
        grid[:, 1] == edges[words]
        if words in edges
        else grid[:, 0] == (grid[:, 0].min() if words == "left" else grid[:, 0].max())
    )
    assert depth[edge].mean() < depth[~edge].mean()
    axis, sign = (0, np.sign(tilt_deg[0])) if tilt_deg[0] else (1, np.sign(tilt_deg[1]))
    rest = [
        exact_view(tilt, 0.36 + 0.02 * i, 0.0, seed=i)
        for i, tilt in enumerate([(25, 0), (-25, 0), (0, 25), (0, -25), (22, 0), (-22, 0), (0, 22), (0, -22)] * 2)
        if np.sign(tilt[axis]) != sign
    ]
    with pytest.raises(InputError, match=f"missing: with its {words} edge towards the camera \\("):
        fit_camera(rest)


def test_a_view_that_disagrees_is_left_out():
    good = around(12)
    bent = replace(good[3], corners_px=good[3].corners_px + np.sin(good[3].corners_px / 40) * 3)
    fit = fit_camera([*good[:3], bent, *good[4:]])
    assert fit.left_out == 1 and fit.rms_px < 0.1


def test_pictures_of_two_sizes_are_refused():
    with pytest.raises(InputError, match="one size expected, found 320x180 and 640x360"):
        fit_camera([*around(9), replace(around(1)[0], size=(320, 180))])


def test_a_view_counts_once_and_only_with_corners_in_rows_and_columns():
    view = exact_view((10, 10))
    assert usable(view) and not is_new(view, [view]) and is_new(exact_view((10, 10), 0.6), [view])
    row = view.ids < 6
    assert not usable(replace(view, ids=view.ids[row], corners_px=view.corners_px[row]))


def test_where_the_board_never_was_is_named():
    view = replace(exact_view((0, 0)), ids=np.array([0, 1]), corners_px=np.array([[10.0, 10.0], [320.0, 180.0]]))
    assert set(unseen_areas([view])) == {
        "top", "upper right", "left", "right", "lower left", "bottom", "lower right",
    }  # fmt: skip
