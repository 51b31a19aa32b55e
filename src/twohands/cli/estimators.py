"""The estimator that a command is told to use: ours, or MediaPipe's hands lifted to metres."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Literal, NamedTuple

from twohands.inference.decision import DecisionConfig
from twohands.inference.estimator import HandEstimator
from twohands.lifting.mediapipe_estimator import MediaPipeEstimator
from twohands.types import TwoHandPose


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


def opened(
    stack: ExitStack, kind: Literal["ours", "mediapipe"], weights: str, python: Path | None, model: Path | None
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
        peer = stack.enter_context(MediaPipeEstimator(python, model=model, video=True))
        return OpenEstimator(peer.estimate, peer.name, {}, None)
    ours = HandEstimator.from_preset(weights)
    return OpenEstimator(ours.estimate, ours.card.name, {"config": ours.card.settings()}, ours.card.decision)
