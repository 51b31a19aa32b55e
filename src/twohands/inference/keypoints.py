"""Stages 2 and 3: crops of the hands, PoseNet2D, and 2D joints read from its heatmaps.

Source: paper section 4.2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from twohands.geometry import heatmaps as codec
from twohands.geometry.boxes import (
    apply_homography,
    box_before_camera,
    box_from_points,
    box_in_picture,
    image_from_rolled,
    mirrored_columns,
    near_picture,
    perspective_crop,
    points_from_crops,
    square_crop,
    upright_roll_deg,
)
from twohands.geometry.composition import compose_hand_input
from twohands.geometry.network_input import network_input
from twohands.geometry.rotation import rotation_about_z
from twohands.inference.weights import WeightsCard
from twohands.skeleton import N_JOINTS, RIGHT
from twohands.types import HandCrop, PinholeCamera

PoseNet2D = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True, slots=True)
class Keypoints:
    """What PoseNet2D sees in B crops; kept, chosen and exchanged together.

    Attributes:
        crops: B of them.
        heatmaps: B times (21 + cues, M, M), of which every pair of pose networks has its own M and cues.
        joints_px: (B, 21, 2) pixels of the picture.
        joint_scores: (B, 21) 0..1.
        hand_logits: (B,) log-odds that a crop shows a hand of its side.
    """

    crops: list[HandCrop]
    heatmaps: list[np.ndarray]
    joints_px: np.ndarray
    joint_scores: np.ndarray
    hand_logits: np.ndarray

    @property
    def sides(self) -> np.ndarray:
        """(B,) LEFT or RIGHT of every crop."""
        return np.array([crop.side for crop in self.crops], int)

    @property
    def pairs(self) -> np.ndarray:
        """(B,) the pair of pose networks that saw every crop."""
        return np.array([crop.pair for crop in self.crops], int)

    @property
    def placed_px(self) -> np.ndarray:
        """(B, 21, 2) joints; NaN for one that was seen where there is no pixel (`read_out`), which says nothing of
        where the hand ends."""
        return np.where(self.joint_scores[..., None] > 0, self.joints_px, np.nan)

    def rows(self, chosen: Sequence[int] | np.ndarray) -> Keypoints:
        """Some of the crops."""
        rows = np.asarray(chosen, int)
        crops, heatmaps = [self.crops[i] for i in rows], [self.heatmaps[i] for i in rows]
        return Keypoints(crops, heatmaps, *(values[rows] for values in self._arrays()))

    def replaced(self, rows: np.ndarray, other: Keypoints) -> Keypoints:
        """The same, with other crops in some rows."""
        order = np.arange(len(self.crops))
        order[rows] = len(order) + np.arange(len(rows))
        return Keypoints.joined([self, other]).rows(order)

    @staticmethod
    def joined(parts: Sequence[Keypoints]) -> Keypoints:
        """One after the other; at least one."""
        if len(parts) == 1:
            return parts[0]
        arrays = zip(*(part._arrays() for part in parts), strict=True)
        crops = [crop for part in parts for crop in part.crops]
        heatmaps = [maps for part in parts for maps in part.heatmaps]
        return Keypoints(crops, heatmaps, *(np.concatenate(each) for each in arrays))

    def corrected(self, joints_px: np.ndarray | None) -> Keypoints:
        """The same with known joints, (2, 21, 2) pixels by side, NaN where unknown, or None; they have a score of 1."""
        if joints_px is None:
            return self
        known_px = joints_px[self.sides]
        known = np.asarray(np.isfinite(known_px).all(axis=-1))
        return replace(
            self,
            joints_px=np.where(known[..., None], known_px, self.joints_px),
            joint_scores=np.where(known, 1.0, self.joint_scores),
        )

    def _arrays(self) -> tuple[np.ndarray, ...]:
        return self.joints_px, self.joint_scores, self.hand_logits


NO_KEYPOINTS: Final = Keypoints([], [], np.zeros((0, N_JOINTS, 2)), np.zeros((0, N_JOINTS)), np.zeros(0))
"""Of a picture without a candidate."""


def crop_hand(
    card: WeightsCard,
    image: np.ndarray,
    masks: np.ndarray,
    box_px: np.ndarray,
    side: int,
    camera: PinholeCamera,
    roll_deg: float = 0.0,
    *,
    pair: int = 0,
) -> HandCrop:
    """Stage 2: the hand's square picture; the rest black or dimmed, a right hand mirrored.

    Args:
        card: of the weights.
        image, masks: (H, W, 3) and (H, W), as `masks_from_logits` gives them.
        box_px: (4,) u0, v0, u1, v1, in pixels of the rolled camera.
        side: LEFT or RIGHT.
        camera: of the image.
        roll_deg: of the camera that sees the crop, about its line of sight; 0 is that of the image.
        pair: of pose networks whose card it is.

    Raises:
        InputError: there is no such crop (`perspective_crop`, `square_crop`).
    """
    size, margin = card.crop_size, card.crop_margin
    if card.crop_kind == "perspective":
        image_from_crop = perspective_crop(box_px, camera, size=size, side=side, margin=margin)
    else:
        image_from_crop = square_crop(box_px, size=size, side=side, margin=margin)
    if roll_deg:
        image_from_crop = image_from_rolled(camera, rotation_about_z(math.radians(roll_deg))) @ image_from_crop
    composed = compose_hand_input(image, masks, image_from_crop, side, size, card.background)
    return HandCrop(composed, image_from_crop, side, mirrored=side == RIGHT, roll_deg=roll_deg, pair=pair)


def cuttable(card: WeightsCard, box_px: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """An estimated box, smaller where a wide camera's crop could not show all of it (`box_before_camera`)."""
    return box_before_camera(box_px, camera) if card.crop_kind == "perspective" else box_px


