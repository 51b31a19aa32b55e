"""Which solver of the global step gives the best range from the same predictions.

    twohands eval predict DATA --out ours.npz
    python benchmarks/range_solvers.py ours.npz DATA

Key bone, all joints alike, all joints weighted by powers of their scores, the palm's joints (wrist and knuckles) alone,
the weights that the pipeline uses (`range_weights`), and the fit that it uses; no network is run. Errors in cm, degrees
and mm over the hands that every solver places; the interval is a bootstrap over images of the mean range's difference
to "all joints". Poses of a predictions file are drawn to the rays of the fitted place already, which favours the fit;
predictions of an estimator with `ray_share` 0 favour none.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from twohands.datasets.opening import open_dataset
from twohands.evaluation.comparison import compare, without_picture
from twohands.evaluation.completion import hand_lengths_m
from twohands.evaluation.predictions import load_predictions
from twohands.geometry.projection import Method, project_global, range_weights
from twohands.skeleton import PALM

PALM_ONLY = np.isin(np.arange(21), PALM).astype(float)
SOLVERS: dict[str, tuple[Method, Callable[[np.ndarray], np.ndarray | None]]] = {
    "key bone": ("keybone", lambda scores: None),
    "all joints": ("all-joints", np.ones_like),
    "weighted by score": ("all-joints", lambda scores: scores),
    "weighted by score^2": ("all-joints", lambda scores: scores**2),
    "weighted by score^4": ("all-joints", lambda scores: scores**4),
    "palm only": ("all-joints", lambda scores: PALM_ONLY + 0 * scores),
    "palm 1, fingers 1/4": ("all-joints", lambda scores: range_weights(np.ones_like(scores))),
    "the same x score^2": ("all-joints", range_weights),
    "fitted": ("fitted", np.ones_like),
    "fitted, palm 1, fingers 1/4, x score^2": ("fitted", range_weights),
}
"""Method, and scores (2, 21) -> weights (2, 21)."""
RESAMPLES = 2_000


def main(path: str, data: str) -> None:
    predictions = load_predictions(path)
    predictions = replace(predictions, masks_png=(b"",) * len(predictions))
    dataset = open_dataset(data).labels
    labels = [without_picture(dataset[index]) for index in range(len(predictions))]
    errors = {}
    for name, (method, weigh) in SOLVERS.items():
        joints_m, valid = np.full_like(predictions.joints_m, np.nan), np.zeros_like(predictions.valid)
        for index, sample in enumerate(labels):
            pose = project_global(
                predictions.canonical[index],
                predictions.joints_px[index],
                sample.camera,
                hand_lengths_m(sample),
                method=method,
                weights=weigh(predictions.joint_scores[index]),
            )
            valid[index] = predictions.present[index] & pose.valid
            joints_m[index] = np.where(valid[index][:, None, None], pose.joints_m, np.nan)
        c = compare(replace(predictions, joints_m=joints_m, valid=valid), labels)
        errors[name] = 1e2 * c.root[..., 3], c.root[..., 2], c.camera_mm.mean(axis=-1)  # (N, 2) cm, degrees, mm
    counted = np.all([np.isfinite(range_cm) & np.isfinite(mm) for range_cm, _, mm in errors.values()], axis=0)
    print(f"{counted.sum()} hands of {len(labels)} images")
    head = ("solver", "range, median (cm)", "mean", "p90", "against all joints, 95 %", "direction, median (deg)")
    print("|", " | ".join((*head, "CS-MPJPE (mm)")), "|")
    print("| --- |", "---: | " * len(head))
    rng = np.random.default_rng(0)
    picks = rng.integers(0, len(labels), (RESAMPLES, len(labels)))
    base = np.where(counted, errors["all joints"][0], 0.0)
    for name, (range_cm, degrees, mm) in errors.items():
        difference = (np.where(counted, range_cm, 0.0) - base).sum(axis=1)  # (N,)
        means = difference[picks].sum(axis=1) / counted.sum(axis=1)[picks].sum(axis=1)
        low, high = np.percentile(means, (2.5, 97.5))
        cm = range_cm[counted]
        print(
            f"| {name} | {np.median(cm):.2f} | {cm.mean():.2f} | {np.percentile(cm, 90):.2f} "
            f"| {low:+.2f} to {high:+.2f} | {np.median(degrees[counted]):.3f} | {mm[counted].mean():.1f} |"
        )


if __name__ == "__main__":
    main(*sys.argv[1:3])
