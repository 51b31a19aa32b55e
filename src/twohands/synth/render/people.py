"""Draws whole people with OpenGL: dressed meshes, posed on the CPU, in passes for shadows, labels and colour."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import cv2
import numpy as np

from twohands.synth.render.people_shaders import (
    CARD_FRAGMENT,
    CLOTH_FRAGMENT,
    EYE_FRAGMENT,
    HAIR_FRAGMENT,
    HANDS,
    INSIDE_FRAGMENT,
    LABEL_CLOTH,
    LABEL_HAIR,
    LABEL_SKIN,
    PERSON_VERTEX,
    SHADED_VERTEX,
    SHADOW_FRAGMENT,
    SHADOW_VERTEX,
    SHADOWS,
    SKIN_FRAGMENT,
)
from twohands.synth.render.shaders import MAX_LIGHTS
from twohands.synth.render.surface import surface
from twohands.synth.scene.body import BONE_NAMES, load_asset, part_labels, posed_joints
from twohands.synth.scene.collision import capsules
from twohands.synth.scene.looks import MOTIFS, PLAIN, ZONES, Cloth, PersonLook, PersonSpec
from twohands.synth.scene.people import BODY_BONES, N_BONES, Worn, load_people
from twohands.synth.scene.spec import Lighting, arms_of
from twohands.synth.scene.things import NO_LABEL, vertex_normals

PARTS: Final = ("skin", "eyes", "cloth", "hair", "brow")
LANYARD, GLASSES, HAT, BADGE = range(ZONES, ZONES + 4)
SHADOW_SIZE: Final = 224
"""Coarse: lamps are not points."""
HAT_LINE_M: Final = -0.048
"""Hair higher than this over the eyes is not seen under a hat."""
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
ROWS: Final = "2f 4f 4f 3f 1f"
STILL: Final = ("uv", "traits", "more", "rest", "part")


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


@lru_cache(maxsize=1)
def wrinkle_map(size: int = 512) -> np.ndarray:
    """(size, size, 3) uint8, tileable: slopes of creased cloth along both axes about 128, and how deep it lies.

    Folds are long, soft ridges, most of them lengthwise; fine creases lie between them.
    """
    rng = np.random.default_rng(7)
    height = np.zeros((3 * size, 3 * size))
    for count, length, width, tall in ((16, 0.55, 0.030, 1.0), (45, 0.28, 0.013, 0.45), (120, 0.12, 0.006, 0.16)):
        layer = np.zeros_like(height)
        for _ in range(count):
            turn = np.pi / 2 + rng.normal(0, 0.55)
            steps = np.linspace(-0.5, 0.5, 24)
            bend = rng.normal(0, 0.25, 2)
            angle = turn + bend[0] * 2 * steps + bend[1] * 8 * steps**2
            path = np.cumsum(np.stack([np.cos(angle), np.sin(angle)], 1), axis=0) * length * rng.uniform(0.5, 1.2) / 24
            path = (path - path.mean(0) + rng.uniform(0, 1, 2)) * size
            strength = tall * rng.uniform(0.4, 1.0) * rng.choice([-0.6, 1.0])
            fade = strength * np.cos(np.pi * steps) ** 0.7
            for dx in (0, 1, 2):
                for dy in (0, 1, 2):
                    at = path + np.array([dx, dy]) * size
                    if (at.max(0) < 0).any() or (at.min(0) > 3 * size).any():
                        continue
                    for (x0, y0), (x1, y1), value in zip(at, at[1:], fade[1:], strict=False):
                        ends = (round(x0), round(y0)), (round(x1), round(y1))
                        cv2.line(layer, *ends, float(value), max(1, round(width * size)))
        height += cv2.GaussianBlur(layer, (0, 0), 0.55 * width * size)
    height = height[size : 2 * size, size : 2 * size]
    height = (height - height.mean()) / height.std()
    slope = [np.roll(height, -1, axis) - np.roll(height, 1, axis) for axis in (1, 0)]
    scale = 3.5 * np.std(slope)
    planes = [*(np.clip(127.5 + 127.5 * s / scale, 0, 255) for s in slope), np.clip(100 - 70 * height, 0, 255)]
    return np.stack(planes, -1).astype(np.uint8)


@lru_cache(maxsize=1)
def strand_map(size: int = 256) -> np.ndarray:
    """(size, size, 4) uint8, tileable: strands of hair that run along the rows: brightness, length, lean, and the
    brightness of whole locks."""
    rng = np.random.default_rng(11)

    def smooth(sigma_x: float, sigma_y: float) -> np.ndarray:
        noise = np.fft.fft2(rng.normal(size=(size, size)))
        fy, fx = (np.fft.fftfreq(size)[:, None], np.fft.fftfreq(size)[None])
        kernel = np.exp(-2 * np.pi**2 * ((fx * sigma_x) ** 2 + (fy * sigma_y) ** 2))
        out = np.real(np.fft.ifft2(noise * kernel))
        rank = out.ravel().argsort().argsort().reshape(out.shape)
        return rank / out.size

    fine, lock = smooth(0.9, 24), smooth(7, 40)
    planes = [0.75 * fine + 0.25 * lock, 0.55 * smooth(1.0, 60) + 0.45 * lock, smooth(2, 20), smooth(9, 60)]
    return np.clip(255 * np.stack(planes, -1), 0, 255).astype(np.uint8)


@lru_cache(maxsize=1)
def motif_map(size: int = 128) -> np.ndarray:
    """(4 size, 4 size, 1) uint8: sixteen motifs as they are printed on shirts: lettering, stripes, rings, shapes."""
    rng = np.random.default_rng(23)
    sheet = np.zeros((4 * size, 4 * size), np.uint8)
    letters = "ABCDEFGHIKLMNOPRSTUVWXYZ0123456789"
    for number in range(MOTIFS):
        tile = np.zeros((size, size), np.uint8)
        middle = size // 2
        if number % 4 in (0, 1):
            lines = 1 + number % 3
            for line in range(lines):
                text = "".join(rng.choice(list(letters), rng.integers(3, 8)))
                font, thickness = int(rng.integers(0, 5)), int(rng.integers(2, 7))
                (width, height), _ = cv2.getTextSize(text, font, 1.0, thickness)
                grown = 0.88 * size / width
                at = int(0.06 * size), int(middle + (line - (lines - 1) / 2) * 0.3 * size + grown * height / 2)
                cv2.putText(tile, text, at, font, grown, 255.0, thickness, cv2.LINE_AA)
        if number % 4 in (1, 2):
            for _ in range(int(rng.integers(1, 4))):
                radius = int(rng.uniform(0.1, 0.45) * size)
                thickness = int(rng.choice([-1, 2, 5, 9]))
                cv2.circle(tile, (middle, middle), radius, float(rng.choice([90, 170, 255])), thickness, cv2.LINE_AA)
        if number % 4 == 3:
            corners = rng.uniform(0.08, 0.92, (int(rng.integers(3, 9)), 2)) * size
            cv2.fillPoly(tile, [corners.astype(np.int32)], 255.0, cv2.LINE_AA)
        row, column = divmod(number, 4)
        sheet[row * size : (row + 1) * size, column * size : (column + 1) * size] = tile
    return sheet[..., None]


class _Loaded:
    """A person's mesh on the graphics side."""

    def __init__(self, ctx: Any, programs: dict[str, Any], mesh: PersonMesh) -> None:
        self.mesh = mesh
        self.moving = ctx.buffer(reserve=mesh.position.size * 2 * 4)
        still, faces = ctx.buffer(mesh.still.tobytes()), ctx.buffer(mesh.faces.tobytes())
        rows = [(self.moving, "3f 3f", "position", "normal"), (still, ROWS, *STILL)]
        self.arrays = {
            name: ctx.vertex_array(program, rows, faces, skip_errors=True) for name, program in programs.items()
        }
        self.kept = [self.moving, still, faces, *self.arrays.values()]

    def release(self) -> None:
        """Gives the memory back."""
        for part in self.kept:
            part.release()

    def pose(self, spec: PersonSpec) -> np.ndarray:
        """Moves the vertices; returns where they are, (V, 3), camera frame, scaled metres."""
        mesh = self.mesh
        moves = mesh.weight @ np.ascontiguousarray(spec.transforms.reshape(N_BONES, 12), np.float32)
        moves = moves.reshape(-1, 3, 4)
        rows = np.empty((len(moves), 6), np.float32)
        rows[:, :3] = np.einsum("vab,vb->va", moves[..., :3], mesh.position) + moves[..., 3]
        rows[:, 3:] = np.einsum("vab,vb->va", moves[..., :3], mesh.normal)
        self.moving.write(rows.tobytes())
        return rows[:, :3]

    def draw(self, program: str, first_part: str, last_part: str | None = None) -> None:
        """Draws parts with one of the programs."""
        start = self.mesh.first[PARTS.index(first_part)]
        stop = self.mesh.first[PARTS.index(last_part or first_part) + 1]
        if stop > start:
            self.arrays[program].render(first=3 * int(start), vertices=3 * int(stop - start))


