from pathlib import Path

import numpy as np
import pytest

from twohands.errors import DataFormatError
from twohands.synth.scene.garments import metric_uv, read_binding, read_garment, read_mesh
from twohands.synth.scene.people_bake import fit_basis, openness, samples_of
from twohands.synth.scene.things import joined

BINDING = """# a comment
basemesh hm08
x_scale 4 5 2.0
z_depth 50
verts 0
material cloth.mhmat
0 1 2 0.5 0.25 0.25 1.0 0.0 0.5
1 2 3 1.0 0.0 0.0 0.0 1.0 0.0
3
2 3 0 0.2 0.3 0.5 0.0 0.0 0.0
delete_verts
1 3 - 5 9
"""
MESH = """v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 2 0
vt 2 2
vt 0 2
f 1/1 2/2 3/3 4/4
"""


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    (tmp_path / "cloth.mhclo").write_text(BINDING)
    (tmp_path / "cloth.obj").write_text(MESH)
    return tmp_path / "cloth.mhclo", tmp_path / "cloth.obj"


def test_a_binding_is_read_line_by_line(files):
    bind, weight, offset, scale, reference, hidden = read_binding(files[0])
    np.testing.assert_array_equal(bind, [[0, 1, 2], [1, 2, 3], [3, 3, 3], [2, 3, 0]])
    np.testing.assert_array_equal(weight[2], [1, 0, 0])  # a line of one number: that vertex itself
    np.testing.assert_array_equal(offset[0], [1, 0, 0.5])
    np.testing.assert_array_equal(scale, [[4, 5], [0, 0], [0, 0]])
    np.testing.assert_array_equal(reference, [2, 1, 1])
    np.testing.assert_array_equal(hidden, [1, 3, 4, 5, 9])


def test_faces_become_triangles_that_share_corners(files):
    garment = read_garment(*files)
    np.testing.assert_array_equal(garment.source[garment.faces], [[0, 1, 2], [0, 2, 3]])
    np.testing.assert_array_equal(garment.uv[garment.faces[0]], [[0, 0], [2, 0], [2, 2]])
    assert len(read_mesh(files[1])[2]) == 1


def test_a_binding_of_another_mesh_is_refused(files):
    files[1].write_text(MESH.replace("v 0 1 0\n", "v 0 1 0\nv 2 2 0\n"))
    with pytest.raises(DataFormatError, match="4 bound vertices, 5 in"):
        read_garment(*files)
    files[1].write_text("v 0 0 0\n")
    with pytest.raises(DataFormatError, match="no faces"):
        read_mesh(files[1])


def test_maps_are_measured_on_the_body(files):
    garment = read_garment(*files)
    base = np.zeros((6, 3))
    base[:4] = [[0, 0, 0], [3, 0, 0], [3, 3, 0], [0, 3, 0]]  # decimetres
    plain = type(garment)(
        np.repeat(garment.source[:, None], 3, 1), np.tile([1.0, 0, 0], (4, 1)), np.zeros((4, 3)), np.zeros((3, 2), int),
        np.ones(3), garment.uv, garment.faces, garment.source, garment.hidden,
    )  # fmt: skip
    np.testing.assert_allclose(np.ptp(metric_uv(plain, base), axis=0), 0.3)


def test_parts_that_share_a_corner_are_joined():
    np.testing.assert_array_equal(joined(7, np.array([[0, 1, 2], [2, 3, 0], [4, 5, 6]])), [0, 0, 0, 0, 1, 1, 1])


def test_samples_leave_no_gap():
    triangle = np.array([[0.0, 0, 0], [0.05, 0, 0], [0, 0.05, 0]])
    samples = samples_of(triangle, np.array([[0, 1, 2]]))
    inside = np.random.default_rng(0).dirichlet([1, 1, 1], 200) @ triangle
    assert np.linalg.norm(inside[:, None] - samples, axis=-1).min(1).max() < 0.004


def test_a_roof_hides_the_sky_and_open_ground_sees_all_of_it():
    ground, up = np.zeros((1, 3)), np.array([[0.0, 0, 1]])
    corners = np.array([[-1.0, -1, 0.1], [1, -1, 0.1], [1, 1, 0.1], [-1, 1, 0.1]])
    x, y = np.meshgrid(np.arange(-0.3, 0.3, 0.004), np.arange(-0.3, 0.3, 0.004))
    roof = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.05)])
    assert openness(ground, up, corners - np.array([0, 0, 5.0]))[0] == pytest.approx(1)
    assert openness(ground, up, roof)[0] < 0.12
    half = openness(ground, up, roof[roof[:, 0] > 0])[0]
    assert 0.4 < half < 0.65


def test_a_basis_of_full_rank_gives_the_samples_back():
    rng = np.random.default_rng(1)
    average, directions = rng.normal(size=(5, 3)), rng.normal(size=(4, 5, 3))
    samples = average + np.einsum("nk,kpc->npc", rng.normal(size=(30, 4)), directions)
    basis, coefficients = fit_basis(average, samples, rng.uniform(1, 5, 5), 4)
    np.testing.assert_allclose(average + np.einsum("nk,kpc->npc", coefficients, basis), samples, atol=1e-9)
    np.testing.assert_allclose((coefficients**2).mean(0), 1)
