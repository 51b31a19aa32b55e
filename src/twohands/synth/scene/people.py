"""Whole people: shape, rig and what can be worn, of the packaged asset (`twohands.synth.scene.people_bake`).

Frame: between the eyes of a person at rest who looks straight ahead (x right, y down, z forward, metres), as in
`twohands.synth.scene.body`. Every bone rotates about its head, in the axes of this frame at rest, relative to its
parent. The highest bone of the spine, where neck and shoulders begin, stays where it is: bending the spine moves the
pelvis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from twohands.errors import DataFormatError
from twohands.synth.scene.body import BONE_NAMES, JOINT_BONES, Body, each_moved, load_asset
from twohands.synth.scene.things import joined

ASSET: Final = Path(__file__).parent / "assets" / "people.npz"
N_INFLUENCES: Final = 8
HEAD_CENTRE: Final = np.array([0.0, -0.03, -0.09])
HEAD_RADIUS_M: Final = 0.085
CAP_VERTICES: Final = 260
"""Parts of a hair's mesh with at least so many vertices lie on the head; smaller ones are cards."""
TIED: Final = ("ponytail", "braid")
EYE_PARTS: Final = ("helper-l-eye", "helper-r-eye")

_SPINE: Final = ("root", "spine05", "spine04", "spine03", "spine02", "spine01", "neck01", "neck02", "neck03", "head")
_LEG: Final = ("pelvis", "upperleg01", "upperleg02", "lowerleg01", "lowerleg02", "foot")
BODY_BONES: Final = (
    *_SPINE,
    "eye.L",
    "eye.R",
    *(f"{name}.{letter}" for letter in "LR" for name in ("clavicle", "shoulder01")),
    *(f"{name}.{letter}" for letter in "LR" for name in _LEG),
)
"""Bones beside the arms', parents first; spine05 is the lowest of the back."""
ANCHOR: Final = BODY_BONES.index("spine01")


def _parent(name: str) -> int:
    stem, _, letter = name.partition(".")
    if name in _SPINE:
        return _SPINE.index(name) - 1
    chain = {"eye": ("head",), "clavicle": ("spine01",), "shoulder01": (f"clavicle.{letter}",), "pelvis": ("root",)}
    if stem in chain:
        return BODY_BONES.index(chain[stem][0])
    return BODY_BONES.index(f"{_LEG[_LEG.index(stem) - 1]}.{letter}")


BODY_PARENTS: Final = tuple(_parent(name) for name in BODY_BONES)
N_BONES: Final = len(BODY_BONES) + len(BONE_NAMES)
"""Bones of the whole person: BODY_BONES, then BONE_NAMES."""


def body_bone(name: str) -> int:
    """Index into BODY_BONES, for example `body_bone("upperleg01.L")`."""
    return BODY_BONES.index(name)


@dataclass(frozen=True, slots=True, eq=False)
class Worn:
    """A mesh bound to the body (`garments.Garment`), in the asset's frame and metres.

    Attributes:
        bind, weight: (V, 3) rows of the body's points and their weights.
        offset: (V, 3) of the reference body.
        scale, reference: (3, 2) rows whose distance along each axis, divided by (3,), scales the offset; 0 for none.
        uv: (V, 2).
        faces: (F, 3) counter-clockwise from outside.
        hidden: (N,) bool, the body's points that lie under it.
        zone: (V,) which fabric (`garments.zones`); zeros for all but outfits.
        open: (V,) share of the light from all around that reaches it, at rest.
        first, same: one vertex of every place (P,), and the place of every vertex (V,): vertices are split at seams.
    """

    bind: np.ndarray
    weight: np.ndarray
    offset: np.ndarray
    scale: np.ndarray
    reference: np.ndarray
    uv: np.ndarray
    faces: np.ndarray
    hidden: np.ndarray
    zone: np.ndarray
    open: np.ndarray
    first: np.ndarray
    same: np.ndarray

    def fitted(self, points: np.ndarray) -> np.ndarray:
        """(V, 3) the mesh on a body at rest (N, 3)."""
        spans = np.abs(points[self.scale[:, 0]] - points[self.scale[:, 1]]).diagonal()
        scale = np.where(self.reference > 0, spans / np.maximum(self.reference, 1e-9), 1.0)
        return np.einsum("vk,vkc->vc", self.weight, points[self.bind]) + self.offset * scale

    def follows(self, weights: np.ndarray) -> np.ndarray:
        """(V, J) skinning weights, mixed from the body's (N, J) as places are."""
        mixed = np.einsum("vk,vkj->vj", np.abs(self.weight), weights[self.bind])
        return mixed / mixed.sum(1, keepdims=True)


