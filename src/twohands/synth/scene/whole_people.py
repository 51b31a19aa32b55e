"""Scenes of whole people: who is there, how they sit or stand, what their hands do, and which camera sees it.

The hands that count are those of the first person, who is the largest in the picture; others stand or sit farther off.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Final

import numpy as np

from twohands.errors import InputError
from twohands.skeleton import LEFT, RIGHT
from twohands.synth.scene import gestures, props
from twohands.synth.scene.appearance import sample_lighting
from twohands.synth.scene.body import Body, bone
from twohands.synth.scene.config import SynthConfig
from twohands.synth.scene.fabrics import FabricFolder
from twohands.synth.scene.figures import Figure, Posture, Y, figure, sample_posture
from twohands.synth.scene.looks import PersonLook, PersonSpec
from twohands.synth.scene.people import after
from twohands.synth.scene.plans import MOVABLE, SHOWING, SITTING, STANDING, choose, sample_plan
from twohands.synth.scene.pose import rotation_about
from twohands.synth.scene.posed_arms import PosedArms, pose_arms
from twohands.synth.scene.sampling import inside_image
from twohands.synth.scene.spec import ArmMotion, Lighting, SceneSpec, Skin, moved, viewed
from twohands.synth.scene.things import Thing, muted_colour, sample_things
from twohands.synth.scene.views import Viewpoint, sample_viewpoint
from twohands.synth.scene.wardrobe import LONG_SLEEVES, sample_look, sample_someone

MAX_TRIES, TRIES_PER_PERSON, TRIES_PER_VIEW, TRIES_PER_PLAN = 480, 24, 8, 4
MIN_INSIDE: Final = 6
"""So many of a hand's 21 joints lie in the picture, or the hand is absent."""
OTHERS: Final = (0.78, 0.17, 0.05)
"""Shares of pictures with no, one and two more people."""
DOING: Final = (0.35, 0.25, 0.4)
"""Shares of their hands that rest, show something, and are in a pocket."""
POCKETED: Final = ((gestures.in_pocket, 1.0),)
HANDLESS: Final = 0.1
"""Share of pictures of people who show no hand on purpose; some rest in the picture all the same."""
MOVING: Final = 0.3
"""Share of pictures in which arms move during the exposure."""
TURNS_RAD: Final = (0.03, 0.2)
"""Typical turns of a forearm during it."""


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """The first person before the camera.

    Attributes:
        person: who.
        posture: how they sit or stand.
        viewpoint: whose camera.
        view: (3, 4) from the person's frame to the camera's.
    """

    person: Figure
    posture: Posture
    viewpoint: Viewpoint
    view: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Setting:
    """All of a scene of people but what the first one's arms do, and what moves with them.

    Attributes:
        subject: the first person.
        look: of that person.
        scale: as of `SceneSpec`.
        lighting: lights.
        others: people farther off.
    """

    subject: Subject
    look: PersonLook
    scale: float
    lighting: Lighting
    others: tuple[PersonSpec, ...]

    def scene(self, arms: PosedArms, index: int) -> SceneSpec:
        """With the arms so, and no things."""
        person, view = self.subject.person, self.subject.view
        joints = moved(view, arms.joints)
        present = inside_image(joints[:, 1:], self.subject.viewpoint.camera, 0.0).sum(-1) >= MIN_INSIDE
        transforms, shape, look = viewed(view, arms.transforms), person.someone.shape, self.look
        return SceneSpec(
            self.subject.viewpoint.camera,
            shape,
            transforms,
            self.scale,
            np.where(present[:, None, None], joints * self.scale, np.nan),
            present,
            Skin(look.skin_albedo, look.palm_albedo, look.skin_albedo, look.skin_roughness, 0.5, look.seed),
            self.lighting,
            index,
            view,
            people=(PersonSpec(look, shape, transforms, arms.turns, view, self.scale, np.ones(2, bool)), *self.others),
        )


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
    subject, arms = sample_subject(config, bool(rng.random() < HANDLESS), rng)
    lighting = sample_people_lighting(config, subject.viewpoint, rng)
    look_rng, thing_rng, others, still, worn_rng = rng.spawn(5)
    setting = sample_setting(config, subject, lighting, fabrics, fabric_rng, look_rng, others)
    scene = setting.scene(arms, index)
    things = (*_things(config, subject, arms, thing_rng), *worn_on_arms(config, setting, arms, worn_rng))
    return dataclasses.replace(scene, things=things, motion=_motion(subject.person, scene.people[0], arms, still))


def sample_subject(config: SynthConfig, handless: bool, rng: np.random.Generator) -> tuple[Subject, PosedArms]:
    """Somebody before a camera, and what their arms do.

    Args:
        config: picture size, camera.
        handless: whether no hand is to be seen.
        rng: the only source of randomness.

    Raises:
        InputError: no camera of this configuration sees a hand.
    """
    for attempt in range(MAX_TRIES):
        if attempt % TRIES_PER_PERSON == 0:  # the fingers of some touch each other in every pose
            person = figure(sample_someone(rng))
        if attempt % TRIES_PER_VIEW == 0:
            viewpoint = sample_viewpoint(config, rng)
            posture = sample_posture(viewpoint, rng)
            view = after(viewpoint.view, np.c_[posture.lean, np.zeros(3)])
        if attempt % TRIES_PER_PLAN == 0:
            chosen, seen = sample_plan(viewpoint, posture, handless, rng)
        arms = pose_arms(person, posture, chosen, seen, view, viewpoint, config, rng)
        if arms is not None:
            return Subject(person, posture, viewpoint, view), arms
    raise InputError("no pose of a whole person fits the picture: take a wider field of view")


