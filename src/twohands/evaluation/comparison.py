"""Predictions beside labels: every error of every hand, gathered once, from which all tables and curves are made.

Arrays are (N images, 2 sides (LEFT, RIGHT), ...). Errors follow `metrics`: NaN does not count, infinite is a miss.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from pathlib import PurePosixPath
from typing import Final

import numpy as np

from twohands.errors import DataFormatError, InputError
from twohands.evaluation import metrics as m
from twohands.evaluation.predictions import Fingerprint, Predictions
from twohands.geometry.boxes import box_in_picture, box_iou
from twohands.geometry.canonical import cartesian_alignment, spherical_alignment
from twohands.geometry.part_labels import hand_classes, visible_share
from twohands.skeleton import LEFT, RIGHT, ROOT, WRIST
from twohands.types import HandSample

REFERENCE_WIDTH_PX: Final = 480
"""2D errors are multiplied by 480 / image width (paper, figure 7: "using image size of (270x480)")."""


@dataclass(frozen=True, slots=True)
class Protocol:
    """What counts, where data sets and published protocols differ (docs/evaluation.md, *Rules*).

    Raises:
        InputError: fps is not above 0, or not finite.
    """

    visible_only: bool = False
    "Joint errors run over the joints that the labels call visible; errors of the root joint do not."
    all_hands_labelled: bool = True
    "Whether a hand without label is a hand that is not there; if not, finding one is neither right nor wrong."
    fps: float | None = None
    "Samples of one folder are consecutive frames at so many a second; None for single pictures."

    def __post_init__(self) -> None:
        if self.fps is not None and not 0 < self.fps < math.inf:
            raise InputError(f"frames a second must be a number above 0, got {self.fps}")


DEFAULT_PROTOCOL: Final = Protocol()


@dataclass(frozen=True, slots=True)
class Comparison:
    """All errors of one predictions file.

    Attributes:
        sources: (N,) names of the samples.
        present, found, valid: (N, 2) bool, labelled as present, predicted as present, predicted with a usable range.
        judged: (N, 2) bool, hands whose presence can be right or wrong.
        boxed: (N, 2) bool, those of them whose box can be: absent, or labelled whole and partly in the picture.
        range_m: (N, 2) true distance of the root joint; NaN where unknown.
        overlap: (N, 2) share of the box of the hand's labelled joints that the other hand's covers, 0..1; NaN where
            unknown.
        visible_share: (N, 2) share of the hand's joints in view (`part_labels.visible_share`); NaN where unknown.
        box_iou: (N, 2) overlap of predicted box and that of the labelled joints; NaN without either.
        joints_px: (N, 2, 21) 2D error, pixels at a width of 480.
        spherical_mm, cartesian_mm: (N, 2, 21) error of the canonical pose at the true hand length, by alignment; NaN
            where that length is unknown.
        procrustes_mm: (N, 2, 21) the same after the best similarity transform.
        bones_mm: (N, 2, 20) bone length errors of the canonical pose at the true hand length; NaN as above.
        camera_mm: (N, 2, 21) error in camera space without any alignment.
        root: (N, 2, 5) of `metrics.spherical_errors`: theta, phi, direction in degrees, range in m, range / true range.
        relative_root_mm: (N,) error of the vector between the hands.
        acceleration: (N, 2, 2) tangential and radial error of the root joint's acceleration, m/s^2; NaN but in video.
        intersections, unions: (K, 3) pixels of the K images with masks on both sides (`metrics.class_overlaps`).
    """

    sources: tuple[str, ...]
    present: m.BoolArray
    found: m.BoolArray
    valid: m.BoolArray
    judged: m.BoolArray
    boxed: m.BoolArray
    range_m: m.FloatArray
    overlap: m.FloatArray
    visible_share: m.FloatArray
    box_iou: m.FloatArray
    joints_px: m.FloatArray
    spherical_mm: m.FloatArray
    cartesian_mm: m.FloatArray
    procrustes_mm: m.FloatArray
    bones_mm: m.FloatArray
    camera_mm: m.FloatArray
    root: m.FloatArray
    relative_root_mm: m.FloatArray
    acceleration: m.FloatArray
    intersections: m.FloatArray
    unions: m.FloatArray

    def __len__(self) -> int:
        return len(self.sources)

    def of_hands(self, keep: m.BoolArray) -> Comparison:
        """The same with every other hand's errors unknown.

        Args:
            keep: (N, 2) bool.

        Returns:
            A comparison of equal length. What belongs to whole images (masks, the vector between the hands) is empty.
        """
        errors = {
            field.name: np.where(np.expand_dims(keep, tuple(range(2, values.ndim))), values, np.nan)
            for field in fields(self)
            if field.name not in _NOT_BY_HAND
            for values in [getattr(self, field.name)]
        }
        return replace(
            self,
            present=self.present & keep,
            found=self.found & keep,
            valid=self.valid & keep,
            judged=self.judged & keep,
            boxed=self.boxed & keep,
            relative_root_mm=np.full(len(self), np.nan),
            intersections=np.empty((0, 3)),
            unions=np.empty((0, 3)),
            **errors,
        )


_NOT_BY_HAND: Final = (
    "sources",
    "present",
    "found",
    "valid",
    "judged",
    "boxed",
    "relative_root_mm",
    "intersections",
    "unions",
)


def compare(
    predictions: Predictions, samples: Iterable[HandSample], protocol: Protocol = DEFAULT_PROTOCOL
) -> Comparison:
    """Sets predictions against the labels they were made for.

    Args:
        predictions: N images.
        samples: the same N labelled images in the same order; further ones are not read.
        protocol: what counts.

    Returns:
        All errors.

    Raises:
        InputError: the samples are not those of the predictions.
        DataFormatError: a mask does not have its picture's size.
    """
    truth = _Labels(predictions)
    fingerprint = Fingerprint()
    reader = iter(samples)
    for index, source in enumerate(predictions.sources):
        sample = next(reader, None)
        if sample is None or sample.source != source:
            found = "the end of the dataset" if sample is None else f"'{sample.source}'"
            raise InputError(
                f"predictions belong to other data: expected '{source}' at position {index}, found {found}"
            )
        fingerprint.add(sample)
        truth.add(index, sample)
    if str(fingerprint) != predictions.dataset_id:
        raise InputError(
            f"predictions belong to other data: they were made for labels {predictions.dataset_id} of "
            f"'{predictions.dataset}', these labels are {fingerprint}"
        )
    return _comparison(predictions, truth, protocol)


class _Labels:
    """Labels of all samples as arrays (N, 2, ...), and mask overlaps, gathered one sample at a time."""

    def __init__(self, predictions: Predictions) -> None:
        self._predictions = predictions
        count = len(predictions)
        self.present = np.zeros((count, 2), np.bool_)
        self.whole = np.zeros((count, 2), np.bool_)  # every joint labelled
        self.visible = np.ones((count, 2, 21), np.bool_)
        self.scale_2d = np.ones(count)
        self.joints_px = np.full((count, 2, 21, 2), np.nan)
        self.boxes_px = np.full((count, 2, 4), np.nan)
        self.sizes_px = np.zeros((count, 2))  # width, height
        self.joints_m = np.full((count, 2, 21, 3), np.nan)
        self.visible_share = np.full((count, 2), np.nan)
        self.overlaps: list[tuple[m.FloatArray, m.FloatArray]] = []

    def add(self, index: int, sample: HandSample) -> None:
        self.present[index] = sample.present
        self.scale_2d[index] = REFERENCE_WIDTH_PX / sample.camera.width
        self.sizes_px[index] = sample.camera.width, sample.camera.height
        known = sample.valid & sample.present[:, None]  # (2, 21)
        self.joints_px[index] = np.where(known[..., None], sample.joints_px, np.nan)
        self.whole[index] = np.isfinite(self.joints_px[index]).all(axis=(1, 2))
        boxes_px = box_in_picture(self.joints_px[index], sample.camera.width, sample.camera.height)
        self.boxes_px[index] = np.asarray(boxes_px)
        self.joints_m[index] = np.where(known[..., None], sample.joints_m, np.nan)
        if sample.visible is not None:
            self.visible[index] = sample.visible
        for side in np.flatnonzero(sample.present).tolist():
            self.visible_share[index, side] = visible_share(self.joints_px[index, side], sample.labels, side)
        mask = self._predictions.mask(index)
        if sample.labels is not None and mask is not None:
            if mask.shape != sample.labels.shape:
                raise DataFormatError(f"{sample.source}: mask {mask.shape} and labels {sample.labels.shape} differ")
            self.overlaps.append(m.class_overlaps(mask, hand_classes(sample.labels)))


def _comparison(predictions: Predictions, truth: _Labels, protocol: Protocol) -> Comparison:
    found = predictions.present
    valid = found & predictions.valid
    counted = truth.visible if protocol.visible_only else np.ones_like(truth.visible)  # (N, 2, 21)

    def joints(errors: m.FloatArray) -> m.FloatArray:
        return np.where(counted, errors, np.nan)

    scale = truth.scale_2d[:, None, None, None]
    length = np.linalg.norm(truth.joints_m[..., WRIST, :] - truth.joints_m[..., ROOT, :], axis=-1)  # (N, 2)
    scaled_mm = 1e3 * length[..., None, None] * predictions.canonical
    true_mm = 1e3 * truth.joints_m
    sized_mm = np.where(np.isfinite(length)[..., None, None], true_mm, np.nan)  # no length, no canonical pose in mm
    true_roots, roots = truth.joints_m[:, :, ROOT], predictions.joints_m[:, :, ROOT]
    spherical_mm, cartesian_mm = (
        joints(
            by_hand(
                m.endpoint_errors,
                1e3 * np.asarray(align(predictions.canonical, length, truth.joints_m)),
                sized_mm,
                found,
            )
        )
        for align in (spherical_alignment, cartesian_alignment)
    )
    judged = truth.present | protocol.all_hands_labelled
    overlap = covered_share(truth.boxes_px)
    limits_px = np.tile(truth.sizes_px[:, None], 2)  # (N, 1, 4)
    within_picture = np.minimum(np.maximum(predictions.box_px.astype(np.float64), 0.0), limits_px)
    pairs = [np.array(arrays) for arrays in zip(*truth.overlaps, strict=True)] or [np.empty((0, 3))] * 2
    return Comparison(
        sources=predictions.sources,
        present=truth.present,
        found=found,
        valid=valid,
        judged=judged,
        boxed=judged & (~truth.present | (truth.whole & ~np.isnan(overlap))),
        range_m=np.linalg.norm(true_roots, axis=-1),
        overlap=overlap,
        visible_share=truth.visible_share,
        box_iou=np.asarray(box_iou(within_picture, truth.boxes_px)),
        joints_px=joints(by_hand(m.endpoint_errors, predictions.joints_px * scale, truth.joints_px * scale, found)),
        spherical_mm=spherical_mm,
        cartesian_mm=cartesian_mm,
        procrustes_mm=joints(by_hand(m.procrustes_errors, scaled_mm, true_mm, found)),
        bones_mm=by_hand(m.bone_length_errors, scaled_mm, sized_mm, found),
        camera_mm=joints(by_hand(m.endpoint_errors, 1e3 * predictions.joints_m, true_mm, valid)),
        root=by_hand(m.spherical_errors, roots, true_roots, valid),
        relative_root_mm=1e3 * m.relative_root_errors(roots, true_roots, valid),
        acceleration=_accelerations(
            predictions.sources, np.where(valid[..., None], roots, np.nan), true_roots, protocol
        ),
        intersections=pairs[0],
        unions=pairs[1],
    )


def without_picture(sample: HandSample) -> HandSample:
    """The labels of a sample that are kept when it is scored several times; picture, masks and depth are dropped."""
    return replace(sample, image=np.zeros((1, 1, 3), np.uint8), labels=None, depth_m=None)


def by_hand(
    errors: Callable[[m.FloatArray, m.FloatArray, m.BoolArray], m.FloatArray],
    predicted: m.FloatArray,
    truth: m.FloatArray,
    found: m.BoolArray,
) -> m.FloatArray:
    """Applies a metric on (M, ...) hands to (N, 2, ...) arrays."""
    return np.stack([errors(predicted[:, s], truth[:, s], found[:, s]) for s in (LEFT, RIGHT)], axis=1)


def covered_share(boxes_px: m.FloatArray) -> m.FloatArray:
    """How much of each hand's box lies under the other hand's.

    Args:
        boxes_px: (N, 2, 4) u0, v0, u1, v1; NaN for an absent hand.

    Returns:
        (N, 2) 0..1; 0 for a hand that is alone, NaN for a hand without box or with one that has no area.
    """
    own, other = boxes_px, boxes_px[:, ::-1]
    sides = np.maximum(np.minimum(own[..., 2:], other[..., 2:]) - np.maximum(own[..., :2], other[..., :2]), 0.0)
    area = np.prod(own[..., 2:] - own[..., :2], axis=-1)
    share = np.nan_to_num(np.prod(sides, axis=-1)) / np.where(area > 0, area, np.nan)
    return np.asarray(share)


def sequences(sources: tuple[str, ...]) -> list[list[int]]:
    """Positions of the samples of each folder, in their order: the frames of one video each."""
    found: dict[PurePosixPath, list[int]] = {}
    for index, source in enumerate(sources):
        found.setdefault(PurePosixPath(source).parent, []).append(index)
    return list(found.values())


def _accelerations(
    sources: tuple[str, ...], roots: m.FloatArray, true_roots: m.FloatArray, protocol: Protocol
) -> m.FloatArray:
    errors = np.full((len(sources), 2, 2), np.nan)
    if protocol.fps is not None:
        for frames in sequences(sources):
            errors[frames] = m.acceleration_errors(roots[frames], true_roots[frames], protocol.fps)
    return errors