@dataclass(frozen=True, eq=False)
class PeopleAsset:
    """Contents of the packaged asset.

    Attributes:
        average: (N + 76, 3) float64, the average adult: the body's points (skin, eyes and helper geometry that clothes
            are bound to), then the heads of BODY_BONES and BONE_NAMES.
        basis: (K, N + 76, 3) float32, shape directions for coefficients of unit variance.
        coefficients: (P, K) of sampled adults; traits: (P, 9) see `people_bake.TRAITS`.
        weights: (N, 76) float32 skinning weights.
        arm_rows: (V,) the points that are the vertices of the arms' asset.
        skin_source, skin_uv, skin_faces: the skin and eyes as drawn: points (S,), map (S, 2), triangles (F, 3).
        is_eye: (2, N) bool, points of the left and right eyeball.
        open: (N,) share of the light from all around that reaches the bare skin at rest.
        worn: by name, for example `outfit/male_casualsuit03`.
        pictures: files of the maps by name.
    """

    average: np.ndarray
    basis: np.ndarray
    coefficients: np.ndarray
    traits: np.ndarray
    weights: np.ndarray
    arm_rows: np.ndarray
    skin_source: np.ndarray
    skin_uv: np.ndarray
    skin_faces: np.ndarray
    is_eye: np.ndarray
    open: np.ndarray
    worn: Mapping[str, Worn]
    pictures: Mapping[str, np.ndarray]

    @property
    def n_points(self) -> int:
        """N."""
        return len(self.weights)

    @cached_property
    def _shaped(self) -> dict[tuple[float, ...], np.ndarray]:
        return {}

    def points(self, shape: np.ndarray) -> np.ndarray:
        """(N + 76, 3) a person at rest, of coefficients (k,), k <= K: points, then bone heads; read-only."""
        key = tuple(np.asarray(shape, float).tolist())
        if key not in self._shaped:
            while len(self._shaped) >= 16:
                del self._shaped[next(iter(self._shaped))]
            points = self.average + np.tensordot(np.asarray(shape, np.float32), self.basis[: len(shape)], axes=1)
            points = points - points[[self.n_points + body_bone(f"eye.{letter}") for letter in "LR"]].mean(0)
            points.flags.writeable = False
            self._shaped[key] = points
        return self._shaped[key]

    def heads(self, shape: np.ndarray) -> np.ndarray:
        """(28, 3) heads of BODY_BONES at rest."""
        return self.points(shape)[self.n_points : self.n_points + len(BODY_BONES)]

    def arms_body(self, shape: np.ndarray) -> Body:
        """The arms of the person, for anatomy, collision and joints."""
        points, asset = self.points(shape), load_asset()
        vertices, heads = points[self.arm_rows], points[self.n_points + len(BODY_BONES) :]
        last = heads[JOINT_BONES[:, [4, 8, 12, 16, 20]]]
        return Body(vertices, heads, vertices[asset.tip_vertices] * 0.9 + last * 0.1, asset)

    def strands(self, name: str) -> np.ndarray:
        """(V, 4) how the strands of a hair run, see `strands_of`; kept."""
        kept = self._strands
        if name not in kept:
            worn = self.worn[f"hair/{name}"]
            kept[name] = strands_of(worn, worn.fitted(self.average[: self.n_points]), tied=name.startswith(TIED))
        return kept[name]

    @cached_property
    def _strands(self) -> dict[str, np.ndarray]:
        return {}

    def picture(self, name: str) -> np.ndarray:
        """(H, W, 3 or 4) uint8, a map, RGB or RGBA."""
        decoded = np.asarray(cv2.imdecode(self.pictures[name], cv2.IMREAD_UNCHANGED))
        return cv2.cvtColor(decoded, cv2.COLOR_BGRA2RGBA if decoded.shape[2] == 4 else cv2.COLOR_BGR2RGB)

    def names(self, kind: str) -> tuple[str, ...]:
        """Names of all that is worn of a kind: outfit, shoes, hat, hair, brow, lash."""
        return tuple(sorted(name.split("/")[1] for name in self.worn if name.startswith(f"{kind}/")))


