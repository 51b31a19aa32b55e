"""What people do with their hands: goals for arms, and the arms that reach them.

Frame: that between the eyes at rest of the person at hand (x right, y down, z forward, metres), in which the chest does
not move. A gesture says where a part of the hand should be and how the palm should lie, for many candidates at once;
`solved` finds the arm to each, and `Outline` tells which of them leave trunk, head and lap in peace.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from twohands.skeleton import LEFT, RIGHT
from twohands.synth.scene.body import ARM_BONES
from twohands.synth.scene.collision import N_SEGMENTS, segment_distance
from twohands.synth.scene.pose import (
    ANGLE_LIMITS,
    ArmAnatomy,
    HandAngles,
    cross,
    dot,
    frame,
    rotation_about,
    signed_angle,
    unit,
)
from twohands.synth.scene.sampling import sample_angles

CANDIDATES: Final = 24
"""Arms tried at once for one gesture."""
_UPPER_ARM, _ELBOW, _TWIST, _WRIST = (
    ARM_BONES.index(name) for name in ("upperarm01", "lowerarm01", "lowerarm02", "wrist")
)
SHARPEST_ELBOW: Final = np.radians(36)
"""Between upper arm and forearm: flesh meets."""
SHARE_OF_TWIST: Final = 0.55
"""Of the forearm's pronation at its middle; the rest at the wrist (as `pose`)."""
PALM: Final = np.bincount([1, 6, 10, 14, 18], [0.28, 0.18, 0.18, 0.18, 0.18], 22)
WRIST_POINT: Final = np.bincount([1], [1.0], 22)
FINGERTIPS: Final = np.bincount([9, 13], [0.5, 0.5], 22)
THUMB_AND_INDEX: Final = np.bincount([5, 9], [0.5, 0.5], 22)
FINGERS_MIDDLE: Final = np.bincount([7, 11, 15], [1 / 3, 1 / 3, 1 / 3], 22)
"""Weights (22,) over elbow and hand joints of the point that a goal puts in place."""


@dataclass(frozen=True, slots=True, eq=False)
class ArmGoal:
    """Where one hand should be, for N candidates.

    Attributes:
        place: (N, 3) of the point `at`.
        along: (N, 3) unit, from the wrist to the middle knuckle.
        palm: (N, 3) unit, out of the palm; made normal to `along`.
        elbow: (N, 3) where the elbow points, seen from the line between shoulder and wrist.
        angles: fingers of the N hands; forearm and wrist follow from the goal.
        at: (22,) weights of the joints, elbow first, whose mean is put in place.
        slack: largest angle in radians by which the hand may lie otherwise than asked, where the wrist's limits say so.
        touches: metres by which the hand may enter trunk and head: it presses on them.
        hidden: whether it does not matter if the hand enters anything: nobody sees it.
    """

    place: np.ndarray
    along: np.ndarray
    palm: np.ndarray
    elbow: np.ndarray
    angles: HandAngles
    at: np.ndarray
    slack: float = 0.5
    touches: float = 0.0
    hidden: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class SolvedArms:
    """Answers to an `ArmGoal`.

    Attributes:
        rotations: (N, 24, 3, 3) of the arm's bones.
        joints: (N, 22, 3) where the person's frame has them, the shoulder moved.
        fits: (N,) bool, whether it is within reach and close to what was asked.
        strain: (N,) how far the wrist is from its middle, 0..about 3.
    """

    rotations: np.ndarray
    joints: np.ndarray
    fits: np.ndarray
    strain: np.ndarray


