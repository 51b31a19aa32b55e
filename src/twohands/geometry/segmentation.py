"""From HandSegNet's maps to masks, boxes and the decision whether a hand is there.

Source: paper section 4.1; docs/paper-map.md for what the paper leaves open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import cv2
import numpy as np
from numpy.typing import NDArray

from twohands.geometry.boxes import box_from_points, box_iou

Floats = NDArray[np.floating]
PRESENCE_THRESHOLD = 0.6
"""A hand is absent where its score (`hand_scores`) is below this, unless PoseNet2D has a say (`inference.handedness`).

The paper says "very low activation" of the energy and gives no value. Chosen on pictures that are neither
trained nor tested on: right for 99.5 % of 600 hands of preset paper and 90 % of 400 of preset wild; in photographs
without hands, 1.7 % of 300 are invented.
"""
OPENING_SIZE = 5
"""Side of the opening's kernel on a map of REFERENCE_WIDTH; smaller maps take a smaller kernel."""
REFERENCE_WIDTH = 512
UNCERTAIN = 2
"""What is added to a hand's class in masks where a pixel is perhaps that hand's."""
UNCERTAIN_LEAD = 1.0
"""The background's lead, in logits, below which a pixel is perhaps a hand's."""


@dataclass(frozen=True, slots=True)
class BoxEvidence:
    """What HandSegNet's maps say of either side inside each of two boxes, 0 for a box that is missing.

    Attributes:
        energy: (side, box) log-odds of the side's energy where it is highest in the box.
        lead: (side, box) the side's lead, in logits, over the next class where it is largest in the box.
        share: (side, box) 0..1, share of the box that the side has in the masks.
        arm: (box, 2) from the box's middle to that of the arm outside it, pixels (u, v) as a share of the box's longer
            side; 0 where no arm is seen.
    """

    energy: np.ndarray
    lead: np.ndarray
    share: np.ndarray
    arm: np.ndarray


@dataclass(frozen=True, slots=True)
class HandBoxes:
    """Detection of both hands.

    Attributes:
        boxes_px: (2, 4) u0, v0, u1, v1 in pixels of the picture; NaN for an absent hand.
        present: (2,) bool.
        scores: (2,) how sure it is that each hand is there, 0..1.
        evidence: what the maps say in these boxes; None where no maps were read.
        parted: whether one side's map shows both hands (`parted_boxes`), so that the masks do not tell them apart.
        guessed: (2,) bool, boxes where nothing was seen, but a hand should be; None for none.
    """

    boxes_px: np.ndarray
    present: np.ndarray
    scores: np.ndarray
    evidence: BoxEvidence | None = None
    parted: bool = False
    guessed: np.ndarray | None = None


def masks_from_logits(
    logits: np.ndarray, image_size: tuple[int, int], present: np.ndarray, uncertain_lead: float = UNCERTAIN_LEAD
) -> np.ndarray:
    """Per-pixel class at full resolution, with what may be a hand's besides.

    Each hand's lead over the background is enlarged before the decision, which keeps outlines smooth.

    Args:
        logits: (3, h, w) for background, left, right.
        image_size: (H, W) of the picture.
        present: (2,) bool, which hands are there; a hand that is not gets no pixel.
        uncertain_lead: the background's lead, in logits, below which a pixel is perhaps a hand's.

    Returns:
        (H, W) uint8, 0 background, 1 left, 2 right; 3 perhaps left, 4 perhaps right where the background leads by less
        than `uncertain_lead`. `certain_masks` takes these for background, `compose_hand_input` for the hand.
    """
    height, width = image_size
    masks = np.zeros((height, width), np.uint8)
    largest, lead = np.zeros((2, height, width), np.float32)  # used again and again: fresh memory is slow to get
    largest -= uncertain_lead
    for hand in 1 + np.flatnonzero(present):  # one class after the other: np.argmax over all takes six times as long
        cv2.resize(np.asarray(logits[hand] - logits[0], np.float32), (width, height), dst=lead)
        leads = cv2.compare(lead, largest, cv2.CMP_GT)  # 255 where it does: all bits
        cv2.max(masks, np.bitwise_and(leads, np.uint8(hand)), dst=masks)
        cv2.max(largest, lead, dst=largest)
    perhaps = np.asarray((masks > 0) & (largest <= 0), np.uint8)
    masks += UNCERTAIN * perhaps
    return masks


