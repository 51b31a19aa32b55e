"""What is known of camera and hand, by the options of a command: said, kept in a profile, noted by a picture, assumed.

`track` and `calibrate` ask here. An option counts before a profile, a profile before what a picture notes.
"""

from __future__ import annotations

import math
from pathlib import Path

from twohands.errors import InputError
from twohands.formats.camera_files import read_camera
from twohands.formats.profiles import IntrinsicsSource, Profile, read_profile
from twohands.inference.known import DEFAULT_FOV_DEG, Known
from twohands.types import PinholeCamera


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
