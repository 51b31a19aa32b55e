"""Where anatomists and most data sets of real hands put the joints of the palm.

The skeleton of the generator, like that of Ego3DHands, is an animator's: its wrist lies inside the forearm, one to two
centimetres above the crease, and its knuckles where the fingers leave the palm rather than in the ball joints. Data
sets of real hands place both by the bones. All of these points are fixed to the palm, so each is a mean of others.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from twohands.skeleton import N_JOINTS, ROOT, WRIST

KNUCKLES: Final = (5, 9, 13, 17)
KNUCKLE_SHIFTS: Final = (0.127, 0.089, 0.073, 0.060)
"""Index to little finger: how far the knuckle moves towards the wrist, as a share of the way. It makes the first
phalanx 1.7, 1.55, 1.5 and 1.75 times as long as the second, about what bone tables of adults say."""
WRIST_SHIFT: Final = 0.160
"""How far the wrist moves towards the middle knuckle, as a share of the way: the palm is then 0.82 times as long as the
middle finger from knuckle to tip."""
HAND_LENGTH: Final = 1.0 - WRIST_SHIFT - KNUCKLE_SHIFTS[1]
"""Distance from the anatomical wrist to the anatomical middle knuckle, in hand lengths of our skeleton: 0.751."""


def _weights(part: float) -> np.ndarray:
    """(21, 21), rows sum to 1: joints on the way to the anatomical ones as means of ours."""
    weights = np.eye(N_JOINTS)
    for knuckle, shift in zip(KNUCKLES, KNUCKLE_SHIFTS, strict=True):
        weights[knuckle, [knuckle, WRIST]] = 1 - part * shift, part * shift
    weights[WRIST, [WRIST, ROOT]] = 1 - part * WRIST_SHIFT, part * WRIST_SHIFT
    return weights


def anatomical_joints(joints: np.ndarray, part: float = 1.0) -> np.ndarray:
    """Joints as data sets of real hands have them.

    Args:
        joints: (..., 21, 3) in our skeleton, any unit and frame, of one hand each; or (..., 21, 2) in the picture.
        part: how far of the way they move, 0..1: some data sets have them in between.

    Returns:
        Array of the same shape, unit and frame: wrist and knuckles moved, all others as they are.

    Source: ours. Proportions after anthropometric tables (for example Buchholz, Armstrong and Goldstein 1992); no data
    set of pictures was fitted.
    """
    return _weights(part) @ joints


def skeleton_joints(joints: np.ndarray, part: float = 1.0) -> np.ndarray:
    """The reverse of `anatomical_joints`: joints of data sets of real hands as our skeleton has them.

    Args:
        joints: (..., 21, 3), any unit and frame, of one hand each; or (..., 21, 2) in a picture, which is
            right as far as a palm has one depth.
        part: as for `anatomical_joints`.

    Returns:
        Array of the same shape, unit and frame: wrist and knuckles moved, all others as they are.
    """
    return np.linalg.solve(_weights(part), joints)
