"""Plain records that cross package borders. Conventions: docs/conventions.md.

Camera frame: x right, y down, z forward, metres. Pixels: (u, v), (0, 0) is the outer corner of the first pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from twohands.errors import InputError
from twohands.skeleton import ROOT

Array = Any
"""A numpy array or a torch tensor; functions of `twohands.geometry` return the kind they were given."""


MAX_SIDE_PX = 1 << 16
"""Of a picture: no camera has more, and no decoder takes more."""
MIN_FOCAL_PX, MAX_FOCAL_PX = 1e-3, 1e8
MAX_COEFFICIENT = 1e6
"""Of lens distortion. Within these bounds nothing overflows; what can be believed is a narrower matter
(`twohands.plausibility`)."""


@dataclass(frozen=True, slots=True)
class PinholeCamera:
    """Intrinsics of one camera at one image size.

    Attributes:
        fx, fy: focal lengths in pixels, positive.
        cx, cy: principal point in pixels, measured from the image's outer corner.
        width, height: image size in pixels.
        distortion: OpenCV coefficients (k1, k2, p1, p2[, k3[, k4, k5, k6]]), empty for none; an array of any shape is
            taken as well, and kept as a tuple.

    Raises:
        InputError: a value is not finite, not positive where it must be, or beyond the bounds above.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name in ("fx", "fy", "cx", "cy", "width", "height"):
            value = getattr(self, name)
            if not math.isfinite(value):
                raise InputError(f"camera: {name} must be a finite number, got {value}")
            if name in ("fx", "fy", "width", "height") and value <= 0:
                raise InputError(f"camera: {name} must be positive, got {value:g}")
            if name in ("width", "height") and value > MAX_SIDE_PX:
                raise InputError(f"camera: {name} must be at most {MAX_SIDE_PX} pixels, got {value:g}")
            if abs(value) > MAX_FOCAL_PX:
                raise InputError(f"camera: {name} must be at most {MAX_FOCAL_PX:g} pixels, got {value:g}")
            if name in ("fx", "fy") and value < MIN_FOCAL_PX:
                raise InputError(f"camera: {name} must be at least {MIN_FOCAL_PX:g} pixels, got {value:g}")
        object.__setattr__(self, "distortion", tuple(np.ravel(np.asarray(self.distortion, np.float64)).tolist()))
        if len(self.distortion) not in (0, 4, 5, 8) or not all(map(math.isfinite, self.distortion)):
            raise InputError(f"camera: distortion needs 0, 4, 5 or 8 finite numbers, got {self.distortion}")
        if any(abs(value) > MAX_COEFFICIENT for value in self.distortion):
            raise InputError(f"camera: distortion must be at most {MAX_COEFFICIENT:g}, got {self.distortion}")

    @classmethod
    def from_fov(cls, hfov_deg: float, width: int, height: int) -> PinholeCamera:
        """A camera with square pixels, centred principal point and the given horizontal field of view in degrees."""
        if not (math.isfinite(hfov_deg) and 0.0 < hfov_deg < 180.0):
            raise InputError(f"field of view must lie between 0 and 180 degrees, got {hfov_deg}")
        focal = 0.5 * width / math.tan(math.radians(hfov_deg) / 2)
        return cls(focal, focal, width / 2, height / 2, width, height)

    @classmethod
    def ego3dhands(cls, width: int = 480, height: int = 270) -> PinholeCamera:
        """The paper's camera: f = 187.932 px at 480x270, centred principal point (docs/dataset-format.md)."""
        focal = 187.932202 * height / 270
        return cls(focal, focal, width / 2, height / 2, width, height)

    @property
    def hfov_deg(self) -> float:
        """Horizontal field of view in degrees, lens distortion ignored."""
        return math.degrees(math.atan(self.cx / self.fx) + math.atan((self.width - self.cx) / self.fx))

    def resized(self, width: int, height: int) -> PinholeCamera:
        """The same camera after its image was resized; a plain product, because pixel (0, 0) is the outer corner."""
        sx, sy = width / self.width, height / self.height
        return PinholeCamera(self.fx * sx, self.fy * sy, self.cx * sx, self.cy * sy, width, height, self.distortion)


