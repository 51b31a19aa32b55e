"""From a labelled picture to what each network is shown and asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from twohands.datasets.transforms import MaskConfig, PhotometricConfig, jitter_colours, spoil_masks
from twohands.errors import DataFormatError, InputError
from twohands.geometry.boxes import apply_homography, box_from_points, perspective_crop, square_crop, warp_image
from twohands.geometry.canonical import canonical_from_camera
from twohands.geometry.composition import compose_hand_input
from twohands.geometry.segmentation import letterbox
from twohands.skeleton import N_JOINTS, RIGHT, ROOT, WRIST
from twohands.types import HandSample, PinholeCamera

MIRROR_X = np.diag([-1.0, 1.0, 1.0])


@dataclass(frozen=True)
class CropConfig:
    """How a hand is cut out for PoseNet2D."""

    kind: Literal["square", "perspective"] = "square"
    """square: the paper's axis-aligned crop; perspective: what a camera that looks at the box's centre would see."""
    margin: float = 1.5
    """Crop side over the larger side of the hand's box (SPEC 2)."""
    shift: float = 0.0
    """Training: largest shift of the box centre, as a fraction of the box's larger side."""
    smallest: float = 1.0
    """Training: smallest factor on the box's size."""
    largest: float = 1.0
    """Training: largest factor on the box's size."""
    roll: float = 0.0
    """Training: half of the crops are as a camera sees them that is rolled about its line of sight, by at most so many
    degrees."""
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
        if not 0 <= self.background <= 1:
            raise InputError(f"crop: background must lie in 0..1, got {self.background}")
        if not (self.margin > 0 and self.shift >= 0 and 0 < self.smallest <= self.largest):
            raise InputError(
                f"crop: need margin > 0, shift >= 0, 0 < smallest <= largest, got {self.margin}, {self.shift}, "
                f"{self.smallest}, {self.largest}"
            )


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

    def __post_init__(self) -> None:
        if not 0 <= self.close <= 1:
            raise InputError(f"zoom: close must lie in 0..1, got {self.close}")
        if not 0 <= self.roll <= 180:
            raise InputError(f"zoom: roll must lie in 0..180 degrees, got {self.roll}")


CLOSE = (0.25, 0.8)
"""Range of a close hand's size: the larger side of its box over the picture's height."""
LEAST_INSIDE = 0.2
"""A hand of whose box a change has left less than this in the picture counts as absent."""
LARGEST_ZOOM = 3.0
"""A close hand is enlarged no further than this: there is no more detail in the picture."""


@dataclass(frozen=True, slots=True)
class SegmentationTarget:
    """One training example of HandSegNet.

    Attributes:
        image: (H, W, 3) uint8 RGB at network size, fitted in as for inference (`geometry.segmentation.letterbox`).
        classes: (H, W) uint8, 0 background, 1 left, 2 right; the forearm belongs to its hand (SPEC 2).
        boxes_px: (2, 4) float32 u0, v0, u1, v1 in pixels of `image`, clipped to it; 0 for an absent hand.
        present: (2,) bool.
    """

    image: np.ndarray
    classes: np.ndarray
    boxes_px: np.ndarray
    present: np.ndarray


