"""Draws one scene: who, in which pose, under which light. A pure function of (config, seed, index)."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from twohands.errors import InputError
from twohands.geometry.camera import project
from twohands.skeleton import INDEX_MCP, LEFT, LITTLE_MCP, RIGHT, ROOT, WRIST
from twohands.synth.body import BONES_PER_SIDE, Body, forward_kinematics, load_asset
from twohands.synth.collision import hand_enters_itself, hands_collide
from twohands.synth.config import SynthConfig
from twohands.synth.fabrics import Fabric, FabricFolder
from twohands.synth.pose import ArmAnatomy, HandAngles, rotation_about, unit
from twohands.synth.things import Thing, fabric, sample_person, sample_things
from twohands.types import PinholeCamera

_FABRIC_STREAM = 1 << 48
"""Offset of the seeds that draw fabrics, apart from those of instances."""
MAX_TRIES = 400
TRIES_PER_VIEW = 10
"""Attempts to pose a person before another camera: some narrow views show no hand of the box."""
SHAPE_RANK = 24
"""Leading shape directions that random people use; the rest are below what a picture shows."""


PATTERNS = 16
"""Different patterns of veins, creases and spots; painting one takes longer than drawing a picture, so renderers keep
them."""


@dataclass(frozen=True, slots=True)
class SkinDetail:
    """Small things on one person's skin; strengths are 0 (none) to 1.

    Attributes:
        veins: on the back of the hand and on the forearm.
        creases: of palm, fingers and knuckles.
        freckles, moles: on the back of the hand and on the forearm.
        pattern: which pattern of all these, 0 to PATTERNS - 1.
    """

    veins: float
    creases: float
    freckles: float
    moles: float
    pattern: int


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """Look of one person's skin; colours are linear RGB albedo.

    Attributes:
        albedo: (3,) back of the hand.
        palm_albedo: (3,).
        nail_albedo: (3,).
        roughness: 0.25 (moist) to 0.7 (dry).
        mottle: strength of the blotchy variation, 0..1.
        seed: (3,) offset into the noise field.
        detail: veins, creases and freckles; None for smooth skin.
    """

    albedo: np.ndarray
    palm_albedo: np.ndarray
    nail_albedo: np.ndarray
    roughness: float
    mottle: float
    seed: np.ndarray
    detail: SkinDetail | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Clothes:
    """What covers the arms; colours are linear RGB albedo.

    Attributes:
        sleeve_from: where sleeves begin, on the way from the wrist (0) to the elbow (1); infinite without sleeves.
        glove_until: where gloves end on the same scale; minus infinity without gloves.
        sleeve_albedo, glove_albedo: (3,).
        pattern: (3,) strength, period in metres and direction (radians) of the sleeve's stripes.
        thickness_m: of the fabric.
        fabric: whose pattern sleeves and gloves have; None for plain or striped ones.
    """

    sleeve_from: float
    glove_until: float
    sleeve_albedo: np.ndarray
    glove_albedo: np.ndarray
    pattern: np.ndarray
    thickness_m: float
    fabric: Fabric | None = None


BARE = Clothes(np.inf, -np.inf, np.zeros(3), np.zeros(3), np.array([0.0, 0.01, 0.0]), 0.0)
"""Short sleeves, no gloves."""


@dataclass(frozen=True, slots=True, eq=False)
class Lighting:
    """Point lights and an ambient hemisphere, linear RGB.

    Attributes:
        positions: (L, 3) camera frame, metres.
        colours: (L, 3) radiant intensity; the fall-off is quadratic.
        sky, ground: (3,) ambient light from above and below.
    """

    positions: np.ndarray
    colours: np.ndarray
    sky: np.ndarray
    ground: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class SceneSpec:
    """Everything a renderer needs for one picture.

    Attributes:
        camera: intrinsics.
        shape: shape coefficients of the person.
        transforms: (48, 3, 4) rest-to-posed transforms of the bones, before scaling.
        scale: factor from the body's metres to the scene's (`SynthConfig.hand_length`).
        joints_m: (2, 22, 3) camera frame, scaled metres; NaN for an absent hand.
        present: (2,) bool.
        skin: the person's.
        lighting: lights.
        index: number of the instance.
        view: (3, 4) from the frame between the eyes (SPEC 5.1) to the camera, before scaling.
        clothes: sleeves and gloves.
        things: what the hands hold and wear, in the frame between the eyes, before scaling.
    """

    camera: PinholeCamera
    shape: np.ndarray
    transforms: np.ndarray
    scale: float
    joints_m: np.ndarray
    present: np.ndarray
    skin: Skin
    lighting: Lighting
    index: int
    view: np.ndarray = field(default_factory=lambda: np.eye(3, 4))
    clothes: Clothes = BARE
    things: tuple[Thing, ...] = ()

    @property
    def body(self) -> Body:
        """The person at rest."""
        return _body(tuple(self.shape.tolist()))


@lru_cache(maxsize=16)
def _body(shape: tuple[float, ...]) -> Body:
    return load_asset().body(np.array(shape) if shape else None)


@lru_cache(maxsize=16)
def _anatomy(shape: tuple[float, ...]) -> tuple[ArmAnatomy, ArmAnatomy]:
    body = _body(shape)
    return ArmAnatomy(body, LEFT), ArmAnatomy(body, RIGHT)


def instance_rng(seed: int, index: int) -> np.random.Generator:
    """The generator that owns instance `index` of the set with this seed, whatever the number of workers."""
    return np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=(index,)))


_FINGERS_WITH_THUMB = np.array(
    [(0, 0, 0, 0), (1, 0, 0, 0), (0, 0, 0, 1), (1, 0, 0, 1), (1, 1, 0, 0), (1, 1, 1, 0), (1, 1, 1, 1)], bool
)
"""Which fingers, index to little, people stretch with the thumb: thumbs up, L, shaka, horns, three, four, five."""


def sample_angles(
    rng: np.random.Generator, shape: tuple[int, ...] = (), gestures: float = SynthConfig.gestures
) -> HandAngles:
    """Random angles within the ranges of a healthy adult hand, or of an array of hands of the given shape.

    Fingers are drawn together (fists, flat hands, grasps; 47 % of the hands that are no gestures), each on its own
    (free poses; 35 %), or as a pinching or hooked hand (18 %), so that common hand shapes and odd ones both occur.

    Args:
        rng: source of randomness.
        shape: of the array.
        gestures: share of hands that point or count: some fingers out, the others curled; half of them with the thumb
            out as well.
    """
    others = (1 - gestures) / 0.85
    kinds = np.cumsum([0.4 * others, 0.3 * others, gestures])
    deg = np.radians
    kind = np.searchsorted(kinds, rng.random(shape), side="right")
    # Together: flat hand to fist.
    together = rng.uniform(-0.05, 1.0, shape)[..., None, None] + rng.normal(0, 0.10, (*shape, 4, 2))
    # Free: every joint on its own.
    free = rng.uniform(-0.1, 1.0, (*shape, 4, 2))
    # Some fingers out, the others curled: pointing, counting, thumbs up.
    thumb_out = rng.random(shape) < 0.5
    usual = _FINGERS_WITH_THUMB[rng.integers(len(_FINGERS_WITH_THUMB), size=shape)]
    out = np.where(thumb_out[..., None], usual, rng.random((*shape, 4)) < 0.5)[..., None]
    fist = rng.uniform(0.6, 0.9, (*shape, 1, 1)) + rng.normal(0, 0.05, (*shape, 4, 2))
    some = np.where(out, rng.uniform(-0.1, 0.15, (*shape, 4, 2)), fist)
    # Knuckles bent, fingers rather straight, or the reverse: pinch and hook.
    pinch = rng.uniform(0, 1, (*shape, 1, 2)) + rng.normal(0, 0.08, (*shape, 4, 2))
    curl = np.choose(kind[..., None, None], [together, free, some, pinch])
    curl = np.clip(curl, -0.15, 1.0)
    mcp = deg(-5 + 88 * curl[..., 0])
    pip = deg(4 + 98 * np.clip(curl[..., 1], 0, 1))
    dip = pip * rng.uniform(0.4, 0.8, (*shape, 4)) + deg(rng.normal(0, 3, (*shape, 4)))
    openness = rng.uniform(-0.4, 1.0, (*shape, 1))
    # A bent knuckle cannot spread: its side ligaments are tight.
    room = np.cos(np.clip(mcp, 0, deg(80))) ** 2
    spread = (deg([10.0, 2.0, -6.0, -14.0]) * openness + deg(rng.normal(0, 3, (*shape, 4)))) * room
    # Spread of the thumb as measured on people: beside the index, spread out, or opposed to the other fingers.
    beside = rng.random((*shape, 1)) < 0.25
    base = np.where(
        beside,
        rng.uniform([2, -4], [22, 14], (*shape, 2)),
        np.clip(rng.normal([29, 27], [13, 14], (*shape, 2)), [-2, -4], [56, 54]),
    )
    # It lies over a curled index finger, or beside it, but not where that finger is.
    aside = np.where(curl[..., 0, :].min(-1) > 0.45, rng.uniform(32, 56, shape), -2)
    base[..., 0] = np.maximum(base[..., 0], aside)
    bent = np.concatenate([base, rng.uniform([0, -12], [50, 65], (*shape, 2))], axis=-1)
    straight = rng.uniform([36, -4, 0, -12], [56, 32, 14, 12], (*shape, 4))
    thumb = deg(np.where(((kind == 2) & thumb_out)[..., None], straight, bent))
    return HandAngles(
        pronation=deg(rng.uniform(-75, 75, shape)),
        wrist_flexion=deg(np.clip(rng.normal(-5, 28, shape), -60, 60)),
        wrist_deviation=deg(np.clip(rng.normal(-4, 11, shape), -28, 20)),
        cup=deg(rng.uniform(0, 14, shape)),
        thumb=thumb,
        fingers=np.stack([spread, mcp, pip, dip], axis=-1),
    )


_MONK_SRGB = np.array(
    [
        [246, 237, 228],
        [243, 231, 219],
        [247, 234, 208],
        [234, 218, 186],
        [215, 189, 150],
        [160, 126, 86],
        [130, 92, 67],
        [96, 65, 52],
        [58, 49, 42],
        [41, 36, 32],
    ]
)
"""The ten tones of the Monk Skin Tone scale (Google, CC BY 4.0), sRGB."""


def sample_skin(config: SynthConfig, rng: np.random.Generator) -> Skin:
    """Skin whose tone is even over the Monk scale, with the variation of hue that one tone covers."""
    tone = rng.uniform(*config.skin_tones) * (len(_MONK_SRGB) - 1)
    low = min(int(tone), len(_MONK_SRGB) - 2)
    srgb = (_MONK_SRGB[low] * (1 - tone + low) + _MONK_SRGB[low + 1] * (tone - low)) / 255
    albedo = srgb**2.2
    # The printed scale is paler than lit skin; blood reddens and deepens it.
    albedo = albedo * np.array([0.86, 0.60, 0.46]) ** rng.uniform(0.75, 1.5) * rng.uniform(0.9, 1.2)
    albedo = np.clip(albedo * np.exp(rng.normal(0, 0.03, 3)), 0.012, 0.9)
    pale = np.array([0.62, 0.36, 0.27])
    palm = albedo + (pale - albedo) * np.where(albedo < pale, 0.38, 0.12)
    nail = albedo + (np.array([0.75, 0.52, 0.45]) - albedo) * 0.4
    return Skin(albedo, palm, nail, rng.uniform(0.3, 0.7), rng.uniform(0.2, 1.0), rng.uniform(-100, 100, 3))


def sample_skin_detail(config: SynthConfig, rng: np.random.Generator) -> SkinDetail | None:
    """Small things on the skin: veins mostly faint, creases on everybody, freckles on three people of ten, moles on
    six."""
    if config.skin_detail == 0:
        return None
    spots = rng.uniform(0.2, 1.0, 2) * (rng.random(2) < [0.3, 0.6])
    strengths = config.skin_detail * np.array([rng.beta(1.2, 1.8), rng.uniform(0.35, 1.0), *spots])
    return SkinDetail(*strengths.tolist(), pattern=int(rng.integers(PATTERNS)))


def sample_lighting(config: SynthConfig, rng: np.random.Generator) -> Lighting:
    """Lights around and above the person, of random brightness, with slightly random colour."""
    count = config.lights
    direction = rng.normal(size=(count, 3)) * [1.0, 0.6, 1.0] + [0.0, -0.8, 0.0]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    distance = rng.uniform(0.9, 2.2, (count, 1))
    positions = direction * distance + [0.0, 0.1, 0.35]
    warmth = rng.normal(0, 0.07)  # what a camera's white balance leaves
    tint = np.exp(np.array([warmth, 0.0, -warmth]) + rng.normal(0, 0.035, (count, 3)))
    power = rng.dirichlet(np.full(count, 1.5))[:, None] * count * distance**2
    level = np.exp(rng.normal(0, 0.3))
    ambient = level * rng.uniform(0.12, 0.45)
    sky = ambient * np.exp(np.array([warmth, 0.0, -warmth]) + rng.normal(0, 0.04, 3))
    ground = sky * rng.uniform(0.3, 0.9) * np.exp(rng.normal(0, 0.1, 3))
    return Lighting(positions, tint * power * level * rng.uniform(0.16, 0.34), sky, ground)


def sample_shape(config: SynthConfig, rng: np.random.Generator) -> np.ndarray:
    """Shape coefficients of a random person: a blend of two sampled adults, drawn towards the average."""
    if config.body_variation == 0:
        return np.zeros(0)
    coefficients = load_asset().coefficients
    a, b = coefficients[rng.integers(len(coefficients), size=2)]
    blend = rng.uniform()
    return (config.body_variation * (a * blend + b * (1 - blend)))[:SHAPE_RANK].astype(np.float64)


def held_up(joints_m: np.ndarray) -> np.ndarray:
    """Which hands (..., 21, 3), camera frame, metres, are shown to the camera: palm or back within 45 degrees of facing
    it, the knuckles above the wrist within 60 degrees; (...) bool."""
    wrist, index, middle, little = (joints_m[..., joint, :] for joint in (WRIST, INDEX_MCP, ROOT, LITTLE_MCP))
    palm = np.cross(index - wrist, little - wrist)
    facing = np.abs((palm * middle).sum(-1)) / (np.linalg.norm(palm, axis=-1) * np.linalg.norm(middle, axis=-1))
    up = (wrist - middle)[..., 1] / np.linalg.norm(middle - wrist, axis=-1)
    return (facing > np.cos(np.pi / 4)) & (up > np.cos(np.pi / 3))


def inside_image(joints_m: np.ndarray, camera: PinholeCamera, margin: float) -> np.ndarray:
    """Which joints (..., 3) project into the image, `margin` (a fraction of its size) away from its border; (...)."""
    ahead = joints_m[..., 2] > 0.02
    px = project(np.where(ahead[..., None], joints_m, [0.0, 0.0, 1.0]), camera) / [camera.width, camera.height]
    return ahead & (px > margin).all(-1) & (px < 1 - margin).all(-1)


def sample_camera(config: SynthConfig, rng: np.random.Generator) -> tuple[PinholeCamera, np.ndarray]:
    """Intrinsics, and the (3, 4) transform from the frame between the eyes to the camera's."""
    camera = PinholeCamera.ego3dhands(config.width, config.height)
    if config.intrinsics is not None:
        camera = PinholeCamera(*config.intrinsics, config.width, config.height)
    if config.fov is not None:
        camera = PinholeCamera.from_fov(rng.uniform(*config.fov), config.width, config.height)
    if config.principal_shift:
        shift = rng.uniform(-config.principal_shift, config.principal_shift, 2) * [config.width, config.height]
        camera = dataclasses.replace(camera, cx=camera.cx + shift[0], cy=camera.cy + shift[1])
    pitch, roll = np.radians(rng.uniform(*config.pitch)), np.radians(rng.uniform(*config.roll))
    place = rng.uniform(-config.camera_shift, config.camera_shift, 3)
    kind = rng.random()
    if kind < config.webcam:  # on a screen or a shelf across the table
        place = rng.uniform([-0.2, -0.1, 0.55], [0.2, 0.4, 0.95])
        aim = looking_from(place, HANDS_CENTRE + rng.normal(0, 0.03, 3))
    elif kind < config.webcam + config.free_view:
        azimuth, height = rng.uniform(-np.pi, np.pi), rng.uniform(-0.9, 0.5)
        direction = np.array([np.sin(azimuth) * np.cos(height), np.sin(height), np.cos(azimuth) * np.cos(height)])
        place = HANDS_CENTRE + direction * rng.uniform(0.45, 1.0)
        aim = looking_from(place, HANDS_CENTRE + rng.normal(0, 0.03, 3))
    else:
        aim = rotation_about(np.array([1.0, 0.0, 0.0]), pitch)
    rotation = rotation_about(np.array([0.0, 0.0, 1.0]), roll) @ aim
    return camera, np.concatenate([rotation, -(rotation @ place)[:, None]], axis=1)


