"""The work of a run in this process, or in several of this machine."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnContext, SpawnProcess
from types import FrameType
from typing import Any

from twohands.errors import InputError, TwoHandsError
from twohands.executors.base import AHEAD, Opener, Result

JOBS = 2
"""Jobs of a worker at a time, where results come in order: the one it does and the next."""
GRACE_S = 5.0
"""Seconds that workers have, all together, to finish their jobs; then again to leave them, when they are told to."""


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

    def run(self, opener: Opener[Result], indices: Iterable[int], *, in_order: bool = True) -> Iterator[Result]:
        """See `Executor.run`. Processes end with this one, even if it is killed."""
        if self.workers == 1:
            yield from _run_here(opener, indices)
            return
        # Spawned, for a process that has held an OpenGL context does not survive a fork.
        context = multiprocessing.get_context("spawn")
        with _deaf_to_interrupts():
            crew = [_Worker(context, opener) for _ in range(self.workers)]
        try:
            yield from _share_out(crew, indices, in_order)
        finally:
            _dismiss(crew)


class _Worker:
    """A process with a pipe of its own, so that one that is killed in the middle of an answer blocks no other, and is
    noticed: the pipe ends. (The shared pipe of a `ProcessPoolExecutor` would hang.)"""

    def __init__(self, context: SpawnContext, opener: Opener[Any]) -> None:
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, opener), daemon=True)
        self.process.start()
        theirs.close()
        self.jobs = 0

    def give(self, index: int) -> None:
        """One job more."""
        with _told():
            self.pipe.send(index)
        self.jobs += 1

    def take(self) -> tuple[int, Any, BaseException | None]:
        """Waits for the next answer: index, result, and what was raised instead."""
        with _told():
            answer = self.pipe.recv()
        self.jobs -= 1
        return answer


def _dismiss(crew: Sequence[_Worker]) -> None:
    """Ends workers: they may finish a short job, leave a long one and clean up after it, and are killed else."""
    for worker in crew:
        worker.pipe.close()
    for end in (None, SpawnProcess.terminate, SpawnProcess.kill):
        staying = [worker.process for worker in crew if worker.process.is_alive()]
        if end is not None:
            for process in staying:
                end(process)
        until = time.monotonic() + GRACE_S
        for process in staying:
            process.join(max(0.0, until - time.monotonic()))


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Processes that start in the block never hear an interrupt, not even while they import, with a traceback."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # else the first process starts it, and it lets interrupts through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _told() -> Iterator[None]:
    """A pipe that ended is a process that died."""
    try:
        yield
    except (EOFError, OSError) as error:
        raise TwoHandsError(
            "a worker process died (killed, or out of memory): run the same command again to go on"
        ) from error


def _share_out(crew: Sequence[_Worker], indices: Iterable[int], in_order: bool) -> Iterator[Any]:
    """Results, each worker with a job and, in order, the next one.

    Raises:
        TwoHandsError: a worker died.
    """
    remaining, jobs = iter(indices), JOBS if in_order else 1
    order: deque[int] = deque()
    done: dict[int, tuple[Any, BaseException | None]] = {}
    while True:
        for worker in crew:
            room = min(jobs - worker.jobs, AHEAD * len(crew) - len(order))
            for index in islice(remaining, max(room, 0)):
                worker.give(index)
                order.append(index)
        if not order:
            return
        next_up = order[0] if in_order else next(iter(done), None)
        if next_up in done:
            order.remove(next_up)
            result, error = done.pop(next_up)
            if error is not None:
                raise error
            yield result
            continue
        ready = wait([worker.pipe for worker in crew if worker.jobs])
        for worker in crew:
            if worker.pipe in ready:
                index, result, error = worker.take()
                done[index] = result, error


def _run_here(opener: Opener[Result], indices: Iterable[int]) -> Iterator[Result]:
    work: Callable[[int], Result] | None = None
    for index in indices:
        work = work or opener()
        yield work(index)


def _serve(pipe: Connection, opener: Opener[Any]) -> None:
    """What a worker does until its pipe ends."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the first one ends the others
    signal.signal(signal.SIGTERM, _leave)
    work: Callable[[int], Any] | None = None
    with suppress(EOFError, OSError):
        while True:
            index = pipe.recv()
            try:
                work = work or opener()
                answer = index, work(index), None
            except Exception as error:
                answer = index, None, error
            pipe.send(answer)


def _leave(number: int, frame: FrameType | None) -> None:
    """Ends a worker through its context managers, which remove what is half done."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # once is enough
    sys.exit(128 + number)


def _end_with_parent() -> None:
    """Ends the worker in the middle of its job when the process that started it is killed: a job may write files, which
    a new run would write as well."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
