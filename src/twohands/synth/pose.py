"""Anatomical pose of one arm and hand: from angles a physician would use to rotations of the rig.

All axes are found on the rest pose of the person at hand, so the same angles mean the same thing for every body and
for both sides. Angles are in radians, zero is a straight limb: a finger in line with its metacarpal, a hand in line
with its forearm, a forearm with the thumb towards the upper arm.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twohands.skeleton import LITTLE_MCP, ROOT, WRIST
from twohands.synth.body import BONE_NAMES, BONES_PER_SIDE, Body, bone


@dataclass(frozen=True, slots=True)
class HandAngles:
    """Angles of one hand and forearm, radians.

    Attributes:
        pronation: of the forearm, 0 with the thumb towards the upper arm, positive palm down.
        wrist_flexion: positive towards the palm.
        wrist_deviation: positive towards the thumb.
        cup: bend of the ring and little metacarpals towards the palm.
        thumb: (4,) radial angle of its metacarpal (in the palm's plane, from the hand's axis outwards), palmar angle
            (out of that plane), then flexion of the two joints beyond.
        fingers: (4, 4) index to little: spread (positive towards the thumb), then flexion of the three joints.
    """

    pronation: float
    wrist_flexion: float
    wrist_deviation: float
    cup: float
    thumb: np.ndarray
    fingers: np.ndarray

    def as_vector(self) -> np.ndarray:
        """(24,) all angles in the order of the attributes, fingers from index to little."""
        arm = [self.pronation, self.wrist_flexion, self.wrist_deviation, self.cup]
        return np.concatenate([arm, self.thumb, self.fingers.ravel()])

    @classmethod
    def from_vector(cls, vector: np.ndarray) -> HandAngles:
        """Undoes `as_vector`."""
        arm = (float(angle) for angle in vector[:4])
        return cls(*arm, thumb=vector[4:8], fingers=vector[8:24].reshape(4, 4))


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
`scene.sample_angles`, its Gaussian parts cut at about three standard deviations."""


def rotation_about(axis: np.ndarray, angle: float) -> np.ndarray:
    """(3, 3) rotation by `angle` radians about the unit vector `axis`, right-handed (Rodrigues' formula)."""
    x, y, z = axis
    s, c = np.sin(angle), np.cos(angle)
    d = 1 - c
    return np.array(
        [
            [c + x * x * d, x * y * d - z * s, x * z * d + y * s],
            [x * y * d + z * s, c + y * y * d, y * z * d - x * s],
            [x * z * d - y * s, y * z * d + x * s, c + z * z * d],
        ]
    )


def unit(vector: np.ndarray) -> np.ndarray:
    """The vector at length 1."""
    return vector / np.sqrt(vector @ vector)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product of two single vectors, without numpy's generality and cost."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def signed_angle(a: np.ndarray, b: np.ndarray, axis: np.ndarray) -> float:
    """Angle from `a` to `b` about the unit `axis`, radians, after both were projected on the plane normal to it."""
    a, b = a - axis * (a @ axis), b - axis * (b @ axis)
    return float(np.arctan2(cross(a, b) @ axis, a @ b))


