"""The whole pipeline on one page: segment -> boxes -> crops -> 2D -> 3D -> camera space.

Source: paper, figure 3 and section 4. Every stage can be replaced by ground truth (`StageTruth`); that is how each
stage is studied alone and how the error budget is drawn up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np

from twohands.errors import InputError
from twohands.geometry.boxes import (
    box_before_camera,
    box_iou,
    image_from_rolled,
    perspective_crop,
    points_from_crops,
    rolled_box,
    square_crop,
)
from twohands.geometry.camera import unproject
from twohands.geometry.canonical import camera_from_canonical, unrolled_canonical
from twohands.geometry.composition import compose_hand_input
from twohands.geometry.projection import drawn_to_rays, project_global, range_weights
from twohands.geometry.rotation import rotation_about_z
from twohands.geometry.segmentation import (
    PRESENCE_THRESHOLD,
    HandBoxes,
    as_one_hand,
    boxes_from_energy,
    certain_masks,
    hand_scores,
    letterbox,
    log_odds,
    masks_from_logits,
    mean_of_looks,
    network_input,
    probability,
    unmirrored,
)
from twohands.inference.engine import Networks, load_networks
from twohands.inference.looks import Look, agreement, geometric_median, in_sight, joint_boxes, mirror_crop
from twohands.inference.range_prior import likely_ranges
from twohands.inference.read_out import read_joints
from twohands.inference.sides import (
    APART,
    CANDIDATE_THRESHOLD,
    ONE_PLACE,
    REMEMBERED_THRESHOLD,
    TURN_BELOW,
    assign_sides,
    corrected_masks,
    last_word,
    palms_apart,
)
from twohands.inference.weights import DEFAULT_PRESET, PictureLook, WeightsCard, preset_folder, read_card
from twohands.skeleton import LEFT, N_JOINTS, RIGHT, ROOT
from twohands.types import GlobalPose, HandCrop, HandPose, PinholeCamera, TwoHandPose

DEFAULT_HAND_LENGTH_M = 0.10
"""|wrist - middle knuckle| where none is given: the unit to which the paper scales its data (SPEC 1.1)."""
KEY_BONE_NAMES = ("wrist", "little")
SECOND_LOOK_IOU = 0.65
"""PoseNet2D looks again where HandSegNet's box and that of the joints found in it overlap less, into the latter.

Ours; the paper looks once. It concerns a fifth of the hands. With earlier weights, on 160 test images, it brought the
root's direction from 92 % within 1.5 degrees to 94 %, and the mean camera-space error from 18.4 to 17.5 mm; a second
look at all hands gives no more.
"""
RAY_SHARE = 0.5
"""How far the joints are drawn to the lines of sight on which PoseNet2D sees them (`drawn_to_rays`), times their score.

