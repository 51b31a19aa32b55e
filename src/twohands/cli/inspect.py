"""Check a dataset in the Ego3DHands layout: integrity, counts, contact sheet.

Exit code 0: sound. 1: problems were found, and are listed. 2: nothing there to inspect.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import cv2
import tyro
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from twohands.cli.output import write_file
from twohands.datasets.contact_sheet import contact_sheet
from twohands.datasets.ego3dhands import Ego3DHands
from twohands.datasets.inspect import DatasetReport, inspect_dataset
from twohands.errors import InputError

EXIT_PROBLEMS = 1
SHEET_NAME = "contact_sheet.png"


@dataclass(frozen=True)
class InspectArgs:
    """Arguments of `twohands inspect`."""

    dataset: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DATASET")]
    """Any folder above instances (folders containing location_2d.npy), or one instance."""
    out: Path | None = None
    """Folder for the contact sheet, where an earlier sheet is replaced; default out/inspect/<name of the dataset>."""
    count: int = 24
    """Number of instances on the contact sheet, spread over the dataset."""
    problems: int = 20
    """How many problems to print in full."""


def run(args: InspectArgs) -> int:
    """Carry out `twohands inspect`."""
    if args.count < 1 or args.problems < 0:
        raise InputError(f"--count must be at least 1 and --problems at least 0, got {args.count}, {args.problems}")
    dataset = Ego3DHands(args.dataset)
    console = Console()
    report = _with_progress(console, len(dataset), lambda on_progress: inspect_dataset(dataset, on_progress))
    console.print(_table(report))
    for problem in report.problems[: args.problems]:
        console.print(f"[red]problem[/red] {problem.source}: {problem.message}", soft_wrap=True, highlight=False)
    if len(report.problems) > args.problems:
        console.print(f"... and {len(report.problems) - args.problems} more problems (--problems N shows more)")
    damaged = {problem.source for problem in report.problems}
    sound = _Without(dataset, damaged)
    if len(sound):
        out = (args.out or Path("out") / "inspect" / dataset.name) / SHEET_NAME
        sheet = contact_sheet(sound, args.count)
        write_file(out, cv2.imencode(".png", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))[1].tobytes())
        console.print(f"contact sheet written to {out}", soft_wrap=True, highlight=False)
    return EXIT_PROBLEMS if report.problems else 0


class _Without:
    """A dataset without its damaged instances, which may not even be readable."""

    def __init__(self, dataset: Ego3DHands, damaged: set[str]) -> None:
        self._dataset = dataset
        self._indices = [i for i in range(len(dataset)) if dataset.source(i) not in damaged]
        self.name = dataset.name

    def __len__(self) -> int:
        return len(self._indices)

    def __getitem__(self, index: int):
        return self._dataset[self._indices[index]]


def _with_progress(
    console: Console, total: int, work: Callable[[Callable[[int], None]], DatasetReport]
) -> DatasetReport:
    with Progress(console=Console(stderr=True), transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("inspecting", total=total)
        return work(lambda done: progress.update(task, completed=done))


def _table(report: DatasetReport) -> Table:
    table = Table(title=f"dataset {report.name}", title_justify="left", show_header=False)
    table.add_column("what")
    table.add_column("value")
    low, median, high = (100 * value for value in report.range_m)
    rows = [
        ("instances", str(report.instances)),
        ("skipped folders", str(report.skipped)),
        ("hands", ", ".join(f"{name} {count}" for name, count in report.presence.items())),
        ("image sizes", ", ".join(f"{w}x{h}: {count}" for (w, h), count in report.image_sizes.items())),
        ("missing files", ", ".join(f"{name}: {count}" for name, count in report.missing_files.items()) or "none"),
        ("root joint's range", f"{low:.1f} to {high:.1f} cm, median {median:.1f} cm"),
        ("joints outside the image", f"{100 * report.joints_outside:.1f} %"),
        ("2D joints from projected 3D", f"{report.reprojection_px:.2g} px at most"),
        ("joints below the visible surface", f"{1e3 * report.surface_gap_m:.1f} mm (median)"),
        ("problems", f"[red]{len(report.problems)}[/red]" if report.problems else "none"),
    ]
    if math.isnan(report.reprojection_px):
        rows = [row for row in rows if not row[1].startswith("nan")]
    for row in rows:
        table.add_row(*row)
    return table