class PeoplePass:
    """Draws the people of scenes into the renderer's framebuffers.

    Args:
        ctx: moderngl's context.
    """

    def __init__(self, ctx: Any) -> None:
        self.ctx = ctx
        fragments = {
            "skin": SKIN_FRAGMENT, "eyes": EYE_FRAGMENT, "cloth": CLOTH_FRAGMENT, "inside": INSIDE_FRAGMENT,
            "hair": HAIR_FRAGMENT, "card": CARD_FRAGMENT, "label": LABEL_SKIN,
            "label_cloth": LABEL_CLOTH, "label_hair": LABEL_HAIR,
        }  # fmt: skip
        self.programs = {
            name: ctx.program(
                vertex_shader=SHADED_VERTEX if name in ("skin", "cloth") else PERSON_VERTEX, fragment_shader=text
            )
            for name, text in fragments.items()
        }
        self.programs["shadow"] = ctx.program(vertex_shader=SHADOW_VERTEX, fragment_shader=SHADOW_FRAGMENT)
        asset = load_people()
        skin = asset.picture("skin")
        self.mean = _typical(skin)
        brown, blue = (_flipless(asset.picture(f"eye_{name}")) for name in ("brown", "blue"))
        pictures = {
            "skin_map": skin, "eye_brown": brown, "eye_blue": blue, "brow": asset.picture("brow"),
            "wrinkles": wrinkle_map(), "motifs": motif_map(), "strands": strand_map(),
        }  # fmt: skip
        self.textures = {name: self._texture(picture) for name, picture in pictures.items()}
        self._tile = lru_cache(maxsize=32)(lambda tile: self._texture(tile.picture))
        self.shadow_maps = [self._shadow_map() for _ in range(SHADOWS)]
        self.loaded: dict[tuple[Any, ...], tuple[_Loaded, PersonLook]] = {}

    def _texture(self, picture: np.ndarray) -> Any:
        height, width, channels = picture.shape
        texture = self.ctx.texture((width, height), channels, np.ascontiguousarray(picture).tobytes(), alignment=1)
        texture.build_mipmaps()
        texture.filter = (self.ctx.LINEAR_MIPMAP_NEAREST, self.ctx.LINEAR)
        return texture

    def _shadow_map(self) -> tuple[Any, Any]:
        texture = self.ctx.depth_texture((SHADOW_SIZE, SHADOW_SIZE))
        texture.compare_func = "<="
        texture.filter = (self.ctx.LINEAR, self.ctx.LINEAR)
        texture.repeat_x = texture.repeat_y = False
        return texture, self.ctx.framebuffer(depth_attachment=texture)

    def _load(self, spec: PersonSpec) -> _Loaded:
        key = (id(spec.look), tuple(spec.shape.tolist()), tuple(spec.present.tolist()))
        if key not in self.loaded:
            while len(self.loaded) >= 6:
                self.loaded.pop(next(iter(self.loaded)))[0].release()
            mesh = person_mesh(spec.look, spec.shape, (bool(spec.present[0]), bool(spec.present[1])))
            self.loaded[key] = (_Loaded(self.ctx, self.programs, mesh), spec.look)  # the look keeps its identity
        return self.loaded[key][0]

    def prepare(
        self, people: tuple[PersonSpec, ...], lighting: Lighting, projection: bytes, things: Any, corners: int
    ) -> None:
        """Poses the people and draws shadows; leaves another framebuffer in use.

        Args:
            people: the first is labelled.
            lighting: lamps.
            projection: clip matrix of the camera.
            things: vertex array of the things in the scene for the shadow program; unused without `corners`.
            corners: number of its vertices.
        """
        self.things, self.corners = things, corners
        self.people = [(spec, self._load(spec)) for spec in people]
        places = [loaded.pose(spec) for spec, loaded in self.people]
        scale = people[0].scale
        for name, program in self.programs.items():
            if name != "shadow":
                program["projection"].write(projection)
        lamps = lighting.positions * scale
        order = self._strongest(lamps, lighting.colours * scale**2, np.concatenate([p[::7] for p in places]))
        self._shadows(lamps, order, np.concatenate([p[::5] for p in places]), scale)
        positions, colours = np.zeros((MAX_LIGHTS, 3)), np.zeros((MAX_LIGHTS, 3))
        positions[: len(lamps)], colours[: len(lamps)] = lamps, lighting.colours * scale**2
        for name in ("skin", "eyes", "cloth", "inside", "hair", "card"):
            program = self.programs[name]
            _set(program, "light_position", positions.astype("f4").tobytes())
            _set(program, "light_colour", colours.astype("f4").tobytes())
            _set(program, "light_count", len(lamps))
            _set(program, "sky", tuple(lighting.sky))
            _set(program, "ground", tuple(lighting.ground))
            _set(program, "metre", scale)
            _set(program, "shadow_from", self.shadow_matrices.tobytes())
            _set(program, "texel", tuple(self.shadow_texels))
            _set(program, "shadow_of", [int(i) for i in order])
            for index, sampler in enumerate(("shadow_a", "shadow_b")):
                _set(program, sampler, index)

    @staticmethod
    def _strongest(lamps: np.ndarray, colours: np.ndarray, points: np.ndarray) -> np.ndarray:
        """(SHADOWS,) the lamps that matter most; the same one twice where there is one."""
        power = colours.sum(1) / ((lamps - np.median(points, axis=0)) ** 2).sum(1)
        return np.resize(np.argsort(-power), SHADOWS)

    def _shadows(self, lamps: np.ndarray, order: np.ndarray, points: np.ndarray, scale: float) -> None:
        low, high = points.min(0), points.max(0)
        self.shadow_matrices = np.zeros((SHADOWS, 4, 4), np.float32)
        self.shadow_texels = np.zeros(SHADOWS)
        self.ctx.disable(self.ctx.CULL_FACE)
        for index, lamp in enumerate(order):
            matrix = _lamp_matrix(lamps[lamp], (low + high) / 2, float(np.linalg.norm(high - low)) / 2, scale)
            self.shadow_texels[index] = (
                2 * np.linalg.norm(lamps[lamp] - (low + high) / 2) / np.linalg.norm(matrix[0, :3]) / SHADOW_SIZE
            )
            self.shadow_matrices[index] = matrix.T
            _, framebuffer = self.shadow_maps[index]
            framebuffer.use()
            framebuffer.clear(depth=1.0)
            self.programs["shadow"]["projection"].write(np.ascontiguousarray(matrix.T, np.float32).tobytes())
            for _, loaded in self.people:
                loaded.draw("shadow", "skin", "hair")
            if self.corners:
                self.things.render(vertices=self.corners)
        self.ctx.enable(self.ctx.CULL_FACE)

    def draw_arm(self, side: int) -> None:
        """Labels and depth of one arm of the first person alone into the framebuffer in use."""
        self._draw_labels(self.people[:1], (1.0 + 7 * side, 7.0 + 7 * side))

    def draw_labels(self) -> None:
        """Labels and depth of everybody into the framebuffer in use."""
        self._draw_labels(self.people, (0.0, 255.0))

    def _draw_labels(self, people: list[tuple[PersonSpec, _Loaded]], shown: tuple[float, float]) -> None:
        for number, (spec, loaded) in enumerate(people):
            for name in ("label", "label_cloth", "label_hair"):
                _set(self.programs[name], "labelled", float(number == 0))
                _set(self.programs[name], "shown", shown)
            loaded.draw("label", "skin", "eyes")
            self.ctx.disable(self.ctx.CULL_FACE)
            _set(self.programs["label_cloth"], "sleeve_from", spec.look.sleeve_from)
            loaded.draw("label_cloth", "cloth")
            _set(self.programs["label_hair"], "hat_line", HAT_LINE_M if spec.look.hat else -UNCUT)
            self._use("label_hair", "strands", 2, self.textures["strands"])
            loaded.draw("label_hair", "hair")
            self.ctx.enable(self.ctx.CULL_FACE)

    def draw_colour(self) -> None:
        """Everybody into the framebuffer in use."""
        for index, (texture, _) in enumerate(self.shadow_maps):
            texture.use(index)
        for spec, loaded in self.people:
            look = spec.look
            self._write_hands(spec)
            self._write_skin(look)
            loaded.draw("skin", "skin")
            eye = self.programs["eyes"]
            _set(eye, "iris", tuple(look.iris))
            self._use("eyes", "eye_map", 2, self.textures["eye_blue" if look.blue else "eye_brown"])
            loaded.draw("eyes", "eyes")
            self._write_cloth(look)
            loaded.draw("cloth", "cloth")
            self.ctx.cull_face = "front"
            loaded.draw("inside", "cloth")
            self.ctx.cull_face = "back"
            self.ctx.disable(self.ctx.CULL_FACE)
            hair = self.programs["hair"]
            _set(hair, "hair_albedo", tuple(look.hair_albedo))
            _set(hair, "white", look.grey)
            _set(hair, "hat_line", HAT_LINE_M if look.hat else -UNCUT)
            self._use("hair", "strands", 2, self.textures["strands"])
            loaded.draw("hair", "hair")
            self._draw_brows(look, loaded)
            self.ctx.enable(self.ctx.CULL_FACE)

    def _draw_brows(self, look: PersonLook, loaded: _Loaded) -> None:
        card = self.programs["card"]
        ctx = self.ctx
        ctx.enable(ctx.BLEND)
        ctx.blend_func = (ctx.SRC_ALPHA, ctx.ONE_MINUS_SRC_ALPHA, ctx.ZERO, ctx.ONE)
        _set(card, "card_albedo", tuple(0.8 * look.hair_albedo))
        _set(card, "strength", 1.7 * look.brow_strength)
        self._use("card", "card_map", 2, self.textures["brow"])
        loaded.draw("card", "brow")
        ctx.disable(ctx.BLEND)

    def _use(self, program: str, sampler: str, unit: int, texture: Any) -> None:
        texture.use(unit)
        _set(self.programs[program], sampler, unit)

    def _write_hands(self, spec: PersonSpec) -> None:
        """The person's hands and forearms as capsules."""
        body = arms_of(tuple(spec.shape.tolist()))
        joints = posed_joints(body, spec.arms)[spec.present] * spec.scale
        starts, ends, radii = capsules(body, joints)
        along = ends - starts
        rows = np.zeros((2, HANDS, 4), np.float32)
        rows[0, : len(radii)] = np.column_stack([starts, radii * spec.scale])
        rows[1, : len(radii)] = np.column_stack([along, 1 / (along**2).sum(1)])
        for name in ("skin", "cloth"):
            _set(self.programs[name], "capsule_from", rows[0].tobytes())
            _set(self.programs[name], "capsule_along", rows[1].tobytes())
            _set(self.programs[name], "capsule_count", len(radii))

    def _write_skin(self, look: PersonLook) -> None:
        skin = self.programs["skin"]
        _set(skin, "seed", tuple(look.seed))
        _set(skin, "mean", tuple(self.mean))
        _set(skin, "skin_albedo", tuple(look.skin_albedo))
        _set(skin, "palm_albedo", tuple(look.palm_albedo))
        _set(skin, "hair_albedo", tuple(look.hair_albedo))
        _set(skin, "lips", tuple(look.lips))
        # What is red on fair skin is hardly redder than the rest on dark skin.
        dark = 1 - min(float(look.skin_albedo.mean()) / 0.3, 1.0)
        _set(
            skin, "detail", tuple(look.skin_detail * np.array([1.0 - 0.1 * dark, 1.0 - 0.3 * dark, 1.0 - 0.35 * dark]))
        )
        _set(skin, "roughness", look.skin_roughness)
        _set(skin, "flushed", look.flushed)
        _set(skin, "stubble", look.stubble)
        _set(skin, "moustache", look.moustache)
        _set(skin, "scalp", 1.0 if look.hair else 0.75)
        _set(skin, "white", look.grey)
        self._use("skin", "skin_map", 2, self.textures["skin_map"])

    def _write_cloth(self, look: PersonLook) -> None:
        cloth = self.programs["cloth"]
        fabrics = [*look.clothes]
        white = np.full(3, 0.7)
        for colour, roughness in ((look.lanyard, 0.8), (look.glasses, 0.3), (look.hat_albedo, 0.9), (white, 0.4)):
            plain = white if colour is None else colour
            fabrics.append(Cloth(plain, plain, PLAIN, 0.01, 0.0, 0.0, 0.0, roughness))
        _set(cloth, "seed", tuple(look.seed))
        for program in (cloth, self.programs["inside"]):
            _set(program, "sleeve_from", look.sleeve_from)
            _set(program, "albedo", np.array([f.albedo for f in fabrics], np.float32).tobytes())
        _set(cloth, "second", np.array([f.second for f in fabrics], np.float32).tobytes())
        _set(
            cloth, "weave", np.array([[f.kind, f.period_m, f.turn, f.contrast] for f in fabrics], np.float32).tobytes()
        )
        _set(
            cloth,
            "finish",
            np.array([[f.wrinkles, f.roughness, f.fabric is not None] for f in fabrics], np.float32).tobytes(),
        )
        self._use("cloth", "wrinkles", 2, self.textures["wrinkles"])
        _set(cloth, "tile", 3)
        self._use("cloth", "motifs", 4, self.textures["motifs"])
        own = next((f.fabric for f in fabrics if f.fabric is not None), None)
        if own is not None:
            height, width = own.tile.picture.shape[:2]
            c, s = np.cos(own.turn), np.sin(own.turn)
            tiling = np.array([[c, -s], [s * width / height, c * width / height]]) / own.period_m
            _set(cloth, "tiling", np.ascontiguousarray(tiling.T, np.float32).tobytes())
            _set(cloth, "tile_mean", tuple(own.tile.mean))
            self._tile(own.tile).use(3)


