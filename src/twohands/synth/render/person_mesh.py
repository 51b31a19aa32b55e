"""A dressed person as one mesh at rest: skin, eyes, clothes, hair, glasses and lanyard, with what the shaders need."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from twohands.synth.render.surface import surface
from twohands.synth.scene.body import BONE_NAMES, load_asset, part_labels
from twohands.synth.scene.looks import ZONES, PersonLook
from twohands.synth.scene.people import BODY_BONES, N_BONES, Worn, load_people
from twohands.synth.scene.things import NO_LABEL, vertex_normals

PARTS: Final = ("skin", "eyes", "cloth", "hair", "brow")
LANYARD, GLASSES, HAT, BADGE = range(ZONES, ZONES + 4)
UNCUT: Final = 9.0
"""Place along the arm of what no sleeve's end cuts off."""
SKIN_UNDER_M: Final = 0.004
"""How far skin is drawn in where cloth covers a part of it."""
UNDER_RIBBON_M, RIBBON_M, RIBBON_ABOVE_M = 0.026, 0.015, 0.005
BROW_RAISED_M: Final = 0.0015
BROW_OF_MAP: Final = "eyebrow011"
"""The brow whose map there is; the others have as many vertices in the same order."""
LENS_AHEAD_M: Final = 0.014
FRAME_RADIUS_M: Final = 0.0016
STRIPE_PER_ARM_M: Final = 0.27
"""Length of forearm and of upper arm, roughly: what one unit of the place along the arm is in metres."""
IRIS_ANGLE: Final = np.radians(28)
IRIS_ON_MAP: Final = 0.187
"""Half the iris, seen from the eyeball's middle, and on its map as a share of the width."""


@dataclass(frozen=True, slots=True, eq=False)
class PersonMesh:
    """A dressed person at rest; V vertices.

    Attributes:
        position, normal: (V, 3) metres, frame between the eyes.
        weight: (V, 76) float32 skinning weights.
        still: (V, 14) float32, what does not change with the pose: uv, traits, more, rest, part, as the shaders have
            them.
        faces: (F, 3) int32.
        first: (6,) first triangle of every one of PARTS, and their number.
    """

    position: np.ndarray
    normal: np.ndarray
    weight: np.ndarray
    still: np.ndarray
    faces: np.ndarray
    first: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class _Anatomy:
    """What the average body tells about the points of all: (N,) each."""

    label: np.ndarray
    palmar: np.ndarray
    along: np.ndarray
    scalp: np.ndarray
    beard: np.ndarray
    moustache: np.ndarray
    face: np.ndarray
    eye: np.ndarray
    flush: np.ndarray


