"""Stage 1, HandSegNet: whose pixel is it, where are the hands, how sure is it that they are there.

Source: paper section 4.1; test-time augmentation is ours.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from twohands.geometry.segmentation import (
    HandBoxes,
    boxes_from_energy,
    hand_scores,
    letterbox,
    masks_from_logits,
    mean_of_views,
    network_input,
    probability,
    unmirrored,
)
from twohands.inference.decision import PictureView
from twohands.inference.weights import WeightsCard

HandSegNet = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


class HandMaps(NamedTuple):
    """HandSegNet's answer for a picture, over the whole of it and nothing else.

    Attributes:
        seg_logits: (3, h, w) for background, left, right.
        energies: (2, h, w) for LEFT and RIGHT, 0..1.
        scores: (2,) `hand_scores`, 0..1.
    """

    seg_logits: np.ndarray
    energies: np.ndarray
    scores: np.ndarray


def hand_maps(network: HandSegNet, card: WeightsCard, image: np.ndarray) -> HandMaps:
    """HandSegNet's maps of a picture; the mean of all views where the first leaves a score within `tta_score_range`.

    Args:
        network: HandSegNet.
        card: what it expects.
        image: (H, W, 3) uint8 RGB.
    """
    fitted = cache(lambda size: letterbox(image, size))

    def seen(view: PictureView) -> tuple[np.ndarray, np.ndarray]:
        canvas, place = fitted(view.size)
        picture = canvas[:, ::-1] if view.mirrored else canvas
        seg_logits, energy_logits = (maps[0] for maps in network(network_input(picture[None])))
        if view.mirrored:
            seg_logits, energy_logits = unmirrored(seg_logits, energy_logits)
        return place.content(seg_logits), place.content(energy_logits)

    def scored(maps: tuple[np.ndarray, ...]) -> HandMaps:
        seg_logits, energies = maps[0], probability(maps[1])
        return HandMaps(seg_logits, energies, hand_scores(energies, seg_logits))

    first = seen(PictureView(card.seg_input_size))
    found = scored(first)
    low, high = card.views.tta_score_range
    if card.views.tta_views and ((found.scores > low) & (found.scores < high)).any():
        return scored(mean_of_views([first, *map(seen, card.views.tta_views)]))
    return found


def candidate_boxes(
    card: WeightsCard,
    maps: HandMaps,
    image_size: tuple[int, int],
    present: np.ndarray | None = None,
    was_present: np.ndarray | None = None,
) -> HandBoxes:
    """Where hands may be: those found, or, where PoseNet2D has a say later, candidates.

    Args:
        card: of the weights.
        maps: of the picture.
        image_size: (H, W) of the picture.
        present: (2,) bool, the known answer; None to decide by score.
        was_present: (2,) bool, which hands were there one frame of a video before; None where nothing is known.
    """
    rules = card.decision
    threshold = np.full(2, rules.candidate_threshold if card.hand_logit else rules.presence_threshold)
    if card.hand_logit and was_present is not None:
        threshold = np.where(was_present, rules.was_present_threshold, threshold)
    return boxes_from_energy(maps.energies, image_size, maps.scores, present, threshold)


def hand_masks(card: WeightsCard, maps: HandMaps, image_size: tuple[int, int], present: np.ndarray) -> np.ndarray:
    """(H, W) uint8 `masks_from_logits` of the hands, (2,) bool, that are there."""
    return masks_from_logits(maps.seg_logits, image_size, present, card.decision.uncertain_lead)
