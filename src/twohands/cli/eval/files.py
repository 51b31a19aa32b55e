"""Files that `twohands eval` has written and reads again, and those that it is about to write."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from twohands.cli.output import check_output_folder
from twohands.errors import DataFormatError, InputError
from twohands.formats.structured import parse_json

Read = TypeVar("Read")


def read_own_json(path: Path, read: Callable[[dict[str, Any]], Read], what: str) -> Read:
    """A JSON file that `twohands eval` has written, through `read`.

    Raises:
        InputError: there is no such file.
        DataFormatError: it is not `what` it should be, or of another version.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        return read(parse_json(path.read_bytes()))
    except (OSError, DataFormatError, ValueError, KeyError, TypeError, AttributeError, StopIteration) as error:
        reason = f" ({error})" if isinstance(error, ValueError | DataFormatError) else ""
        raise DataFormatError(f"{path}: not {what}{reason}") from None


def refuse_existing(path: Path, overwrite: bool, option: str) -> None:
    """See, before any work is done, whether a file may be written.

    Raises:
        InputError: it is there already and may not be replaced, or its folder cannot be written.
    """
    check_output_folder(path.parent, overwrite=True)
    if path.exists() and not overwrite:
        raise InputError(f"{path}: exists already; choose another {option}, or allow it with --overwrite")
