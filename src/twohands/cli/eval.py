"""Measure the pipeline on a dataset: predictions are written first and scored later.

`predict` runs the networks and writes a predictions file, `score` scores such a file without any network, `run` does
both and keeps nothing unless asked to.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

from twohands.cli.output import write_file
from twohands.datasets.ego3dhands import Ego3DHands
from twohands.errors import InputError
from twohands.evaluation.metrics import hand_masks
from twohands.evaluation.predictions import (
    Predictions,
    check_predictions_path,
    load_predictions,
    predict,
    save_predictions,
)
from twohands.evaluation.protocols import evaluate
from twohands.evaluation.report import EvaluationReport, table_row
from twohands.geometry.boxes import box_from_points
from twohands.geometry.canonical import canonical_from_camera
from twohands.inference.estimator import HandEstimator, StageTruth
from twohands.inference.weights import DEFAULT_PRESET, NETWORK_NAMES, preset_folder
from twohands.types import HandSample, TwoHandPose

Stage = Literal["presence", "masks", "boxes", "joints-2d", "canonical"]
DatasetPath: TypeAlias = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DATASET")]


@dataclass(frozen=True)
class Predict:
    """Run the pipeline and write a predictions file."""

    dataset: DatasetPath
    """Folder in the Ego3DHands layout."""
    out: Path
    """Predictions file to write, ending in .npz."""
    weights: str = DEFAULT_PRESET
    """Preset that ships with the package, or a weights folder."""
    count: int | None = None
    """Only the first COUNT instances."""
    truth: tuple[Stage, ...] = ()
    """Stages to replace by ground truth, for isolated results."""
    overwrite: bool = False
    """Replace an existing predictions file."""


@dataclass(frozen=True)
class Score:
    """Score a predictions file; no network is run."""

    predictions: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="PREDICTIONS")]
    """Predictions file."""
    dataset: DatasetPath
    """The dataset it was made from."""
    report: Path | None = None
    """Write the report there: JSON for a name ending in .json, a Markdown table otherwise."""
    overwrite: bool = False
    """Replace an existing report."""


@dataclass(frozen=True)
class Run:
    """Run the pipeline, score it, print the table."""

    dataset: DatasetPath
    """Folder in the Ego3DHands layout."""
    weights: str = DEFAULT_PRESET
    """Preset that ships with the package, or a weights folder."""
    count: int | None = None
    """Only the first COUNT instances."""
    truth: tuple[Stage, ...] = ()
    """Stages to replace by ground truth, for isolated results."""
    report: Path | None = None
    """Write the report there: JSON for a name ending in .json, a Markdown table otherwise."""
    overwrite: bool = False
    """Replace an existing report."""


def run(args: Predict | Score | Run) -> int:
    """Carry out `twohands eval`."""
    dataset = Ego3DHands(args.dataset)
    if isinstance(args, Predict):
        check_predictions_path(args.out, overwrite=args.overwrite)
        predictions = _predict(dataset, args.weights, args.count, args.truth)
        save_predictions(args.out, predictions, overwrite=args.overwrite)
        print(f"{len(predictions)} predictions written to {args.out}")
        return 0
    if args.report is not None and args.report.exists() and not args.overwrite:
        raise InputError(f"{args.report}: exists already; choose another --report, or allow it with --overwrite")
    if isinstance(args, Score):
        predictions = load_predictions(args.predictions)
    else:
        predictions = _predict(dataset, args.weights, args.count, args.truth)
    report = evaluate(predictions, _samples(dataset, len(predictions), "scoring"))
    _print_report(report)
    if args.report is not None:
        text = json.dumps(report.to_dict(), indent=1) if args.report.suffix == ".json" else report.to_markdown()
        write_file(args.report, text.encode())
        print(f"report written to {args.report}")
    return 0


def _predict(dataset: Ego3DHands, weights: str, count: int | None, stages: tuple[Stage, ...]) -> Predictions:
    if count is not None and count < 1:
        raise InputError(f"--count must be at least 1, got {count}")
    estimator = HandEstimator.from_preset(weights)

    def estimate(sample: HandSample) -> TwoHandPose:
        return estimator.estimate(sample.image, sample.camera, dataset.hand_length_m, stage_truth(sample, stages))

    return predict(
        _samples(dataset, len(dataset) if count is None else min(count, len(dataset)), "predicting"),
        estimate,
        dataset=dataset.name,
        weights=f"{estimator.card.name}@{_digest(preset_folder(weights))}",
        settings={
            "card": asdict(estimator.card),
            "hand_length_m": dataset.hand_length_m,
            "camera": "the dataset's",
            "truth": list(stages),
        },
    )


def stage_truth(sample: HandSample, stages: tuple[Stage, ...]) -> StageTruth:
    """Ground truth for the stages named, taken from a sample's labels.

    Args:
        sample: a labelled image.
        stages: what to replace.

    Returns:
        What `HandEstimator.estimate` takes; all None for no stage.

    Raises:
        InputError: masks are asked for, but the sample has no part labels.
    """
    if "masks" in stages and sample.labels is None:
        raise InputError(f"{sample.source}: has no part labels to replace the masks by")
    return StageTruth(
        masks=hand_masks(sample.labels) if "masks" in stages and sample.labels is not None else None,
        boxes_px=np.asarray(box_from_points(sample.joints_px)) if "boxes" in stages else None,
        present=sample.present if "presence" in stages else None,
        joints_px=sample.joints_px if "joints-2d" in stages else None,
        canonical=np.asarray(canonical_from_camera(sample.joints_m).joints) if "canonical" in stages else None,
    )


def _samples(dataset: Ego3DHands, count: int, doing: str) -> Iterator[HandSample]:
    console = Console(stderr=True)
    indices = range(min(count, len(dataset)))
    for index in track(indices, doing, console=console, disable=not console.is_terminal, transient=True):
        yield dataset[index]


def _digest(folder: Path) -> str:
    """Identifies a set of weights by its networks' bytes."""
    digest = hashlib.sha256()
    for name in NETWORK_NAMES:
        digest.update((folder / f"{name}.onnx").read_bytes())
    return digest.hexdigest()[:12]


def _print_report(report: EvaluationReport) -> None:
    title = f"{report.dataset}: {report.images} images, labels {report.dataset_id}, weights {report.weights}"
    table = Table(title=title, title_justify="left")
    table.add_column("metric")
    for name in ("value", "left", "right"):
        table.add_column(name, justify="right")
    table.add_column("unit")
    table.add_column("count", justify="right")
    for metric in report.metrics:
        table.add_row(*table_row(metric))
    Console().print(table)
