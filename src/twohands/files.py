"""Files of the machine: read at once up to a limit, and written so that they appear whole or not at all."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from twohands.errors import InputError


def read_file(path: Path, limit: int, what: str = "file") -> bytes:
    """A file's content.

    Args:
        path: the file.
        limit: bytes that it may have; one more is read of a larger one, so that the caller can tell.
        what: it is, for the message of one that is not there: "camera file".

    Raises:
        InputError: there is no such file, or it cannot be read.
    """
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size or limit  # 0 of pipes; no room for what is not there
            return file.read(min(size, limit) + 1)
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such {what}") from error
    except (OSError, ValueError) as error:  # ValueError: a name with a zero byte
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error


def partial_path(path: Path) -> Path:
    """Where a file is put together; what lies there was left by a process that was killed."""
    return path.with_name(f".{path.name}.partial")


@contextlib.contextmanager
def appearing(path: Path) -> Iterator[Path]:
    """The place where a file is put together, `partial_path`; it takes its own place when the block ends, and an old
    one's with it. After an error nothing of it is left.

    Raises:
        OSError: it cannot be put in its place.
    """
    partial = partial_path(path)
    try:
        yield partial
        os.replace(partial, path)
    except BaseException:
        with contextlib.suppress(OSError):  # of the error that brought us here, not of this one
            partial.unlink(missing_ok=True)
        raise


def write_whole(path: Path, content: bytes) -> None:
    """Writes a file so that it appears whole or not at all; an old one is replaced.

    Raises:
        OSError: it cannot be written.
    """
    with appearing(path) as partial:
        partial.write_bytes(content)


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Holds an advisory lock on a folder, which unlike the files in it is never replaced; the system lets go of it when
    the process ends, however it ends.

    Raises:
        InputError: another process holds it.
    """
    try:
        import fcntl
    except ImportError:  # Windows has other locks; two runs in one folder are then the user's to avoid
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"another process is writing to {folder}: wait for it, or stop it") from None
        except OSError:  # some network file systems know no locks
            pass
        yield
    finally:
        os.close(descriptor)


def let_others_read(path: Path) -> None:
    """Give a file that was made private, as temporary ones are, the permissions of any other new file: what the
    process's umask allows."""
    mask = os.umask(0)
    os.umask(mask)
    os.chmod(path, 0o666 & ~mask)
