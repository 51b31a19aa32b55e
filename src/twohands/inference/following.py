"""Hands of a video followed from frame to frame without HandSegNet: where they will be, and what to look for there.

Ours; the paper's networks see every frame alone. Where a hand will be follows from its last joints and their velocity.
PoseNet2D looks there; the card's last decision says whether it is still the hand.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import cv2
import numpy as np

from twohands.geometry.boxes import box_in_picture, box_iou
from twohands.geometry.segmentation import UNCERTAIN, HandBoxes, log_odds
from twohands.inference.detection import Detection, HandFinder
from twohands.inference.handedness import Assignment
from twohands.inference.keypoints import Keypoints, in_sight, joint_boxes
from twohands.inference.leaving import LONGEST_STEP
from twohands.inference.trail import Trail
from twohands.inference.weights import WeightsCard
from twohands.skeleton import LEFT, N_JOINTS, RIGHT
from twohands.types import HandPose, TwoHandPose

REST_FRAMES: Final = 2
"""For so many frames in a row HandSegNet may rest: the older the masks, the worse PoseNet2D's crops (docs/history/
journal.md, *Two frames of rest*)."""
LONGER_REST: Final = 3
"""Times as long it may rest while the second pair of pose networks follows both hands, which needs no masks
(docs/history/journal.md, *Real hands followed*)."""
FARTHEST: Final = (0.08, 0.15)
"""How far, as a share of the hand's size, its joints may lie on average from where they were expected, as the first and
as the second pair of pose networks see them; farther, and HandSegNet looks (docs/history/journal.md, *What segmentation
at rest cost* and *Real hands followed*)."""
_MOST_CELLS: Final = 960
"""Masks of followed hands have at most so many cells along the longer side of the picture."""


def followed_hands(finder: HandFinder, trail: Trail, time: float) -> Detection | None:
    """Stages 2 and 3 of the hands of the last frame, where they should be now.

    Args:
        finder: of the picture.
        trail: of the clip.
        time: of the frame, on the clip's clock: `TwoHandPose.time_s`, or `index` where that is None.

    Returns:
        None where HandSegNet is to look: no hand can be followed (`followed_boxes`); or one is less likely a hand than
        none, by the card's last decision where the first pose networks see it, by what the second ones themselves say;
        or it is not where it was expected (`FARTHEST`). Those that saw a hand see it again, the first
        every one, for its range; where these lose theirs, the second are asked.
    """
    finder, expected_px = replace(finder, keep_masks=True), expected_joints(trail, time)
    boxes = followed_boxes(trail, expected_px, finder.size, finder.card)
    if boxes is None:
        return None
    masks, present = moved_masks(trail, expected_px), np.flatnonzero(boxes.present)
    pairs = _pairs(trail.last[-1])[present]

    def looked(rows: np.ndarray, pair: int) -> Keypoints:
        sides, pairs = present[rows], np.full(len(rows), pair)
        crops = finder.joint_crops(masks, boxes.boxes_px, expected_px[sides], sides, pairs)
        return finder.looked(masks, boxes.boxes_px, crops)

    first, others = looked(np.arange(len(present)), 0), np.flatnonzero(pairs)
    keypoints = first.replaced(others, looked(others, 1)) if len(others) else first
    seen = finder.recropped(Detection(masks, boxes, keypoints, first=first if len(others) else None))
    found, lost = _first_judged(finder, trail, seen, expected_px)
    found = finder.seen_better(found, boxes.boxes_px, expected_px, lost=lost)
    by_second = found.keypoints.pairs == 1
    gone = found.keypoints.hand_logits < 0
    gone |= strayed(expected_px[present], found.keypoints.joints_px) > FARTHEST[1]
    if np.where(by_second, gone, lost).any():
        return None
    return found._replace(followed=True)


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
    judged = finder.rescored(own, followed_assignment(trail, present)).boxes
    doubtful = ~judged.present | (judged.scores < 0.5)
    far = strayed(expected_px[sides], keypoints.joints_px) > FARTHEST[0]
    scores = np.where(present, judged.scores, found.boxes.scores)
    return found._replace(boxes=replace(found.boxes, scores=scores)), first & (doubtful[sides] | far)


def expected_joints(trail: Trail, time: float) -> np.ndarray:
    """Where the hands will be if they move on as they did, without changing their pose.

    Args:
        trail: of the clip.
        time: of the frame that comes, on the clip's clock: `TwoHandPose.time_s`, or `index` where that is None.

    Returns:
        (2, 21, 2) pixels; NaN for a hand that was not there in the last frame, and of both after a pause.
    """
    newest = trail.last[-1]
    joints_px = np.array([_joints(hand) for hand in newest.hands])
    if len(trail.last) < 2:
        return joints_px
    step, passed = _clock(newest) - _clock(trail.last[-2]), time - _clock(newest)
    if not 0 < passed <= LONGEST_STEP * step:
        return np.full_like(joints_px, np.nan)
    moved = joints_px - np.array([_joints(hand) for hand in trail.last[-2].hands])
    return joints_px + np.nan_to_num(moved.mean(axis=1, keepdims=True)) * (passed / step)


def as_expected(pose: TwoHandPose, trail: Trail | None) -> bool:
    """Whether the hands of a frame are those of the frames before, where they were expected: where they are not, to
    follow them would most likely have failed."""
    if trail is None:
        return False
    expected_px, found_px = expected_joints(trail, _clock(pose)), np.array([_joints(hand) for hand in pose.hands])
    known = np.isfinite(expected_px).all(axis=(1, 2))
    if (known != np.isfinite(found_px).all(axis=(1, 2))).any():
        return False
    return bool((strayed(expected_px, found_px) <= np.array(FARTHEST)[_pairs(pose)])[known].all())


def longest_rest(pose: TwoHandPose, rest_frames: int) -> int:
    """For how many frames in a row HandSegNet may rest once it has seen these hands, if it is `rest_frames` for both by
    the first pose networks. One hand that these see is never followed: the other may come."""
    present = [hand for hand in pose.hands if hand.present]
    by_second = all(hand.pair for hand in present)
    if len(present) == 2:
        return rest_frames * LONGER_REST if by_second else rest_frames
    return rest_frames if by_second else 0


def followed_boxes(
    trail: Trail, expected_px: np.ndarray, image_size: tuple[int, int], card: WeightsCard
) -> HandBoxes | None:
    """Where to look for the hands, with the scores that they had when HandSegNet saw them.

    Args:
        trail: of the clip.
        expected_px: (2, 21, 2) `expected_joints`.
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
    return HandBoxes(boxes_px, present, _scores(trail))


