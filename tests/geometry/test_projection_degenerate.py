"""Input the projection must refuse: no number is invented, no warning given, no neighbour disturbed."""

import numpy as np
import pytest
from tests.builders import CENTRED_CAMERA, random_hands

from twohands.geometry.camera import project
from twohands.geometry.canonical import canonical_from_camera
from twohands.geometry.projection import project_global
from twohands.skeleton import LITTLE_MCP, ROOT, WRIST
from twohands.types import PinholeCamera

METHODS = ["keybone", "all-joints", "fitted"]


def degenerate_cases():
    """name -> (canonical, joints_px, hand_length_m, methods that must refuse it)."""
    joints_m, joints_px, length = random_hands(1, CENTRED_CAMERA, np.random.default_rng(16))
    good = canonical_from_camera(joints_m[0]).joints, joints_px[0], length[0]

    def changed(**changes):
        canonical, pixels = good[0].copy(), good[1].copy()
        for joints, value in changes.get("canonical", {}).items():
            canonical[joints] = value
        for joints, value in changes.get("pixels", {}).items():
            pixels[joints] = value
        return canonical, pixels, changes.get("length", good[2])

    every = ...
    before = 0.5 * np.array([0, 0, 1]) * (np.arange(21) != ROOT)[:, None]
    behind = good[0] * [-1, -1, 1]  # the hand seen upside down can only lie behind the camera
    return {
        "absent, NaN": (*changed(canonical={every: np.nan}, pixels={every: np.nan}), METHODS),
        "absent, zeros": (*changed(canonical={every: 0}, pixels={every: 0}), METHODS),
        "canonical zeros": (*changed(canonical={every: 0}), METHODS),
        "pixels all zero": (*changed(pixels={every: 0}), METHODS),
        "root pixel NaN": (*changed(pixels={ROOT: np.nan}), METHODS),
        "wrist pixel NaN": (*changed(pixels={WRIST: np.nan}), METHODS),
        "little MCP pixel infinite": (*changed(pixels={LITTLE_MCP: np.inf}), METHODS),
        "finger pixel NaN": (*changed(pixels={4: np.nan}), ["all-joints", "fitted"]),
        "canonical finger NaN": (*changed(canonical={4: np.nan}), METHODS),
        "canonical finger infinite": (*changed(canonical={4: -np.inf}), METHODS),
        "length 0": (*changed(length=0.0), METHODS),
        "length negative": (*changed(length=-0.1), METHODS),
        "length NaN": (*changed(length=np.nan), METHODS),
        "length infinite": (*changed(length=np.inf), METHODS),
        "both key bones without 2D length": (
            *changed(pixels={WRIST: good[1][ROOT], LITTLE_MCP: good[1][ROOT]}),
            ["keybone"],
        ),
        "all pixels on the root": (*changed(pixels={every: [200.0, 100.0]}), METHODS),
        "all pixels next to the root": (
            *changed(pixels={every: [200.0, 100.0], WRIST: [200.0, 100.0 + 1e-7]}),
            METHODS,
        ),
        "key bones along the ray": (*changed(canonical={WRIST: [0, 0, -1], LITTLE_MCP: [0, 1e-9, 0.4]}), ["keybone"]),
        "key bone all but along the ray": (*changed(canonical={WRIST: [1e-9, 0, -1.0]}), ["keybone"]),
        "all joints along the ray": (good[0] * [0, 0, 1], good[1], good[2], METHODS),
        "all joints all but along the ray": (good[0] * [1e-9, 1e-9, 0] - before, good[1], good[2], METHODS),
        "hand behind the camera": (behind, good[1], good[2], ["all-joints", "fitted"]),
        "wrist seen far wider than it is": (
            *changed(canonical={WRIST: [0.01, 0, 1.0], LITTLE_MCP: [0.01, 0, 0.4]}, pixels={WRIST: [500.0, 250.0]}),
            METHODS,
        ),
        "huge canonical": (*changed(canonical={WRIST: 1e308, LITTLE_MCP: 1e308}, length=100.0), METHODS),
        "huge finger": (*changed(canonical={4: 1e308}, length=100.0), METHODS),
        "huge pixels": (*changed(pixels={WRIST: 1e308, LITTLE_MCP: -1e308}), METHODS),
        "tiny length": (*changed(length=5e-324), METHODS),
    }


CASES = degenerate_cases()


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("method", METHODS)
def test_degenerate_input_is_refused_without_a_warning(to, case, method):
    canonical, joints_px, length, refused_by = CASES[case]
    pose = project_global(to(canonical), to(joints_px), CENTRED_CAMERA, float(length), method=method)
    known = bool(np.isfinite(np.asarray(pose.joints_m)).all() and np.isfinite(np.asarray(pose.radius_m)))
    unknown = bool(np.isnan(np.asarray(pose.joints_m)).all() and np.isnan(np.asarray(pose.radius_m)))
    assert bool(pose.valid) == known == (not unknown)
    assert bool(pose.valid) == (method not in refused_by)