def certain_masks(masks: np.ndarray) -> np.ndarray:
    """Masks (H, W) uint8 with what is perhaps a hand's (`masks_from_logits`) given to the background."""
    return cv2.threshold(masks, UNCERTAIN, 0, cv2.THRESH_TOZERO_INV)[1]


def otsu_threshold(energy: np.ndarray) -> float:
    """Otsu's threshold of an energy map, over a 256-bin histogram on [0, 1].

    Args:
        energy: (h, w), 0..1.

    Returns:
        The threshold t, 0..1; the foreground is energy > t.

    Source: paper section 4.1; Otsu 1979.
    """
    return _foreground(energy)[0] / 255.0


def energy_box(energy: np.ndarray) -> np.ndarray | None:
    """Box of one hand: Otsu's threshold, opening, the largest component, its bounding box.

    Args:
        energy: (h, w), 0..1.

    Returns:
        (4,) float64 u0, v0, u1, v1 in map cells ((0, 0) the outer corner), or None where nothing is left.

    Source: paper section 4.1. The opening and the choice of the largest component are ours: a second blob,
    usually the other hand's, would stretch the box over both.
    """
    stats = _blobs(energy)
    return stats[np.argmax(stats[:, 4]), :4] if len(stats) else None


def _blobs(energy: np.ndarray) -> np.ndarray:
    """(N, 5) float64 u0, v0, u1, v1 in map cells and area of the components above Otsu's threshold, opened."""
    _, mask = _foreground(energy)
    side = 2 * round((OPENING_SIZE * energy.shape[1] / REFERENCE_WIDTH - 1) / 2) + 1
    rows, columns = _extent(mask, around=side)
    mask = mask[rows, columns]
    if side > 1:
        mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((side, side), np.uint8))
    stats = np.asarray(cv2.connectedComponentsWithStats(mask, connectivity=8)[2], np.float64)[1:]
    corners = stats[:, :2] + [columns.start, rows.start]
    return np.concatenate([corners, corners + stats[:, 2:4], stats[:, 4:]], axis=1)


def _extent(mask: np.ndarray, around: int = 0) -> tuple[slice, slice]:
    """Rows and columns of the smallest part of a mask (h, w) uint8 that holds all of it, with so many cells around it
    as there are; at least one cell."""
    left, top, width, height = cv2.boundingRect(mask)
    rows = slice(max(0, top - around), min(mask.shape[0], top + max(1, height) + around))
    return rows, slice(max(0, left - around), min(mask.shape[1], left + max(1, width) + around))


def log_odds(probabilities: np.ndarray) -> np.ndarray:
    """log(p / (1 - p)) as float64, finite for 0 and 1 too."""
    p = np.minimum(np.maximum(np.asarray(probabilities, np.float64), 1e-6), 1 - 1e-6)
    return np.log(p / (1 - p))


def probability(logits: np.ndarray) -> np.ndarray:
    """1 / (1 + exp(-logits)), in the given precision: what has these `log_odds`."""
    with np.errstate(over="ignore"):  # of a network that says so large a number, exp is infinite and this 0
        return 1 / (1 + np.exp(-logits))


def class_leads(seg_logits: np.ndarray) -> NDArray[np.float32]:
    """Each side's lead over the next class, in logits.

    Args:
        seg_logits: (3, h, w) for background, left, right.

    Returns:
        (2, h, w) for LEFT and RIGHT.
    """
    planes = np.ascontiguousarray(seg_logits, np.float32)
    leads = np.empty((2, *planes.shape[1:]), np.float32)
    for side in (0, 1):
        np.subtract(planes[1 + side], np.maximum(planes[0], planes[2 - side]), out=leads[side])
    return leads


