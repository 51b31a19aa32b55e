"""Pixels and rays; the lens model is OpenCV's, checked against OpenCV."""

import cv2
import numpy as np
import pytest

from twohands.geometry.camera import project, unproject
from twohands.types import PinholeCamera

LENSES = {
    "barrel": (-0.28, 0.07, 0.0, 0.0),
    "webcam": (0.05, -0.12, 0.001, -0.002, 0.03),
    "pincushion": (0.3, 0.1, -0.001, 0.002),
    "rational": (0.4, 0.1, 0.0005, -0.0003, 0.01, 0.7, 0.15, 0.02),
}


def camera_with(distortion=()):
    return PinholeCamera(420.0, 415.0, 300.5, 255.25, 640, 480, distortion)


def image_grid(camera):
    u, v = np.meshgrid(np.linspace(0, camera.width, 13), np.linspace(0, camera.height, 11))
    return np.stack([u, v], axis=-1)  # (11, 13, 2)


def test_hand_computed():
    camera = PinholeCamera(100.0, 200.0, 50.0, 40.0, 100, 80)
    np.testing.assert_allclose(unproject(np.array([150.0, 90.0]), camera), [1.0, 0.25, 1.0])
    np.testing.assert_allclose(project(np.array([2.0, 0.5, 2.0]), camera), [150.0, 90.0])


@pytest.mark.parametrize("lens", [(), *LENSES.values()], ids=["none", *LENSES])
def test_round_trip(to, lens):
    camera = camera_with(lens)
    pixels = image_grid(camera)
    rays = unproject(to(pixels), camera)
    assert np.all(np.asarray(rays)[..., 2] == 1)
    np.testing.assert_allclose(np.asarray(project(rays * 3.7, camera, distort=True)), pixels, atol=1e-9)


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_lens_model_is_opencv(to, lens):
    camera = camera_with(lens)
    points = np.random.default_rng(0).uniform([-0.7, -0.5, 0.9], [0.7, 0.5, 1.4], (200, 3))
    intrinsics = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), intrinsics, np.array(lens))[0][:, 0]
    np.testing.assert_allclose(np.asarray(project(to(points), camera, distort=True)), expected, atol=1e-9)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    distorted, lens_model = expected[:, None], np.array(lens)
    if hasattr(cv2, "undistortPointsIter"):  # its name before OpenCV 5
        undone = cv2.undistortPointsIter(distorted, intrinsics, lens_model, np.eye(3), np.eye(3), criteria)[:, 0]
    else:
        undone = cv2.undistortPoints(distorted, intrinsics, lens_model, criteria=criteria)[:, 0]
    np.testing.assert_allclose(np.asarray(unproject(to(expected), camera))[:, :2], undone, atol=1e-9)


def test_no_ray_where_the_lens_model_folds_back(to):
    """x (1 - x^2 / 3) has its maximum 2/3 at x = 1: nothing is seen beyond, and no ray may be invented there.

    The equation has solutions there (x = -2 gives 2/3 again), but they are on the far side of the fold.
    """
    camera = PinholeCamera(100.0, 100.0, 100.0, 100.0, 200, 200, (-1 / 3, 0.0, 0.0, 0.0))
    inside = np.asarray(unproject(to(np.array([100.0 + 66.0, 100.0])), camera))
    assert 0.8 < inside[0] < 1.0 and inside[0] * (1 - inside[0] ** 2 / 3) == pytest.approx(0.66)
    u, v = np.meshgrid(100 + np.linspace(67, 400, 300), 100 + np.linspace(-20, 20, 5))
    beyond = np.concatenate([np.stack([u.ravel(), v.ravel()], axis=-1), [[1e9, -1e9], [np.inf, 0]]])
    assert np.isnan(np.asarray(unproject(to(beyond), camera))[:, :2]).all()
    # x - 0.5 x^5 + 0.2 x^7 falls between 0.95 and 1.2, then grows again: what is found out there is no ray either
    regrowing = PinholeCamera(100.0, 100.0, 100.0, 100.0, 200, 200, (0.0, -0.5, 0.0, 0.0, 0.2))
    rays = np.asarray(unproject(to(np.array([[100 + 50.0, 100.0], [100 + 150.0, 100.0]])), regrowing))
    assert rays[0, 0] < 0.95 and np.isnan(rays[1, 0])


def test_unseen_points_have_no_pixel(to):
    camera = camera_with()
    points = np.array([[0.1, 0.1, 0.0], [0.1, 0.1, -1.0], [np.nan, 0.1, 1.0], [0.1, 0.1, np.inf], [0.1, 0.1, 1.0]])
    pixels = np.asarray(project(to(points), camera))
    assert np.isnan(pixels[[0, 1, 3]]).all() and np.isnan(pixels[2, 0]) and np.isfinite(pixels[4]).all()


def test_resizing_is_a_plain_product():
    """(0, 0) is the outer corner, so the same ray lands at twice the pixel in an image of twice the size."""
    camera = camera_with(LENSES["webcam"])
    pixels = image_grid(camera)
    np.testing.assert_allclose(unproject(2 * pixels, camera.resized(1280, 960)), unproject(pixels, camera), atol=1e-14)


def test_gradients_through_the_lens():
    torch = pytest.importorskip("torch")
    camera = camera_with(LENSES["rational"])
    pixels = torch.tensor(image_grid(camera)[::5, ::4], requires_grad=True)
    assert torch.autograd.gradcheck(lambda p: unproject(p, camera), pixels)
    points = torch.tensor([[0.3, -0.2, 1.1], [-0.4, 0.1, 0.8]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda p: project(p, camera, distort=True), points)


def test_an_unknown_pixel_does_not_spoil_gradients():
    torch = pytest.importorskip("torch")
    pixels = torch.tensor([[100.0, 200.0], [float("nan"), 5.0]], dtype=torch.float64, requires_grad=True)
    rays = unproject(pixels, camera_with(LENSES["webcam"]))
    rays[0].sum().backward()
    assert torch.isfinite(pixels.grad).all() and (pixels.grad[1] == 0).all()