def strands_of(hair: Worn, place: np.ndarray, *, tied: bool) -> np.ndarray:
    """How strands run over a hair's mesh, whose vertices lie at `place` (V, 3).

    Cards run along their map's longer side. Caps run from the crown down, or where hair is tied from the face to the
    knot, on meridians about that place.

    Returns:
        (V, 4): place across the strands in metres; along them, 0 at the root, 1 at the tip; 0 at the edge of the mesh,
        1 within; 1 on a card, 0 on a cap.
    """
    island = joined(len(place), hair.faces)
    source = hair.same[hair.faces]
    edges = np.sort(np.concatenate([source[:, [0, 1]], source[:, [1, 2]], source[:, [2, 0]]]), axis=1)
    unique, times = np.unique(edges, axis=0, return_counts=True)
    inside = ~np.isin(hair.same, unique[times == 1])
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]]) if tied else np.eye(3)
    around = (place - HEAD_CENTRE) @ turn.T  # y away from the pole, z away from the seam
    across = np.arctan2(around[:, 0], around[:, 2]) * HEAD_RADIUS_M
    pole = np.arctan2(np.hypot(around[:, 0], around[:, 2]), -around[:, 1])
    out = np.stack([across, pole / np.pi, inside, np.zeros(len(place))], axis=1)
    for number, size in enumerate(np.bincount(island)):
        if size >= CAP_VERTICES:
            continue
        own = np.flatnonzero(island == number)
        at, uv = place[own] - place[own].mean(0), hair.uv[own] - hair.uv[own].mean(0)
        # The long way of a card is measured on the head, not on its map.
        per_uv = np.linalg.lstsq(uv, at, rcond=None)[0]
        length = np.linalg.norm(per_uv, axis=1) * np.ptp(uv, axis=0)
        long = int(length.argmax())
        along = (uv[:, long] - uv[:, long].min()) / max(float(np.ptp(uv[:, long])), 1e-6)
        if per_uv[long, 1] < 0:
            along = 1 - along
        sideways = uv[:, 1 - long] / max(float(np.ptp(uv[:, 1 - long])), 1e-6) * length[1 - long]
        out[own] = np.stack([sideways + 0.037 * number, along, inside[own], np.ones(len(own))], axis=1)
    return out


@lru_cache(maxsize=1)
def load_people(path: Path = ASSET) -> PeopleAsset:
    """Reads the packaged asset, once per process.

    Raises:
        DataFormatError: the file is missing or damaged.
    """
    try:
        with np.load(path) as data:
            raw = {key: data[key] for key in data.files}
        return _parsed(raw)
    except (OSError, ValueError, KeyError) as error:
        raise DataFormatError(f"people's asset {path.name} is missing or damaged: reinstall twohands") from error


