"""Progress of a long run: a bar with rate and time left on a terminal, a line now and then in a log."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

LOG_SECONDS = 30.0
"""Time between two lines where the output is no terminal."""


class RateLog:
    """Prints "frames 120/1000, 18.2/s, 0:48 left" every now and then.

    Args:
        what: plural name of the things that are counted.
        say: takes a line.
        clock: seconds.
        seconds: time between two lines.
    """

    def __init__(
        self,
        what: str,
        say: Callable[[str], None] = print,
        clock: Callable[[], float] = time.monotonic,
        seconds: float = LOG_SECONDS,
    ) -> None:
        self._what, self._say, self._clock, self._seconds = what, say, clock, seconds
        self._first: tuple[float, int] | None = None
        self._last = 0.0

    def __call__(self, done: int, total: int) -> None:
        """Takes note of the number that is done; those before the first call count as done by an earlier run."""
        now = self._clock()
        if self._first is None:
            self._first, self._last = (now, done), now
            return
        start, before = self._first
        if (now - self._last < self._seconds and done < total) or now <= start or done == before:
            return
        self._last = now
        rate = (done - before) / (now - start)
        self._say(f"{self._what} {done}/{total}, {rate:.1f}/s, {duration((total - done) / rate)} left")


def duration(seconds: float) -> str:
    """ "0:48", "12:05", "3:07:00"."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


@contextmanager
def progress_of(what: str) -> Iterator[Callable[[int, int], None]]:
    """A function to be called with (done, total), for as long as the block runs."""
    if not sys.stdout.isatty():
        yield RateLog(what, lambda line: print(line, flush=True))
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"), TimeRemainingColumn())
    with Progress(TextColumn("{task.description}"), *columns) as bar:
        task = bar.add_task(what, total=None, rate="")
        first: list[tuple[float, int]] = []

        def advance(done: int, total: int) -> None:
            first.append((time.monotonic(), done)) if not first else None
            start, before = first[0]
            passed = time.monotonic() - start
            rate = f"{(done - before) / passed:.1f}/s" if passed > 0 and done > before else ""
            bar.update(task, completed=done, total=total, rate=rate)

        yield advance
