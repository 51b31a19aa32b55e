"""Things in hands and on arms, as meshes: held objects, watches, rings.

They cover parts of the hands, as in life; a held object never enters the hand that holds it, nor the other one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twohands.skeleton import LEFT, PART_NAMES, RIGHT, part_label
from twohands.synth.scene.body import Body, bone, each_moved, skin, vertex_moves
from twohands.synth.scene.collision import capsules, segment_distance
from twohands.synth.scene.config import SynthConfig
from twohands.synth.scene.pose import dot, unit

NO_LABEL = 255
"""Label of things that are no part of a hand; label images have 0 there."""
GRASP_TRIES = 48
SMALLEST_M, LARGEST_M = 0.007, 0.042
"""Radii of held objects."""
REACH_M = 0.014
"""A held object is at most this far from palm and fingers."""
SHORT_SLEEVE = (-0.32, 0.42)
"""Where a short sleeve begins and ends, as shares of the way from the shoulder to the elbow."""
LOOSE_M = 0.016
"""Distance of a short sleeve from the skin."""
SLEEVE_ROWS = 12
SKIN_AROUND_M = 0.025
"""How far around it (standard deviation) the skin counts that a point of a sleeve follows."""


@dataclass(frozen=True, slots=True, eq=False)
class Thing:
    """A mesh in the frame between the eyes, body's metres.

    Attributes:
        vertices, normals: (V, 3); normals are unit vectors pointing outwards.
        faces: (F, 3) int32, counter-clockwise seen from outside in the frame's right-handed sense.
        albedo: (3,) linear RGB.
        second: (3,) linear RGB of the pattern.
        stripes: periods of the pattern along the first axis of `pattern_at`, 0 for none.
        pattern_at: (V,) place along the pattern, 0..1.
        roughness: 0.1 (polished) to 0.9 (cloth).
        label: part that wears it, or NO_LABEL.
        core: ends (2, 3) of the axis and radius of a capsule that casts about the same shadow; None for what lies close
            to the skin, and for trunk and head, which arms grow out of.
        colours: (V, 3) linear RGB albedo of the vertices instead of `albedo` and the pattern; None without.
    """

    vertices: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    albedo: np.ndarray
    second: np.ndarray
    stripes: float
    pattern_at: np.ndarray
    roughness: float
    label: int
    core: tuple[np.ndarray, float] | None = None
    colours: np.ndarray | None = None

    @property
    def side(self) -> int | None:
        """LEFT or RIGHT, for what is worn and counts as part of that hand or its arm; None for all else."""
        return None if self.label == NO_LABEL else (self.label - 1) // len(PART_NAMES)


def superquadric(
    half: np.ndarray, round_across: float, round_along: float, rows: int = 17, columns: int = 32
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A solid between box, cylinder and ellipsoid about the origin, its axis along z.

    Args:
        half: (3,) half sizes.
        round_across: exponent in the x-y plane, 1 an ellipse, towards 0 a rectangle.
        round_along: the same along z.
        rows, columns: of the grid of vertices.

    Returns:
        Vertices (V, 3), outward unit normals (V, 3), faces (F, 3) counter-clockwise from outside, and the place (V,) of
        every vertex along z, 0..1.

    Source: Barr 1981, superquadrics.
    """

    def power(x: np.ndarray, e: float) -> np.ndarray:
        return np.sign(x) * np.abs(x) ** e

    eta = np.linspace(-np.pi / 2, np.pi / 2, rows)[:, None]
    omega = np.linspace(-np.pi, np.pi, columns, endpoint=False)[None]
    around, up = np.stack([np.cos(omega), np.sin(omega)], -1), np.sin(eta)
    ring = np.cos(eta)
    vertices = np.concatenate(
        [
            half[:2] * power(around, round_across) * power(ring, round_along)[..., None],
            np.broadcast_to(half[2] * power(up, round_along), (rows, columns))[..., None],
        ],
        axis=-1,
    )
    normals = np.concatenate(
        [
            power(around, 2 - round_across) * power(ring, 2 - round_along)[..., None] / half[:2],
            np.broadcast_to(power(up, 2 - round_along) / half[2], (rows, columns))[..., None],
        ],
        axis=-1,
    )
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    place = np.broadcast_to(0.5 + 0.5 * power(up, round_along), (rows, columns))
    return vertices.reshape(-1, 3), normals.reshape(-1, 3), grid_faces(rows, columns), place.ravel()


