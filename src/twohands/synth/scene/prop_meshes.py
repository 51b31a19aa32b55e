"""Shapes that props are made of: turned ones, tubes and slabs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from twohands.synth.scene.pose import unit
from twohands.synth.scene.things import NO_LABEL, Thing, grid_faces, vertex_normals

_CORNERS: Final = 5
"""Vertices along the rounding of a slab's corner."""


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A coloured surface.

    Attributes:
        vertices, normals: (V, 3).
        faces: (F, 3) int32, counter-clockwise from outside.
        colours: (V, 3) linear RGB albedo.
        roughness: 0.1 (polished) to 0.9.
    """

    vertices: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    colours: np.ndarray
    roughness: float

    def placed(self, frame: np.ndarray, origin: np.ndarray) -> Thing:
        """The thing with its axes along the columns of `frame` (3, 3) and its origin at `origin` (3,)."""
        vertices, normals = self.vertices @ frame.T + origin, self.normals @ frame.T
        place = np.zeros(len(vertices))
        mean = self.colours.mean(0)
        return Thing(
            vertices, normals, self.faces, mean, mean, 0.0, place, self.roughness, NO_LABEL, colours=self.colours
        )


def merged(*meshes: Mesh) -> Mesh:
    """Several meshes as one, of the first one's roughness."""
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, first, strict=False)]).astype(np.int32),
        np.concatenate([mesh.colours for mesh in meshes]),
        meshes[0].roughness,
    )


def lathed(profile: list[tuple[float, float]], colours: np.ndarray, roughness: float, columns: int = 28) -> Mesh:
    """A surface of revolution about z.

    Args:
        profile: radius and height of its rings, so that the outside lies to the right of the way.
        colours: (3,) or one (3,) per ring.
        roughness: of the surface.
        columns: vertices around.
    """
    rings = np.array(profile)
    angle = np.linspace(0, 2 * np.pi, columns, endpoint=False)
    around = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    vertices = np.concatenate(
        [rings[:, None, :1] * around, np.broadcast_to(rings[:, None, 1:], (len(rings), columns, 1))], axis=-1
    ).reshape(-1, 3)
    faces = grid_faces(len(rings), columns)
    painted = np.repeat(np.broadcast_to(colours, (len(rings), 3)), columns, axis=0)
    return Mesh(vertices, vertex_normals(vertices, faces), faces, painted, roughness)


def tube(path: np.ndarray, radius: float, colour: np.ndarray, roughness: float, columns: int = 8) -> Mesh:
    """A round tube along a path (N, 3) in the plane x-z, its ends open."""
    along = unit(np.gradient(path, axis=0))
    side = np.broadcast_to([0.0, 1.0, 0.0], path.shape)
    out = np.cross(side, along)
    angle = np.linspace(0, 2 * np.pi, columns, endpoint=False)[None, :, None]
    normals = np.cos(angle) * out[:, None] + np.sin(angle) * side[:, None]
    vertices = path[:, None] + radius * normals
    faces = grid_faces(len(path), columns)
    # Outside is where the triangles turn counter-clockwise.
    first = vertices.reshape(-1, 3)[faces[0]]
    if np.cross(first[1] - first[0], first[2] - first[0]) @ normals.reshape(-1, 3)[faces[0, 0]] < 0:
        faces = faces[:, ::-1]
    painted = np.tile(colour, (len(path) * columns, 1))
    return Mesh(vertices.reshape(-1, 3), normals.reshape(-1, 3), faces.astype(np.int32), painted, roughness)


def slab(
    size: tuple[float, float, float], rounding: float, front: np.ndarray, other: np.ndarray, roughness: float
) -> Mesh:
    """A flat box with rounded corners about the origin, its front towards +z.

    Args:
        size: (3,) along x, y and z.
        rounding: radius of the corners seen from the front.
        front: (rows, columns, 3) colours of the front, the first row at -y.
        other: (3,) colour of back and edges.
        roughness: of the surface.
    """
    half, rows, columns = np.array(size) / 2, front.shape[0], front.shape[1]
    x, y = np.meshgrid(np.linspace(-1, 1, columns), np.linspace(-1, 1, rows))
    flat = _rounded(np.stack([x, y], axis=-1).reshape(-1, 2) * half[:2], half[:2], rounding)
    row, column = np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij")
    a = (row * columns + column).ravel()
    quads = np.concatenate([np.stack([a, a + 1, a + columns + 1], 1), np.stack([a, a + columns + 1, a + columns], 1)])
    top = Mesh(_at(flat, half[2]), np.tile([0.0, 0, 1], (len(flat), 1)), quads, front.reshape(-1, 3), roughness)
    turn = np.linspace(0, np.pi / 2, _CORNERS)
    corner = np.stack([np.cos(turn), np.sin(turn)], 1)
    inner = np.maximum(half[:2] - rounding, 0)
    ring, outward = [], []
    for sx, sy, flip in ((1, 1, 1), (-1, 1, -1), (-1, -1, 1), (1, -1, -1)):
        arc = corner[::flip] * [sx, sy]
        ring.append(arc * rounding + inner * [sx, sy])
        outward.append(arc)
    outline, outward = np.concatenate(ring), np.concatenate(outward)
    n = len(outline)
    sides = np.concatenate([_at(outline, -half[2]), _at(outline, half[2])])
    next_ = (np.arange(n) + 1) % n
    i = np.arange(n)
    faces = np.concatenate([np.stack([i, next_, next_ + n], 1), np.stack([i, next_ + n, i + n], 1)])
    wall = Mesh(sides, np.tile(np.c_[outward, np.zeros(n)], (2, 1)), faces, np.tile(other, (2 * n, 1)), roughness)
    fan = np.stack([np.zeros(n - 2, int), i[2:], i[1:-1]], 1)
    back = Mesh(_at(outline, -half[2]), np.tile([0.0, 0, -1], (n, 1)), fan, np.tile(other, (n, 1)), roughness)
    return merged(top, wall, back)


def _at(flat: np.ndarray, height: float) -> np.ndarray:
    return np.c_[flat, np.full(len(flat), height)]


def _rounded(points: np.ndarray, half: np.ndarray, rounding: float) -> np.ndarray:
    """Points (N, 2) of a rectangle, those beyond its rounded corners drawn in."""
    inner = np.maximum(half - rounding, 0)
    beyond = np.maximum(np.abs(points) - inner, 0)
    length = np.linalg.norm(beyond, axis=1, keepdims=True)
    beyond = np.where(length > rounding, beyond * rounding / np.maximum(length, 1e-9), beyond)
    return np.sign(points) * (np.minimum(np.abs(points), inner) + beyond)
