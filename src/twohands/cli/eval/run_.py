"""`twohands eval run`: run a system and score it; predictions are not kept."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from twohands.cli.eval.arguments import Data, DatasetPath, Rules, ScoringRules
from twohands.cli.eval.files import refuse_existing
from twohands.cli.eval.score import score
from twohands.cli.eval.system import MeasuredSystem, System, predict_with
from twohands.datasets.opening import DatasetOptions, open_dataset


@dataclass(frozen=True)
class Run:
    """Run a system, score it, print the table."""

    dataset: DatasetPath
    """Folder of the dataset (docs/datasets.md)."""
    system: MeasuredSystem = field(default_factory=System)
    data: Data = field(default_factory=DatasetOptions)
    rules: ScoringRules = field(default_factory=Rules)
    count: int | None = None
    """Only the first COUNT instances."""
    report: Path | None = None
    """Write the report there: JSON for a name ending in .json, a Markdown table otherwise."""
    overwrite: bool = False
    """Replace an existing report."""


def run(args: Run) -> int:
    """Carry out `twohands eval run`."""
    if args.report is not None:
        refuse_existing(args.report, args.overwrite, "--report")
    dataset = open_dataset(args.dataset, args.data)
    score(predict_with(dataset, args.system, args.count), dataset, args.rules, args.report)
    return 0