@lru_cache(maxsize=1)
def _anatomy() -> _Anatomy:
    asset = load_people()
    n, points = asset.n_points, asset.average
    arms = load_asset()
    label = np.full(n, float(NO_LABEL))
    label[asset.arm_rows] = part_labels(arms)
    palmar, along = np.zeros(n), np.full(n, 3.0)
    palmar[asset.arm_rows] = surface().palmar
    heads = points[n + len(BODY_BONES) :]
    in_arm = asset.weights[:, len(BODY_BONES) :].reshape(n, 2, -1).sum(2)
    for side in (0, 1):
        shoulder, elbow, wrist = (
            heads[BONE_NAMES.index(f"{name}.{'LR'[side]}")] for name in ("upperarm01", "lowerarm01", "wrist")
        )
        own = in_arm[:, side] > 0.02
        upper, lower = elbow - shoulder, wrist - elbow
        above = 1 - (points[:n] - elbow) @ upper / (upper @ upper)
        below = 1 - (points[:n] - elbow) @ lower / (lower @ lower)
        t = np.where(below < 1, below, np.maximum(above, 1.0))
        along[own] = np.minimum(t, 3.0)[own]
    head = asset.weights[:, BODY_BONES.index("head")] > 0.5
    x, y, z = points[:n].T
    # The hairline: 6.5 cm above the eyes, before the ears, and down to the nape.
    line = np.interp(z, [-0.17, -0.10, -0.075, -0.035, 0.0], [0.045, 0.03, -0.035, -0.052, -0.062])
    line -= 0.012 * np.clip(np.abs(x) / 0.05 - 0.6, 0, 1) * (z > -0.05)
    scalp = (
        (asset.weights[:, [BODY_BONES.index(b) for b in ("head", "neck03")]].sum(1) > 0.3)
        * np.clip((line - y) / 0.016, 0, 1)
        * np.clip((0.075 - np.abs(x)) / 0.006 + 1, 0, 1)
    )
    # Chin, jaw and upper lip: the mouth lies 7 to 8 cm below the eyes, the ears 9 cm behind them.
    jaw = np.clip((y - 0.035 - 0.35 * np.clip(0.0 - z, 0, 0.1)) / 0.012, 0, 1) * np.clip((z + 0.085) / 0.02, 0, 1)
    jaw *= np.clip((0.155 - y + 0.25 * np.minimum(z, 0.0)) / 0.02, 0, 1)
    mouth = np.exp(-((x / 0.026) ** 2) - ((y - 0.078) / 0.0095) ** 2)
    cheek = np.clip((np.hypot(x / 0.030, (y - 0.045) / 0.026) - 0.85) / 0.3, 0, 1)
    lip = np.clip(1.3 - np.hypot(x / 0.032, (y - 0.0625) / 0.0075), 0, 1)
    beard = head * jaw * cheek * np.clip(1 - 1.15 * mouth, 0, 1)
    flush = np.zeros(n)
    flush[asset.arm_rows] = surface().flush
    front = head * (z > -0.05)
    nose = points[:n][front & (np.abs(x) < 0.01) & (y > 0.015) & (y < 0.06)]
    tip = nose[nose[:, 2].argmax()]
    flush += front * 0.9 * np.exp(-(((points[:n] - tip) ** 2).sum(1)) / 0.014**2)
    flush += front * 0.8 * np.exp(-((np.abs(x) - 0.038) ** 2 + (y - 0.043) ** 2) / 0.02**2)
    flush += head * 0.8 * ((np.abs(x) > 0.068) & (y > -0.03) & (y < 0.05) & (z < -0.06) & (z > -0.14))
    eye = np.any(asset.is_eye, axis=0)
    return _Anatomy(label, palmar, along, scalp, beard, head * lip, head.astype(float), eye, np.clip(flush, 0, 1))


class _Builder:
    """Collects the parts of one person's mesh."""

    def __init__(self, points: np.ndarray) -> None:
        self.points = points
        self.rows: list[tuple[np.ndarray, ...]] = []
        self.faces: dict[str, list[np.ndarray]] = {part: [] for part in PARTS}
        self.count = 0

    def add(
        self, part: str, position: np.ndarray, normal: np.ndarray, weight: np.ndarray, uv: np.ndarray,
        traits: np.ndarray, more: np.ndarray, label: np.ndarray, faces: np.ndarray,
    ) -> None:  # fmt: skip
        self.rows.append((position, normal, weight, uv, traits, more, position, label[:, None]))
        self.faces[part].append(faces + self.count)
        self.count += len(position)

    def mesh(self) -> PersonMesh:
        columns = [np.concatenate(column).astype(np.float32) for column in zip(*self.rows, strict=True)]
        position, normal, weight, *still = columns
        faces = [np.concatenate(self.faces[part]) if self.faces[part] else np.zeros((0, 3), int) for part in PARTS]
        first = np.cumsum([0, *(len(part) for part in faces)])
        return PersonMesh(
            position, normal, weight, np.concatenate(still, axis=1), np.concatenate(faces).astype(np.int32), first
        )


