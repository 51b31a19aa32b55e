"""The baked asset against Anny itself (extra `synth-bake`)."""

import numpy as np
import pytest

from twohands.errors import MissingExtraError
from twohands.synth.scene.bake import (
    arm_local_changes,
    average_adult,
    fit_shape_basis,
    load_anny,
    random_adults,
    rest_state,
    shape_vector,
)
from twohands.synth.scene.body import (
    BONE_NAMES,
    BONE_PARENTS,
    CAMERA_FROM_BODY,
    JOINT_BONES,
    Body,
    forward_kinematics,
    load_asset,
    posed_joints,
    skin,
)
from twohands.synth.scene.pose import rotation_about


@pytest.fixture(scope="module")
def model():
    pytest.importorskip("anny", reason="the extra synth-bake is not installed")
    import torch

    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    yield load_anny().double()
    torch.set_default_dtype(before)


def random_rotations(rng, count):
    out = np.empty((count, len(BONE_NAMES), 3, 3))
    for pose in out:
        for i in range(len(BONE_NAMES)):
            axis = rng.normal(size=3)
            pose[i] = rotation_about(axis / np.linalg.norm(axis), rng.uniform(-0.9, 0.9))
    return out


def anny_posed(model, phenotypes, changes, rotations):
    """Anny's own answer in the camera frame: vertices (B, 13718, 3) and bone heads of our bones (B, 48, 3)."""
    import torch

    with torch.no_grad():
        rest = model(phenotype_kwargs=phenotypes, local_changes_kwargs=changes or None)
    labels = list(model.bone_labels)
    count = len(rotations)
    rest_poses = rest["rest_bone_poses"].expand(count, -1, 4, 4).numpy()
    # World orientations: at rest everywhere but along the arms, where every bone adds its own turn to its parent's.
    # Ours turns about the camera's axes, Anny's bones have axes of their own.
    orientations = rest_poses.copy()
    turns = np.empty((count, len(BONE_NAMES), 3, 3))
    for i, (name, parent) in enumerate(zip(BONE_NAMES, BONE_PARENTS, strict=True)):
        own = CAMERA_FROM_BODY.T @ rotations[:, i] @ CAMERA_FROM_BODY
        turns[:, i] = own if parent < 0 else turns[:, parent] @ own
        at = labels.index(name)
        orientations[:, at, :3, :3] = turns[:, i] @ rest_poses[:, at, :3, :3]
    expand = lambda d: {k: v.expand(count) if v.shape[0] == 1 else v for k, v in d.items()}  # noqa: E731
    with torch.no_grad():
        posed = model(
            torch.as_tensor(orientations),
            expand(phenotypes),
            expand(changes) or None,
            pose_parameterization="world-orient",
        )
    eyes = rest["rest_bone_heads"][:, [labels.index("eye.L"), labels.index("eye.R")]].mean(1).numpy()[:, None]
    heads = posed["bone_poses"][:, [labels.index(n) for n in BONE_NAMES], :3, 3].numpy()
    to_camera = lambda points: (points - eyes) @ CAMERA_FROM_BODY.T  # noqa: E731
    return to_camera(posed["vertices"].numpy()), to_camera(heads)


def ours_posed(body, rotations):
    vertices, joints = [], []
    for pose in rotations:
        transforms = forward_kinematics(body, pose)
        vertices.append(skin(body, transforms))
        joints.append(posed_joints(body, transforms))
    return np.array(vertices), np.array(joints)


def worst(a, b):
    return np.linalg.norm(a - b, axis=-1).max()


def own_joints():
    """Joints that are bone heads, all but the fingertips: (2, 22) mask."""
    return JOINT_BONES >= 0


def test_average_body_is_within_a_millimetre_over_50_poses(model):
    asset = load_asset()
    rotations = random_rotations(np.random.default_rng(5), 50)
    vertices, heads = anny_posed(model, average_adult(), {}, rotations)
    ours, joints = ours_posed(asset.body(), rotations)
    assert worst(ours, vertices[:, asset.anny_vertices]) < 1e-3
    mask = own_joints()
    assert worst(joints[:, mask], heads[:, JOINT_BONES[mask]]) < 1e-3


def test_random_adults_are_within_three_millimetres(model):
    asset = load_asset()
    rng = np.random.default_rng(1234)
    count = 30
    phenotypes, changes = random_adults(model, count, rng)
    rotations = random_rotations(rng, count)
    vertices, heads = anny_posed(model, phenotypes, changes, rotations)
    rest_vertices, rest_heads = rest_state(model, phenotypes, changes)
    labels = list(model.bone_labels)
    eyes = rest_heads[:, [labels.index("eye.L"), labels.index("eye.R")]].mean(1, keepdims=True)
    own = [labels.index(name) for name in BONE_NAMES]
    rest = np.concatenate([rest_vertices[:, asset.anny_vertices], rest_heads[:, own]], axis=1)
    rest = (rest - eyes) @ CAMERA_FROM_BODY.T
    basis = asset.basis.reshape(len(asset.basis), -1).astype(float)
    shapes = np.linalg.lstsq(basis.T, (rest - asset.average).reshape(count, -1).T, rcond=None)[0].T
    mask = own_joints()
    for i in range(count):
        body = asset.body(shapes[i])
        assert isinstance(body, Body)
        ours, joints = ours_posed(body, rotations[i : i + 1])
        assert worst(ours, vertices[i : i + 1, asset.anny_vertices]) < 3e-3
        assert worst(joints[:, mask], heads[i : i + 1, JOINT_BONES[mask]]) < 3e-3


def test_sampled_adults_have_equal_hands(model):
    phenotypes, changes = random_adults(model, 3, np.random.default_rng(0))
    assert set(changes) == set(arm_local_changes(model))
    for name, values in changes.items():
        if name.startswith("l-"):
            np.testing.assert_array_equal(values, changes["r-" + name[2:]])
    assert phenotypes["age"].min() >= 0.62


def test_basis_reproduces_what_it_was_fitted_to():
    rng = np.random.default_rng(0)
    average = rng.normal(size=(50, 3))
    directions = rng.normal(size=(6, 50, 3)) * 0.01
    samples = average + np.einsum("nk,kpc->npc", rng.normal(size=(80, 6)), directions)
    basis, coefficients = fit_shape_basis(average, samples, tolerance_m=1e-9, max_rank=20)
    assert len(basis) == 6
    np.testing.assert_allclose(average + np.einsum("nk,kpc->npc", coefficients, basis), samples, atol=1e-9)
    np.testing.assert_allclose((coefficients**2).mean(0), 1, rtol=1e-6)


def test_shape_vector_has_its_origin_between_the_eyes():
    from twohands.synth.scene.bake import Region

    region = Region(np.array([0]), np.array([0]), np.zeros((2, 5), int), np.array([1, 2]))
    vertices = np.array([[[0.0, -1.0, 0.0]]])
    heads = np.array([[[0.0, 0.0, 1.0], [0.03, 0.0, 0.0], [-0.03, 0.0, 0.0]]])
    out = shape_vector(region, vertices, heads)[0]
    # Anny faces -y with z up: one metre ahead is +z of the camera, one metre up is -y.
    np.testing.assert_allclose(out, [[0, 0, 1], [0, -1, 0]], atol=1e-12)


def test_missing_anny_names_the_extra(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "anny", None)
    with pytest.raises(MissingExtraError, match="synth-bake"):
        load_anny()
