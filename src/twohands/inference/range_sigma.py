"""How far a range may be off: the estimate's own standard deviation, and that of what was assumed.

The estimate's own comes from `placement.range_sigma`. A range goes with focal length and hand length one to one; where
one of them is not known, its spread over cameras or people comes on top.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

from twohands.types import HandPose, TwoHandPose

ASSUMED_LENGTH_SPREAD: Final = 0.234
"""How far the hand lengths of 68 % of the generator's 1,200 adults are from the assumed 10 cm at most, as a share of
it; most are longer."""
TYPED_LENGTH_SPREAD: Final = 0.054
"""Of the logarithm of the length from wrist to middle knuckle over that of the whole hand, over the same adults: what
is open where a user has measured the latter."""
TAPED_SPREAD: Final = 0.03
"""Of ranges after a hand at a taped distance, whose own range was off as well: `calibration.tape`."""
ASSUMED_FOCAL_SPREAD: Final = 0.48
"""The same of the focal length over that of 60 degrees, over fields of view drawn evenly from 50 to 110 degrees, which
are those of scene style wild."""


def with_sources(pose: TwoHandPose, scale_source: str, intrinsics_source: str) -> TwoHandPose:
    """The same hands, with how length and camera are known, and standard deviations that allow for it.

    Args:
        pose: as estimated from a length and a camera taken for true.
        scale_source, intrinsics_source: as in `HandPose`.

    Returns:
        A new record; absent hands as they are.
    """
    lengths = {"assumed": ASSUMED_LENGTH_SPREAD, "typed": TYPED_LENGTH_SPREAD, "distance": TAPED_SPREAD}
    assumed = math.hypot(
        lengths.get(scale_source, 0.0),
        # a taped distance makes up for whatever focal length was assumed
        ASSUMED_FOCAL_SPREAD if intrinsics_source == "assumed" and scale_source != "distance" else 0.0,
    )

    def known(hand: HandPose) -> HandPose:
        if not hand.present:
            return hand
        sigma_m = hand.range_sigma_m
        if sigma_m is not None and hand.range_m is not None:
            sigma_m = math.hypot(sigma_m, assumed * hand.range_m)
        return replace(hand, range_sigma_m=sigma_m, scale_source=scale_source, intrinsics_source=intrinsics_source)

    return replace(pose, left=known(pose.left), right=known(pose.right))
