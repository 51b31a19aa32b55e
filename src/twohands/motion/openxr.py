"""OpenXR's 26 joints of each hand as lines of JSON (docs/export.md, *OpenXR's joints*).

Frame: OpenXR's axes (x right, y up, z backward) about the camera, metres. An orientation is that of the bone that
begins in the joint: -z along it, y out of the back of the hand. 21 joints are the clip's own. Five are derived: the
metacarpals of index to little finger lie on the straight way from wrist to knuckle, and the palm half-way between the
middle one and its knuckle.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np

from twohands.geometry.quaternions import quaternions
from twohands.motion.clip import UPRIGHT_FROM_CAMERA, HandMotion
from twohands.motion.fit import FittedHand, HandSkeleton
from twohands.skeleton import ROOT, SIDES, WRIST

VERSION: Final = 1
FORMAT: Final = "openxr hand joints"
NAMES: Final = (
    "palm", "wrist", "thumb_metacarpal", "thumb_proximal", "thumb_distal", "thumb_tip",
    *(
        f"{finger}_{part}"
        for finger in ("index", "middle", "ring", "little")
        for part in ("metacarpal", "proximal", "intermediate", "distal", "tip")
    ),
)  # fmt: skip
"""In the order of XrHandJointEXT."""
METACARPAL_WAY: Final = {5: 0.305, 9: 0.319, 13: 0.409, 17: 0.439}
"""By knuckle: where its metacarpal begins, as a share of the way from our wrist to it. Those of the generator's bodies
(Anny), mean of 41; they differ by 0.003, and the straight way leads past by 3 to 11 % of the hand length."""
DERIVED: Final = tuple(name for name in NAMES if name == "palm" or ("metacarpal" in name and "thumb" not in name))
_DECIMALS: Final = 6
_XR_FROM_BONE: Final = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
"""Columns: where OpenXR's x, y and z lie among a bone's along, nail and hinge."""


def openxr_lines(motion: HandMotion, fitted: Mapping[int, FittedHand]) -> Iterator[str]:
    """A header, then a line for each frame, without their ends.

    Args:
        motion: the clip.
        fitted: `fit_motion` of it.
    """
    about = {"version": VERSION, "format": FORMAT, "source": motion.source, "names": NAMES, "derived": DERIVED}
    yield json.dumps(about | {"axes": "x right, y up, z backward, camera at the origin", "orientation": "x y z w"})
    joints = {side: openxr_joints(motion.joints_m[hand.rows, side]) for side, hand in fitted.items()}
    turns = {side: quaternions(openxr_turns(hand)) for side, hand in fitted.items()}
    row_of = {side: {int(row): n for n, row in enumerate(hand.rows)} for side, hand in fitted.items()}
    for row, (index, time_s) in enumerate(zip(motion.index.tolist(), motion.time_s.tolist(), strict=True)):
        hands: dict[str, Any] = {}
        for side, word in enumerate(SIDES):
            n = row_of.get(side, {}).get(row)
            hands[word] = {"valid": n is not None}
            if n is not None:
                hands[word] |= {
                    "joints_m": np.round(joints[side][n], _DECIMALS).tolist(),
                    "orientations": np.round(turns[side][n], _DECIMALS).tolist(),
                }
        yield json.dumps({"index": index, "time_s": time_s, "hands": hands})


def openxr_joints(joints_m: np.ndarray) -> np.ndarray:
    """The 26 places of a hand.

    Args:
        joints_m: (..., 21, 3) camera frame, metres.

    Returns:
        (..., 26, 3) OpenXR's axes, metres.
    """
    ours = joints_m @ UPRIGHT_FROM_CAMERA.T
    wrist = ours[..., WRIST, :]
    feet = {knuckle: wrist + way * (ours[..., knuckle, :] - wrist) for knuckle, way in METACARPAL_WAY.items()}
    places = [(feet[ROOT] + ours[..., ROOT, :]) / 2, wrist, *(ours[..., joint, :] for joint in range(1, 5))]
    for knuckle, foot in feet.items():
        places += [foot, *(ours[..., knuckle + i, :] for i in range(4))]
    return np.stack(places, axis=-2)


def openxr_turns(hand: FittedHand) -> np.ndarray:
    """(N, 26, 3, 3) rotations from OpenXR's axes of each joint to those of the space; N frames of the fit."""
    own = hand.turns @ hand.skeleton.frames
    feet = {knuckle: hand.turns[:, WRIST] @ _metacarpal(hand.skeleton, knuckle) for knuckle in METACARPAL_WAY}
    turns = [feet[ROOT], own[:, WRIST], *(own[:, joint] for joint in range(1, 5))]
    for knuckle, foot in feet.items():
        turns += [foot, *(own[:, knuckle + i] for i in range(4))]
    return np.stack(turns, axis=1) @ _XR_FROM_BONE


def _metacarpal(skeleton: HandSkeleton, knuckle: int) -> np.ndarray:
    """(3, 3) along, nail and hinge of the way from wrist to knuckle, in the rest pose."""
    along = skeleton.rest_m[knuckle]
    length = np.linalg.norm(along)
    if length < 1e-9 or abs(along[1]) > 0.99 * length:  # no hand; any direction will do
        return skeleton.frames[WRIST]
    along = along / length
    nail = np.array([0.0, 1.0, 0.0]) - along[1] * along
    nail /= np.linalg.norm(nail)
    return np.stack([along, nail, np.cross(along, nail)], axis=-1)
