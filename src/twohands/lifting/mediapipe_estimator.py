"""MediaPipe finds the hands, we give the metres: an estimator of pictures in the place of our own networks."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType

import numpy as np

from twohands.inference.trail import Trail
from twohands.lifting.foreign import ForeignFrame, ForeignHand, ForeignHands
from twohands.lifting.placing import place_hands
from twohands.peers.base import by_own_handedness
from twohands.peers.mediapipe_hands import BONE_RATIO, MediaPipeHands
from twohands.types import PinholeCamera, TwoHandPose


class MediaPipeEstimator:
    """MediaPipe Hands in a process of its own, its hands placed by our geometry; a context manager.

    Args:
        python: interpreter of an environment that holds mediapipe; None for this one.
        model: `hand_landmarker.task` of the Tasks API; None for the legacy solution of mediapipe 0.10.21.
        video: whether pictures are the frames of one video, in which MediaPipe follows hands.

    Raises:
        InputError: no such interpreter, it has no mediapipe, or mediapipe no usable model.
    """

    def __init__(
        self, python: str | Path | None = None, *, model: str | Path | None = None, video: bool = False
    ) -> None:
        self._peer = MediaPipeHands(python, handedness="own", model=model, video=video)
        self.name = f"MediaPipe Hands {self._peer.version}"

    def __enter__(self) -> MediaPipeEstimator:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Ends the process."""
        self._peer.close()

    def estimate(
        self,
        image: np.ndarray,
        camera: PinholeCamera,
        hand_length_m: float,
        *,
        index: int = 0,
        time_s: float | None = None,
        previous: TwoHandPose | Trail | None = None,
    ) -> TwoHandPose:
        """Both hands of one picture.

        Args:
            image: (H, W, 3) uint8 RGB, not mirrored.
            camera: intrinsics at this image size.
            hand_length_m: as `HandEstimator.estimate`; MediaPipe's own bone is `BONE_RATIO` of it.
            index, time_s: position in the source.
            previous: not used; MediaPipe remembers by itself, where pictures are a video's frames.

        Raises:
            DataFormatError: the process has died.
        """
        pair = by_own_handedness(self._peer.detect(image))
        hands = tuple(
            ForeignHand(side, hand.joints_px, hand.shape_m, hand.score)
            for side, hand in enumerate(pair)
            if hand is not None
        )
        found = ForeignHands(self.name, "centred", BONE_RATIO, (ForeignFrame(hands, index, time_s),))
        (pose,) = place_hands(found, camera, BONE_RATIO * hand_length_m)
        return pose
