"""Metrics as pure functions of arrays: no files, no networks, no state.

How unknown and missed are told apart, everywhere in this module: an error is NaN where the ground truth is unknown or
the hand absent (the entry does not count at all), and infinite where a hand is there and was not found (a miss).
Mean and median errors run over the finite entries: hands that are present and found; print `missed` beside them.
Accuracies, PCK and AUC run over all but the NaN entries, so that a miss is a failure at every threshold.

Array shapes: M hands, J joints, N images, T thresholds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twohands.geometry.rotation import centring_angles
from twohands.skeleton import BONES, LEFT, RIGHT

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

AUC_2D_PX: Final = np.linspace(0.0, 30.0, 100)
"""Thresholds of the 2D curve, pixels at 480x270 (docs/evaluation.md, *Thresholds*)."""
AUC_20_50_MM: Final = np.linspace(20.0, 50.0, 100)
AUC_0_50_MM: Final = np.linspace(0.0, 50.0, 100)
AUC_ZB_MM: Final = np.linspace(0.0, 50.0, 20)[8:]
"""What Zimmermann and Brox's code calls "20-50 mm": it really starts at 21.05 mm (docs/evaluation.md, *Thresholds*)."""
AUC_ANGLE_DEG: Final = np.linspace(0.0, 10.0, 101)
AUC_RANGE_CM: Final = np.linspace(0.0, 20.0, 101)
"""The paper's own limits of the spherical curves cannot be recovered (docs/evaluation.md, *Thresholds*)."""


# Presence and segmentation


def presence_accuracy(predicted: ArrayLike, truth: ArrayLike) -> float:
    """Share of hands whose presence is right; a miss and a false find cost the same.

    Args:
        predicted, truth: (N, 2) bool.

    Returns:
        0..1, over all 2N hands. Source: paper section 5.2, "hand detection accuracy".
    """
    return _mean(_bools(predicted) == _bools(truth))


def box_correct(iou: ArrayLike, predicted: ArrayLike, truth: ArrayLike, threshold: float = 0.5) -> BoolArray:
    """Which hands have a right box: absent and none predicted, or present with IoU above the threshold.

    A miss and a false find are wrong.

    Args:
        iou: (...) overlap of predicted and true box; ignored unless the hand is both present and predicted.
        predicted, truth: (...) bool, presence.
        threshold: the IoU must be larger than this.

    Returns:
        (...) bool. Source: paper section 5.2, "bounding box detection accuracy".
    """
    predicted, truth = _bools(predicted), _bools(truth)
    overlapping = np.asarray(iou) > threshold  # False for NaN
    return np.asarray(np.where(truth & predicted, overlapping, ~truth & ~predicted), bool)