Ours; the paper uses the 2D joints for the root's place alone. With earlier weights, on 1,000 test images, it brought
the mean camera-space error from 16.8 to 16.1 mm and the canonical AUC from .947 to .952; more brings little, and bones
of wrong length.
"""
METHOD: Final = "fitted"


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


NO_TRUTH = StageTruth()


class HandEstimator:
    """Both hands in metres from one picture.

    Args:
        networks: the three networks as functions.
        card: what they expect.
    """

    def __init__(self, networks: Networks, card: WeightsCard) -> None:
        self.networks = networks
        self.card = card
        self.threshold = CANDIDATE_THRESHOLD if card.judge else PRESENCE_THRESHOLD
        self.second_look_iou = SECOND_LOOK_IOU
        self.ray_share = RAY_SHARE

    @classmethod
    def from_preset(cls, preset: str | Path = DEFAULT_PRESET, threads: int = 0) -> HandEstimator:
        """Load shipped weights by name, or a folder with the same layout.

        Args:
            preset: name or folder.
            threads: CPU threads of the networks; 0 takes all cores.

        Raises:
            CheckpointError: the weights are missing, damaged, or of other networks.
        """
        folder = preset_folder(preset)
        card = read_card(folder)
        return cls(load_networks(folder, card, threads), card)

    def estimate(
        self,
        image: np.ndarray,
        camera: PinholeCamera,
        hand_length_m: float | np.ndarray = DEFAULT_HAND_LENGTH_M,
        truth: StageTruth = NO_TRUTH,
        *,
        index: int = 0,
        time_s: float | None = None,
        previous: TwoHandPose | None = None,
    ) -> TwoHandPose:
        """Estimate both hands.

        Args:
            image: (H, W, 3) uint8 RGB.
            camera: intrinsics at this image size.
            hand_length_m: |wrist - middle knuckle| of these hands, metres, or (2,) one for each. All lengths scale
                with it.
            truth: ground truth that replaces stages.
            index, time_s: position in the source, handed through.
            previous: of a video, what was found one frame before: hands seldom come or go. Only that they were there
                counts; it needs weights with a judge.

        Returns:
            Both hands; an absent hand has `present` False.

        Raises:
            InputError: image, camera and hand length do not fit together.
        """
        _check(image, camera, hand_length_m)
        remembered = None if previous is None else np.array([hand.present for hand in previous.hands])
        masks, boxes = self.segment(image, truth, remembered)
        hands = [HandPose(present=False), HandPose(present=False)]
        if boxes.present.any():
            masks, boxes, look = self.find_joints(image, masks, boxes, camera, truth, remembered)
        if boxes.present.any():
            sides = look.sides
            canonical = self.lift(look, truth)
            lengths_m = np.broadcast_to(hand_length_m, (2,))[sides]
            estimated = truth.heatmaps is None and truth.joints_px is None and truth.canonical is None
            if estimated and self.card.rolls_deg:
                look, canonical = self.look_around(image, masks, look, canonical, camera)
                if truth.boxes_px is None:
                    boxes.boxes_px[sides] = joint_boxes(look.joints_px, image.shape[:2], boxes.boxes_px[sides])
            pose = self.place(canonical, look.joints_px, look.joint_scores, camera, lengths_m)
            if estimated:
                share = self.ray_share * look.joint_scores
                canonical = drawn_to_rays(canonical, look.joints_px, camera, lengths_m, pose, share)
                radius_m = pose.radius_m
                if self.card.range_errors is not None:
                    radius_m = likely_ranges(radius_m, look.joint_scores, self.card.range_errors)
                joints_m = camera_from_canonical(canonical, lengths_m, radius_m, pose.theta, pose.phi)
                finite = np.isfinite(joints_m).all(axis=(1, 2))
                pose = replace(pose, joints_m=joints_m, radius_m=radius_m, valid=pose.valid & finite)
            for i, side in enumerate(sides):
                hands[side] = _hand_pose(boxes, look, canonical[i], pose, i)
        return TwoHandPose(hands[0], hands[1], camera, certain_masks(masks), index, time_s)

    def segment(
        self, image: np.ndarray, truth: StageTruth = NO_TRUTH, remembered: np.ndarray | None = None
    ) -> tuple[np.ndarray, HandBoxes]:
        """Stage 1, HandSegNet: whose pixel is it, where are the hands, are they there.

        Args:
            image: (H, W, 3).
            truth: what replaces stages.
            remembered: (2,) bool, see `assign_sides`.

        Returns:
            (H, W) masks as `masks_from_logits` gives them, and the boxes.
        """
        size = image.shape[:2]
        masks, boxes = truth.masks, _true_boxes(truth)
        if masks is None or boxes is None:
            seg_logits, energies, scores = self.hand_maps(image)
            if boxes is None:
                threshold: float | np.ndarray = self.threshold
                if self.card.judge and remembered is not None:
                    threshold = np.where(remembered, REMEMBERED_THRESHOLD, threshold)
                boxes = boxes_from_energy(energies, size, scores, truth.present, threshold)
            if masks is None:
                masks = masks_from_logits(seg_logits, size, boxes.present)
        return masks, boxes

    def hand_maps(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """HandSegNet: seg_logits (3, h, w) and energies (2, h, w), 0..1, over the whole picture and nothing else, and
        `hand_scores` (2,) of them; from the mean of all looks where the first leaves a doubt."""

        fitted = cache(lambda size: letterbox(image, size))

        def look(how: PictureLook) -> tuple[np.ndarray, np.ndarray]:
            canvas, place = fitted(how.size)
            picture = canvas[:, ::-1] if how.mirrored else canvas
            seg_logits, energy_logits = (maps[0] for maps in self.networks.hand_seg_net(network_input(picture[None])))
            if how.mirrored:
                seg_logits, energy_logits = unmirrored(seg_logits, energy_logits)
            return place.content(seg_logits), place.content(energy_logits)

        def scored(maps: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            seg_logits, energies = maps[0], probability(maps[1])
            return seg_logits, energies, hand_scores(energies, seg_logits)

        first = look(PictureLook(self.card.seg_input_size))
        seg_logits, energies, scores = scored(first)
        low, high = self.card.doubt
        if self.card.further_looks and ((scores > low) & (scores < high)).any():
            return scored(mean_of_looks([first, *map(look, self.card.further_looks)]))
        return seg_logits, energies, scores

    def find_joints(
        self,
        image: np.ndarray,
        masks: np.ndarray,
        boxes: HandBoxes,
        camera: PinholeCamera,
        truth: StageTruth = NO_TRUTH,
        remembered: np.ndarray | None = None,
    ) -> tuple[np.ndarray, HandBoxes, Look]:
        """Stages 2 and 3: look at every box, decide whose hands they are (`inference.sides`), look again where it
        helps (`SECOND_LOOK_IOU`), and drop what is no hand after all. With true boxes, maps or joints it looks just
        once, with a true `present` it does not decide.

        Args:
            image, masks: (H, W, 3) and (H, W).
            boxes: estimated or true ones.
            camera: of the image.
            truth: what replaces stages.
            remembered: (2,) bool, see `assign_sides`.

        Returns:
            Masks and boxes as they came, or corrected; and the last look at every hand.
        """
        look = self.look(image, masks, boxes.boxes_px, np.flatnonzero(boxes.present), camera, truth)
        if truth.boxes_px is not None or truth.heatmaps is not None or truth.joints_px is not None:
            return masks, boxes, look
        again = np.zeros(len(look.sides), bool)
        judged = self.card.judge and truth.present is None
        if judged:
            source, scores, look = self.judge(image, masks, boxes, look, camera, remembered)
            corrected, boxes = _answered(masks, boxes, source, scores, truth)
            again = (source[look.sides] != look.sides) | (corrected is not masks)
            masks = corrected
            if not len(look.sides):
                return masks, boxes, look
        first_logits, boxes_px = look.hand_logits, boxes.boxes_px[look.sides]
        found_px = joint_boxes(look.joints_px, image.shape[:2], boxes_px)
        again |= box_iou(boxes_px, found_px) < self.second_look_iou
        boxes.boxes_px[look.sides] = found_px
        if again.any():
            second = self.look(image, masks, boxes.boxes_px, look.sides[again], camera)
            look = look.replaced(np.flatnonzero(again), second)
            boxes.boxes_px[look.sides] = joint_boxes(look.joints_px, image.shape[:2], boxes_px)
        if judged:
            answer = log_odds(boxes.scores[look.sides])
            answer = last_word(answer, first_logits, look.hand_logits, look.joint_scores)
            boxes.scores[look.sides] = probability(answer)
            if (answer <= 0).any():
                look = look.rows(np.flatnonzero(answer > 0))
                source = np.where(np.isin([LEFT, RIGHT], look.sides), [LEFT, RIGHT], -1)
                masks, boxes = _answered(masks, boxes, source, boxes.scores, truth)
        return masks, boxes, look

    def look(
        self,
        image: np.ndarray,
        masks: np.ndarray,
        boxes_px: np.ndarray,
        sides: np.ndarray,
        camera: PinholeCamera,
        truth: StageTruth = NO_TRUTH,
    ) -> Look:
        """Crop, PoseNet2D and read-out of the given sides' boxes, boxes_px (2, 4), true or estimated ones."""
        chosen = boxes_px[sides]
        if truth.boxes_px is None:
            chosen = [self.cuttable(box, camera) for box in chosen]
        hands = zip(chosen, sides, strict=True)
        return self.look_at([self.crop(image, masks, box, int(side), camera) for box, side in hands], truth)

    def look_at(self, crops: list[HandCrop], truth: StageTruth = NO_TRUTH) -> Look:
        """PoseNet2D and read-out of crops."""
        heatmaps, hand_logits = self.locate(crops, truth)
        joints_px, joint_scores = self.read_out(heatmaps, crops, truth)
        return Look(crops, heatmaps, joints_px, joint_scores, hand_logits)

    def judge(
        self,
        image: np.ndarray,
        masks: np.ndarray,
        boxes: HandBoxes,
        look: Look,
        camera: PinholeCamera,
        remembered: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, Look]:
        """Which candidate is which hand.

        Args:
            image, masks, camera: of the picture.
            boxes: the candidates, with HandSegNet's scores of both sides.
            look: at the candidates.
            remembered: (2,) bool, see `assign_sides`.

        Returns:
            source (2,) as `assign_sides` gives it; scores (2,) 0..1, HandSegNet's for absent hands; and the look at the
            hands that remain, in the order LEFT, RIGHT.
        """
        own, turned = np.full((2, 2), np.nan)
        own[look.sides] = look.hand_logits
        looks = {(side, side): look.rows([i]) for i, side in enumerate(look.sides)}
        if (look.hand_logits < TURN_BELOW).any():  # of two, both: they may have been exchanged
            mirrored = self.look_at([mirror_crop(crop) for crop in look.crops])
            turned[look.sides] = mirrored.hand_logits
            looks |= {(1 - side, side): mirrored.rows([i]) for i, side in enumerate(look.sides)}
        whole = None
        distance = palms_apart(look.joints_px, boxes.boxes_px) if len(look.sides) == 2 else math.inf
        if distance < ONE_PLACE:
            either = [as_one_hand(masks, boxes.boxes_px, side) for side in (LEFT, RIGHT)]
            alone = self.look_at(
                [
                    self.crop(image, whole_mask, self.cuttable(box, camera), side, camera)
                    for side, (whole_mask, box) in enumerate(either)
                ]
            )
            whole = alone.hand_logits
        source, answer = assign_sides(
            boxes.scores, own, turned, whole=whole, apart=distance >= APART, remembered=remembered
        )
        if whole is not None and (source >= 0).sum() == 1:
            looks |= {(side, side): alone.rows([side]) for side in (LEFT, RIGHT)}
        scores = np.where(source >= 0, probability(np.nan_to_num(answer)), boxes.scores)
        remaining = [looks[side, source[side]] for side in np.flatnonzero(source >= 0)]
        return source, scores, Look.joined(remaining) if remaining else look.rows([])

    def look_around(
        self, image: np.ndarray, masks: np.ndarray, look: Look, canonical: np.ndarray, camera: PinholeCamera
    ) -> tuple[Look, np.ndarray]:
        """Looks at every hand again, as cameras rolled by `card.rolls_deg` see it; all looks count alike.

        Ours. What is learnt from rolled hands is not the same for every roll; the errors of such looks differ, and now
        and then a look takes one finger for another, so that the joints are in the looks' median.

        Args:
            image, masks, camera: of the picture.
            look: at B hands, to be kept but for joints and scores.
            canonical: (B, 21, 3), from that look.

        Returns:
            The look with the geometric median of the joints, scores that are the geometric mean of the joints' mean
            scores and of how well the looks agree (`looks.agreement`), and the mean canonical pose.
        """
        rows = np.flatnonzero(in_sight(look.joints_px, image.shape[:2]))
        if not len(rows):
            return look, canonical
        first = look.rows(rows)
        first_rays = unproject(first.joints_px[:, ROOT], camera)  # beside the picture a lens may have none
        pinhole_rays = unproject(first.joints_px[:, ROOT], replace(camera, distortion=()))
        first_rays = np.where(np.isfinite(first_rays), first_rays, pinhole_rays)
        looks, poses = [first], [canonical[rows]]
        for degrees in self.card.rolls_deg:
            roll = rotation_about_z(math.radians(degrees))
            unrolled = image_from_rolled(camera, roll)
            hands = zip(rolled_box(first.joints_px, image.shape[:2], unrolled), first.sides, strict=True)
            crops = [
                self.crop(image, masks, self.cuttable(box, camera), int(side), camera, unrolled) for box, side in hands
            ]
            again = self.look_at(crops)
            rays = unproject(again.joints_px[:, ROOT], camera)
            rays = np.where(np.isfinite(rays), rays, first_rays)
            looks.append(again)
            poses.append(unrolled_canonical(self.lift(again), rays, roll))
        joints_px, joint_scores, canonical = look.joints_px.copy(), look.joint_scores.copy(), canonical.copy()
        seen_px = np.array([each.joints_px for each in looks])
        joints_px[rows] = geometric_median(seen_px)
        agreed = agreement(seen_px, joints_px[rows])
        joint_scores[rows] = np.sqrt(np.mean([each.joint_scores for each in looks], axis=0) * agreed)
        canonical[rows] = np.mean(poses, axis=0)
        return replace(look, joints_px=joints_px, joint_scores=joint_scores), canonical

    def crop(
        self,
        image: np.ndarray,
        masks: np.ndarray,
        box_px: np.ndarray,
        side: int,
        camera: PinholeCamera,
        image_from_boxed: np.ndarray | None = None,
    ) -> HandCrop:
        """Stage 2: the hand's square picture; the rest black or dimmed, a right hand mirrored.

        `image_from_boxed`, (3, 3), leads to pixels of the picture where the box is given in those of a rolled camera.
        """
        size, margin = self.card.crop_size, self.card.crop_margin
        if self.card.crop_kind == "perspective":
            image_from_crop = perspective_crop(box_px, camera, size=size, side=side, margin=margin)
        else:
            image_from_crop = square_crop(box_px, size=size, side=side, margin=margin)
        if image_from_boxed is not None:
            image_from_crop = image_from_boxed @ image_from_crop
        composed = compose_hand_input(image, masks, image_from_crop, side, size, self.card.background)
        return HandCrop(composed, image_from_crop, side, mirrored=side == RIGHT)

    def cuttable(self, box_px: np.ndarray, camera: PinholeCamera) -> np.ndarray:
        """An estimated box, smaller where a wide camera's crop could not show all of it (`box_before_camera`)."""
        return box_before_camera(box_px, camera) if self.card.crop_kind == "perspective" else box_px

    def locate(self, crops: list[HandCrop], truth: StageTruth = NO_TRUTH) -> tuple[np.ndarray, np.ndarray]:
        """Stage 3, PoseNet2D: both hands in one batch -> heatmaps (B, 21 + cues, M, M), log-odds (B,) that they are
        hands."""
        if truth.heatmaps is not None:
            maps = truth.heatmaps[[crop.side for crop in crops]]
            return np.pad(maps, ((0, 0), (0, self.card.cues), (0, 0), (0, 0))), np.zeros(len(crops))
        return self.networks.pose_net_2d(network_input(np.stack([crop.image for crop in crops])))

    def read_out(
        self, heatmaps: np.ndarray, crops: list[HandCrop], truth: StageTruth = NO_TRUTH
    ) -> tuple[np.ndarray, np.ndarray]:
        """Heatmaps -> joints (B, 21, 2) in pixels of the picture, un-mirrored, and scores (B, 21): 1 for labels, which
        replace what they know; 0 where the crop of a wide camera shows what has no pixel (`points_from_crops`)."""
        cells, scores = read_joints(heatmaps[:, :N_JOINTS], self.card.heatmap_decode)
        crop_px = cells * (self.card.crop_size / heatmaps.shape[-1])
        image_from_crop = np.stack([crop.image_from_crop for crop in crops])
        joints_px, found = points_from_crops(image_from_crop, crop_px, self.card.crop_size)
        scores = np.where(found, scores, 0.0)
        if truth.joints_px is not None:
            true_px = truth.joints_px[[crop.side for crop in crops]]
            known = np.asarray(np.isfinite(true_px).all(axis=-1))
            joints_px, scores = np.where(known[..., None], true_px, joints_px), np.where(known, 1.0, scores)
        return joints_px, scores

    def lift(self, look: Look, truth: StageTruth = NO_TRUTH) -> np.ndarray:
        """Stage 4, PoseNet3D: heatmaps -> canonical joints (B, 21, 3) of the real, unmirrored hands."""
        if truth.canonical is not None:
            return truth.canonical[look.sides]
        unmirror = np.array([[-1.0 if crop.mirrored else 1.0, 1.0, 1.0] for crop in look.crops])
        return self.networks.pose_net_3d(look.heatmaps).astype(np.float64) * unmirror[:, None, :]

    def place(
        self,
        canonical: np.ndarray,
        joints_px: np.ndarray,
        joint_scores: np.ndarray,
        camera: PinholeCamera,
        lengths_m: np.ndarray,
    ) -> GlobalPose:
        """Stage 5: canonical joints (B, 21, 3) and joints in pixels (B, 21, 2) -> metres in camera space.

        A joint that was found so far outside the picture that the lens's model has no line of sight there does not
        count.
        """
        seen = np.isfinite(unproject(joints_px, camera)).all(axis=-1)  # (B, 21)
        weights = np.where(seen, range_weights(joint_scores), 0.0)
        return project_global(canonical, joints_px, camera, lengths_m, method=METHOD, weights=weights)


