"""Who does the work of a long run: this process, several, or a cluster (`ray_cluster.py`).

All of them do the same: call a function on numbers, and hand back the results in the order of the numbers, so that what
is written does not depend on who made it.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from itertools import islice
from typing import Any, Protocol, TypeVar

from twohands.errors import InputError, TwoHandsError

Result = TypeVar("Result")
Opener = Callable[[], Callable[[int], Result]]
"""Called once in every worker; what it returns is called on numbers. It must be picklable, the returned function need
not be."""

AHEAD = 4
"""Jobs handed out per worker before the oldest must be done: enough to hide one slow job, few enough for the memory."""


class Executor(Protocol):
    """Runs a function on numbers."""

    def run(self, opener: Opener[Result], indices: Iterable[int]) -> Iterator[Result]:
        """The function's results, in the order of the indices.

        Args:
            opener: makes the function, in every worker.
            indices: what to call it on; taken as needed, never listed whole.

        Raises:
            TwoHandsError: a worker died, or what the function itself raises.
        """
        ...


@dataclass(frozen=True)
class LocalProcesses:
    """Processes of this machine.

    Attributes:
        workers: number of processes; 1 works in this process.

    Raises:
        InputError: fewer than one worker.
    """

    workers: int

    def __post_init__(self) -> None:
        if self.workers < 1:
            raise InputError(f"workers must be at least 1, got {self.workers}")

    def run(self, opener: Opener[Result], indices: Iterable[int]) -> Iterator[Result]:
        """See `Executor.run`. Processes end with this one, even if it is killed."""
        if self.workers == 1:
            yield from _run_here(opener, indices)
            return
        # Spawned, for a process that has held an OpenGL context does not survive a fork.
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(self.workers, mp_context=context, initializer=_start_worker, initargs=(opener,))
        with pool:
            try:
                yield from ordered(lambda index: pool.submit(_work, index), Future.result, indices, self.workers)
            except BrokenProcessPool as error:
                raise TwoHandsError(
                    "a worker process died (killed, or out of memory): run the same command again to go on"
                ) from error
            finally:
                pool.shutdown(wait=False, cancel_futures=True)


def ordered(
    submit: Callable[[int], Any], collect: Callable[[Any], Result], indices: Iterable[int], workers: int
) -> Iterator[Result]:
    """Results in the order of the indices, a few jobs of every worker in flight.

    Args:
        submit: hands one job out, returns its ticket.
        collect: waits for a ticket's result.
        indices: the jobs.
        workers: number of workers.
    """
    remaining = iter(indices)
    tickets = deque(submit(index) for index in islice(remaining, AHEAD * workers))
    while tickets:
        result = collect(tickets.popleft())
        tickets.extend(submit(index) for index in islice(remaining, 1))
        yield result


def _run_here(opener: Opener[Result], indices: Iterable[int]) -> Iterator[Result]:
    work: Callable[[int], Result] | None = None
    for index in indices:
        work = work or opener()
        yield work(index)


_opener: Opener[Any] | None = None
_opened: Callable[[int], Any] | None = None
"""Of a worker process: set by `_start_worker` and by its first job, so that what fails there is raised as a result."""


def _start_worker(opener: Opener[Any]) -> None:
    global _opener
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the first one ends the others
    _opener = opener
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A pool's processes would wait for ever for work from a process that was killed."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _work(index: int) -> Any:
    global _opened
    if _opener is None:
        raise RuntimeError("worker was not started")
    if _opened is None:
        _opened = _opener()
    return _opened(index)
