"""What people do with both hands together. Frame: as in `gestures`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from twohands.skeleton import LEFT, RIGHT
from twohands.synth.scene.arm_goals import CANDIDATES, FINGERS_MIDDLE, PALM, ArmGoal
from twohands.synth.scene.collision import N_SEGMENTS
from twohands.synth.scene.gestures import Stage, elbows, near, table_place, within
from twohands.synth.scene.hand_shapes import (
    fingers,
    fist,
    flat,
    laced,
    mostly_pointing,
    pressing,
    relaxed,
    sampled,
    straight,
)
from twohands.synth.scene.pose import HandAngles, unit


@dataclass(frozen=True, slots=True, eq=False)
class PairGoal:
    """What both hands do together.

    Attributes:
        goals: (LEFT, RIGHT), each in its side's own axes; candidate i of one belongs to candidate i of the other.
        near: share of the radii's sum below which hands count as inside each other; below 1 where they press or fold
            into each other.
    """

    goals: tuple[ArmGoal, ArmGoal]
    near: float = 0.98

    @property
    def touch(self) -> np.ndarray:
        """(20, 20) `near` of every pair of segments; wrists are much thinner than the forearm's middle."""
        touch = np.full((N_SEGMENTS, N_SEGMENTS), self.near)
        touch[0] = touch[:, 0] = min(self.near, 0.5)
        return touch


Pair = Callable[[Stage, Stage, np.random.Generator], PairGoal]
"""Of both hands, from the stages of left and right."""
_X = np.array([-1.0, 1.0, 1.0])


def _facing(
    middle: np.ndarray,
    across: np.ndarray,
    gap: np.ndarray | float,
    along: tuple[np.ndarray, np.ndarray],
    angles: tuple[HandAngles, HandAngles],
    elbow: np.ndarray,
    *,
    slack: float = 0.7,
    touches: float = 0.0,
    near: float = 0.98,
) -> PairGoal:
    """Palm to palm.

    Args:
        middle: (N, 3) between the palms, person's axes.
        across: (N, 3) unit, from the left palm to the right one.
        gap: (N, 1) half the distance of the palms' bones.
        along: (N, 3) fingers of left and right, person's axes.
        angles: of left and right.
        elbow: (N, 3) own axes.
        slack, touches, near: see the classes.
    """
    goals = []
    for side, sign in ((LEFT, 1.0), (RIGHT, -1.0)):
        mirror = _X if side == LEFT else np.ones(3)
        place, palm = middle - sign * across * gap, across * sign
        goals.append(
            ArmGoal(place * mirror, along[side] * mirror, palm * mirror, elbow, angles[side], PALM, slack, touches)
        )
    return PairGoal((goals[0], goals[1]), near)


def praying(left: Stage, right: Stage, rng: np.random.Generator) -> PairGoal:
    """Palms together before chest or face, fingers up or forwards."""
    middle = within(rng, [-0.04, 0.06, 0.14], [0.04, 0.42, 0.36])
    along = near(rng, [0, -1, rng.uniform(-0.1, 0.9)], 0.08)
    across = near(rng, [1, rng.normal(0, 0.15), 0], 0.08)
    shape = straight(rng), straight(rng)
    return _facing(middle, across, rng.uniform(0.015, 0.02), (along, along), shape, elbows(rng, [1, 0.7, 0]), near=0.4)


def clapping(left: Stage, right: Stage, rng: np.random.Generator) -> PairGoal:
    """Open palms that meet or part, one turned against the other."""
    middle = within(rng, [-0.06, 0.12, 0.2], [0.06, 0.45, 0.4])
    along = near(rng, [0, rng.uniform(-1, 0), 1], 0.12), near(rng, [rng.uniform(-0.5, 0.5), -1, 0.8], 0.12)
    across = near(rng, [1, rng.normal(0, 0.5), 0], 0.1)
    gap = rng.uniform(0.016, 0.03) if rng.random() < 0.5 else rng.uniform(0.03, 0.16, (CANDIDATES, 1))
    return _facing(middle, across, gap, along, (flat(rng), flat(rng)), elbows(rng), slack=0.9, near=0.4)


def clasped(left: Stage, right: Stage, rng: np.random.Generator) -> PairGoal:
    """One hand round the other, or fingers laced, before the chest, under the chin, on lap or table."""
    middle = within(rng, [-0.06, 0.16, 0.16], [0.06, 0.5, 0.34])
    if left.table_y is not None and rng.random() < 0.6:
        middle = table_place(left, rng, [-0.08, 0.22], [0.08, 0.42], rng.uniform(0.04, 0.1)) * _X
    elif left.seated and rng.random() < 0.4:
        middle = within(rng, [-0.05, 0.52, 0.12], [0.05, 0.6, 0.28])
    elif not left.seated and rng.random() < 0.35:
        middle = within(rng, [-0.04, 0.52, 0.12], [0.04, 0.68, 0.24])
    tilt = rng.normal(0, 0.5)
    along = near(rng, [0.65, -0.3 + tilt, 0.75], 0.1), near(rng, [-0.65, -0.3 + tilt, 0.75], 0.1)
    across = near(rng, [1, 0, 0], 0.1)
    if rng.random() < 0.5:
        shape = laced(rng), laced(rng)
    else:
        closed, round_it = fist(rng), fingers(rng, 40, 46, [40, 40, 10, 20])
        shape = (closed, round_it) if rng.random() < 0.5 else (round_it, closed)
    return _facing(
        middle, across, rng.uniform(0.02, 0.03), along, shape, elbows(rng, [1, 0.8, -0.2]), slack=1.0, near=0.0
    )


