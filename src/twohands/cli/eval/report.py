"""`twohands eval report`: set predictions side by side, as JSON, Markdown and one page with pictures."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

from twohands.cli.eval.arguments import Data, DatasetPath, Rules, ScoringRules, protocol_of, this_command
from twohands.cli.eval.budget import read_budget
from twohands.cli.eval.console import with_progress
from twohands.cli.output import check_output_folder, page_bytes, write_file
from twohands.datasets.opening import DatasetOptions, open_dataset
from twohands.errors import InputError
from twohands.evaluation.comparison import Comparison, compare
from twohands.evaluation.predictions import Predictions, load_predictions
from twohands.evaluation.summary import Summary, summarise


@dataclass(frozen=True)
class Report:
    """Set predictions side by side: report.json, report.md and one self-contained report.html."""

    dataset: DatasetPath
    """The dataset that all predictions were made from."""
    predictions: tuple[Path, ...]
    """Predictions files; the first is the system that pictures show."""
    out: Path
    """Folder of the report."""
    names: tuple[str, ...] = ()
    """Short names for the columns, one for each file; the files' names if not given."""
    data: Data = field(default_factory=DatasetOptions)
    rules: ScoringRules = field(default_factory=Rules)
    budget: Path | None = None
    """Error budget to include, from `eval budget --out`."""
    cases: int = 6
    """How many of the worst hands to show, and of the missed and invented ones."""
    note: tuple[str, ...] = ()
    """Remarks for the reader."""
    overwrite: bool = False
    """Replace an existing report."""


def run(args: Report) -> int:
    """Carry out `twohands eval report`."""
    from twohands.visualization.evaluation_page import render_page, typical_images, worst_hands

    check_output_folder(args.out, overwrite=args.overwrite)
    files = [load_predictions(path) for path in args.predictions]
    if not files:
        raise InputError("--predictions needs at least one file")
    if args.cases < 0:
        raise InputError(f"--cases must be at least 0, got {args.cases}")
    names = args.names or tuple(path.stem for path in args.predictions)
    if len(names) != len(files) or len(set(names)) != len(names):
        raise InputError(f"--names must be {len(files)} different names, one for each file, got {', '.join(names)}")
    if len({len(file) for file in files}) > 1:
        raise InputError(
            f"the files hold {', '.join(str(len(file)) for file in files)} images; they must hold the same"
        )
    dataset = open_dataset(args.dataset, args.data)
    protocol = protocol_of(dataset, args.rules)
    compared: list[tuple[str, Predictions, Comparison]] = []
    for name, file in zip(names, files, strict=True):
        compared.append(
            (name, file, compare(file, with_progress(dataset.labels, len(file), f"scoring {name}"), protocol))
        )
    budget = None if args.budget is None else read_budget(args.budget, files[0], dataset.labels)
    notes = args.note
    if len(files[0]) < len(dataset.samples):
        notes = (*notes, f"Only the first {len(files[0])} of {len(dataset.samples)} images.")
    summary = summarise(dataset.kind, compared, protocol, budget=budget, command=this_command(), notes=notes)
    first = compared[0][2]

    def case(index: int, caption: str, side: int | None = None):
        from twohands.visualization.evaluation_page import Case

        sample = dataset.samples[index]
        return Case(sample, files[0].pose(index, sample.camera), caption, side)

    typical = [case(index, caption) for index, caption in typical_images(first)]
    worst = [case(index, caption, side) for index, side, caption in worst_hands(first, args.cases)]
    page = render_page(summary, typical, worst)
    _write_report(args, summary, page)
    return 0


def _write_report(args: Report, summary: Summary, page: str) -> None:
    files = {
        "report.json": json.dumps(summary.to_dict(), indent=1, allow_nan=False).encode(),
        "report.md": page_bytes(summary.to_markdown()),
        "report.html": page_bytes(page),
    }
    for name, content in files.items():
        write_file(args.out / name, content)
    print(f"report.json, report.md and report.html written to {args.out}")
