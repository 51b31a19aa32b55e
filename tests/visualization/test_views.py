"""The three-view figure: what is drawn lies where the joints are, in centimetres, at one scale."""

import dataclasses
import sys

import cv2
import numpy as np
import pytest
from tests.oracles import UNUSED, drawn_hands, full_truth, make_card

from twohands.errors import MissingExtraError
from twohands.inference.estimator import HandEstimator
from twohands.skeleton import SIDES
from twohands.types import HandPose
from twohands.visualization.views import draw_views, render_views

pytest.importorskip("matplotlib")


def scene(seed=0, **options):
    sample = drawn_hands(seed, **options)
    pose = HandEstimator(UNUSED, make_card()).estimate(sample.image, sample.camera, 0.1, full_truth(sample))
    return sample, pose


def drawn_points(axes) -> np.ndarray:
    """(N, 2) corners of all lines of a panel."""
    return np.concatenate([np.stack(line.get_data(), axis=-1) for line in axes.lines])


def contains(points, wanted) -> bool:
    return all(np.linalg.norm(points - p, axis=1).min() < 1e-6 for p in wanted)


def test_joints_are_drawn_where_they_are():
    sample, pose = scene()
    camera_view, top, side = draw_views(sample.image, pose).axes
    for joints_px, joints_m in zip(sample.joints_px, 100 * sample.joints_m, strict=True):
        assert contains(drawn_points(camera_view), joints_px)
        assert contains(drawn_points(top), joints_m[:, [0, 2]])
        assert contains(drawn_points(side), joints_m[:, [2, 1]])


def test_both_plans_hold_camera_and_hands_at_the_same_scale():
    for seed in range(5):
        sample, pose = scene(seed)
        figure = draw_views(sample.image, pose)
        _, top, side = figure.axes
        for axes, columns in ((top, [0, 2]), (side, [2, 1])):
            low = np.sort([axes.get_xlim(), axes.get_ylim()], axis=1)
            for points in (100 * sample.joints_m[..., columns].reshape(-1, 2), np.zeros((1, 2))):
                assert (points > low[:, 0]).all() and (points < low[:, 1]).all()
        figure.canvas.draw()
        scales = [np.ptp(axes.get_xlim()) / axes.get_window_extent().width for axes in (top, side)]
        scales += [np.ptp(axes.get_ylim()) / axes.get_window_extent().height for axes in (top, side)]
        np.testing.assert_allclose(scales, scales[0], rtol=1e-6)


@pytest.mark.parametrize("place", [(0.6, 0.0, 0.3), (0.0, -0.5, 0.2), (-0.1, 0.1, 1.5)])
def test_hands_far_out_and_far_away_are_shown(place):
    sample, pose = scene()
    assert pose.left.joints_m is not None
    moved = pose.left.joints_m - pose.left.joints_m[9] + place
    far = dataclasses.replace(pose, left=dataclasses.replace(pose.left, joints_m=moved))
    _, top, side = draw_views(sample.image, far).axes
    for axes, columns in ((top, [0, 2]), (side, [2, 1])):
        low, high = np.sort([axes.get_xlim(), axes.get_ylim()], axis=1).T
        assert (100 * moved[:, columns] > low).all() and (100 * moved[:, columns] < high).all()


def test_up_is_up():
    """Top view: forward is up, right is right. Side view: y grows downwards, forward is right."""
    sample, pose = scene()
    _, top, side = draw_views(sample.image, pose).axes
    assert top.get_ylim()[0] < top.get_ylim()[1] and top.get_xlim()[0] < top.get_xlim()[1]
    assert side.get_ylim()[0] > side.get_ylim()[1] and side.get_xlim()[0] < side.get_xlim()[1]


def test_ranges_are_written_in_centimetres():
    sample, pose = scene()
    camera_view = draw_views(sample.image, pose).axes[0]
    texts = [text.get_text() for text in camera_view.get_legend().get_texts()]
    for name, joints in zip(SIDES, sample.joints_m, strict=True):
        assert f"{name.capitalize()} hand: {100 * np.linalg.norm(joints[9]):.1f} cm" in texts


def test_absent_hands_and_unsolved_ranges_are_said():
    sample, pose = scene(1, present=(True, False))
    unsolved = dataclasses.replace(pose.left, joints_m=None, range_m=None, valid=False)
    camera_view, top, _ = draw_views(sample.image, dataclasses.replace(pose, left=unsolved)).axes
    texts = [text.get_text() for text in camera_view.get_legend().get_texts()]
    assert texts == ["Left hand: range not solved", "Right hand: not found"]
    assert len(top.lines) == 2, "only the two edges of the field of view"
    nothing = dataclasses.replace(pose, left=HandPose(present=False))
    assert render_views(sample.image, nothing).startswith(b"\x89PNG")


def test_the_bytes_are_a_picture():
    sample, pose = scene(2)
    picture = cv2.imdecode(np.frombuffer(render_views(sample.image, pose, title="two hands"), np.uint8), 1)
    assert picture.shape[1] > 2 * picture.shape[0] > 800
    assert (picture[:5] == 255).all(), "white paper"


def test_without_matplotlib_the_extra_is_named(monkeypatch):
    sample, pose = scene()
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=r"twohands\[view\]"):
        draw_views(sample.image, pose)


def test_a_hand_of_absurd_size_is_drawn_too():
    """Named case: a hand length of 1e11 cm ended with a traceback, for no grid was coarse enough."""
    sample = drawn_hands(0)
    pose = HandEstimator(UNUSED, make_card()).estimate(sample.image, sample.camera, 1e9, full_truth(sample))
    assert render_views(sample.image, pose)
