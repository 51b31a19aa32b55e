"""`twohands eval import`: turn another system's predictions into a predictions file."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from twohands.cli.eval.arguments import Data, DatasetPath, count_of
from twohands.cli.eval.console import with_progress
from twohands.datasets.opening import DatasetOptions, open_dataset
from twohands.errors import InputError
from twohands.evaluation.importing import import_predictions, read_foreign
from twohands.evaluation.predictions import check_predictions_path, save_predictions


@dataclass(frozen=True)
class Import:
    """Turn another system's predictions (.json or .npz) into a predictions file."""

    foreign: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")]
    """Its predictions; the format is in docs/evaluation.md."""
    dataset: DatasetPath
    """The dataset they are about."""
    out: Path
    """Predictions file to write, ending in .npz."""
    data: Data = field(default_factory=DatasetOptions)
    count: int | None = None
    """They are about the first COUNT instances only."""
    hand_length_cm: float | None = None
    """Hand length (wrist to middle knuckle) where a range must be solved; each labelled hand's own if not given."""
    overwrite: bool = False
    """Replace an existing predictions file."""


def run(args: Import) -> int:
    """Carry out `twohands eval import`."""
    check_predictions_path(args.out, overwrite=args.overwrite)
    if args.hand_length_cm is not None and not args.hand_length_cm > 0:
        raise InputError(f"--hand-length-cm must be above 0, got {args.hand_length_cm}")
    foreign = read_foreign(args.foreign)
    samples = open_dataset(args.dataset, args.data).labels
    predictions = import_predictions(
        foreign,
        with_progress(samples, count_of(args.count, samples), "importing"),
        dataset=samples.name,
        hand_length_m=None if args.hand_length_cm is None else args.hand_length_cm / 100,
    )
    save_predictions(args.out, predictions, overwrite=args.overwrite)
    print(f"{len(predictions)} predictions of '{foreign.system}' written to {args.out}")
    return 0
