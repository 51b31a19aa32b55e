"""The arms of whole people in motion: from gesture to gesture, along minimum-jerk movements that enter nothing.

Gestures are those of single pictures (`plans`). Every bone turns from one to the next at the pace of `motion`'s
movements, the fingers a little later than the arm; then the hands rest for a moment, or go on at once. What people
hold they would have to grasp and let go: here they hold nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from twohands.geometry.quaternions import between, quaternions, rotations
from twohands.skeleton import LEFT, RIGHT
from twohands.synth.scene.body import ARM_BONES
from twohands.synth.scene.collision import hand_enters_itself, hands_collide
from twohands.synth.scene.config import SynthConfig
from twohands.synth.scene.figures import X, Y, Z, outline_of
from twohands.synth.scene.motion import DRIFT_HZ, MAX_LAG, PEAK_SPEED, MotionConfig, minimum_jerk
from twohands.synth.scene.outline import enters_body
from twohands.synth.scene.people import body_bone
from twohands.synth.scene.plans import sample_plan
from twohands.synth.scene.pose import rotation_about
from twohands.synth.scene.posed_arms import COLLARS, Contact, PosedArms, before_lens, pose_arms
from twohands.synth.scene.spec import moved
from twohands.synth.scene.whole_people import Subject

TRIES: Final = 60
"""Gestures that are tried after one another before the hands stay where they are."""
ONE_ARM: Final = 0.35
"""Share of movements of one arm alone."""
CHECKED_S: Final = 1 / 30
"""Between the moments of a movement at which nothing may enter anything."""
DETOUR: Final = 1.3
"""Way of a hand from one gesture to the next over the straight one."""
SWINGING: Final = [ARM_BONES.index(name) for name in ("upperarm01", "lowerarm01", "wrist")]
"""Bones that drift."""
NODDING: Final = ("neck01", "neck03", "head")
NOD_RAD: Final = np.radians(5)
"""Largest turn of the head about each axis beside that of the posture."""
_HAND: Final = np.array([name.startswith(("finger", "metacarpal")) for name in ARM_BONES])
_BONES: Final = len(ARM_BONES)


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """Small slow turns about the axes of something that is held still.

    Attributes:
        amplitude, hz, phase: (..., 3, 2) of two waves about each axis, radians.
    """

    amplitude: np.ndarray
    hz: np.ndarray
    phase: np.ndarray

    @classmethod
    def of(cls, shape: tuple[int, ...], largest: float, rng: np.random.Generator) -> Drift:
        """Random ones, by at most `largest` radians."""
        size = (*shape, 3, 2)
        return cls(rng.uniform(0, largest / 2, size), rng.uniform(*DRIFT_HZ, size), rng.uniform(0, 2 * np.pi, size))

    def at(self, time: float) -> np.ndarray:
        """(..., 3, 3) rotations."""
        x, y, z = np.moveaxis((self.amplitude * np.sin(2 * np.pi * self.hz * time + self.phase)).sum(-1), -1, 0)
        axes = (np.broadcast_to(axis, (*x.shape, 3)) for axis in (X, Y, Z))
        turns = [rotation_about(axis, angle) for axis, angle in zip(axes, (x, y, z), strict=True)]
        return turns[0] @ turns[1] @ turns[2]


@dataclass(frozen=True, slots=True, eq=False)
class PeopleMotion:
    """The motion of somebody's arms as a function of time, in seconds.

    Attributes:
        subject: whose.
        keys: (M + 1, 2, 25, 4) quaternions of the collar bone and the bones of each arm between movements.
        contacts: (M + 1) what hands may touch there.
        starts, durations: (M, 2) of the movements of each arm; the next one begins when both have ended.
        lags: (M, 25) share of the duration after which a bone starts.
        arms, head: drift.
    """

    subject: Subject
    keys: np.ndarray
    contacts: tuple[Contact, ...]
    starts: np.ndarray
    durations: np.ndarray
    lags: np.ndarray
    arms: Drift
    head: Drift

    @property
    def end(self) -> float:
        """When the last movement ends."""
        return float((self.starts[-1] + self.durations[-1]).max()) if len(self.starts) else 0.0

    def then(
        self, key: np.ndarray, contact: Contact, starts: np.ndarray, durations: np.ndarray, lags: np.ndarray
    ) -> PeopleMotion:
        """The motion with one more movement."""
        return replace(
            self,
            keys=np.concatenate([self.keys, key[None]]),
            contacts=(*self.contacts, contact),
            starts=np.concatenate([self.starts, starts[None]]),
            durations=np.concatenate([self.durations, durations[None]]),
            lags=np.concatenate([self.lags, lags[None]]),
        )

    def at(self, time: float) -> PosedArms:
        """The arms at one moment."""
        last = int((self.starts.min(axis=1) <= time).sum()) - 1 if len(self.starts) else -1
        if last < 0:
            now, contact = self.keys[0], self.contacts[0]
        else:
            begins = self.starts[last][:, None] + self.lags[last] * self.durations[last][:, None]  # (2, 25)
            share = minimum_jerk((time - begins) / (self.durations[last][:, None] * (1 - MAX_LAG)))
            now = between(self.keys[last], self.keys[last + 1], share)
            contact = self.contacts[last] | self.contacts[last + 1]
        turned = rotations(now)
        turned[:, [1 + bone for bone in SWINGING]] @= self.arms.at(time)
        turns = self.subject.posture.turns.copy()
        turns[COLLARS] = turned[:, 0]
        turns[[body_bone(name) for name in NODDING]] @= self.head.at(time)
        return PosedArms.of(self.subject.person, turned[:, 1:], turns, ("moving", "moving"), contact)


def plan_people_motion(
    config: SynthConfig,
    motion: MotionConfig,
    subject: Subject,
    first: PosedArms,
    seconds: float,
    rng: np.random.Generator,
) -> PeopleMotion:
    """Random motion of both arms that enters nothing, from one gesture to the next.

    Args:
        config: of the set.
        motion: distributions; `leave_rate` and the box do not apply, hands rest where gestures have them.
        subject: whose arms.
        first: what they do at the beginning.
        seconds: how long the motion lasts at least.
        rng: the only source of randomness.
    """
    drift = np.radians(motion.angular_drift)
    arms, head = Drift.of((2, len(SWINGING)), drift, rng), Drift.of((len(NODDING),), NOD_RAD / len(NODDING), rng)
    none = np.zeros((0, 2))
    plan = PeopleMotion(subject, _key(first)[None], (first.contact,), none, none, np.zeros((0, 1 + _BONES)), arms, head)
    now, waited = first, 0.0
    while plan.end + waited < seconds:
        for _ in range(TRIES):
            then = _gesture(config, subject, now, rng)
            if then is None:
                continue
            moves = np.abs(then.rotations - now.rotations).max(axis=(1, 2, 3)) > 1e-9
            durations = _durations(motion, now, then, moves, rng)
            pause = rng.uniform(*motion.pause) if rng.random() < motion.pause_rate else 0.0
            starts = plan.end + waited + pause + rng.uniform(0, 0.15, 2) * durations
            longer = plan.then(_key(then), then.contact, starts, durations, _lags(rng))
            if _sound(longer, float(starts.min())):
                plan, now, waited = longer, then, 0.0
                break
        else:
            waited += motion.pause[1]
    return plan


def _key(arms: PosedArms) -> np.ndarray:
    """(2, 25, 4)."""
    return quaternions(np.concatenate([arms.turns[COLLARS][:, None], arms.rotations], axis=1))


def _gesture(config: SynthConfig, subject: Subject, now: PosedArms, rng: np.random.Generator) -> PosedArms | None:
    """What the arms do next, or None where it is not possible: of one alone, or both; nothing that nobody sees."""
    chosen, seen = sample_plan(subject.viewpoint, subject.posture, False, rng)
    then = pose_arms(subject.person, subject.posture, chosen, seen, subject.view, subject.viewpoint, config, rng)
    if then is None or then.contact.hidden.any():
        return None
    if now.contact.together or then.contact.together or rng.random() >= ONE_ARM:
        return then
    stays = int(rng.integers(2))
    bones, turns, doing = then.rotations.copy(), then.turns.copy(), list(then.doing)
    collar = COLLARS[stays]
    bones[stays], turns[collar], doing[stays] = now.rotations[stays], now.turns[collar], now.doing[stays]
    return PosedArms.of(subject.person, bones, turns, (doing[LEFT], doing[RIGHT]), then.contact | now.contact)


def _durations(
    motion: MotionConfig, now: PosedArms, then: PosedArms, moves: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """(2,) seconds for the movements of both arms, such that they keep the bounds on speed."""
    low, high = np.log(motion.duration)
    drawn = np.exp(rng.uniform(low, high, 2))
    way_m = DETOUR * np.linalg.norm(then.joints[:, 1] - now.joints[:, 1], axis=-1)
    cosines = (np.trace(np.swapaxes(now.rotations, -1, -2) @ then.rotations, axis1=-2, axis2=-1) - 1) / 2
    turn = np.degrees(np.arccos(np.clip(cosines, -1, 1))).max(axis=1)
    least = PEAK_SPEED * np.maximum(way_m / motion.max_speed, turn / motion.max_angular_speed) / (1 - MAX_LAG)
    return np.where(moves, np.maximum(drawn, least), motion.duration[0])


def _lags(rng: np.random.Generator) -> np.ndarray:
    """(25,) the arm starts at once, the hand a little later."""
    return np.where(np.append(False, _HAND), rng.uniform(0, MAX_LAG), 0.0)


def _sound(motion: PeopleMotion, begin: float) -> bool:
    """Whether nothing enters anything from `begin` on, and nothing comes too near to the lens."""
    subject = motion.subject
    outline, body = outline_of(subject.person, subject.posture), subject.person.body
    times = np.append(np.arange(begin, motion.end, CHECKED_S), motion.end)
    order = np.concatenate([times[4::8], np.delete(times, np.s_[4::8])])  # every eighth first: most failures show there
    for time in order:
        arms = motion.at(float(time))
        near, free = before_lens(moved(subject.view, arms.joints[:, 1:])), ~arms.contact.hidden
        if (free & ~near).any() or hands_collide(body, arms.joints, arms.contact.near):
            return False
        if hand_enters_itself(body, arms.joints).any():
            return False
        presses_m = arms.contact.presses_m
        if any(free[side] and enters_body(outline, arms.joints[side], presses_m[side]) for side in (LEFT, RIGHT)):
            return False
    return True
