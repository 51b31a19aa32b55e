"""What a command sets up around itself: how it ends, where others keep their caches, how warnings are said."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import sys
import tempfile
import threading
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from twohands.errors import PlausibilityWarning

ENDING_SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGXCPU") if hasattr(signal, name)
)  # Windows has fewer
"""Sent by `docker stop`, a scheduler, a terminal that is closed, a limit on processor time."""
AGAIN_S = 0.05
"""Until an end that was lost is asked for again."""
MOST_WARNINGS = 8
"""That one command says."""


class EndedBySignal(KeyboardInterrupt):
    """Another signal than Ctrl-C that asks the process to end; what is done is saved as after Ctrl-C.

    Args:
        number: of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


@contextlib.contextmanager
def ending_like_ctrl_c() -> Iterator[None]:
    """While it is open, `ENDING_SIGNALS` raise `EndedBySignal` in the main thread, once; a second one is let pass, so
    that what is being saved is saved. Processes that were forked off end as ever. Signals that the process was told to
    ignore (`nohup`) stay ignored. In another thread than the main one nothing happens.

    Python drops what is raised while it takes an object away (`__del__`, callbacks of weak references); then it is
    raised again a little later."""
    owner = os.getpid()
    asked = False

    def end(number: int, frame: object) -> None:
        nonlocal asked
        if os.getpid() != owner:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        elif not asked:
            asked = True
            raise EndedBySignal(number)

    def again(number: int) -> None:
        if sys.unraisablehook is dropped:  # still open
            os.kill(owner, number)

    def dropped(lost: sys.UnraisableHookArgs) -> None:
        nonlocal asked
        if isinstance(lost.exc_value, EndedBySignal):
            asked = False
            threading.Timer(AGAIN_S, again, (lost.exc_value.number,)).start()
        else:
            usual(lost)

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in ENDING_SIGNALS}
    changed = {number: handler for number, handler in before.items() if handler == signal.SIG_DFL}
    for number in changed:
        signal.signal(number, end)
    usual, sys.unraisablehook = sys.unraisablehook, dropped
    try:
        yield
    finally:
        sys.unraisablehook = usual
        for number, handler in changed.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def without_native_noise() -> Iterator[None]:
    """While it is open, what decoders and parsers print past Python goes nowhere ("Corrupt JPEG data", ...): what
    matters of it comes out as our own line. Where somebody captures stderr nothing is changed."""
    before = sys.stderr
    try:
        real = before is sys.__stderr__ and before.fileno() == 2
    except (AttributeError, OSError, ValueError):  # closed, or none at all
        real = False
    if not real:
        yield
        return
    before.flush()
    ours = os.dup(2)
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    sys.stderr = os.fdopen(ours, "w", 1, before.encoding, "backslashreplace", closefd=False)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):  # its reader has left
            sys.stderr.flush()
        sys.stderr = before
        os.dup2(ours, 2)
        os.close(ours)


def keep_to_ourselves() -> None:
    """Tells the libraries to send nothing, and to keep their caches in our folder; what the user has set stays."""
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")  # its decoders' complaints come out as our one line
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    cache = cache_folder()
    if cache is not None:
        os.environ.setdefault("MPLCONFIGDIR", str(cache / "matplotlib"))  # its list of fonts
        os.environ.setdefault("MESA_SHADER_CACHE_DIR", str(cache))  # makes mesa_shader_cache in it
        os.environ.setdefault("__GL_SHADER_DISK_CACHE_PATH", str(cache))


def cache_folder() -> Path | None:
    """Folder for what may be deleted at any time: twohands in $XDG_CACHE_HOME or ~/.cache; where that cannot be
    written, one in the folder for temporary files; None where nothing can be written. It need not exist yet."""
    homes = [os.environ.get("XDG_CACHE_HOME"), os.path.join(os.path.expanduser("~"), ".cache")]
    folders = [Path(home) / "twohands" for home in homes if home and os.path.isabs(home)]
    with contextlib.suppress(FileNotFoundError):  # there is no folder for temporary files
        user = os.getuid() if hasattr(os, "getuid") else "user"
        folders.append(Path(tempfile.gettempdir()) / f"twohands-cache-{user}")
    return next((folder for folder in folders if _can_be_made(folder)), None)


def _can_be_made(folder: Path) -> bool:
    """Whether a folder is there and can be written, or could be made."""
    existing = next((each for each in (folder, *folder.parents) if os.path.lexists(each)), folder)
    return existing.is_dir() and os.access(existing, os.W_OK | os.X_OK)


@contextlib.contextmanager
def warnings_as_lines() -> Iterator[None]:
    """While it is open, a `PlausibilityWarning` is one line on stderr, the same one with other numbers not again;
    other warnings are as ever."""
    said: set[str] = set()

    with warnings.catch_warnings():
        usual = warnings.showwarning

        def show(
            message: Warning | str,
            category: type[Warning],
            filename: str,
            lineno: int,
            file: TextIO | None = None,
            line: str | None = None,
        ) -> None:
            if not issubclass(category, PlausibilityWarning):
                usual(message, category, filename, lineno, file, line)
            elif (kind := re.sub(r"\d+", "", str(message))) not in said and len(said) <= MOST_WARNINGS:
                said.add(kind)
                text = str(message) if len(said) <= MOST_WARNINGS else "further warnings of this kind are left out"
                print(f"twohands: warning: {text}", file=sys.stderr)

        warnings.simplefilter("always", PlausibilityWarning)
        warnings.showwarning = show
        yield