def grid_faces(rows: int, columns: int) -> np.ndarray:
    """(2 (rows - 1) columns, 3) int32 triangles of a grid that closes along its columns."""
    row, column = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    a, b = row * columns + column, row * columns + (column + 1) % columns
    c, d = a + columns, b + columns
    return np.concatenate([np.stack([a, b, d], -1), np.stack([a, d, c], -1)]).reshape(-1, 3).astype(np.int32)


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V, 3) outward unit normals of a closed mesh whose triangles are counter-clockwise from outside."""
    corners = faces.T.ravel()
    places = vertices.T.take(corners, axis=1).reshape(3, 3, -1)  # one row per axis and corner: numpy is fast along rows
    (ux, uy, uz), (vx, vy, vz) = places[:, 1] - places[:, 0], places[:, 2] - places[:, 0]
    face = (uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx)
    normals = np.stack([np.bincount(corners, np.tile(along, 3), len(vertices)) for along in face], axis=1)
    return normals / np.maximum(np.sqrt(dot(normals, normals)), 1e-12)[:, None]


def joined(n_vertices: int, faces: np.ndarray) -> np.ndarray:
    """(V,) number of the connected part that each vertex belongs to."""
    part = np.arange(n_vertices)
    while True:
        lowest = part.copy()
        np.minimum.at(lowest, faces.ravel(), np.repeat(part[faces].min(1), 3))
        lowest = lowest[lowest]
        if (lowest == part).all():
            return np.unique(part, return_inverse=True)[1].reshape(-1)
        part = lowest


def band(
    points: np.ndarray,
    origin: np.ndarray,
    axis: np.ndarray,
    width: float,
    thickness: float,
    rows: int = 2,
    columns: int = 36,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A band laid around a limb.

    Args:
        points: (N, 3) on the limb's skin near the band.
        origin: (3,) on the limb's axis, in the middle of the band.
        axis: (3,) unit vector along the limb.
        width, thickness: metres.
        rows: of vertices across its outer face; a band that is to bend needs more than 2.
        columns: vertices around.

    Returns:
        Vertices, normals, faces as of `superquadric`, and the place (V,) around, 0..1.
    """
    x = unit(np.cross(axis, [0.3, 0.5, 0.8]))
    y = np.cross(axis, x)
    offset = points - origin
    angle, radius = np.arctan2(offset @ y, offset @ x), np.hypot(offset @ x, offset @ y)
    around = np.linspace(-np.pi, np.pi, columns, endpoint=False)
    # A smooth closed outline through the skin: low harmonics, fitted by least squares.
    basis = lambda t: np.stack([np.ones_like(t), np.cos(t), np.sin(t), np.cos(2 * t), np.sin(2 * t)], 1)  # noqa: E731
    fitted, *_ = np.linalg.lstsq(basis(angle), radius, rcond=None)
    outline = basis(around) @ fitted + np.quantile(radius - basis(angle) @ fitted, 0.9)
    direction = np.cos(around)[:, None] * x + np.sin(around)[:, None] * y
    # Profile across the band: inner edge, outer face, inner edge.
    profile = np.array([(-0.5, 0.0), *((across, 1.0) for across in np.linspace(-0.46, 0.46, rows)), (0.5, 0.0)])
    lean = np.concatenate([[-0.9], np.linspace(-0.25, 0.25, rows), [0.9]])
    vertices, normals = [], []
    for (along, out), tilt in zip(profile, lean, strict=True):
        vertices.append(origin + axis * along * width + direction * (outline + out * thickness)[:, None])
        normals.append(direction * np.sqrt(1 - tilt**2) + axis * tilt)
    place = np.tile(np.arange(columns) / columns, len(profile))
    return np.concatenate(vertices), np.concatenate(normals), grid_faces(len(profile), columns), place