@dataclass(frozen=True, slots=True)
class RenderedFrame:
    """What a renderer returns for one scene.

    Attributes:
        rgb: (H, W, 3) uint8, straight (not premultiplied) colour, 0 where alpha is 0.
        alpha: (H, W) uint8.
        depth_m: (H, W) float32, planar z in metres, 0 on the background.
        part_labels: (H, W) uint8, 0..14 (`skeleton.part_label`).
        joints_m: (2, 22, 3) float64, camera frame, (elbow, 21 joints); NaN for an absent hand.
        present: (2,) bool, (LEFT, RIGHT).
        camera: the camera it was rendered with.
        amodal: (2, H, W) bool, the pixels that each arm would cover, with what it wears, if all else were away; None
            where nobody asked for them.
        turns: of pictures of whole people, by how many quarter turns (counter-clockwise, 0..3) the room stands turned
            in the picture, as the camera lay on its side or hung head down; None of others.

    Alpha also covers things that are no part of a hand and have neither label nor depth; where there are none, a pixel
    has a label exactly where it has alpha.
    """

    rgb: np.ndarray
    alpha: np.ndarray
    depth_m: np.ndarray
    part_labels: np.ndarray
    joints_m: np.ndarray
    present: np.ndarray
    camera: PinholeCamera
    amodal: np.ndarray | None = None
    turns: int | None = None


@dataclass(frozen=True, slots=True)
class HandSample:
    """One labelled picture, whatever its origin.

    Attributes:
        image: (H, W, 3) uint8 RGB.
        camera: intrinsics at this image size.
        present: (2,) bool, (LEFT, RIGHT).
        joints_px: (2, 21, 2) float, pixels of this image; NaN where unknown.
        joints_m: (2, 21, 3) float, camera frame, metres; NaN where unknown.
        valid: (2, 21) bool, which joints carry labels.
        labels: (H, W) uint8 part labels 0..14, or None.
        depth_m: (H, W) float32 planar depth, 0 on the background, or None.
        source: identifies the sample in messages and reports.
        visible: (2, 21) bool, which labelled joints can be seen, or None where the data set does not say.
        confidence: (2, 21) float, 0..1, how much the labels of the joints count in training; None if all count fully.
    """

    image: np.ndarray
    camera: PinholeCamera
    present: np.ndarray
    joints_px: np.ndarray
    joints_m: np.ndarray
    valid: np.ndarray
    labels: np.ndarray | None = None
    depth_m: np.ndarray | None = None
    source: str = ""
    visible: np.ndarray | None = None
    confidence: np.ndarray | None = None


@dataclass(frozen=True, slots=True)
class HandCrop:
    """A square picture of one hand and how to leave it again.

    Attributes:
        image: (S, S, 3) uint8 RGB, composed and mirrored as the network sees it.
        image_from_crop: (3, 3) float64 homography from crop pixels to pixels of the full image; it contains the
            mirroring, so un-cropping and un-mirroring a point is one call of `geometry.boxes.apply_homography`.
        side: LEFT or RIGHT.
        mirrored: whether the crop was flipped, so that the network sees a left-like hand.
        roll_deg: of the camera that sees it so, about its line of sight; 0 is that of the picture.
        pair: of pose networks that it was cut for: 0, or 1 for a preset's second ones.
    """

    image: np.ndarray
    image_from_crop: np.ndarray
    side: int
    mirrored: bool
    roll_deg: float = 0.0
    pair: int = 0


@dataclass(frozen=True, slots=True)
class GlobalPose:
    """Result of the global projection; leading batch dimensions as in the input.

    Attributes:
        joints_m: (..., 21, 3) camera frame, metres; NaN where not valid.
        radius_m: (...) distance of the root joint from the pinhole; NaN where not valid.
        theta, phi: (...) direction of the root joint in radians (docs/conventions.md); known wherever its pixel is,
            else NaN.
        key_bone: (...) index into `skeleton.KEY_BONES` of the bone that was, or would be, used.
        valid: (...) bool.
    """

    joints_m: Array
    radius_m: Array
    theta: Array
    phi: Array
    key_bone: Array
    valid: Array


