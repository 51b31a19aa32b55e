"""A camera's intrinsics and lens from views of the printed board, and whether these views are enough to know them.

OpenCV's calibration with k1, k2, p1, p2. Views are refused, not averaged away: a board that was seen too seldom, or
from one side alone, gives a focal length that looks as good as any and is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np

from twohands.calibration.board import COLUMNS, N_CORNERS, BoardView
from twohands.errors import InputError
from twohands.geometry.rotation import centring_angles, rotation_from_angles
from twohands.types import PinholeCamera

LEAST_VIEWS: Final = 8
LEAST_CORNERS: Final = N_CORNERS // 4
"""Of a view that counts."""
LEAST_TILT_DEG: Final = 12.0
"""By which the board must be turned away to each side at least once: its foreshortening tells the focal length."""
MOST_FOCAL_SIGMA: Final = 0.005
"""Standard deviation of the focal length, as a share of it, beyond which the views do not tell it."""
OUTLIER: Final = 3.0
"""Views whose error is so many times the median's are left out: a bent paper, a shutter that rolled."""
MOST_VIEWS: Final = 50
_MOVED: Final = 0.005
"""Share of the picture's diagonal by which corners must have moved for a view to tell something new."""
_AREAS: Final = ("upper left", "top", "upper right", "left", "middle", "right", "lower left", "bottom", "lower right")
_TILTS: Final = (
    (0, 1, "with its upper edge towards the camera"),
    (0, -1, "with its lower edge towards the camera"),
    (1, -1, "with its left edge towards the camera"),
    (1, 1, "with its right edge towards the camera"),
)
"""Axis and sign of the board's tilt, in words."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraFit:
    """What the views tell.

    Attributes:
        camera: intrinsics and lens.
        views: those that were used.
        errors_px: for each, root mean square distance of its corners from where the camera should see them.
        rms_px: the same over all.
        focal_sigma: standard deviation of the focal length, as a share of it.
        left_out: views that disagreed with the others.
        unseen: parts of the picture in which the board never was; the lens is extrapolated there.
    """

    camera: PinholeCamera
    views: tuple[BoardView, ...]
    errors_px: np.ndarray
    rms_px: float
    focal_sigma: float
    left_out: int
    unseen: tuple[str, ...]


def usable(view: BoardView) -> bool:
    """Whether enough corners are seen, in more than one row and column."""
    rows, columns = np.divmod(view.ids, COLUMNS - 1)
    return len(view.ids) >= LEAST_CORNERS and np.ptp(rows) >= 2 and np.ptp(columns) >= 2


def is_new(view: BoardView, kept: Sequence[BoardView]) -> bool:
    """Whether a view shows the board elsewhere, or otherwise turned, than all those that are kept."""
    least_px = _MOVED * math.hypot(*view.size)
    for other in kept:
        common, mine, theirs = np.intersect1d(view.ids, other.ids, return_indices=True)
        if len(common) < len(view.ids) / 2:
            continue
        moved = np.linalg.norm(view.corners_px[mine] - other.corners_px[theirs], axis=-1).mean()
        if moved < least_px:
            return False
    return True


def fit_camera(views: Sequence[BoardView]) -> CameraFit:
    """The camera that saw the board so.

    Args:
        views: of one camera; those that are not `usable` do not count.

    Returns:
        The camera, with pixels counted from the outer corner of the first one.

    Raises:
        InputError: pictures of several sizes, or views that do not tell the camera; the message says which are missing.
    """
    views = [view for view in views if usable(view)]
    sizes = {view.size for view in views}
    if len(sizes) > 1:
        named = " and ".join(f"{width}x{height}" for width, height in sorted(sizes)[:2])
        raise InputError(f"pictures of one size expected, found {named}")
    if len(views) < LEAST_VIEWS:
        raise InputError(
            f"the board is seen well in {len(views)} different views, at least {LEAST_VIEWS} are needed: sharp, lit "
            f"evenly, with at least {LEAST_CORNERS} of its {N_CORNERS} inner corners, from all sides"
        )
    solved, left_out = _solve(views), 0
    limit = OUTLIER * float(np.median(solved.errors_px))
    kept = [view for view, error in zip(views, solved.errors_px, strict=True) if error <= limit]
    if LEAST_VIEWS <= len(kept) < len(views):
        left_out, views, solved = len(views) - len(kept), kept, _solve(kept)
    if lacking := _missing_tilts(solved.tilts_deg):
        raise InputError(
            f"the board is not tilted enough in these views; missing: {'; '.join(lacking)} "
            f"(by {LEAST_TILT_DEG:g} degrees or more)"
        )
    if not solved.focal_sigma <= MOST_FOCAL_SIGMA:
        raise InputError(
            f"these views tell the focal length to {100 * solved.focal_sigma:.2g} % only, "
            f"{100 * MOST_FOCAL_SIGMA:g} % are needed: nearer and more strongly tilted views are missing"
        )
    rms = float(np.sqrt(np.average(solved.errors_px**2, weights=[len(view.ids) for view in views])))
    return CameraFit(
        solved.camera, tuple(views), solved.errors_px, rms, solved.focal_sigma, left_out, unseen_areas(views)
    )


def unseen_areas(views: Sequence[BoardView]) -> tuple[str, ...]:
    """Ninths of the picture in which no corner was seen, in words."""
    points = np.concatenate([view.corners_px / view.size for view in views])
    columns, rows = np.clip((3 * points).astype(int), 0, 2).T
    seen = set((3 * rows + columns).tolist())
    return tuple(name for index, name in enumerate(_AREAS) if index not in seen)


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    camera: PinholeCamera
    errors_px: np.ndarray
    focal_sigma: float
    tilts_deg: np.ndarray


def _solve(views: Sequence[BoardView]) -> _Solved:
    points: Any = [view.corners_m.astype(np.float32) for view in views]
    pixels: Any = [(view.corners_px - 0.5).astype(np.float32)[:, None] for view in views]
    start: Any = None
    try:
        _, matrix, lens, turns, shifts, sigmas, _, errors = cv2.calibrateCameraExtended(
            points, pixels, views[0].size, start, start, flags=cv2.CALIB_FIX_K3
        )
        camera = PinholeCamera(
            float(matrix[0, 0]),
            float(matrix[1, 1]),
            float(matrix[0, 2]) + 0.5,
            float(matrix[1, 2]) + 0.5,
            *views[0].size,
            distortion=tuple(float(value) for value in np.ravel(lens)[:4]),
        )
    except (cv2.error, InputError):  # no camera of ours, or none at all
        raise InputError(
            "no camera explains these views of the board: is it flat, and are they of one camera at one zoom?"
        ) from None
    focal_sigma = float(max(sigmas[0, 0] / camera.fx, sigmas[1, 0] / camera.fy))
    tilts = [_tilt_deg(view, turn, shift) for view, turn, shift in zip(views, turns, shifts, strict=True)]
    return _Solved(camera, np.ravel(errors), focal_sigma, np.array(tilts))


def _tilt_deg(view: BoardView, turn: np.ndarray, shift: np.ndarray) -> tuple[float, float]:
    """Angles about x and y by which the board is turned from facing the camera, at the middle of what is seen of it."""
    rotation = cv2.Rodrigues(turn)[0]
    middle = rotation @ view.corners_m.mean(axis=0) + np.ravel(shift)
    normal = rotation_from_angles(*centring_angles(middle)) @ rotation[:, 2]
    return math.degrees(math.atan2(-normal[1], normal[2])), math.degrees(math.atan2(normal[0], normal[2]))


def _missing_tilts(tilts_deg: np.ndarray) -> list[str]:
    return [words for axis, sign, words in _TILTS if not (sign * tilts_deg[:, axis] >= LEAST_TILT_DEG).any()]
