"""The estimator of a clip: ours, or MediaPipe's hands lifted to metres."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Literal, NamedTuple

from twohands.inference.decision import DecisionConfig
from twohands.inference.estimator import HandEstimator
from twohands.lifting.mediapipe_estimator import MediaPipeEstimator
from twohands.types import TwoHandPose

EstimatorKind = Literal["ours", "mediapipe"]


class OpenEstimator(NamedTuple):
    """What a clip is estimated by.

    Attributes:
        estimate: as `HandEstimator.estimate`.
        weights: its name, for results.
        more: what else headers say of it.
        decision: of the weights' card; None for MediaPipe's, which has none.
    """

    estimate: Callable[..., TwoHandPose]
    weights: str
    more: dict[str, Any]
    decision: DecisionConfig | None

    @classmethod
    def ours(cls, estimator: HandEstimator) -> OpenEstimator:
        """Our networks."""
        return cls(estimator.estimate, estimator.card.name, {"config": estimator.settings()}, estimator.card.decision)

    @classmethod
    def mediapipe(cls, stack: ExitStack, python: str | Path | None, model: str | Path | None) -> OpenEstimator:
        """MediaPipe in a process of its own, for one clip, through which it follows hands; `stack` ends it.

        Raises:
            InputError: as `MediaPipeEstimator`.
        """
        peer = stack.enter_context(MediaPipeEstimator(python, model=model, video=True))
        return cls(peer.estimate, peer.name, {}, None)


def opened(
    stack: ExitStack, kind: EstimatorKind, weights: str, python: Path | None, model: Path | None
) -> OpenEstimator:
    """Opens an estimator for video.

    Args:
        stack: closes it.
        kind: which one.
        weights: of ours.
        python, model: of MediaPipe's.

    Raises:
        InputError, CheckpointError: it cannot be opened.
    """
    if kind == "mediapipe":
        return OpenEstimator.mediapipe(stack, python, model)
    return OpenEstimator.ours(HandEstimator.from_preset(weights))
