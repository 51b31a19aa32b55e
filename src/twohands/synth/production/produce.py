"""A production run: makes the instances of a set that are not there yet, whoever does the work, wherever they go."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

from twohands.errors import InputError
from twohands.executors.base import Executor
from twohands.synth.production.manifest import claimed_folder
from twohands.synth.production.sinks import FolderSink, ShardSink, Sink

Layout = Literal["ego3dhands", "webdataset"]
MAX_COUNT = 10_000_000
"""Instances of one set: a larger one is better made as several, with seeds of their own."""
FOLDER_OVERHEAD = 20_000
"""Bytes that a folder of seven files takes beyond their contents on a disk of 4 KiB blocks."""
SHARD_OVERHEAD = 7 * 768
"""Headers and padding of seven tar members, on the average."""
SAMPLE = 16
"""Instances from which the size of the others is estimated, where as many are there already."""


@dataclass(frozen=True, slots=True)
class Made:
    """What a worker hands back.

    Attributes:
        files: file name -> contents.
        notes: remarks for the user, each shown once at the end of the run, such as a picture that cannot be read.
    """

    files: dict[str, bytes]
    notes: tuple[str, ...] = ()


class Production(Protocol):
    """A set to be made: numbered instances, each a pure function of its number. Picklable."""

    def __len__(self) -> int:
        """Number of instances; may grow from one run to the next."""
        ...

    def instance_name(self, index: int) -> str:
        """Path of an instance's folder below the set, "00012" or "0003/00012"; no dots."""
        ...

    def identity(self) -> dict[str, Any]:
        """Plain JSON values that tell one set from another: kind, seed, resolved config, backgrounds."""
        ...

    def made_with(self) -> dict[str, str]:
        """`manifest.environment` of this machine.

        Raises:
            MissingExtraError, RendererError: nothing can be rendered here.
        """
        ...

    def expected_bytes(self) -> int:
        """Rough size of an instance's files together."""
        ...

    def open(self) -> Callable[[int], Made]:
        """Called once in every worker, where it may make a renderer; what it returns is called on numbers."""
        ...


@dataclass(frozen=True, slots=True)
class Plan:
    """What a run is about to do.

    Attributes:
        there: instances that are there already.
        missing: instances to be made.
        bytes_needed: rough size of those on disk.
        bytes_free: free on the disk of the set.
    """

    there: int
    missing: int
    bytes_needed: int
    bytes_free: int


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run has done: instances written, and the workers' notes, each once, sorted."""

    written: int
    notes: tuple[str, ...]


def produce(
    production: Production,
    out: Path,
    executor: Executor,
    *,
    layout: Layout = "ego3dhands",
    shard_size: int = 1000,
    announce: Callable[[Plan], None] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Outcome:
    """Writes the instances of a set that are not there yet.

    The process may be killed at any moment; the same call goes on. The same production gives the same bytes, whichever
    executor and however often it was killed.

    Args:
        production: what to make.
        out: folder of this set alone.
        executor: who does the work.
        layout: a folder for each instance, or tar shards.
        shard_size: instances per shard.
        announce: called once, before the first instance.
        progress: called with (instances there, count) after each.

    Raises:
        InputError: the folder belongs to another set or to something else, or cannot be written; or there is not
            enough room on the disk.
        MissingExtraError, RendererError: no renderer on this machine.
        TwoHandsError: a worker died.
    """
    count = len(production)
    if not 1 <= count <= MAX_COUNT:
        raise InputError(f"count must be 1 to {MAX_COUNT}, got {count}")
    names = [production.instance_name(index) for index in range(count)]
    identity = {"format": layout, **({"shard_size": shard_size} if layout == "webdataset" else {})}
    notes: set[str] = set()
    written = 0
    with claimed_folder(out, {**identity, **production.identity()}, production.made_with()):
        sink: Sink = FolderSink(out, names) if layout == "ego3dhands" else ShardSink(out, names, shard_size)
        try:
            missing = [index for index, name in enumerate(names) if name not in sink.entries]
            plan = _plan(production, out, sink, len(missing), layout)
            if announce is not None:
                announce(plan)
            check_room(out, plan.bytes_needed)
            for index, made in zip(missing, executor.run(production.open, missing), strict=True):
                sink.write(names[index], made.files)
                notes.update(made.notes)
                written += 1
                if progress is not None:
                    progress(plan.there + written, count)
        finally:
            sink.close()
    return Outcome(written, tuple(sorted(notes)))


def check_room(folder: Path, needed: int) -> None:
    """Whether something fits on a folder's disk.

    Raises:
        InputError: it does not.
    """
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise InputError(
            f"about {needed / 1e9:.1f} GB are needed in {folder} and {free / 1e9:.1f} GB are free there: "
            "free some space, ask for fewer, or choose another folder"
        )


def _plan(production: Production, out: Path, sink: Sink, missing: int, layout: Layout) -> Plan:
    sizes = [entry.bytes for entry in sink.entries.values()]
    each = sum(sizes) // len(sizes) if len(sizes) >= SAMPLE else production.expected_bytes()
    each += FOLDER_OVERHEAD if layout == "ego3dhands" else SHARD_OVERHEAD
    return Plan(len(production) - missing, missing, missing * each, shutil.disk_usage(out).free)