def looking_from(place: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(3, 3) rotation into the frame of an upright camera at `place` (3,) that looks at `target` (3,)."""
    forward = unit(target - place)
    right = unit(np.cross([0.0, 1.0, 0.0], forward))
    return np.stack([right, np.cross(forward, right), forward])


def sees_the_person(view: np.ndarray) -> bool:
    """Whether the head and body are, or may be, in front of a camera with the view (3, 4)."""
    return bool(moved(view, np.array([[0.0, 0.0, -0.09], [0.0, 0.35, -0.1]]))[:, 2].max() > 0.1)


def worn_on_the_head(view: np.ndarray) -> bool:
    """Whether a camera with the view (3, 4) sits about the eyes, not before the person or beside."""
    return bool(np.linalg.norm(view[:, :3].T @ view[:, 3]) < ABOUT_THE_EYES_M)


def moved(view: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (..., 3) after the rigid transform `view` (3, 4)."""
    return points @ view[:, :3].T + view[:, 3]


def viewed(view: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """Transforms (N, 3, 4), each followed by `view` (3, 4)."""
    return np.concatenate([view[:, :3] @ transforms[..., :3], moved(view, transforms[..., 3])[..., None]], axis=-1)


def sample_clothes(config: SynthConfig, rng: np.random.Generator) -> Clothes:
    """Sleeves and gloves in any colour, mostly muted, plain or striped."""
    has_sleeves, has_gloves = rng.random(2) < [config.sleeves, config.gloves]
    if not (has_sleeves or has_gloves):
        return BARE

    striped = rng.random() < 0.3
    pattern = np.array(
        [rng.uniform(0.2, 0.8) * striped, np.exp(rng.uniform(*np.log([0.003, 0.03]))), rng.uniform(0, 3)]
    )
    return Clothes(
        rng.uniform(0.02, 0.95) if has_sleeves else np.inf,
        rng.uniform(0.0, 0.25) if has_gloves else -np.inf,
        fabric(rng),
        fabric(rng),
        pattern,
        rng.uniform(0.0008, 0.006),
    )


def woven(clothes: Clothes, fabrics: FabricFolder | None, rng: np.random.Generator) -> Clothes:
    """The clothes, if there are any, made of one of the user's fabrics, if there are any."""
    if fabrics is None or clothes is BARE:
        return clothes
    fabric = fabrics.sample(rng, clothes.sleeve_albedo)
    return dataclasses.replace(
        clothes, fabric=fabric, sleeve_albedo=fabric.albedo, glove_albedo=fabric.albedo, pattern=BARE.pattern
    )


def sample_scene(config: SynthConfig, seed: int, index: int, fabrics: FabricFolder | None = None) -> SceneSpec:
    """One random instance.

    Args:
        config: distributions.
        seed: of the whole set.
        index: of the instance; the same (config, seed, index) gives the same scene anywhere.
        fabrics: for sleeves and gloves; plain and striped ones if None. Nothing else depends on them.

    Returns:
        The scene.

    Raises:
        InputError: the hand box cannot be reached or seen with this configuration.
    """
    rng = instance_rng(seed, index)
    for attempt in range(MAX_TRIES):
        if attempt % TRIES_PER_VIEW == 0:
            shape = sample_shape(config, rng)
            key = tuple(shape.tolist())
            body, anatomy = _body(key), _anatomy(key)
            camera, view = sample_camera(config, rng)
            present = rng.random(2) >= config.drop_rate
            if not present.any():
                present[rng.integers(2)] = True
            rotations = np.tile(np.eye(3), (2, BONES_PER_SIDE, 1, 1))
            joints = body.joints.copy()
            sides = [side for side in (LEFT, RIGHT) if present[side]]
            together = len(sides) == 2 and rng.random() < config.together
        first = int(rng.integers(2)) if together else 0
        partner = None
        for side in sides if first == 0 else sides[::-1]:
            arm = _pose_arm(config, anatomy[side], body, camera, view, rng, partner)
            if arm is None:
                break
            rotations[side], joints[side] = arm
            partner = joints[side, 1 + ROOT] if together else None
        if arm is None:
            continue
        if not (present.all() and hands_collide(body, joints)):
            break
    else:
        raise InputError(f"no pose fits the hand box {config.box_min} to {config.box_max}: enlarge or move it")

    scale = 1.0 if config.hand_length is None else config.hand_length / body.hand_length_m
    joints_m = np.where(present[:, None, None], moved(view, joints) * scale, np.nan)
    lighting = sample_lighting(config, rng)
    skin, clothes = sample_skin(config, rng), sample_clothes(config, rng)
    clothes = woven(clothes, fabrics, instance_rng(seed, _FABRIC_STREAM + index))
    bare = clothes.glove_until, clothes.sleeve_from
    transforms = forward_kinematics(body, rotations.reshape(-1, 3, 3))
    things = sample_things(config, body, transforms, joints, present, bare, rng)
    if sees_the_person(view):
        things += sample_person(body, transforms, present, skin.albedo, clothes.sleeve_albedo, rng)
    skin = dataclasses.replace(skin, detail=sample_skin_detail(config, rng))
    return SceneSpec(
        camera,
        shape,
        viewed(view, transforms),
        scale,
        joints_m,
        present,
        skin,
        dataclasses.replace(lighting, positions=moved(view, lighting.positions)),
        index,
        view,
        clothes,
        things,
    )


ABOUT_THE_EYES_M = 0.3
"""Farther from the point between the eyes than any `SynthConfig.camera_shift`, nearer than a webcam."""
HANDS_CENTRE = np.array([0.0, 0.05, 0.32])
"""Where cameras that are not on the head look: the middle of the hand boxes, metres, frame between the eyes."""
NEAR_PARTNER_M = (0.03, 0.13)
"""Range of the spread (standard deviation per axis) of the distance between two roots that are together."""


CANDIDATES, BATCHES = 10, 4
"""Arms drawn at once, and how often, before an attempt at a person fails."""


def _pose_arm(
    config: SynthConfig,
    anatomy: ArmAnatomy,
    body: Body,
    camera: PinholeCamera,
    view: np.ndarray,
    rng: np.random.Generator,
    partner: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Draws one arm, near the root `partner` of the other hand if there is one.

    Returns:
        Rotations (24, 3, 3) of its bones and its joints (22, 3) in the body's metres, or None if no arm was found that
        reaches the box, stays in the picture and out of itself.
    """
    low, high = hand_box(config, anatomy.side)
    shown = config.shown > 0 and rng.random() < config.shown
    for _ in range(BATCHES):
        target = rng.uniform(low, high, (CANDIDATES, 3))
        if partner is not None:
            spread = rng.uniform(*NEAR_PARTNER_M, (CANDIDATES, 1))
            target = np.clip(partner + rng.normal(0, 1, target.shape) * spread, low, high)
        rotations = anatomy.hand_rotations(sample_angles(rng, (CANDIDATES,), config.gestures))
        reached = anatomy.reach(rotations, anatomy.wrist_before(target), np.radians(rng.uniform(-10, 75, CANDIDATES)))
        joints = anatomy.joints(rotations)
        root = joints[:, 1 + ROOT]
        in_box = ((root > low) & (root < high)).all(-1)
        seen = moved(view, joints[:, 1:])
        inside = inside_image(seen, camera, config.image_margin).sum(-1) >= config.min_inside
        fitting = reached & in_box & inside
        if shown:
            fitting &= held_up(seen)
        for candidate in np.flatnonzero(fitting):
            if not hand_enters_itself(body, joints[candidate]):
                return rotations[candidate], joints[candidate]
    return None


def hand_box(config: SynthConfig, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the box that holds the root joint, mirrored for the right hand."""
    low, high = np.array(config.box_min), np.array(config.box_max)
    if side == RIGHT:
        low[0], high[0] = -config.box_max[0], -config.box_min[0]
    return low, high
