"""What a person sees while `twohands eval` works, and the tables at its end."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import Console
from rich.progress import track
from rich.table import Table
from rich.text import Text

from twohands.datasets.base import HandDataset
from twohands.datasets.read_ahead import read_ahead
from twohands.evaluation.summary import Table as TextTable
from twohands.evaluation.summary import is_number
from twohands.types import HandSample


def with_progress(dataset: HandDataset, count: int, doing: str) -> Iterator[HandSample]:
    """The first `count` samples, read ahead, with a bar on a terminal that says what is being done."""
    console = Console(stderr=True)
    samples = read_ahead(dataset, min(count, len(dataset)))
    return iter(
        track(
            samples,
            doing,
            total=min(count, len(dataset)),
            console=console,
            disable=not console.is_terminal,
            transient=True,
        )
    )


def print_table(title: str, rows: TextTable) -> None:
    """Print a table whose first row names its columns."""
    table = Table(title=Text(title), title_justify="left")  # names of folders may look like markup
    for column, name in enumerate(rows[0]):
        numbers = all(is_number(row[column]) for row in rows[1:])
        table.add_column(name, justify="right" if numbers else "left")
    for row in rows[1:]:
        table.add_row(*row)
    Console().print(table)