@dataclass(frozen=True, slots=True)
class Segmentation:
    """What HandSegNet answered for one picture.

    Attributes:
        classes: (H, W) uint8, 0 background, 1 left, 2 right.
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
        weight: (21,) float32, 1 for a labelled joint inside the crop, else 0.
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


def hand_classes(labels: np.ndarray) -> np.ndarray:
    """Part labels 0..14 -> classes 0 background, 1 left, 2 right, same shape, uint8."""
    return ((labels > 0).astype(np.uint8) + (labels > 7)).astype(np.uint8)


def hand_box(sample: HandSample, side: int) -> np.ndarray | None:
    """Tight box of a hand's labelled 2D joints, clipped to the picture.

    Returns:
        (4,) u0, v0, u1, v1 in pixels; None if the hand is absent or less than 2 pixels of it are in the picture.
    """
    boxes, found = _boxes_inside(_hand_points(sample)[[side]], *sample.image.shape[1::-1])
    return boxes[0] if found[0] else None


def segmentation_target(
    sample: HandSample,
    height: int,
    width: int,
    *,
    photometric: PhotometricConfig | None = None,
    zoom: ZoomConfig | None = None,
    rng: np.random.Generator | None = None,
) -> SegmentationTarget:
    """What HandSegNet sees and should answer for one picture.

    Args:
        sample: must carry part labels.
        height, width: network size.
        photometric, zoom: training changes, used only with `rng`.
        rng: source of randomness; None leaves the picture as it is.

    Raises:
        DataFormatError: no part labels.
    """
    if sample.labels is None:
        raise DataFormatError(f"{sample.source}: HandSegNet needs part labels, this sample has none")
    full_height, full_width = sample.image.shape[:2]
    image, place = letterbox(sample.image, (height, width))
    scale = np.array([place.width * width / full_width, place.height * height / full_height])
    corner = np.array([place.left * width, place.top * height])
    cols, rows = (
        np.clip((np.arange(size) + 0.5 - corner[axis]) / scale[axis], 0, full - 1).astype(int)
        for axis, (size, full) in enumerate([(width, full_width), (height, full_height)])
    )
    classes = hand_classes(sample.labels[np.ix_(rows, cols)])
    points = _hand_points(sample) * scale + corner
    if rng is not None:
        if zoom is not None:
            image, classes, points = _zoomed(image, classes, points, zoom, rng)
        if photometric is not None:
            image = jitter_colours(image, photometric, rng)
    boxes, present = _boxes_inside(points, width, height)
    return SegmentationTarget(image, classes, boxes.astype(np.float32), present)


def _hand_points(sample: HandSample) -> np.ndarray:
    """(2, 21, 2) joints, moved into the picture where they lie outside; NaN where unknown or of an absent hand."""
    height, width = sample.image.shape[:2]
    points = np.asarray(sample.joints_px, np.float64)
    known = np.asarray(sample.valid) & np.asarray(sample.present)[:, None] & np.isfinite(points).all(axis=-1)
    return np.where(known[..., None], np.clip(points, 0, [width, height]), np.nan)


def _boxes_inside(points: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Tight boxes of hands (N, K, 2), clipped to the picture, (N, 4), 0 for a hand of which less than 2 pixels or
    `LEAST_INSIDE` of its box are inside; and whether there is one, (N,)."""
    whole = np.asarray(box_from_points(points))
    inside = np.clip(whole, 0, [width, height, width, height])
    sizes, whole_sizes = inside[:, 2:] - inside[:, :2], whole[:, 2:] - whole[:, :2]
    present = (sizes.min(axis=1) >= 2) & (sizes.prod(axis=1) >= LEAST_INSIDE * whole_sizes.prod(axis=1))
    return np.where(present[:, None], inside, 0.0), present


def _zoomed(image, classes, points, config: ZoomConfig, rng: np.random.Generator):
    """Scale about the centre, shift, perhaps flip (swapping left and right), perhaps turn; the border goes on outside,
    so that arms that leave the picture are not cut off. Returns the picture, classes and joints."""
    height, width = classes.shape
    scale = 2.0 ** rng.uniform(-config.zoom, config.zoom)
    shift = rng.uniform(-config.shift, config.shift, 2) * [width, height]
    flip = rng.random() < config.flip
    turn = _roll(config.roll, rng)[:2, :2]
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
        classes = np.array([0, 2, 1], np.uint8)[np.asarray(classes, np.uint8)]
        points = points[::-1]
    return image, classes, points


