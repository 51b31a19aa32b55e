"""Where a person's trunk, head and lap are, seen from the front, so that hands and forearms stay out of them.

Frame: that between the eyes at rest (x right, y down, z forward, metres).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from twohands.synth.scene.collision import segment_distance

CELL_M: Final = 0.02
_LOW, _CELLS = np.array([-0.36, -0.24]), (72, 36)
"""Corner (x, y) and (rows, columns) of the grid of an outline: down to the knees."""


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """How far a person's trunk and head reach forwards and backwards, and where the lap is.

    Attributes:
        front, back: (72, 36) z of the skin per cell of x and y; minus and plus infinity beside the body.
        inward: (72, 36) metres to the nearest edge of the body as seen from the front, negative beside it.
        thighs: (2, 2, 3) hips and knees, (LEFT, RIGHT), where the person sits; None where they stand.
        thigh_m: radius of a thigh.
    """

    front: np.ndarray
    back: np.ndarray
    inward: np.ndarray
    thighs: np.ndarray | None = None
    thigh_m: float = 0.085

    @classmethod
    def of(cls, skin: np.ndarray, cloth_m: float) -> Outline:
        """Of the resting trunk, head and legs, points (V, 3), under cloth of that thickness."""
        cells = np.floor((skin[:, :2] - _LOW) / CELL_M).astype(int)
        kept = ((cells >= 0) & (cells < _CELLS[::-1])).all(1)
        (column, row), z = cells[kept].T, skin[kept, 2]
        front, back = np.full(_CELLS, -np.inf, np.float32), np.full(_CELLS, np.inf, np.float32)
        np.maximum.at(front, (row, column), z)
        np.minimum.at(back, (row, column), z)
        around = np.ones((3, 3), np.uint8)
        front, back = np.asarray(cv2.dilate(front, around)), np.asarray(cv2.erode(back, around))
        # The outermost cells are there by the dilation, which closes the gaps between vertices.
        inward = np.asarray(cv2.distanceTransform(np.isfinite(front).astype(np.uint8), cv2.DIST_L2, 5)) - 1.5
        return cls(front + cloth_m, back - cloth_m, inward * CELL_M + cloth_m)

    def surface(self, points: np.ndarray) -> np.ndarray:
        """(...) z of the front of the body at the x and y of points (..., 2 or more)."""
        row, column = self._cells(points)
        return self.front[row, column]

    def _cells(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        cells = np.floor((points[..., :2] - _LOW) / CELL_M).astype(int)
        column, row = np.moveaxis(np.clip(cells, 0, np.array(_CELLS[::-1]) - 1), -1, 0)
        return row, column

    def depth(self, points: np.ndarray) -> np.ndarray:
        """(...) metres by which points (..., 3) lie within the body, negative outside."""
        row, column = self._cells(points)
        inside = np.minimum(self.front[row, column] - points[..., 2], points[..., 2] - self.back[row, column])
        inside = np.minimum(inside, self.inward[row, column])
        if self.thighs is not None:
            ends = self.thighs
            a = np.broadcast_to(points[..., None, :], (*points.shape[:-1], 2, 3))
            gap = segment_distance(a, a, np.broadcast_to(ends[:, 0], a.shape), np.broadcast_to(ends[:, 1], a.shape))
            inside = np.maximum(inside, self.thigh_m - gap.min(-1))
        return inside


_FOREARM_SHARES = np.array([0.25, 0.5, 0.75])[:, None]


def enters_body(outline: Outline, joints: np.ndarray, touches: float) -> np.ndarray:
    """(...) bool, whether hand or forearm of arms (..., 22, 3) enters the body by more than their flesh yields, and by
    `touches` metres more."""
    elbow, wrist = joints[..., :1, :], joints[..., 1:2, :]
    points = np.concatenate([joints[..., 1:, :], elbow + (wrist - elbow) * _FOREARM_SHARES], axis=-2)
    yields = np.r_[0.028, np.full(20, 0.008), np.full(3, 0.03)]
    return (outline.depth(points) > touches - yields + 0.004).any(-1)
