"""Queue length x degree of the range smoothing on predictions of video: which setting is the best, without a network.

Every setting runs the tracker over every sequence from its first frame on, as it would run live: the result of a frame
never depends on later ones.

Source: paper section 4.4 (silent on both numbers).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from twohands.errors import InputError
from twohands.evaluation.comparison import Protocol, compare, sequences, without_picture
from twohands.evaluation.predictions import Predictions
from twohands.evaluation.protocols import metrics_of
from twohands.evaluation.report import Metric, json_values
from twohands.inference.tracker import DEFAULT_SMOOTHING, HandTracker, RangeSmoothing
from twohands.types import HandSample, TwoHandPose

VERSION: Final = 2
LENGTHS: Final = (5, 8, 10, 15, 20)
DEGREES: Final = (1, 2, 3)
METRICS: Final = ("range_mean", "range_median", "range_3.5cm", "range_7cm", "cs_mpjpe", "acceleration_radial")


@dataclass(frozen=True, slots=True)
class SweepRow:
    """One setting.

    Attributes:
        length, degree, fade: of the queue (`RangeSmoothing`); None for the ranges as predicted.
        metrics: by key, of METRICS.
    """

    length: int | None
    degree: int | None
    fade: float | None
    metrics: dict[str, Metric]

    @property
    def name(self) -> str:
        """The setting in words."""
        if self.length is None:
            return "no smoothing"
        return f"queue {self.length}, degree {self.degree}" + (f", fade {self.fade:g}" if self.fade != 1 else "")


@dataclass(frozen=True, slots=True)
class Sweep:
    """All settings on one predictions file.

    Attributes:
        dataset, dataset_id, weights: as in the predictions.
        frames, sequences: how many.
        fps: frames a second.
        rows: the ranges as predicted first, the tracker's default last.
        command: what made it.
    """

    dataset: str
    dataset_id: str
    weights: str
    frames: int
    sequences: int
    fps: float
    rows: tuple[SweepRow, ...]
    command: str = ""

    def to_dict(self) -> dict[str, Any]:
        """JSON values; NaN becomes None."""
        return {
            "version": VERSION,
            "dataset": self.dataset,
            "dataset_id": self.dataset_id,
            "weights": self.weights,
            "frames": self.frames,
            "sequences": self.sequences,
            "fps": self.fps,
            "command": self.command,
            "rows": [
                {
                    "name": row.name,
                    "length": row.length,
                    "degree": row.degree,
                    "fade": row.fade,
                    "metrics": json_values(row.metrics),
                }
                for row in self.rows
            ],
        }


def smoothing_sweep(
    predictions: Predictions,
    samples: Iterable[HandSample],
    *,
    fps: float,
    lengths: Sequence[int] = LENGTHS,
    degrees: Sequence[int] = DEGREES,
    command: str = "",
) -> Sweep:
    """Scores plain regression (`RangeSmoothing.fade` 1) at every length and degree, no smoothing at all, and the
    tracker's default.

    Args:
        predictions: N frames; those of one folder are one sequence.
        samples: the N labelled frames in the same order; each is read once.
        fps: frames a second.
        lengths, degrees: settings to try, those with more coefficients than radii left out.
        command: handed through.

    Raises:
        InputError: ranges that are smoothed already, no sequence of three frames or more, settings out of range, or
            samples that are not those of the predictions.
    """
    if predictions.settings.get("smoothed"):
        raise InputError("these ranges are smoothed already; predict without --smooth")
    videos = sequences(predictions.sources)
    if max(len(frames) for frames in videos) < 3:
        raise InputError("no folder holds three frames or more: smoothing needs video, one folder a sequence")
    settings = [RangeSmoothing(n, degree, fade=1.0) for n in lengths for degree in degrees if n < 1 or degree < n]
    if not settings:
        raise InputError(f"no setting to try: every degree of {degrees} needs a longer queue than those of {lengths}")
    labels = [without_picture(sample) for sample, _ in zip(samples, predictions.sources, strict=False)]
    protocol = Protocol(fps=fps)
    raw = replace(predictions, masks_png=(b"",) * len(predictions))
    compare(raw, labels, protocol)  # refuses other data before anything else relies on the labels
    poses = [raw.pose(index, sample.camera) for index, sample in enumerate(labels)]

    def row(ranged: Predictions, smoothing: RangeSmoothing | None) -> SweepRow:
        no_pose = replace(ranged, canonical=np.full_like(ranged.canonical, np.nan))  # what smoothing leaves as it is
        metrics = {metric.key: metric for metric in metrics_of(compare(no_pose, labels, protocol))}
        setting = (None, None, None) if smoothing is None else (smoothing.length, smoothing.degree, smoothing.fade)
        return SweepRow(*setting, {key: metrics[key] for key in METRICS if key in metrics})

    settings.append(DEFAULT_SMOOTHING)
    rows = [row(raw, None), *(row(with_smooth_ranges(raw, poses, smoothing), smoothing) for smoothing in settings)]
    return Sweep(
        predictions.dataset,
        predictions.dataset_id,
        predictions.weights,
        len(predictions),
        len(videos),
        fps,
        tuple(rows),
        command,
    )


def with_smooth_ranges(
    predictions: Predictions, poses: Sequence[TwoHandPose], smoothing: RangeSmoothing = DEFAULT_SMOOTHING
) -> Predictions:
    """What the tracker makes of predictions, sequence by sequence.

    Args:
        predictions: N frames; those of one folder are one sequence.
        poses: the same as poses (`Predictions.pose`).
        smoothing: the setting.

    Returns:
        Predictions with other `joints_m` and `valid`.
    """
    joints_m, valid = predictions.joints_m.copy(), predictions.valid.copy()
    for frames in sequences(predictions.sources):
        tracker = HandTracker(smoothing, carried_frames=0)  # the same hands in all rows
        for number, index in enumerate(frames):
            pose = tracker.update(replace(poses[index], index=number))
            for side, hand in enumerate(pose.hands):
                valid[index, side] = hand.present and bool(hand.valid)
                joints_m[index, side] = np.nan if hand.joints_m is None else hand.joints_m
    return replace(predictions, joints_m=joints_m, valid=valid)
