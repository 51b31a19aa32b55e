"""Both hands over a video: what every frame's estimate becomes by those around it.

The estimator of single pictures is told what the clip has shown so far (`trail.Trail`): what was found one frame
before, where hands will be, of which side they are. Ranges are smoothed and leaving hands carried on (`tracker`).
`track`, `eval --smooth` and a live view do this alike, by this class.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twohands.inference.decision import DecisionConfig
from twohands.inference.expected import as_expected
from twohands.inference.following import longest_rest
from twohands.inference.leaving import CARRIED_FRAMES
from twohands.inference.side_keeping import SideKeeper
from twohands.inference.tracker import DEFAULT_SMOOTHING, HandTracker, RangeSmoothing
from twohands.inference.trail import Trail
from twohands.inference.turning import told_turn
from twohands.types import TwoHandPose

Estimate = Callable[[Trail | None], TwoHandPose]
"""Estimates one frame, told what the clip has shown so far; None for the first."""


class VideoEstimator:
    """Takes the estimates of one clip's frames in their order; one instance per clip, or `reset` between clips.

    State: the last estimates, how long HandSegNet has rested, which side hands are of, by how many quarters the camera
    is turned, the queues of ranges.

    Args:
        smoothing: of the ranges; None leaves them, and leaving hands, as they are.
        carried_frames: for how many frames a leaving hand is carried on.
        rests: whether HandSegNet may rest while hands are followed (`longest_rest`).
        decision: of the weights' card, how what frames say of sides, and of the camera's turn, adds up.

    Attributes:
        frames: how many there were, over all clips.
        rested: in how many of them HandSegNet has rested.
    """

    def __init__(
        self,
        smoothing: RangeSmoothing | None = DEFAULT_SMOOTHING,
        *,
        carried_frames: int = CARRIED_FRAMES,
        rests: bool = True,
        decision: DecisionConfig | None = None,
    ) -> None:
        self._tracker = None if smoothing is None else HandTracker(smoothing, carried_frames)
        self._rests = rests
        self._sides = SideKeeper(decision)
        self.frames = self.rested = 0
        self.reset()

    @property
    def side_changes(self) -> int:
        """How often a hand has taken the other side, over all clips."""
        return self._sides.changes

    def reset(self) -> None:
        """Forget everything about the clip."""
        self._last: tuple[TwoHandPose, ...] = ()
        self._seen: TwoHandPose | None = None
        self._turn: np.ndarray | None = None
        self._resting, self._steady = 0, False
        self._sides.reset()
        if self._tracker is not None:
            self._tracker.reset()

    def update(self, estimate: Estimate) -> TwoHandPose:
        """One frame.

        Args:
            estimate: what estimates it; its pose has a later time, or where that is None a higher index, than the last.

        Returns:
            Both hands, on their sides, with smooth ranges.

        Raises:
            InputError: of the estimate, or the frame does not follow the last one; the frame is then as if it had not
                come.
        """
        trail = self._trail()
        pose = self._sides.kept(estimate(trail))
        smooth = pose if self._tracker is None else self._tracker.update(pose)
        self._sides.remember(pose)
        self._turn = told_turn(self._turn, pose, self._sides.memory.config)
        self._steady = pose.followed or as_expected(pose, trail)
        self._last = (*self._last[-1:], pose)
        self._resting = self._resting + 1 if pose.followed else 0
        self._seen = self._seen if pose.followed else pose
        self.frames, self.rested = self.frames + 1, self.rested + pose.followed
        return smooth

    def _trail(self) -> Trail | None:
        if self._seen is None:
            return None
        sides = self._sides.memory
        calm = self._steady and not sides.misses_one and self._resting < longest_rest(self._last[-1], watched=True)
        return Trail(self._last, self._seen, self._rests and calm, self._resting, sides, self._turn)
