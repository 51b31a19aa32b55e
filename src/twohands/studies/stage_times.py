"""How long each stage of the pipeline takes, measured from outside: the estimator knows nothing of it."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

from twohands.inference.estimator import HandEstimator
from twohands.inference.stages import Stages
from twohands.types import TwoHandPose

STAGES: Final = {
    "hand_maps": "letterbox, HandSegNet",
    "body": "body",
    "boxes": "boxes, masks",
    "masks": "boxes, masks",
    "crop": "crops",
    "locate": "PoseNet2D",
    "read_out": "joints from heatmaps",
    "palms": "palms",
    "check": "HandCheck",
    "lift": "PoseNet3D",
    "place": "global solve",
}
"""Fields of `Stages` and what a reader calls them, in the order of the pipeline."""
REST: Final = "checks, results"
"""What the estimator does between its stages."""
ROWS: Final = (*dict.fromkeys(STAGES.values()), REST)
"""Every name under which time counts, once."""


class StageClock:
    """Adds up the time spent in functions, each without what its own timed callees take.

    Args:
        clock: seconds.

    Attributes:
        seconds: name -> seconds since the last `reset`.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self._clock = clock
        self._inner: list[float] = [0.0]
        self.seconds: dict[str, float] = defaultdict(float)

    def reset(self) -> None:
        """Start from zero."""
        self.seconds.clear()

    def timed(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The same function, whose calls count under `name`."""

        def call(*args: Any, **options: Any) -> Any:
            self._inner.append(0.0)
            start = self._clock()
            try:
                return function(*args, **options)
            finally:
                passed = self._clock() - start
                self.seconds[name] += passed - self._inner.pop()
                self._inner[-1] += passed

        return call


def timed_estimate(estimator: HandEstimator, clock: StageClock) -> Callable[..., TwoHandPose]:
    """`estimate` of an estimator like this one, whose stages count on `clock` under the names in `ROWS`."""
    stages = _timed_stages(estimator.stages, clock)
    return clock.timed(REST, HandEstimator(estimator.networks, estimator.card, stages).estimate)


def _timed_stages(plain: Stages, clock: StageClock) -> Stages:
    """The same stages, those of second pose networks under the same names as the first's."""
    known = {field: getattr(plain, field) for field in STAGES}
    timed = {field: clock.timed(STAGES[field], stage) for field, stage in known.items() if stage is not None}
    return replace(plain, **timed, second=plain.second and _timed_stages(plain.second, clock))