def sample_things(
    config: SynthConfig,
    body: Body,
    transforms: np.ndarray,
    joints: np.ndarray,
    present: np.ndarray,
    bare: tuple[float, float],
    rng: np.random.Generator,
) -> tuple[Thing, ...]:
    """Draws what the person holds and wears.

    Args:
        config: shares of hands that hold an object, wear a watch, wear a ring.
        body: the person.
        transforms: (48, 3, 4) posed bones, frame between the eyes, body's metres.
        joints: (2, 22, 3) in the same frame.
        present: (2,) bool.
        bare: where gloves end and sleeves begin, from the wrist (0) to the elbow (1).
        rng: the only source of randomness.
    """
    things: list[Thing] = []
    wrist, *fingers, left, right = rng.spawn(5)  # what is worn stays the same, whatever is held or seen
    watch_side = int(wrist.integers(2)) if wrist.random() < config.watches else -1
    for side, finger, grasp in zip((LEFT, RIGHT), fingers, (left, right), strict=True):
        if not present[side]:
            continue
        if side == watch_side and bare[0] < 0.0 and bare[1] > 0.3:
            things += _watch(body, transforms, joints[side], side, wrist)
        if finger.random() < config.rings and bare[0] < 0.0:
            things.append(_ring(body, transforms, joints[side], side, finger))
        if grasp.random() < config.objects:
            held = _held(body, joints, present, side, grasp)
            if held is not None:
                things.append(held)
    return tuple(things)


def sample_person(
    body: Body,
    transforms: np.ndarray,
    present: np.ndarray,
    skin_albedo: np.ndarray,
    cloth_albedo: np.ndarray,
    rng: np.random.Generator,
) -> tuple[Thing, ...]:
    """What a camera that is not on the head sees of the person beside the arms: trunk, neck, head and hair as solids,
    and the shirt's short sleeves, in which the arms' meshes end. Where they go on in long sleeves, they count as arms.

    Args:
        body: the person.
        transforms: (48, 3, 4) posed bones, frame between the eyes, body's metres.
        present: (2,) bool, which arms are there.
        skin_albedo, cloth_albedo: (3,) linear RGB; cloth without a colour gets one.
        rng: the only source of randomness.
    """
    left, right = (body.heads[bone("upperarm01", side)] for side in (LEFT, RIGHT))
    shoulders, across = (left + right) / 2, np.abs(left - right)[0] / 2
    cloth = cloth_albedo if cloth_albedo.any() else muted_colour(rng)
    hair = np.array([0.25, 0.16, 0.09]) * rng.uniform(0.05, 1.8) * rng.uniform([0.8, 0.8, 0.6], [1.1, 1.1, 1.2])
    depth = rng.uniform(0.10, 0.15)
    solids = (
        (shoulders + np.array([0.0, 0.37, -0.02]), [depth, across + 0.035, 0.43], (0.75, 0.4), cloth, 0.85),
        (shoulders + np.array([0.0, -0.06, 0.0]), [0.055, 0.058, 0.12], (1.0, 0.4), skin_albedo, 0.5),
        (np.array([0.0, 0.02, -0.09]), [0.098, 0.078, 0.118], (0.95, 0.95), skin_albedo, 0.5),
        (np.array([0.0, -0.02, -0.115]), [0.1, 0.088, 0.108], (1.0, 1.0), hair, 0.6),
    )
    upright = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # columns: forwards, sideways, down
    things = []
    for centre, half, exponents, albedo, roughness in solids:
        vertices, normals, faces, place = superquadric(np.array(half), *exponents)
        mesh = vertices @ upright.T + centre, normals @ upright.T, faces, place
        things.append(_thing(mesh, albedo, albedo * 0.8, 0.0, roughness, NO_LABEL))
    for side in np.flatnonzero(present):
        label = part_label(int(side), PART_NAMES.index("arm")) if cloth_albedo.any() else NO_LABEL
        things.append(_short_sleeve(body, transforms, int(side), cloth, label))
    return tuple(things)


def _short_sleeve(body: Body, transforms: np.ndarray, side: int, albedo: np.ndarray, label: int) -> Thing:
    """A tube about the upper arm, closed and round at the shoulder, that bends with the skin under it."""
    shoulder, elbow = (body.heads[bone(name, side)] for name in ("upperarm01", "lowerarm01"))
    low, high = SHORT_SLEEVE
    chosen = _near(body, side, shoulder, elbow, low, high, 0.12)
    axis, length = unit(elbow - shoulder), float(np.linalg.norm(elbow - shoulder))
    origin = shoulder + axis * length * (low + high) / 2
    tube, _, faces, place = band(body.vertices[chosen], origin, axis, length * (high - low), LOOSE_M, rows=SLEEVE_ROWS)
    along = (tube - shoulder) @ axis / length
    centre = shoulder + along[:, None] * axis * length
    width = (1 - np.clip(along / low, 0, 1) ** 4) ** 0.25
    tube = centre + width[:, None] * (tube - centre)
    # Every vertex follows what the skin around it follows.
    apart = ((tube[:, None] - body.vertices[chosen]) ** 2).sum(-1)
    share = np.exp(-apart / (2 * SKIN_AROUND_M**2)) + 1e-30
    skin_moves = vertex_moves(body.asset, transforms, chosen=chosen)
    vertices = each_moved(np.einsum("vn,nab->vab", share / share.sum(1, keepdims=True), skin_moves), tube)
    mesh = vertices, vertex_normals(vertices, faces), faces, place
    return _thing(mesh, albedo, albedo * 0.8, 0.0, 0.85, label)


