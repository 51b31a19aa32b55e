"""Files that appear whole or not at all, in folders that are asked about first."""

from __future__ import annotations

import os
from pathlib import Path

from twohands.errors import InputError
from twohands.files import write_whole


def check_output_folder(folder: Path, *, overwrite: bool) -> None:
    """See, before any work is done, whether results may go to a folder; nothing is created yet.

    Args:
        folder: where results are to go.
        overwrite: whether a folder that holds something already is welcome.

    Raises:
        InputError: it cannot be made or written, or it is not empty and `overwrite` is False.
    """
    existing = folder
    while not os.path.lexists(existing) and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        raise InputError(f"output {folder}: {existing} is a file, not a folder; choose another --out")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise InputError(f"output {folder}: no permission to write to {existing}; choose another --out")
    try:
        taken = not overwrite and existing == folder and any(folder.iterdir())
    except OSError as error:
        raise InputError(f"output {folder}: cannot be read: {error.strerror}; choose another --out") from error
    if taken:
        raise InputError(f"output {folder} is not empty; choose another --out, or allow it with --overwrite")


def write_file(path: Path, content: bytes) -> None:
    """Write a file so that it appears whole or not at all; folders are made.

    Raises:
        InputError: it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error


def page_bytes(page: str) -> bytes:
    """UTF-8 of a page; bytes of file names that are no text are written as escapes, as on the terminal."""
    return page.encode(errors="backslashreplace")
