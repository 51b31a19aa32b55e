"""Goals for arms, and the arms that reach them.

Frame: that between the eyes at rest of the person at hand (x right, y down, z forward, metres), in which the chest does
not move. A goal says where a part of the hand should be and how the palm should lie, for many candidates at once;
`solved` finds the arm to each.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from twohands.synth.scene.body import ARM_BONES
from twohands.synth.scene.pose import (
    ANGLE_LIMITS,
    ArmAnatomy,
    HandAngles,
    cross,
    dot,
    frame,
    rotation_about,
    signed_angle,
)

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
