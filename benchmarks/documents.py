"""Tables that benchmarks put into documents."""

from __future__ import annotations

from pathlib import Path

from twohands.cli.output import write_file
from twohands.errors import InputError
from twohands.evaluation.results import inserted


def insert(path: Path, text: str, marker: str) -> None:
    """Put text between a document's markers of a name (`evaluation.results.inserted`).

    Raises:
        InputError: the document cannot be read, or has one marker without the other.
        OSError: it cannot be written.
    """
    try:
        document = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    write_file(path, inserted(document, text, marker).encode())
