"""What people do with one hand: which goal every gesture sets for the arm.

Frame: that between the eyes at rest of the person at hand (x right, y down, z forward, metres), in which the chest does
not move; a gesture is made in the side's own axes (x outwards), for many candidates at once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from twohands.skeleton import LEFT
from twohands.synth.scene.arm_goals import CANDIDATES, FINGERS_MIDDLE, FINGERTIPS, PALM, WRIST_POINT, ArmGoal
from twohands.synth.scene.hand_shapes import (
    cradling,
    fingers,
    fist,
    flat,
    gripping,
    mostly_pointing,
    pinching,
    pressing,
    relaxed,
    sampled,
)
from twohands.synth.scene.outline import Outline
from twohands.synth.scene.pose import HandAngles, unit


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """What one side's gestures are made for, in the side's own axes: x outwards, y down, z forward.

    Attributes:
        side: LEFT or RIGHT.
        shoulder: (3,) at rest.
        reach_m: longest distance from shoulder to wrist.
        outline: of the body, in the person's axes.
        upright: (3, 3) rotation from axes with gravity along y to the person's, in own axes.
        camera: (3,) the pinhole.
        seated: whether the person sits.
        table_y: how far below the eyes the table is, in axes with gravity along y; None without one.
    """

    side: int
    shoulder: np.ndarray
    reach_m: float
    outline: Outline
    upright: np.ndarray
    camera: np.ndarray
    seated: bool
    table_y: float | None

    @property
    def mirror(self) -> np.ndarray:
        """(3,) factors between own and the person's axes."""
        return np.array([-1.0 if self.side == LEFT else 1.0, 1.0, 1.0])

    def surface(self, places: np.ndarray, above: float | np.ndarray) -> np.ndarray:
        """(N, 3) places with their z on the front of the body, `above` metres before it."""
        z = self.outline.surface(places * self.mirror)
        z = np.where(np.isfinite(z), z, 0.0)
        return np.concatenate([places[:, :2], (z + above)[:, None]], axis=1)


def near(
    rng: np.random.Generator, direction: Sequence[float] | np.ndarray, spread: float, n: int = CANDIDATES
) -> np.ndarray:
    """(N, 3) unit vectors about a direction (3,) or (N, 3), with about `spread` radians of deviation."""
    wanted = unit(np.asarray(direction, float))
    return unit(wanted + rng.normal(0, spread, (n, 3)))


def within(rng: np.random.Generator, low: Sequence[float], high: Sequence[float], n: int = CANDIDATES) -> np.ndarray:
    """(N, 3) places in a box."""
    return rng.uniform(low, high, (n, 3))


DOWN_OUT: Final = np.array([0.55, 1.0, -0.25])
"""Where elbows mostly point."""


def elbows(rng: np.random.Generator, direction: np.ndarray | Sequence[float] | None = None) -> np.ndarray:
    """(N, 3) directions of the elbow."""
    return near(rng, DOWN_OUT if direction is None else direction, 0.22)


Gesture = Callable[[Stage, np.random.Generator], ArmGoal]
"""Of one hand, in the side's own axes."""


