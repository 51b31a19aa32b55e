"""What is known of camera and hand: said, kept in a profile, noted by a picture, or assumed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from twohands.formats.camera_files import camera_for_image
from twohands.formats.noted_camera import noted_camera
from twohands.formats.profiles import IntrinsicsSource, ScaleSource
from twohands.inference.estimator import DEFAULT_HAND_LENGTH_M
from twohands.types import PinholeCamera

DEFAULT_FOV_DEG: Final = 60.0


@dataclass(frozen=True, slots=True)
class Known:
    """What is known.

    Attributes:
        hand_length_m: |wrist - middle knuckle|, metres.
        scale_source: how it is known.
        camera: of a file or profile; None where there is none.
        fov_deg: horizontal field of view that was said; None where it was not.
        camera_source: how the camera is known; None where neither camera nor field of view is.
    """

    hand_length_m: float = DEFAULT_HAND_LENGTH_M
    scale_source: ScaleSource = "assumed"
    camera: PinholeCamera | None = None
    fov_deg: float | None = None
    camera_source: IntrinsicsSource | None = None

    def camera_of(self, width: int, height: int, path: Path | None = None) -> tuple[PinholeCamera, IntrinsicsSource]:
        """The camera of an upright picture, and how it is known.

        Args:
            width, height: of the picture, pixels.
            path: its file, which may note something; None for frames of a video.

        Raises:
            InputError: the camera that is known is of another aspect.
        """
        if self.camera is not None:
            return camera_for_image(self.camera, width, height), self.camera_source or "file"
        if self.fov_deg is not None:
            return PinholeCamera.from_fov(self.fov_deg, width, height), "fov"
        noted = None if path is None else noted_camera(path, width, height)
        return (assumed_camera(width, height), "assumed") if noted is None else (noted, "exif")

    def assumptions(self) -> list[str]:
        """What was assumed of all pictures, a line each, none where nothing was."""
        if self.scale_source != "assumed":
            return []
        return [
            f"no hand length given: assuming {100 * DEFAULT_HAND_LENGTH_M:g} cm from wrist to middle knuckle; "
            "ranges scale with it (--hand-length CM, or twohands calibrate)"
        ]


def assumed_camera(width: int, height: int) -> PinholeCamera:
    """The camera of a picture of which nothing is known: `DEFAULT_FOV_DEG` along the longer side, so that a telephone
    has one focal length however it is held."""
    focal = PinholeCamera.from_fov(DEFAULT_FOV_DEG, max(width, height), min(width, height)).fx
    return PinholeCamera(focal, focal, width / 2, height / 2, width, height)