def person_mesh(look: PersonLook, shape: np.ndarray, present: tuple[bool, bool] = (True, True)) -> PersonMesh:
    """Dresses a person at rest."""
    asset, anatomy = load_people(), _anatomy()
    n = asset.n_points
    points = asset.points(shape)[:n]
    build = _Builder(points)
    outfit, shoes = asset.worn[f"outfit/{look.outfit}"], asset.worn[f"shoes/{look.shoes}"]
    hidden = outfit.hidden & ~((anatomy.along < look.sleeve_from + 0.12) & (look.sleeve_from > 0)) | shoes.hidden
    _skin(build, points, hidden, anatomy, present)
    _worn(build, outfit, outfit.zone.astype(float), anatomy, cut=True)
    _worn(build, shoes, np.full(len(shoes.bind), float(ZONES - 1)), anatomy)
    if look.hat is not None:
        hat = asset.worn[f"hat/{look.hat}"]
        _worn(build, hat, np.full(len(hat.bind), float(HAT)), anatomy)
    if look.glasses is not None:
        _glasses(build, points, look)
    if look.lanyard is not None:
        _lanyard(build, points, outfit, hidden)
    if look.hair is not None:
        hair = asset.worn[f"hair/{look.hair}"]
        position, normal = _shell(hair, points)
        more = np.column_stack([np.zeros(len(position)), hair.open, np.zeros((len(position), 2))])
        labels = np.full(len(position), float(NO_LABEL))
        build.add(
            "hair",
            position,
            normal,
            hair.follows(asset.weights),
            hair.uv,
            asset.strands(look.hair),
            more,
            labels,
            hair.faces,
        )
    brow = asset.worn[f"brow/{look.brow}"]
    position, normal = _shell(brow, points)
    position = position + BROW_RAISED_M * np.sign(normal[:, 2:]) * normal
    zero, labels = np.zeros((len(position), 4)), np.full(len(position), float(NO_LABEL))
    uv = asset.worn[f"brow/{BROW_OF_MAP}"].uv * [1, -1] + [0, 1]
    build.add("brow", position, normal, brow.follows(asset.weights), uv, zero, zero, labels, brow.faces)
    return build.mesh()


def _skin(
    build: _Builder, points: np.ndarray, hidden: np.ndarray, anatomy: _Anatomy, present: tuple[bool, bool]
) -> None:
    asset = load_people()
    faces = asset.skin_faces
    rows = asset.skin_source
    body_faces = rows[faces]
    normals = np.zeros_like(points)
    normals[:] = vertex_normals(points, body_faces)
    gone = hidden[body_faces].all(1)
    for side in (0, 1):
        if not present[side]:
            own = (anatomy.label >= 1 + 7 * side) & (anatomy.label < 8 + 7 * side)
            gone |= own[body_faces].any(1)
    # Where cloth begins, skin dives under it.
    under = hidden & ~anatomy.eye
    position = points - SKIN_UNDER_M * under[:, None] * normals
    eye_face = anatomy.eye[body_faces].all(1)
    traits = np.column_stack([anatomy.palmar, anatomy.flush, anatomy.scalp, anatomy.beard])
    more = np.column_stack([anatomy.face, asset.open, anatomy.moustache, np.zeros(len(points))])
    for part, chosen in (("skin", ~eye_face & ~gone), ("eyes", eye_face)):
        used = np.unique(faces[chosen])
        place = np.zeros(len(rows), int)
        place[used] = np.arange(len(used))
        own = rows[used]
        trait = traits[own]
        if part == "eyes":
            trait = np.column_stack([normals[own, 1], np.zeros((len(own), 3))])
        uv = asset.skin_uv[used] * [1, -1] + [0, 1]
        if part == "eyes":
            uv = _on_eye(position[own], asset.is_eye[1][own])
        build.add(
            part,
            position[own],
            normals[own],
            asset.weights[own],
            uv,
            trait,
            more[own],
            anatomy.label[own],
            place[faces[chosen]],
        )


