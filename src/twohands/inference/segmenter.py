"""Stage 1, HandSegNet: whose pixel is it, where are the hands, how sure is it that they are there.

Source: paper section 4.1; test-time augmentation is ours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import cv2
import numpy as np

from twohands.geometry.body import Body
from twohands.geometry.boxes import box_iou
from twohands.geometry.network_input import canvas_size, letterbox, network_input
from twohands.geometry.picture_turn import turn_logits
from twohands.geometry.segmentation import (
    UNCERTAIN,
    HandBoxes,
    box_evidence,
    boxes_from_energy,
    class_leads,
    hand_scores,
    masks_from_logits,
    mean_of_views,
    parted_boxes,
    probability,
    resized_maps,
    unmirrored,
)
from twohands.inference.body import no_body, with_body
from twohands.inference.decision import PictureView, ViewConfig
from twohands.inference.weights import WeightsCard
from twohands.skeleton import LEFT, RIGHT

HandSegNet = Callable[[np.ndarray], tuple[np.ndarray, ...]]


class HandMaps(NamedTuple):
    """HandSegNet's answer for a picture, over the whole of it and nothing else.

    Attributes:
        seg_logits: (3, h, w) for background, left, right.
        energies: (2, h, w) for LEFT and RIGHT, 0..1.
        leads: (2, h, w) `class_leads`.
        scores: (2,) `hand_scores`, 0..1.
        turn_logits: (4,) as in `TwoHandPose`; None where HandSegNet does not say.
    """

    seg_logits: np.ndarray
    energies: np.ndarray
    leads: np.ndarray
    scores: np.ndarray
    turn_logits: np.ndarray | None = None

    @classmethod
    def of(cls, seg_logits: np.ndarray, energies: np.ndarray, turn_logits: np.ndarray | None = None) -> HandMaps:
        """With what follows from the maps."""
        leads = class_leads(seg_logits)
        return cls(seg_logits, energies, leads, hand_scores(energies, leads), turn_logits)


class View(NamedTuple):
    """HandSegNet's logits for one view of a picture, over the whole of it: as in `HandMaps`, but for `energy_logits`,
    (2, h, w)."""

    seg_logits: np.ndarray
    energy_logits: np.ndarray
    turn_logits: np.ndarray | None


def hand_maps(network: HandSegNet, card: WeightsCard, image: np.ndarray) -> HandMaps:
    """HandSegNet's maps of a picture; where hands and arms fill a small part of it, of that part seen closer.

    Args:
        network: HandSegNet.
        card: what it expects.
        image: (H, W, 3) uint8 RGB.
    """
    found = picture_maps(network, card, image)
    part = closer_part(found, image.shape[:2], card.views) if card.views.closer_below_share else None
    if part is None:
        return found
    return with_part(found, picture_maps(network, card, image[part]), part, image.shape[:2])


def picture_maps(network: HandSegNet, card: WeightsCard, image: np.ndarray) -> HandMaps:
    """HandSegNet's maps of a picture; the mean of all views where the first leaves a score within `tta_score_range`.

    Args:
        network: HandSegNet.
        card: what it expects.
        image: (H, W, 3) uint8 RGB.
    """
    fitted = cache(lambda size: letterbox(image, canvas_size(image.shape[:2], size)))

    def seen(view: PictureView) -> View:
        canvas, place = fitted(view.size)
        maps = network(network_input((canvas[:, ::-1] if view.mirrored else canvas)[None]))
        seg_logits, energy_logits = (resized_maps(one[0], canvas.shape[:2]) for one in maps[:2])
        if view.mirrored:
            seg_logits, energy_logits = unmirrored(seg_logits, energy_logits)
        said = turn_logits(maps[2][0]) if card.says_turn and not view.mirrored else None
        return View(place.content(seg_logits), place.content(energy_logits), said)

    first = seen(PictureView(card.seg_input_size))
    found = scored(*first)
    low, high = card.views.tta_score_range
    if card.views.tta_views and ((found.scores > low) & (found.scores < high)).any():
        seg_logits, energy_logits = mean_of_views([first[:2], *(seen(view)[:2] for view in card.views.tta_views)])
        return scored(seg_logits, energy_logits, first.turn_logits)
    return found


def scored(seg_logits: np.ndarray, energy_logits: np.ndarray, said: np.ndarray | None = None) -> HandMaps:
    """Maps with their scores, of logits (3, h, w) and (2, h, w), and what is said of the turn."""
    return HandMaps.of(seg_logits, probability(energy_logits), said)


def closer_part(maps: HandMaps, image_size: tuple[int, int], views: ViewConfig) -> tuple[slice, slice] | None:
    """The part of a picture that shows hands and arms with some room around them.

    Args:
        maps: of the whole picture.
        image_size: (H, W).
        views: how likely a pixel must be an arm's, how much room there is, and how small the part must be.

    Returns:
        Rows and columns; None where nothing is found, or the part is so large that it would gain little.
    """
    lead = np.max(maps.seg_logits[1:], axis=0) - maps.seg_logits[0]
    likely = cv2.morphologyEx((lead > views.closer_lead).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    if not likely.any():
        return None
    part, share = [], 1.0
    for axis, full in enumerate(image_size):
        cells = np.flatnonzero(likely.any(axis=1 - axis))
        low, high = cells[0] / likely.shape[axis], (cells[-1] + 1) / likely.shape[axis]
        reach = max(views.closer_margin * (high - low), views.closer_smallest) / 2
        start, stop = ((low + high) / 2 - reach) * full, ((low + high) / 2 + reach) * full
        part.append(slice(max(0, round(start)), min(full, round(stop))))
        share *= (part[-1].stop - part[-1].start) / full
    return (part[0], part[1]) if share < views.closer_below_share else None


def with_part(maps: HandMaps, closer: HandMaps, part: tuple[slice, slice], image_size: tuple[int, int]) -> HandMaps:
    """Maps of a picture in which a part was seen closer: these within it, at their resolution, and the first around.

    Args:
        maps, closer: of the whole picture, and of the part.
        part: rows and columns of the picture.
        image_size: (H, W) of the picture.
    """
    fine, size, where = closer.energies.shape[1:], [], []
    for cut, cells, full in zip(part, fine, image_size, strict=True):
        scale = cells / (cut.stop - cut.start)
        size.append(max(cells, round(full * scale)))
        start = min(round(cut.start * scale), size[-1] - cells)
        where.append(slice(start, start + cells))

    def merged(whole: np.ndarray, detail: np.ndarray) -> np.ndarray:
        planes = resized_maps(whole, tuple(size))
        planes = planes.copy() if planes is whole else planes
        planes[:, where[0], where[1]] = detail
        return planes

    seg_logits, energies = merged(maps.seg_logits, closer.seg_logits), merged(maps.energies, closer.energies)
    return HandMaps.of(seg_logits, energies, maps.turn_logits)


def candidate_boxes(
    card: WeightsCard,
    maps: HandMaps,
    image_size: tuple[int, int],
    present: np.ndarray | None = None,
    body: Callable[[], Body | None] = no_body,
) -> HandBoxes:
    """Where hands may be: those found, or, where the card's fitted decision has a say later, candidates.

    Args:
        card: of the weights.
        maps: of the picture.
        image_size: (H, W) of the picture.
        present: (2,) bool, the known answer; None to decide by score.
        body: of the person, which may have hands that are not seen (`body.with_body`).
    """
    rules = card.decision
    threshold = rules.candidate_threshold if card.decides else rules.presence_threshold
    boxes = boxes_from_energy(maps.energies, image_size, maps.scores, present, threshold)
    if not card.decides:
        return boxes
    if present is None:
        boxes = parted_boxes(boxes, maps.energies, image_size, rules.candidate_threshold, rules.same_place_iou)
        boxes = with_body(boxes, body, image_size)
    return replace(boxes, evidence=box_evidence(maps.energies, maps.leads, boxes.boxes_px, image_size))


def hand_masks(card: WeightsCard, maps: HandMaps, image_size: tuple[int, int], present: np.ndarray) -> np.ndarray:
    """(H, W) uint8 `masks_from_logits` of the hands, (2,) bool, that are there."""
    return masks_from_logits(maps.seg_logits, image_size, present, card.views.uncertain_lead)


def corrected_masks(masks: np.ndarray, source: np.ndarray, boxes_px: np.ndarray) -> np.ndarray:
    """Masks that agree with the answer.

    Args:
        masks: (H, W) uint8, as `masks_from_logits` gives them, by HandSegNet's candidates.
        source: (2,) as in `Assignment`.
        boxes_px: (2, 4) u0, v0, u1, v1 of the candidates; NaN where there was none.

    Returns:
        The same array if nothing changes; else a new one, in which each candidate's pixels bear the class of the hand
        that it is. The pixels of a candidate that is no hand go to a hand whose box meets its own, else to the
        background.
    """
    classes = np.arange(1 + 2 * UNCERTAIN, dtype=np.uint8)
    for candidate in np.flatnonzero(np.isfinite(boxes_px).all(axis=1)):
        owners, others = np.flatnonzero(source == candidate), np.flatnonzero(source == 1 - candidate)
        if len(owners):
            classes[1 + candidate] = 1 + owners[0]
        elif len(others) and box_iou(*boxes_px) > 0:
            classes[1 + candidate] = 1 + others[0]
        else:
            classes[1 + candidate] = 0
    for known in (1 + LEFT, 1 + RIGHT):
        classes[known + UNCERTAIN] = classes[known] + UNCERTAIN if classes[known] else 0
    return masks if classes.tolist() == list(range(len(classes))) else classes[masks]
