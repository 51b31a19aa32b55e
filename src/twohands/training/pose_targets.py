"""From a labelled picture to what PoseNet2D and PoseNet3D are shown and asked for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from twohands.errors import InputError
from twohands.geometry.boxes import (
    apply_homography,
    box_before_camera,
    box_from_points,
    box_iou,
    ellipse_in,
    image_from_rolled,
    inside_picture,
    perspective_crop,
    rolled_box,
    square_crop,
    upright_roll_deg,
    warp_image,
)
from twohands.geometry.camera import intrinsic_matrix
from twohands.geometry.canonical import canonical_from_camera
from twohands.geometry.composition import compose_hand_input
from twohands.geometry.part_labels import hand_classes
from twohands.geometry.rotation import rotation_about_z
from twohands.skeleton import N_JOINTS, RIGHT, ROOT, WRIST
from twohands.training.hand_views import hand_box, random_roll
from twohands.training.transforms import MaskConfig, PhotometricConfig, jitter_colours, spoil_masks
from twohands.types import HandSample, PinholeCamera

MIRROR_X = np.diag([-1.0, 1.0, 1.0])
LEAST_OVERLAP = 0.1
"""Intersection over union with the true box below which a predicted one is not this hand's."""


UPRIGHT_ERROR_DEG = 15.0
"""Standard deviation of that error. The wrist and a knuckle that a first look finds are off by as much."""


@dataclass(frozen=True)
class CropConfig:
    """How a hand is cut out for PoseNet2D."""

    kind: Literal["square", "perspective"] = "square"
    """square: the paper's axis-aligned crop; perspective: what a camera that looks at the box's centre would see."""
    margin: float = 1.5
    """Crop side over the larger side of the hand's box (docs/paper-map.md)."""
    shift: float = 0.0
    """Training: largest shift of the box centre, as a fraction of the box's larger side."""
    smallest: float = 1.0
    """Training: smallest factor on the box's size."""
    largest: float = 1.0
    """Training: largest factor on the box's size."""
    roll: float = 0.0
    """Training: half of the crops are as a camera sees them that is rolled about its line of sight, by at most so many
    degrees."""
    beyond: float = 0.0
    """Training: how far the boxes of hands that the picture's edge cuts reach beyond it: half of them at most so large
    a share of the way to the hand's end, as those of joints that were found; the others at most so large a share of
    their longer side, as those of masks. Without random changes it is this share of the way. At 0 boxes end at the
    edge, and joints far beyond it are not learnt."""
    upright: float = 0.0
    """Training: so large a share of the crops is as a camera sees them that is rolled so that the fingers point up, but
    for an error (`UPRIGHT_ERROR_DEG`)."""
    background: float = 0.0
    """Brightness of the background in the crop: 0 blacks it out, as in the paper."""
    min_joints: int = 12
    """Hands with fewer labelled joints inside the picture are left out."""
    min_visible: float = 0.01
    """Hands whose mask covers less than this fraction of the crop are left out."""

    def __post_init__(self) -> None:
        if self.kind not in ("square", "perspective"):
            raise InputError(f"crop: kind must be square or perspective, got {self.kind!r}")
        if not 0 <= self.roll <= 180:
            raise InputError(f"crop: roll must lie in 0..180 degrees, got {self.roll}")
        for name in ("beyond", "upright", "background"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"crop: {name} must lie in 0..1, got {getattr(self, name)}")
        if not (self.margin > 0 and self.shift >= 0 and 0 < self.smallest <= self.largest):
            raise InputError(
                f"crop: need margin > 0, shift >= 0, 0 < smallest <= largest, got {self.margin}, {self.shift}, "
                f"{self.smallest}, {self.largest}"
            )


@dataclass(frozen=True, slots=True)
class Segmentation:
    """What HandSegNet answered for one picture.

    Attributes:
        classes: (H, W) uint8, 0 background, 1 left, 2 right, 3 perhaps left, 4 perhaps right.
        boxes_px: (2, 4) u0, v0, u1, v1 in pixels of the picture; NaN for a hand that was not found.
    """

    classes: np.ndarray
    boxes_px: np.ndarray