@dataclass(frozen=True, slots=True)
class HandPose:
    """Everything known about one hand in one image. Absent hands have `present` False and None elsewhere.

    Attributes:
        present: whether the hand was found.
        score: confidence of presence, 0..1.
        box_px: (4,) u0, v0, u1, v1 in pixels, within the picture.
        joints_px: (21, 2) pixels; of a hand that the picture's edge cuts also beyond it.
        joint_scores: (21,) 0..1.
        canonical: (21, 3) unitless, root at 0, |wrist - root| = 1 (to about 1 % in an estimate), centred frame.
        joints_m: (21, 3) camera frame, metres; None if the projection is not valid.
        range_m: distance of the root joint, metres; None if not valid.
        theta_deg, phi_deg: direction of the root joint; a fitted one's is where all joints put it, a little beside its
            own pixel.
        key_bone: "wrist" or "little".
        method: how the root was placed: "fitted", "all-joints", "keybone"; or "predicted" from earlier frames.
        valid: whether the camera-space result can be used.
        side_logit: log-odds that the hand is of this side and not of the other, as this picture alone says; None where
            nobody says; not exported.
        pair: of pose networks that saw the joints, 0 or 1; None where it was none of ours; for the next frame of a
            video, not exported.
        other_px: (21, 2) the joints as the other pair of pose networks sees them; None where it was not asked; for the
            next frame of a video, not exported.
        range_shares: the range as the pose networks place it whose word it is, over that which the joints by themselves
            say, the standard deviation of the estimate over it (NaN where it is not known), and the mean score of the
            joints that it was estimated from; None where nothing is known; for the next frame of a video, not exported.
        body_range_m: how far the hand is by the size of its person's body, metres; None where nobody knows; for the
            next frame of a video, not exported.
        range_sigma_m: standard deviation of `range_m`, metres: that of the estimate, and of what was assumed; None
            where it is not known.
        scale_source: how the hand length is known: "typed", "board", "distance", "assumed".
        intrinsics_source: how the camera is known: "file", "fov", "board", "exif", "assumed".
    """

    present: bool
    score: float | None = None
    box_px: np.ndarray | None = None
    joints_px: np.ndarray | None = None
    joint_scores: np.ndarray | None = None
    canonical: np.ndarray | None = None
    joints_m: np.ndarray | None = None
    range_m: float | None = None
    theta_deg: float | None = None
    phi_deg: float | None = None
    key_bone: str | None = None
    method: str | None = None
    valid: bool | None = None
    side_logit: float | None = None
    pair: int | None = None
    other_px: np.ndarray | None = None
    range_shares: tuple[float, float, float] | None = None
    body_range_m: float | None = None
    range_sigma_m: float | None = None
    scale_source: str | None = None
    intrinsics_source: str | None = None


@dataclass(frozen=True, slots=True)
class TwoHandPose:
    """Both hands in one image.

    Attributes:
        left, right: the person's own hands in an unmirrored image.
        camera: intrinsics that were used.
        masks: (H, W) uint8, 0 background, 1 left, 2 right; not exported.
        crop_masks: the same with 3 perhaps left, 4 perhaps right, by which hands are cropped; for the next frame of a
            video, not exported.
        index, time_s: position in the source.
        followed: whether the hands were looked for only where those of the frame before should be; not exported.
        turn_logits: (4,) log-odds, against each other, that the picture is an upright one turned by 0 to 3 quarters,
            counter-clockwise, as this picture alone says; None where nobody says; for the next frame of a video, not
            exported.
        around_px: (2, 2) middle of the person's body and a point at its end, in pixels; None where there is none; for
            the next frame of a video, not exported.
        image: (H, W, 3) uint8 RGB, the picture itself; for the next frame of a video, not exported.
    """

    left: HandPose
    right: HandPose
    camera: PinholeCamera
    masks: np.ndarray | None = field(default=None, repr=False)
    index: int = 0
    time_s: float | None = None
    followed: bool = False
    crop_masks: np.ndarray | None = field(default=None, repr=False)
    turn_logits: np.ndarray | None = field(default=None, repr=False)
    around_px: np.ndarray | None = field(default=None, repr=False)
    image: np.ndarray | None = field(default=None, repr=False)

    @property
    def hands(self) -> tuple[HandPose, HandPose]:
        """(LEFT, RIGHT)."""
        return self.left, self.right

    def without_masks(self) -> TwoHandPose:
        """The same with neither masks nor picture, for who keeps many."""
        return replace(self, masks=None, crop_masks=None, image=None)

    @property
    def between_hands_m(self) -> np.ndarray | None:
        """(3,) from the left hand's root joint to the right one's, camera frame, metres; None unless both are valid."""
        if self.left.joints_m is None or self.right.joints_m is None or not (self.left.valid and self.right.valid):
            return None
        return self.right.joints_m[ROOT] - self.left.joints_m[ROOT]

    @property
    def overlap(self) -> float | None:
        """Share of the smaller hand's box that lies in the other's, 0..1; None unless both are present."""
        if self.left.box_px is None or self.right.box_px is None:
            return None
        left, right = (np.asarray(hand.box_px, np.float64) for hand in self.hands)
        common = np.minimum(left[2:], right[2:]) - np.maximum(left[:2], right[:2])
        smaller = min(float(np.prod(box[2:] - box[:2])) for box in (left, right))
        return float(np.prod(np.maximum(common, 0.0))) / smaller if smaller > 0 else None
