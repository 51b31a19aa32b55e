"""A clip that comes picture by picture: what its header and its frames' lines are."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np

from twohands.errors import InputError
from twohands.formats.profiles import IntrinsicsSource
from twohands.inference.clip_files import frame_line, header_line
from twohands.inference.decision import DecisionConfig
from twohands.inference.range_sigma import with_sources
from twohands.inference.trail import Trail
from twohands.inference.video import VideoEstimator
from twohands.live.measuring import Measured, Measuring
from twohands.live.messages import Settings
from twohands.types import PinholeCamera, TwoHandPose

Estimate = Callable[..., TwoHandPose]
"""`HandEstimator.estimate` or its like: (image, camera, hand length, index=, time_s=, previous=) -> pose."""
CameraFor = Callable[[float | None, int, int], tuple[PinholeCamera, IntrinsicsSource]]
"""(field of view in degrees or None, width, height) -> camera and how it is known, or InputError where that cannot
be."""


class Told(NamedTuple):
    """What one picture gives.

    Attributes:
        header: the clip's, the same string object for all of its frames.
        line: the frame's.
        note: for who has asked to measure; None where nobody has.
    """

    header: str
    line: str
    note: str | None


class Listener(Protocol):
    """Whoever wants the poses themselves."""

    def begin(self) -> None:
        """A new clip."""
        ...

    def send(self, pose: TwoHandPose) -> None:
        """A frame."""
        ...


class LiveClip:
    """Estimates one clip after the other; for one thread.

    Args:
        estimate: of single pictures.
        camera_for: camera of pictures of a size.
        weights: what estimates.
        more: what else headers say.
        settings: of the first clip.
        listener: who else is told; None for nobody.
        decision: of the weights' card; None for an estimator that has none.
    """

    def __init__(
        self,
        estimate: Estimate,
        camera_for: CameraFor,
        weights: str,
        more: Mapping[str, Any],
        settings: Settings,
        listener: Listener | None = None,
        decision: DecisionConfig | None = None,
    ) -> None:
        self._estimate = estimate
        self._camera_for = camera_for
        self._weights = weights
        self._more = dict(more)
        self._listener = listener
        self._video = VideoEstimator(decision=decision)
        self.begin(settings)

    def begin(self, settings: Settings) -> None:
        """A new clip; what was before is forgotten."""
        self._settings = settings
        self._camera: tuple[PinholeCamera, IntrinsicsSource] | None = None
        self._measuring: Measuring | None = None
        self._header = ""
        self._video.reset()
        if self._listener is not None:
            self._listener.begin()

    def measure(self, distance_m: float | None) -> None:
        """One hand is held at that distance from the lens, metres: some frames from now on the hand length is what they
        say, and a new clip begins. None: no more."""
        self._measuring = None if distance_m is None else Measuring(distance_m, self._settings)

    def frame(self, image: np.ndarray, index: int, time_s: float) -> Told:
        """One picture.

        Args:
            image: (H, W, 3) uint8 RGB.
            index: position in the clip.
            time_s: in the clip's clock, later than the last one's.

        Raises:
            InputError: the picture does not fit the camera or those before it.
        """
        settings = self._settings
        image = np.ascontiguousarray(image[:, ::-1]) if settings.mirrored else image
        height, width = image.shape[:2]
        camera, source = self._camera or self._camera_for(settings.fov_deg, width, height)
        if (camera.width, camera.height) != (width, height):
            raise InputError(
                f"the size changes from {camera.width}x{camera.height} to {width}x{height}; begin a new clip"
            )
        estimated: list[TwoHandPose] = []

        def run(previous: Trail | None) -> TwoHandPose:
            length = settings.hand_length_m
            estimated.append(self._estimate(image, camera, length, index=index, time_s=time_s, previous=previous))
            return with_sources(estimated[-1], settings.scale_source, source)

        pose = self._video.update(run)
        if self._camera is None:
            self._camera = camera, source
            self._header = header_line(
                camera,
                source=settings.source,
                weights=self._weights,
                hand_length_m=settings.hand_length_m,
                more=self._more | {"mirrored": settings.mirrored, "smoothed": True, "look_ahead_s": 0.0},
            )
        if self._listener is not None:
            self._listener.send(pose)
        told = self._header, frame_line(pose.without_masks())
        return Told(*told, self._measured(estimated[-1], source))

    def _measured(self, pose: TwoHandPose, source: IntrinsicsSource) -> str | None:
        """What the measuring says of a frame; begins a new clip when it has come to an end."""
        if self._measuring is None:
            return None
        found: Measured = self._measuring.take(pose, source)
        if found.settings is not None:
            self.begin(found.settings)
        elif found.over:
            self._measuring = None
        return found.note