def steepled(left: Stage, right: Stage, rng: np.random.Generator) -> PairGoal:
    """Fingertips meet."""
    middle = within(rng, [-0.04, 0.1, 0.18], [0.04, 0.4, 0.34])
    along = near(rng, [0.45, -0.8, 0.5], 0.08), near(rng, [-0.45, -0.8, 0.5], 0.08)
    across, shape = near(rng, [1, 0, 0], 0.06), fingers(rng, 14, 14, [40, 20, 6, 6], openness=0.8)
    return _facing(middle, across, rng.uniform(0.045, 0.06), along, (shape, shape), elbows(rng), slack=0.9, near=0.4)


def stacked(left: Stage, right: Stage, rng: np.random.Generator) -> PairGoal:
    """One hand on or in the other, across or along it: counting on a palm, rubbing, a hand on a hand."""
    middle = within(rng, [-0.08, 0.14, 0.2], [0.08, 0.48, 0.36])
    across = near(rng, [rng.normal(0, 0.3), (1 if rng.random() < 0.5 else -1), rng.normal(0, 0.4)], 0.1)
    along = near(rng, [0.8, -0.1, 0.7], 0.2), near(rng, [-0.8, -0.1, 0.7], 0.2)
    kinds = [flat, relaxed, mostly_pointing, fist]
    open_hand, other = flat(rng), kinds[int(rng.choice(4, p=[0.4, 0.2, 0.25, 0.15]))](rng)
    shape = (open_hand, other) if rng.random() < 0.5 else (other, open_hand)
    return _facing(middle, across, rng.uniform(0.016, 0.035), along, shape, elbows(rng), slack=1.1, near=0.1)


def framing(left: Stage, right: Stage, rng: np.random.Generator) -> PairGoal:
    """Both hands open before the body, facing each other or up: talk, sizes, a ball."""
    middle = within(rng, [-0.05, 0.12, 0.22], [0.05, 0.46, 0.4])
    along = near(rng, [0.2, rng.uniform(-0.7, 0.2), 1], 0.15), near(rng, [-0.2, rng.uniform(-0.7, 0.2), 1], 0.15)
    across, angles = near(rng, [1, 0, 0], 0.1), (flat(rng), flat(rng))
    if rng.random() < 0.5:
        angles = sampled(rng), sampled(rng)
    up = rng.uniform(-0.9, 0.3)  # palms turned up
    goal = _facing(middle, across, rng.uniform(0.07, 0.24, (CANDIDATES, 1)), along, angles, elbows(rng), slack=0.9)
    a, b = (replace(g, palm=unit(g.palm + np.array([0, up, 0]))) for g in goal.goals)
    return PairGoal((a, b))


def folded(left: Stage, right: Stage, rng: np.random.Generator) -> PairGoal:
    """Arms folded before the chest."""
    upper = int(rng.integers(2))
    height = rng.uniform(0.36, 0.46)
    goals = []
    for side, stage in ((LEFT, left), (RIGHT, right)):
        over = side == upper
        lower = height - 0.01 if over else height + 0.05
        place = within(rng, [-0.17, lower - 0.03, 0], [-0.09, lower + 0.04, 0])
        place = stage.surface(place, 0.085 if over else 0.035)
        place[:, 2] = np.maximum(place[:, 2], rng.uniform(0.06, 0.1) if over else 0.02)
        along = near(rng, [-1, rng.uniform(-0.45, 0), -0.25], 0.1)
        shape = relaxed(rng) if rng.random() < 0.6 else flat(rng, -0.1)
        elbow = elbows(rng, [0.7, 1, -0.1])
        goals.append(ArmGoal(place, along, near(rng, [0, 0.1, -1], 0.15), elbow, shape, PALM, 0.9, touches=0.08))
    return PairGoal((goals[0], goals[1]), near=0.1)


def both_at_face(left: Stage, right: Stage, rng: np.random.Generator) -> PairGoal:
    """Hands on cheeks, over mouth or eyes, or to the head."""
    height = rng.choice([0.085, 0.06, 0.01, -0.06])
    angles = flat(rng, rng.uniform(-0.3, 0.4)), flat(rng, rng.uniform(-0.3, 0.4))
    goals = []
    for stage, shape in ((left, angles[0]), (right, angles[1])):
        chosen = np.array([rng.uniform(0.02, 0.06), height])
        place = np.concatenate([chosen + rng.normal(0, 0.006, (CANDIDATES, 2)), np.zeros((CANDIDATES, 1))], axis=1)
        along, palm = near(rng, [-0.35, -1, -0.25], 0.12), near(rng, [-0.5, 0, -1], 0.15)
        place = stage.surface(place, 0.016)
        goals.append(ArmGoal(place, along, palm, elbows(rng), shape, FINGERS_MIDDLE, 1.0, touches=0.03))
    return PairGoal((goals[0], goals[1]), near=0.4)


def holding_between(left: Stage, right: Stage, rng: np.random.Generator) -> PairGoal:
    """A thing held with both hands: the thumbs before it."""
    middle = within(rng, [-0.05, 0.12, 0.2], [0.05, 0.45, 0.4])
    along = near(rng, [0.45, -0.75, 0.5], 0.08), near(rng, [-0.45, -0.75, 0.5], 0.08)
    across, shape = near(rng, [1, 0, 0], 0.04), (pressing(rng), pressing(rng))
    goal = _facing(middle, across, rng.uniform(0.06, 0.15, (CANDIDATES, 1)), along, shape, elbows(rng), slack=0.8)
    a, b = (replace(g, palm=unit(g.palm + np.array([0, -0.3, -1.0]))) for g in goal.goals)
    return PairGoal((a, b))
