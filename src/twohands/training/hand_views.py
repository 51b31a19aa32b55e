"""Where the hands of a labelled picture are, and the changes that all training pictures share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twohands.geometry.boxes import box_from_points, inside_picture
from twohands.geometry.part_labels import hand_classes
from twohands.geometry.rotation import rotation_about_z
from twohands.skeleton import LEFT, RIGHT, part_label
from twohands.types import HandSample

LEAST_INSIDE = 0.2
"""A hand of whose box less than this is in the picture is none to look at more closely."""
MOST_CUT = 0.4
"""Largest share of a picture's width and height that `cut_at_border` takes away."""
KEPT = (-0.2, 0.7)
"""Range of the share of a hand's box that it leaves in the picture; below 0 only the arm may be left."""
HANDLESS = (0.3, 0.9)
"""Range of the share of a picture's width and height that `part_without_hands` keeps."""
LEAST_ARM = 0.02
"""Share of such a part that is an arm."""
HANDLESS_TRIES = 24
"""Parts that it looks at."""


def hand_box(sample: HandSample, side: int) -> np.ndarray | None:
    """Tight box of a hand's labelled 2D joints, clipped to the picture.

    Returns:
        (4,) u0, v0, u1, v1 in pixels; None if the hand is absent or less than 2 pixels of it are in the picture.
    """
    boxes, found = boxes_inside(hand_points(sample)[[side]], *sample.image.shape[1::-1])
    return boxes[0] if found[0] else None


def hand_points(sample: HandSample) -> np.ndarray:
    """(2, 21, 2) joints, moved into the picture where they lie outside; NaN where unknown or of an absent hand."""
    height, width = sample.image.shape[:2]
    points = np.asarray(sample.joints_px, np.float64)
    known = np.asarray(sample.valid) & np.asarray(sample.present)[:, None] & np.isfinite(points).all(axis=-1)
    return np.where(known[..., None], np.clip(points, 0, [width, height]), np.nan)


def kept_inside(points: np.ndarray, inside: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Hands after a change of what the picture shows.

    Args:
        points: (N, K, 2) joints as `hand_points` gives them, in pixels of the new picture.
        inside: (N, K) bool, those that were in the picture before.
        width, height: of the new picture.

    Returns:
        The joints, moved into the new picture, NaN for a hand of which none is in it; and which are, (N, K).
    """
    inside = inside & inside_picture(points, width, height)
    left = np.any(inside, axis=1, keepdims=True)[..., None]
    return np.where(left, np.clip(points, 0, [width, height]), np.nan), inside


def boxes_inside(points: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Tight boxes of hands (N, K, 2), clipped to the picture, (N, 4), 0 for a hand of which less than 2 pixels or
    `LEAST_INSIDE` of its box are inside; and whether that much is, (N,)."""
    whole = np.asarray(box_from_points(points))
    inside = np.clip(whole, 0, [width, height, width, height])
    sizes, whole_sizes = inside[:, 2:] - inside[:, :2], whole[:, 2:] - whole[:, :2]
    present = (sizes.min(axis=1) >= 2) & (sizes.prod(axis=1) >= LEAST_INSIDE * whole_sizes.prod(axis=1))
    return np.where(present[:, None], inside, 0.0), present


def cut_at_border(sample: HandSample, rng: np.random.Generator) -> HandSample:
    """The part of a picture that a hand is leaving or has left: a random line across the box of one of its hands, or
    beside it, is an edge of the part, which has the picture's shape.

    Returns:
        A sample with views into the arrays of the given one, its labels and intrinsics in pixels of the part; a hand
        whose labelled joints all lie outside is absent, one without labels stays what it was. The given sample if it
        shows no labelled hand, or if any such part would be smaller than `MOST_CUT` allows.
    """
    size = np.array(sample.image.shape[1::-1])
    boxes, found = boxes_inside(hand_points(sample), *size)
    if not found.any():
        return sample
    low, high = boxes[rng.choice(np.flatnonzero(found))].reshape(2, 2)
    kept = rng.uniform(*KEPT) * (high - low)
    lost = np.stack([high - kept, size - (low + kept)]) / size  # [which end, axis]
    allowed = np.argwhere(lost <= MOST_CUT)
    if not len(allowed):
        return sample
    end, axis = allowed[rng.integers(len(allowed))]
    part = np.ceil(size * (1 - lost[end, axis])).astype(int)
    corner = rng.integers(0, size - part + 1)
    corner[axis] = 0 if end else (size - part)[axis]
    return _part(sample, corner, part)


def part_without_hands(sample: HandSample, rng: np.random.Generator) -> HandSample:
    """A part of a picture that shows an arm, and more of its person, but no hand.

    Returns:
        A sample with views into the arrays of the given one, as from `cut_at_border`. The given sample if it shows no
        hand, if not all of its hands are labelled, or if random parts of the picture's shape met no such place.
    """
    points = hand_points(sample)
    unknown = sample.present & np.isnan(points).all(axis=(1, 2))
    if sample.labels is None or unknown.any() or not np.any(sample.present):
        return sample
    size = np.array(sample.image.shape[1::-1])
    arm = np.isin(sample.labels, (part_label(LEFT, 0), part_label(RIGHT, 0)))
    hand = (hand_classes(sample.labels) > 0) & ~arm
    for share in rng.uniform(*HANDLESS, HANDLESS_TRIES):
        width, height = part = np.ceil(size * share).astype(int)
        left, top = corner = rng.integers(0, size - part + 1)
        window = slice(top, top + height), slice(left, left + width)
        if hand[window].any() or inside_picture(points - corner, width, height).any():
            continue
        if arm[window].mean() >= LEAST_ARM:
            return _part(sample, corner, part)
    return sample


def _part(sample: HandSample, corner: np.ndarray, part: np.ndarray) -> HandSample:
    """What a picture shows in a part of it, from `corner` (u, v) on, `part` (width, height) pixels large."""
    (left, top), (width, height), camera = corner, part, sample.camera
    window = slice(top, top + height), slice(left, left + width)
    joints_px = sample.joints_px - corner
    labelled = np.asarray(sample.valid)
    left_over = (labelled & inside_picture(joints_px, width, height)).any(axis=1) | ~labelled.any(axis=1)
    return replace(
        sample,
        image=sample.image[window],
        camera=replace(camera, cx=camera.cx - left, cy=camera.cy - top, width=int(width), height=int(height)),
        present=np.asarray(sample.present) & left_over,
        joints_px=joints_px,
        labels=None if sample.labels is None else sample.labels[window],
        depth_m=None if sample.depth_m is None else sample.depth_m[window],
    )


def random_roll(largest_deg: float, rng: np.random.Generator | None) -> np.ndarray:
    """(3, 3) rotation about z, from the frame of a camera to that of the rolled one: in half of all cases none, else by
    at most so many degrees."""
    if rng is None or not largest_deg or rng.random() < 0.5:
        return np.eye(3)
    return rotation_about_z(np.radians(rng.uniform(-largest_deg, largest_deg)))