def _check(image: np.ndarray, camera: PinholeCamera, hand_length_m: float | np.ndarray) -> None:
    """Refuse what cannot be computed with; messages name what was found."""
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


def _answered(
    masks: np.ndarray, boxes: HandBoxes, source: np.ndarray, scores: np.ndarray, truth: StageTruth
) -> tuple[np.ndarray, HandBoxes]:
    """Masks, true ones as they are, and boxes that agree with an answer of `assign_sides`."""
    if truth.masks is None:
        masks = corrected_masks(masks, source, boxes.boxes_px)
    boxes_px = np.where((source >= 0)[:, None], boxes.boxes_px[source], np.nan)
    return masks, HandBoxes(boxes_px, source >= 0, scores)


def _true_boxes(truth: StageTruth) -> HandBoxes | None:
    """Boxes given by ground truth; a hand is present where its box is finite, unless `truth.present` denies it."""
    if truth.boxes_px is None:
        return None
    known = np.asarray(np.isfinite(truth.boxes_px).all(axis=1))
    present = known if truth.present is None else np.logical_and(known, truth.present)
    return HandBoxes(np.asarray(truth.boxes_px, np.float64), present, np.where(present, 1.0, 0.0))


def _hand_pose(boxes: HandBoxes, look: Look, canonical: np.ndarray, pose: GlobalPose, i: int) -> HandPose:
    """Gather one hand's results, row i of the batch."""
    side, valid = look.crops[i].side, bool(pose.valid[i])
    return HandPose(
        present=True,
        score=float(boxes.scores[side]),
        box_px=boxes.boxes_px[side],
        joints_px=look.joints_px[i],
        joint_scores=look.joint_scores[i],
        canonical=canonical,
        joints_m=np.asarray(pose.joints_m[i]) if valid else None,
        range_m=float(pose.radius_m[i]) if valid else None,
        theta_deg=_degrees(pose.theta[i]),
        phi_deg=_degrees(pose.phi[i]),
        key_bone=KEY_BONE_NAMES[int(pose.key_bone[i])],
        method=METHOD,
        valid=valid,
    )


def _degrees(angle: float) -> float | None:
    """Radians in degrees; None where unknown."""
    return math.degrees(angle) if math.isfinite(angle) else None