def _near(body: Body, side: int, a: np.ndarray, b: np.ndarray, low: float, high: float, radius: float) -> np.ndarray:
    """Vertices of one side between the shares `low` and `high` of the way from a to b at rest, and near that line."""
    way = b - a
    offset = body.vertices - a
    share = offset @ way / (way @ way)
    beside = np.linalg.norm(offset - share[:, None] * way, axis=1)
    return np.flatnonzero((body.asset.side == side) & (share > low) & (share < high) & (beside < radius))


def muted_colour(rng: np.random.Generator) -> np.ndarray:
    """(3,) any colour, mostly muted."""
    grey = rng.beta(0.8, 1.0)
    return np.clip((grey + rng.normal(0, 0.22, 3) * rng.beta(1, 2)) * 0.85, 0.01, 0.85)


def _watch(body: Body, transforms: np.ndarray, joints: np.ndarray, side: int, rng: np.random.Generator) -> list[Thing]:
    rest = body.joints[side]
    share = rng.uniform(0.08, 0.20)
    chosen = _near(body, side, rest[1], rest[0], share - 0.06, share + 0.06, 0.06)
    points = skin(body, transforms, chosen=chosen)
    axis = unit(joints[0] - joints[1])
    origin = points.mean(0)
    width = rng.uniform(0.012, 0.022)
    label = part_label(side, PART_NAMES.index("arm"))
    strap = band(points, origin, axis, width, rng.uniform(0.0015, 0.003))
    strap_albedo = muted_colour(rng)
    things = [_thing(strap, strap_albedo, strap_albedo, 0.0, rng.uniform(0.3, 0.8), label)]
    # The dial sits on the back of the arm: away from the palm, as the wrist bone has turned it.
    wrist = transforms[bone("wrist", side)][:, :3]
    palmar_rest = np.cross(rest[1 + 9] - rest[1], rest[1 + 5] - rest[1 + 17]) * (1 if side == 0 else -1)
    dorsal = -(wrist @ unit(palmar_rest))
    dorsal = unit(dorsal - axis * (dorsal @ axis))
    out = np.max((points - origin) @ dorsal)
    dial = rng.uniform(0.015, 0.023)
    half = np.array([dial, dial * rng.uniform(0.85, 1.1), rng.uniform(0.003, 0.006)])
    solid = superquadric(half, rng.choice([1.0, 0.3]), 0.25)
    frame = np.stack([axis, np.cross(dorsal, axis), dorsal], axis=1)
    placed = (solid[0] @ frame.T + origin + dorsal * (out + half[2] * 0.6), solid[1] @ frame.T, solid[2], solid[3])
    face = muted_colour(rng) if rng.random() < 0.5 else np.full(3, rng.choice([0.02, 0.6]))
    things.append(_thing(placed, face, np.full(3, rng.uniform(0.05, 0.7)), 0.0, rng.uniform(0.1, 0.3), label))
    return things


def _ring(body: Body, transforms: np.ndarray, joints: np.ndarray, side: int, rng: np.random.Generator) -> Thing:
    finger = int(rng.choice(5, p=[0.08, 0.17, 0.2, 0.4, 0.15]))
    base = 2 + 4 * finger + (1 if finger == 0 else 0)
    rest = body.joints[side]
    share = rng.uniform(0.45, 0.62)
    chosen = _near(body, side, rest[base], rest[base + 1], share - 0.12, share + 0.12, 0.014)
    points = skin(body, transforms, chosen=chosen)
    axis = unit(joints[base + 1] - joints[base])
    origin = joints[base] + (joints[base + 1] - joints[base]) * share
    ring = band(points, origin, axis, rng.uniform(0.002, 0.006), rng.uniform(0.0008, 0.0018))
    metals = np.array([[0.75, 0.55, 0.22], [0.62, 0.62, 0.63], [0.7, 0.45, 0.35], [0.03, 0.03, 0.03]])
    metal = metals[rng.integers(len(metals))]
    return _thing(ring, metal, metal, 0.0, rng.uniform(0.12, 0.3), part_label(side, 2 + finger))