def sample_setting(
    config: SynthConfig,
    subject: Subject,
    lighting: Lighting,
    fabrics: FabricFolder | None,
    fabric_rng: np.random.Generator,
    look_rng: np.random.Generator,
    others_rng: np.random.Generator,
) -> Setting:
    """What somebody looks like, and who else is there; arguments as of `draw_people`, each with its own randomness."""
    person = subject.person
    scale = 1.0 if config.hand_length is None else config.hand_length / person.body.hand_length_m
    fabric = None if fabrics is None else fabrics.sample(fabric_rng, muted_colour(fabric_rng))
    look = sample_look(look_rng, person.someone, fabric)
    return Setting(subject, look, scale, lighting, _others(config, subject.viewpoint, scale, others_rng))


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
        shoulder = moved(first.arms[bone("upperarm01", side)], person.anatomy[side].shoulder) * first.scale
        motion.append(ArmMotion(shoulder, 0.4 * swing, bend))
    return motion[LEFT], motion[RIGHT]


def sample_people_lighting(config: SynthConfig, viewpoint: Viewpoint, rng: np.random.Generator) -> Lighting:
    """The lamps of hands' scenes, farther off, for a whole person needs more room."""
    lighting = sample_lighting(config, rng)
    farther, ambient = rng.uniform(1.2, 1.8), rng.uniform(1.0, 1.9)
    # People mostly turn towards the light, and whoever takes their picture does not stand against it.
    ahead = np.where(rng.random((len(lighting.positions), 1)) < 0.7, np.abs(lighting.positions), lighting.positions)
    positions = np.c_[lighting.positions[:, :2], ahead[:, 2]] @ rotation_about(Y, -_azimuth(viewpoint))
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


def furniture_of(posture: Posture, rng: np.random.Generator) -> list[Thing]:
    """Their table and chair."""
    return props.furniture(posture.table_y, posture.seated, posture.lean.T, rng)


def _things(config: SynthConfig, subject: Subject, arms: PosedArms, rng: np.random.Generator) -> tuple[Thing, ...]:
    """What the first person holds, where the gesture is one of holding, and their furniture."""
    things = furniture_of(subject.posture, rng)
    if config.objects == 0:
        return tuple(things)
    up = -subject.posture.lean[1]
    if arms.doing[LEFT] == arms.doing[RIGHT] == "holding_between":
        return (*things, props.flat_between(arms.joints, rng))
    for side in (LEFT, RIGHT):
        held = _held(subject.person.body, arms.joints, side, arms.doing[side], up, rng)
        if held is not None:
            things.append(held)
    return tuple(things)


def worn_on_arms(config: SynthConfig, setting: Setting, arms: PosedArms, rng: np.random.Generator) -> tuple[Thing, ...]:
    """A watch on a bare wrist, and rings; the same draws give the same ones on arms that have moved."""
    look, body = setting.look, setting.subject.person.body
    sleeve = look.sleeve_from if look.outfit in LONG_SLEEVES else np.inf
    worn = dataclasses.replace(config, objects=0.0)
    return sample_things(worn, body, arms.transforms, arms.joints, np.ones(2, bool), (-np.inf, sleeve), rng)


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
    """People behind and beside the first one, smaller in the picture, whose hands nobody sees: hands without labels
    would teach that hands of people farther off are none."""
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
        turn = rotation_about(Y, np.radians(rng.normal(0, 25)))
        place = beside * rng.uniform(0.5, 0.9) * (1 if k == 0 else -1) + away * rng.uniform(0.25, 1.8)
        place = place + Y * rng.normal(0, 0.12)
        view = after(viewpoint.view, np.c_[turn @ posture.lean, place])
        resting = SITTING if posture.seated else STANDING
        for _ in range(6):
            options = (resting, SHOWING, POCKETED)
            left, right = (choose(rng, options[rng.choice(3, p=DOING)]) for _ in (LEFT, RIGHT))
            arms = pose_arms(person, posture, (left, right), (False, False), view, viewpoint, config, rng)
            if arms is not None and not _sees_hand(arms, view, viewpoint):
                look = sample_look(rng, person.someone)
                transforms = viewed(view, arms.transforms)
                shape = person.someone.shape
                people.append(PersonSpec(look, shape, transforms, arms.turns, view, scale, np.ones(2, bool)))
                break
    return tuple(people)


def _sees_hand(arms: PosedArms, view: np.ndarray, viewpoint: Viewpoint) -> bool:
    """Whether a hand that is not in a pocket has a joint in the picture."""
    inside = inside_image(moved(view, arms.joints[:, 1:]), viewpoint.camera, 0.0).any(axis=1)
    return bool((inside & (np.array(arms.doing) != gestures.in_pocket.__name__)).any())
