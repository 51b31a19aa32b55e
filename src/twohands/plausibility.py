"""What can be computed with and yet is hard to believe: hand lengths, cameras and ranges, each with the likely mistake.

A number in the wrong unit gives ranges that are wrong by the factor between the units, and nothing else looks amiss.
The bounds are wide: within them lie children's hands and telephoto lenses; outside, a mistake is likelier.
"""

from __future__ import annotations

import math
import warnings
from typing import Final

from twohands.errors import PlausibilityWarning
from twohands.types import PinholeCamera

HAND_LENGTH_M: Final = (0.055, 0.15)
"""|wrist - middle knuckle| of our skeleton, from small children to the largest adults."""
FIELD_OF_VIEW_DEG: Final = (8.0, 140.0)
"""Along the longer side, of lenses that a pinhole describes."""
RANGE_M: Final = (0.08, 8.0)
"""Distance at which a hand fills a lens, and at which it is a few pixels."""
CENTRED: Final = (0.3, 0.7)
"""Where the principal point lies, as fractions of width and height."""
LARGEST_NUMBER: Final = 1e9
"""Of a joint's coordinates, in whatever unit: no picture or room is larger, and squares of them can still be summed."""
_SAME_TIMES: Final = 1.15
"""Between width and height, of a picture that was scaled, where the principal point is near the middle."""
_LIKELY_HAND_M: Final = (0.075, 0.135)
_LIKELY_FOV_DEG: Final = (25.0, 130.0)


def hand_length_doubts(hand_length_m: float) -> list[str]:
    """What is hard to believe about |wrist - middle knuckle| in metres, at most one line."""
    low, high = HAND_LENGTH_M
    if low <= hand_length_m <= high:
        return []
    centimetres = 100 * hand_length_m
    guesses = [
        what
        for metres, what in (
            (hand_length_m / 100, "it looks like centimetres; metres are expected here"),
            (hand_length_m / 1000, "it looks like millimetres; metres are expected here"),
            (hand_length_m * 0.0254, "it looks like inches; metres are expected here"),
            (centimetres * 0.0254, "it looks like inches; centimetres are expected"),
            (centimetres / 1000, "it looks like millimetres; centimetres are expected"),
            (centimetres, "it looks like metres; centimetres are expected"),
            (0.6 * hand_length_m, "it looks like the whole hand, from wrist to fingertip: take 0.6 times that"),
        )
        if _LIKELY_HAND_M[0] <= metres <= _LIKELY_HAND_M[1]
    ]
    guess = guesses[0] if guesses else f"{100 * low:g} to {100 * high:g} cm are usual"
    return [
        f"a hand length of {centimetres:g} cm from wrist to middle knuckle is hard to believe, and ranges scale with "
        f"it: {guess}"
    ]


def camera_doubts(camera: PinholeCamera) -> list[str]:
    """What is hard to believe about a camera, one line each."""
    long_side, focal = max(camera.width, camera.height), max(camera.fx, camera.fy)
    fov_deg = 2 * math.degrees(math.atan(long_side / (2 * focal)))
    if max(camera.fx, camera.fy, abs(camera.cx), abs(camera.cy)) < 10 and min(camera.width, camera.height) >= 32:
        guess = "fractions of its size: multiply them by its width and height"
        if min(camera.cx, camera.cy) > 1:
            guess = "millimetres: divide them by the size of the sensor's pixels"
        elif min(camera.cx, camera.cy) < 0:
            guess = "an inverted camera matrix: give the matrix itself"
        return [
            f"intrinsics of fx {camera.fx:g}, fy {camera.fy:g}, cx {camera.cx:g}, cy {camera.cy:g} for a picture of "
            f"{camera.width}x{camera.height} look like {guess}, pixels are expected"
        ]
    low, high = FIELD_OF_VIEW_DEG
    doubts = []
    if not low <= fov_deg <= high:
        if fov_deg > high:
            guess = "pinhole cameras this wide are hardly built, and a fisheye's pictures must be undistorted first"
            if 1 <= focal < 100 < long_side / 4:
                guess = f"millimetres? Pixels are expected; or else, {guess}"
        elif _LIKELY_FOV_DEG[0] <= math.degrees(camera.hfov_deg) <= _LIKELY_FOV_DEG[1]:
            radians = camera.hfov_deg
            guess = f"radians? {radians:.3g} radians are {math.degrees(radians):.0f} degrees; degrees are expected"
        else:
            guess = "of a larger picture, or in another unit? Pixels are expected"
        doubts.append(
            f"a focal length of {focal:g} pixels, a field of view of {fov_deg:.3g} degrees along the {long_side} "
            f"pixels of the longer side, is hard to believe, and ranges depend on it: {guess}"
        )
    if not 0.75 <= camera.fx / camera.fy <= 4 / 3:
        doubts.append(f"fx {camera.fx:g} and fy {camera.fy:g} differ much; pixels of nearly all cameras are square")
    if not _centred(camera.cx, camera.cy, camera):
        guess = "was the picture cropped?"
        times = (2 * camera.cx / camera.width, 2 * camera.cy / camera.height)
        if _centred(camera.cy, camera.cx, camera):
            guess = "cx and cy, or width and height, look exchanged"
        elif min(times) > 0 and max(times) < _SAME_TIMES * min(times):
            guess = f"are the intrinsics of a picture {sum(times) / 2:.2g} times as large? Then scale them"
        doubts.append(
            f"a principal point of ({camera.cx:g}, {camera.cy:g}) in a picture of {camera.width}x{camera.height} is "
            f"far from its middle: {guess}"
        )
    return doubts


def range_doubts(range_m: float) -> list[str]:
    """What is hard to believe about the distance of a hand that was found, in metres, at most one line."""
    low, high = RANGE_M
    if not math.isfinite(range_m) or low <= range_m <= high:
        return []
    which = f"nearer than {100 * low:g} cm" if range_m < low else f"farther than {high:g} m"
    return [  # the same words for all, so that Python shows them once
        f"a hand {which} is hard to believe: focal length, field of view or hand length may be in another "
        "unit than expected"
    ]


def warn(doubts: list[str], stacklevel: int = 2) -> None:
    """Gives each as a `PlausibilityWarning`; Python shows the same one once."""
    for doubt in doubts:
        warnings.warn(doubt, PlausibilityWarning, stacklevel=stacklevel + 1)


def _centred(cx: float, cy: float, camera: PinholeCamera) -> bool:
    low, high = CENTRED
    return low <= cx / camera.width <= high and low <= cy / camera.height <= high
