"""From a labelled picture to what HandSegNet is shown and asked for."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from twohands.errors import DataFormatError, InputError
from twohands.geometry.boxes import box_in_picture, inside_picture
from twohands.geometry.network_input import LETTERBOX_GREY, letterbox
from twohands.geometry.part_labels import hand_classes
from twohands.training.hand_views import boxes_inside, hand_points, kept_inside, random_roll
from twohands.training.transforms import PhotometricConfig, in_two_tones, jitter_colours, nearest_cells
from twohands.types import HandSample

OUTSIDE = 3
"""Class, for the time being, of what lies outside the picture."""
CLOSE = (0.25, 0.8)
"""Range of a close hand's size: the larger side of its box over the picture's height."""
NARROWEST = 9 / 16
"""Least width of a cut picture over its height."""
LARGEST_ZOOM = 3.0
"""A close hand is enlarged no further than this: there is no more detail in the picture."""


@dataclass(frozen=True)
class ZoomConfig:
    """Geometric changes of HandSegNet's training pictures."""

    zoom: float = 0.0
    """Largest change of log2 of the scale: 0.5 allows 0.71 to 1.41."""
    shift: float = 0.0
    """Largest shift as a fraction of the picture's size."""
    flip: float = 0.0
    """Probability of a horizontal flip; left and right swap places with it."""
    roll: float = 0.0
    """Half of the pictures are turned about their centre, by at most so many degrees."""
    close: float = 0.0
    """Share of pictures cut to a part in which one hand fills 25 to 80 % of the height (`CLOSE`): a person who shows a
    hand to a webcam holds it nearer than an egocentric camera ever sees it."""
    cut: float = 0.0
    """Share of pictures cut to a narrower part, as upright as `NARROWEST` at most, and fitted in with a border: cameras
    of 4:3, square pictures, phones held upright."""

    def __post_init__(self) -> None:
        for name in ("close", "cut"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"zoom: {name} must lie in 0..1, got {getattr(self, name)}")
        if not 0 <= self.roll <= 180:
            raise InputError(f"zoom: roll must lie in 0..180 degrees, got {self.roll}")


@dataclass(frozen=True, slots=True)
class SegmentationTarget:
    """One training example of HandSegNet.

    Attributes:
        image: (H, W, 3) uint8 RGB at network size, fitted in as for inference (`geometry.segmentation.letterbox`).
        classes: (H, W) uint8, 0 background, 1 left, 2 right; the forearm belongs to its hand (docs/conventions.md).
        boxes_px: (2, 4) float32 u0, v0, u1, v1 in pixels of `image`, clipped to it; 0 for an absent hand.
        present: (2,) bool: any joint is inside, and any of the hand was to be seen before the changes.
    """

    image: np.ndarray
    classes: np.ndarray
    boxes_px: np.ndarray
    present: np.ndarray


def segmentation_target(
    sample: HandSample,
    height: int,
    width: int,
    *,
    photometric: PhotometricConfig | None = None,
    zoom: ZoomConfig | None = None,
    two_tones: float = 0.0,
    rng: np.random.Generator | None = None,
) -> SegmentationTarget:
    """What HandSegNet sees and should answer for one picture.

    Args:
        sample: must carry part labels.
        height, width: network size.
        photometric, zoom: training changes, used only with `rng`.
        two_tones: `AugmentConfig.two_tones`, the same.
        rng: source of randomness; None leaves the picture as it is.

    Raises:
        DataFormatError: no part labels.
    """
    if sample.labels is None:
        raise DataFormatError(f"{sample.source}: HandSegNet needs part labels, this sample has none")
    image, labels, points = sample.image, sample.labels, hand_points(sample)
    seen = hand_classes(labels)
    points[[not (seen == 1 + side).any() for side in range(len(points))]] = np.nan
    inside = inside_picture(np.where(np.isfinite(points), sample.joints_px, np.nan), *image.shape[1::-1])
    if rng is not None and zoom is not None and zoom.cut > 0 and rng.random() < zoom.cut:
        image, labels, points, inside = _cut(image, labels, points, inside, rng)
    full_height, full_width = image.shape[:2]
    image, place = letterbox(image, (height, width))
    scale = np.array([place.width * width / full_width, place.height * height / full_height])
    corner = np.array([place.left * width, place.top * height])
    classes = np.full((height, width), OUTSIDE, np.uint8)
    shown = place.content(classes)
    rows, cols = (nearest_cells(n, full) for n, full in zip(shown.shape, labels.shape, strict=True))
    shown[:] = hand_classes(labels[np.ix_(rows, cols)])
    points = points * scale + corner
    if rng is not None:
        if zoom is not None:
            image, classes, points, inside = _zoomed(image, classes, points, inside, zoom, rng)
        if two_tones and rng.random() < two_tones:
            image = in_two_tones(image, classes, rng)
        if photometric is not None:
            image = jitter_colours(image, photometric, rng)
    border = classes == OUTSIDE
    image[border], classes[border] = LETTERBOX_GREY, 0
    boxes = np.asarray(box_in_picture(points, width, height))
    present = inside.any(axis=1) & ((boxes[:, 2:] - boxes[:, :2]).min(axis=1) > 0)
    return SegmentationTarget(image, classes, np.where(present[:, None], boxes, 0).astype(np.float32), present)


