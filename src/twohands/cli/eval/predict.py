"""`twohands eval predict`: run a system and write a predictions file."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from twohands.cli.eval.arguments import Data, DatasetPath
from twohands.cli.eval.system import MeasuredSystem, System, predict_with
from twohands.datasets.opening import DatasetOptions, open_dataset
from twohands.evaluation.predictions import check_predictions_path, save_predictions


@dataclass(frozen=True)
class Predict:
    """Run a system and write a predictions file."""

    dataset: DatasetPath
    """Folder of the dataset (docs/datasets.md)."""
    out: Path
    """Predictions file to write, ending in .npz."""
    system: MeasuredSystem = field(default_factory=System)
    data: Data = field(default_factory=DatasetOptions)
    count: int | None = None
    """Only the first COUNT instances."""
    overwrite: bool = False
    """Replace an existing predictions file."""


def run(args: Predict) -> int:
    """Carry out `twohands eval predict`."""
    check_predictions_path(args.out, overwrite=args.overwrite)
    dataset = open_dataset(args.dataset, args.data)
    predictions = predict_with(dataset, args.system, args.count)
    save_predictions(args.out, predictions, overwrite=args.overwrite)
    print(f"{len(predictions)} predictions written to {args.out}")
    return 0
