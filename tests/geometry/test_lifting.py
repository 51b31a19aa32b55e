"""Anybody's shape of a hand, placed: exact for exact input, whatever its unit, origin and axes."""

import numpy as np
import pytest
from tests.builders import CENTRED_CAMERA, OFF_CENTRE_CAMERA, random_hands

from twohands.errors import InputError
from twohands.geometry.canonical import canonical_from_camera
from twohands.geometry.lifting import canonical_from_shape, lift
from twohands.skeleton import ROOT, WRIST

CAMERAS = [CENTRED_CAMERA, OFF_CENTRE_CAMERA]


def shapes(joints_m, view, rng):
    """The hands' shapes as a tracker tells them: another size and another origin for each hand."""
    shape = joints_m if view == "camera" else canonical_from_camera(joints_m).joints
    n = len(joints_m)
    return shape * rng.uniform(0.01, 1000, (n, 1, 1)) + rng.uniform(-5, 5, (n, 1, 3))


@pytest.mark.parametrize("camera", CAMERAS, ids=["centred", "off-centre"])
@pytest.mark.parametrize("view", ["centred", "camera"])
@pytest.mark.parametrize("method", ["fitted", "all-joints", "keybone"])
def test_true_pixels_and_shape_give_the_true_place(to, camera, view, method):
    rng = np.random.default_rng(3)
    joints_m, joints_px, length = random_hands(300, camera, rng)
    shape = to(shapes(joints_m, view, rng))
    pose = lift(to(joints_px), shape, camera, to(length), view=view, method=method)
    assert bool(pose.valid.all())
    np.testing.assert_allclose(np.asarray(pose.joints_m), joints_m, atol=1e-9)
    np.testing.assert_allclose(np.asarray(pose.radius_m), np.linalg.norm(joints_m[:, ROOT], axis=-1), atol=1e-9)


def test_batch_is_the_same_as_one_by_one_and_inputs_stay():
    rng = np.random.default_rng(4)
    joints_m, joints_px, length = random_hands(6, OFF_CENTRE_CAMERA, rng)
    joints_px = joints_px + rng.normal(0, 1, joints_px.shape)
    shape, scores = shapes(joints_m, "centred", rng), rng.uniform(0, 1, (6, 21))
    before = [array.copy() for array in (joints_px, shape, scores)]
    pose = lift(joints_px.reshape(2, 3, 21, 2), shape.reshape(2, 3, 21, 3), OFF_CENTRE_CAMERA, length.reshape(2, 3),
                joint_scores=scores.reshape(2, 3, 21))  # fmt: skip
    for i in range(6):
        one = lift(joints_px[i], shape[i], OFF_CENTRE_CAMERA, float(length[i]), joint_scores=scores[i])
        np.testing.assert_allclose(pose.joints_m.reshape(6, 21, 3)[i], one.joints_m, atol=1e-12)
    for array, old in zip((joints_px, shape, scores), before, strict=True):
        np.testing.assert_array_equal(array, old)


def test_joints_that_were_not_found_do_not_count(to):
    rng = np.random.default_rng(5)
    joints_m, joints_px, length = random_hands(50, CENTRED_CAMERA, rng)
    joints_px[:, [4, 8, 20, WRIST]] = np.nan
    pose = lift(to(joints_px), to(shapes(joints_m, "centred", rng)), CENTRED_CAMERA, to(length))
    np.testing.assert_allclose(np.asarray(pose.joints_m), joints_m, atol=1e-9)


def test_a_hand_that_cannot_be_placed_leaves_the_others_alone(to):
    rng = np.random.default_rng(6)
    joints_m, joints_px, length = random_hands(4, CENTRED_CAMERA, rng)
    shape = shapes(joints_m, "camera", rng)
    shape[0, WRIST] = shape[0, ROOT]
    joints_px[1, ROOT] = np.nan
    shape[2, 7] = np.inf
    pose = lift(to(joints_px), to(shape), CENTRED_CAMERA, to(length), view="camera")
    assert np.asarray(pose.valid).tolist() == [False, False, False, True]
    np.testing.assert_allclose(np.asarray(pose.joints_m[3]), joints_m[3], atol=1e-9)


def test_an_uncertain_joint_counts_less():
    joints_m, joints_px, length = random_hands(200, CENTRED_CAMERA, np.random.default_rng(7))
    joints_px[:, 12] += 25.0
    scores = np.ones((200, 21))
    alike = lift(joints_px, joints_m, CENTRED_CAMERA, length, view="camera", joint_scores=scores, method="all-joints")
    scores[:, 12] = 0.1
    doubted = lift(joints_px, joints_m, CENTRED_CAMERA, length, view="camera", joint_scores=scores, method="all-joints")
    true = np.linalg.norm(joints_m[:, ROOT], axis=-1)
    assert np.median(abs(doubted.radius_m - true)) < 0.2 * np.median(abs(alike.radius_m - true))


def test_gradients_pass():
    torch = pytest.importorskip("torch")
    joints_m, joints_px, _ = random_hands(3, CENTRED_CAMERA, np.random.default_rng(8))
    shape = torch.from_numpy(joints_m.copy())
    shape[1, WRIST] = shape[1, ROOT]
    shape.requires_grad_(True)
    pose = lift(torch.from_numpy(joints_px), shape, CENTRED_CAMERA, 0.1, view="camera")
    pose.radius_m[pose.valid].sum().backward()
    assert bool(torch.isfinite(shape.grad).all()) and bool((shape.grad[0] != 0).any())


def test_a_canonical_pose_stays_as_it_is(to):
    joints_m, joints_px, _ = random_hands(10, CENTRED_CAMERA, np.random.default_rng(9))
    canonical = canonical_from_camera(joints_m).joints
    again = canonical_from_shape(to(canonical), to(joints_px), CENTRED_CAMERA)
    np.testing.assert_allclose(np.asarray(again), canonical, atol=1e-12)


def test_an_unknown_view_is_refused():
    with pytest.raises(InputError, match="view centred or camera"):
        lift(np.zeros((21, 2)), np.zeros((21, 3)), CENTRED_CAMERA, 0.1, view="world")  # pyright: ignore
