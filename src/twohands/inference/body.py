"""The body of the person in a picture, by networks that have seen people: where its hands should be, and whose.

Ours. HandSegNet sees hands, and of dressed people mostly sleeves; a hand that is small, blurred or on the other one
looks like nothing. MediaPipe Pose's networks have seen people and know them by all that they show. They stay as
published. What they say is evidence (`inference.handedness`) and gives HandSegNet's missing candidates a place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from twohands.geometry.body import (
    FINDER_SIZE,
    JOINTS_SIZE,
    VALUES,
    Body,
    body_of,
    body_square,
    found_body,
)
from twohands.geometry.boxes import apply_homography, inside_picture, picture_square, warp_image
from twohands.geometry.segmentation import UNCERTAIN, HandBoxes

FOUND: Final = 0.8
"""Chance from which on somebody is found: below it are mostly hands and things (docs/history/journal.md, *Bodies*)."""
SURE: Final = 0.5
"""Chance from which on there is still a body where it was, or a wrist is visible."""


@dataclass(frozen=True, slots=True)
class BodyNetworks:
    """MediaPipe Pose's networks, RGB pictures of one batch of one.

    Attributes:
        finder: (1, 224, 224, 3), -1..1 -> points (1, N, 12) and logits (1, N, 1) as `geometry.body.found_body` reads
            them.
        joints: (1, 256, 256, 3), 0..1 -> joints (1, 195) as `geometry.body.body_of` reads them, and the chance (1, 1)
            that there is a body.
    """

    finder: Callable[[np.ndarray], tuple[np.ndarray, ...]]
    joints: Callable[[np.ndarray], tuple[np.ndarray, ...]]


def no_body() -> Body | None:
    """Where nobody looks for one."""
    return None


class BodySight:
    """The body of the person in a picture, looked for when it is first asked for, with its whereabouts for a clip's
    next frame.

    Args:
        look: the picture's body, looked for around given points or None, as `seen_body` does; None where nobody can.
        around_px: (2, 2) where it was last seen, if it was.
    """

    def __init__(
        self, look: Callable[[np.ndarray | None], Body | None] | None, around_px: np.ndarray | None = None
    ) -> None:
        self._look = look
        self._body: Body | None = None
        self.around_px = around_px

    def __call__(self) -> Body | None:
        """The body; None where there is none."""
        if self._look is not None:
            self._body, self._look = self._look(self.around_px), None
            self.around_px = None if self._body is None else self._body.around_px
        return self._body


def seen_body(networks: BodyNetworks, image: np.ndarray, around_px: np.ndarray | None = None) -> Body | None:
    """The body of a person.

    Args:
        networks: as published.
        image: (H, W, 3) uint8 RGB.
        around_px: (2, 2) `Body.around_px` of the frame before, where it is looked for first; None of a picture alone.

    Returns:
        None where there is none.
    """
    known = None if around_px is None else _joints(networks, image, around_px)
    if known is not None:
        return known
    place = picture_square((image.shape[0], image.shape[1]), FINDER_SIZE)
    crop = warp_image(image, place, FINDER_SIZE)
    points, logits = networks.finder(crop[None].astype(np.float32) / 127.5 - 1)
    found = found_body(points[0], logits[0, :, 0], FOUND)
    return None if found is None else _joints(networks, image, np.asarray(apply_homography(place, found)))


def _joints(networks: BodyNetworks, image: np.ndarray, around_px: np.ndarray) -> Body | None:
    """The body that is seen there, if there is one."""
    place = body_square(around_px)
    joints, chance = networks.joints(warp_image(image, place, JOINTS_SIZE)[None].astype(np.float32) / 255)
    return body_of(joints.reshape(-1, VALUES).astype(np.float64), place) if chance.item() >= SURE else None


def with_body(boxes: HandBoxes, body: Callable[[], Body | None], image_size: tuple[int, int]) -> HandBoxes:
    """Candidates, where HandSegNet misses some: a hand that the body should have, in the picture, with a visible wrist.

    Args:
        boxes: of HandSegNet.
        body: gives that of the person, if there is one; asked where a candidate is missing.
        image_size: (H, W) of the picture.

    Returns:
        The boxes, with those of the body `guessed`. A wrist near which HandSegNet has its one candidate gives none.
    """
    if boxes.present.all() or (known := body()) is None:
        return boxes
    shown = (known.visible > SURE) & inside_picture(known.palms_px, image_size[1], image_size[0])
    boxes_px, guessed = boxes.boxes_px.copy(), np.zeros(2, bool)
    if boxes.present.any():
        side = int(np.argmin(boxes.present))
        own = boxes_px[1 - side]
        near = np.linalg.norm(known.palms_px - (own[:2] + own[2:]) / 2, axis=1)
        wrist = int(np.argmax(near))
        guessed[side] = shown[wrist]
        boxes_px[side] = np.where(shown[wrist], known.boxes_px[wrist], np.nan)
    else:
        guessed = shown
        boxes_px[shown] = known.boxes_px[shown]
    return replace(boxes, boxes_px=boxes_px, present=boxes.present | guessed, guessed=guessed)


def guessed_masks(masks: np.ndarray, boxes: HandBoxes) -> np.ndarray:
    """Masks (H, W) uint8 in which the background of the ellipses in `guessed` boxes is perhaps the hand's; where
    none is guessed, the same."""
    for side in () if boxes.guessed is None else np.flatnonzero(boxes.guessed):
        box = boxes.boxes_px[side]
        middle, half = (box[:2] + box[2:]) / 2, np.maximum((box[2:] - box[:2]) / 2, 1.0)
        inside = np.zeros_like(masks)
        centre, axes = (np.rint(pair).astype(int).tolist() for pair in (middle, half))
        cv2.ellipse(inside, centre, axes, 0, 0, 360, 1 + int(side) + UNCERTAIN, -1)
        masks = np.where(masks > 0, masks, inside)
    return masks