@dataclass(frozen=True, slots=True)
class PoseTarget:
    """One training example of PoseNet2D and PoseNet3D: a left-like hand.

    Attributes:
        image: (S, S, 3) uint8 RGB, composed crop.
        joints_px: (21, 2) float32 in crop pixels, 0 where `weight` is 0.
        weight: (21,) float32, for a labelled joint inside the crop 1 or `HandSample.confidence`, else 0.
        canonical: (21, 3) float32, x mirrored for right hands; 0 where unknown.
        canonical_weight: (21,) float32, 1 where `canonical` is known.
        distance: root's distance from the pinhole over the hand length; 0 where unknown.
        rays_from_crop: (3, 3) float32, crop pixels (u, v, 1) -> viewing ray in the left-like camera frame: mirrored
            back for right hands, so that right hands need no further care downstream. Lens distortion ignored. Of the
            rolled camera if there is one, as `canonical`.
        image_from_crop: (3, 3) float32, crop pixels -> pixels of the full picture.
        side: LEFT or RIGHT.
        hand: whether the crop shows a hand of that side; if not, no joint is known.
    """

    image: np.ndarray
    joints_px: np.ndarray
    weight: np.ndarray
    canonical: np.ndarray
    canonical_weight: np.ndarray
    distance: float
    rays_from_crop: np.ndarray
    image_from_crop: np.ndarray
    side: int
    hand: bool = True


def crop_matrix(
    box_px: np.ndarray,
    camera: PinholeCamera,
    side: int,
    size: int,
    config: CropConfig,
    rng: np.random.Generator | None = None,
) -> np.ndarray:
    """`image_from_crop` for a hand's box, (3, 3) float64, jittered if `rng` is given."""
    box = np.asarray(box_px, dtype=np.float64)
    if rng is not None:
        larger = max(box[2] - box[0], box[3] - box[1])
        centre = (box[:2] + box[2:]) / 2 + rng.uniform(-config.shift, config.shift, 2) * larger
        half = (box[2:] - box[:2]) / 2 * rng.uniform(config.smallest, config.largest)
        box = np.concatenate([centre - half, centre + half])
    if config.kind == "square":
        return np.asarray(square_crop(box, size=size, side=side, margin=config.margin))
    box = box_before_camera(box, camera)
    return np.asarray(perspective_crop(box, camera, size=size, side=side, margin=config.margin))


def pose_target(
    sample: HandSample,
    side: int,
    size: int,
    crop: CropConfig,
    *,
    photometric: PhotometricConfig | None = None,
    masks: MaskConfig | None = None,
    predicted: Segmentation | None = None,
    rng: np.random.Generator | None = None,
) -> PoseTarget | None:
    """What PoseNet2D and PoseNet3D see and should answer for one hand.

    Without part labels the whole crop counts as the primary hand's mask.

    Args:
        sample: the picture.
        side: LEFT or RIGHT.
        size: crop side in pixels.
        crop: kind of crop, jitter, and which hands to leave out.
        photometric, masks: training changes, used only with `rng`.
        predicted: HandSegNet's masks and boxes, to be used instead of the true ones: as they are, without `masks` and
            without the jitter of `crop`. A hand that it missed or took for the other one keeps the true ones.
        rng: source of randomness; None gives the plain, centred crop.

    Returns:
        The target, or None if the hand is absent or too little of it can be seen.

    Source: paper section 4.2 (input, mirroring), section 4.3 (targets).
    """
    box = hand_box(sample, side)
    if box is None:
        return None
    known = np.asarray(sample.valid[side]) & np.isfinite(sample.joints_px[side]).all(axis=-1)
    joints_px = np.where(known[:, None], sample.joints_px[side], 0.0)
    height, width = sample.image.shape[:2]
    if int((known & inside_picture(joints_px, width, height)).sum()) < crop.min_joints:
        return None

    rolled_camera = _rolled_camera(joints_px, known, crop, rng)
    unrolled = image_from_rolled(sample.camera, rolled_camera)
    seen = rolled_box(joints_px, (height, width), unrolled, known)
    if min(seen[2:] - seen[:2]) < 2:
        return None
    if crop.beyond:
        seen = _reaching_beyond(seen, joints_px[known], unrolled, (height, width), crop, rng)
    overlap = 0.0 if predicted is None else box_iou(box, predicted.boxes_px[side])
    if predicted is not None and overlap > LEAST_OVERLAP and not shows_other_hand(sample, side, predicted):
        seen = _like(seen, box, predicted.boxes_px[side], unrolled)
        rolled_from_crop = crop_matrix(seen, sample.camera, side, size, crop)
    else:
        predicted = None
        rolled_from_crop = crop_matrix(seen, sample.camera, side, size, crop, rng)
    image_from_crop = unrolled @ rolled_from_crop
    crop_joints = np.asarray(apply_homography(np.linalg.inv(image_from_crop), joints_px))
    inside = known & inside_picture(crop_joints, size, size)
    image = warp_image(sample.image, image_from_crop, size, interpolation="linear")
    if sample.labels is None:
        classes = np.full((size, size), side + 1, np.uint8)
    else:
        labels = warp_image(sample.labels, image_from_crop, size, interpolation="nearest")
        classes = hand_classes(labels)
        if (classes == side + 1).mean() < crop.min_visible:
            return None
        if predicted is not None:
            classes = warp_image(predicted.classes, image_from_crop, size, interpolation="nearest")
        elif rng is not None and masks is not None:
            classes = spoil_masks(classes, labels == 1 + 7 * side, side, masks, rng)
    composed = _composed(image, classes, side, crop, photometric, rng)

    canonical, distance, has_3d = _canonical_target(sample, side, rolled_camera)
    mirror = MIRROR_X if side == RIGHT else np.eye(3)
    rays = mirror @ np.linalg.inv(intrinsic_matrix(sample.camera)) @ rolled_from_crop
    return PoseTarget(
        image=composed,
        joints_px=np.where(inside[:, None], crop_joints, 0.0).astype(np.float32),
        weight=(inside if sample.confidence is None else inside * sample.confidence[side]).astype(np.float32),
        canonical=canonical.astype(np.float32),
        canonical_weight=has_3d.astype(np.float32),
        distance=distance,
        rays_from_crop=rays.astype(np.float32),
        image_from_crop=image_from_crop.astype(np.float32),
        side=side,
    )


