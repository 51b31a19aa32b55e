"""Both hands over a video: what every frame's estimate becomes by those around it.

The estimator of single pictures is told what was found one frame before (`previous`); hands keep their sides
(`side_keeping`), their ranges are smoothed and leaving hands carried on (`tracker`). `track`, `eval --smooth` and a
live view do this alike, by this class.
"""

from __future__ import annotations

from collections.abc import Callable

from twohands.inference.leaving import CARRIED_FRAMES
from twohands.inference.side_keeping import SideKeeper
from twohands.inference.tracker import DEFAULT_SMOOTHING, HandTracker, RangeSmoothing
from twohands.types import TwoHandPose

Estimate = Callable[[TwoHandPose | None], TwoHandPose]
"""Estimates one frame, told the estimate of the frame before; None for the first."""


class VideoEstimator:
    """Takes the estimates of one clip's frames in their order; one instance per clip, or `reset` between clips.

    State: the last estimate, where hands were, the queues of ranges.

    Args:
        smoothing: of the ranges; None leaves them, and leaving hands, as they are.
        carried_frames: for how many frames a leaving hand is carried on.
        keep_sides: whether hands keep their sides.
    """

    def __init__(
        self,
        smoothing: RangeSmoothing | None = DEFAULT_SMOOTHING,
        *,
        carried_frames: int = CARRIED_FRAMES,
        keep_sides: bool = True,
    ) -> None:
        self._tracker = None if smoothing is None else HandTracker(smoothing, carried_frames)
        self._sides = SideKeeper() if keep_sides else None
        self._previous: TwoHandPose | None = None

    @property
    def side_changes(self) -> int:
        """How often hands have changed their sides, over all clips."""
        return 0 if self._sides is None else self._sides.changes

    def reset(self) -> None:
        """Forget everything about the clip."""
        self._previous = None
        if self._sides is not None:
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
        pose = estimate(self._previous)
        kept = pose if self._sides is None else self._sides.update(pose)
        smooth = kept if self._tracker is None else self._tracker.update(kept)
        self._previous = kept
        return smooth
