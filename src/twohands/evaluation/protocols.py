"""Which metrics are computed from predictions and labels, and over what.

Source: SPEC 7. Hands are scored against labels in metres; 2D errors are brought to the paper's image width.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

import numpy as np

from twohands.errors import DataFormatError, InputError
from twohands.evaluation import metrics as m
from twohands.evaluation.predictions import Fingerprint, Predictions
from twohands.evaluation.report import EvaluationReport, Metric
from twohands.geometry.boxes import box_from_points, box_iou
from twohands.geometry.canonical import cartesian_alignment, spherical_alignment
from twohands.skeleton import LEFT, RIGHT, ROOT, WRIST
from twohands.types import HandSample

REFERENCE_WIDTH_PX: Final = 480
"""2D errors are multiplied by 480 / image width (SPEC 7.2, "at 270x480")."""

_FOUND_ONLY: Final = "hands present and found; mean of left and right"
_MISS_FAILS: Final = "hands present, a miss is a failure; mean of left and right"
Reduce = Callable[[m.FloatArray], float]


def evaluate(predictions: Predictions, samples: Iterable[HandSample]) -> EvaluationReport:
    """Scores predictions against the labels they were made for.

    Args:
        predictions: N images.
        samples: the same N labelled images in the same order; further ones are not read.

    Returns:
        The report.

    Raises:
        InputError: the samples are not those of the predictions.
    """
    truth = _Truth(predictions)
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
    return EvaluationReport(
        dataset=predictions.dataset,
        dataset_id=predictions.dataset_id,
        weights=predictions.weights,
        settings=predictions.settings,
        images=len(predictions),
        metrics=(
            *_detection_metrics(predictions, truth),
            *_joints_2d_metrics(predictions, truth),
            *_joints_3d_metrics(predictions, truth),
            *_camera_space_metrics(predictions, truth),
        ),
    )


class _Truth:
    """Labels of all samples as arrays (N, 2, ...), and mask overlaps, gathered one sample at a time."""

    def __init__(self, predictions: Predictions) -> None:
        self._predictions = predictions
        count = len(predictions)
        self.present = np.zeros((count, 2), np.bool_)
        self.scale_2d = np.ones(count)
        self.joints_px = np.full((count, 2, 21, 2), np.nan)
        self.joints_m = np.full((count, 2, 21, 3), np.nan)
        self.overlaps: list[tuple[m.FloatArray, m.FloatArray]] = []

    def add(self, index: int, sample: HandSample) -> None:
        self.present[index] = sample.present
        self.scale_2d[index] = REFERENCE_WIDTH_PX / sample.camera.width
        known = sample.valid & sample.present[:, None]  # (2, 21)
        self.joints_px[index] = np.where(known[..., None], sample.joints_px, np.nan)
        self.joints_m[index] = np.where(known[..., None], sample.joints_m, np.nan)
        mask = self._predictions.mask(index)
        if sample.labels is not None and mask is not None:
            if mask.shape != sample.labels.shape:
                raise DataFormatError(f"{sample.source}: mask {mask.shape} and labels {sample.labels.shape} differ")
            self.overlaps.append(m.class_overlaps(mask, m.hand_masks(sample.labels)))


def _detection_metrics(predictions: Predictions, truth: _Truth) -> list[Metric]:
    iou = np.asarray(box_iou(predictions.box_px.astype(np.float64), box_from_points(truth.joints_px)))
    right_presence = predictions.present == truth.present  # (N, 2)
    right_box = m.box_correct(iou, predictions.present, truth.present)
    missed = truth.present & ~predictions.present
    false = ~truth.present & predictions.present
    all_hands = "all 2N hands"
    found = [
        _per_side("presence_accuracy", "presence accuracy", "", right_presence, np.mean, all_hands),
        _per_side("box_accuracy", "box accuracy (IoU > 0.5)", "", right_box, np.mean, all_hands),
        _per_side("missed", "hands missed", "hands", missed, np.sum, "sum", total=np.sum),
        _per_side("false", "hands found that are not there", "hands", false, np.sum, "sum", total=np.sum),
    ]
    if truth.overlaps:
        intersections, unions = (np.array(arrays) for arrays in zip(*truth.overlaps, strict=True))
        value = m.mean_iou(intersections, unions)
        found.append(Metric("miou", "mIoU (per image)", value, "", len(intersections), "mean over images, foreground"))
        iou_background, iou_left, iou_right = (float(value) for value in m.dataset_iou(intersections, unions))
        foreground = (iou_left + iou_right) / 2
        rule = "pixels of all images pooled"
        found += [
            Metric("iou", "IoU (pooled)", foreground, "", len(intersections), rule, iou_left, iou_right),
            Metric("iou_background", "IoU of the background (pooled)", iou_background, "", len(intersections), rule),
        ]
    return found


def _joints_2d_metrics(predictions: Predictions, truth: _Truth) -> list[Metric]:
    scale = truth.scale_2d[:, None, None, None]
    errors = _both_sides(m.endpoint_errors, predictions.joints_px * scale, truth.joints_px * scale, predictions.present)
    return [
        _error("epe_2d_mean", "2D EPE mean", "px", errors, m.epe_mean),
        _error("epe_2d_median", "2D EPE median", "px", errors, m.epe_median),
        _error("error_2d_median", "2D error, median of all joints", "px", errors, m.finite_median),
        _share("auc_2d", "2D PCK AUC 0-30 px", errors, lambda e: m.pck_auc(e, m.AUC_2D_PX)),
    ]


def _joints_3d_metrics(predictions: Predictions, truth: _Truth) -> list[Metric]:
    """Of the canonical pose, scaled by the true hand length (SPEC 7.2)."""
    length = np.linalg.norm(truth.joints_m[..., WRIST, :] - truth.joints_m[..., ROOT, :], axis=-1)  # (N, 2)
    found: list[Metric] = []
    for key, name, align in (
        ("spherical", "spherical alignment", spherical_alignment),
        ("cartesian", "Cartesian alignment", cartesian_alignment),
    ):
        aligned_mm = 1e3 * np.asarray(align(predictions.canonical, length, truth.joints_m))
        errors = _both_sides(m.endpoint_errors, aligned_mm, 1e3 * truth.joints_m, predictions.present)
        found += [
            _error(f"epe_3d_{key}_mean", f"3D EPE mean, {name}", "mm", errors, m.epe_mean),
            _error(f"epe_3d_{key}_median", f"3D EPE median, {name}", "mm", errors, m.epe_median),
            _share(f"auc_20_50_{key}", f"3D PCK AUC 20-50 mm, {name}", errors, lambda e: m.pck_auc(e, m.AUC_20_50_MM)),
            _share(f"auc_0_50_{key}", f"3D PCK AUC 0-50 mm, {name}", errors, lambda e: m.pck_auc(e, m.AUC_0_50_MM)),
            _share(f"auc_zb_{key}", f"3D PCK AUC 21-50 mm (ZB), {name}", errors, lambda e: m.pck_auc(e, m.AUC_ZB_MM)),
        ]
    scaled_mm = 1e3 * length[..., None, None] * predictions.canonical
    true_mm = 1e3 * truth.joints_m
    bones = _both_sides(m.bone_length_errors, scaled_mm, true_mm, predictions.present)
    procrustes = _both_sides(m.procrustes_errors, scaled_mm, true_mm, predictions.present)
    return [
        *found,
        _error("bone_length", "bone length error", "mm", bones, m.finite_mean),
        _error("pa_mpjpe", "PA-MPJPE", "mm", procrustes, m.finite_mean),
    ]


def _camera_space_metrics(predictions: Predictions, truth: _Truth) -> list[Metric]:
    usable = predictions.present & predictions.valid
    roots, true_roots = predictions.joints_m[:, :, ROOT], truth.joints_m[:, :, ROOT]
    spherical = _both_sides(m.spherical_errors, roots, true_roots, usable)  # (N, 2, 5)
    distance_cm, relative = 1e2 * spherical[..., 3], spherical[..., 4]
    placed = _both_sides(m.endpoint_errors, 1e3 * predictions.joints_m, 1e3 * truth.joints_m, usable)
    relative_root = 1e3 * m.relative_root_errors(roots, true_roots, usable)  # (N,)
    invalid = truth.present & predictions.present & ~predictions.valid
    found = [
        _per_side("invalid", "hands found without a valid range", "hands", invalid, np.sum, "sum", total=np.sum),
        _error("range_median", "range error, median", "cm", distance_cm, m.finite_median),
        _error("range_relative_median", "range error / range, median", "", relative, m.finite_median),
        *(_share(f"range_{t}cm", f"range within {t} cm", distance_cm, _within(t)) for t in (3, 5, 7, 10)),
        _share("range_auc", "range AUC 0-20 cm", distance_cm, lambda e: m.pck_auc(e[:, None], m.AUC_RANGE_CM)),
    ]
    for index, (key, name) in enumerate((("theta", "theta"), ("phi", "phi"), ("direction", "direction"))):
        angle = spherical[..., index]
        found += [
            _error(f"{key}_median", f"{name} error, median", "deg", angle, m.finite_median),
            *(_share(f"{key}_{t}deg", f"{name} within {t} deg", angle, _within(t)) for t in (1, 3, 5)),
            _share(f"{key}_auc", f"{name} AUC 0-10 deg", angle, lambda e: m.pck_auc(e[:, None], m.AUC_ANGLE_DEG)),
        ]
    pairs = int(np.isfinite(relative_root).sum())
    return [
        *found,
        _error("cs_mpjpe", "CS-MPJPE", "mm", placed, m.finite_mean),
        Metric("mrrpe", "MRRPE", m.finite_mean(relative_root), "mm", pairs, "images with both hands present and found"),
    ]


def _both_sides(
    errors: Callable[[m.FloatArray, m.FloatArray, m.BoolArray], m.FloatArray],
    predicted: m.FloatArray,
    truth: m.FloatArray,
    found: m.BoolArray,
) -> m.FloatArray:
    """Applies a metric on (M, ...) hands to (N, 2, ...) arrays."""
    return np.stack([errors(predicted[:, s], truth[:, s], found[:, s]) for s in (LEFT, RIGHT)], axis=1)


def _within(threshold: float) -> Reduce:
    return lambda errors: m.accuracy_at(errors, threshold)


def _error(key: str, name: str, unit: str, errors: m.FloatArray, reduce: Reduce) -> Metric:
    """A mean or median error: missed hands are left out of the number and of the count."""
    count = _hands(np.isfinite(errors))
    return _metric(key, name, unit, [reduce(errors[:, s]) for s in (LEFT, RIGHT)], count, _FOUND_ONLY)


def _share(key: str, name: str, errors: m.FloatArray, reduce: Reduce) -> Metric:
    """A share of successes: missed hands count as failures."""
    count = _hands(~np.isnan(errors))
    return _metric(key, name, "", [reduce(errors[:, s]) for s in (LEFT, RIGHT)], count, _MISS_FAILS)


def _per_side(
    key: str,
    name: str,
    unit: str,
    values: m.BoolArray,
    reduce: Callable[..., float],
    rule: str,
    total: Callable[..., float] = np.mean,
) -> Metric:
    """Any number over all 2N hands."""
    sides = [float(reduce(values[:, s])) for s in (LEFT, RIGHT)]
    return Metric(key, name, float(total(sides)), unit, values.size, rule, *sides)


def _metric(key: str, name: str, unit: str, sides: list[float], count: int, rule: str) -> Metric:
    known = [value for value in sides if not np.isnan(value)]
    value = float(np.mean(known)) if known else float("nan")
    return Metric(key, name, value, unit, count, rule, *sides)


def _hands(counted: m.BoolArray) -> int:
    """Number of hands with any counted entry; counted is (N, 2) or (N, 2, J)."""
    return int(np.any(counted, axis=tuple(range(2, counted.ndim))).sum())
