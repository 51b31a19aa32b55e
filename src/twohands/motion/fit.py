"""A hand of fixed bones, fitted to the joints of a clip: what BVH files and avatars can move.

Estimated joints make bones that vary by some per cent from frame to frame; skeletons of animators have rotations alone.
Once for each clip and hand:

1. the palm, wrist and the five places where fingers begin, is one rigid piece: the median over all frames of the palms
   laid on one another;
2. each of the other bones is as long as the median of it.

Then for each frame, in closed form:

3. the palm is laid on its joints by least squares (Kabsch);
4. from the palm to the tips, each bone aims from where it begins in the fit at the joint where it should end: the
   nearest place that its length allows, so that errors do not add up along a finger;
5. its rotation follows from two angles: flexion about the hinge that lies across the finger, then abduction. Nothing
   twists about a bone, and a finger that bends keeps its nail above (docs/export.md, *The fit*).

Rest pose, in which all rotations are the identity: the T-pose of VRM in the upright frame, seen from behind the person:
the left hand's fingers along -x, the right hand's along +x, backs of the hands up (+y), thumbs forward (-z) at 45
degrees.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from twohands.motion.clip import UPRIGHT_FROM_CAMERA, HandMotion
from twohands.skeleton import INDEX_MCP, LEFT, LITTLE_MCP, N_JOINTS, PARENTS, ROOT, WRIST

PALM: Final = (WRIST, 1, INDEX_MCP, ROOT, 13, LITTLE_MCP)
"""The rigid piece: the wrist and the first joint of every finger."""
_THUMB_PAD: Final = 0.6
"""Which way the thumb's pad looks: across the palm, and this much into it (as in the generator's hands)."""
_ROUNDS: Final = 8
"""Of laying palms on one another; their median stands still after three or four."""


@dataclass(frozen=True, slots=True, eq=False)
class HandSkeleton:
    """A hand at rest.

    Attributes:
        side: LEFT or RIGHT.
        rest_m: (21, 3) joints in the rest pose, wrist at the origin, upright axes, metres.
        frames: (21, 3, 3) of the bone that begins in a joint: its columns are along the bone, towards the nail, and the
            hinge, in the rest pose. A fingertip has that of the bone before it; the wrist's is the palm's.
    """

    side: int
    rest_m: np.ndarray
    frames: np.ndarray

    @property
    def offsets_m(self) -> np.ndarray:
        """(21, 3) from each joint's parent to it in the rest pose; the wrist's is 0."""
        parents = np.maximum(PARENTS, 0)
        return self.rest_m - self.rest_m[parents]

    def joints(self, wrist_m: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """Forward kinematics.

        Args:
            wrist_m: (..., 3) upright frame.
            turns: (..., 21, 3, 3) of bones, from the rest pose.

        Returns:
            (..., 21, 3) upright frame, metres.
        """
        joints = np.empty((*wrist_m.shape[:-1], N_JOINTS, 3))
        joints[..., WRIST, :] = wrist_m
        for joint in range(1, N_JOINTS):
            parent = PARENTS[joint]
            joints[..., joint, :] = joints[..., parent, :] + turns[..., parent, :, :] @ self.offsets_m[joint]
        return joints


@dataclass(frozen=True, slots=True, eq=False)
class FittedHand:
    """A hand's fit over the N frames in which it is valid.

    Attributes:
        skeleton: at rest.
        rows: (N,) int, those frames' rows in the motion.
        turns: (N, 21, 3, 3) rotations of the bones that begin in each joint, from the rest pose to the upright frame;
            those of fingertips are those of the bones before them.
        joints_m: (N, 21, 3) of the fit, upright frame, metres.
        distance_m: (N, 21) from them to the joints that were fitted.
    """

    skeleton: HandSkeleton
    rows: np.ndarray
    turns: np.ndarray
    joints_m: np.ndarray
    distance_m: np.ndarray

    def local_turns_of(self, frames: np.ndarray | slice = slice(None)) -> np.ndarray:
        """(M, 21, 3, 3) rotations of some of the N frames, relative to the joints' parents; the wrist's as it is."""
        turns = self.turns[frames]
        local = np.swapaxes(turns[:, np.maximum(PARENTS, 0)], -1, -2) @ turns
        local[:, WRIST] = turns[:, WRIST]
        return local


def fit_motion(motion: HandMotion) -> dict[int, FittedHand]:
    """Fits both hands of a clip.

    Returns:
        By side, LEFT or RIGHT, of the hands that are valid in some frame.
    """
    return {side: fit_hand(motion.joints_m[:, side], motion.valid[:, side], side) for side in motion.sides}


def fit_hand(joints_m: np.ndarray, valid: np.ndarray, side: int) -> FittedHand:
    """Fits one hand.

    Args:
        joints_m: (F, 21, 3) camera frame, metres.
        valid: (F,) bool, at least one.
        side: LEFT or RIGHT.
    """
    rows = np.flatnonzero(valid)
    seen = joints_m[rows] @ UPRIGHT_FROM_CAMERA.T
    return pose_hand(fit_skeleton(seen, side), seen, rows)


def fit_skeleton(seen: np.ndarray, side: int) -> HandSkeleton:
    """The bones that suit all frames: steps 1 and 2.

    Args:
        seen: (N, 21, 3) joints in the upright frame, metres, N >= 1.
        side: LEFT or RIGHT.
    """
    palm = _median_palm(seen[:, PALM], side)
    palm = (palm - palm[0]) @ _palm_axes(palm, side)
    rest = np.zeros((N_JOINTS, 3))
    frames = np.zeros((N_JOINTS, 3, 3))
    outwards = -1.0 if side == LEFT else 1.0
    upright = np.diag([outwards, 1.0, outwards])  # columns: along the fingers, the back of the hand, and their normal
    rest[list(PALM)] = palm @ upright.T
    thumb = _thumb_frame(outwards)
    frames[WRIST] = upright
    lengths = np.median(np.linalg.norm(seen - seen[:, np.maximum(PARENTS, 0)], axis=-1), axis=0)
    for joint in range(1, N_JOINTS):
        frames[joint] = thumb if joint <= 4 else upright
        if joint not in PALM:
            rest[joint] = rest[PARENTS[joint]] + lengths[joint] * frames[joint][:, 0]
    return HandSkeleton(side, rest, frames)


def pose_hand(skeleton: HandSkeleton, seen: np.ndarray, rows: np.ndarray) -> FittedHand:
    """The bones laid on the joints of every frame: steps 3 to 5.

    Args:
        skeleton: to be posed.
        seen: (N, 21, 3) joints in the upright frame, metres.
        rows: (N,) what to call the frames.
    """
    palm, wrist = _lay_on(skeleton.rest_m[list(PALM)], seen[:, PALM])
    turns = np.empty((len(seen), N_JOINTS, 3, 3))
    joints = np.empty((len(seen), N_JOINTS, 3))
    turns[:, WRIST], joints[:, WRIST] = palm, wrist
    offsets = skeleton.offsets_m
    for joint in range(1, N_JOINTS):
        parent = PARENTS[joint]
        joints[:, joint] = joints[:, parent] + turns[:, parent] @ offsets[joint]
        if joint % 4 == 0:
            turns[:, joint] = turns[:, parent]
        else:
            aim = seen[:, joint + 1] - joints[:, joint]
            turns[:, joint] = turns[:, parent] @ _hinged(aim, turns[:, parent], skeleton.frames[joint])
    return FittedHand(skeleton, rows, turns, joints, np.linalg.norm(joints - seen, axis=-1))


def _hinged(aim: np.ndarray, parent: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """(N, 3, 3) local rotations, from the rest pose, that turn a bone towards `aim` (N, 3): flexion, then abduction.

    A bone that is to point nowhere stays as it is at rest.
    """
    x, y, z = np.moveaxis(np.einsum("ji,nkj,nk->ni", frame, parent, aim), -1, 0)
    flexion, abduction = np.arctan2(y, x), -np.arctan2(z, np.hypot(x, y))
    cos_f, sin_f, cos_a, sin_a = np.cos(flexion), np.sin(flexion), np.cos(abduction), np.sin(abduction)
    zero = np.zeros_like(cos_f)
    turn = np.stack(
        [
            np.stack([cos_f * cos_a, -sin_f, cos_f * sin_a], axis=-1),
            np.stack([sin_f * cos_a, cos_f, sin_f * sin_a], axis=-1),
            np.stack([-sin_a, zero, cos_a], axis=-1),
        ],
        axis=-2,
    )
    return frame @ turn @ frame.T


def _lay_on(shape: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (N, 3, 3) and the places (N, 3) of the shape's origin that bring (K, 3) nearest to (N, K, 3)."""
    middle, middles = shape.mean(axis=0), seen.mean(axis=1)
    u, _, vt = np.linalg.svd(np.swapaxes(seen - middles[:, None], -1, -2) @ (shape - middle))
    u[..., 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    turn = u @ vt
    return turn, middles - turn @ middle


def _median_palm(palms: np.ndarray, side: int) -> np.ndarray:
    """(K, 3) the median of the shapes (N, K, 3), wherever they lie, in axes of its own; begins with the most usual."""
    apart = np.linalg.norm(palms[:, :, None] - palms[:, None], axis=-1)
    shape = palms[np.abs(apart - np.median(apart, axis=0)).sum(axis=(1, 2)).argmin()]
    shape = shape @ _palm_axes(shape, side)  # so that it is the same one, whichever way the clip is turned
    for _ in range(_ROUNDS):
        turn, origin = _lay_on(shape, palms)
        shape = np.median((palms - origin[:, None]) @ turn, axis=0)
    return shape


def _palm_axes(palm: np.ndarray, side: int) -> np.ndarray:
    """(3, 3) whose columns are along the fingers of a palm (K, 3), out of the back of the hand, and across."""
    wrist, index, middle, little = (palm[PALM.index(joint)] for joint in (WRIST, INDEX_MCP, ROOT, LITTLE_MCP))
    along = _unit(middle - wrist, np.array([1.0, 0.0, 0.0]))
    thumbwards = index - little
    nail = np.cross(thumbwards, along) if side == LEFT else np.cross(along, thumbwards)
    spare = np.eye(3)[np.abs(along).argmin()]
    nail = _unit(nail, _unit(np.cross(along, spare), spare))
    return np.stack([along, nail, np.cross(along, nail)], axis=-1)


def _thumb_frame(outwards: float) -> np.ndarray:
    """(3, 3) of the thumb's bones at rest: along, nail, hinge."""
    along = np.array([outwards, 0.0, -1.0]) / np.sqrt(2)
    pad = np.array([0.0, -_THUMB_PAD, 1.0])  # across the palm, away from the thumb, and into it
    nail = -pad + (pad @ along) * along
    nail /= np.linalg.norm(nail)
    return np.stack([along, nail, np.cross(along, nail)], axis=-1)


def _unit(vector: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    """Of length 1; `otherwise` where it has none."""
    length = np.linalg.norm(vector)
    return vector / length if length > 1e-12 else otherwise