def rolled_hand_box(
    card: WeightsCard, points_px: np.ndarray, image_size: tuple[int, int], camera: PinholeCamera, roll_deg: float
) -> np.ndarray:
    """Box (4,) for `crop_hand` of a hand's points (N, 2), those beyond the edge (`near_picture`) of a picture of size
    (H, W) included, as a rolled camera sees it."""
    rolled_from = np.linalg.inv(image_from_rolled(camera, rotation_about_z(math.radians(roll_deg))))
    points_px = near_picture(points_px, image_size[1], image_size[0])
    return cuttable(card, np.asarray(box_from_points(apply_homography(rolled_from, points_px))), camera)


def off_upright_deg(keypoints: Keypoints) -> np.ndarray:
    """(B,) how much further the cameras that saw B hands would have to be rolled for the fingers to point up, -180 to
    180 degrees."""
    rolled_deg = np.array([crop.roll_deg for crop in keypoints.crops])
    return np.asarray((upright_roll_deg(keypoints.joints_px) - rolled_deg + 180) % 360 - 180)


def mirror_crop(crop: HandCrop) -> HandCrop:
    """The crop as that of a hand of the other side."""
    from_mirrored = mirrored_columns(crop.image.shape[1])
    image = np.ascontiguousarray(crop.image[:, ::-1])
    from_crop = crop.image_from_crop @ from_mirrored
    side, mirrored = 1 - crop.side, not crop.mirrored
    return replace(crop, image=image, image_from_crop=from_crop, side=side, mirrored=mirrored)


def locate(network: PoseNet2D, crops: list[HandCrop]) -> tuple[np.ndarray, np.ndarray]:
    """Stage 3, PoseNet2D: both hands in one batch -> heatmaps (B, 21 + cues, M, M), hand_logit (B,): log-odds that the
    crops show hands of their side."""
    return network(network_input(np.stack([crop.image for crop in crops])))


def given_heatmaps(card: WeightsCard, heatmaps: np.ndarray, crops: list[HandCrop]) -> np.ndarray:
    """Known maps (2, 21, M, M) by side as PoseNet2D would give them for crops, (B, 21 + cues, M, M); the cues are 0."""
    return np.pad(heatmaps[[crop.side for crop in crops]], ((0, 0), (0, card.cues), (0, 0), (0, 0)))


def read_out(card: WeightsCard, heatmaps: np.ndarray, crops: list[HandCrop]) -> tuple[np.ndarray, np.ndarray]:
    """Heatmaps -> joints (B, 21, 2) in pixels of the picture, un-mirrored, and scores (B, 21) 0..1: 0 where the crop of
    a wide camera shows what has no pixel (`points_from_crops`)."""
    cells, scores = read_joints(heatmaps[:, :N_JOINTS], card.heatmap_decode)
    crop_px = cells * (card.seen_size / heatmaps.shape[-1]) + card.surround
    image_from_crop = np.stack([crop.image_from_crop for crop in crops])
    joints_px, found = points_from_crops(image_from_crop, crop_px, card.crop_size)
    return joints_px, np.where(found, scores, 0.0)


def read_joints(maps: np.ndarray, decoder: str) -> tuple[np.ndarray, np.ndarray]:
    """Read one joint from every heatmap.

    Args:
        maps: (..., 21, M, M), not negative where it matters.
        decoder: "subpixel" for maps with linear output: a parabola through the logarithm about the peak, exact for a
            Gaussian of any width; the score is the peak's value. "softargmax" for probability maps: the mean within
            a window round the peak; the score is the share of the map's mass inside that window.

    Returns:
        (..., 21, 2) u, v in map cells, (0, 0) the outer corner, and (..., 21) scores 0..1.

    Source: ours; the paper does not say how it reads its maps (docs/paper-map.md).
    """
    if decoder == "subpixel":
        joints, peaks = codec.decode_subpixel(maps)
        return joints, np.clip(peaks, 0.0, 1.0)
    return codec.decode_windowed(np.asarray(maps, np.float64))


def joint_boxes(
    joints_px: np.ndarray, image_size: tuple[int, int], otherwise_px: np.ndarray, smallest_px: float
) -> np.ndarray:
    """Tight boxes of hands' joints, those beyond the picture's edge (`near_picture`) included.

    Args:
        joints_px: (B, 21, 2) pixels.
        image_size: (H, W) of the picture.
        otherwise_px: (B, 4) u0, v0, u1, v1 for hands whose joints span less than `smallest_px` of the picture.
        smallest_px: `ViewConfig.smallest_box_px`.

    Returns:
        (B, 4) u0, v0, u1, v1.
    """
    seen = in_sight(joints_px, image_size, smallest_px)
    boxes_px = np.asarray(box_from_points(near_picture(joints_px, image_size[1], image_size[0])))
    return np.where(seen[:, None], boxes_px, otherwise_px)


def in_sight(joints_px: np.ndarray, image_size: tuple[int, int], smallest_px: float) -> np.ndarray:
    """(B,) bool: whether the joints (B, 21, 2) of a hand span `smallest_px` or more of a picture of size (H, W)."""
    boxes_px = np.asarray(box_in_picture(joints_px, image_size[1], image_size[0]))
    return np.asarray((boxes_px[:, 2:] - boxes_px[:, :2]).min(axis=1) >= smallest_px)
