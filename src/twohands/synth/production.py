"""What every long run of the generator needs: a folder of its own, and worker processes that may die without harm."""

from __future__ import annotations

import json
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any, TypeVar

from twohands.errors import InputError, TwoHandsError

MANIFEST = "manifest.json"
Job = TypeVar("Job")
Result = TypeVar("Result")


def claim_folder(folder: Path, manifest: dict[str, Any]) -> None:
    """Makes a folder the home of one run, or checks that it already is; nothing else is ever written to.

    Args:
        folder: made if missing; must be empty or hold the same manifest.
        manifest: plain JSON values that tell one run from another.

    Raises:
        InputError: the folder belongs to another run or to something else, or cannot be written.
    """
    path = folder / MANIFEST
    manifest = json.loads(json.dumps(manifest))
    if path.is_file():
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise InputError(f"{path} is damaged: choose another folder") from error
        if found != manifest:
            differ = sorted(k for k in {*found, *manifest} if found.get(k) != manifest.get(k))
            raise InputError(f"{folder} holds another set ({', '.join(differ)} differ): choose another folder")
        return
    try:
        if folder.is_dir() and any(folder.iterdir()):
            raise InputError(f"output {folder} is not empty and holds no set of ours: choose another folder")
        folder.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{path.name}.partial")
        partial.write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
        os.replace(partial, path)
    except OSError as error:
        raise InputError(f"output {folder}: cannot be written: {error.strerror}") from error


def in_processes(
    work: Callable[[Job], Result],
    jobs: Sequence[Job],
    workers: int,
    start: Callable[..., None],
    arguments: tuple[Any, ...],
) -> Iterator[Result]:
    """Results of `work` on every job, as they are ready, from fresh processes.

    Args:
        work: a module-level function.
        jobs: what to work on; none starts no process.
        workers: number of processes.
        start, arguments: called once in every process before its first job.

    Raises:
        TwoHandsError: a process died, for want of memory or by a signal; what was finished is kept.
    """
    if not jobs:
        return
    context = multiprocessing.get_context("spawn")
    count = min(workers, len(jobs))
    with ProcessPoolExecutor(count, mp_context=context, initializer=start, initargs=arguments) as pool:
        try:
            yield from pool.map(work, jobs, chunksize=max(1, min(8, len(jobs) // (4 * count))))
        except BrokenProcessPool as error:
            raise TwoHandsError(
                "a worker process died (killed, or out of memory): run the same command again to go on"
            ) from error
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
