"""Draws one scene: who, in which pose, under which light."""

from __future__ import annotations

import dataclasses
from functools import lru_cache

import numpy as np

from twohands.errors import InputError
from twohands.geometry.camera import project
from twohands.skeleton import INDEX_MCP, LEFT, LITTLE_MCP, RIGHT, ROOT, WRIST
from twohands.synth.scene.appearance import (
    sample_clothes,
    sample_lighting,
    sample_shape,
    sample_skin,
    sample_skin_detail,
    woven,
)
from twohands.synth.scene.body import BONES_PER_SIDE, Body, forward_kinematics
from twohands.synth.scene.collision import hand_enters_itself, hands_collide
from twohands.synth.scene.config import SynthConfig
from twohands.synth.scene.fabrics import FabricFolder
from twohands.synth.scene.pose import ArmAnatomy, HandAngles, rotation_about, unit
from twohands.synth.scene.spec import Clothes, SceneSpec, Skin, body_of, moved, viewed
from twohands.synth.scene.things import Thing, sample_person, sample_things
from twohands.types import PinholeCamera

MAX_TRIES = 400
TRIES_PER_VIEW = 10
"""Attempts to pose a person before another camera: some narrow views show no hand of the box."""


@lru_cache(maxsize=16)
def _anatomy(shape: tuple[float, ...]) -> tuple[ArmAnatomy, ArmAnatomy]:
    body = body_of(shape)
    return ArmAnatomy(body, LEFT), ArmAnatomy(body, RIGHT)


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


def draw_scene(
    config: SynthConfig,
    index: int,
    rng: np.random.Generator,
    fabrics: FabricFolder | None,
    fabric_rng: np.random.Generator,
) -> SceneSpec:
    """One random scene.

    Args:
        config: distributions.
        index: of the instance in its set.
        rng: draws all but the fabrics.
        fabrics: for sleeves and gloves; plain and striped ones if None. Nothing else depends on them.
        fabric_rng: draws one of them.

    Returns:
        The scene.

    Raises:
        InputError: the hand box cannot be reached or seen with this configuration.
    """
    for attempt in range(MAX_TRIES):
        if attempt % TRIES_PER_VIEW == 0:
            shape = sample_shape(config, rng)
            key = tuple(shape.tolist())
            body, anatomy = body_of(key), _anatomy(key)
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
    clothes = woven(clothes, fabrics, fabric_rng)
    transforms = forward_kinematics(body, rotations.reshape(-1, 3, 3))
    things = sample_belongings(config, body, transforms, joints, present, view, skin, clothes, rng)
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


def sample_belongings(
    config: SynthConfig,
    body: Body,
    transforms: np.ndarray,
    joints: np.ndarray,
    present: np.ndarray,
    view: np.ndarray,
    skin: Skin,
    clothes: Clothes,
    rng: np.random.Generator,
) -> tuple[Thing, ...]:
    """What the person holds and wears, and as much of the person beside the arms as the camera may see.

    Args:
        config: shares of hands that hold an object, wear a watch, wear a ring.
        body: the person.
        transforms: (48, 3, 4) posed bones, frame between the eyes, body's metres.
        joints: (2, 22, 3) in the same frame.
        present: (2,) bool.
        view: (3, 4) from the frame between the eyes to the camera.
        skin, clothes: the person's.
        rng: the only source of randomness.
    """
    bare = clothes.glove_until, clothes.sleeve_from
    things = sample_things(config, body, transforms, joints, present, bare, rng)
    if sees_the_person(view):
        things += sample_person(body, transforms, present, skin.albedo, clothes.sleeve_albedo, rng)
    return things


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
