"""Tracks all clips of a listing that are not done yet, whoever does the work, wherever the results go."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from twohands.batch.manifest import Entry, Manifest
from twohands.batch.stores import Clip, Listing, is_remote, store_of
from twohands.batch.tracker import ClipTracker
from twohands.errors import InputError
from twohands.executors.base import Executor
from twohands.files import locked
from twohands.version import made_with

Existing = Literal["refuse", "resume", "replace"]
"""What to do where the place of the results holds something: refuse, go on with a run of the same settings, or replace
what has the same name."""
_PACKAGES = ("numpy", "opencv-python-headless", "openvino", "av")


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run has done.

    Attributes:
        there: clips that were done already.
        entries: of the clips that were worked on, in the order in which they were done.
    """

    there: int
    entries: tuple[Entry, ...]


def track_clips(
    tracker: ClipTracker,
    listing: Listing,
    executor_for: Callable[[int], Executor],
    *,
    existing: Existing = "refuse",
    progress: Callable[[int, int], None] | None = None,
) -> Outcome:
    """Tracks the clips of a listing, and keeps the manifest of what became of them.

    The process may be killed at any moment; the same call with `existing="resume"` goes on. The same clips give the
    same bytes, whichever executor and however often it was killed. Clips that have failed are tried again.

    Args:
        tracker: how; its root is the listing's.
        listing: the clips.
        executor_for: who does the work, given the number of clips that are not done.
        existing: what to do where the place of the results holds something.
        progress: called with (clips done, all) after each.

    Raises:
        InputError: the place holds something else, or cannot be written; another process writes to it.
        TwoHandsError: the networks cannot be loaded, or a worker died.
    """
    out, store = tracker.out, store_of(tracker.out)
    manifest = Manifest(store, out, listing.root, tracker.settings())
    empty = store.is_empty(out)
    if existing == "refuse" and not empty:
        raise InputError(
            f"output {out} is not empty; go on with --resume, choose another --out, or allow it with --overwrite"
        )
    entries: list[Entry] = []
    with _alone(out):
        if existing == "resume" and not empty:
            manifest.load()
        manifest.save()  # before any work, for it may be that it cannot be written
        missing = [clip for clip in listing.clips if not manifest.holds(clip)]
        there = len(listing.clips) - len(missing)
        opener = partial(open_tracker, tracker, listing.root, missing)
        try:
            for entry in executor_for(len(missing)).run(opener, range(len(missing)), in_order=False):
                manifest.add(entry)
                entries.append(entry)
                if progress is not None:
                    progress(there + len(entries), len(listing.clips))
        finally:
            manifest.save()
    return Outcome(there, tuple(entries))


def open_tracker(tracker: ClipTracker, root: str, clips: Sequence[Clip]) -> Callable[[int], Entry]:
    """What a worker calls on the numbers of clips; loads the networks, if they are to be had."""
    tracker.check()
    return lambda index: tracker.track(root, clips[index])


def environment() -> dict[str, str]:
    """Versions of everything that the bytes of results depend on."""
    return made_with(_PACKAGES)


@contextmanager
def _alone(out: str) -> Iterator[None]:
    """Keeps other runs out of a folder of this machine; buckets know no locks.

    Raises:
        InputError: another process writes there, or it cannot be made.
    """
    if is_remote(out):
        yield
        return
    folder = Path(os.path.abspath(out))
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"output {out}: cannot be made: {error.strerror}") from error
    with locked(folder):
        yield