@pytest.mark.parametrize("joint", [ROOT, WRIST, LITTLE_MCP])
@pytest.mark.parametrize("method", METHODS)
def test_a_pixel_outside_the_lens_model_is_unknown(to, method, joint):
    """Finite, but no ray leads there: the model x (1 - x^2 / 3) sees nothing beyond 2/3."""
    camera = PinholeCamera(100.0, 100.0, 100.0, 100.0, 200, 200, (-1 / 3, 0.0, 0.0, 0.0))
    joints_m = 0.05 * random_hands(1, CENTRED_CAMERA, np.random.default_rng(16))[0][0] + [0.0, 0.0, 0.3]
    canonical = canonical_from_camera(joints_m)
    joints_px = project(joints_m, camera, distort=True)
    length = float(canonical.hand_length_m)
    assert bool(project_global(to(canonical.joints), to(joints_px), camera, length, method=method).valid)
    joints_px[joint] = [190.0, 110.0]
    pose = project_global(to(canonical.joints), to(joints_px), camera, length, method=method)
    assert not bool(pose.valid) and np.isnan(np.asarray(pose.joints_m)).all()
    assert np.isnan(float(pose.theta)) == (joint == ROOT)


@pytest.mark.parametrize("method", METHODS)
def test_a_joint_seen_beside_the_turned_camera_is_refused(to, method):
    """In a very wide image the wrist is seen more than 90 degrees from the root: no slope describes it."""
    camera = PinholeCamera.from_fov(150, 640, 480)
    joints_m, _, length = random_hands(1, CENTRED_CAMERA, np.random.default_rng(16))
    canonical = canonical_from_camera(joints_m[0]).joints
    joints_px = np.full((21, 2), 240.0)
    joints_px[ROOT] = [20.0, 240.0]
    joints_px[:, 0] += np.arange(21) - ROOT
    joints_px[WRIST] = [620.0, 240.0]
    canonical[WRIST] = [0.9, 0.0, 0.4]
    pose = project_global(to(canonical), to(joints_px), camera, float(length[0]), method=method)
    assert not bool(pose.valid) and np.isnan(np.asarray(pose.joints_m)).all()


@pytest.mark.parametrize("method", METHODS)
def test_a_degenerate_neighbour_changes_nothing(to, method):
    """In a batch with every degenerate case, the good hand's result is the same."""
    joints_m, joints_px, length = random_hands(1, CENTRED_CAMERA, np.random.default_rng(17))
    canonical = np.stack([canonical_from_camera(joints_m[0]).joints, *(case[0] for case in CASES.values())])
    pixels = np.stack([joints_px[0], *(case[1] for case in CASES.values())])
    lengths = np.array([length[0], *(case[2] for case in CASES.values())])
    pose = project_global(to(canonical), to(pixels), CENTRED_CAMERA, to(lengths), method=method)
    assert np.asarray(pose.valid).tolist() == [True, *(method not in case[3] for case in CASES.values())]
    np.testing.assert_allclose(np.asarray(pose.joints_m)[0], joints_m[0], atol=1e-12)


def test_key_bone_along_the_ray_uses_the_other(to):
    """A wrist exactly behind or before the root is no obstacle: the little MCP takes over."""
    camera = CENTRED_CAMERA
    joints_m = random_hands(1, camera, np.random.default_rng(18))[0][0]
    joints_m[WRIST] = joints_m[ROOT] * 1.2
    canonical = canonical_from_camera(joints_m)
    joints_px = project(joints_m, camera)
    for method in METHODS:
        pose = project_global(
            to(canonical.joints), to(joints_px), camera, float(canonical.hand_length_m), method=method
        )
        assert bool(pose.valid) and int(pose.key_bone) == 1
        np.testing.assert_allclose(np.asarray(pose.joints_m), joints_m, atol=1e-12)


def test_direction_is_known_even_where_the_range_is_not(to):
    canonical, joints_px, _, _ = CASES["length NaN"]
    pose = project_global(to(canonical), to(joints_px), CENTRED_CAMERA, float("nan"))
    assert not bool(pose.valid) and np.isfinite(float(pose.theta)) and np.isfinite(float(pose.phi))
    pose = project_global(to(canonical), to(joints_px * np.nan), CENTRED_CAMERA, 0.1)
    assert np.isnan(float(pose.theta)) and np.isnan(float(pose.phi))


@pytest.mark.parametrize("method", METHODS)
def test_degenerate_neighbours_do_not_spoil_gradients(method):
    """The valid hands get finite gradients, the refused ones none at all."""
    torch = pytest.importorskip("torch")
    joints_m, joints_px, length = random_hands(1, CENTRED_CAMERA, np.random.default_rng(17))
    cases = [case for name, case in CASES.items() if not name.startswith("huge")]  # overflow has no gradient to save
    arguments = [
        torch.tensor(np.stack([first, *(case[k] for case in cases)]), requires_grad=True)
        for k, first in enumerate((canonical_from_camera(joints_m[0]).joints, joints_px[0], length[0]))
    ]
    weights = None
    if method != "keybone":
        weights = torch.ones(arguments[0].shape[:-1], dtype=torch.float64)
        weights[1, 3] = float("nan")
    pose = project_global(arguments[0], arguments[1], CENTRED_CAMERA, arguments[2], method=method, weights=weights)
    pose.joints_m[pose.valid].sum().backward()
    for argument in arguments:
        assert torch.isfinite(argument.grad).all()
        assert (argument.grad[~pose.valid] == 0).all()
    assert (arguments[0].grad[0] != 0).any()
