"""`twohands eval sweep`: try settings of the range smoothing on predictions of video."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twohands.cli.eval.arguments import Data, DatasetPath, PredictionsPath, this_command
from twohands.cli.eval.console import print_table, with_progress
from twohands.cli.eval.files import read_own_json, refuse_existing
from twohands.cli.output import write_file
from twohands.datasets.opening import DatasetOptions, open_dataset
from twohands.evaluation.predictions import load_predictions
from twohands.evaluation.results import sweep_findings, sweep_table
from twohands.studies.smoothing_sweep import DEGREES, LENGTHS, VERSION, smoothing_sweep


@dataclass(frozen=True)
class Sweep:
    """Try settings of the range smoothing on predictions of video; no network is run."""

    predictions: PredictionsPath
    """Predictions file, made without --smooth; the frames of one folder are one sequence."""
    dataset: DatasetPath
    """The dataset it was made from."""
    data: Data = field(default_factory=DatasetOptions)
    fps: float = 30.0
    """Frames a second."""
    lengths: tuple[int, ...] = LENGTHS
    """Queue lengths, in frames."""
    degrees: tuple[int, ...] = DEGREES
    """Degrees of the polynomial."""
    out: Path | None = None
    """Write the sweep there as JSON, for `eval results --sweeps`."""
    overwrite: bool = False
    """Replace an existing file."""


def run(args: Sweep) -> int:
    """Carry out `twohands eval sweep`."""
    if args.out is not None:
        refuse_existing(args.out, args.overwrite, "--out")
    predictions = load_predictions(args.predictions)
    labels = open_dataset(args.dataset, args.data).labels
    sweep = smoothing_sweep(
        predictions,
        with_progress(labels, len(predictions), "reading labels"),
        fps=args.fps,
        lengths=args.lengths,
        degrees=args.degrees,
        command=this_command(),
    ).to_dict()
    print_table(f"{sweep['dataset']}: {sweep['frames']} frames, weights {sweep['weights']}", sweep_table(sweep))
    for line in sweep_findings(sweep):
        print(line)
    if args.out is not None:
        write_file(args.out, json.dumps(sweep, indent=1, allow_nan=False).encode())
        print(f"sweep written to {args.out}")
    return 0


def _checked_sweep(sweep: dict[str, Any]) -> dict[str, Any]:
    """The same if it can be set out."""
    if sweep["version"] != VERSION:
        raise ValueError(f"expected a sweep of version {VERSION}, got {sweep['version']}")
    _ = sweep_table(sweep), sweep_findings(sweep), [sweep[k] for k in ("dataset", "sequences", "fps", "command")]
    return sweep


def read_sweep(path: Path) -> dict[str, Any]:
    """A sweep of `twohands eval sweep`, ready to be set out.

    Raises:
        InputError: there is no such file.
        DataFormatError: it is something else, or of another version.
    """
    return read_own_json(path, _checked_sweep, "a sweep of twohands eval sweep")
