"""Anatomical pose of one arm and hand: from angles a physician would use to rotations of the rig.

All axes are found on the rest pose of the person at hand, so the same angles mean the same thing for every body and
for both sides. Angles are in radians, zero is a straight limb: a finger in line with its metacarpal, a hand in line
with its forearm, a forearm with the thumb towards the upper arm.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from twohands.skeleton import LITTLE_MCP, ROOT, WRIST
from twohands.synth.scene.body import ARM_BONES, BONES_PER_SIDE, Body, arm_kinematics, carried


@dataclass(frozen=True, slots=True)
class HandAngles:
    """Angles of one hand and forearm, radians, or of many: leading dimensions (...), none for one hand.

    Attributes:
        pronation: (...) of the forearm, 0 with the thumb towards the upper arm, positive palm down.
        wrist_flexion: (...) positive towards the palm.
        wrist_deviation: (...) positive towards the thumb.
        cup: (...) bend of the ring and little metacarpals towards the palm.
        thumb: (..., 4) radial angle of its metacarpal (in the palm's plane, from the hand's axis outwards), palmar
            angle (out of that plane), then flexion of the two joints beyond.
        fingers: (..., 4, 4) index to little: spread (positive towards the thumb), then flexion of the three joints.
    """

    pronation: float | np.ndarray
    wrist_flexion: float | np.ndarray
    wrist_deviation: float | np.ndarray
    cup: float | np.ndarray
    thumb: np.ndarray
    fingers: np.ndarray

    def as_vector(self) -> np.ndarray:
        """(..., 24) all angles in the order of the attributes, fingers from index to little."""
        arm = np.stack([self.pronation, self.wrist_flexion, self.wrist_deviation, self.cup], axis=-1)
        return np.concatenate([arm, self.thumb, self.fingers.reshape(*self.thumb.shape[:-1], 16)], axis=-1)

    @classmethod
    def from_vector(cls, vector: np.ndarray) -> HandAngles:
        """Undoes `as_vector`."""
        arm = (vector[..., i] for i in range(4))
        return cls(*arm, thumb=vector[..., 4:8], fingers=vector[..., 8:24].reshape(*vector.shape[:-1], 4, 4))


ANGLE_LIMITS = np.radians(
    [
        (-75, 75),  # pronation
        (-60, 60),  # wrist flexion
        (-28, 20),  # wrist deviation
        (0, 14),  # cup
        (-2, 56),  # thumb: radial, palmar, two flexions
        (-4, 54),
        (0, 50),
        (-12, 65),
        *[
            limits
            for spread in ((-12, 20), (-10, 12), (-15, 11), (-22, 14))  # index to little
            for limits in (spread, (-19, 83), (4, 102), (-8, 88))
        ],
    ]
)
"""(24, 2) smallest and largest value of every angle in the order of `HandAngles.as_vector`, radians: the span of
`sampling.sample_angles`, its Gaussian parts cut at about three standard deviations."""


ROOT_BEYOND_WRIST = 0.09
"""Metres on the line from the shoulder, about a hand length."""


def rotation_about(axis: np.ndarray, angle: float | np.ndarray) -> np.ndarray:
    """(..., 3, 3) rotations by `angle` (...) radians about the unit vectors `axis` (..., 3), right-handed.

    Source: Rodrigues' formula, R = cos (1 - a a') + a a' + sin [a]x.
    """
    angle = np.asarray(angle)[..., None, None]
    x, y, z, none = axis[..., 0], axis[..., 1], axis[..., 2], np.zeros(axis.shape[:-1])
    around = np.stack([none, -z, y, z, none, -x, -y, x, none], axis=-1).reshape(*axis.shape, 3)
    along = axis[..., :, None] * axis[..., None, :]
    return np.cos(angle) * (np.eye(3) - along) + along + np.sin(angle) * around


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(...) scalar products of vectors (..., 3)."""
    return (a[..., None, :] @ b[..., :, None])[..., 0, 0]


def unit(vector: np.ndarray) -> np.ndarray:
    """The vectors (..., 3) at length 1."""
    return vector / np.sqrt(dot(vector, vector))[..., None]


_NEXT = np.array([1, 2, 0])
"""Of the axes x, y, z."""


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(..., 3) cross products, without numpy's generality and cost."""
    return (a * b.take(_NEXT, -1) - a.take(_NEXT, -1) * b).take(_NEXT, -1)


