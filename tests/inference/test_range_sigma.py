"""How far ranges may be off: the posterior's spread, the palm's misfit, what was assumed."""

import math
from dataclasses import replace

import numpy as np
import pytest

from twohands.geometry.camera import project
from twohands.geometry.canonical import camera_from_canonical
from twohands.inference.decision import PlacementConfig
from twohands.inference.placement import LEAST_MISFIT, palm_misfit, posterior
from twohands.inference.range_sigma import ASSUMED_FOCAL_SPREAD, ASSUMED_LENGTH_SPREAD, with_sources
from twohands.skeleton import PALM, ROOT, WRIST
from twohands.synth.scene.body import load_asset
from twohands.types import GlobalPose, HandPose, PinholeCamera, TwoHandPose

CAMERA = PinholeCamera(500.0, 500.0, 320.0, 180.0, 640, 360)
CONFIG = PlacementConfig(range_errors=(0.05, 0.15), lower_score=0.8, usual_spread=0.3, correlation=0.4)


def scores(*means: float) -> np.ndarray:
    return np.repeat(np.array(means)[:, None], 21, axis=1)


def test_the_spread_of_one_hand_is_that_of_two_normal_sources():
    """1 / sqrt(1 / 0.3^2 + 1 / 0.15^2) at the lower score."""
    _, spread = posterior(np.array([0.5]), scores(0.8), CONFIG)
    assert spread == pytest.approx([1 / math.sqrt(1 / 0.3**2 + 1 / 0.15**2)])


def test_the_other_hand_narrows_what_is_uncertain():
    _, alone = posterior(np.array([0.5]), scores(0.8), CONFIG)
    _, beside = posterior(np.array([0.5, 0.5]), scores(0.8, 1.0), CONFIG)
    prior = 0.3**2 * np.array([[1, 0.4], [0.4, 1]])
    expected = np.linalg.inv(np.linalg.inv(prior) + np.diag([1 / 0.15**2, 1 / 0.05**2]))
    np.testing.assert_allclose(beside, np.sqrt(np.diag(expected)))
    assert beside[0] < alone[0]


def test_68_percent_lie_within_it_where_errors_are_as_supposed():
    rng = np.random.default_rng(0)
    true = CONFIG.usual_range_m * np.exp(rng.normal(0, 0.3, 4000))
    estimated = true * np.exp(rng.normal(0, 0.15, 4000))
    off = []
    for value, truth in zip(estimated, true, strict=True):
        likely, spread = posterior(np.array([value]), scores(0.8), CONFIG)
        off.append(abs(math.log(likely[0] / truth)) / spread[0])
    assert np.mean(np.array(off) < 1) == pytest.approx(0.683, abs=0.025)


def test_nothing_is_said_where_nothing_is_known():
    likely, spread = posterior(np.array([0.5, np.nan]), scores(0.9, 0.9), CONFIG)
    assert np.isfinite(spread[0]) and np.isnan(spread[1]) and np.isnan(likely[1])
    assert np.isnan(posterior(np.array([0.5]), scores(0.9), PlacementConfig())[1]).all()


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


def hand(range_m: float, sigma_m: float | None) -> HandPose:
    return HandPose(True, range_m=range_m, range_sigma_m=sigma_m, valid=True)


@pytest.mark.parametrize(
    ("sources", "share"),
    [
        (("typed", "file"), 0.0),
        (("distance", "assumed"), 0.0),
        (("board", "board"), 0.0),
        (("assumed", "file"), ASSUMED_LENGTH_SPREAD),
        (("typed", "assumed"), ASSUMED_FOCAL_SPREAD),
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
    assert math.sqrt(np.mean(np.log(lengths / 0.10) ** 2)) == pytest.approx(ASSUMED_LENGTH_SPREAD, abs=0.03)


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