def hand_scores(energies: np.ndarray, leads: np.ndarray) -> np.ndarray:
    """How sure HandSegNet is that each hand is there.

    Ours; the paper looks at the energy alone. Where energy and mask disagree, most often nothing is there.

    Args:
        energies: (2, h, w) for LEFT and RIGHT, 0..1, covering the whole picture.
        leads: (2, h, w) as `class_leads` gives them.

    Returns:
        (2,) 0..1: the mean, as log-odds, of the energy's peak and of the mask's lead over the next class where it is
        most certain.
    """
    return probability((log_odds(energies.max(axis=(1, 2))) + np.float64(leads.max(axis=(1, 2)))) / 2)


def unmirrored(seg_logits: np.ndarray, energy_logits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """HandSegNet's answer for a picture's mirror image, in which a left hand is a right one, as one for the picture.

    Args:
        seg_logits: (3, h, w) for background, left, right.
        energy_logits: (2, h, w) for LEFT and RIGHT.
    """
    return seg_logits[[0, 2, 1], :, ::-1], energy_logits[::-1, :, ::-1]


def mean_of_views(views: Sequence[tuple[np.ndarray, ...]]) -> tuple[np.ndarray, ...]:
    """Mean of several answers for one picture, at the resolution of the finest.

    Ours. Views of a picture from another side or at another size err differently.

    Args:
        views: of each the same maps, (C, h, w), each covering the whole picture at a resolution of its own.
    """
    size = max(view[0].shape[1:] for view in views)
    sums = (reduce(np.add, [resized_maps(maps, size) for maps in same]) for same in zip(*views, strict=True))
    return tuple(total / len(views) for total in sums)


def resized_maps(maps: np.ndarray, size: tuple[int, ...]) -> np.ndarray:
    """Maps (C, h, w) with other cells over the same picture, (C, *size): between the old ones, by linear
    interpolation. The same array where they are as many."""
    if maps.shape[1:] == size:
        return maps
    resized = np.empty((len(maps), *size), maps.dtype)
    for plane, target in zip(maps, resized, strict=True):
        cv2.resize(np.ascontiguousarray(plane), size[::-1], dst=target)
    return resized


def boxes_from_energy(
    energies: np.ndarray,
    image_size: tuple[int, int],
    scores: np.ndarray,
    present: np.ndarray | None = None,
    threshold: float | np.ndarray = PRESENCE_THRESHOLD,
) -> HandBoxes:
    """Find both hands.

    Args:
        energies: (2, h, w) for LEFT and RIGHT, 0..1, covering the whole picture.
        image_size: (H, W) of the picture.
        scores: (2,) as `hand_scores` gives them.
        present: (2,) bool, the known answer; None to decide by `threshold`.
        threshold: smallest score of a hand, or (2,) of either.

    Returns:
        Boxes in pixels of the picture. A hand is absent where its score is below `threshold` or nothing survives the
        opening.
    """
    cell_px = np.array([image_size[1] / energies.shape[2], image_size[0] / energies.shape[1]] * 2)
    expected = scores >= threshold if present is None else present
    boxes_px = np.full((2, 4), np.nan)
    for side, energy in enumerate(energies):
        box = energy_box(energy) if expected[side] else None
        if box is not None:
            boxes_px[side] = box * cell_px
    found = np.asarray(np.isfinite(boxes_px).all(axis=1))
    return HandBoxes(boxes_px, found, scores)


def parted_boxes(
    boxes: HandBoxes, energies: np.ndarray, image_size: tuple[int, int], threshold: float, same_place_iou: float
) -> HandBoxes:
    """Candidates in two places where both sides' energies are highest in one: HandSegNet sees hands, and not whose.

    Args:
        boxes: of either or both sides.
        energies: (2, h, w) for LEFT and RIGHT, 0..1, covering the whole picture.
        image_size: (H, W) of the picture.
        threshold: energy that another place must reach.
        same_place_iou: boxes that overlap so much or more are in one place.

    Returns:
        The same where the boxes are in two places, or there is no other place; else the box of the surer side and that
        of the largest other place, given to the sides in the order that the energies favour.
    """
    there = np.flatnonzero(boxes.present)
    if not len(there) or (len(there) == 2 and box_iou(*boxes.boxes_px) < same_place_iou):
        return boxes
    first_px = boxes.boxes_px[there[np.argmax(boxes.scores[there])]]
    cell_px = np.array([image_size[1] / energies.shape[2], image_size[0] / energies.shape[1]] * 2)
    blobs = _blobs(energies.max(axis=0))
    peaks = np.zeros((len(blobs), 2))
    for number, blob in enumerate(blobs):
        rows, columns = _cells(blob[:4] * cell_px, image_size, energies.shape[1:])
        peaks[number] = energies[:, rows, columns].max(axis=(1, 2))
    apart = np.array([_overlap_share(blob[:4] * cell_px, first_px) < same_place_iou for blob in blobs], bool)
    others = np.flatnonzero(apart & (peaks.max(axis=1) >= threshold))
    if not len(others):
        return boxes
    other = others[np.argmax(blobs[others, 4])]
    rows, columns = _cells(first_px, image_size, energies.shape[1:])
    first = log_odds(energies[:, rows, columns].max(axis=(1, 2)))
    lead = (first - log_odds(peaks[other])) @ [1.0, -1.0]  # of the first place as the left hand
    if lead == 0:  # then the one further to the left in the picture, which a mirror image turns round
        lead = float(blobs[other, 0] * cell_px[0] - first_px[0])
    pair = [first_px, blobs[other, :4] * cell_px]
    return HandBoxes(np.array(pair if lead > 0 else pair[::-1]), np.array([True, True]), boxes.scores, parted=True)


def parted_masks(masks: np.ndarray, boxes_px: np.ndarray) -> np.ndarray:
    """Masks in which every hand's pixels belong to the candidate in whose box they, or all else of their region, are.

    Args:
        masks: (H, W) uint8, as `masks_from_logits` gives them.
        boxes_px: (2, 4) u0, v0, u1, v1 of both candidates.
    """
    size = masks.shape[0], masks.shape[1]
    regions = _regions(masks > 0)
    boxes = [_cells(box_px, size, size) for box_px in boxes_px]
    touched = [np.setdiff1d(regions[cells], [0]) for cells in boxes]
    parted, perhaps = np.array(masks), masks > UNCERTAIN
    for candidate, cells in enumerate(boxes):
        mine = np.isin(regions, np.setdiff1d(touched[candidate], touched[1 - candidate]))
        mine[cells] |= masks[cells] > 0
        parted[mine] = np.where(perhaps[mine], 1 + candidate + UNCERTAIN, 1 + candidate)
    return parted


def _regions(mask: NDArray[np.bool_]) -> NDArray[np.int32]:
    """(H, W) the number of every pixel's connected region, from 1; 0 outside the mask."""
    return np.asarray(cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)[1], np.int32)


