"""Check a dataset in the Ego3DHands layout, ours or the official one: integrity, counts, contact sheet, and a page of
charts of how its hands are distributed.

Exit code 0: sound. 1: problems were found, and are listed. 2: nothing there to inspect.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import tyro
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress
from rich.table import Table

from twohands.cli.output import check_output_folder, page_bytes, write_file
from twohands.datasets.ego3dhands import Ego3DHands
from twohands.datasets.inspection.contact_sheet import contact_sheet
from twohands.datasets.inspection.inspect import DatasetReport, inspect_dataset
from twohands.datasets.shards import ShardedEgo3DHands, open_ego3dhands
from twohands.errors import InputError
from twohands.types import HandSample
from twohands.visualization.dataset_page import dataset_page, summary

AnyDataset = Ego3DHands | ShardedEgo3DHands
EXIT_PROBLEMS = 1
SHEET_NAME = "contact_sheet.png"
PAGE_NAME = "report.html"


@dataclass(frozen=True)
class InspectArgs:
    """Arguments of `twohands inspect`."""

    dataset: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DATASET")]
    """Any folder above instances (folders containing location_2d.npy), one instance, or a folder of tar shards."""
    beside: Path | None = None
    """Another dataset, to be shown in the same charts."""
    out: Path | None = None
    """Folder for contact sheet and report.html, where earlier ones are replaced; default out/inspect/<name of the
    dataset>."""
    count: int = 24
    """Number of instances on the contact sheet, spread over the dataset."""
    problems: int = 20
    """How many problems to print in full."""


def run(args: InspectArgs) -> int:
    """Carry out `twohands inspect`."""
    if args.count < 1 or args.problems < 0:
        raise InputError(f"--count must be at least 1 and --problems at least 0, got {args.count}, {args.problems}")
    console = Console()
    datasets = [open_ego3dhands(path) for path in (args.dataset, args.beside) if path is not None]
    out = args.out or Path("out") / "inspect" / datasets[0].name
    check_output_folder(out, overwrite=True)
    reports = [_inspect(dataset, console) for dataset in datasets]
    for report in reports:
        _print(report, args.problems, console)
    sheets = [_sheet(dataset, report, args.count) for dataset, report in zip(datasets, reports, strict=True)]
    if sheets[0] is not None:
        picture = cv2.imencode(".png", cv2.cvtColor(sheets[0], cv2.COLOR_RGB2BGR))[1].tobytes()
        write_file(out / SHEET_NAME, picture)
        console.print(f"contact sheet written to {escape(str(out / SHEET_NAME))}", soft_wrap=True, highlight=False)
    write_file(out / PAGE_NAME, page_bytes(dataset_page(reports, sheets)))
    console.print(f"report written to {escape(str(out / PAGE_NAME))}", soft_wrap=True, highlight=False)
    return EXIT_PROBLEMS if any(report.problems for report in reports) else 0


class _Without:
    """A dataset without its damaged instances, which may not even be readable."""

    def __init__(self, dataset: AnyDataset, damaged: set[str]) -> None:
        self._dataset = dataset
        self._indices = [i for i in range(len(dataset)) if dataset.source(i) not in damaged]
        self.name = dataset.name

    def __len__(self) -> int:
        return len(self._indices)

    def __getitem__(self, index: int) -> HandSample:
        return self._dataset[self._indices[index]]


def _inspect(dataset: AnyDataset, console: Console) -> DatasetReport:
    return _with_progress(console, len(dataset), lambda on_progress: inspect_dataset(dataset, on_progress))


def _sheet(dataset: AnyDataset, report: DatasetReport, count: int) -> np.ndarray | None:
    """(H, W, 3) uint8 RGB of sound instances, None if there is none."""
    sound = _Without(dataset, {problem.source for problem in report.problems})
    return contact_sheet(sound, count) if len(sound) else None


def _print(report: DatasetReport, problems: int, console: Console) -> None:
    console.print(_table(report))
    for problem in report.problems[:problems]:
        what = escape(f"{problem.source}: {problem.message}")
        console.print(f"[red]problem[/red] {what}", soft_wrap=True, highlight=False)
    if len(report.problems) > problems:
        console.print(f"... and {len(report.problems) - problems} more problems (--problems N shows more)")


def _with_progress(
    console: Console, total: int, work: Callable[[Callable[[int], None]], DatasetReport]
) -> DatasetReport:
    with Progress(console=Console(stderr=True), transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("inspecting", total=total)
        return work(lambda done: progress.update(task, completed=done))


def _table(report: DatasetReport) -> Table:
    table = Table(title=escape(f"dataset {report.name}"), title_justify="left", show_header=False)
    table.add_column("what")
    table.add_column("value")
    for what, value in summary(report):
        table.add_row(what, f"[red]{escape(value)}[/red]" if what == "problems" and report.problems else escape(value))
    return table
