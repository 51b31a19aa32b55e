"""Which metrics are computed from predictions and labels, and over what.

Source: paper section 5; docs/evaluation.md. Hands are scored against labels in metres; 2D errors are brought to the
paper's image width.

Names of averages: "EPE mean" and "EPE median" are Zimmermann and Brox's, the mean over joints of each joint's own mean
or median, left and right averaged; "pooled" is over all joints of all hands at once. Everything runs over one data set:
data sets are never pooled with each other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict
from typing import Final

import numpy as np

from twohands.evaluation import metrics as m
from twohands.evaluation.comparison import DEFAULT_PROTOCOL, Comparison, Protocol, compare
from twohands.evaluation.predictions import Predictions
from twohands.evaluation.report import EvaluationReport, Metric
from twohands.skeleton import LEFT, RIGHT
from twohands.types import HandSample

FAILURE_MM: Final = (100.0, 1000.0)
"""CS-MPJPE above which a hand counts as failed: a hand's length, and the limit that EgoForce uses."""

_FOUND_ONLY: Final = "hands present and found; mean of left and right"
_POOLED: Final = "all joints of hands present and found, pooled"
_MISS_FAILS: Final = "hands present, a miss is a failure; mean of left and right"
Reduce = Callable[[m.FloatArray], float]


def evaluate(
    predictions: Predictions, samples: Iterable[HandSample], protocol: Protocol = DEFAULT_PROTOCOL
) -> EvaluationReport:
    """Scores predictions against the labels they were made for.

    Args:
        predictions: N images.
        samples: the same N labelled images in the same order; further ones are not read.
        protocol: what counts.

    Returns:
        The report.

    Raises:
        InputError: the samples are not those of the predictions.
        DataFormatError: a mask does not have its picture's size.
    """
    return report_of(predictions, compare(predictions, samples, protocol), protocol)


def report_of(predictions: Predictions, comparison: Comparison, protocol: Protocol) -> EvaluationReport:
    """The table of a comparison that has been made already."""
    return EvaluationReport(
        dataset=predictions.dataset,
        dataset_id=predictions.dataset_id,
        weights=predictions.weights,
        settings=predictions.settings,
        protocol=asdict(protocol),
        images=len(comparison),
        metrics=metrics_of(comparison),
    )


def metrics_of(comparison: Comparison) -> tuple[Metric, ...]:
    """Every metric of a comparison, or of a part of one (`Comparison.of_hands`), in the order of the table."""
    return (
        *_detection_metrics(comparison),
        *_mask_metrics(comparison),
        *_joints_2d_metrics(comparison),
        *_joints_3d_metrics(comparison),
        *_camera_space_metrics(comparison),
        *_motion_metrics(comparison),
    )


def _detection_metrics(c: Comparison) -> list[Metric]:
    right_box = m.box_correct(c.box_iou, c.found, c.present)
    every = "all hands whose presence is known"
    boxed = f"{every}, and the box of those present"
    return [
        _count("presence_accuracy", "presence accuracy", c.found == c.present, c.judged, every, share=True),
        _count("box_accuracy", "box accuracy (IoU > 0.5)", right_box, c.boxed, boxed, share=True),
        _count("missed", "hands missed", ~c.found, c.present, "sum over hands present"),
        _count("false", "hands found that are not there", c.found, c.judged & ~c.present, "sum over hands absent"),
    ]


def _mask_metrics(c: Comparison) -> list[Metric]:
    if not len(c.unions):
        return []
    background, left, right = (float(value) for value in m.dataset_iou(c.intersections, c.unions))
    images, pooled = len(c.unions), "pixels of all images pooled"
    return [
        Metric(
            "miou", "mIoU (per image)", m.mean_iou(c.intersections, c.unions), "", images, "mean over images, hands"
        ),
        Metric("iou", "IoU of the hands (pooled)", _known_mean([left, right]), "", images, pooled, left, right),
        Metric("iou_background", "IoU of the background (pooled)", background, "", images, pooled),
    ]


def _joints_2d_metrics(c: Comparison) -> list[Metric]:
    errors = c.joints_px
    return [
        _error("epe_2d_mean", "2D EPE mean", "px", errors, m.epe_mean),
        _error("epe_2d_median", "2D EPE median", "px", errors, m.epe_median),
        _pooled("error_2d_mean", "2D error, mean, pooled", "px", errors, m.finite_mean),
        _pooled("error_2d_median", "2D error, median, pooled", "px", errors, m.finite_median),
        _share("auc_2d", "2D PCK AUC 0-30 px", errors, lambda e: m.pck_auc(e, m.AUC_2D_PX)),
    ]


def _joints_3d_metrics(c: Comparison) -> list[Metric]:
    """Of the canonical pose, scaled by the true hand length (paper section 5.1)."""
    found: list[Metric] = []
    for key, name, errors in (
        ("spherical", "spherical alignment", c.spherical_mm),
        ("cartesian", "Cartesian alignment", c.cartesian_mm),
    ):
        found += [
            _error(f"epe_3d_{key}_mean", f"3D EPE mean, {name}", "mm", errors, m.epe_mean),
            _error(f"epe_3d_{key}_median", f"3D EPE median, {name}", "mm", errors, m.epe_median),
            _pooled(f"error_3d_{key}_mean", f"3D error, mean, pooled, {name}", "mm", errors, m.finite_mean),
            _pooled(f"error_3d_{key}_median", f"3D error, median, pooled, {name}", "mm", errors, m.finite_median),
            _share(f"auc_20_50_{key}", f"3D PCK AUC 20-50 mm, {name}", errors, lambda e: m.pck_auc(e, m.AUC_20_50_MM)),
            _share(f"auc_0_50_{key}", f"3D PCK AUC 0-50 mm, {name}", errors, lambda e: m.pck_auc(e, m.AUC_0_50_MM)),
            _share(f"auc_zb_{key}", f"3D PCK AUC 21-50 mm (ZB), {name}", errors, lambda e: m.pck_auc(e, m.AUC_ZB_MM)),
        ]
    return [
        *found,
        _error("bone_length", "bone length error", "mm", c.bones_mm, m.finite_mean),
        _error("pa_mpjpe", "PA-MPJPE", "mm", c.procrustes_mm, m.finite_mean),
    ]