def solved(anatomy: ArmAnatomy, goal: ArmGoal, shoulder: np.ndarray) -> SolvedArms:
    """The arms that meet a goal as well as elbow and wrist let them.

    Args:
        anatomy: of the arm.
        goal: N candidates.
        shoulder: (3, 4) how the collar bone moves the arm as a whole.
    """
    turn, rotations = shoulder[:, :3], anatomy.hand_rotations(goal.angles)
    rotations[:, [_TWIST, _WRIST]] = np.eye(3)
    place, along = (goal.place - shoulder[:, 3]) @ turn, goal.along @ turn
    palm, elbow = goal.palm @ turn, goal.elbow @ turn
    offset = np.einsum("j,nja->na", goal.at, anatomy.joints(rotations)) - anatomy.wrist
    hand = frame(along, palm) @ frame(anatomy.hand_axis, anatomy.palmar).T
    reached = anatomy.reach_by(rotations, place - (hand @ offset[..., None])[..., 0], elbow)
    forearm = rotations[:, _UPPER_ARM] @ rotations[:, _ELBOW]
    angles = _wrist_angles(anatomy, np.swapaxes(forearm, -1, -2) @ hand)
    clipped = np.clip(angles, ANGLE_LIMITS[:3, 0] - _rests(anatomy), ANGLE_LIMITS[:3, 1] - _rests(anatomy))
    twist, flexion, deviation = clipped.T
    turned = rotation_about(anatomy.flexion_axis, flexion) @ rotation_about(anatomy.deviation_axis, deviation)
    rotations[:, _TWIST] = rotation_about(anatomy.pronation_axis, SHARE_OF_TWIST * twist)
    rotations[:, _WRIST] = rotation_about(anatomy.pronation_axis, (1 - SHARE_OF_TWIST) * twist) @ turned
    # What the wrist could not give moved the point: once more, with the hand as it lies now.
    hand_now = forearm @ rotation_about(anatomy.pronation_axis, twist) @ turned
    reached &= anatomy.reach_by(rotations, place - (hand_now @ offset[..., None])[..., 0], elbow)
    off = np.arccos(np.clip((np.trace(np.swapaxes(hand, -1, -2) @ hand_now, axis1=-2, axis2=-1) - 1) / 2, -1, 1))
    strain = (np.abs(clipped + _rests(anatomy)) / ANGLE_LIMITS[:3, 1]).sum(-1) + 2 * off
    joints = anatomy.joints(rotations)
    upper, lower = anatomy.shoulder - joints[:, 0], joints[:, 1] - joints[:, 0]
    bent = dot(upper, lower) / (anatomy.upper_length * anatomy.lower_length)
    fits = reached & (off < goal.slack) & (bent < np.cos(SHARPEST_ELBOW))
    return SolvedArms(rotations, joints @ turn.T + shoulder[:, 3], fits, strain)


def _rests(anatomy: ArmAnatomy) -> np.ndarray:
    """(3,) pronation, flexion and deviation at rest, radians."""
    return np.array([anatomy.pronation_rest, anatomy.wrist_flexion_rest, 0.0])


def _wrist_angles(anatomy: ArmAnatomy, turn: np.ndarray) -> np.ndarray:
    """(N, 3) turns about the axes of pronation, flexion and deviation, one after the other from the elbow on, that make
    the rotations `turn` (N, 3, 3) of the hand against the forearm."""
    twist, flex, deviate = anatomy.pronation_axis, anatomy.flexion_axis, anatomy.deviation_axis
    # Deviation leaves its own axis alone, pronation what lies along the forearm: that gives the flexion.
    turned = turn @ deviate
    a, b = twist @ deviate, twist @ cross(flex, deviate)
    size, phase = np.hypot(a, b), np.arctan2(b, a)
    apart = np.arccos(np.clip(turned @ twist / size, -1, 1))
    flexion = np.stack([phase + apart, phase - apart])
    flexion = (flexion + np.pi) % (2 * np.pi) - np.pi
    flexion = np.where(np.abs(flexion[0]) < np.abs(flexion[1]), flexion[0], flexion[1])
    bent = rotation_about(flex, flexion)
    pronation = signed_angle(bent @ deviate, turned, np.broadcast_to(twist, turned.shape))
    rest = np.swapaxes(rotation_about(twist, pronation) @ bent, -1, -2) @ turn
    return np.stack([pronation, flexion, signed_angle(flex + 0 * turned, rest @ flex, deviate + 0 * turned)], axis=-1)


