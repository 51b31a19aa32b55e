"""Scenes of whole people: who is there, how they sit or stand, what their hands do, and which camera sees it.

The hands that count are those of the first person, who is the largest in the picture; others stand or sit farther off.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from twohands.errors import InputError
from twohands.skeleton import LEFT, RIGHT
from twohands.synth.scene import gestures, props
from twohands.synth.scene.appearance import sample_lighting
from twohands.synth.scene.body import BONE_NAMES, BONES_PER_SIDE, Body, arm_kinematics
from twohands.synth.scene.collision import hand_enters_itself, hands_collide
from twohands.synth.scene.config import SynthConfig
from twohands.synth.scene.fabrics import FabricFolder
from twohands.synth.scene.gestures import ArmGoal, Gesture, Outline, Pair, SolvedArms, Stage
from twohands.synth.scene.looks import PersonLook, PersonSpec
from twohands.synth.scene.people import BODY_BONES, after, body_bone, body_transforms, load_people, shoulder_moves
from twohands.synth.scene.pose import ArmAnatomy, rotation_about
from twohands.synth.scene.sampling import inside_image
from twohands.synth.scene.spec import BARE, ArmMotion, Lighting, SceneSpec, Skin, moved, viewed
from twohands.synth.scene.things import Thing, muted_colour, sample_things
from twohands.synth.scene.views import Viewpoint, sample_viewpoint
from twohands.synth.scene.wardrobe import LONG_SLEEVES, Someone, sample_look, sample_someone

MAX_TRIES, TRIES_PER_PERSON, TRIES_PER_VIEW, TRIES_PER_PLAN = 480, 24, 8, 4
MIN_INSIDE: Final = 6
"""So many of a hand's 21 joints lie in the picture, or the hand is absent."""
SHOWN_INSIDE: Final = 9
"""So many do of a hand that is meant to be seen."""
NEAREST_M: Final = 0.09
"""Of a hand's joints before the lens."""
CLOTH_M: Final = 0.014
OTHERS: Final = (0.78, 0.17, 0.05)
"""Shares of pictures with no, one and two more people."""
HANDLESS: Final = 0.1
"""Share of pictures of people who show no hand on purpose; some rest in the picture all the same."""

SEATED: Final = {"webcam": 0.8, "selfie": 0.3, "room": 0.35, "shoulder": 0.9, "above": 1.0}
WITH_TABLE: Final = {"webcam": 0.35, "selfie": 0.1, "room": 0.3, "shoulder": 0.8, "above": 1.0}
"""Shares of people who sit, and of those at a table, by the style of the view."""
LOWEST_OVER_TABLE_M: Final = 0.3
"""A camera farther below the eyes would look at the table from beneath."""
MOVING: Final = 0.3
"""Share of pictures in which arms move during the exposure."""
TURNS_RAD: Final = (0.03, 0.4)
"""Typical turns of a forearm during it."""

_X, _Y, _Z = np.eye(3)

SHOWING: Final[tuple[tuple[Gesture, float], ...]] = (
    (gestures.shown, 0.26),
    (gestures.open_palm, 0.09),
    (gestures.signing, 0.2),
    (gestures.talking, 0.09),
    (gestures.pointing, 0.07),
    (gestures.thumb_up, 0.06),
    (gestures.at_face, 0.08),
    (gestures.chin_rest, 0.03),
    (gestures.at_ear, 0.03),
    (gestures.at_head, 0.02),
    (gestures.on_chest, 0.03),
    (gestures.holding, 0.05),
    (gestures.holding_flat, 0.03),
    (gestures.reading_phone, 0.04),
)
AT_TABLE: Final[tuple[tuple[Gesture, float], ...]] = (
    (gestures.on_table, 0.5),
    (gestures.writing, 0.16),
    (gestures.holding, 0.12),
    (gestures.reading_phone, 0.08),
    (gestures.holding_flat, 0.06),
    (gestures.talking, 0.08),
)
STANDING: Final[tuple[tuple[Gesture, float], ...]] = (
    (gestures.hanging, 0.6),
    (gestures.in_pocket, 0.12),
    (gestures.behind_back, 0.12),
    (gestures.on_hip, 0.1),
    (gestures.on_chest, 0.06),
)
SITTING: Final[tuple[tuple[Gesture, float], ...]] = (
    (gestures.on_lap, 0.45),
    (gestures.reaching_down, 0.4),
    (gestures.hanging, 0.15),
)
TOGETHER: Final[tuple[tuple[Pair, float], ...]] = (
    (gestures.praying, 0.13),
    (gestures.clapping, 0.14),
    (gestures.clasped, 0.16),
    (gestures.steepled, 0.08),
    (gestures.stacked, 0.13),
    (gestures.framing, 0.14),
    (gestures.folded, 0.09),
    (gestures.both_at_face, 0.05),
    (gestures.holding_between, 0.08),
)