def _close_up(points, width: int, height: int, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Centre and scale of a part of the picture, at most the whole, in which one of the hands is near and its box
    inside; the whole where there is no hand."""
    corner = np.array([width, height], np.float64)
    boxes, present = _boxes_inside(points, width, height)
    if not present.any():
        return corner / 2, 1.0
    box = boxes[rng.choice(np.flatnonzero(present))]
    larger = max(box[2:] - box[:2])
    scale = float(np.clip(np.exp(rng.uniform(*np.log(CLOSE))) * height / larger, 1, LARGEST_ZOOM))
    half = corner / 2 / scale
    room = np.maximum(half - larger / 2, 0)
    centre = (box[:2] + box[2:]) / 2 + rng.uniform(-room, room)
    return np.clip(centre, half, corner - half), scale


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
            without the jitter of `crop`. A hand that it missed keeps the true ones.
        rng: source of randomness; None gives the plain, centred crop.

    Returns:
        The target, or None if the hand is absent or too little of it can be seen.

    Source: SPEC 3 (input composition, mirroring), SPEC 4 (targets).
    """
    box = hand_box(sample, side)
    if box is None:
        return None
    known = np.asarray(sample.valid[side]) & np.isfinite(sample.joints_px[side]).all(axis=-1)
    joints_px = np.where(known[:, None], sample.joints_px[side], 0.0)
    height, width = sample.image.shape[:2]
    if int((known & _inside(joints_px, width, height)).sum()) < crop.min_joints:
        return None

    rolled_camera = _roll(crop.roll, rng)
    intrinsics = _intrinsics(sample.camera)
    image_from_rolled = intrinsics @ rolled_camera.T @ np.linalg.inv(intrinsics)
    corner = np.array([width, height], np.float64)
    seen = apply_homography(np.linalg.inv(image_from_rolled), np.clip(joints_px, 0, corner))
    rolled_box = np.asarray(box_from_points(seen, known), np.float64)
    if min(rolled_box[2:] - rolled_box[:2]) < 2:
        return None
    if predicted is not None and np.isfinite(predicted.boxes_px[side]).all():
        rolled_box = _like(rolled_box, box, predicted.boxes_px[side], image_from_rolled)
        rolled_from_crop = crop_matrix(rolled_box, sample.camera, side, size, crop)
    else:
        predicted = None
        rolled_from_crop = crop_matrix(rolled_box, sample.camera, side, size, crop, rng)
    image_from_crop = image_from_rolled @ rolled_from_crop
    crop_joints = np.asarray(apply_homography(np.linalg.inv(image_from_crop), joints_px))
    inside = known & _inside(crop_joints, size, size)
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
    rays = mirror @ np.linalg.inv(intrinsics) @ rolled_from_crop
    return PoseTarget(
        image=composed,
        joints_px=np.where(inside[:, None], crop_joints, 0.0).astype(np.float32),
        weight=inside.astype(np.float32),
        canonical=canonical.astype(np.float32),
        canonical_weight=has_3d.astype(np.float32),
        distance=distance,
        rays_from_crop=rays.astype(np.float32),
        image_from_crop=image_from_crop.astype(np.float32),
        side=side,
    )


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
    """A crop cut where no hand of that side is, for PoseNet2D's judge.

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
    image_from_crop = crop_matrix(box_px, camera, side, size, crop)
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


def _roll(largest_deg: float, rng: np.random.Generator | None) -> np.ndarray:
    """(3, 3) rotation about z, from the frame of a camera to that of the rolled one: in half of all cases none, else by
    at most so many degrees."""
    if rng is None or not largest_deg or rng.random() < 0.5:
        return np.eye(3)
    angle = np.radians(rng.uniform(-largest_deg, largest_deg))
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def _like(rolled_box: np.ndarray, box: np.ndarray, predicted: np.ndarray, image_from_rolled: np.ndarray) -> np.ndarray:
    """A predicted box in the rolled picture: its centre there, and larger or smaller by as much as the true box."""
    centre = apply_homography(np.linalg.inv(image_from_rolled), (predicted[None, :2] + predicted[None, 2:]) / 2)[0]
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


def _inside(points: np.ndarray, width: int, height: int) -> np.ndarray:
    """(N, 2) points -> (N,) bool, within [0, width) x [0, height); NaN is outside."""
    return (points >= 0).all(axis=-1) & (points[:, 0] < width) & (points[:, 1] < height)


def _intrinsics(camera: PinholeCamera) -> np.ndarray:
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