CELL_M: Final = 0.02
_LOW, _CELLS = np.array([-0.36, -0.24]), (72, 36)
"""Corner (x, y) and (rows, columns) of the grid of an outline: down to the knees."""


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """How far a person's trunk and head reach forwards and backwards, and where the lap is.

    Attributes:
        front, back: (72, 36) z of the skin per cell of x and y; minus and plus infinity beside the body.
        inward: (72, 36) metres to the nearest edge of the body as seen from the front, negative beside it.
        thighs: (2, 2, 3) hips and knees, (LEFT, RIGHT), where the person sits; None where they stand.
        thigh_m: radius of a thigh.
    """

    front: np.ndarray
    back: np.ndarray
    inward: np.ndarray
    thighs: np.ndarray | None = None
    thigh_m: float = 0.085

    @classmethod
    def of(cls, skin: np.ndarray, cloth_m: float) -> Outline:
        """Of the resting trunk, head and legs, points (V, 3), under cloth of that thickness."""
        cells = np.floor((skin[:, :2] - _LOW) / CELL_M).astype(int)
        kept = ((cells >= 0) & (cells < _CELLS[::-1])).all(1)
        (column, row), z = cells[kept].T, skin[kept, 2]
        front, back = np.full(_CELLS, -np.inf, np.float32), np.full(_CELLS, np.inf, np.float32)
        np.maximum.at(front, (row, column), z)
        np.minimum.at(back, (row, column), z)
        around = np.ones((3, 3), np.uint8)
        front, back = np.asarray(cv2.dilate(front, around)), np.asarray(cv2.erode(back, around))
        # The outermost cells are there by the dilation, which closes the gaps between vertices.
        inward = np.asarray(cv2.distanceTransform(np.isfinite(front).astype(np.uint8), cv2.DIST_L2, 5)) - 1.5
        return cls(front + cloth_m, back - cloth_m, inward * CELL_M + cloth_m)

    def surface(self, points: np.ndarray) -> np.ndarray:
        """(...) z of the front of the body at the x and y of points (..., 2 or more)."""
        row, column = self._cells(points)
        return self.front[row, column]

    def _cells(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        cells = np.floor((points[..., :2] - _LOW) / CELL_M).astype(int)
        column, row = np.moveaxis(np.clip(cells, 0, np.array(_CELLS[::-1]) - 1), -1, 0)
        return row, column

    def depth(self, points: np.ndarray) -> np.ndarray:
        """(...) metres by which points (..., 3) lie within the body, negative outside."""
        row, column = self._cells(points)
        inside = np.minimum(self.front[row, column] - points[..., 2], points[..., 2] - self.back[row, column])
        inside = np.minimum(inside, self.inward[row, column])
        if self.thighs is not None:
            ends = self.thighs
            a = np.broadcast_to(points[..., None, :], (*points.shape[:-1], 2, 3))
            gap = segment_distance(a, a, np.broadcast_to(ends[:, 0], a.shape), np.broadcast_to(ends[:, 1], a.shape))
            inside = np.maximum(inside, self.thigh_m - gap.min(-1))
        return inside


_FOREARM_SHARES = np.array([0.25, 0.5, 0.75])[:, None]


def enters_body(outline: Outline, joints: np.ndarray, touches: float) -> np.ndarray:
    """(...) bool, whether hand or forearm of arms (..., 22, 3) enters the body by more than their flesh yields, and by
    `touches` metres more."""
    elbow, wrist = joints[..., :1, :], joints[..., 1:2, :]
    points = np.concatenate([joints[..., 1:, :], elbow + (wrist - elbow) * _FOREARM_SHARES], axis=-2)
    yields = np.r_[0.028, np.full(20, 0.008), np.full(3, 0.03)]
    return (outline.depth(points) > touches - yields + 0.004).any(-1)


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


def fingers(
    rng: np.random.Generator,
    mcp: float | Sequence[float],
    pip: float | Sequence[float],
    thumb: Sequence[float],
    *,
    openness: float = 0.2,
    noise: float = 5.0,
    n: int = CANDIDATES,
) -> HandAngles:
    """Hands about one shape.

    Args:
        rng: source of variation.
        mcp, pip: degrees, of all fingers or of index to little.
        thumb: (4,) degrees: radial, palmar, two flexions.
        openness: of the fingers, -0.4 close to 1 spread.
        noise: standard deviation in degrees.
        n: number of hands.
    """
    own = rng.normal(0, noise, (n, 1))
    bent = np.broadcast_to(np.asarray(mcp, float), (4,)) + own + rng.normal(0, noise / 2, (n, 4))
    middle = np.broadcast_to(np.asarray(pip, float), (4,)) + own + rng.normal(0, noise / 2, (n, 4))
    middle = np.maximum(middle, 4.0)
    spread = np.array([10.0, 2.0, -6.0, -14.0]) * (openness + rng.normal(0, 0.12, (n, 1)))
    spread = spread * np.cos(np.radians(np.clip(bent, 0, 80))) ** 2
    stacked = np.stack([spread, bent, middle, middle * rng.uniform(0.45, 0.75, (n, 1))], axis=-1)
    vector = np.zeros((n, 24))
    vector[:, 3] = rng.uniform(0, 10, n)
    vector[:, 4:8] = np.asarray(thumb) + rng.normal(0, noise, (n, 4))
    vector[:, 8:] = stacked.reshape(n, 16)
    return HandAngles.from_vector(np.clip(np.radians(vector), ANGLE_LIMITS[:, 0], ANGLE_LIMITS[:, 1]))


def relaxed(rng: np.random.Generator) -> HandAngles:
    """Hands at rest: half curled, the more so towards the little finger."""
    curl = rng.uniform(0.4, 1.3)
    return fingers(
        rng, list(curl * np.array([15, 20, 24, 28])), list(curl * np.array([28, 32, 34, 36])), [20, 20, 10, 15]
    )


def flat(rng: np.random.Generator, openness: float | None = None) -> HandAngles:
    """Open hands, fingers together or spread."""
    spread = rng.uniform(-0.3, 1.0) if openness is None else openness
    thumb = [rng.uniform(10, 50), rng.uniform(0, 25), 4, 4]
    return fingers(rng, rng.uniform(-4, 12), rng.uniform(4, 14), thumb, openness=spread, noise=4)


def _straight(rng: np.random.Generator) -> HandAngles:
    """Flat hands that bend a little back, as where they press on each other."""
    return fingers(rng, -9, 4, [rng.uniform(15, 40), 6, 4, 4], openness=rng.uniform(-0.15, 0.2), noise=2)


def fist(rng: np.random.Generator) -> HandAngles:
    """Closed hands, the thumb over the fingers."""
    return fingers(rng, 72, 92, [44, 40, 38, 40], openness=0.0)


def mostly_pointing(rng: np.random.Generator) -> HandAngles:
    """The index finger out."""
    return fingers(rng, [3, 68, 72, 74], [6, 92, 92, 90], [40, 36, 30, 30])


def pinching(rng: np.random.Generator) -> HandAngles:
    """Thumb and index finger meet, as about a pen."""
    return fingers(rng, [48, 50, 54, 58], [42, 48, 52, 54], [40, 42, 22, 26], openness=0.0)


def gripping(rng: np.random.Generator) -> HandAngles:
    """About a cup or a bottle."""
    curl = rng.uniform(0.65, 1.05)
    return fingers(rng, curl * 26, curl * 48, [34, 22, 14, 10], openness=0.1, noise=3)


def cradling(rng: np.random.Generator) -> HandAngles:
    """About a telephone that lies along the palm."""
    return fingers(rng, rng.uniform(18, 32), rng.uniform(16, 28), [42, 12, 10, 10], noise=3)


def pressing(rng: np.random.Generator) -> HandAngles:
    """Fingers on one side, thumb on the other, as about a plate, a book or the edge of a screen."""
    return fingers(rng, rng.uniform(30, 48), rng.uniform(8, 22), [38, 44, 4, 8], openness=0.0, noise=3)


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


def _table_place(
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
    place = _table_place(stage, rng, [-0.04, 0.24], [0.34, 0.5], above)
    return ArmGoal(place, along, near(rng, palm, 0.08) @ stage.upright.T, elbows(rng, [1, 0.7, -0.4]), shape, PALM, 0.7)


def writing(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """As with a pen on paper."""
    place = _table_place(stage, rng, [-0.06, 0.24], [0.18, 0.42], 0.045)
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
        ) * rng.uniform(0.3, stage.reach_m, (CANDIDATES, 1))
    to_camera = unit(stage.camera - place)
    facing = to_camera * (1 if rng.random() < 0.7 else -1)
    along = near(rng, [rng.normal(0, 0.3), -1, rng.normal(0.1, 0.2)], 0.15)
    return ArmGoal(place, along, near(rng, facing, 0.28), elbows(rng), angles or _sampled(rng), PALM, slack=0.75)


def _sampled(rng: np.random.Generator) -> HandAngles:
    """Any shape of fingers, half of them pointing or counting."""
    return sample_angles(rng, (CANDIDATES,), 0.5)


def open_palm(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """A wave or a stop."""
    return shown(stage, rng, flat(rng, rng.uniform(0.3, 1.0)))


def signing(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """Anywhere before chest and face, turned anyhow, as in sign language and talk."""
    place = within(rng, [-0.12, -0.05, 0.08], [0.32, 0.5, 0.45])
    along = near(rng, [rng.uniform(-1, 0.4), rng.uniform(-1, 0.5), rng.uniform(-0.1, 1)], 0.25)
    palm = near(rng, rng.normal(0, 1, 3), 0.4)
    return ArmGoal(place, along, palm, elbows(rng), _sampled(rng), PALM, slack=1.3)


def talking(stage: Stage, rng: np.random.Generator) -> ArmGoal:
    """A loose hand before the belly or chest, palm up or inwards."""
    place = within(rng, [-0.02, 0.2, 0.16], [0.3, 0.5, 0.42])
    along = near(rng, [rng.uniform(-0.7, 0.3), rng.uniform(-0.5, 0.3), 1], 0.2)
    palm = near(rng, [-1, rng.uniform(-1, 0.7), rng.uniform(-0.5, 0.2)], 0.25)
    angles = relaxed(rng) if rng.random() < 0.5 else _sampled(rng)
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
    shape = _straight(rng), _straight(rng)
    return _facing(middle, across, rng.uniform(0.015, 0.02), (along, along), shape, elbows(rng, [1, 0.7, 0]), near=0.4)


def clapping(left: Stage, right: Stage, rng: np.random.Generator) -> PairGoal:
    """Open palms that meet or part, one turned against the other."""
    middle = within(rng, [-0.06, 0.12, 0.2], [0.06, 0.45, 0.4])
    along = near(rng, [0, rng.uniform(-1, 0), 1], 0.12), near(rng, [rng.uniform(-0.5, 0.5), -1, 0.8], 0.12)
    across = near(rng, [1, rng.normal(0, 0.5), 0], 0.1)
    gap = rng.uniform(0.016, 0.03) if rng.random() < 0.5 else rng.uniform(0.03, 0.16, (CANDIDATES, 1))
    return _facing(middle, across, gap, along, (flat(rng), flat(rng)), elbows(rng), slack=0.9, near=0.4)


def _laced(rng: np.random.Generator) -> HandAngles:
    """Fingers bent and apart, for those of the other hand between them."""
    return fingers(rng, 52, 48, [36, 30, 10, 20], openness=0.7)


def clasped(left: Stage, right: Stage, rng: np.random.Generator) -> PairGoal:
    """One hand round the other, or fingers laced, before the chest, under the chin, on lap or table."""
    middle = within(rng, [-0.06, 0.16, 0.16], [0.06, 0.5, 0.34])
    if left.table_y is not None and rng.random() < 0.6:
        middle = _table_place(left, rng, [-0.08, 0.22], [0.08, 0.42], rng.uniform(0.04, 0.1)) * _X
    elif left.seated and rng.random() < 0.4:
        middle = within(rng, [-0.05, 0.52, 0.12], [0.05, 0.6, 0.28])
    elif not left.seated and rng.random() < 0.35:
        middle = within(rng, [-0.04, 0.52, 0.12], [0.04, 0.68, 0.24])
    tilt = rng.normal(0, 0.5)
    along = near(rng, [0.65, -0.3 + tilt, 0.75], 0.1), near(rng, [-0.65, -0.3 + tilt, 0.75], 0.1)
    across = near(rng, [1, 0, 0], 0.1)
    if rng.random() < 0.5:
        shape = _laced(rng), _laced(rng)
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
        angles = _sampled(rng), _sampled(rng)
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
