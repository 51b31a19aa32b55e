"""MakeHuman's clothes, shoes, hats, hair, brows and lashes: their files, and how they are bound to the base mesh.

A garment comes as a mesh (`.obj`) and its binding (`.mhclo`): every vertex lies at a weighted sum of three vertices of
the base mesh plus an offset that grows with the body.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from twohands.errors import DataFormatError
from twohands.synth.scene.things import joined

HAIRS: Final = (
    "afro01", "bob01", "bob02", "braid01", "long01", "ponytail01", "short01", "short02", "short03", "short04",
)  # fmt: skip
OUTFITS: Final = (
    "female_casualsuit01", "female_casualsuit02", "female_elegantsuit01", "female_sportsuit01",
    *(f"male_casualsuit0{i}" for i in range(1, 7)), "male_elegantsuit01", "male_worksuit01",
)  # fmt: skip
SHOES: Final = tuple(f"shoes0{i}" for i in range(1, 7))
BROWS: Final = tuple(f"eyebrow{i:03d}" for i in range(1, 13))
LASHES: Final = ("eyelashes01", "eyelashes04")
HATS: Final = ("fedora", "fedora_cocked")
BOTTOM_BELOW_DM: Final = 1.0
"""Islands of an outfit's map whose middle is lower than this, in the base mesh's decimetres, are trousers or skirts."""


@dataclass(frozen=True, slots=True, eq=False)
class Garment:
    """A mesh bound to the base mesh, its vertices split where its map is.

    Attributes:
        bind: (V, 3) base vertices.
        weight: (V, 3).
        offset: (V, 3) in the base mesh's axes and unit, of the reference body.
        scale: (3, 2) base vertices whose distance along x, y, z scales the offset, and (3,) that of the reference body.
        reference: (3,).
        uv: (V, 2).
        faces: (F, 3) counter-clockwise from outside.
        source: (V,) the vertex of the file.
        hidden: base vertices that lie under it.
    """

    bind: np.ndarray
    weight: np.ndarray
    offset: np.ndarray
    scale: np.ndarray
    reference: np.ndarray
    uv: np.ndarray
    faces: np.ndarray
    source: np.ndarray
    hidden: np.ndarray


def read_mesh(path: Path) -> tuple[np.ndarray, np.ndarray, list[list[tuple[int, int]]]]:
    """A Wavefront file's vertices (V, 3), texture coordinates (T, 2) and faces as lists of (vertex, texture) numbers.

    Raises:
        DataFormatError: it holds no faces.
    """
    vertices, textures, faces = [], [], []
    for line in path.read_text().splitlines():
        kind, *rest = line.split() or [""]
        if kind == "v":
            vertices.append([float(value) for value in rest[:3]])
        elif kind == "vt":
            textures.append([float(value) for value in rest[:2]])
        elif kind == "f":
            corners = [corner.split("/") for corner in rest]
            faces.append([(int(c[0]) - 1, int(c[1]) - 1 if len(c) > 1 and c[1] else 0) for c in corners])
    if not faces:
        raise DataFormatError(f"{path}: no faces")
    return np.array(vertices), np.array(textures or [[0.0, 0.0]]), faces


def read_binding(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A `.mhclo` file: base vertices (V, 3), weights (V, 3), offsets (V, 3), scale vertices (3, 2), their distances
    (3,) in the reference body, and the base vertices (N,) that the garment hides.

    Raises:
        DataFormatError: a line cannot be understood.
    """
    bind, weight, offset, hidden = [], [], [], []
    scale, reference = np.zeros((3, 2), int), np.ones(3)
    part = ""
    for line in path.read_text(errors="replace").splitlines():
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if words[0] in ("x_scale", "y_scale", "z_scale"):
            axis = "xyz".index(words[0][0])
            scale[axis], reference[axis] = [int(word) for word in words[1:3]], float(words[3])
        elif words[0] in ("verts", "delete_verts"):
            part = words[0]
        elif part == "verts" and words[0].lstrip("-").isdigit():
            try:
                if len(words) == 1:
                    bind.append([int(words[0])] * 3)
                    weight.append([1.0, 0.0, 0.0])
                    offset.append([0.0, 0.0, 0.0])
                else:
                    bind.append([int(word) for word in words[:3]])
                    weight.append([float(word) for word in words[3:6]])
                    offset.append([float(word) for word in words[6:9]])
            except ValueError as error:
                raise DataFormatError(f"{path}: {line!r} binds no vertex") from error
        elif part == "delete_verts":
            hidden += _ranges(words)
    return (
        np.array(bind), np.array(weight), np.array(offset), scale, reference, np.unique(np.array(hidden, int)),
    )  # fmt: skip