def _overlap_share(box: np.ndarray, other: np.ndarray) -> float:
    """Share of the smaller of two boxes that lies in the other one."""
    sides = np.minimum(box[2:], other[2:]) - np.maximum(box[:2], other[:2])
    areas = [(one[2:] - one[:2]).prod() for one in (box, other)]
    return float(np.maximum(sides, 0).prod() / max(min(areas), 1e-9))


def box_evidence(
    energies: np.ndarray, leads: np.ndarray, boxes_px: np.ndarray, image_size: tuple[int, int]
) -> BoxEvidence:
    """What both sides' maps say inside each box: HandSegNet may have found a hand as the wrong one.

    Args:
        energies: (2, h, w) for LEFT and RIGHT, 0..1, covering the whole picture.
        leads: (2, h', w') as `class_leads` gives them.
        boxes_px: (2, 4) u0, v0, u1, v1; NaN for one that is missing.
        image_size: (H, W) of the picture.
    """
    energy, lead, share, arm = np.zeros((4, 2, 2))
    cell_px = np.array([image_size[1] / leads.shape[2], image_size[0] / leads.shape[1]])
    shown = (leads[0] > 0) | (leads[1] > 0)
    extent = _extent(shown.view(np.uint8))
    corner = np.array([extent[1].start, extent[0].start])
    regions = _regions(shown[extent])
    for box in np.flatnonzero(np.isfinite(boxes_px).all(axis=1)):
        rows, columns = _cells(boxes_px[box], image_size, energies.shape[1:])
        energy[:, box] = log_odds(energies[:, rows, columns].max(axis=(1, 2)))
        cells = rows, columns = _cells(boxes_px[box], image_size, leads.shape[1:])
        inside = leads[:, rows, columns]
        lead[:, box], share[:, box] = inside.max(axis=(1, 2)), (inside > 0).mean(axis=(1, 2))
        outside = _rest_of_regions(regions, *(_within(part, whole) for part, whole in zip(cells, extent, strict=True)))
        total = int(outside.sum())
        if total:
            counts = (np.asarray(outside.sum(axis=axis), np.int64) for axis in (0, 1))
            along = [int((count * np.arange(len(count))).sum()) for count in counts]
            mean = (np.array(along) + corner * total) / total
            middle_px = (boxes_px[box, :2] + boxes_px[box, 2:]) / 2
            away_px = (mean + 0.5) * cell_px - middle_px
            arm[box] = away_px / (boxes_px[box, 2:] - boxes_px[box, :2]).max()
    return BoxEvidence(energy, lead, share, arm)


