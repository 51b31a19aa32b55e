"""Colours of hands and fingers, shared by every picture.

Left is blue, right is orange: the pair of the Okabe-Ito palette that stays apart under all common kinds of colour
blindness, and by brightness alone where there is no colour. Fingers run from light (thumb) to dark (little finger).
"""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np

from twohands.skeleton import FINGERS, SIDES

HAND_COLOURS: Final = ((86, 180, 233), (230, 159, 0))
"""RGB of (LEFT, RIGHT)."""
HAND_INITIALS: Final = tuple(side[0].upper() for side in SIDES)

_SHADES: Final = (0.50, 0.25, 0.0, -0.22, -0.44)
"""Mix of each finger with white (positive) or black (negative)."""


@cache
def finger_colour(side: int, finger: int) -> tuple[int, int, int]:
    """RGB of one finger.

    Args:
        side: LEFT or RIGHT.
        finger: index into `skeleton.FINGERS`.
    """
    shade = _SHADES[finger]
    target = 255.0 if shade > 0 else 0.0
    mixed = (1 - abs(shade)) * np.array(HAND_COLOURS[side]) + abs(shade) * target
    red, green, blue = (round(float(c)) for c in mixed)
    return red, green, blue


def joint_colour(side: int, joint: int) -> tuple[int, int, int]:
    """RGB of a joint and of the bone that ends in it; the wrist has the hand's own colour."""
    return HAND_COLOURS[side] if joint == 0 else finger_colour(side, (joint - 1) // 4)


assert len(_SHADES) == len(FINGERS)