def _ranges(words: list[str]) -> list[int]:
    """Numbers of a list such as `3 5 - 7 9`."""
    out: list[int] = []
    for i, word in enumerate(words):
        if word == "-":
            out += range(int(words[i - 1]) + 1, int(words[i + 1]))
        else:
            out.append(int(word))
    return out


def read_garment(binding: Path, mesh: Path) -> Garment:
    """Mesh and binding together.

    Raises:
        DataFormatError: they do not belong together.
    """
    bind, weight, offset, scale, reference, hidden = read_binding(binding)
    vertices, textures, faces = read_mesh(mesh)
    if len(vertices) != len(bind):
        raise DataFormatError(f"{binding}: {len(bind)} bound vertices, {len(vertices)} in {mesh.name}")
    triangles = np.array([[face[0], face[i], face[i + 1]] for face in faces for i in range(1, len(face) - 1)])
    corners, index = np.unique(triangles.reshape(-1, 2), axis=0, return_inverse=True)
    source = corners[:, 0]
    return Garment(
        bind[source], weight[source], offset[source], scale, reference, textures[corners[:, 1]],
        index.reshape(-1, 3), source, hidden,
    )  # fmt: skip


def zones(garment: Garment, base_dm: np.ndarray) -> np.ndarray:
    """(V,) which of the outfit's fabrics a vertex has: 0 top, 1 bottom, 2 what is worn over or set off against the top,
    3 buttons, buckles and other small things."""
    place = worn_on(garment, base_dm)
    island = joined(len(garment.uv), garment.faces)
    whole = joined(int(garment.source.max()) + 1, garment.source[garment.faces])[garment.source]
    zone = np.zeros(len(garment.uv), int)
    for number in range(island.max() + 1):
        zone[island == number] = place[island == number, 1].mean() < BOTTOM_BELOW_DM
    tops = [n for n in range(whole.max() + 1) if (zone[whole == n] == 0).mean() > 0.5 and (whole == n).any()]
    largest = max(tops, key=lambda n: int((whole == n).sum()), default=-1)
    for number in range(whole.max() + 1):
        own = whole == number
        size = np.ptp(place[own], axis=0).max() if own.any() else 0.0
        if own.any() and size < 0.35:
            zone[own] = 3
        elif number in tops and number != largest:
            zone[own] = 2
    return zone


def metric_uv(garment: Garment, base_dm: np.ndarray) -> np.ndarray:
    """(V, 2) the map's coordinates, every island in metres on the body."""
    place = worn_on(garment, base_dm) / 10
    island = joined(len(garment.uv), garment.faces)
    a, b, c = (place[garment.faces[:, i]] for i in range(3))
    p, q, r = (garment.uv[garment.faces[:, i]] for i in range(3))
    true = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    u, v = q - p, r - p
    mapped = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    of = island[garment.faces[:, 0]]
    size = np.bincount(of, true, island.max() + 1) / np.maximum(np.bincount(of, mapped, island.max() + 1), 1e-12)
    return garment.uv * np.sqrt(size)[island][:, None]


def worn_on(garment: Garment, base: np.ndarray) -> np.ndarray:
    """(V, 3) the garment on a base mesh (N, 3), in its axes and unit."""
    a, b = base[garment.scale[:, 0]], base[garment.scale[:, 1]]
    scale = np.where((garment.scale == 0).all(1), 1.0, np.abs(np.diagonal(a - b)) / garment.reference)
    return np.einsum("vk,vkc->vc", garment.weight, base[garment.bind]) + garment.offset * scale


def read_all(source: Path) -> dict[str, Garment]:
    """Everything that is worn or grows, by its name in the asset."""
    out = {}

    def read(kind: str, names: Iterable[str], folder: str, sub: str | None = None) -> None:
        for name in names:
            place = source / folder / (sub or name)
            mesh = next(iter(sorted(place.glob(f"{name}.obj"))), None) or next(iter(sorted(place.glob("*.obj"))))
            out[f"{kind}/{name}"] = read_garment(place / f"{name}.mhclo", mesh)

    read("outfit", OUTFITS, "clothes")
    read("shoes", SHOES, "clothes")
    read("hat", HATS, "clothes", "fedora01")
    read("hair", HAIRS, "hair")
    read("brow", BROWS, "eyebrows")
    read("lash", LASHES, "eyelashes")
    return out