def strayed(expected_px: np.ndarray, joints_px: np.ndarray) -> np.ndarray:
    """(B,) how far joints (B, 21, 2) lie from those expected, on average, as a share of the hands' size: the longer
    side of the box of those expected."""
    size_px = np.ptp(expected_px, axis=1).max(axis=-1)
    return np.linalg.norm(joints_px - expected_px, axis=-1).mean(axis=-1) / np.maximum(size_px, 1e-9)


def followed_assignment(trail: Trail, present: np.ndarray) -> Assignment:
    """Every hand of those that are followed, (2,) bool, is itself, as surely as when HandSegNet saw it."""
    source = np.where(present, [LEFT, RIGHT], -1)
    return Assignment(source, np.where(present, log_odds(_scores(trail)), np.nan))


def moved_masks(trail: Trail, expected_px: np.ndarray) -> np.ndarray:
    """What HandSegNet saw last, what is perhaps a hand's included, moved, turned and scaled with the joints.

    No wider and no coarser than it was: a rim of bright background makes a small hand seem near.

    Args:
        trail: of the clip.
        expected_px: (2, 21, 2) `expected_joints`.

    Returns:
        (h, w) uint8 masks of the picture, 0 background, 1 left, 2 right, of large pictures coarser than these; all
        background where nothing was seen.
    """
    if trail.seen.crop_masks is None:
        return np.zeros((1, 1), np.uint8)
    step = -(-max(trail.seen.crop_masks.shape) // _MOST_CELLS)
    before = np.ascontiguousarray(trail.seen.crop_masks[::step, ::step])
    masks = np.zeros_like(before)
    for side, hand in enumerate(trail.seen.hands):
        joints = _joints(hand)
        if np.isfinite(joints).all() and np.isfinite(expected_px[side]).all():
            own = np.zeros(256, np.uint8)
            own[[1 + side, 1 + side + UNCERTAIN]] = 1 + side
            _move(cv2.LUT(before, own), similarity(joints / step, expected_px[side] / step), masks)
    return masks


def _move(mask: np.ndarray, place: np.ndarray, masks: np.ndarray) -> None:
    """Puts a mask (h, w), moved by a matrix (2, 3), over masks of the same size, in place. Only the part that it
    covers is touched: hands are small."""
    left, top, width, height = cv2.boundingRect(mask)
    corners = np.array([[0, 0], [1, 0], [0, 1], [1, 1]]) * (width, height) + (left, top)
    size = masks.shape[1], masks.shape[0]
    box = np.asarray(box_in_picture(corners @ place[:, :2].T + place[:, 2], *size))
    low, high = np.floor(box[:2]).astype(int), np.minimum(np.ceil(box[2:]) + 1, size).astype(int)
    if not width or (high <= low).any():
        return
    own = place.copy()
    own[:, 2] += place[:, :2] @ (left, top) - low
    part = mask[top : top + height, left : left + width]
    part = cv2.warpAffine(part, own, (high - low).tolist(), flags=cv2.INTER_NEAREST)
    covered = masks[low[1] : high[1], low[0] : high[0]]
    np.copyto(covered, part, where=part > 0)


def similarity(points: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """The shift, turn and scale that bring points (N, 2) nearest to others (N, 2), by least squares: (2, 3), for
    columns (u, v, 1). Of points that are all one, a shift."""
    middle, to = points.mean(axis=0), moved.mean(axis=0)
    around, other = points - middle, moved - to
    spread = float((around**2).sum())
    turn = np.array([(around * other).sum(), (around[:, 0] * other[:, 1] - around[:, 1] * other[:, 0]).sum()])
    cos, sin = turn / spread if spread > 0 else (1.0, 0.0)
    linear = np.array([[cos, -sin], [sin, cos]])
    return np.column_stack([linear, to - linear @ middle])


def _scores(trail: Trail) -> np.ndarray:
    """(2,) of the hands as HandSegNet saw them; even chances where there is none."""
    return np.array([0.5 if hand.score is None else hand.score for hand in trail.seen.hands])


def _pairs(pose: TwoHandPose) -> np.ndarray:
    """(2,) the pair of pose networks that saw each hand; the first where none of ours did."""
    return np.array([hand.pair or 0 for hand in pose.hands])


def _clock(pose: TwoHandPose) -> float:
    return float(pose.index if pose.time_s is None else pose.time_s)


def _joints(hand: HandPose) -> np.ndarray:
    known = hand.present and hand.joints_px is not None
    return np.asarray(hand.joints_px, np.float64) if known else np.full((N_JOINTS, 2), np.nan)