def _camera_space_metrics(c: Comparison) -> list[Metric]:
    distance_cm, relative = 1e2 * c.root[..., 3], 1e2 * c.root[..., 4]
    found = [
        _count("invalid", "hands found without a valid range", ~c.valid, c.present & c.found, "sum over hands found"),
        _error("range_mean", "range error, mean", "cm", distance_cm, m.finite_mean),
        _error("range_median", "range error, median", "cm", distance_cm, m.finite_median),
        _error("range_relative_median", "range error / range, median", "%", relative, m.finite_median),
        *(_share(f"range_{t}cm", f"range within {t} cm", distance_cm, _within(t)) for t in (3, 3.5, 5, 7, 10)),
        _share("range_auc", "range AUC 0-20 cm", distance_cm, lambda e: m.pck_auc(e[:, None], m.AUC_RANGE_CM)),
    ]
    for index, (key, name) in enumerate((("theta", "theta"), ("phi", "phi"), ("direction", "direction"))):
        angle = c.root[..., index]
        found += [
            _error(f"{key}_median", f"{name} error, median", "deg", angle, m.finite_median),
            *(_share(f"{key}_{t}deg", f"{name} within {t} deg", angle, _within(t)) for t in (1, 1.5, 3, 5)),
            _share(f"{key}_auc", f"{name} AUC 0-10 deg", angle, lambda e: m.pck_auc(e[:, None], m.AUC_ANGLE_DEG)),
        ]
    pairs = int(np.isfinite(c.relative_root_mm).sum())
    mrrpe = m.finite_mean(c.relative_root_mm)
    return [
        *found,
        _error("cs_mpjpe", "CS-MPJPE", "mm", c.camera_mm, m.finite_mean),
        _pooled("cs_median", "camera-space error, median, pooled", "mm", c.camera_mm, m.finite_median),
        *(
            _share(
                f"failure_{limit:.0f}mm", f"failure rate (missed or CS-MPJPE > {limit / 10:.0f} cm)", c.camera_mm, rate
            )
            for limit in FAILURE_MM
            for rate in [_failing(limit)]
        ),
        Metric("mrrpe", "MRRPE", mrrpe, "mm", pairs, "images with both hands present and found"),
    ]


def _motion_metrics(c: Comparison) -> list[Metric]:
    if np.isnan(c.acceleration).all():
        return []
    return [
        _error(
            f"acceleration_{key}", f"acceleration error, root, {key}", "m/s2", c.acceleration[..., part], m.finite_mean
        )
        for part, key in enumerate(("tangential", "radial"))
    ]


def _within(threshold: float) -> Reduce:
    return lambda errors: m.accuracy_at(errors, threshold)


def _failing(threshold: float) -> Reduce:
    return lambda errors: m.failure_rate(errors, threshold)


def _error(key: str, name: str, unit: str, errors: m.FloatArray, reduce: Reduce) -> Metric:
    """A mean or median error: missed hands are left out of the number and of the count."""
    return _metric(key, name, unit, errors, reduce, np.isfinite(errors), _FOUND_ONLY)


def _share(key: str, name: str, errors: m.FloatArray, reduce: Reduce) -> Metric:
    """A share: missed hands count as failures."""
    return _metric(key, name, "", errors, reduce, ~np.isnan(errors), _MISS_FAILS)


def _metric(
    key: str, name: str, unit: str, errors: m.FloatArray, reduce: Reduce, counted: m.BoolArray, rule: str
) -> Metric:
    sides = [reduce(errors[:, s]) for s in (LEFT, RIGHT)]
    return Metric(key, name, _known_mean(sides), unit, _hands(counted), rule, *sides)


def _pooled(key: str, name: str, unit: str, errors: m.FloatArray, reduce: Reduce) -> Metric:
    """A mean or median over all joints of all hands of both sides at once."""
    sides = [reduce(errors[:, s]) for s in (LEFT, RIGHT)]
    return Metric(key, name, reduce(errors), unit, _hands(np.isfinite(errors)), _POOLED, *sides)


def _count(
    key: str, name: str, happened: m.BoolArray, counted: m.BoolArray, rule: str, *, share: bool = False
) -> Metric:
    """How often something happened among the hands that count; NaN, not 0, where none does."""
    numbers = [
        float((happened & counted)[:, s].sum() / (counted[:, s].sum() if share else 1))
        if counted[:, s].any()
        else np.nan
        for s in (LEFT, RIGHT)
    ]
    total = int(counted.sum())
    value = float((happened & counted).sum() / (total if share else 1)) if total else float("nan")
    return Metric(key, name, value, "" if share else "hands", total, rule, *numbers)


def _known_mean(sides: list[float]) -> float:
    known = [value for value in sides if not np.isnan(value)]
    return float(np.mean(known)) if known else float("nan")


def _hands(counted: m.BoolArray) -> int:
    """Number of hands with any counted entry; counted is (N, 2) or (N, 2, J)."""
    return int(np.any(counted, axis=tuple(range(2, counted.ndim))).sum())
