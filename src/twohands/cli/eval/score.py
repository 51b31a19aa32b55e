"""`twohands eval score`: score a predictions file, without any network."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

from twohands.cli.eval.arguments import Data, DatasetPath, PredictionsPath, Rules, ScoringRules, protocol_of
from twohands.cli.eval.console import print_table, with_progress
from twohands.cli.eval.files import refuse_existing
from twohands.cli.output import page_bytes, write_file
from twohands.datasets.opening import DatasetOptions, OpenedDataset, open_dataset
from twohands.evaluation.predictions import Predictions, load_predictions
from twohands.evaluation.protocols import evaluate
from twohands.evaluation.report import EvaluationReport, table_row


@dataclass(frozen=True)
class Score:
    """Score a predictions file; no network is run."""

    predictions: PredictionsPath
    """Predictions file."""
    dataset: DatasetPath
    """The dataset it was made from."""
    data: Data = field(default_factory=DatasetOptions)
    rules: ScoringRules = field(default_factory=Rules)
    report: Path | None = None
    """Write the report there: JSON for a name ending in .json, a Markdown table otherwise."""
    overwrite: bool = False
    """Replace an existing report."""


def run(args: Score) -> int:
    """Carry out `twohands eval score`."""
    if args.report is not None:
        refuse_existing(args.report, args.overwrite, "--report")
    predictions = load_predictions(args.predictions)
    score(predictions, open_dataset(args.dataset, args.data), args.rules, args.report)
    return 0


def score(predictions: Predictions, dataset: OpenedDataset, rules: Rules, path: Path | None) -> None:
    """Score predictions, print the table, and write the report if a `path` is given."""
    report = evaluate(
        predictions, with_progress(dataset.labels, len(predictions), "scoring"), protocol_of(dataset, rules)
    )
    _print_report(report)
    if len(predictions) < len(dataset.samples):
        print(f"only the first {len(predictions)} of {len(dataset.samples)} images")
    if path is not None:
        as_json = path.suffix == ".json"
        text = json.dumps(report.to_dict(), indent=1, allow_nan=False) if as_json else report.to_markdown()
        write_file(path, page_bytes(text))
        print(f"report written to {path}")


def _print_report(report: EvaluationReport) -> None:
    title = f"{report.dataset}: {report.images} images, labels {report.dataset_id}, weights {report.weights}"
    head = ["metric", "value", "left", "right", "unit", "count"]
    print_table(title, [head, *(list(table_row(metric)) for metric in report.metrics)])
