"""MediaPipe in the place of our networks: its hands on their sides, in metres."""

from pathlib import Path

import numpy as np
import pytest
from tests.lifting import formats
from tests.oracles import drawn_hands

from twohands.lifting import mediapipe_estimator
from twohands.lifting.mediapipe_estimator import MediaPipeEstimator
from twohands.peers.base import DetectedHand
from twohands.peers.mediapipe_hands import BONE_RATIO
from twohands.skeleton import LEFT, RIGHT


class StandIn:
    """A MediaPipe that sees everything right, but takes both hands for left ones."""

    version = "0"

    def __init__(self, python: Path | None, **options: object) -> None:
        self.closed = False

    def detect(self, image: np.ndarray) -> list[DetectedHand]:
        sample = drawn_hands(1)
        return [
            DetectedHand(LEFT, 0.9 - 0.2 * side, sample.joints_px[side], formats.shape_of(sample, side))
            for side in (LEFT, RIGHT)
        ]

    def close(self) -> None:
        self.closed = True


def test_its_hands_get_metres_and_sides(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mediapipe_estimator, "MediaPipeHands", StandIn)
    sample = drawn_hands(1)
    with MediaPipeEstimator(video=True) as estimator:
        pose = estimator.estimate(sample.image, sample.camera, 0.1 / BONE_RATIO, index=7, time_s=0.25)
    assert (pose.index, pose.time_s, estimator.name) == (7, 0.25, "MediaPipe Hands 0")
    for side, hand in enumerate(pose.hands):
        assert hand.joints_m is not None
        np.testing.assert_allclose(hand.joints_m, sample.joints_m[side], atol=1e-9)