def class_overlaps(predicted: ArrayLike, truth: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Pixel counts from which every IoU follows.

    Args:
        predicted, truth: (H, W) integer masks, 0 background, 1 left, 2 right.

    Returns:
        (intersection, union), each (3,) pixels.

    Raises:
        ValueError: the masks differ in shape.
    """
    predicted, truth = np.asarray(predicted), np.asarray(truth)
    if predicted.shape != truth.shape:
        raise ValueError(f"masks differ in shape: predicted {predicted.shape}, truth {truth.shape}")
    pairs = [(predicted == index, truth == index) for index in range(3)]
    intersection = np.array([np.count_nonzero(a & b) for a, b in pairs], float)
    union = np.array([np.count_nonzero(a | b) for a, b in pairs], float)
    return intersection, union


def mean_iou(intersections: ArrayLike, unions: ArrayLike) -> float:
    """Mean over images of the mean IoU of the two foreground classes.

    A hand that is in neither mask counts as IoU 1, a hand in one of them only as 0.

    Args:
        intersections, unions: (N, 3) pixels, from `class_overlaps`.

    Returns:
        0..1. Source: paper section 5.2; the averaging is that of docs/evaluation.md.
    """
    return _mean(_ratio(intersections, unions)[..., 1:])


def dataset_iou(intersections: ArrayLike, unions: ArrayLike) -> FloatArray:
    """IoU per class with all images' pixels pooled.

    Args:
        intersections, unions: (N, 3) pixels, from `class_overlaps`.

    Returns:
        (3,) background, left, right; each 0..1, NaN for a class that is in no mask of any image.
    """
    intersection, union = _floats(intersections).sum(axis=0), _floats(unions).sum(axis=0)
    return np.where(union > 0, intersection / np.maximum(union, 1.0), np.nan)


# Errors per joint and what is made of them


def endpoint_errors(predicted: ArrayLike, truth: ArrayLike, found: ArrayLike) -> FloatArray:
    """Euclidean distance of predicted from true joints, in the unit of the input.

    Args:
        predicted: (M, J, D); anything where the hand was not found.
        truth: (M, J, D); NaN where unknown or absent.
        found: (M,) bool, whether the hand was found.

    Returns:
        (M, J); NaN where the truth is unknown, infinite where the hand was missed.
    """
    truth = _floats(truth)
    distance = np.linalg.norm(_floats(predicted) - truth, axis=-1)  # (M, J)
    known = _all_finite(truth)
    hit = _bools(found)[:, None] & np.isfinite(distance)
    return np.where(known, np.where(hit, distance, np.inf), np.nan)


def epe_mean(errors: ArrayLike) -> float:
    """Mean over joints of each joint's mean error; joints without any finite error do not count.

    Args:
        errors: (M, J), see the module's docstring; missed hands are left out.

    Returns:
        In the unit of the input. Source: Zimmermann and Brox's evaluation code, which the paper follows (section 5.1).
    """
    return _mean_over_joints(errors, np.mean)


def epe_median(errors: ArrayLike) -> float:
    """Mean over joints of each joint's median error: not the median of all errors pooled.

    Args:
        errors: (M, J), see the module's docstring; missed hands are left out.

    Returns:
        In the unit of the input. Source: Zimmermann and Brox's evaluation code, which the paper follows (section 5.1).
    """
    return _mean_over_joints(errors, np.median)


def pck_curve(errors: ArrayLike, thresholds: ArrayLike) -> FloatArray:
    """Percentage of correct keypoints: mean over joints of the share of errors <= threshold; a miss is a failure.

    Args:
        errors: (M, J), see the module's docstring.
        thresholds: (T,) in the unit of the errors.

    Returns:
        (T,) 0..1; NaN without any known joint. Source: as `epe_mean`.
    """
    errors = _floats(errors)
    known = ~np.isnan(errors)  # (M, J)
    labelled = known.sum(axis=0) > 0  # (J,)
    if not labelled.any():
        return np.full(_floats(thresholds).shape, np.nan)
    counts = known.sum(axis=0)[labelled]  # (J',)
    shares = [(errors <= threshold).sum(axis=0)[labelled] / counts for threshold in _floats(thresholds)]
    return np.array([share.mean() for share in shares], float)


def pck_auc(errors: ArrayLike, thresholds: ArrayLike) -> float:
    """Area under the PCK curve by trapezoids, divided by the width of the threshold range; a miss is a failure.

    Args:
        errors: (M, J), see the module's docstring.
        thresholds: (T,) increasing.

    Returns:
        0..1. Source: as `epe_mean`; ranges in docs/evaluation.md, *Thresholds*.
    """
    thresholds = _floats(thresholds)
    curve = pck_curve(errors, thresholds)
    return float(np.sum((curve[1:] + curve[:-1]) / 2 * np.diff(thresholds)) / (thresholds[-1] - thresholds[0]))


def accuracy_at(errors: ArrayLike, threshold: float) -> float:
    """Share of hands with an error <= threshold; a miss is a failure.

    Args:
        errors: (M,), see the module's docstring.
        threshold: in the unit of the errors.

    Returns:
        0..1; NaN without any hand.
    """
    errors = _floats(errors)
    return _mean(errors[~np.isnan(errors)] <= threshold)


def failure_rate(errors: ArrayLike, threshold: float) -> float:
    """Share of hands whose mean joint error exceeds a threshold, or that were missed.

    Args:
        errors: (M, J), see the module's docstring; a hand's mean runs over its known joints.
        threshold: in the unit of the errors; an error equal to it is no failure.

    Returns:
        0..1; NaN without any hand of which a joint is known.
        Source: what EgoForce (2026) reports beside CS-MPJPE, because a mean over found hands hides the others.
    """
    errors = _floats(errors)
    known = ~np.isnan(errors)  # (M, J)
    errors, known = errors[known.any(axis=1)], known[known.any(axis=1)]
    means = np.where(known, errors, 0.0).sum(axis=1) / known.sum(axis=1)
    return _mean(means > threshold)


def finite_mean(errors: ArrayLike) -> float:
    """Mean of the finite entries (missed hands left out), all pooled; NaN if there is none."""
    errors = _floats(errors)
    return _mean(errors[np.isfinite(errors)])


def finite_median(errors: ArrayLike) -> float:
    """Median of the finite entries (missed hands left out), all pooled; NaN if there is none."""
    errors = _floats(errors)
    errors = errors[np.isfinite(errors)]
    return float(np.median(errors)) if errors.size else float("nan")


# Shape of one hand


def bone_length_errors(predicted: ArrayLike, truth: ArrayLike, found: ArrayLike) -> FloatArray:
    """Absolute difference of the 20 bones' lengths.

    Args:
        predicted: (M, 21, 3); anything where the hand was not found.
        truth: (M, 21, 3); NaN where unknown or absent.
        found: (M,) bool.

    Returns:
        (M, 20) in the unit of the input; NaN where the truth is unknown, infinite where the hand was missed.
        Source: paper section 5.2, "average bone length error".
    """
    parents, children = [parent for parent, _ in BONES], [child for _, child in BONES]
    lengths = [
        np.linalg.norm(joints[:, children] - joints[:, parents], axis=-1)  # (M, 20)
        for joints in (_floats(predicted), _floats(truth))
    ]
    return endpoint_errors(lengths[0][..., None], lengths[1][..., None], found)


def procrustes_aligned(predicted: ArrayLike, truth: ArrayLike) -> FloatArray:
    """The similarity transform (scale, proper rotation, translation) of a prediction nearest to the truth.

    Args:
        predicted, truth: (J, 3), finite.

    Returns:
        (J, 3) the transformed prediction.
        Source: closed form by singular value decomposition (Umeyama 1991); the base of PA-MPJPE.
    """
    predicted, truth = _floats(predicted), _floats(truth)
    mean_predicted, mean_truth = predicted.mean(axis=0), truth.mean(axis=0)
    centred_predicted, centred_truth = predicted - mean_predicted, truth - mean_truth
    u, singular_values, vt = np.linalg.svd(centred_truth.transpose() @ centred_predicted)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])  # a mirrored hand must not fit
    rotation = (u * signs) @ vt
    spread = np.sum(centred_predicted**2)
    scale = np.sum(singular_values * signs) / spread if spread > 0 else 1.0
    return np.asarray(scale * np.einsum("ij,nj->ni", rotation, centred_predicted) + mean_truth)


def procrustes_errors(predicted: ArrayLike, truth: ArrayLike, found: ArrayLike) -> FloatArray:
    """Endpoint errors after aligning every hand by its own similarity transform (PA-MPJPE before averaging).

    Args:
        predicted: (M, J, 3); anything where the hand was not found.
        truth: (M, J, 3); a hand with an unknown (NaN) joint does not count.
        found: (M,) bool.

    Returns:
        (M, J) in the unit of the input; NaN where the truth is unknown, infinite where the hand was missed.
    """
    predicted, truth = _floats(predicted), _floats(truth)
    hit = _bools(found) & _all_finite(predicted, (1, 2))
    known = _all_finite(truth, (1, 2))
    aligned = np.full_like(truth, np.nan)
    for hand in np.flatnonzero(hit & known):
        aligned[hand] = procrustes_aligned(predicted[hand], truth[hand])
    complete_truth = np.where(known[:, None, None], truth, np.nan)
    return endpoint_errors(aligned, complete_truth, hit)


# Camera space


def relative_root_errors(predicted_roots: ArrayLike, true_roots: ArrayLike, found: ArrayLike) -> FloatArray:
    """Error of the vector from the right hand's root joint to the left hand's (MRRPE before averaging).

    Args:
        predicted_roots, true_roots: (N, 2, 3) camera frame; NaN where unknown.
        found: (N, 2) bool.

    Returns:
        (N,) in the unit of the input; NaN unless both hands are present, infinite where either was missed.
        Source: MRRPE of InterHand2.6M (Moon et al. 2020).
    """
    predicted_roots, true_roots = _floats(predicted_roots), _floats(true_roots)
    predicted = predicted_roots[:, LEFT] - predicted_roots[:, RIGHT]  # (N, 3)
    truth = true_roots[:, LEFT] - true_roots[:, RIGHT]
    return endpoint_errors(predicted[:, None], truth[:, None], _bools(found)[:, LEFT] & _bools(found)[:, RIGHT])[:, 0]


def spherical_coordinates(points: ArrayLike) -> FloatArray:
    """Camera-frame points as (theta, phi, radius).

    Args:
        points: (..., 3) x right, y down, z forward.

    Returns:
        (..., 3) theta and phi of `geometry.rotation.centring_angles` in degrees, radius in the unit of the input.
        Source: paper section 5.2 and Eq. 3; docs/conventions.md.
    """
    points = _floats(points)
    theta, phi = centring_angles(points)
    return np.stack([np.degrees(theta), np.degrees(phi), np.linalg.norm(points, axis=-1)], axis=-1)


def spherical_errors(predicted_roots: ArrayLike, true_roots: ArrayLike, found: ArrayLike) -> FloatArray:
    """Errors of the root joint in spherical coordinates.

    Args:
        predicted_roots, true_roots: (M, 3) camera frame; NaN where unknown.
        found: (M,) bool.

    Returns:
        (M, 5): |theta error| deg, |phi error| deg, great-circle angle between the directions deg, |radius error| in
        the unit of the input, |radius error| / true radius. NaN where the truth is unknown, infinite where missed.
        Source: docs/evaluation.md, *Rules*; ours.
    """
    predicted_roots, true_roots = _floats(predicted_roots), _floats(true_roots)
    predicted, truth = spherical_coordinates(predicted_roots), spherical_coordinates(true_roots)
    turn = np.abs(predicted[:, :2] - truth[:, :2])
    angles = np.minimum(turn, 360.0 - turn)  # (M, 2)
    cross = np.linalg.norm(np.cross(predicted_roots, true_roots), axis=-1)
    great_circle = np.degrees(np.arctan2(cross, np.sum(predicted_roots * true_roots, axis=-1)))  # exact near 0
    radius = np.abs(predicted[:, 2] - truth[:, 2])
    errors = np.column_stack([angles, great_circle, radius, radius / truth[:, 2]])
    known = _all_finite(true_roots)[:, None]
    hit = (_bools(found) & _all_finite(errors))[:, None]
    return np.where(known, np.where(hit, errors, np.inf), np.nan)


def acceleration_errors(predicted: ArrayLike, truth: ArrayLike, fps: float) -> FloatArray:
    """Errors of the acceleration of points over video, along the line of sight and across it.

    The acceleration at frame t is (x[t-1] - 2 x[t] + x[t+1]) fps^2. Its error is split by the direction from the
    pinhole to the true point at frame t: monocular range is far noisier than direction, and one number would hide it.

    Args:
        predicted, truth: (T, ..., 3) consecutive frames, camera frame; NaN where unknown or not found.
        fps: frames a second.

    Returns:
        (T, ..., 2) lengths of the tangential and of the radial part of the error, unit of the input per s^2. NaN at the
        first and last frame and wherever one of the three frames is unknown or not found: there is no acceleration.

    Raises:
        ValueError: fps is not above 0.
        Source: acceleration error as usual in video pose estimation; the split is ours, because
        only the range is smoothed.
    """
    if not fps > 0:
        raise ValueError(f"frames a second must be above 0, got {fps}")
    predicted, truth = _floats(predicted), _floats(truth)
    errors = np.full((*truth.shape[:-1], 2), np.nan)
    if len(truth) < 3:
        return errors
    difference = predicted - truth
    error = (difference[:-2] - 2.0 * difference[1:-1] + difference[2:]) * fps**2  # (T-2, ..., 3)
    sight = truth[1:-1] / np.linalg.norm(truth[1:-1], axis=-1, keepdims=True)
    along = np.sum(error * sight, axis=-1)
    across = np.linalg.norm(error - along[..., None] * sight, axis=-1)
    errors[1:-1] = np.stack([across, np.abs(along)], axis=-1)
    return errors


def _floats(values: ArrayLike) -> FloatArray:
    return np.asarray(values, dtype=np.float64)


def _bools(values: ArrayLike) -> BoolArray:
    return np.asarray(values, dtype=np.bool_)


def _all_finite(values: FloatArray, axis: int | tuple[int, ...] = -1) -> BoolArray:
    return _bools(np.isfinite(values).all(axis=axis))


def _mean(values: ArrayLike) -> float:
    values = _floats(values)
    return float(values.mean()) if values.size else float("nan")


def _ratio(intersection: ArrayLike, union: ArrayLike) -> FloatArray:
    intersection, union = _floats(intersection), _floats(union)
    return np.where(union > 0, intersection / np.maximum(union, 1.0), 1.0)


def _mean_over_joints(errors: ArrayLike, reduce: Callable[[FloatArray], Any]) -> float:
    values = _floats(errors)
    columns: list[FloatArray] = [values[:, joint] for joint in range(values.shape[1])]
    per_joint = [column[np.isfinite(column)] for column in columns]
    return _mean([float(reduce(column)) for column in per_joint if column.size])
