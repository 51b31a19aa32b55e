"""A person's body in a picture: what MediaPipe Pose's networks say, in pixels, and where the hands should be by that.

Source: the published networks' inputs and outputs (MediaPipe 0.10.21, modules pose_detection and pose_landmark).
"""

from __future__ import annotations

import math
from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twohands.geometry.anchors import anchor_middles
from twohands.geometry.boxes import apply_homography, near_box, upright_square
from twohands.geometry.segmentation import log_odds, probability

FINDER_SIZE: Final = 224
"""Rows and columns of the picture in which bodies are found."""
JOINTS_SIZE: Final = 256
"""Rows and columns of the crop in which a body's joints are seen."""
VALUES: Final = 5
"""Numbers that describe a joint: u, v, depth, log-odds that it is not hidden, and that it is in the crop."""
BODY_TERMS: Final = 6
"""Of `Body.distance_terms`."""
USUAL_LENGTH_M: Final = 0.1
"""Of a hand, of which its length says nothing."""
_STRIDES: Final = ((8, 2), (16, 2), (32, 6))
"""Pixels from one anchor to the next, and how many lie in one place."""
_AROUND: Final = 1.25
"""Radius of the square around a body over the distance of the two points that describe it."""
_SHOULDERS, _HIPS, _WRISTS, _THUMBS = (11, 12), (23, 24), (15, 16), (21, 22)
_EYES, _MOUTH = (2, 5), (9, 10)
_KNUCKLES: Final = ((17, 19), (18, 20))
"""Of little and first finger."""
_CENTRE, _END = 33, 34
_ENDS: Final = (((11, 11), (12, 12)), (_EYES, _MOUTH), (_SHOULDERS, _HIPS))
"""Pairs of joints, in whose middles lie the ends of what is told of a body's size."""
_PALM_SHARE: Final = 1.3
"""From the wrist to the middle of the hand's box, over the distance of the knuckles from the wrist."""
_HAND_SPANS, _HAND_TORSOS = 2.4, 0.47
"""Longer side of the hand's box over the widest distance of the hand's four points, and over the torso's length;
medians over generated people, as `_PALM_SHARE`."""


class Body(NamedTuple):
    """A person's body, in pixels of the picture.

    Attributes:
        palms_px: (2, 2) of LEFT and RIGHT, the middle of the wrist and the knuckles of first and little finger.
        boxes_px: (2, 4) u0, v0, u1, v1, where the hands should be.
        visible: (2,) 0..1, how likely the wrists are in the picture, and not hidden.
        around_px: (2, 2) middle of the body and a point at its end: where to look in a clip's next frame.
        along_px: (2, 2) from the wrists to these knuckles.
        sizes_px: (3,) from shoulder to shoulder, from the eyes to the mouth, from the shoulders to the hips; in space.
        depths_px: (3,) how far behind the hips the LEFT wrist, the RIGHT one and the shoulders are.
    """

    palms_px: NDArray[np.float64]
    boxes_px: NDArray[np.float64]
    visible: NDArray[np.float64]
    around_px: NDArray[np.float64]
    along_px: NDArray[np.float64]
    sizes_px: NDArray[np.float64]
    depths_px: NDArray[np.float64]

    def distance_terms(
        self, focal_px: float, lengths_m: float | NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], float]:
        """What the logarithms of the hands' distances in metres go with, terms (2, `BODY_TERMS`) of LEFT and RIGHT, and
        what they are more than a weighted sum of these.

        Of a picture that is enlarged, focal length and all, both stay the same; a person twice as far is half as
        large. Who has longer hands, `lengths_m` of one or (2,), is mostly larger.
        """
        shoulders, *others = np.log(np.maximum(self.sizes_px, 1.0))
        ratios = np.tile([1.0, *(np.array(others) - shoulders)], (2, 1))
        behind = np.column_stack([self.depths_px[:2], np.full(2, self.depths_px[2])]) / focal_px
        longer = np.log(np.broadcast_to(lengths_m, (2,)) / USUAL_LENGTH_M)
        return np.column_stack([ratios, behind, longer]), math.log(focal_px) - float(shoulders)

    def near(self, box_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """(2,) how likely the LEFT and the RIGHT hand are what a box (4,) shows: whether their wrist is visible, less
        the farther the palm is from the box's middle."""
        return self.visible * near_box(self.palms_px, box_px)


def found_body(
    points: NDArray[np.float64], logits: NDArray[np.float64], threshold: float
) -> NDArray[np.float64] | None:
    """The surest body.

    Args:
        points: (N, 12) by anchor, pixels from its middle: box, and four points of the body, of which the first two are
            its middle and a point at its end.
        logits: (N,) log-odds that there is a body.
        threshold: 0..1, least chance.

    Returns:
        (2, 2) its middle and end in pixels of the finder's input; None where there is none.
    """
    best = int(np.argmax(logits))
    if logits[best] < log_odds(np.array(threshold)):
        return None
    return np.reshape(points[best, 4:8], (2, 2)) + _anchors()[best]


@cache
def _anchors() -> NDArray[np.float64]:
    """(N, 2) middles of the anchors in pixels of the finder's input."""
    return anchor_middles(FINDER_SIZE, _STRIDES)


def body_square(around_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """image_from_crop (3, 3) of the square of `JOINTS_SIZE` around a body, turned so that its end is above its middle.

    Args:
        around_px: (2, 2) middle and end, pixels of the picture.
    """
    up = around_px[1] - around_px[0]
    length = float(np.hypot(*up))
    up = up if length > 1 else np.array([0.0, -1.0])
    return upright_square(around_px[0], up, 2 * _AROUND * max(length, 1.0), JOINTS_SIZE)


def body_of(joints: NDArray[np.float64], image_from_crop: NDArray[np.float64]) -> Body:
    """A body from its joints.

    Args:
        joints: (39, `VALUES`) in pixels of the crop.
        image_from_crop: (3, 3).
    """
    at_px = np.asarray(apply_homography(image_from_crop, joints[:, :2]), np.float64)
    depths_px = joints[:, 2] * math.sqrt(abs(np.linalg.det(image_from_crop[:2, :2])))
    in_space = np.column_stack([at_px, depths_px])
    chances = probability(joints[list(_WRISTS), 3:])
    torso_px = np.linalg.norm(at_px[list(_SHOULDERS)].mean(axis=0) - at_px[list(_HIPS)].mean(axis=0))
    (palms_px, along_px), boxes_px = np.zeros((2, 2, 2)), np.zeros((2, 4))
    for side in range(2):
        wrist, (little, first) = at_px[_WRISTS[side]], at_px[list(_KNUCKLES[side])]
        points = np.stack([wrist, little, first, at_px[_THUMBS[side]]])
        span_px = np.linalg.norm(points[:, None] - points, axis=-1).max()
        palms_px[side] = points[:3].mean(axis=0)
        along_px[side] = (little + first) / 2 - wrist
        middle = wrist + _PALM_SHARE * along_px[side]
        half = math.sqrt(max(_HAND_SPANS * span_px * _HAND_TORSOS * torso_px, 1.0)) / 2
        boxes_px[side] = [*(middle - half), *(middle + half)]
    ends = np.array([[in_space[list(pair)].mean(axis=0) for pair in pairs] for pairs in _ENDS])
    sizes_px = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    behind_px = np.array([*depths_px[list(_WRISTS)], depths_px[list(_SHOULDERS)].mean()])
    return Body(palms_px, boxes_px, chances.min(axis=1), at_px[[_CENTRE, _END]], along_px, sizes_px, behind_px)
