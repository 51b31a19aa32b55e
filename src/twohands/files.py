"""Files that appear whole or not at all, as readable as any other."""

from __future__ import annotations

import os
from pathlib import Path


def partial_path(path: Path) -> Path:
    """Where a file is put together; what lies there was left by a process that was killed."""
    return path.with_name(f".{path.name}.partial")


def write_whole(path: Path, content: bytes) -> None:
    """Writes a file so that it appears whole or not at all; an old one is replaced.

    Raises:
        OSError: it cannot be written.
    """
    partial = partial_path(path)
    try:
        partial.write_bytes(content)
        os.replace(partial, path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def let_others_read(path: Path) -> None:
    """Give a file that was made private, as temporary ones are, the permissions of any other new file: what the
    process's umask allows."""
    mask = os.umask(0)
    os.umask(mask)
    os.chmod(path, 0o666 & ~mask)
