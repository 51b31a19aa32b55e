"""What is known of camera and hand, by the options of a command: said, kept in a profile, noted by a picture, assumed.

`track` and `calibrate` ask here. An option counts before a profile, a profile before what a picture notes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from twohands.errors import InputError
from twohands.formats.camera_files import camera_for_image, read_camera
from twohands.formats.noted_camera import noted_camera
from twohands.formats.profiles import IntrinsicsSource, Profile, ScaleSource, read_profile
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


def camera_assumption(source: IntrinsicsSource) -> str | None:
    """What is assumed of a camera that is known so, in a line; None where nothing is."""
    if source == "exif":
        return "no camera given: taking the focal length that the pictures note (--camera FILE says it better)"
    if source == "assumed":
        return (
            f"no camera given: assuming a field of view of {DEFAULT_FOV_DEG:g} degrees along the longer side; "
            "ranges depend on it (--camera FILE, --fov DEG, or twohands calibrate)"
        )
    return None


def known_by(
    camera: Path | None, fov_deg: float | None, hand_length_cm: float | None, profile: str | None = None
) -> Known:
    """What the options say.

    Args:
        camera: --camera.
        fov_deg: --fov.
        hand_length_cm: --hand-length.
        profile: --profile.

    Raises:
        InputError: options that contradict each other or cannot be, a file or profile that cannot be read.
        DataFormatError: a file or profile that holds something else.
    """
    if camera is not None and fov_deg is not None:
        raise InputError("give --camera or --fov, not both")
    if fov_deg is not None:
        PinholeCamera.from_fov(fov_deg, 1000, 1000)  # refuses what is no field of view
    if hand_length_cm is not None and not (math.isfinite(hand_length_cm) and hand_length_cm > 0):
        raise InputError(f"--hand-length must be a positive number of cm, got {hand_length_cm}")
    kept = Profile() if profile is None else read_profile(profile)
    said = camera is not None or fov_deg is not None
    if said and hand_length_cm is None and kept.scale_source == "distance":
        raise InputError(
            f"profile '{profile}' has a hand length from a taped distance, which holds with its own camera alone; "
            "leave --camera and --fov out, or give --hand-length"
        )
    if camera is not None:
        lens, source = read_camera(camera), "file"
    elif fov_deg is not None:
        lens, source = None, "fov"
    else:
        lens, source = kept.camera, kept.intrinsics_source
    if hand_length_cm is not None:
        return Known(hand_length_cm / 100, "typed", lens, fov_deg, source)
    if kept.hand_length_m is not None:
        return Known(kept.hand_length_m, kept.scale_source or "typed", lens, fov_deg, source)
    return Known(camera=lens, fov_deg=fov_deg, camera_source=source)


def assumed_camera(width: int, height: int) -> PinholeCamera:
    """The camera of a picture of which nothing is known: `DEFAULT_FOV_DEG` along the longer side, so that a telephone
    has one focal length however it is held."""
    focal = PinholeCamera.from_fov(DEFAULT_FOV_DEG, max(width, height), min(width, height)).fx
    return PinholeCamera(focal, focal, width / 2, height / 2, width, height)