def _set(program: Any, name: str, value: Any) -> None:
    """Sets a uniform, unless the compiler found it unused."""
    if name in program:
        if isinstance(value, bytes):
            program[name].write(value)
        else:
            program[name].value = value


def _flipless(picture: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(picture)


def _typical(skin: np.ndarray) -> np.ndarray:
    """(3,) colour of plain skin on the map, by squares."""
    plain = skin[skin.max(-1) > 60].reshape(-1, 3)
    return (np.median(plain, axis=0) / 255) ** 2


def _lamp_matrix(lamp: np.ndarray, centre: np.ndarray, radius: float, scale: float) -> np.ndarray:
    """(4, 4) into the clip space of a lamp's picture that shows a ball."""
    offset = centre - lamp
    distance = float(np.linalg.norm(offset))
    forward = offset / distance
    side = np.cross([0.0, 1.0, 0.0] if abs(forward[1]) < 0.9 else [1.0, 0.0, 0.0], forward)
    side /= np.linalg.norm(side)
    turn = np.stack([side, np.cross(forward, side), forward])
    half = np.tan(min(np.arcsin(min(radius / distance, 1.0)), np.radians(55)))
    near, far = max(distance - radius, 0.08 * scale), distance + radius
    out = np.zeros((4, 4))
    out[0, :3], out[1, :3] = turn[0] / half, turn[1] / half
    out[2, :3] = turn[2] * (far + near) / (far - near)
    out[3, :3] = turn[2]
    out[:, 3] = out[:, :3] @ -lamp
    out[2, 3] -= 2 * far * near / (far - near)
    return out
