"""Meshes of things: closed where they should be, and right side out."""

import numpy as np
import pytest

from twohands.synth.scene import props
from twohands.synth.scene.prop_meshes import slab

RNG = np.random.default_rng
MESHES = {
    "mug": lambda rng: props.mug(rng, 0.04),
    "bottle": lambda rng: props.bottle(rng, 0.03),
    "stick": lambda rng: props.stick(rng, 0.005, 0.07),
    "plate": lambda rng: props.plate(rng, 0.12),
    "phone": props.phone,
    "tablet": lambda rng: props.tablet(rng, 0.2, 0.25),
    "book": lambda rng: props.book(rng, 0.3, 0.2),
    "table": lambda rng: props.table_top(rng, 1.2, 0.7),
}


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("seed", range(4))
def test_faces_and_normals_agree_and_look_outwards(name, seed):
    """Every triangle turns counter-clockwise about its normals, and the mesh encloses a positive volume."""
    mesh = MESHES[name](RNG(seed))
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    turned = np.cross(b - a, c - a)
    real = np.linalg.norm(turned, axis=1) > 1e-10
    facing = (turned * mesh.normals[mesh.faces].mean(1)).sum(1)[real]
    assert (facing > 0).mean() > 0.9
    assert (a * np.cross(b, c)).sum() / 6 > 0
    assert mesh.colours.shape == mesh.vertices.shape and mesh.colours.min() >= 0 and mesh.colours.max() <= 1


def test_a_slab_is_as_large_as_asked():
    mesh = slab((0.2, 0.3, 0.01), 0.02, np.full((4, 4, 3), 0.5), np.zeros(3), 0.5)
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), [0.2, 0.3, 0.01])
    corner = np.abs(mesh.vertices[:, :2]) - [0.08, 0.13]
    assert (np.hypot(*corner[(corner > 0).all(1)].T) <= 0.02 + 1e-9).all()


def test_placing_moves_and_turns():
    thing = props.phone(RNG(0)).placed(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([1.0, 2, 3]))
    assert np.ptp(thing.vertices[:, 0]) > np.ptp(thing.vertices[:, 1])
    np.testing.assert_allclose(thing.vertices.mean(0), [1, 2, 3], atol=0.02)