def _parsed(raw: dict[str, np.ndarray]) -> PeopleAsset:
    n = len(raw["weight"])
    weights = np.zeros((n, N_BONES), np.float32)
    np.put_along_axis(weights, raw["weight_index"].astype(np.int64), raw["weight"].astype(np.float32), axis=1)
    weights /= weights.sum(1, keepdims=True)
    names = sorted({"/".join(key.split("/")[:2]) for key in raw if key.endswith("/bind")})
    axes = np.array([-1.0, -1.0, 1.0])  # from the base mesh's axes to the frame between the eyes

    def worn(name: str) -> Worn:
        part = {key: raw[f"{name}/{key}"] for key in ("bind", "weight", "offset", "scale", "reference", "uv", "faces")}
        count = len(part["bind"])
        weight = part["weight"].astype(np.float64)
        binding = np.column_stack([part["bind"], part["weight"], part["offset"]])
        _, first, same = np.unique(binding, axis=0, return_index=True, return_inverse=True)
        return Worn(
            part["bind"].astype(np.int64),
            weight / weight.sum(1, keepdims=True),
            part["offset"] * axes,
            part["scale"].astype(np.int64),
            part["reference"].astype(np.float64),
            part["uv"].astype(np.float32),
            part["faces"].astype(np.int64),
            np.unpackbits(raw[f"{name}/hidden"], count=n).astype(bool),
            raw.get(f"{name}/zone", np.zeros(count, np.uint8)),
            raw.get(f"{name}/open", np.full(count, 255, np.uint8)) / 255.0,
            first,
            same.reshape(-1),
        )

    return PeopleAsset(
        average=raw["average"].astype(np.float64),
        basis=raw["basis"].astype(np.float32),
        coefficients=raw["coefficients"].astype(np.float64),
        traits=raw["traits"].astype(np.float64),
        weights=weights,
        arm_rows=raw["arm_rows"].astype(np.int64),
        skin_source=raw["skin_source"].astype(np.int64),
        skin_uv=raw["skin_uv"],
        skin_faces=raw["skin_faces"].astype(np.int64),
        is_eye=raw["eye_rows"],
        open=raw["open"] / 255.0,
        worn={name: worn(name) for name in names},
        pictures={key[4:]: value for key, value in raw.items() if key.startswith("map/")},
    )


def body_transforms(heads: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """Poses the body's bones.

    Args:
        heads: (28, 3) of BODY_BONES at rest (`PeopleAsset.heads`).
        rotations: (28, 3, 3) rotation of every bone about its head, in the axes of the rest pose, relative to its
            parent.

    Returns:
        (28, 3, 4) rigid transforms from rest to posed space, frame between the eyes; the identity for spine01.
    """
    out = np.zeros((len(BODY_BONES), 3, 4))
    for index, parent in enumerate(BODY_PARENTS):
        own = np.concatenate([rotations[index], (heads[index] - rotations[index] @ heads[index])[:, None]], axis=1)
        out[index] = own if parent < 0 else after(out[parent], own)
    anchor = out[ANCHOR]
    back = np.concatenate([anchor[:, :3].T, -(anchor[:, :3].T @ anchor[:, 3])[:, None]], axis=1)
    return np.stack([after(back, transform) for transform in out])


def shoulder_moves(transforms: np.ndarray) -> np.ndarray:
    """(2, 3, 4) how the left and the right shoulder, in which an arm is hung, have moved: what follows
    `body.forward_kinematics` of an arm."""
    return transforms[[body_bone("shoulder01.L"), body_bone("shoulder01.R")]]


def after(outer: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """(..., 3, 4) the rigid transform `outer` after `inner`."""
    turned = outer[..., :3] @ inner
    turned[..., 3] += outer[..., 3]
    return turned


def posed(points: np.ndarray, weights: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """(V, 3) points after linear blend skinning with weights (V, J) and transforms (J, 3, 4)."""
    moves = (weights @ transforms.reshape(len(transforms), 12)).reshape(-1, 3, 4)
    return each_moved(moves, points)
