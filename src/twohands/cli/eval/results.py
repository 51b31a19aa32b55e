"""`twohands eval results`: make one Markdown page of finished reports and sweeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from twohands.cli.eval.arguments import this_command
from twohands.cli.eval.files import read_own_json, refuse_existing
from twohands.cli.eval.sweep import read_sweep
from twohands.cli.output import page_bytes, write_file
from twohands.errors import InputError
from twohands.evaluation.results import headlines, inserted, results_page
from twohands.evaluation.summary import Summary


@dataclass(frozen=True)
class Results:
    """Make one Markdown page of finished reports and sweeps; docs/results/generated.md is made like this."""

    reports: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="REPORT")]
    """Files report.json of `eval report`, one section each."""
    out: Path
    """Markdown file to write."""
    sweeps: tuple[Path, ...] = ()
    """Files of `eval sweep --out`."""
    insert: Path | None = None
    """A Markdown file that gets the headlines, between its markers "generated sets"."""
    note: tuple[str, ...] = ()
    """Remarks for the reader."""
    overwrite: bool = False
    """Replace an existing page."""


def run(args: Results) -> int:
    """Carry out `twohands eval results`."""
    refuse_existing(args.out, args.overwrite, "--out")
    summaries = [
        read_own_json(path, Summary.from_dict, "a report.json of twohands eval report") for path in args.reports
    ]
    if not summaries:
        raise InputError("at least one report.json is needed")
    sweeps = [read_sweep(path) for path in args.sweeps]
    page = results_page(summaries, sweeps, command=this_command(), notes=args.note)
    short = None if args.insert is None else _with_headlines(args.insert, summaries)
    write_file(args.out, page_bytes(page))
    if args.insert is not None and short is not None:
        write_file(args.insert, page_bytes(short))
    print(f"{len(summaries)} reports and {len(sweeps)} sweeps set out in {args.out}")
    return 0


def _with_headlines(path: Path, summaries: Sequence[Summary]) -> str:
    """The document with these headlines."""
    try:
        return inserted(path.read_text(encoding="utf-8"), headlines(summaries), "generated sets")
    except (OSError, UnicodeError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None
