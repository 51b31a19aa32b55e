"""How far ranges may be off: how sure the joints are, the palm's misfit, what was assumed."""

import math
from dataclasses import replace

import numpy as np
import pytest

from twohands.geometry.camera import project
from twohands.geometry.canonical import camera_from_canonical
from twohands.inference.decision import PlacementConfig
from twohands.inference.placement import DOUBT, LEAST_MISFIT, palm_misfit, palm_span, posterior_ranges, range_sigma
from twohands.inference.range_sigma import (
    ASSUMED_FOCAL_SPREAD,
    ASSUMED_LENGTH_SPREAD,
    TAPED_SPREAD,
    TYPED_LENGTH_SPREAD,
    with_sources,
)
from twohands.skeleton import PALM, ROOT, WRIST
from twohands.synth.scene.body import load_asset
from twohands.types import GlobalPose, HandPose, PinholeCamera, TwoHandPose

CAMERA = PinholeCamera(500.0, 500.0, 320.0, 180.0, 640, 360)
CONFIG = PlacementConfig(range_errors=(0.05, 0.15), range_sigma=(0.03, 1.5, 0.5, 1.0))
SPAN = np.array([CONFIG.sigma_span])


def scores(*means: float) -> np.ndarray:
    return np.repeat(np.array(means)[:, None], 21, axis=1)


def test_a_sure_hand_that_agrees_has_the_first_number_and_powers_do_the_rest():
    """Half as sure again of what is missing of the score, and four times the misfit: 2^1.5 and 4^0.5 times as much."""
    typical = range_sigma(scores(CONFIG.sigma_score), np.array([CONFIG.sigma_misfit]), SPAN, CONFIG)
    assert typical == pytest.approx([0.03])
    less = DOUBT - 2 * (DOUBT - CONFIG.sigma_score)
    misfit, span = np.array([1, 4, 1]) * CONFIG.sigma_misfit, np.array([1, 1, 0.5]) * CONFIG.sigma_span
    found = range_sigma(scores(less, CONFIG.sigma_score, CONFIG.sigma_score), misfit, span, CONFIG)
    assert found == pytest.approx([0.03 * 2**1.5, 0.03 * 2, 0.03 / 2])


def test_no_picture_tells_less_than_what_is_usual():
    assert range_sigma(scores(0.1), np.array([0.5]), SPAN, CONFIG) == pytest.approx([CONFIG.usual_spread])


def test_a_perfect_score_is_not_taken_for_certainty():
    assert range_sigma(scores(1.0), np.array([LEAST_MISFIT]), SPAN, CONFIG) > 0.001


def test_nothing_is_said_where_nothing_is_known():
    assert np.isnan(range_sigma(scores(0.9), np.array([0.02]), SPAN, PlacementConfig())).all()
    assert np.isnan(range_sigma(scores(0.9), np.array([np.nan]), SPAN, CONFIG)).all()
    likely = posterior_ranges(np.array([0.5, np.nan]), np.array([0.9, 0.9]), CONFIG)
    assert np.isfinite(likely[0]) and np.isnan(likely[1])


def placed_hand() -> tuple[np.ndarray, np.ndarray, GlobalPose]:
    canonical = np.random.default_rng(1).uniform(-0.8, 0.8, (1, 21, 3))
    canonical[0, ROOT], canonical[0, WRIST] = 0, (0.0, 1.0, 0.0)
    radius, theta, phi = np.array([0.5]), np.array([0.1]), np.array([-0.2])
    joints_m = camera_from_canonical(canonical, np.array([0.1]), radius, theta, phi)
    pose = GlobalPose(joints_m, radius, theta, phi, np.array([0]), np.array([True]))
    return canonical, project(joints_m, CAMERA), pose


def test_a_pose_that_is_seen_where_it_is_has_the_least_misfit():
    canonical, pixels, pose = placed_hand()
    assert palm_misfit(canonical, pixels, CAMERA, np.array([0.1]), pose) == pytest.approx([LEAST_MISFIT])


def test_the_misfit_is_in_hand_lengths_at_the_hand_s_range():
    """5 px of 500 px focal length at 0.5 m are 5 mm, 0.05 of a hand of 0.1 m; fingers do not count."""
    canonical, pixels, pose = placed_hand()
    moved = pixels + np.isin(np.arange(21), PALM)[:, None] * [5.0, 0.0]
    assert palm_misfit(canonical, moved, CAMERA, np.array([0.1]), pose) == pytest.approx([0.05], rel=1e-6)
    fingers = pixels + (~np.isin(np.arange(21), PALM))[:, None] * [50.0, 0.0]
    assert palm_misfit(canonical, fingers, CAMERA, np.array([0.1]), pose) == pytest.approx([LEAST_MISFIT])