MOVABLE: Final = frozenset(
    gesture.__name__
    for gesture in (
        *(gestures.shown, gestures.open_palm, gestures.signing, gestures.talking, gestures.pointing, gestures.thumb_up),
        *(gestures.clapping, gestures.framing, gestures.hanging, gestures.at_face, gestures.stacked),
    )
)
"""Names of gestures in which arms may move."""


@dataclass(frozen=True, eq=False)
class Figure:
    """Somebody ready to be posed.

    Attributes:
        someone: who.
        body: their arms at rest.
        anatomy: (LEFT, RIGHT).
        heads: (28, 3) of the body's bones at rest.
        outline: of the naked, standing body with some cloth.
    """

    someone: Someone
    body: Body
    anatomy: tuple[ArmAnatomy, ArmAnatomy]
    heads: np.ndarray
    outline: Outline


@dataclass(frozen=True, slots=True, eq=False)
class Posture:
    """How somebody sits or stands.

    Attributes:
        turns: (28, 3, 3) of the body's bones.
        lean: (3, 3) rotation from the person's frame to axes with gravity along y.
        seated: whether they sit.
        table_y: how far below the eyes a table is; None without one.
    """

    turns: np.ndarray
    lean: np.ndarray
    seated: bool
    table_y: float | None


@dataclass(frozen=True, slots=True, eq=False)
class PosedArms:
    """Both arms of a figure, in the person's frame.

    Attributes:
        transforms: (48, 3, 4) rest-to-posed.
        joints: (2, 22, 3).
        turns: (28, 3, 3) the posture's, with the collar bones'.
        doing: names of the gestures of left and right.
    """

    transforms: np.ndarray
    joints: np.ndarray
    turns: np.ndarray
    doing: tuple[str, str]


@lru_cache(maxsize=1)
def _trunk_rows() -> np.ndarray:
    """Rows of the asset's points on the skin of trunk, head and legs."""
    asset = load_people()
    skin = np.unique(asset.skin_source)
    return skin[asset.weights[skin][:, len(BODY_BONES) :].sum(1) < 0.5]


def figure(someone: Someone) -> Figure:
    """The person, ready to be posed."""
    asset = load_people()
    body = asset.arms_body(someone.shape)
    anatomy = ArmAnatomy(body, LEFT), ArmAnatomy(body, RIGHT)
    skin = asset.points(someone.shape)[_trunk_rows()]
    return Figure(someone, body, anatomy, asset.heads(someone.shape), Outline.of(skin, CLOTH_M))


def sample_posture(view: Viewpoint, rng: np.random.Generator) -> Posture:
    """Sits or stands as the view makes likely, leans a little, turns and tilts the head."""
    seated = bool(rng.random() < SEATED[view.style])
    at_table = seated and rng.random() < WITH_TABLE[view.style] and view.place[1] < LOWEST_OVER_TABLE_M
    lean, aside = np.radians(rng.normal(-4 if seated else 0, 7 if seated else 4)), np.radians(rng.normal(0, 3))
    turns = np.tile(np.eye(3), (len(BODY_BONES), 1, 1))
    nod, turn, tilt = np.radians(rng.normal([-25 if view.style == "above" else -3, 0, 0], [8, 12, 6]))
    if view.style in ("webcam", "selfie", "room") and view.place[2] > 0 and rng.random() < 0.65:  # into the lens
        turn += 0.8 * np.clip(np.arctan2(view.place[0], view.place[2]), -0.7, 0.7)
        nod -= 0.6 * np.clip(np.arctan2(view.place[1], np.hypot(view.place[0], view.place[2])), -0.5, 0.5) + lean
    for name, share in (("neck01", 0.2), ("neck03", 0.3), ("head", 0.5)):
        turns[body_bone(name)] = (
            rotation_about(_Y, share * turn) @ rotation_about(_X, share * nod) @ rotation_about(_Z, share * tilt)
        )
    # The chest stays; what is below it turns against it, so that hips and legs keep to gravity.
    bend = 0.6 * lean
    for name in ("spine02", "spine03", "spine04"):
        turns[body_bone(name)] = rotation_about(_X, bend / 3) @ rotation_about(_Z, 0.25 * aside)
    thigh = np.radians(rng.uniform(78, 92) if seated else 0.0) - 0.4 * lean
    for letter, sign in (("L", -1), ("R", 1)):
        spread = np.radians(rng.uniform(0, 14 if seated else 3)) * sign
        turns[body_bone(f"upperleg01.{letter}")] = rotation_about(_Y, spread if seated else 0.0) @ rotation_about(
            _X, thigh
        )
        turns[body_bone(f"lowerleg01.{letter}")] = rotation_about(
            _X, -np.radians(rng.uniform(70, 100)) if seated else 0.0
        )
    table = rng.uniform(0.40, 0.5) if at_table else None
    return Posture(turns, rotation_about(_X, lean) @ rotation_about(_Z, aside), seated, table)