def grasped(
    body: Body,
    joints: np.ndarray,
    present: np.ndarray,
    side: int,
    rng: np.random.Generator,
    half_lengths: tuple[float, float] = (0.02, 0.09),
    reach_m: float = REACH_M,
) -> tuple[np.ndarray, np.ndarray, float, float] | None:
    """The thickest rod that fits between palm and fingers.

    Args:
        body: the person.
        joints: (2, 22, 3) posed joints, body's metres.
        present: (2,) bool, hands that are not to be entered.
        side: whose hand holds it.
        rng: the only source of randomness.
        half_lengths: range of half its length, metres, even in the logarithm.
        reach_m: it is at most this far from the palm and from two fingers.

    Returns:
        Its centre (3,), its axis (3,) from the little finger's side to the index finger's, half its length and its
        radius; None where nothing is grasped.
    """
    hand = joints[side, 1:]
    knuckles = hand[[5, 9, 13, 17]]
    axis = unit(hand[5] - hand[17] + rng.normal(0, 0.012, 3))
    half_length = float(np.exp(rng.uniform(*np.log(half_lengths))))
    start = 0.5 * (knuckles.mean(0) + hand[[8, 12, 16, 20]].mean(0))
    palmar = unit(np.cross(hand[9] - hand[0], hand[5] - hand[17])) * (1 if side == 0 else -1)
    slide = rng.uniform(-0.5, 0.5) * half_length
    spread = rng.normal(0, 0.014, (GRASP_TRIES, 3)) + palmar * rng.uniform(0, 0.02, (GRASP_TRIES, 1))
    centres = start + spread + axis * slide
    starts, ends, radii = capsules(body, joints[present])
    own = np.repeat(np.flatnonzero(present) == side, len(radii) // int(present.sum()))
    n, m = GRASP_TRIES, len(radii)
    a, b = np.repeat(centres - axis * half_length, m, 0), np.repeat(centres + axis * half_length, m, 0)
    gaps = segment_distance(a, b, np.tile(starts, (n, 1)), np.tile(ends, (n, 1))).reshape(n, m) - radii
    free = gaps.min(1)
    best = int(free.argmax())
    radius = min(float(free[best]), LARGEST_M)
    if radius < SMALLEST_M:
        return None
    own_gaps = gaps[best][own]
    palm, fingers = own_gaps[1:5].min(), np.sort(own_gaps[5:].reshape(5, 3).min(1))
    if palm > radius + reach_m or fingers[1] > radius + reach_m:
        return None
    return centres[best], axis, half_length, radius


def _held(body: Body, joints: np.ndarray, present: np.ndarray, side: int, rng: np.random.Generator) -> Thing | None:
    """The thickest solid, of a random kind, that fits between palm and fingers; None where nothing is grasped."""
    rod = grasped(body, joints, present, side, rng)
    if rod is None:
        return None
    centre, axis, half_length, radius = rod
    middles = joints[side, 1:][[6, 10, 14, 18]]
    across, along = rng.choice([1.0, 0.9, 0.35]), rng.choice([1.0, 0.3, 0.15])
    inside = 0.72 + 0.28 * across  # a box touches the hand with its edges
    half = np.array([radius * inside, radius * inside * rng.uniform(0.5, 1.0), half_length])
    solid = superquadric(half, across, along)
    turn = rng.uniform(0, 2 * np.pi)
    x = unit(np.cross(axis, middles.mean(0) - centre))
    y = np.cross(axis, x)
    frame = np.stack([np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x, axis], axis=1)
    placed = (solid[0] @ frame.T + centre, solid[1] @ frame.T, solid[2], solid[3])
    stripes = float(rng.integers(2, 9)) if rng.random() < 0.35 else 0.0
    thing = _thing(placed, muted_colour(rng), muted_colour(rng), stripes, rng.uniform(0.15, 0.8), NO_LABEL)
    thickness = float(np.sqrt(half[0] * half[1]))
    reach = axis * max(half_length - thickness, 1e-3)
    return replace(thing, core=(np.stack([centre - reach, centre + reach]), thickness))


def _thing(
    mesh: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    albedo: np.ndarray,
    second: np.ndarray,
    stripes: float,
    roughness: float,
    label: int,
) -> Thing:
    vertices, normals, faces, place = mesh
    return Thing(vertices, normals, faces, albedo, second, stripes, place, roughness, label)
