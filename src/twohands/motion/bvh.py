"""BVH: one hand as a skeleton of fixed bones that turns, as animators' programs read it.

Frame: upright (x right, y up, z backward), metres, the camera at the origin. The root is the wrist, with its place and
rotation; all other joints have rotations alone. Angles are degrees in the order Z, Y, X: the rotation is
R_z R_y R_x. BVH has even times only and cannot leave a hand out: see `even_times`.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from twohands.geometry.quaternions import between, quaternions, rotations
from twohands.motion.clip import HandMotion
from twohands.motion.even_times import EvenTimes, even_times
from twohands.motion.fit import FittedHand, HandSkeleton
from twohands.skeleton import N_JOINTS, PARENTS, SIDES, WRIST

_FINGERS: Final = ("Thumb", "Index", "Middle", "Ring", "Pinky")
_BLOCK: Final = 10_000
"""Frames at once."""
_CHANNELS: Final = "Zrotation Yrotation Xrotation"


def joint_names(side: int) -> tuple[str, ...]:
    """Of the 21 joints as animators' rigs call them: LeftHand, LeftHandThumb1, ...; tips end in 4 and become end
    sites."""
    hand = f"{SIDES[side].capitalize()}Hand"
    return (hand, *(f"{hand}{finger}{i}" for finger in _FINGERS for i in range(1, 5)))


def bvh_text(motion: HandMotion, hand: FittedHand) -> tuple[str, EvenTimes]:
    """The content of a .bvh file of one hand, and which frames it has.

    Args:
        motion: the clip.
        hand: the fit of one of its hands.

    Raises:
        InputError: the clip's times would ask for too many frames.
    """
    times = even_times(motion.time_s, hand.rows)
    moving = [joint for joint in range(N_JOINTS) if joint == WRIST or joint % 4]
    lines: list[str] = []
    for start in range(0, len(times.share), _BLOCK):
        wrist, local = even_pose(hand, times, slice(start, start + _BLOCK))
        values = np.concatenate([wrist[:, None], np.degrees(angles_zyx(local[:, moving]))], axis=1)
        lines += [" ".join(f"{value:.7f}" for value in row) for row in values.reshape(len(wrist), -1)]
    head = ["HIERARCHY", *_joint_lines(hand.skeleton, joint_names(hand.skeleton.side), WRIST, "")]
    return "\n".join([*head, "MOTION", f"Frames: {len(lines)}", f"Frame Time: {times.step_s:.9f}", *lines, ""]), times


def even_pose(hand: FittedHand, times: EvenTimes, part: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
    """The fit at even times, or at a part of them.

    Returns:
        wrist: (E, 3) upright frame, metres.
        local: (E, 21, 3, 3) rotation of each bone relative to the one before it.
    """
    before, after, share = times.before[part], times.after[part], times.share[part, None]
    wrist = hand.joints_m[:, WRIST]
    places = (1 - share) * wrist[before] + share * wrist[after]
    first, last = (quaternions(hand.local_turns_of(rows)) for rows in (before, after))
    return places, rotations(between(first, last, np.repeat(share, N_JOINTS, axis=1)))


def angles_zyx(turns: np.ndarray) -> np.ndarray:
    """(..., 3) radians about z, y and x, so that the rotation (..., 3, 3) is R_z R_y R_x."""
    z = np.arctan2(turns[..., 1, 0], turns[..., 0, 0])
    y = np.arctan2(-turns[..., 2, 0], np.hypot(turns[..., 0, 0], turns[..., 1, 0]))
    # What is left after z and y are turned back is about x, also where y is a quarter turn and z could be anything.
    sin_z, cos_z = np.sin(z), np.cos(z)
    sine = sin_z * turns[..., 0, 2] - cos_z * turns[..., 1, 2]
    cosine = cos_z * turns[..., 1, 1] - sin_z * turns[..., 0, 1]
    return np.stack([z, y, np.arctan2(sine, cosine)], axis=-1)


def _joint_lines(skeleton: HandSkeleton, names: tuple[str, ...], joint: int, margin: str) -> list[str]:
    """A joint and all that hang on it."""
    x, y, z = skeleton.offsets_m[joint]
    tip = joint != WRIST and joint % 4 == 0
    kind = "ROOT" if joint == WRIST else "End" if tip else "JOINT"
    lines = [f"{margin}{kind} {'Site' if tip else names[joint]}", f"{margin}{{"]
    inner = margin + "\t"
    lines.append(f"{inner}OFFSET {x:.7f} {y:.7f} {z:.7f}")
    if joint == WRIST:
        lines.append(f"{inner}CHANNELS 6 Xposition Yposition Zposition {_CHANNELS}")
    elif not tip:
        lines.append(f"{inner}CHANNELS 3 {_CHANNELS}")
    for child in range(1, N_JOINTS):
        if PARENTS[child] == joint:
            lines += _joint_lines(skeleton, names, child, inner)
    return [*lines, f"{margin}}}"]