def hanging(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """Beside the thigh."""
    down = np.array([rng.uniform(0.12, 0.3), 1.0, rng.uniform(-0.08, 0.22)])
    aside = unit(down + rng.normal(0, 0.06, (CANDIDATES, 3)))
    place = stage.shoulder + aside * stage.reach_m * rng.uniform(0.95, 0.995)
    along, palm = near(rng, [0.05, 1, 0.12], 0.1), near(rng, [-1, 0, rng.uniform(-0.9, 0.2)], 0.2)
    return ArmGoal(place, along, palm, near(rng, [0.7, 0, -1], 0.2), relaxed(rng), WRIST_POINT, 0.9, touches=0.025)


def on_lap(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """On the thigh or between the thighs."""
    thighs = stage.outline.thighs
    if thighs is None:
        return hanging(stage, rng)
    hip, knee = thighs[stage.side] * stage.mirror
    share = rng.uniform(0.45, 0.95, (CANDIDATES, 1))
    place = hip + (knee - hip) * share + rng.uniform([-0.1, 0, 0], [0.03, 0, 0], (CANDIDATES, 3))
    place = place - stage.upright[:, 1] * (stage.outline.thigh_m + 0.03)
    along = near(rng, [rng.uniform(-0.7, 0.1), 0.15, 1], 0.15)
    palm = near(rng, stage.upright[:, 1] + [rng.uniform(-0.6, 0.1), 0, 0], 0.15)
    return ArmGoal(place, along, palm, elbows(rng, [1, 0.5, -0.5]), relaxed(rng), PALM, 0.9, touches=0.025)


def table_place(
    stage: Stage, rng: np.random.Generator, low: Sequence[float], high: Sequence[float], above: float
) -> np.ndarray:
    """(N, 3) places above the table, box in x and z (gravity's axes)."""
    height = 0.44 if stage.table_y is None else stage.table_y
    places = within(rng, [low[0], height - above, low[1]], [high[0], height - above + 1e-6, high[1]])
    return places @ stage.upright.T


def on_table(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """Flat, relaxed or as a fist on the table, or typing."""
    kind = rng.random()
    along = near(rng, [rng.uniform(-0.9, 0.2), 0.1, 1], 0.12) @ stage.upright.T
    if kind < 0.35:
        shape, above, palm = flat(rng), 0.02, [0, 1, 0]
    elif kind < 0.65:
        shape, above, palm = relaxed(rng), 0.035, [rng.uniform(-0.9, 0), 1, 0]
    elif kind < 0.85:
        shape, above, palm = fingers(rng, 28, 32, [20, 30, 8, 10], openness=0.2), 0.045, [-0.1, 1, 0.1]
    else:
        shape, above, palm = fist(rng), 0.05, [-1, rng.uniform(0, 0.8), 0]
    place = table_place(stage, rng, [-0.04, 0.24], [0.34, 0.5], above)
    return ArmGoal(place, along, near(rng, palm, 0.08) @ stage.upright.T, elbows(rng, [1, 0.7, -0.4]), shape, PALM, 0.7)


def writing(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """As with a pen on paper."""
    place = table_place(stage, rng, [-0.06, 0.24], [0.18, 0.42], 0.045)
    along, palm = near(rng, [-0.45, 0.15, 1], 0.12), near(rng, [-0.75, 0.7, 0], 0.12)
    return ArmGoal(
        place, along @ stage.upright.T, palm @ stage.upright.T, elbows(rng, [1, 0.7, -0.4]), pinching(rng), PALM, 0.6
    )


def shown(stage: Stage, rng: np.random.Generator, angles: HandAngles | None = None) -> ArmGoal:
    """Held up, palm or back to the camera: greetings, numbers, signs."""
    close = rng.random() < 0.25
    place = within(rng, [-0.02, -0.22, 0.12], [0.42, 0.42, 0.46])
    if close:  # towards the lens
        place = stage.shoulder + unit(
            stage.camera - stage.shoulder + rng.normal(0, 0.12, (CANDIDATES, 3))
        ) * rng.uniform(min(0.3, stage.reach_m), stage.reach_m, (CANDIDATES, 1))
    to_camera = unit(stage.camera - place)
    facing = to_camera * (1 if rng.random() < 0.7 else -1)
    along = near(rng, [rng.normal(0, 0.3), -1, rng.normal(0.1, 0.2)], 0.15)
    return ArmGoal(place, along, near(rng, facing, 0.28), elbows(rng), angles or sampled(rng), PALM, slack=0.75)


def open_palm(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """A wave or a stop."""
    return shown(stage, rng, flat(rng, rng.uniform(0.3, 1.0)))


def signing(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """Anywhere before chest and face, turned anyhow, as in sign language and talk."""
    place = within(rng, [-0.12, -0.05, 0.08], [0.32, 0.5, 0.45])
    along = near(rng, [rng.uniform(-1, 0.4), rng.uniform(-1, 0.5), rng.uniform(-0.1, 1)], 0.25)
    palm = near(rng, rng.normal(0, 1, 3), 0.4)
    return ArmGoal(place, along, palm, elbows(rng), sampled(rng), PALM, slack=1.3)


def talking(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """A loose hand before the belly or chest, palm up or inwards."""
    place = within(rng, [-0.02, 0.2, 0.16], [0.3, 0.5, 0.42])
    along = near(rng, [rng.uniform(-0.7, 0.3), rng.uniform(-0.5, 0.3), 1], 0.2)
    palm = near(rng, [-1, rng.uniform(-1, 0.7), rng.uniform(-0.5, 0.2)], 0.25)
    angles = relaxed(rng) if rng.random() < 0.5 else sampled(rng)
    return ArmGoal(place, along, palm, elbows(rng), angles, PALM, slack=0.9)


def pointing(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """At the camera, aside, up or at something before the person."""
    place = within(rng, [-0.1, -0.1, 0.15], [0.45, 0.42, 0.5])
    kind = rng.random()
    aim = (
        unit(stage.camera - place) if kind < 0.4 else near(rng, [rng.uniform(-0.9, 1), rng.uniform(-1, 0.3), 0.6], 0.2)
    )
    return ArmGoal(place, aim, near(rng, [-0.6, 0.8, 0], 0.35), elbows(rng), mostly_pointing(rng), PALM, slack=0.9)


def thumb_up(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """Or down, or a fist before the chest."""
    place = within(rng, [0.0, 0.0, 0.18], [0.34, 0.45, 0.45])
    up = -1 if rng.random() < 0.75 else 1
    thumb = [50, 4, 4, 4] if rng.random() < 0.7 else [44, 40, 38, 40]
    along = near(rng, [rng.uniform(-1, -0.2), rng.normal(0, 0.2), 0.6], 0.2)
    # The thumb's side is up where the palm looks inwards.
    palm = near(rng, [-0.6, 0, -0.8] if up < 0 else [0.7, 0, 0.6], 0.25)
    angles = fingers(rng, 74, 94, thumb, openness=0.0)
    return ArmGoal(place, along, palm, elbows(rng, None if up < 0 else [1, 0.1, 0]), angles, PALM, slack=1.0)


def at_face(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """Fingers on chin, cheek, mouth, nose, glasses, brow, temple, ear, hair or neck."""
    places = np.array(
        [
            *[(0.01, 0.108), (0.03, 0.1), (0.055, 0.06), (0.01, 0.075), (0.012, 0.04), (0.05, 0.0), (0.03, -0.04)],
            *[(0.062, 0.015), (0.05, -0.075), (0.045, 0.13)],
        ]
    )
    chosen = places[rng.integers(len(places))]
    place = np.concatenate([chosen + rng.normal(0, 0.008, (CANDIDATES, 2)), np.zeros((CANDIDATES, 1))], axis=1)
    place = stage.surface(place, 0.014)
    along = near(rng, [rng.uniform(-0.9, -0.1), rng.uniform(-1, -0.5), rng.uniform(-0.5, 0)], 0.2)
    palm = near(rng, [-0.35, 0, -1], 0.3)
    angles = [relaxed, flat, mostly_pointing, pinching, fist][int(rng.choice(5, p=[0.4, 0.2, 0.2, 0.1, 0.1]))](rng)
    return ArmGoal(place, along, palm, elbows(rng, [0.5, 1, 0.3]), angles, FINGERTIPS, slack=1.0, touches=0.02)


def chin_rest(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """The chin or cheek on a hand."""
    place = within(rng, [0.01, 0.115, -0.03], [0.06, 0.15, 0.03])
    along = near(rng, [-0.15, -1, -0.2], 0.15)
    palm = near(rng, [-0.6, -0.5, -0.8], 0.3)
    angles = fist(rng) if rng.random() < 0.5 else relaxed(rng)
    return ArmGoal(place, along, palm, elbows(rng, [0.4, 1, 0.5]), angles, FINGERS_MIDDLE, slack=0.9, touches=0.05)


def at_ear(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """As with a telephone."""
    place = within(rng, [0.125, 0.02, -0.07], [0.16, 0.08, -0.01])
    along, palm = near(rng, [-0.1, -1, -0.35], 0.15), near(rng, [-1, 0, 0.15], 0.12)
    return ArmGoal(place, along, palm, elbows(rng, [0.7, 1, 0.4]), cradling(rng), PALM, slack=0.8, touches=0.045)


def at_head(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """A hand in the hair or behind the head."""
    behind = rng.random() < 0.5
    place = (
        within(rng, [0.03, -0.06, -0.24], [0.09, 0.04, -0.19])
        if behind
        else within(rng, [0.03, -0.16, -0.16], [0.1, -0.11, -0.05])
    )
    along = near(rng, [-1, -0.4, -0.4] if behind else [-0.7, -0.7, -0.4], 0.2)
    palm = near(rng, [-0.2, 0.1, 1] if behind else [-0.5, 1, -0.2], 0.25)
    return ArmGoal(place, along, palm, near(rng, [1, -0.1, 0.35], 0.2), relaxed(rng), PALM, slack=1.2, touches=0.03)


def on_chest(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """A hand on the heart, the belly or the other shoulder."""
    places = [(0.02, 0.3), (-0.06, 0.26), (0.0, 0.42), (0.02, 0.52), (-0.12, 0.22)]
    chosen = np.array(places[rng.integers(len(places))])
    place = np.concatenate([chosen + rng.normal(0, 0.02, (CANDIDATES, 2)), np.zeros((CANDIDATES, 1))], axis=1)
    along = near(rng, [-1, rng.uniform(-0.6, 0.25), 0.05], 0.12)
    angles = flat(rng) if rng.random() < 0.5 else relaxed(rng)
    return ArmGoal(
        stage.surface(place, 0.036), along, near(rng, [0, 0, -1], 0.15), elbows(rng), angles, PALM, 0.8, 0.05
    )


def on_hip(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """Arms akimbo."""
    place = within(rng, [0.18, 0.6, -0.1], [0.23, 0.7, 0.0])
    along, palm = near(rng, [-0.5, 0.5, 0.6], 0.2), near(rng, [-1, 0.1, -0.3], 0.2)
    return ArmGoal(place, along, palm, near(rng, [1, 0, -0.5], 0.15), relaxed(rng), PALM, slack=1.0, touches=0.03)


def behind_back(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """Out of sight."""
    place = within(rng, [0.02, 0.58, -0.34], [0.12, 0.7, -0.28])
    along, palm = near(rng, [-1, 0.5, -0.1], 0.2), near(rng, [0, 0, -1], 0.3)
    return ArmGoal(place, along, palm, near(rng, [1, 0, -0.7], 0.15), relaxed(rng), WRIST_POINT, slack=2.5, hidden=True)


def in_pocket(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """In the pocket of the trousers or of a hood's front: the hand lies within the clothes."""
    place = within(rng, [0.15, 0.74, -0.06], [0.19, 0.8, 0.0])
    along, palm = near(rng, [-0.1, 1, 0.15], 0.12), near(rng, [-1, 0, -0.3], 0.2)
    return ArmGoal(place, along, palm, near(rng, [0.8, 0, -1], 0.2), relaxed(rng), WRIST_POINT, slack=1.5, hidden=True)


def reaching_down(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """Below the picture: on a keyboard, on the knees, on the arms of the chair."""
    place = within(rng, [0.08, 0.6, 0.05], [0.35, 0.72, 0.35])
    along, palm = near(rng, [-0.1, 0.5, 1], 0.2), near(rng, [-0.2, 1, 0], 0.2)
    return ArmGoal(place, along, palm, elbows(rng, [0.9, 0.5, -0.6]), relaxed(rng), WRIST_POINT, slack=1.0)


def holding(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """A cup, a bottle, a telephone: the thumb's side up."""
    place = within(rng, [-0.08, 0.08, 0.14], [0.3, 0.5, 0.42])
    along = near(rng, [rng.uniform(-1, 0.1), rng.uniform(-0.5, 0.25), 0.8], 0.15)
    return ArmGoal(place, along, near(rng, [-1, 0, -0.6], 0.15), elbows(rng), gripping(rng), PALM, slack=0.6)


def holding_flat(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """A plate, a book, a sheet, a tablet at its edge, the palm up or towards the person."""
    place = within(rng, [-0.02, 0.1, 0.2], [0.26, 0.48, 0.42])
    along = near(rng, [rng.uniform(-0.9, -0.1), rng.uniform(-0.8, 0.0), 0.6], 0.15)
    palm = near(rng, [-0.5, -0.8, -0.5], 0.25)
    return ArmGoal(place, along, palm, elbows(rng), pressing(rng), PALM, slack=0.8)


def reading_phone(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """A telephone before the chest, its screen to the face."""
    place = within(rng, [-0.08, 0.16, 0.2], [0.16, 0.42, 0.36])
    along = near(rng, [-1, -0.4, 0.35], 0.15)
    palm = near(rng, unit(np.array([0.0, 0.0, 0.05]) - place) + np.array([-0.2, 0, 0]), 0.12)
    return ArmGoal(place, along, palm, elbows(rng), cradling(rng), PALM, slack=0.9)


def holds_camera(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """Behind the lens: the camera is in this hand."""
    away = unit(stage.shoulder - stage.camera)
    place = stage.camera + near(rng, -away, 0.1) * 0.03 + [0.02, 0.06, 0]
    place = stage.shoulder + (place - stage.shoulder) * np.minimum(
        1, 0.93 * stage.reach_m / np.linalg.norm(place - stage.shoulder, axis=1, keepdims=True)
    )
    along = near(rng, [0.1, -0.8, 0.6], 0.2)
    return ArmGoal(
        place, along, near(rng, [-0.5, 0, -1], 0.3), elbows(rng), gripping(rng), WRIST_POINT, 2.5, hidden=True
    )
