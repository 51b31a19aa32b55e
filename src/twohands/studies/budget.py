"""The error budget: what each stage costs, when all before it are perfect.

A study runs the pipeline with some stages replaced by labels. Along the chain, each study estimates one stage more than
the one it is compared with; the difference is what that stage costs. The last step, the global projection, is run twice
on every study's results: with the paper's key bone, and fitted to all joints.

Source: paper section 5 (isolated results); the budget is ours.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from twohands.evaluation.comparison import DEFAULT_PROTOCOL, Protocol, compare, without_picture
from twohands.evaluation.completion import hand_lengths_m
from twohands.evaluation.predictions import Predictions, predict
from twohands.evaluation.protocols import metrics_of
from twohands.evaluation.report import Metric, json_values
from twohands.geometry.projection import Method, project_global, range_weights
from twohands.studies.ground_truth import Stage
from twohands.types import HandSample, PinholeCamera, TwoHandPose

VERSION: Final = 2
METHODS: Final[tuple[Method, Method]] = ("keybone", "fitted")


@dataclass(frozen=True, slots=True)
class Study:
    """One run of the pipeline with some stages replaced.

    Attributes:
        key: stable name for programs.
        name: what is estimated.
        truth: the stages that are replaced by labels.
        against: key of the study that estimates one stage less; None for the first.
        stage: the stage that this study adds to that one.
    """

    key: str
    name: str
    truth: tuple[Stage, ...]
    against: str | None = None
    stage: str = ""


STUDIES: Final = (
    Study("global", "global step alone", ("presence", "masks", "boxes", "joints-2d", "heatmaps", "canonical")),
    Study("2d", "PoseNet2D", ("presence", "masks", "boxes", "canonical"), "global", "2D joints"),
    Study(
        "3d-true-maps",
        "PoseNet3D, true heatmaps",
        ("presence", "masks", "boxes", "joints-2d", "heatmaps"),
        "global",
        "3D pose, perfect maps",
    ),
    Study(
        "3d",
        "PoseNet3D, estimated heatmaps",
        ("presence", "masks", "boxes", "joints-2d"),
        "3d-true-maps",
        "maps not perfect",
    ),
    Study("pose", "both pose networks", ("presence", "masks", "boxes"), "2d", "3D pose"),
    Study("masks", "... and masks", ("presence", "boxes"), "pose", "masks"),
    Study("boxes", "... and boxes", ("presence",), "masks", "boxes"),
    Study("complete", "complete", (), "boxes", "presence"),
)


def studies_without_masks() -> tuple[Study, ...]:
    """The studies for data sets without part labels: masks are estimated in all of them but the first."""
    kept = [study for study in STUDIES if study.key != "masks"]
    found = [replace(study, truth=tuple(s for s in study.truth if s != "masks")) for study in kept]
    return tuple(replace(s, against="pose") if s.against == "masks" else s for s in found)


@dataclass(frozen=True, slots=True)
class BudgetRow:
    """One study's result.

    Attributes:
        study: which one.
        metrics: by method of the global step, every metric by key.
    """

    study: Study
    metrics: dict[Method, dict[str, Metric]]


@dataclass(frozen=True, slots=True)
class Budget:
    """The whole budget of one set of weights on one data set.

    Attributes:
        dataset, dataset_id, weights: as in predictions.
        images: number of images.
        rows: one a study.
        notes: what a reader must know.
        command: what made it.
    """

    dataset: str
    dataset_id: str
    weights: str
    images: int
    rows: tuple[BudgetRow, ...]
    notes: tuple[str, ...] = field(default=())
    command: str = ""

    def to_dict(self) -> dict[str, Any]:
        """JSON values; NaN becomes None."""
        return {
            "version": VERSION,
            "dataset": self.dataset,
            "dataset_id": self.dataset_id,
            "weights": self.weights,
            "images": self.images,
            "command": self.command,
            "notes": list(self.notes),
            "rows": [
                {
                    "study": row.study.key,
                    "estimated": row.study.name,
                    "truth": list(row.study.truth),
                    "against": row.study.against,
                    "stage": row.study.stage,
                    "metrics": {method: json_values(row.metrics[method]) for method in METHODS},
                }
                for row in self.rows
            ],
        }


def error_budget(
    samples: Iterable[HandSample],
    estimator_of: Callable[[Study], Callable[[HandSample], TwoHandPose]],
    *,
    dataset: str,
    weights: str,
    studies: Sequence[Study] = STUDIES,
    protocol: Protocol = DEFAULT_PROTOCOL,
    notes: tuple[str, ...] = (),
    command: str = "",
) -> Budget:
    """Runs all studies.

    Args:
        samples: labelled images; each is read once.
        estimator_of: the pipeline with a study's stages replaced.
        dataset, weights: for the report.
        studies: which ones; the ones they are compared with must come first.
        protocol: what counts.
        notes, command: handed through.

    Returns:
        The budget.

    Raises:
        DataFormatError: there is no sample.
    """
    estimates = [estimator_of(study) for study in studies]
    poses: list[list[TwoHandPose]] = [[] for _ in studies]
    labels: list[HandSample] = []
    for sample in samples:
        for found, estimate in zip(poses, estimates, strict=True):
            found.append(estimate(sample).without_masks())  # neither masks nor pictures are kept in memory
        labels.append(without_picture(sample))
    cameras = [sample.camera for sample in labels]
    lengths = np.array([hand_lengths_m(sample) for sample in labels])
    rows: list[BudgetRow] = []
    identity = ""
    for study, found in zip(studies, poses, strict=True):
        said = iter(found)
        predictions = predict(
            labels, lambda _, said=said: next(said), dataset=dataset, weights=weights, settings={"study": study.key}
        )
        metrics: dict[Method, dict[str, Metric]] = {}
        for method in METHODS:
            placed = solved_again(predictions, cameras, lengths, method)
            metrics[method] = {metric.key: metric for metric in metrics_of(compare(placed, labels, protocol))}
        rows.append(BudgetRow(study, metrics))
        identity = predictions.dataset_id
    return Budget(dataset, identity, weights, len(labels), tuple(rows), notes, command)


def solved_again(
    predictions: Predictions, cameras: Sequence[PinholeCamera], hand_lengths_m: np.ndarray, method: Method
) -> Predictions:
    """The same 2D joints and canonical poses, placed in the camera frame by another method.

    Args:
        predictions: N images.
        cameras: N intrinsics.
        hand_lengths_m: (N, 2) metres.
        method: as `project_global`.

    Returns:
        Predictions with other `joints_m` and `valid`; masks are left out.
    """
    joints_m = np.full_like(predictions.joints_m, np.nan)
    valid = np.zeros_like(predictions.valid)
    weights = range_weights(predictions.joint_scores)
    for index, camera in enumerate(cameras):
        pose = project_global(
            predictions.canonical[index],
            predictions.joints_px[index],
            camera,
            hand_lengths_m[index],
            method=method,
            weights=None if method == "keybone" else weights[index],
        )
        valid[index] = predictions.present[index] & np.asarray(pose.valid)
        joints_m[index] = np.where(valid[index][:, None, None], pose.joints_m, np.nan)
    no_masks = (b"",) * len(predictions)
    return replace(predictions, joints_m=joints_m, valid=valid, masks_png=no_masks)