def _outline(person: Figure, posture: Posture) -> Outline:
    """The body's, with the thighs of who sits."""
    if not posture.seated:
        return person.outline
    transforms = body_transforms(person.heads, posture.turns)
    ends = [[body_bone(f"{name}.{letter}") for name in ("upperleg01", "lowerleg01")] for letter in "LR"]
    thighs = (transforms[ends][..., :3] @ person.heads[ends][..., None])[..., 0] + transforms[ends][..., 3]
    return dataclasses.replace(person.outline, thighs=thighs)


def _choice(rng: np.random.Generator, options: tuple[tuple[Gesture, float], ...]) -> Gesture:
    weights = np.array([weight for _, weight in options])
    return options[int(rng.choice(len(options), p=weights / weights.sum()))][0]


def _shoulders(rng: np.random.Generator, heights: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """(3, 3) turns of the left and right collar bones for hands so far below the eyes (metres): they rise with the
    arms, and move forwards or shrug a little by themselves."""
    shrug = rng.normal(0, 1.5) + (rng.uniform(4, 12) if rng.random() < 0.06 else 0.0)
    turns = []
    for sign, height in zip((1.0, -1.0), heights, strict=True):
        raised = shrug + rng.normal(0, 1.5) + 22 * np.clip((0.3 - height) / 0.55, 0, 1)
        forward = rng.normal(2, 3)
        turns.append(rotation_about(_Z, sign * np.radians(raised)) @ rotation_about(_Y, sign * np.radians(forward)))
    return turns[0], turns[1]


def pose_arms(
    person: Figure,
    posture: Posture,
    chosen: tuple[Gesture, Gesture] | Pair,
    seen: tuple[bool, bool],
    view: np.ndarray,
    viewpoint: Viewpoint,
    config: SynthConfig,
    rng: np.random.Generator,
) -> PosedArms | None:
    """The arms of somebody who makes the chosen gestures, or None where none of a few tries is possible.

    Args:
        person, posture: who, and how they sit or stand.
        chosen: gestures of left and right, or of both together.
        seen: whether the left and the right hand must be in the picture.
        view: (3, 4) from the person's frame to the camera's.
        viewpoint: whose camera that is.
        config: of the set.
        rng: the only source of randomness.
    """
    outline = _outline(person, posture)
    pinhole = -(view[:, :3].T @ view[:, 3])
    stages = [_stage(person, posture, outline, side, pinhole) for side in (LEFT, RIGHT)]
    if isinstance(chosen, tuple):
        goals = [gesture(stage, rng) for gesture, stage in zip(chosen, stages, strict=True)]
        touch, names = None, tuple(gesture.__name__ for gesture in chosen)
    else:
        pair = chosen(stages[LEFT], stages[RIGHT], rng)
        goals, touch, names = list(pair.goals), pair.touch, (chosen.__name__,) * 2
    goals = [_mirrored(goal, stage) for goal, stage in zip(goals, stages, strict=True)]
    collars = _shoulders(rng, [float(goal.place[:, 1].mean()) for goal in goals])
    turns = posture.turns.copy()
    turns[[body_bone("clavicle.L"), body_bone("clavicle.R")]] = collars
    shoulders = shoulder_moves(body_transforms(person.heads, turns))
    solved = [
        gestures.solved(anatomy, goal, shoulder)
        for anatomy, goal, shoulder in zip(person.anatomy, goals, shoulders, strict=True)
    ]
    fit = [_fits(person, outline, *of, view, viewpoint, config) for of in zip(solved, goals, seen, strict=True)]
    both = _both(person, solved, fit, touch, rng)
    if both is None:
        return None
    rotations = np.stack([arms.rotations[i] for arms, i in zip(solved, both, strict=True)])
    bones = arm_kinematics(person.body.heads.reshape(2, BONES_PER_SIDE, 3), rotations)
    transforms = np.concatenate([after(shoulder, bone) for shoulder, bone in zip(shoulders, bones, strict=True)])
    joints = np.stack([arms.joints[i] for arms, i in zip(solved, both, strict=True)])
    return PosedArms(transforms, joints, turns, (names[0], names[1]))


def _stage(person: Figure, posture: Posture, outline: Outline, side: int, pinhole: np.ndarray) -> Stage:
    mirror = np.array([-1.0 if side == LEFT else 1.0, 1.0, 1.0])
    anatomy = person.anatomy[side]
    upright = mirror[:, None] * posture.lean.T * mirror
    reach = anatomy.max_reach
    return Stage(
        side, anatomy.shoulder * mirror, reach, outline, upright, pinhole * mirror, posture.seated, posture.table_y
    )


def _mirrored(goal: ArmGoal, stage: Stage) -> ArmGoal:
    """From the side's own axes to the person's."""
    m = stage.mirror
    return dataclasses.replace(
        goal, place=goal.place * m, along=goal.along * m, palm=goal.palm * m, elbow=goal.elbow * m
    )


def _fits(
    person: Figure,
    outline: Outline,
    arms: SolvedArms,
    goal: ArmGoal,
    seen: bool,
    view: np.ndarray,
    viewpoint: Viewpoint,
    config: SynthConfig,
) -> np.ndarray:
    """(N,) bool, which candidates are possible, and in the picture where they must be."""
    fits = arms.fits.copy()
    points = moved(view, arms.joints[:, 1:])
    fits &= (points[..., 2] > NEAREST_M).all(-1) | (points[..., 2] < 0).all(-1) | goal.hidden
    if seen:
        fits &= inside_image(points, viewpoint.camera, 0.0).sum(-1) >= SHOWN_INSIDE
    left = np.flatnonzero(fits)
    if not goal.hidden:
        left = left[~gestures.enters_body(outline, arms.joints[left], goal.touches)]
    left = left[~hand_enters_itself(person.body, arms.joints[left])]
    fits[:] = False
    fits[left] = True
    return fits


def _both(
    person: Figure, solved: list[SolvedArms], fit: list[np.ndarray], touch: np.ndarray | None, rng: np.random.Generator
) -> tuple[int, int] | None:
    """A left and a right candidate that leave each other in peace, the easier ones first; the same one of both where
    the hands act together."""
    if touch is None:
        left, right = (
            np.flatnonzero(f)[np.argsort((arms.strain + rng.uniform(0, 1, len(f)))[f])][:4]
            for arms, f in zip(solved, fit, strict=True)
        )
        pairs = np.array([(i, j) for i in left for j in right], int).reshape(-1, 2)
    else:
        fits = np.flatnonzero(fit[LEFT] & fit[RIGHT])
        strain = solved[LEFT].strain + solved[RIGHT].strain + rng.uniform(0, 1, len(fit[LEFT]))
        pairs = np.tile(fits[np.argsort(strain[fits])], (2, 1)).T
    if not len(pairs):
        return None
    joints = np.stack([solved[LEFT].joints[pairs[:, 0]], solved[RIGHT].joints[pairs[:, 1]]], axis=1)
    free = np.flatnonzero(
        ~(hands_collide(person.body, joints) if touch is None else hands_collide(person.body, joints, touch))
    )
    return None if not len(free) else (int(pairs[free[0], 0]), int(pairs[free[0], 1]))


def _plan(
    viewpoint: Viewpoint, posture: Posture, handless: bool, rng: np.random.Generator
) -> tuple[tuple[Gesture, Gesture] | Pair, tuple[bool, bool]]:
    """What the hands are to do, and which of them must be seen."""
    resting = SITTING if posture.seated else STANDING
    if viewpoint.side >= 0:
        own = _choice(rng, resting if handless else SHOWING)
        holds = gestures.holds_camera
        if viewpoint.side == LEFT:
            return (holds, own), (False, not handless)
        return (own, holds), (not handless, False)
    if handless:
        return (_choice(rng, resting), _choice(rng, resting)), (False, False)
    table = posture.table_y is not None and (viewpoint.style in ("above", "shoulder") or rng.random() < 0.35)
    if rng.random() < 0.32:
        pairs = np.array([weight for _, weight in TOGETHER])
        return TOGETHER[int(rng.choice(len(TOGETHER), p=pairs / pairs.sum()))][0], (True, True)
    options = AT_TABLE if table else SHOWING
    first = _choice(rng, options)
    kind = rng.random()
    second = (
        _choice(rng, options) if kind < 0.28 else first if kind < 0.42 else _choice(rng, AT_TABLE if table else resting)
    )
    right = rng.random() < 0.58
    both = kind < 0.42
    return ((second, first), (both, True)) if right else ((first, second), (True, both))


def draw_people(
    config: SynthConfig,
    index: int,
    rng: np.random.Generator,
    fabrics: FabricFolder | None,
    fabric_rng: np.random.Generator,
) -> SceneSpec:
    """One random picture of one to three whole people.

    Args:
        config: picture size, camera, light.
        index: number of the instance.
        rng: the only source of randomness but for the fabrics.
        fabrics: the user's, for what the first person wears; generated ones if None.
        fabric_rng: draws the fabric.

    Raises:
        InputError: no camera of this configuration sees a hand.
    """
    handless = bool(rng.random() < HANDLESS)
    for attempt in range(MAX_TRIES):
        if attempt % TRIES_PER_PERSON == 0:  # the fingers of some touch each other in every pose
            person = figure(sample_someone(rng))
        if attempt % TRIES_PER_VIEW == 0:
            viewpoint = sample_viewpoint(config, rng)
            posture = sample_posture(viewpoint, rng)
            view = after(viewpoint.view, np.c_[posture.lean, np.zeros(3)])
        if attempt % TRIES_PER_PLAN == 0:
            chosen, seen = _plan(viewpoint, posture, handless, rng)
        arms = pose_arms(person, posture, chosen, seen, view, viewpoint, config, rng)
        if arms is not None:
            break
    else:
        raise InputError("no pose of a whole person fits the picture: take a wider field of view")
    scale = 1.0 if config.hand_length is None else config.hand_length / person.body.hand_length_m
    joints = moved(view, arms.joints)
    present = inside_image(joints[:, 1:], viewpoint.camera, 0.0).sum(-1) >= MIN_INSIDE
    lighting = _lighting(config, viewpoint, rng)
    look_rng, thing_rng, others, still, worn_rng = rng.spawn(5)
    fabric = None if fabrics is None else fabrics.sample(fabric_rng, muted_colour(fabric_rng))
    look = sample_look(look_rng, person.someone, fabric)
    first = PersonSpec(
        look, person.someone.shape, viewed(view, arms.transforms), arms.turns, view, scale, np.ones(2, bool)
    )
    return SceneSpec(
        viewpoint.camera,
        person.someone.shape,
        first.arms,
        scale,
        np.where(present[:, None, None], joints * scale, np.nan),
        present,
        Skin(look.skin_albedo, look.palm_albedo, look.skin_albedo, look.skin_roughness, 0.5, look.seed),
        lighting,
        index,
        view,
        BARE,
        (*_things(config, person, posture, arms, thing_rng), *_worn(config, person, look, arms, worn_rng)),
        people=(first, *_others(config, viewpoint, scale, others)),
        motion=_motion(person, first, arms, still),
    )


def _motion(
    person: Figure, first: PersonSpec, arms: PosedArms, rng: np.random.Generator
) -> tuple[ArmMotion | None, ArmMotion | None]:
    """How the arms of some people move during the exposure; a hand that holds or touches something is still."""
    moves = rng.random() < MOVING
    motion: list[ArmMotion | None] = []
    for side in (LEFT, RIGHT):
        swing, bend = rng.normal(0, 1, (2, 3)) * np.exp(rng.uniform(*np.log(TURNS_RAD)))
        if not moves or arms.doing[side] not in MOVABLE or rng.random() < 0.25:
            motion.append(None)
            continue
        upper = BONE_NAMES.index(f"upperarm01.{'LR'[side]}")
        shoulder = moved(first.arms[upper], person.anatomy[side].shoulder) * first.scale
        motion.append(ArmMotion(shoulder, 0.4 * swing, bend))
    return motion[LEFT], motion[RIGHT]


def _lighting(config: SynthConfig, viewpoint: Viewpoint, rng: np.random.Generator) -> Lighting:
    """The lamps of hands' scenes, farther off, for a whole person needs more room."""
    lighting = sample_lighting(config, rng)
    farther, ambient = rng.uniform(1.2, 1.8), rng.uniform(1.0, 1.9)
    # People mostly turn towards the light, and whoever takes their picture does not stand against it.
    ahead = np.where(rng.random((len(lighting.positions), 1)) < 0.7, np.abs(lighting.positions), lighting.positions)
    positions = np.c_[lighting.positions[:, :2], ahead[:, 2]] @ rotation_about(_Y, -_azimuth(viewpoint))
    return dataclasses.replace(
        lighting,
        positions=moved(viewpoint.view, positions * farther),
        colours=lighting.colours * farther**2 * np.exp(rng.normal(0.3, 0.25)),
        sky=lighting.sky * ambient,
        ground=lighting.ground * ambient,
    )


def _azimuth(viewpoint: Viewpoint) -> float:
    """Of the camera, to the person's right of straight ahead, radians."""
    return float(np.arctan2(viewpoint.place[0], viewpoint.place[2]))


def _things(
    config: SynthConfig,
    person: Figure,
    posture: Posture,
    arms: PosedArms,
    rng: np.random.Generator,
) -> tuple[Thing, ...]:
    """What the first person holds, where the gesture is one of holding, and their table and chair."""
    upright = posture.lean.T
    things = props.furniture(posture.table_y, posture.seated, upright, rng)
    if config.objects == 0:
        return tuple(things)
    up = -upright[:, 1]
    if arms.doing[LEFT] == arms.doing[RIGHT] == "holding_between":
        return (*things, props.flat_between(arms.joints, rng))
    for side in (LEFT, RIGHT):
        held = _held(person.body, arms.joints, side, arms.doing[side], up, rng)
        if held is not None:
            things.append(held)
    return tuple(things)


def _worn(
    config: SynthConfig, person: Figure, look: PersonLook, arms: PosedArms, rng: np.random.Generator
) -> tuple[Thing, ...]:
    """A watch on a bare wrist, and rings."""
    sleeve = look.sleeve_from if look.outfit in LONG_SLEEVES else np.inf
    worn = dataclasses.replace(config, objects=0.0)
    return sample_things(worn, person.body, arms.transforms, arms.joints, np.ones(2, bool), (-np.inf, sleeve), rng)


def _held(
    body: Body, joints: np.ndarray, side: int, doing: str, up: np.ndarray, rng: np.random.Generator
) -> Thing | None:
    """What one hand holds that makes this gesture."""
    if doing == "holding":
        rod = None if rng.random() < 0.2 else props.rod_in_hand(body, joints, side, up, rng)
        return props.phone_in_hand(body, joints, side, up, rng) if rod is None else rod
    if doing in ("reading_phone", "at_ear"):
        return props.phone_in_hand(body, joints, side, up, rng)
    if doing == "writing":
        return props.pen_in_hand(joints, side, rng)
    return props.flat_in_hand(body, joints, side, rng) if doing == "holding_flat" else None


def _others(
    config: SynthConfig, viewpoint: Viewpoint, scale: float, rng: np.random.Generator
) -> tuple[PersonSpec, ...]:
    """People behind and beside the first one, smaller in the picture."""
    count = int(rng.choice(3, p=OTHERS))
    if viewpoint.style in ("above", "shoulder"):
        count = 0
    forward = -viewpoint.place * [1, 0, 1]
    away = forward / max(np.linalg.norm(forward), 1e-9)
    beside = np.array([away[2], 0.0, -away[0]]) * rng.choice([-1, 1])
    people = []
    for k in range(count):
        person = figure(sample_someone(rng))
        posture = sample_posture(viewpoint, rng)
        turn = rotation_about(_Y, np.radians(rng.normal(0, 25)))
        place = beside * rng.uniform(0.5, 0.9) * (1 if k == 0 else -1) + away * rng.uniform(0.25, 1.8)
        place = place + _Y * rng.normal(0, 0.12)
        view = after(viewpoint.view, np.c_[turn @ posture.lean, place])
        resting = SITTING if posture.seated else STANDING
        for _ in range(6):
            left, right = (_choice(rng, resting if rng.random() < 0.6 else SHOWING) for _ in (LEFT, RIGHT))
            arms = pose_arms(person, posture, (left, right), (False, False), view, viewpoint, config, rng)
            if arms is not None:
                look = sample_look(rng, person.someone)
                transforms = viewed(view, arms.transforms)
                shape = person.someone.shape
                people.append(PersonSpec(look, shape, transforms, arms.turns, view, scale, np.ones(2, bool)))
                break
    return tuple(people)