def _rolled_camera(
    joints_px: np.ndarray, known: np.ndarray, crop: CropConfig, rng: np.random.Generator | None
) -> np.ndarray:
    """(3, 3) rotation about z to the camera that sees a hand of joints (21, 2), of which some are known, (21,) bool."""
    if rng is None or not _is_upright(crop, rng) or not known[[WRIST, ROOT]].all():
        return random_roll(crop.roll, rng)
    roll_deg = float(upright_roll_deg(joints_px)) + rng.normal(0, UPRIGHT_ERROR_DEG)
    return rotation_about_z(math.radians(roll_deg))


def _reaching_beyond(
    seen: np.ndarray,
    joints_px: np.ndarray,
    unrolled: np.ndarray,
    size: tuple[int, int],
    crop: CropConfig,
    rng: np.random.Generator | None,
) -> np.ndarray:
    """A hand's box (4,) as the rolled camera sees it, `seen` of its part in the picture of size (H, W), with some of
    what is beyond the edges that its joints (K, 2) cross."""
    share = crop.beyond if rng is None else rng.uniform(0, crop.beyond)
    end = joints_px
    if rng is not None and rng.random() < 0.5:  # wherever the hand ends
        inside = np.clip(joints_px, 0, size[::-1])
        end = inside + np.sign(joints_px - inside) * np.ptp(inside, axis=0).max()
    whole = np.asarray(box_from_points(apply_homography(np.linalg.inv(unrolled), end)))
    return (1 - share) * seen + share * whole


def _is_upright(crop: CropConfig, rng: np.random.Generator | None) -> bool:
    """Whether this crop is of the share that is `CropConfig.upright`."""
    return rng is not None and crop.upright > 0 and rng.random() < crop.upright


def shows_other_hand(sample: HandSample, side: int, predicted: Segmentation) -> bool:
    """Whether a hand's predicted mask covers more of the other hand than of this one. Hands that are not segmented in
    the labels are not known to."""
    if sample.labels is None:
        return False
    u0, v0, u1, v1 = np.nan_to_num(predicted.boxes_px[side]).clip(0).astype(int)
    part = np.s_[v0 : v1 + 1, u0 : u1 + 1]
    shown = hand_classes(sample.labels[part])[predicted.classes[part] == side + 1]
    own, other = ((shown == hand + 1).sum() for hand in (side, 1 - side))
    return bool(other > own)


