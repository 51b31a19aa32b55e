"""Joints in another frame, unit or order than ours, told by what no camera can see or by what fits the labels better.

A score of such joints would be about the file, not about the system; behind the camera it can even be a good one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from twohands.errors import DataFormatError
from twohands.geometry.camera import project
from twohands.skeleton import N_JOINTS, ROOT, WRIST
from twohands.types import PinholeCamera

FloatArray = NDArray[np.float64]
OURS: Final = "expected: the camera's frame, x right, y down, z forward, metres"
_AT_ORIGIN_M: Final = 0.02
_LONGEST_HAND_M: Final = 0.5
"""|wrist - root| beyond which no prediction of a hand in metres lies, however bad."""
_FAR_OFF: Final = 0.05
"""Of the picture's diagonal: an error in 2D from which on another frame is thought of."""
_MUCH_BETTER: Final = 0.25
"""Share of the error that is left when the frame is the cause of it."""
_OTHER_SIZE: Final = 1.2
"""Of a picture over the labels', from which on its pixels are others."""


def refuse_impossible(joints_m: FloatArray) -> None:
    """Refuses joints (21, 3) that no camera can see where they are said to be.

    Raises:
        DataFormatError: they are relative to a joint, behind the camera, or in another unit; named.
    """
    length = float(np.linalg.norm(joints_m[WRIST] - joints_m[ROOT]))
    if length > _LONGEST_HAND_M:
        unit = "millimetres" if length > 20 else "centimetres" if length > 2 else "another unit"
        raise DataFormatError(f"joints_m: a hand of {length:.3g} m from wrist to root looks like {unit}; {OURS}")
    for joint, name in ((ROOT, "root joint"), (WRIST, "wrist")):
        if np.linalg.norm(joints_m[joint]) < min(_AT_ORIGIN_M, 0.5 * length):
            raise DataFormatError(f"joints_m: relative to the {name}, which is the pinhole itself; {OURS}")
    behind = int((joints_m[:, 2] <= 0).sum())
    if behind:
        raise DataFormatError(
            f"joints_m: {behind} of {N_JOINTS} joints lie behind the camera (z <= 0), as in the frame of OpenGL and "
            f"Blender (y up, looking along -z), or relative to a joint; {OURS}"
        )


@dataclass(slots=True)
class FrameCheck:
    """Compares what a whole file says with the labels, as it is and as it would be in other frames.

    Attributes:
        errors: by frame, the mean distance of each hand's joints to its labels in 2D, as a fraction of the diagonal.
        products: of pixels given and labelled, for u and v, summed over joints: given², given x labelled, labelled².
    """

    errors: dict[str, list[float]] = field(default_factory=lambda: dict[str, list[float]]())
    products: FloatArray = field(default_factory=lambda: np.zeros((3, 2)))

    def add(
        self,
        camera: PinholeCamera,
        truth_px: FloatArray,
        joints_m: FloatArray | None,
        joints_px: FloatArray | None,
    ) -> None:
        """Takes in one hand.

        Args:
            camera: of its picture.
            truth_px: (21, 2) labels, NaN where unknown.
            joints_m: (21, 3) as given, or None.
            joints_px: (21, 2) as given, or None.
        """
        candidates: Mapping[str, FloatArray] = {}
        if joints_px is not None:
            size = np.array([camera.width, camera.height])
            candidates = {
                "": joints_px,
                "joints_px: rows and columns are exchanged; (u, v) = (column, row) is expected": joints_px[:, ::-1],
                "joints_px: counted from the picture's lower edge; v down from the upper edge is expected": np.stack(
                    [joints_px[:, 0], camera.height - joints_px[:, 1]], axis=1
                ),
                "joints_px: counted from the picture's right edge, as in a mirrored picture": np.stack(
                    [camera.width - joints_px[:, 0], joints_px[:, 1]], axis=1
                ),
                "joints_px: fractions of the picture, as MediaPipe gives them; pixels are expected": joints_px * size,
                "joints_px: from -1 to 1 over the picture; pixels are expected": (joints_px + 1) / 2 * size,
            }
            self._add_products(joints_px, truth_px)
        elif joints_m is not None:
            candidates = {
                "": _seen(joints_m, camera),
                f"joints_m: y points up, as in OpenGL and Unity; {OURS}": _seen(joints_m * [1, -1, 1], camera),
                f"joints_m: x points left; {OURS}": _seen(joints_m * [-1, 1, 1], camera),
                f"joints_m: x and y are exchanged; {OURS}": _seen(joints_m[:, [1, 0, 2]], camera),
            }
        for name, points_px in candidates.items():
            with np.errstate(over="ignore"):  # of joints next to the pinhole
                distances: FloatArray = np.asarray(np.linalg.norm(points_px - truth_px, axis=-1), np.float64)
            if np.isfinite(distances).any():
                error = float(np.nanmean(distances)) / float(np.hypot(camera.width, camera.height))
                self.errors.setdefault(name, []).append(error)

    def verdict(self) -> str | None:
        """What is wrong with the file, named; None where it fits as well as it would in any other frame."""
        medians = {name: float(np.median(errors)) for name, errors in self.errors.items()}
        plain = medians.pop("", 0.0)
        best = min(medians, key=lambda name: medians[name], default=None)
        if best is None or plain < _FAR_OFF:
            return None
        if medians[best] <= _MUCH_BETTER * plain:
            return f"{best} (fits the labels {plain / max(medians[best], 1e-9):.0f} times better)"
        return self._other_size()

    def _add_products(self, joints_px: FloatArray, truth_px: FloatArray) -> None:
        known = np.isfinite(truth_px).all(axis=-1)
        with np.errstate(over="ignore"):  # of absurd pixels, which others complain about
            products = [joints_px[known] ** 2, joints_px[known] * truth_px[known], truth_px[known] ** 2]
            self.products = self.products + np.array([product.sum(axis=0) for product in products])

    def _other_size(self) -> str | None:
        """Whether the pixels are those of a larger or smaller picture, by the factors that fit the labels best."""
        given, both, labelled = self.products
        if not np.isfinite(self.products).all() or not (both > 0).all():
            return None
        factors = both / given
        before = float((given - 2 * both + labelled).sum())
        after = float((labelled - both * factors).sum())
        if after > _MUCH_BETTER**2 * before or max(factors.max(), 1 / factors.min()) < _OTHER_SIZE:
            return None
        return (
            f"joints_px: pixels of a picture of another size, {1 / factors[0]:.3g} times as wide and "
            f"{1 / factors[1]:.3g} times as high as the labelled one"
        )


def _seen(joints_m: FloatArray, camera: PinholeCamera) -> FloatArray:
    with np.errstate(all="ignore"):  # of joints next to the pinhole
        return np.asarray(project(joints_m, camera, distort=True))


def read_numbers(value: object, shape: Sequence[int]) -> FloatArray | None:
    """An array of finite numbers of a shape; None for anything else, which others complain about."""
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        return None
    return array if array.shape == tuple(shape) and np.isfinite(array).all() else None