def frame(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """(3, 3) right-handed frame whose first column is along `x` and whose third is near `z`."""
    x = unit(x)
    y = unit(cross(z, x))
    return np.stack([x, y, cross(x, y)], axis=1)


class ArmAnatomy:
    """Axes and rest angles of one arm of one person.

    Args:
        body: the person.
        side: LEFT or RIGHT.
    """

    def __init__(self, body: Body, side: int) -> None:
        self.side = side
        self.first = side * BONES_PER_SIDE
        joints = body.joints[side]
        elbow, hand = joints[0], joints[1:]
        self.shoulder = body.heads[bone("upperarm01", side)]
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

        self.fingers = [self._finger(hand, finger) for finger in range(1, 5)]
        self.thumb = self._thumb(hand)
        self.thumb_foot, self.little_mcp = hand[1], hand[LITTLE_MCP]
        self.index = {
            name.split(".")[0]: i - self.first
            for i, name in enumerate(BONE_NAMES)
            if self.first <= i < self.first + BONES_PER_SIDE
        }

    def _finger(self, hand: np.ndarray, finger: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Flexion axis, spread axis and rest flexions of one finger (1 index .. 4 little)."""
        mcp = 1 + 4 * finger
        a, b, c, d = hand[mcp : mcp + 4]
        # The palm arches, so each finger bends about the local tangent of the row of knuckles.
        neighbours = hand[1 + 4 * max(finger - 1, 1)] - hand[1 + 4 * min(finger + 1, 4)]
        palmar = unit(cross(unit(a - hand[WRIST]), neighbours)) * (1.0 if self.side == 0 else -1.0)
        axis = unit(cross(b - a, palmar))
        rest = np.array(
            [
                signed_angle(a - hand[WRIST], b - a, axis),
                signed_angle(b - a, c - b, axis),
                signed_angle(c - b, d - c, axis),
            ]
        )
        spread = unit(cross(b - a, self.thumbwards))
        return axis, spread, rest

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

    def _thumb_base(self, radial: float, palmar: float) -> np.ndarray:
        """(3, 3) rotation of the thumb's metacarpal from rest to the given angles.

        Wherever the metacarpal points, it keeps the roll that lets the thumb bend towards the base of the little
        finger, as the saddle joint at its foot does.
        """
        outward = unit(self.thumbwards - self.hand_axis * (self.thumbwards @ self.hand_axis))
        direction = np.cos(palmar) * (np.cos(radial) * self.hand_axis + np.sin(radial) * outward)
        direction = direction + np.sin(palmar) * self.palmar
        rest_frame, metacarpal, _ = self.thumb
        tip = self.thumb_foot + direction * np.sqrt(metacarpal @ metacarpal)
        return frame(direction, self.little_mcp - tip) @ rest_frame.T

    def hand_rotations(self, angles: HandAngles) -> np.ndarray:
        """(24, 3, 3) rotations of this arm's bones for the hand and forearm; elbow and shoulder stay at rest."""
        out = np.tile(np.eye(3), (BONES_PER_SIDE, 1, 1))
        twist = angles.pronation - self.pronation_rest
        # The skin of the forearm turns gradually: a third at mid-forearm, more at the wrist, as radius crosses ulna.
        out[self.index["lowerarm02"]] = rotation_about(self.pronation_axis, 0.55 * twist)
        flex = rotation_about(self.flexion_axis, angles.wrist_flexion - self.wrist_flexion_rest)
        deviate = rotation_about(self.deviation_axis, angles.wrist_deviation)
        out[self.index["wrist"]] = rotation_about(self.pronation_axis, 0.45 * twist) @ flex @ deviate
        out[self.index["metacarpal3"]] = rotation_about(self.flexion_axis, 0.4 * angles.cup)
        out[self.index["metacarpal4"]] = rotation_about(self.flexion_axis, angles.cup)

        out[self.index["finger1-1"]] = self._thumb_base(angles.thumb[0], angles.thumb[1])
        flexion = self.thumb[2]
        out[self.index["finger1-2"]] = rotation_about(flexion, angles.thumb[2] - self.thumb_rest[0])
        out[self.index["finger1-3"]] = rotation_about(flexion, angles.thumb[3] - self.thumb_rest[1])

        for finger, (axis, spread, rest) in enumerate(self.fingers):
            a = angles.fingers[finger]
            name = f"finger{finger + 2}"
            out[self.index[f"{name}-1"]] = rotation_about(spread, a[0]) @ rotation_about(axis, a[1] - rest[0])
            out[self.index[f"{name}-2"]] = rotation_about(axis, a[2] - rest[1])
            out[self.index[f"{name}-3"]] = rotation_about(axis, a[3] - rest[2])
        return out

    @cached_property
    def max_reach(self) -> float:
        """Longest distance from shoulder to wrist, metres, the elbow just short of straight."""
        return 0.985 * (self.upper_length + self.lower_length)

    def reach(self, rotations: np.ndarray, wrist_target: np.ndarray, swivel: float) -> bool:
        """Two-bone inverse kinematics: puts the wrist joint on the target.

        Args:
            rotations: (24, 3, 3) of this arm; its shoulder and elbow are set in place.
            wrist_target: (3,) camera frame, metres.
            swivel: angle of the elbow about the line from shoulder to wrist, 0 lowest, positive outwards.

        Returns:
            Whether the target is within reach; `rotations` are unchanged if not.
        """
        to_wrist = wrist_target - self.shoulder
        distance = float(np.linalg.norm(to_wrist))
        low, high = abs(self.upper_length - self.lower_length) * 1.3, self.max_reach
        if not low < distance < high:
            return False
        direction = to_wrist / distance
        along = (self.upper_length**2 - self.lower_length**2 + distance**2) / (2 * distance)
        radius = float(np.sqrt(max(self.upper_length**2 - along**2, 0.0)))
        down = np.array([0.0, 1.0, 0.0])
        lowest = unit(down - direction * (down @ direction))
        outward = np.array([-1.0 if self.side == 0 else 1.0, 0.0, 0.0])
        lateral = unit(outward - direction * (outward @ direction) - lowest * (outward @ lowest))
        elbow = self.shoulder + direction * along + radius * (np.cos(swivel) * lowest + np.sin(swivel) * lateral)
        upper, lower = elbow - self.shoulder, wrist_target - elbow
        hinge = unit(cross(upper, lower))
        upper_rotation = frame(upper, hinge) @ frame(self.elbow - self.shoulder, self.hinge).T
        rotations[self.index["upperarm01"]] = upper_rotation
        flexion = signed_angle(upper, lower, hinge) - self.elbow_rest
        rotations[self.index["lowerarm01"]] = rotation_about(self.hinge, flexion)
        return True