def _on_eye(position: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(V, 2) places on the eye's map of vertices of both eyeballs, by the angle to the way they look at rest."""
    uv = np.zeros((len(position), 2))
    for own in (right, ~right):
        low, high = position[own].min(0), position[own].max(0)
        offset = (position[own] - (low + high) / 2) / ((high - low) / 2)
        angle = np.arccos(np.clip(offset[:, 2] / np.linalg.norm(offset, axis=1), -1, 1))
        around = offset[:, :2] / np.maximum(np.linalg.norm(offset[:, :2], axis=1, keepdims=True), 1e-6)
        uv[own] = 0.5 + around * np.minimum(angle / IRIS_ANGLE * IRIS_ON_MAP, 0.47)[:, None]
    return uv


def _shell(worn: Worn, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places and normals (V, 3) of what is worn, smooth across the seams of its map."""
    position = worn.fitted(points)
    normal = vertex_normals(position[worn.first], worn.same[worn.faces])[worn.same]
    return position, normal


def _worn(build: _Builder, worn: Worn, zone: np.ndarray, anatomy: _Anatomy, cut: bool = False) -> None:
    asset = load_people()
    position, normal = _shell(worn, build.points)
    weight = worn.follows(asset.weights)
    along = np.full(len(position), UNCUT)
    label = np.full(len(position), float(NO_LABEL))
    if cut:
        along = np.einsum("vk,vk->v", worn.weight, anatomy.along[worn.bind])
        arms = weight[:, len(BODY_BONES) :].reshape(len(weight), 2, -1).sum(2)
        for side in (0, 1):
            label[arms[:, side] > 0.5] = 1 + 7 * side
    # Stripes run around trunk, legs and arms; creases are deepest about elbows, armpits and waist.
    down = np.where(label < NO_LABEL, -STRIPE_PER_ARM_M * along, position[:, 1])
    waist = position[:, 1]
    crease = 0.45 + 0.8 * np.exp(-(((along - 1.0) / 0.28) ** 2)) + 0.5 * np.exp(-(((along - 2.15) / 0.3) ** 2))
    crease += 0.5 * np.exp(-(((waist - 0.62) / 0.09) ** 2)) * (label == NO_LABEL)
    traits = np.column_stack([along, down, crease, np.zeros(len(position))])
    more = np.column_stack([np.zeros(len(position)), worn.open, np.zeros(len(position)), zone])
    build.add("cloth", position, normal, weight, worn.uv, traits, more, label, worn.faces)


def _rigid(
    build: _Builder, mesh: tuple[np.ndarray, np.ndarray, np.ndarray], zone: int, weight: np.ndarray, loose: float = 0.0
) -> None:
    """Adds a plain mesh (vertices, normals, faces) with skinning weights (V, 76) to the cloth."""
    position, normal, faces = mesh
    n = len(position)
    more = np.column_stack([np.zeros(n), np.ones(n), np.zeros(n), np.full(n, float(zone))])
    traits = np.column_stack([np.full(n, UNCUT), np.zeros(n), np.full(n, loose), np.zeros(n)])
    label = np.full(n, float(NO_LABEL))
    build.add("cloth", position, normal, weight, position[:, :2], traits, more, label, faces)


def tube(path: np.ndarray, radius: float, *, closed: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A tube of six sides about a path (N, 3): vertices (6 N, 3), outward unit normals, triangles from outside."""
    sides, n = 6, len(path)
    ahead = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0) if closed else np.gradient(path, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    across = np.cross(ahead, [0.02, 0.03, 1.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    beside = np.cross(ahead, across)
    angle = np.arange(sides) * 2 * np.pi / sides
    normal = np.cos(angle)[None, :, None] * across[:, None] + np.sin(angle)[None, :, None] * beside[:, None]
    row, column = np.meshgrid(np.arange(n if closed else n - 1), np.arange(sides), indexing="ij")
    a, b = row * sides + column, row * sides + (column + 1) % sides
    c, d = (row + 1) % n * sides + column, (row + 1) % n * sides + (column + 1) % sides
    faces = np.concatenate([np.stack([a, b, d], -1), np.stack([a, d, c], -1)]).reshape(-1, 3)
    return (path[:, None] + radius * normal).reshape(-1, 3), normal.reshape(-1, 3), faces


def _glasses(build: _Builder, points: np.ndarray, look: PersonLook) -> None:
    """Rims about the eyes, a bridge and temples to the ears."""
    asset = load_people()
    eyes = [points[own].mean(0) for own in asset.is_eye]
    front = max(float(points[own][:, 2].max()) for own in asset.is_eye) + LENS_AHEAD_M
    temple = points[(_anatomy().face > 0) & (np.abs(points[:, 1]) < 0.02) & (np.abs(points[:, 2] + 0.05) < 0.02)]
    ear = float(np.abs(temple[:, 0]).max()) + 0.002
    head = np.zeros(N_BONES, np.float32)
    head[BODY_BONES.index("head")] = 1
    turn = np.linspace(0, 2 * np.pi, 28, endpoint=False)
    paths = []
    for eye in eyes:
        side = np.sign(eye[0])
        rim = np.stack(
            [
                np.sign(np.cos(turn)) * np.abs(np.cos(turn)) ** 0.75,
                np.sign(np.sin(turn)) * np.abs(np.sin(turn)) ** 0.75,
            ],
            1,
        )
        x = eye[0] + side * 0.002 + rim[:, 0] * look.lens[0]
        y = eye[1] + 0.004 + rim[:, 1] * look.lens[1]
        paths.append((np.column_stack([x, y, front - 6.0 * np.maximum(np.abs(x) - 0.02, 0) ** 2]), True))
        outer = eye[0] + side * (0.002 + look.lens[0])
        z = front - 6.0 * (abs(outer) - 0.02) ** 2
        hinge, top = np.array([outer, eye[1] - 0.3 * look.lens[1], z]), -0.35 * look.lens[1]
        paths.append((np.array([hinge, [side * ear, top, -0.045], [side * (ear - 0.004), 0.012, -0.098]]), False))
    inner = [eye[0] + np.sign(eye[0]) * (0.002 - look.lens[0]) for eye in eyes]
    bridge = np.linspace(inner[0], inner[1], 6)
    bow = 1 - (np.linspace(-1, 1, 6)) ** 2
    paths.append((np.column_stack([bridge, -0.002 - 0.003 * bow, front + 0.003 * bow]), False))
    for path, closed in paths:
        mesh = tube(path, FRAME_RADIUS_M, closed=closed)
        _rigid(build, mesh, GLASSES, np.tile(head, (len(mesh[0]), 1)))


def _lanyard(build: _Builder, points: np.ndarray, outfit: Worn, hidden: np.ndarray) -> None:
    """A ribbon from both sides of the neck to a badge on the belly, lying on what is worn."""
    asset = load_people()
    worn = outfit.fitted(points)
    weights = outfit.follows(asset.weights)
    bare = np.unique(asset.skin_source)
    bare = bare[~hidden[bare] & (points[bare, 2] > -0.14) & (np.abs(points[bare, 0]) < 0.2) & (points[bare, 1] > 0.1)]
    under = np.concatenate([worn, points[bare]])
    start = float(points[bare, 1].min()) + 0.035
    steps = np.linspace(0, 1, 40)

    def lie(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Heights over the body at places (N,), minus infinity beside it, and the cloth's vertices there."""
        apart = (under[:, 0] - x[:, None]) ** 2 + (under[:, 1] - y[:, None]) ** 2
        z = np.where(apart < UNDER_RIBBON_M**2, under[:, 2], -np.inf).max(1)
        nearest = ((worn[:, :2] - np.stack([x, y], 1)[:, None]) ** 2).sum(-1) + 0.3 * (worn[:, 2] - z[:, None]) ** 2
        return z, nearest.argmin(1)

    for side in (-1, 1):
        x, y = side * (0.075 * (1 - steps) ** 0.8 + 0.004), start + (0.52 - start) * steps
        z, of = lie(x, y)
        held = np.isfinite(z)
        x, y, z, of = x[held], y[held], z[held], of[held]
        if len(z) < 8:
            continue
        for _ in range(80):  # a taut ribbon bridges what is hollow
            z[1:-1] = np.maximum(z[1:-1], (z[:-2] + z[2:]) / 2)
        z = z + RIBBON_ABOVE_M
        n = len(z)
        vertices = np.concatenate([np.column_stack([x + s * RIBBON_M / 2, y, z]) for s in (-1, 1)])
        i = np.arange(n - 1)
        faces = np.concatenate([np.stack([i, i + n, i + 1], 1), np.stack([i + 1, i + n, i + n + 1], 1)])
        normal = np.tile([0.0, 0.0, 1.0], (len(vertices), 1))
        _rigid(build, (vertices, normal, faces), LANYARD, weights[np.concatenate([of, of])])
    z, of = lie(np.zeros(1), np.array([0.56]))
    badge = np.array(
        [
            [-0.028, 0.515, z[0] + 0.009],
            [0.028, 0.515, z[0] + 0.006],
            [0.028, 0.605, z[0] + 0.006],
            [-0.028, 0.605, z[0] + 0.006],
        ]
    )
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    _rigid(build, (badge, np.tile([0.0, 0.0, 1.0], (4, 1)), faces), BADGE, weights[np.repeat(of, 4)])