def signed_angle(a: np.ndarray, b: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """(...) angles from `a` to `b` about the unit `axis`, radians, after both were projected on the plane normal to it;
    all (..., 3)."""
    a, b = a - axis * dot(a, axis)[..., None], b - axis * dot(b, axis)[..., None]
    return np.arctan2(dot(cross(a, b), axis), dot(a, b))


def frame(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """(..., 3, 3) right-handed frames whose first column is along `x` and whose third is near `z`, both (..., 3)."""
    x = unit(x)
    y = unit(cross(z, x))
    return np.stack([x, y, cross(x, y)], axis=-1)


_SHARE_OF_TWIST = 0.55
"""Pronation at mid-forearm; the rest at the wrist. The skin of the forearm turns gradually, as radius crosses ulna."""
_SHARE_OF_CUP = 0.4
"""Of the ring finger's metacarpal; the little one bends by the whole angle."""


class _Turns:
    """The 24 rotations about fixed axes that `hand_rotations` is put together from, in the order of their rows.

    0 pronation at mid-forearm; 1 pronation, 2 flexion, 3 deviation at the wrist; 4, 5 cup; 6, 7 the thumb's flexions;
    8 + 4 f spread, then flexions, of finger f (0 index .. 3 little).
    """

    ANGLE: Final = np.array([0, 0, 1, 2, 3, 3, 6, 7, *range(8, 24)])
    """Place of the turn's angle in `HandAngles.as_vector`."""
    SHARE: Final = np.array([_SHARE_OF_TWIST, 1 - _SHARE_OF_TWIST, 1, 1, _SHARE_OF_CUP, *[1.0] * 19])
    WRIST: Final = slice(1, 4)
    SPREAD: Final = slice(8, 24, 4)
    FLEXION: Final = slice(9, 24, 4)
    ALONE: Final = np.array([0, 4, 5, 6, 7, *(i for i in range(8, 24) if i % 4 >= 2)])
    """Turns that are the whole rotation of a bone, and below these bones."""
    BONES: Final = [ARM_BONES.index(name) for name in ("lowerarm02", "metacarpal3", "metacarpal4")] + [
        ARM_BONES.index(f"finger{finger}-{joint}") for finger in range(1, 6) for joint in (2, 3)
    ]
    KNUCKLES: Final = [ARM_BONES.index(f"finger{finger}-1") for finger in range(2, 6)]


_UPPER_ARM, _ELBOW, _WRIST, _THUMB = (
    ARM_BONES.index(name) for name in ("upperarm01", "lowerarm01", "wrist", "finger1-1")
)


class ArmAnatomy:
    """Axes and rest angles of one arm of one person.

    Args:
        body: the person.
        side: LEFT or RIGHT.
    """

    def __init__(self, body: Body, side: int) -> None:
        self.side = side
        self.first = side * BONES_PER_SIDE
        self.heads = body.heads[self.first : self.first + BONES_PER_SIDE]
        self.rest_joints = joints = body.joints[side]
        elbow, hand = joints[0], joints[1:]
        self.shoulder = self.heads[_UPPER_ARM]
        self.elbow, self.wrist = elbow, hand[WRIST]
        self.upper_length = float(np.linalg.norm(elbow - self.shoulder))
        self.lower_length = float(np.linalg.norm(self.wrist - elbow))
        self.forearm = unit(self.wrist - elbow)
        self.hinge = unit(cross(elbow - self.shoulder, self.wrist - elbow))
        self.elbow_rest = signed_angle(elbow - self.shoulder, self.wrist - elbow, self.hinge)

        self.hand_axis = unit(hand[ROOT] - hand[WRIST])
        self.thumbwards = unit(hand[5] - hand[LITTLE_MCP])
        # For a left hand in this frame, fingers x thumb-side points out of the palm; mirrored for a right hand.
        mirror = 1.0 if side == 0 else -1.0
        self.palmar = unit(cross(self.hand_axis, self.thumbwards)) * mirror
        self.flexion_axis = unit(cross(self.hand_axis, self.palmar))
        self.deviation_axis = unit(cross(self.hand_axis, self.thumbwards))
        self.wrist_flexion_rest = signed_angle(self.forearm, self.hand_axis, self.flexion_axis)
        # Pronation turns the palm normal from the medial hinge direction downwards, seen along the forearm.
        self.pronation_axis = self.forearm * mirror
        self.pronation_rest = signed_angle(self.hinge * mirror, self.palmar, self.pronation_axis)

        axes, spreads, finger_rests = self._fingers(hand)
        self.finger_axes = axes
        self.thumb = self._thumb(hand)
        self.thumb_foot, self.little_mcp = hand[1], hand[LITTLE_MCP]
        self._rest_frame = frame(elbow - self.shoulder, self.hinge)
        twist, flexion = self.pronation_axis, self.flexion_axis
        wrist_and_thumb = [twist, twist, flexion, self.deviation_axis, flexion, flexion, self.thumb[2], self.thumb[2]]
        self._turn_axes = np.concatenate(
            [np.stack(wrist_and_thumb), np.stack([spreads, axes, axes, axes], axis=1).reshape(16, 3)]
        )
        self._turn_rests = np.zeros(24)
        self._turn_rests[:3] = self.pronation_rest, self.pronation_rest, self.wrist_flexion_rest
        self._turn_rests[6:8] = self.thumb_rest
        self._turn_rests[8:].reshape(4, 4)[:, 1:] = finger_rests

    def _fingers(self, hand: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Flexion axes, spread axes and rest flexions (4, 3) of the fingers, index to little."""
        a, b, c, d = (hand[5 + joint : 21 : 4] for joint in range(4))
        # All bend about the row of knuckles as a whole: about its arch, they would meet half-way in a fist.
        palmar = unit(cross(unit(a - hand[WRIST]), a[0] - a[3])) * (1.0 if self.side == 0 else -1.0)
        axes = unit(cross(b - a, palmar))
        bones = np.stack([a - hand[WRIST], b - a, c - b, d - c])
        rests = signed_angle(bones[:-1], bones[1:], axes[None]).T
        return axes, unit(cross(b - a, self.thumbwards)), rests

    def _thumb(self, hand: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Orientation of the metacarpal at rest, joint at its end, and flexion axis of the joints beyond."""
        # The pad faces the little finger's base, half-way between across and into the palm.
        pad = unit(-self.thumbwards + 0.6 * self.palmar)
        distal = unit(hand[4] - hand[2])
        flexion = unit(cross(distal, pad - distal * (pad @ distal)))
        metacarpal, proximal = hand[2] - hand[1], hand[3] - hand[2]
        self.thumb_rest = (
            signed_angle(metacarpal, proximal, flexion),
            signed_angle(proximal, hand[4] - hand[3], flexion),
        )
        return frame(metacarpal, hand[LITTLE_MCP] - hand[2]), metacarpal, flexion

    def _thumb_base(self, radial: np.ndarray, palmar: np.ndarray) -> np.ndarray:
        """(..., 3, 3) rotations of the thumb's metacarpal from rest to the given angles (...).

        Wherever the metacarpal points, it keeps the roll that lets the thumb bend towards the base of the little
        finger, as the saddle joint at its foot does.
        """
        radial, palmar = radial[..., None], palmar[..., None]
        outward = unit(self.thumbwards - self.hand_axis * (self.thumbwards @ self.hand_axis))
        direction = np.cos(palmar) * (np.cos(radial) * self.hand_axis + np.sin(radial) * outward)
        direction = direction + np.sin(palmar) * self.palmar
        rest_frame, metacarpal, _ = self.thumb
        tip = self.thumb_foot + direction * np.sqrt(metacarpal @ metacarpal)
        return frame(direction, self.little_mcp - tip) @ rest_frame.T

    def hand_rotations(self, angles: HandAngles) -> np.ndarray:
        """(..., 24, 3, 3) rotations of this arm's bones for the hand and forearm; elbow and shoulder stay at rest."""
        vector = angles.as_vector()
        turns = rotation_about(self._turn_axes, (vector[..., _Turns.ANGLE] - self._turn_rests) * _Turns.SHARE)
        out = np.empty((*vector.shape[:-1], BONES_PER_SIDE, 3, 3))
        out[:] = np.eye(3)
        out[..., _Turns.BONES, :, :] = turns[..., _Turns.ALONE, :, :]
        twist, flex, deviate = np.moveaxis(turns[..., _Turns.WRIST, :, :], -3, 0)
        out[..., _WRIST, :, :] = twist @ flex @ deviate
        out[..., _THUMB, :, :] = self._thumb_base(angles.thumb[..., 0], angles.thumb[..., 1])
        out[..., _Turns.KNUCKLES, :, :] = turns[..., _Turns.SPREAD, :, :] @ turns[..., _Turns.FLEXION, :, :]
        return out

    def joints(self, rotations: np.ndarray) -> np.ndarray:
        """(..., 22, 3) joints of this arm, camera frame, metres, from the rotations (..., 24, 3, 3) of its bones."""
        return carried(self.rest_joints, arm_kinematics(self.heads, rotations))

    def wrist_before(self, root: np.ndarray) -> np.ndarray:
        """(..., 3) where to put the wrist so that the root joint comes near `root`: `ROOT_BEYOND_WRIST` nearer to the
        shoulder, for boxes are those of the root joint but the arm's solver places the wrist."""
        return root - unit(root - self.shoulder) * ROOT_BEYOND_WRIST

    @cached_property
    def max_reach(self) -> float:
        """Longest distance from shoulder to wrist, metres, the elbow just short of straight."""
        return 0.985 * (self.upper_length + self.lower_length)

    def reach(self, rotations: np.ndarray, wrist_target: np.ndarray, swivel: float | np.ndarray) -> np.ndarray:
        """Two-bone inverse kinematics: puts the wrist joint on the target.

        Args:
            rotations: (..., 24, 3, 3) of this arm; its shoulder and elbow are set in place.
            wrist_target: (..., 3) camera frame, metres.
            swivel: (...) angle of the elbow about the line from shoulder to wrist, 0 lowest, positive outwards.

        Returns:
            (...) bool, whether the target is within reach; those `rotations` that are not are unchanged.
        """
        reached, to_wrist, direction = self._within_reach(wrist_target)
        down = np.array([0.0, 1.0, 0.0])
        lowest = unit(down - direction * dot(down, direction)[..., None])
        outward = np.array([-1.0 if self.side == 0 else 1.0, 0.0, 0.0])
        lateral = outward - direction * dot(outward, direction)[..., None] - lowest * dot(outward, lowest)[..., None]
        aside = np.cos(swivel)[..., None] * lowest + np.sin(swivel)[..., None] * unit(lateral)
        self._bend(rotations, reached, to_wrist, aside)
        return reached

    def reach_by(self, rotations: np.ndarray, wrist_target: np.ndarray, elbow: np.ndarray) -> np.ndarray:
        """`reach` with the elbow on the side of the direction `elbow` (..., 3), seen from the line between shoulder and
        wrist."""
        reached, to_wrist, direction = self._within_reach(wrist_target)
        aside = unit(elbow - direction * dot(elbow, direction)[..., None] + 1e-9)
        self._bend(rotations, reached, to_wrist, aside)
        return reached

    def _within_reach(self, wrist_target: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(...) whether the target is within reach, (..., 3) the way there from the shoulder and its direction."""
        to_wrist = wrist_target - self.shoulder
        distance = np.sqrt(dot(to_wrist, to_wrist))
        low = abs(self.upper_length - self.lower_length) * 1.3
        reached = (low < distance) & (distance < self.max_reach)
        # Out of reach, solve for the wrist at rest instead and drop the result.
        to_wrist = np.where(reached[..., None], to_wrist, self.wrist - self.shoulder)
        return reached, to_wrist, to_wrist / np.sqrt(dot(to_wrist, to_wrist))[..., None]

    def _bend(self, rotations: np.ndarray, reached: np.ndarray, to_wrist: np.ndarray, aside: np.ndarray) -> None:
        """Sets shoulder and elbow of the `rotations` that are within reach, the elbow towards the unit vectors `aside`
        (..., 3) normal to `to_wrist` (..., 3)."""
        distance = np.sqrt(dot(to_wrist, to_wrist))
        direction = to_wrist / distance[..., None]
        along = (self.upper_length**2 - self.lower_length**2 + distance**2) / (2 * distance)
        radius = np.sqrt(np.maximum(self.upper_length**2 - along**2, 0.0))
        upper = direction * along[..., None] + radius[..., None] * aside
        lower = to_wrist - upper
        hinge = unit(cross(upper, lower))
        flexion = signed_angle(upper, lower, hinge) - self.elbow_rest
        for index, solved in (
            (_UPPER_ARM, frame(upper, hinge) @ self._rest_frame.T),
            (_ELBOW, rotation_about(self.hinge, flexion)),
        ):
            rotations[..., index, :, :] = np.where(reached[..., None, None], solved, rotations[..., index, :, :])