def test_the_span_of_a_palm_is_as_it_is_seen():
    """Joints on a circle of 0.3 have that span from in front, and half of its square from the side."""
    canonical = np.zeros((2, 21, 3))
    angles = np.arange(len(PALM)) * 2 * math.pi / len(PALM)
    canonical[0, list(PALM)] = 0.3 * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=-1)
    canonical[1, list(PALM)] = 0.3 * np.stack([0 * angles, np.sin(angles), np.cos(angles)], axis=-1)
    np.testing.assert_allclose(palm_span(canonical), [0.3, 0.3 / math.sqrt(2)])


def hand(range_m: float, sigma_m: float | None) -> HandPose:
    return HandPose(True, range_m=range_m, range_sigma_m=sigma_m, valid=True)


@pytest.mark.parametrize(
    ("sources", "share"),
    [
        (("typed", "file"), TYPED_LENGTH_SPREAD),
        (("distance", "assumed"), TAPED_SPREAD),
        (("distance", "file"), TAPED_SPREAD),
        (("board", "board"), 0.0),
        (("assumed", "file"), ASSUMED_LENGTH_SPREAD),
        (("typed", "assumed"), math.hypot(TYPED_LENGTH_SPREAD, ASSUMED_FOCAL_SPREAD)),
        (("assumed", "assumed"), math.hypot(ASSUMED_LENGTH_SPREAD, ASSUMED_FOCAL_SPREAD)),
    ],
)
def test_what_was_assumed_comes_on_top(sources, share):
    pose = TwoHandPose(hand(0.5, 0.02), HandPose(present=False), CAMERA)
    found = with_sources(pose, *sources)
    assert found.left.range_sigma_m == pytest.approx(math.hypot(0.02, 0.5 * share))
    assert (found.left.scale_source, found.left.intrinsics_source) == sources
    assert found.right == pose.right
    assert with_sources(replace(pose, left=hand(0.5, None)), *sources).left.range_sigma_m is None


def test_the_spread_of_lengths_is_that_of_the_generator_s_adults():
    asset = load_asset()
    lengths = np.array([asset.body(each).hand_length_m for each in asset.coefficients[::8]])
    assert np.quantile(np.abs(lengths / 0.10 - 1), 0.683) == pytest.approx(ASSUMED_LENGTH_SPREAD, abs=0.01)


def test_the_spread_of_typed_lengths_is_that_of_the_generator_s_adults():
    """A user measures the whole hand; how long its palm is beside its middle finger differs."""
    asset = load_asset()
    shares = []
    for each in asset.coefficients[::8]:
        hand = np.asarray(asset.body(each).joints)[0, 1:]
        chain = np.linalg.norm(hand[[ROOT, 10, 11, 12]] - hand[[WRIST, ROOT, 10, 11]], axis=-1)
        shares.append(chain[0] / chain.sum())
    assert np.log(shares).std() == pytest.approx(TYPED_LENGTH_SPREAD, abs=0.006)


def test_the_spread_of_focal_lengths_is_that_of_even_fields_of_view():
    fov = np.radians(np.linspace(50, 110, 2001))
    off = np.log(math.tan(math.radians(30)) / np.tan(fov / 2))
    assert math.sqrt(np.mean(off**2)) == pytest.approx(ASSUMED_FOCAL_SPREAD, abs=0.005)


def test_from_one_hand_to_the_other():
    joints = np.zeros((2, 21, 3))
    joints[0, ROOT], joints[1, ROOT] = (-0.1, 0.0, 0.5), (0.2, 0.1, 0.4)
    boxes = np.array([[0.0, 0.0, 10.0, 10.0], [5.0, 5.0, 9.0, 25.0]])
    left, right = (HandPose(True, box_px=boxes[i], joints_m=joints[i], valid=True) for i in range(2))
    pose = TwoHandPose(left, right, CAMERA)
    np.testing.assert_allclose(pose.between_hands_m, [0.3, 0.1, -0.1])
    assert pose.overlap == pytest.approx(4 * 5 / 80)
    apart = replace(pose, right=replace(right, valid=False, joints_m=None, box_px=boxes[1] + 100))
    assert apart.between_hands_m is None and apart.overlap == 0
    assert TwoHandPose(left, HandPose(present=False), CAMERA).overlap is None
