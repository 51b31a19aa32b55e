"""Palms in a picture: what MediaPipe Hands' palm detector says, in pixels.

Source: the published network's input and outputs (MediaPipe 0.10.21, module palm_detection), and the square around a
hand that its landmark network sees (module hand_landmark).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twohands.geometry.anchors import anchor_middles
from twohands.geometry.boxes import apply_homography, box_iou, ellipse_in, near_box, upright_square

PALM_SIZE: Final = 192
"""Rows and columns of the picture in which palms are found."""
VALUES: Final = 18
"""Numbers that describe a palm: middle and sides of its box, and seven points, of which the first is the wrist and the
third the middle knuckle."""
SURE_LOGIT: Final = 0.0
"""Log-odds from which on there is a palm, as published."""
LEAST_LOGIT: Final = -2.0
"""Log-odds from which on there may be one, which is weighed."""
_STRIDES: Final = ((8, 2), (16, 6))
_WRIST, _KNUCKLE = 2, 4
"""Rows of these points among box and points."""
_SAME_IOU: Final = 0.3
"""Two boxes that overlap this much show one palm, as published."""
_MOST: Final = 8
"""Palms of one picture that are kept, at most."""
_BEYOND, _AROUND = 0.5, 2.6
"""From the middle of the palm to that of the square around the hand, towards the fingers, and the square's side, in
sides of the palm's box; as published."""
_REACH: Final = 0.85
"""From the middle of that square to where the hand may end, in the same."""


class Palm(NamedTuple):
    """A palm, and the hand that it should be of; in pixels of the picture.

    Attributes:
        logit: log-odds that it is one.
        middle_px: (2,) middle of the hand.
        along_px: (2,) from the wrist to the middle knuckle.
        side_px: longer side of the palm's box.
    """

    logit: float
    middle_px: NDArray[np.float64]
    along_px: NDArray[np.float64]
    side_px: float

    def square(self, size: int) -> NDArray[np.float64]:
        """image_from_crop (3, 3) of a square crop of `size` pixels a side around the hand, its fingers up."""
        return upright_square(self.middle_px, self.along_px, _AROUND * self.side_px, size)

    def around_px(self) -> NDArray[np.float64]:
        """(16, 2) points on the circle in which the hand should be."""
        reach_px = _REACH * self.side_px
        return ellipse_in(np.concatenate([self.middle_px - reach_px, self.middle_px + reach_px]))


def palm_in(palms: Sequence[Palm], box_px: NDArray[np.float64]) -> tuple[int, float] | None:
    """Number of the palm that a hand's box (4,) shows, the surest and nearest, and how near to the box's middle its
    hand is, 0..1 (`near_box`); None where there is no palm."""
    if not palms:
        return None
    near = near_box(np.array([palm.middle_px for palm in palms]), box_px)
    best = int(np.argmax(near * (np.array([palm.logit for palm in palms]) - LEAST_LOGIT)))
    return best, float(near[best])


def found_palms(
    points: NDArray[np.float64], logits: NDArray[np.float64], image_from_input: NDArray[np.float64]
) -> tuple[Palm, ...]:
    """Palms that may be there, the surest first.

    Args:
        points: (A, `VALUES`) by anchor, pixels of the input from its middle.
        logits: (A,) log-odds that there is a palm.
        image_from_input: (3, 3), of a square that is not turned.
    """
    likely = np.flatnonzero(logits >= LEAST_LOGIT)
    likely = likely[np.argsort(-logits[likely], kind="stable")]
    described = np.reshape(points[likely], (-1, VALUES // 2, 2))
    middles, sides = described[:, 0] + _anchors()[likely], described[:, 1]
    boxes = np.concatenate([middles - sides / 2, middles + sides / 2], axis=1)
    kept: list[int] = []
    for number in range(len(likely)):
        if len(kept) < _MOST and all(box_iou(boxes[number], boxes[other]) < _SAME_IOU for other in kept):
            kept.append(number)
    palms: list[Palm] = []
    for number in kept:
        wrist, knuckle = described[number, [_WRIST, _KNUCKLE]] + _anchors()[likely[number]]
        seen = np.asarray(apply_homography(image_from_input, np.stack([middles[number], wrist, knuckle])), np.float64)
        along_px, side_px = seen[2] - seen[1], float(sides[number].max() * image_from_input[0, 0])
        up = along_px / max(float(np.hypot(*along_px)), 1e-9)
        palms.append(Palm(float(logits[likely[number]]), seen[0] + _BEYOND * side_px * up, along_px, side_px))
    return tuple(palms)


@cache
def _anchors() -> NDArray[np.float64]:
    """(A, 2) middles of the anchors in pixels of the input."""
    return anchor_middles(PALM_SIZE, _STRIDES)
