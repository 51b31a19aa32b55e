"""Both arms of somebody who makes gestures: of all candidates, a left and a right one that are possible."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Final

import numpy as np

from twohands.skeleton import LEFT, RIGHT
from twohands.synth.scene.arm_goals import ArmGoal, SolvedArms
from twohands.synth.scene.arm_goals import solved as solve
from twohands.synth.scene.body import BONES_PER_SIDE, arm_kinematics, carried
from twohands.synth.scene.collision import HANDS_TOUCH, hand_enters_itself, hands_collide
from twohands.synth.scene.config import SynthConfig
from twohands.synth.scene.figures import Figure, Posture, Y, Z, outline_of
from twohands.synth.scene.gestures import Gesture, Stage
from twohands.synth.scene.outline import Outline, enters_body
from twohands.synth.scene.pair_gestures import Pair
from twohands.synth.scene.people import after, body_bone, body_transforms, shoulder_moves
from twohands.synth.scene.pose import rotation_about
from twohands.synth.scene.sampling import inside_image
from twohands.synth.scene.spec import moved
from twohands.synth.scene.views import Viewpoint

SHOWN_INSIDE: Final = 9
"""So many do of a hand that is meant to be seen."""
NEAREST_M: Final = 0.09
"""Of a hand's joints before the lens."""
COLLARS: Final = [body_bone("clavicle.L"), body_bone("clavicle.R")]
"""Of BODY_BONES."""


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """What the hands of a pose may touch.

    Attributes:
        near: as of `collision.hands_collide`.
        presses_m: (2,) by which they may enter trunk and head (`ArmGoal.touches`).
        hidden: (2,) bool, whether it does not matter if they enter anything.
    """

    near: float | np.ndarray
    presses_m: np.ndarray
    hidden: np.ndarray

    @property
    def together(self) -> bool:
        """Whether the hands act together, and may touch where others may not."""
        return np.ndim(self.near) > 0

    def __or__(self, other: Contact) -> Contact:
        """What may be touched on the way from one pose to the other."""
        near = np.minimum(self.near, other.near)
        return Contact(near, np.maximum(self.presses_m, other.presses_m), self.hidden | other.hidden)


@dataclass(frozen=True, slots=True, eq=False)
class PosedArms:
    """Both arms of a figure, in the person's frame.

    Attributes:
        rotations: (2, 24, 3, 3) of their bones.
        transforms: (48, 3, 4) rest-to-posed.
        joints: (2, 22, 3).
        turns: (28, 3, 3) the posture's, with the collar bones'.
        doing: names of the gestures of left and right.
        contact: what the hands may touch.
    """

    rotations: np.ndarray
    transforms: np.ndarray
    joints: np.ndarray
    turns: np.ndarray
    doing: tuple[str, str]
    contact: Contact

    @classmethod
    def of(
        cls, person: Figure, rotations: np.ndarray, turns: np.ndarray, doing: tuple[str, str], contact: Contact
    ) -> PosedArms:
        """From the rotations of all bones."""
        shoulders = shoulder_moves(body_transforms(person.heads, turns))
        bones = arm_kinematics(person.body.heads.reshape(2, BONES_PER_SIDE, 3), rotations)
        transforms = after(shoulders[:, None], bones)
        joints = carried(person.body.joints, transforms)
        return cls(rotations, transforms.reshape(-1, 3, 4), joints, turns, doing, contact)


def _shoulders(rng: np.random.Generator, heights: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """(3, 3) turns of the left and right collar bones for hands so far below the eyes (metres): they rise with the
    arms, and move forwards or shrug a little by themselves."""
    shrug = rng.normal(0, 1.5) + (rng.uniform(4, 12) if rng.random() < 0.06 else 0.0)
    turns = []
    for sign, height in zip((1.0, -1.0), heights, strict=True):
        raised = shrug + rng.normal(0, 1.5) + 22 * np.clip((0.3 - height) / 0.55, 0, 1)
        forward = rng.normal(2, 3)
        turns.append(rotation_about(Z, sign * np.radians(raised)) @ rotation_about(Y, sign * np.radians(forward)))
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
    outline = outline_of(person, posture)
    pinhole = -(view[:, :3].T @ view[:, 3])
    stages = [_stage(person, posture, outline, side, pinhole) for side in (LEFT, RIGHT)]
    if isinstance(chosen, tuple):
        goals = [gesture(stage, rng) for gesture, stage in zip(chosen, stages, strict=True)]
        touch, names = None, tuple(gesture.__name__ for gesture in chosen)
    else:
        pair = chosen(stages[LEFT], stages[RIGHT], rng)
        goals, touch, names = list(pair.goals), pair.touch, (chosen.__name__,) * 2
    presses_m, hidden = np.array([goal.touches for goal in goals]), np.array([goal.hidden for goal in goals])
    contact = Contact(HANDS_TOUCH if touch is None else touch, presses_m, hidden)
    goals = [_mirrored(goal, stage) for goal, stage in zip(goals, stages, strict=True)]
    collars = _shoulders(rng, [float(goal.place[:, 1].mean()) for goal in goals])
    turns = posture.turns.copy()
    turns[COLLARS] = collars
    shoulders = shoulder_moves(body_transforms(person.heads, turns))
    solved = [
        solve(anatomy, goal, shoulder) for anatomy, goal, shoulder in zip(person.anatomy, goals, shoulders, strict=True)
    ]
    fit = [_fits(person, outline, *of, view, viewpoint, config) for of in zip(solved, goals, seen, strict=True)]
    both = _both(person, solved, fit, touch, rng)
    if both is None:
        return None
    rotations = np.stack([arms.rotations[i] for arms, i in zip(solved, both, strict=True)])
    return PosedArms.of(person, rotations, turns, (names[0], names[1]), contact)


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


def before_lens(points: np.ndarray) -> np.ndarray:
    """(...) bool, whether all joints (..., J, 3), camera's frame, are far enough before the lens, or all behind."""
    return np.asarray((points[..., 2] > NEAREST_M).all(-1) | (points[..., 2] < 0).all(-1))


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
    fits &= before_lens(points) | goal.hidden
    if seen:
        fits &= inside_image(points, viewpoint.camera, 0.0).sum(-1) >= SHOWN_INSIDE
    left = np.flatnonzero(fits)
    if not goal.hidden:
        left = left[~enters_body(outline, arms.joints[left], goal.touches)]
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
