"""Hands of a video followed from frame to frame without HandSegNet: where they will be, and what to look for there.

Ours; the paper's networks see every frame alone. Where a hand will be follows from its last joints and their velocity.
PoseNet2D looks there; the card's last decision says whether it is still the hand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from twohands.geometry.boxes import box_iou, near_box
from twohands.geometry.palm import Palm
from twohands.geometry.segmentation import HandBoxes
from twohands.inference.body import SURE
from twohands.inference.detection import Detection, HandFinder
from twohands.inference.expected import FARTHEST, Expected, strayed
from twohands.inference.handedness import PASSED
from twohands.inference.keypoints import NO_KEYPOINTS, in_sight, joint_boxes
from twohands.inference.moved_masks import NO_MASKS, moved_masks
from twohands.inference.palm import no_palms
from twohands.inference.side_decision import known_assignment, known_scores
from twohands.inference.trail import Trail
from twohands.inference.weights import WeightsCard
from twohands.skeleton import LEFT, RIGHT
from twohands.types import HandPose, TwoHandPose

LONGEST_REST: Final = ((1, 3), (2, 6))
"""For how many frames in a row HandSegNet may rest, of a hand that is alone and of both: where the first pair of pose
networks follows one, whose masks grow old (docs/history/journal.md, *Masks that move with the picture*), and where the
second pair, which needs none, follows all (*Real hands followed*)."""
WATCHED_REST: Final = (2, 4)
"""The same of a hand that is alone, by the pair that follows it, while the palm detector sees this hand and no other
(*A hand alone, watched over*): the other one comes unseen otherwise."""
EMPTY_REST: Final = 2
"""The same where there is no hand, while the palm detector sees none."""
NOTHING_FOUND: Final = Detection(
    NO_MASKS, HandBoxes(np.full((2, 4), np.nan), np.zeros(2, bool), np.zeros(2)), NO_KEYPOINTS, followed=True
)
"""In a frame of rest without hands."""


def followed_hands(
    finder: HandFinder, trail: Trail, expected: Expected, palms: Callable[[], Sequence[Palm]] = no_palms
) -> Detection | None:
    """Stages 2 and 3 of the hands of the last frame, where they should be now.

    Args:
        finder: of the picture.
        trail: of the clip.
        expected: of the frame.
        palms: give those in the picture, if they are asked.

    Returns:
        No hand where there was none and the palm detector sees none. None where HandSegNet is to look: no hand
        can be followed (`followed_boxes`); or it has rested for long, and the one hand is not `_watched`; or
        one is less likely a hand than none, by the card's last decision where the first pose networks see it,
        by what the second ones themselves say; or it is not where it was expected (`FARTHEST`); or nothing is
        known of the range of one that the second ones follow. Those that saw a hand see it again; where the
        first ones lose theirs, the second are asked, and must be sure (`PASSED`): they know rendered hands
        less. A hand that the second ones saw before may be elsewhere, if they see it twice there
        (`_seen_twice`).
    """
    if not any(hand.present for hand in trail.last[-1].hands):
        return None if finder.stages.palms is None or palms() else NOTHING_FOUND
    finder, expected_px = replace(finder, keep_masks=True), expected.joints_px
    boxes = followed_boxes(trail, expected_px, finder.size, finder.card)
    if boxes is None or np.isnan(expected.ranges[boxes.present & (expected.pairs > 0), 0]).any():
        return None
    present = np.flatnonzero(boxes.present)
    if trail.rested >= longest_rest(trail.last[-1]) and not _watched(boxes.boxes_px[present], palms()):
        return None
    masked = (expected.pairs[present] == 0).any()  # the second ones need none
    masks = moved_masks(trail.last[-1], finder.image, expected_px) if masked else NO_MASKS
    crops = finder.joint_crops(masks, boxes.boxes_px, expected_px[present], present, expected.pairs[present])
    looked = Detection(masks, boxes, finder.looked(masks, boxes.boxes_px, crops))
    astray = (looked.keypoints.pairs == 1) & _far_from(expected_px[present], looked)
    seen = finder.recropped(looked, astray)
    elsewhere = astray & _seen_twice(finder, looked, seen, expected_px)
    found, lost = _first_judged(finder, trail, seen, expected_px)
    found = finder.seen_better(found, boxes.boxes_px, expected_px, lost=lost)
    doubted = found.keypoints.hand_logits < np.where(lost, PASSED, 0.0)
    gone = doubted | (_far_from(expected_px[present], found) & ~elsewhere)
    if np.where(found.keypoints.pairs == 1, gone, lost).any():
        return None
    return found._replace(followed=True)


def _watched(boxes_px: np.ndarray, palms: Sequence[Palm]) -> bool:
    """Whether the palm detector sees the hand that is alone in its box (1, 4), and no other."""
    near = [near_box(palm.middle_px[None], boxes_px[0])[0] > SURE for palm in palms]
    return len(near) > 0 and all(near)


def _far_from(joints_px: np.ndarray, found: Detection) -> np.ndarray:
    """(B,) bool, whether hands are farther from joints (B, 21, 2) than the second pose networks may see them."""
    return strayed(joints_px, found.keypoints.joints_px) > FARTHEST[1]


def _seen_twice(finder: HandFinder, looked: Detection, seen: Detection, expected_px: np.ndarray) -> np.ndarray:
    """(B,) bool, which hands two looks see in one place, in the picture, and no nearer to where the other hand was
    expected than to where they were, (2, 21, 2)."""
    sides, joints_px = seen.keypoints.sides, seen.keypoints.joints_px
    own, other = (np.linalg.norm(expected_px[whose] - joints_px, axis=-1).mean(axis=-1) for whose in (sides, 1 - sides))
    there = in_sight(joints_px, finder.size, finder.card.views.smallest_box_px)
    return there & ~(other < own) & ~_far_from(looked.keypoints.joints_px, seen)


def _first_judged(
    finder: HandFinder, trail: Trail, found: Detection, expected_px: np.ndarray
) -> tuple[Detection, np.ndarray]:
    """Hands with the scores that the card's last decision gives those of the first pose networks, and (B,) bool, which
    of these are lost: less likely hands than none, or too far from where they were expected."""
    keypoints, sides, first = found.keypoints, found.keypoints.sides, found.keypoints.pairs == 0
    if not first.any():
        return found, first
    present = np.isin([LEFT, RIGHT], sides[first])
    own = Detection(found.masks, replace(found.boxes, present=present), keypoints.rows(np.flatnonzero(first)))
    judged = finder.rescored(own, known_assignment(trail, present)).boxes
    doubtful = ~judged.present | (judged.scores < 0.5)
    far = strayed(expected_px[sides], keypoints.joints_px) > FARTHEST[0]
    scores = np.where(present, judged.scores, found.boxes.scores)
    return found._replace(boxes=replace(found.boxes, scores=scores)), first & (doubtful[sides] | far)


def longest_rest(pose: TwoHandPose, watched: bool = False) -> int:
    """For how many frames in a row HandSegNet may rest once it has seen these hands; of one alone for longer where it
    is `watched` over, and where there is none only so."""
    pairs = [hand.pair or 0 for hand in pose.hands if hand.present]
    if watched and len(pairs) < 2:
        return WATCHED_REST[pairs[0]] if pairs else EMPTY_REST
    return LONGEST_REST[min(pairs)][len(pairs) - 1] if pairs else 0


def followed_boxes(
    trail: Trail, expected_px: np.ndarray, image_size: tuple[int, int], card: WeightsCard
) -> HandBoxes | None:
    """Where to look for the hands, with the scores that they had when HandSegNet saw them.

    Args:
        trail: of the clip.
        expected_px: (2, 21, 2) `Expected.joints_px`.
        image_size: (H, W) of the picture.
        card: of the weights.

    Returns:
        None where there is no hand, one leaves the picture, or two are in one place.
    """
    smallest_px = card.views.smallest_box_px
    present = np.asarray(np.isfinite(expected_px).all(axis=(1, 2)))
    if not present.any() or not in_sight(expected_px[present], image_size, smallest_px).all():
        return None
    boxes_px = np.full((2, 4), np.nan)
    boxes_px[present] = joint_boxes(expected_px[present], image_size, boxes_px[present], smallest_px)
    if present.all() and box_iou(*boxes_px) >= card.decision.same_place_iou:
        return None
    return HandBoxes(boxes_px, present, known_scores(trail))


def going_on(found: Detection, expected: Expected | None) -> np.ndarray:
    """(B, 3) what was known in the last frame (`Expected.ranges`) of the ranges of followed hands that the second pose
    networks see alone; NaN for others. Of ranges these know less than the first ones (`Detection.first`), and what
    they miss by is much the same from frame to frame."""
    keypoints = found.keypoints
    if not found.followed or expected is None:
        return np.full((len(keypoints.sides), 3), np.nan)
    alone = (keypoints.pairs if found.first is None else np.minimum(keypoints.pairs, found.first.pairs)) > 0
    return np.where(alone[:, None], expected.ranges[keypoints.sides], np.nan)


def with_sight(
    hands: tuple[HandPose, HandPose], found: Detection, shares: np.ndarray, bodies_m: np.ndarray
) -> tuple[HandPose, HandPose]:
    """The hands with what the next frame needs: where the other pair of pose networks saw their joints, (2,)
    `HandPose.body_range_m`, and (B, 3) `HandPose.range_shares`; not of a hand that the first ones have just lost, whose
    word that range is."""
    seen = list(hands)
    for row, (side, pair) in enumerate(zip(found.keypoints.sides, found.keypoints.pairs, strict=True)):
        other_px, lost = None, False
        if not pair:
            other_px = None if found.second_px is None else found.second_px[side]
        elif found.first is not None and not found.first.pairs[row]:
            other_px, lost = found.first.joints_px[row], found.followed
        asked = other_px is not None and bool(np.isfinite(other_px).all())
        known = bool(np.isfinite(shares[row, 0])) and not lost
        share = (float(shares[row, 0]), float(shares[row, 1]), float(shares[row, 2])) if known else None
        body_m = float(bodies_m[side]) if np.isfinite(bodies_m[side]) else None
        sight = {"other_px": other_px if asked else None, "range_shares": share, "body_range_m": body_m}
        seen[side] = replace(hands[side], **sight)
    return seen[0], seen[1]
