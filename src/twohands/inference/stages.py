"""The pipeline's stages as a record of functions, and the ground truth that may stand in for what they say.

Whoever wants another stage, or wants to time one, hands `HandEstimator` another record (`dataclasses.replace`);
nobody changes an estimator that exists.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np

from twohands.errors import InputError
from twohands.geometry.body import Body
from twohands.geometry.palm import Palm
from twohands.geometry.segmentation import HandBoxes
from twohands.inference import body as bodies
from twohands.inference import hand_check, keypoints, palm, placement, segmenter
from twohands.inference.engine import Networks
from twohands.inference.keypoints import Keypoints
from twohands.inference.segmenter import HandMaps
from twohands.inference.weights import WeightsCard
from twohands.plausibility import camera_doubts, hand_length_doubts, warn
from twohands.skeleton import N_JOINTS
from twohands.types import GlobalPose, HandCrop, PinholeCamera


@dataclass(frozen=True, slots=True)
class StageTruth:
    """Ground truth that replaces what a stage would estimate; None leaves the stage alone. Axis order (LEFT, RIGHT).

    Attributes:
        masks: (H, W) uint8, 0 background, 1 left, 2 right.
        boxes_px: (2, 4) tight boxes in pixels; NaN for an absent hand.
        present: (2,) bool. A present hand still needs a box, true or estimated, to be found.
        joints_px: (2, 21, 2) pixels; NaN for a joint that is left to the estimate.
        heatmaps: (2, 21, M, M) maps of the crops that the pipeline cuts from its boxes; no cues come with them.
        canonical: (2, 21, 3) unitless canonical joints of the real, unmirrored hands.
    """

    masks: np.ndarray | None = None
    boxes_px: np.ndarray | None = None
    present: np.ndarray | None = None
    joints_px: np.ndarray | None = None
    heatmaps: np.ndarray | None = None
    canonical: np.ndarray | None = None

    @property
    def replaces_nothing(self) -> bool:
        """Whether all stages are left alone."""
        return all(getattr(self, known.name) is None for known in fields(self))

    @property
    def knows_hands(self) -> bool:
        """Whether there is nothing left to ask HandSegNet."""
        return self.masks is not None and self.boxes_px is not None

    def hand_boxes(self) -> HandBoxes | None:
        """The known boxes; a hand is present where its box is finite, unless `present` denies it. None for no boxes."""
        if self.boxes_px is None:
            return None
        known = np.asarray(np.isfinite(self.boxes_px).all(axis=1))
        present = known if self.present is None else np.logical_and(known, self.present)
        return HandBoxes(np.asarray(self.boxes_px, np.float64), present, np.where(present, 1.0, 0.0))


NO_TRUTH = StageTruth()


@dataclass(frozen=True, slots=True)
class Stages:
    """The stages, each a pure function; the networks and the card are bound in.

    Attributes:
        hand_maps: image -> `segmenter.hand_maps`.
        boxes: maps, size of the picture, ... -> `segmenter.candidate_boxes`.
        masks: maps, size of the picture, present -> `segmenter.hand_masks`.
        crop: image, masks, box, side, camera[, roll_deg] -> `keypoints.crop_hand`.
        locate: B crops -> heatmaps (B, 21 + cues, M, M) and hand_logit (B,), `keypoints.locate`.
        read_out: heatmaps, crops -> joints (B, 21, 2) in pixels and scores (B, 21), `keypoints.read_out`.
        lift: keypoints -> canonical joints (B, 21, 3), `placement.lift`.
        place: canonical, joints_px, joint_scores, camera, lengths_m -> `placement.place`.
        refine: hands, the same by those whose ranges count, sigmas, sure, camera, lengths_m, bodies_m ->
            `placement.refine`.
        check: image, joints (B, 21, 2)[, palms] -> `hand_check.checked`; None without such a network.
        body: image[, where to look first] -> `body.seen_body`; None without such networks.
        palms: image -> `palm.seen_palms`; None without such a network.
        card: of the weights.
        second: the same stages with the second pose networks; None without any.
    """

    hand_maps: Callable[[np.ndarray], HandMaps]
    boxes: Callable[..., HandBoxes]
    masks: Callable[..., np.ndarray]
    crop: Callable[..., HandCrop]
    locate: Callable[[list[HandCrop]], tuple[np.ndarray, np.ndarray]]
    read_out: Callable[[np.ndarray, list[HandCrop]], tuple[np.ndarray, np.ndarray]]
    lift: Callable[[Keypoints], np.ndarray]
    place: Callable[[np.ndarray, np.ndarray, np.ndarray, PinholeCamera, np.ndarray], GlobalPose]
    refine: Callable[..., tuple[np.ndarray, GlobalPose, np.ndarray]]
    card: WeightsCard
    check: Callable[..., np.ndarray] | None = None
    body: Callable[[np.ndarray, np.ndarray | None], Body | None] | None = None
    palms: Callable[[np.ndarray], Sequence[Palm]] | None = None
    second: Stages | None = None

    @classmethod
    def of(cls, networks: Networks, card: WeightsCard, pair: int = 0) -> Stages:
        """The stages of a set of weights; `pair` is 1 for those of the second pose networks."""
        check = body = palms = second = None
        if (known := networks.second) is not None:
            check = None if known.hand_check is None else partial(hand_check.checked, known.hand_check, known.card)
            body = None if known.body is None else partial(bodies.seen_body, known.body)
            palms = None if known.palm is None else partial(palm.seen_palms, known.palm)
            poses = replace(networks, pose_net_2d=known.pose_net_2d, pose_net_3d=known.pose_net_3d, second=None)
            second = cls.of(poses, known.card, 1)
        return cls(
            hand_maps=partial(segmenter.hand_maps, networks.hand_seg_net, card),
            boxes=partial(segmenter.candidate_boxes, card),
            masks=partial(segmenter.hand_masks, card),
            crop=partial(keypoints.crop_hand, card, pair=pair),
            locate=partial(keypoints.locate, networks.pose_net_2d),
            read_out=partial(keypoints.read_out, card),
            lift=partial(placement.lift, networks.pose_net_3d),
            place=partial(placement.place, card.placement),
            refine=partial(placement.refine, card.placement),
            card=card,
            check=check,
            body=body,
            palms=palms,
            second=second,
        )

    def of_pair(self, pair: int) -> Stages:
        """The stages with that pair of pose networks."""
        return self if pair == 0 or self.second is None else self.second

    def keypoints(self, crops: list[HandCrop], heatmaps: np.ndarray | None = None) -> Keypoints:
        """PoseNet2D and read-out of B crops, at least one, each by the pair of networks that it was cut for; or
        read-out of known heatmaps (B, 21 + cues, M, M)."""
        pairs = np.array([crop.pair for crop in crops])
        if self.second is not None and (pairs > 0).any():
            own, others = np.flatnonzero(pairs == 0), np.flatnonzero(pairs)
            seen = self.second.keypoints([crops[i] for i in others])
            if not len(own):
                return seen
            joined = Keypoints.joined([self.keypoints([crops[i] for i in own]), seen])
            return joined.rows(np.argsort(np.concatenate([own, others])))
        maps, hand_logits = self.locate(crops) if heatmaps is None else (heatmaps, np.zeros(len(crops)))
        joints_px, joint_scores = self.read_out(maps, crops)
        return Keypoints(crops, list(maps), joints_px, joint_scores, hand_logits)

    def lifted(self, keypoints: Keypoints) -> np.ndarray:
        """Canonical joints (B, 21, 3) of B hands, each by the pair of networks that saw it."""
        second = np.flatnonzero(keypoints.pairs)
        if self.second is None or not len(second):
            return self.lift(keypoints)
        canonical = np.zeros((len(keypoints.crops), N_JOINTS, 3))
        canonical[second] = self.second.lift(keypoints.rows(second))
        if len(first := np.flatnonzero(keypoints.pairs == 0)):
            canonical[first] = self.lift(keypoints.rows(first))
        return canonical


def check_picture(image: np.ndarray, camera: PinholeCamera, hand_length_m: float | np.ndarray) -> None:
    """Refuse what cannot be computed with, and warn of what is hard to believe; messages name what was found.

    Warns:
        PlausibilityWarning: camera or hand length are those of no camera or hand (`twohands.plausibility`).

    Raises:
        InputError: image, camera and hand length do not fit together.
    """
    if not isinstance(image, np.ndarray):
        why = "; cv2.imread gives None for what it cannot read, twohands.read_image says why" if image is None else ""
        raise InputError(f"image: (H, W, 3) uint8 RGB expected, got {type(image).__name__}{why}")
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise InputError(f"image: (H, W, 3) uint8 RGB expected, got {image.shape} {image.dtype}")
    if (camera.height, camera.width) != image.shape[:2]:
        raise InputError(
            f"camera is for {camera.width}x{camera.height} but the image has {image.shape[1]}x{image.shape[0]} pixels; "
            "use camera.resized(width, height)"
        )
    lengths_m = np.asarray(hand_length_m, np.float64)
    if lengths_m.shape not in ((), (2,)) or not (np.isfinite(lengths_m) & (lengths_m > 0)).all():
        raise InputError(f"hand length must be a positive number of metres, got {hand_length_m}")
    doubts = [doubt for length in sorted(set(np.ravel(lengths_m).tolist())) for doubt in hand_length_doubts(length)]
    warn(doubts + camera_doubts(camera), stacklevel=3)