def _rest_of_regions(regions: NDArray[np.int32], rows: slice, columns: slice) -> NDArray[np.bool_]:
    """(h, w) what the regions that reach into a part of their map have outside it."""
    touched = np.zeros(regions.max() + 1, bool)
    touched[regions[rows, columns]] = True
    touched[0] = False
    rest = touched[regions]
    rest[rows, columns] = False
    return rest


def _within(part: slice, whole: slice) -> slice:
    """A slice of all rows as one of the rows of `whole`; empty where it has none of them."""
    start, stop = max(part.start, whole.start), min(part.stop, whole.stop)
    return slice(start - whole.start, max(start, stop) - whole.start)


def _cells(box_px: np.ndarray, image_size: tuple[int, int], map_size: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns of a map that a box touches, at least one of each."""
    spans: list[slice] = []
    for axis in (0, 1):
        scale, last = map_size[axis] / image_size[axis], map_size[axis] - 1
        first = min(max(int(box_px[1 - axis] * scale), 0), last)
        spans.append(slice(first, max(first + 1, int(np.ceil(box_px[3 - axis] * scale)))))
    return spans[0], spans[1]


def as_one_hand(masks: np.ndarray, boxes_px: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Both candidates taken for one hand, of which HandSegNet gave a part to either side.

    Args:
        masks: (H, W) uint8, as `masks_from_logits` gives them.
        boxes_px: (2, 4) u0, v0, u1, v1 of both.
        side: which hand it is taken for.

    Returns:
        The masks (H, W) uint8 with every pixel that is or may be a hand's that side's, and the box (4,) around both
        boxes.
    """
    return np.where(masks > 0, np.uint8(side + 1), np.uint8(0)), box_around(boxes_px)


def box_around(boxes_px: np.ndarray) -> np.ndarray:
    """(4,) the box around both boxes (2, 4)."""
    return np.asarray(box_from_points(np.reshape(boxes_px, (-1, 2))))


def _foreground(energy: np.ndarray) -> tuple[float, np.ndarray]:
    """Otsu's grey level, 0..255, of an energy map, and the (h, w) uint8 mask of what lies above it."""
    return cv2.threshold(cv2.convertScaleAbs(energy, alpha=255.0), 0, 1, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
