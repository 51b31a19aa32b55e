"""The authors' published sample, instance 00000 (docs/paper-map.md, *Exactness*): exact up to
its float32 labels."""

from dataclasses import dataclass

import numpy as np
import pytest

from twohands.geometry.camera import project, unproject
from twohands.geometry.canonical import canonical_from_camera, cartesian_alignment
from twohands.geometry.projection import canonical_xy_from_rays, project_global
from twohands.skeleton import LITTLE_MCP, ROOT, WRIST
from twohands.types import PinholeCamera

CAMERA = PinholeCamera(375.864404, 375.864404, 480.0, 270.0, 960, 540)
HAND_LENGTH_M = 0.1
CM = 100.0


@dataclass(frozen=True)
class Sample:
    joints_px: np.ndarray
    joints_m: np.ndarray
    canonical: np.ndarray


@pytest.fixture(scope="module")
def sample(shared_data):
    """Both hands in our conventions, read here by hand: (row, column[, depth]) swapped, elbow dropped, cm to m."""
    folder = shared_data / "official" / "ego3dhands" / "00000"
    if not folder.is_dir():
        pytest.skip("the official Ego3DHands sample is not among the shared data")
    fractions, global_cm, canonical = (
        np.load(folder / f"location_{name}.npy")[:, 1:] for name in ("2d", "3d_global", "3d_canonical")
    )
    to_xyz = [1, 0, 2]
    return Sample(fractions[..., ::-1] * [960, 540], global_cm[..., to_xyz] / CM, canonical[..., to_xyz])


def mean_error_cm(joints_m, truth):
    return CM * np.linalg.norm(np.asarray(joints_m) - truth, axis=-1).mean(axis=-1)


def test_canonical_is_recomputed(to, sample):
    canonical = canonical_from_camera(to(sample.joints_m))
    assert np.abs(np.asarray(canonical.joints) - sample.canonical).max() < 1e-6
    np.testing.assert_allclose(np.asarray(canonical.hand_length_m), HAND_LENGTH_M, atol=1e-6)


@pytest.mark.parametrize("method", ["keybone", "all-joints", "fitted"])
def test_global_is_recovered(to, sample, method):
    pose = project_global(to(sample.canonical), to(sample.joints_px), CAMERA, HAND_LENGTH_M, method=method)
    assert np.asarray(pose.valid).all()
    assert CM * np.abs(np.asarray(pose.joints_m) - sample.joints_m).max() < 1e-4


def test_worked_example(sample):
    """The table of docs/paper-map.md, *Exactness*, every number to the digits printed there."""
    pose = project_global(sample.canonical, sample.joints_px, CAMERA, HAND_LENGTH_M, method="keybone")
    np.testing.assert_allclose(np.degrees(pose.theta), [-2.5139, -2.9669], atol=5e-5)
    np.testing.assert_allclose(np.degrees(pose.phi), [16.4926, 15.5146], atol=5e-5)
    across = np.linalg.norm(sample.joints_px - sample.joints_px[:, ROOT : ROOT + 1], axis=-1)
    np.testing.assert_allclose(across[:, WRIST], [91.98, 120.13], atol=5e-3)
    np.testing.assert_allclose(across[:, LITTLE_MCP], [48.73, 42.87], atol=5e-3)
    assert pose.key_bone.tolist() == [0, 0]  # the wrist
    np.testing.assert_allclose(CM * pose.radius_m, [28.10820, 32.97803], atol=5e-6)
    np.testing.assert_allclose(CM * np.linalg.norm(sample.joints_m[:, ROOT], axis=-1), [28.10818, 32.97801], atol=5e-6)
    np.testing.assert_allclose(mean_error_cm(pose.joints_m, sample.joints_m), [2.3e-5, 2.6e-5], atol=5e-7)


def test_worked_example_with_the_printed_equation(sample):
    pose = project_global(sample.canonical, sample.joints_px, CAMERA, HAND_LENGTH_M, method="keybone", angles="paper")
    np.testing.assert_allclose(np.degrees(pose.phi), [16.5077, 15.5344], atol=5e-5)
    np.testing.assert_allclose(mean_error_cm(pose.joints_m, sample.joints_m), [0.013, 0.037], atol=5e-4)


def test_cartesian_alignment_keeps_an_error(sample):
    aligned = cartesian_alignment(sample.canonical, HAND_LENGTH_M, sample.joints_m)
    error_cm = CM * np.linalg.norm(aligned - sample.joints_m, axis=-1)
    np.testing.assert_allclose(error_cm.mean(axis=-1), [0.94, 0.99], atol=6e-3)  # the second is 0.985
    np.testing.assert_allclose(error_cm.max(axis=-1), [2.68, 2.71], atol=5e-3)


def test_intrinsics_fit(sample):
    """The layout's own camera reprojects the labels to 1e-4 px: focal length, principal point, corner convention."""
    assert np.abs(project(sample.joints_m, CAMERA) - sample.joints_px).max() < 1e-4


def test_pixels_imply_the_canonical_xy(to, sample):
    distance = np.linalg.norm(sample.joints_m[:, ROOT], axis=-1) / HAND_LENGTH_M
    xy = canonical_xy_from_rays(unproject(to(sample.joints_px), CAMERA), to(distance), to(sample.canonical[..., 2]))
    np.testing.assert_allclose(np.asarray(xy), sample.canonical[..., :2], atol=1e-5)
