"""What a video has shown so far, as the estimate of its next frame needs it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twohands.inference.side_keeping import NOTHING_KNOWN, SideMemory
from twohands.types import TwoHandPose


@dataclass(frozen=True, slots=True)
class Trail:
    """What a clip has shown so far.

    Attributes:
        last: its last frames, newest last, one or two.
        seen: the last frame that HandSegNet saw.
        may_rest: whether HandSegNet may rest in the frame that comes.
        rested: for how many frames in a row it has.
        sides: what is known of the hands' sides.
        turn_logits: (4,) what the frames together say of the camera's turn, as `TwoHandPose.turn_logits`; None for
            nothing.
    """

    last: tuple[TwoHandPose, ...]
    seen: TwoHandPose
    may_rest: bool = False
    rested: int = 0
    sides: SideMemory = NOTHING_KNOWN
    turn_logits: np.ndarray | None = None

    @classmethod
    def of(cls, pose: TwoHandPose) -> Trail:
        """Of a clip of which one frame is known."""
        return cls((pose,), pose)