def false_hand(
    image: np.ndarray,
    classes: np.ndarray,
    box_px: np.ndarray,
    camera: PinholeCamera,
    side: int,
    size: int,
    crop: CropConfig,
    *,
    photometric: PhotometricConfig | None = None,
    rng: np.random.Generator | None = None,
) -> PoseTarget:
    """A crop cut where no hand of that side is, for PoseNet2D's judge; rolled as often as those of hands.

    Args:
        image: (H, W, 3) uint8 RGB.
        classes: (H, W) uint8, the masks that mistake something for a hand.
        box_px: (4,) u0, v0, u1, v1, where the hand is said to be.
        camera: of the picture.
        side: which hand it is said to be.
        size: crop side in pixels.
        crop: kind of crop.
        photometric: training changes, used only with `rng`.
        rng: source of randomness.
    """
    anyhow = _is_upright(crop, rng)  # the fingers may have been thought to be anywhere
    rolled_camera = random_roll(180.0 if anyhow else crop.roll, rng)
    unrolled = image_from_rolled(camera, rolled_camera)
    rolled = rolled_box(ellipse_in(box_px), image.shape[:2], unrolled)
    image_from_crop = unrolled @ crop_matrix(rolled, camera, side, size, crop)
    shown = warp_image(image, image_from_crop, size, interpolation="linear")
    masks = warp_image(classes, image_from_crop, size, interpolation="nearest")
    return _without_hand(_composed(shown, masks, side, crop, photometric, rng), image_from_crop, side)


def mirrored_hand(target: PoseTarget) -> PoseTarget:
    """The same crop mirrored: it shows a hand of the wrong side."""
    return _without_hand(np.ascontiguousarray(target.image[:, ::-1]), target.image_from_crop, target.side)


def _without_hand(image: np.ndarray, image_from_crop: np.ndarray, side: int) -> PoseTarget:
    nothing = np.zeros(N_JOINTS, np.float32)
    return PoseTarget(
        image=image,
        joints_px=np.zeros((N_JOINTS, 2), np.float32),
        weight=nothing,
        canonical=np.zeros((N_JOINTS, 3), np.float32),
        canonical_weight=nothing,
        distance=0.0,
        rays_from_crop=np.eye(3, dtype=np.float32),
        image_from_crop=image_from_crop.astype(np.float32),
        side=side,
        hand=False,
    )


def _composed(
    image: np.ndarray,
    classes: np.ndarray,
    side: int,
    crop: CropConfig,
    photometric: PhotometricConfig | None,
    rng: np.random.Generator | None,
) -> np.ndarray:
    """A crop (S, S, 3) and its masks (S, S) as PoseNet2D sees them, the colours changed if `rng` is given."""
    if rng is not None and photometric is not None:
        image = jitter_colours(image, photometric, rng)
    return compose_hand_input(image, classes, np.eye(3), side, len(image), crop.background)


def _like(rolled_box: np.ndarray, box: np.ndarray, predicted: np.ndarray, unrolled: np.ndarray) -> np.ndarray:
    """A predicted box in the rolled picture: beside the tight box there by as much as it is beside the true one, and
    larger or smaller by as much."""
    middles = np.stack([predicted[:2] + predicted[2:], box[:2] + box[2:]]) / 2
    found, true = apply_homography(np.linalg.inv(unrolled), middles)
    centre = (rolled_box[:2] + rolled_box[2:]) / 2 + found - true
    half = (predicted[2:] - predicted[:2]) / 2 * (rolled_box[2:] - rolled_box[:2]) / (box[2:] - box[:2])
    return np.concatenate([centre - half, centre + half])


def _canonical_target(sample: HandSample, side: int, rolled_camera: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """Left-like canonical joints (21, 3), distance in hand lengths, and which joints are known (21,), all for the
    camera rolled by `rolled_camera` (3, 3)."""
    joints = np.asarray(sample.joints_m[side], dtype=np.float64) @ rolled_camera.T
    known = np.asarray(sample.valid[side]) & np.isfinite(joints).all(axis=-1)
    if not (known[ROOT] and known[WRIST]):
        return np.zeros((N_JOINTS, 3)), 0.0, np.zeros(N_JOINTS, bool)
    canonical = canonical_from_camera(np.where(known[:, None], joints, joints[ROOT]))
    pose = np.where(known[:, None], canonical.joints, 0.0)
    if side == RIGHT:
        pose = pose @ MIRROR_X
    return pose, float(np.linalg.norm(joints[ROOT]) / canonical.hand_length_m), known
