"""Smooth motion of both hands: overlapping minimum-jerk movements between random poses.

A hand's state is a vector of 28 numbers (place of the wrist, swivel of the elbow, 24 angles of forearm and hand). A
movement m takes it from key pose m to key pose m + 1 along s(u) = 10 u^3 - 15 u^4 + 6 u^5, whose speed and
acceleration are zero at both ends, so every sum of movements is continuous to the second derivative. The next
movement may begin before the last one has ended: the state is

    x(t) = key_0 + sum over m of s((t - start_m) / duration_m) (key_{m+1} - key_m) + drift(t).

Movements begin and end in order, so that s of an earlier one is never below that of a later one. The state is then a
convex combination of keys, and whatever interval holds for the keys (joint limits, the box of the wrists) holds at
all times. Fingers start up to `MAX_LAG` of a movement after the arm, each at its own moment.

Speeds. A minimum-jerk movement over a distance D in time T peaks at 1.875 D / T and 5.774 D / T^2. Reaching 40 cm in
half a second, brisk but ordinary, peaks at 1.5 m/s and 9.2 m/s^2; a finger joint that flexes by 60 degrees in 200 ms,
the middle of the durations at which people were asked to pinch (Darling, Cole and Abbs 1988: 100, 200, 400 ms),
peaks at 560 degrees/s and 8,700 degrees/s^2. The defaults of `MotionConfig` bound the sum of two overlapping
movements near those figures; most movements are slower.

A held hand never freezes: a drift of a few millimetres and degrees below 1 Hz goes on throughout.

Source: Flash and Hogan 1985 (minimum jerk), Flash and Henis 1991 (superposition of movements); the paper's section
3.1 asks for independent random motion of both hands and says no more.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twohands.errors import InputError
from twohands.geometry.camera import project
from twohands.skeleton import LEFT, RIGHT, ROOT, SIDES
from twohands.synth.scene.body import Body
from twohands.synth.scene.collision import hand_enters_itself, hands_collide, segment_distance
from twohands.synth.scene.config import SynthConfig
from twohands.synth.scene.pose import ANGLE_LIMITS, ArmAnatomy, HandAngles
from twohands.synth.scene.sampling import hand_box, inside_image, sample_angles
from twohands.synth.scene.spec import moved
from twohands.types import PinholeCamera

WRIST_PART, SWIVEL, ANGLES = slice(0, 3), 3, slice(4, 28)
"""Parts of a state: wrist in the camera frame (body's metres), the elbow's swivel, `HandAngles.as_vector` (radians)."""
STATE_SIZE = 28
SWIVEL_LIMITS = np.radians([-12.0, 77.0])
PEAK_SPEED, PEAK_ACCELERATION = 1.875, 10 / np.sqrt(3)
"""Of a minimum-jerk movement over a unit of distance in a unit of time."""
MAX_LAG = 0.15
MAX_OVERLAP = 0.4
"""Shares of a movement: the latest start of a finger, and how much of it the next movement may overlap."""
DRIFT_WAVES = 3
DRIFT_HZ = (0.15, 0.8)
HEAD_CENTRE, HEAD_RADIUS = np.array([0.0, 0.0, -0.09]), 0.13
"""Sphere in the camera frame, metres, that no part of an arm beyond the elbow enters: the camera sits between the
eyes."""
KEY_TRIES, PATH_TRIES, START_TRIES, SETBACKS = 60, 12, 40, 200
"""Draws per key, keys per movement, first keys, and movements taken back, before giving up."""
_SEGMENTS = np.array([(0, 1), (1, 10)] + [(2 + 4 * f + i, 3 + 4 * f + i) for f in range(5) for i in range(3)])
"""Forearm, palm, phalanges, as pairs of 22-joint indices."""


@dataclass(frozen=True)
class MotionConfig:
    """Distributions of the motion. Lengths are metres of the body (before scaling to `SynthConfig.hand_length`)."""

    duration: tuple[float, float] = (0.35, 1.4)
    """Range of a movement's duration in seconds, drawn evenly in its logarithm; longer where the speeds ask for it."""
    pause_rate: float = 0.3
    """Probability of a pause after a movement; otherwise the next one overlaps its end."""
    pause: tuple[float, float] = (0.05, 0.9)
    """Range of a pause in seconds; twice that for a hand out of the picture."""
    leave_rate: float = 0.07
    """Probability that a movement takes the hand out of the picture of a camera on the head; never both hands."""
    arm_only_rate: float = 0.25
    """Probability that a movement keeps the fingers as they are."""
    hand_only_rate: float = 0.25
    """Probability that a movement keeps the wrist where it is."""
    max_speed: float = 1.8
    """Of the wrist, metres per second."""
    max_acceleration: float = 16.0
    """Of the wrist, metres per second squared."""
    max_angular_speed: float = 600.0
    """Of every joint angle, degrees per second."""
    max_angular_acceleration: float = 8000.0
    """Of every joint angle, degrees per second squared."""
    drift: float = 0.003
    """Amplitude of the slow drift of the wrist, metres."""
    angular_drift: float = 1.0
    """Amplitude of the slow drift of every angle, degrees."""

    def __post_init__(self) -> None:
        for name in ("duration", "pause"):
            low, high = getattr(self, name)
            if not 0 < low <= high < np.inf:
                raise InputError(
                    f"motion {name} must be an ordered pair of positive, finite seconds, got {(low, high)}"
                )
        for name in ("pause_rate", "leave_rate", "arm_only_rate", "hand_only_rate"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"motion {name} must lie in [0, 1], got {getattr(self, name)}")
        if self.arm_only_rate + self.hand_only_rate > 1:
            raise InputError("motion arm_only_rate and hand_only_rate must not exceed 1 together")
        if not 0 <= self.drift <= 0.02 or not 0 <= self.angular_drift <= 2:
            raise InputError(
                f"motion drift must lie in [0, 0.02] m and angular_drift in [0, 2] degrees, "
                f"got {self.drift} and {self.angular_drift}"
            )
        fastest = 2 * np.pi * DRIFT_HZ[1]
        for name, drift in (("", self.drift), ("angular_", self.angular_drift)):
            for kind, least in (("speed", drift * fastest), ("acceleration", drift * fastest**2)):
                value = getattr(self, f"max_{name}{kind}")
                if not value > 2 * least:
                    raise InputError(f"motion max_{name}{kind} must exceed {2 * least:.3g}, got {value}")


def minimum_jerk(u: np.ndarray) -> np.ndarray:
    """Share of the way covered after the share `u` of the time: 0 before it, 1 after it, C2 everywhere."""
    u = np.clip(u, 0.0, 1.0)
    return u**3 * (10 - 15 * u + 6 * u**2)


@dataclass(frozen=True, slots=True, eq=False)
class HandMotion:
    """One hand's motion as a function of time.

    Attributes:
        keys: (M + 1, 28) states between movements.
        starts: (M,) seconds.
        durations: (M,) seconds.
        lags: (M, 28) share 0..MAX_LAG of the duration after which a component starts.
        away: (M + 1,) bool, whether the key lies outside the picture.
        drift_amplitude, drift_hz, drift_phase: (3, 28) sinusoids.
    """

    keys: np.ndarray
    starts: np.ndarray
    durations: np.ndarray
    lags: np.ndarray
    away: np.ndarray
    drift_amplitude: np.ndarray
    drift_hz: np.ndarray
    drift_phase: np.ndarray

    def states(self, times: np.ndarray) -> np.ndarray:
        """(N, 28) states at the times (N,) in seconds."""
        times = np.asarray(times, float)
        waves = self.drift_hz * times[:, None, None] * (2 * np.pi) + self.drift_phase  # (N, 3, 28)
        drift = (self.drift_amplitude * np.sin(waves)).sum(1)
        spans = (self.durations * (1 - MAX_LAG))[:, None]  # (M, 1)
        begins = self.starts[:, None] + self.lags * self.durations[:, None]  # (M, 28)
        shares = minimum_jerk((times[:, None, None] - begins) / spans)  # (N, M, 28)
        return self.keys[0] + (shares * np.diff(self.keys, axis=0)).sum(1) + drift

    @property
    def end(self) -> float:
        """Time at which the last movement ends."""
        return float(self.starts[-1] + self.durations[-1]) if len(self.starts) else 0.0

    def then(self, key: np.ndarray, away: bool, start: float, duration: float, lags: np.ndarray) -> HandMotion:
        """The motion with one more movement."""
        return replace(
            self,
            keys=np.concatenate([self.keys, key[None]]),
            away=np.append(self.away, away),
            starts=np.append(self.starts, start),
            durations=np.append(self.durations, duration),
            lags=np.concatenate([self.lags, lags[None]]),
        )

    def without_last(self) -> HandMotion:
        """The motion before its last movement was added."""
        return replace(
            self,
            keys=self.keys[:-1],
            away=self.away[:-1],
            starts=self.starts[:-1],
            durations=self.durations[:-1],
            lags=self.lags[:-1],
        )


class Arm:
    """One arm of one person, posed by a state.

    Args:
        body: the person.
        anatomy: of the side in question.
    """

    def __init__(self, body: Body, anatomy: ArmAnatomy) -> None:
        self.body, self.anatomy, self.side = body, anatomy, anatomy.side

    def rotations(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(..., 24, 3, 3) rotations of the arm's bones in the states (..., 28), and (...) bool, whether the wrist can
        be reached; where it cannot, upper arm and elbow stay at rest."""
        rotations = self.anatomy.hand_rotations(HandAngles.from_vector(states[..., ANGLES]))
        return rotations, self.anatomy.reach(rotations, states[..., WRIST_PART], states[..., SWIVEL])

    def joints(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(..., 22, 3) joints in the camera frame, body's metres, in the states (..., 28), and (...) bool as above."""
        rotations, reached = self.rotations(states)
        return self.anatomy.joints(rotations), reached


def in_picture(joints: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """(...) bool, whether any of the joints (..., N, 3) is in front of the camera and projects into the image."""
    px = np.asarray(project(joints, camera))  # NaN behind the camera
    return np.asarray(((px >= 0) & (px <= [camera.width, camera.height])).all(-1).any(-1))


def enters_head(joints: np.ndarray) -> np.ndarray:
    """(...) bool, whether the forearm or hand of one arm's joints (..., 22, 3) enters the sphere of the head."""
    a, b = joints[..., _SEGMENTS[:, 0], :], joints[..., _SEGMENTS[:, 1], :]
    head = np.broadcast_to(HEAD_CENTRE, a.shape)
    return np.asarray((segment_distance(a, b, head, head) < HEAD_RADIUS).any(-1))


def plan_motion(
    config: SynthConfig,
    motion: MotionConfig,
    arms: tuple[Arm, Arm],
    camera: PinholeCamera,
    view: np.ndarray,
    times: np.ndarray,
    rng: np.random.Generator,
) -> tuple[HandMotion, HandMotion]:
    """Random motion of both hands, free of collisions at every one of the given times.

    Args:
        config: its box and margin hold for the keys inside the picture.
        motion: distributions.
        arms: of one person, (LEFT, RIGHT).
        camera: who is out of the picture is judged with it.
        view: (3, 4) from the frame between the eyes to the camera's (`SceneSpec.view`).
        times: (N,) seconds, rising from 0: the frames.
        rng: the only source of randomness.

    Returns:
        (LEFT, RIGHT).

    Raises:
        InputError: no such motion was found with this configuration.
    """
    left = _Planner(config, motion, arms[LEFT], camera, view, times, rng, None)
    left.plan()
    right = _Planner(config, motion, arms[RIGHT], camera, view, times, rng, left.joints())
    right.plan()
    return left.motion, right.motion


class _Planner:
    """Adds movements to one hand's motion until it lasts long enough, going back where it is stuck."""

    def __init__(
        self,
        config: SynthConfig,
        motion: MotionConfig,
        arm: Arm,
        camera: PinholeCamera,
        view: np.ndarray,
        times: np.ndarray,
        rng: np.random.Generator,
        other: np.ndarray | None,
    ) -> None:
        self.config, self.settings, self.arm, self.camera, self.view = config, motion, arm, camera, view
        self.times, self.rng, self.other = times, rng, other
        self.other_seen = None if other is None else in_picture(moved(view, other[:, 1:]), camera)
        amplitude = np.full(STATE_SIZE, np.radians(motion.angular_drift))
        amplitude[WRIST_PART] = motion.drift / np.sqrt(3)
        share = rng.dirichlet(np.full(DRIFT_WAVES, 2.0), STATE_SIZE).T  # (3, 28), sums to 1
        self.low, self.high = (np.append(SWIVEL_LIMITS[i], ANGLE_LIMITS[:, i]) for i in (0, 1))
        self.low, self.high = self.low + amplitude[SWIVEL:], self.high - amplitude[SWIVEL:]
        self.motion = HandMotion(
            keys=np.zeros((1, STATE_SIZE)),
            starts=np.zeros(0),
            durations=np.zeros(0),
            lags=np.zeros((0, STATE_SIZE)),
            away=np.zeros(1, bool),
            drift_amplitude=share * amplitude,
            drift_hz=rng.uniform(*DRIFT_HZ, share.shape),
            drift_phase=rng.uniform(0, 2 * np.pi, share.shape),
        )

    def joints(self) -> np.ndarray:
        """(N, 22, 3) joints of the planned motion."""
        return self.arm.joints(self.motion.states(self.times))[0]

    def plan(self) -> None:
        """Fills `motion` up to the last of the times."""
        last = float(self.times[-1])
        self._restart()
        failures = 0
        while self.motion.end < last:
            longer = self._longer()
            if longer is not None:
                self.motion = longer
                continue
            failures += 1
            if failures > SETBACKS:
                raise self._no_motion()
            if len(self.motion.starts):
                self.motion = self.motion.without_last()
            else:
                self._restart()

    def _no_motion(self) -> InputError:
        box = f"{self.config.box_min} to {self.config.box_max}"
        return InputError(f"no motion of the {SIDES[self.arm.side]} hand fits the hand box {box}: enlarge or move it")

    def _restart(self) -> None:
        """Draws the first key, in the picture."""
        for _ in range(START_TRIES):
            key = self._draw_key(None, away=False)
            if key is not None:
                self.motion = replace(self.motion, keys=key[None])
                if self._sound(self.motion, 0.0, 0.0):
                    return
        raise self._no_motion()

    def _longer(self) -> HandMotion | None:
        """The motion with one more movement, or None if none of a few attempts is sound."""
        rng, settings, motion = self.rng, self.settings, self.motion
        for _ in range(PATH_TRIES):
            away = bool(rng.random() < settings.leave_rate) and not motion.away[-1]
            key = self._draw_key(motion.keys[-1], away)
            if key is None:
                continue
            duration = self._duration(key - motion.keys[-1])
            if not len(motion.starts):
                start = rng.uniform(0, 0.3)
            elif motion.away[-1] or rng.random() < settings.pause_rate:
                start = motion.end + rng.uniform(*settings.pause) * (2 if motion.away[-1] else 1)
            else:
                start = motion.end - MAX_OVERLAP * rng.random() * min(duration, motion.durations[-1])
            longer = motion.then(key, away, start, duration, self._lags())
            if self._sound(longer, min(start, motion.end), longer.end):
                return longer
        return None

    def _duration(self, step: np.ndarray) -> float:
        """Seconds for a movement by `step`, such that two of them at once keep the bounds on speed."""
        settings, fastest = self.settings, 2 * np.pi * DRIFT_HZ[1]
        low, high = np.log(settings.duration)
        seconds = float(np.exp(self.rng.uniform(low, high)))
        distance, angle = float(np.linalg.norm(step[WRIST_PART])), float(np.degrees(np.abs(step[SWIVEL:]).max()))
        for way, drift, name in ((distance, settings.drift, ""), (angle, settings.angular_drift, "angular_")):
            speed = (getattr(settings, f"max_{name}speed") - drift * fastest) / 2
            acceleration = (getattr(settings, f"max_{name}acceleration") - drift * fastest**2) / 2
            moving = max(PEAK_SPEED * way / speed, float(np.sqrt(PEAK_ACCELERATION * way / acceleration)))
            seconds = max(seconds, moving / (1 - MAX_LAG))
        return seconds

    def _lags(self) -> np.ndarray:
        """(28,) the arm starts at once, forearm and wrist a little later, every finger at its own moment."""
        lags = np.zeros(STATE_SIZE)
        lags[ANGLES.start : ANGLES.start + 4] = self.rng.uniform(0, MAX_LAG)
        lags[ANGLES.start + 4 :] = np.repeat(self.rng.uniform(0, MAX_LAG, 5), 4)
        return lags

    def _draw_key(self, previous: np.ndarray | None, away: bool) -> np.ndarray | None:
        """A random state that is anatomically sound and where it should be; None if none was found."""
        rng, settings = self.rng, self.settings
        choice = rng.random()
        for _ in range(KEY_TRIES):
            key = np.empty(STATE_SIZE)
            key[WRIST_PART] = self._away_wrist() if away else self._wrist_in_box()
            key[SWIVEL] = np.radians(rng.uniform(0, 40) if away else rng.uniform(-10, 75))
            key[ANGLES] = sample_angles(rng).as_vector()
            if previous is not None:
                if away or choice < settings.arm_only_rate:
                    key[ANGLES.start + 3 :] = previous[ANGLES.start + 3 :]
                elif choice < settings.arm_only_rate + settings.hand_only_rate and not self.motion.away[-1]:
                    key[: ANGLES.start] = previous[: ANGLES.start]
            key[SWIVEL:] = np.clip(key[SWIVEL:], self.low, self.high)
            joints, reached = self.arm.joints(key)
            if not reached or hand_enters_itself(self.arm.body, joints):
                continue
            if away and not in_picture(moved(self.view, joints), self.camera):
                return key
            if not away and self._well_placed(joints):
                return key
        return None

    def _well_placed(self, joints: np.ndarray) -> bool:
        low, high = hand_box(self.config, self.arm.side)
        root = joints[1 + ROOT]
        in_box = bool((root > low).all() and (root < high).all())
        return in_box and bool(
            inside_image(moved(self.view, joints[1:]), self.camera, self.config.image_margin).sum()
            >= self.config.min_inside
        )

    def _wrist_in_box(self) -> np.ndarray:
        return self.arm.anatomy.wrist_before(self.rng.uniform(*hand_box(self.config, self.arm.side)))

    def _away_wrist(self) -> np.ndarray:
        """Below the picture, towards the lap, or beside it."""
        outward = -1.0 if self.arm.side == LEFT else 1.0
        if self.rng.random() < 0.7:
            place = self.rng.uniform([0.05, 0.40, 0.05], [0.40, 0.52, 0.28])
        else:
            place = self.rng.uniform([0.42, 0.05, 0.00], [0.55, 0.30, 0.18])
        return place * [outward, 1.0, 1.0]

    def _sound(self, motion: HandMotion, begin: float, end: float) -> bool:
        """Whether all frames from `begin` to `end` are possible; every eighth of them is tried first."""
        frames = np.flatnonzero((self.times >= begin - 1e-9) & (self.times <= end + 1e-9))
        few = np.zeros(len(frames), bool)
        few[4::8] = True
        return all(
            self._frames_are_sound(some, motion.states(self.times[some])) for some in (frames[few], frames[~few])
        )

    def _frames_are_sound(self, frames: np.ndarray, states: np.ndarray) -> bool:
        """Whether this hand in the states (F, 28) at the frames (F,) enters nothing; without the other hand in the
        picture it has to be there."""
        body = self.arm.body
        joints, reached = self.arm.joints(states)
        if not reached.all() or enters_head(joints).any():
            return False
        seen = in_picture(moved(self.view, joints[:, 1:]), self.camera)
        if (seen & (joints[:, 1:, 2].min(-1) < 0.05)).any():
            return False
        if self.other is not None and self.other_seen is not None:
            other, other_seen = self.other[frames], self.other_seen[frames]
            both = seen & other_seen
            if not (seen | other_seen).all() or hands_collide(body, np.stack([joints, other], axis=1)[both]).any():
                return False
        return not hand_enters_itself(body, joints).any()