def _cut(image, labels, points, inside, rng: np.random.Generator):
    """A narrower part of the picture, with most of one of its hands inside if there is one; returns the picture, labels
    and, see `kept_inside`, joints."""
    height, full_width = labels.shape
    narrowest = min(NARROWEST, full_width / height)
    width = min(round(height * np.exp(rng.uniform(np.log(narrowest), np.log(full_width / height)))), full_width)
    anywhere = rng.uniform(0, full_width)
    box = _one_box(points, full_width, height, rng)
    centre = anywhere if box is None else box[[0, 2]].mean()
    left = int(np.clip(centre - width * rng.uniform(0.25, 0.75), 0, full_width - width))
    columns = slice(left, left + width)
    return image[:, columns], labels[:, columns], *kept_inside(points - [left, 0], inside, width, height)


def _zoomed(image, classes, points, inside, config: ZoomConfig, rng: np.random.Generator):
    """Scale about the centre, shift, perhaps flip (swapping left and right), perhaps turn; the edge goes on outside, so
    that arms that leave the picture are not cut off. Returns the picture, classes and, see `kept_inside`, joints."""
    height, width = classes.shape
    scale = 2.0 ** rng.uniform(-config.zoom, config.zoom)
    shift = rng.uniform(-config.shift, config.shift, 2) * [width, height]
    flip = rng.random() < config.flip
    turn = random_roll(config.roll, rng)[:2, :2]
    # out = turn(flip(scale * (in - centre))) + middle + shift, in corner-based pixels
    middle = np.array([width, height]) / 2
    centre = middle
    if config.close > 0 and rng.random() < config.close:
        centre, scale = _close_up(points, width, height, rng)
        shift = np.zeros(2)
    linear = scale * turn @ np.diag([-1.0 if flip else 1.0, 1.0])
    matrix = np.column_stack([linear, middle + shift * [-1 if flip else 1, 1] - linear @ centre])
    centred = matrix.copy()
    centred[:, 2] += matrix[:, :2] @ [0.5, 0.5] - 0.5  # cv2 counts from the first pixel's centre
    edge = cv2.BORDER_REPLICATE
    image = cv2.warpAffine(image, centred, (width, height), flags=cv2.INTER_LINEAR, borderMode=edge)
    classes = cv2.warpAffine(classes, centred, (width, height), flags=cv2.INTER_NEAREST, borderMode=edge)
    points = points @ linear.T + matrix[:, 2]
    if flip:
        classes = np.array([0, 2, 1, OUTSIDE], np.uint8)[np.asarray(classes, np.uint8)]
        points, inside = points[::-1], inside[::-1]
    return image, classes, *kept_inside(points, inside, width, height)


def _one_box(points, width: int, height: int, rng: np.random.Generator) -> np.ndarray | None:
    """Box (4,) of one of the hands in the picture; None if there is none."""
    boxes, present = boxes_inside(points, width, height)
    return boxes[rng.choice(np.flatnonzero(present))] if present.any() else None


def _close_up(points, width: int, height: int, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Centre and scale of a part of the picture, at most the whole, in which one of the hands is near and its box
    inside; the whole where there is no hand."""
    corner = np.array([width, height], np.float64)
    box = _one_box(points, width, height, rng)
    if box is None:
        return corner / 2, 1.0
    larger = max(box[2:] - box[:2])
    scale = float(np.clip(np.exp(rng.uniform(*np.log(CLOSE))) * height / larger, 1, LARGEST_ZOOM))
    half = corner / 2 / scale
    room = np.maximum(half - larger / 2, 0)
    centre = (box[:2] + box[2:]) / 2 + rng.uniform(-room, room)
    return np.clip(centre, half, corner - half), scale
