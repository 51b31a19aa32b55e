"""Fills a folder with a static set in the Ego3DHands layout: resumable, same bytes for any number of workers."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from twohands import __version__
from twohands.ego3dhands_format import instance_name
from twohands.errors import InputError
from twohands.synth.backgrounds import BackgroundFolder, Backgrounds, ProceduralBackgrounds
from twohands.synth.compositing import compose_frame
from twohands.synth.config import SynthConfig
from twohands.synth.production import claim_folder, in_processes
from twohands.synth.stream import SyntheticStream
from twohands.synth.writer import encode_instance, write_instance


@dataclass(frozen=True)
class StaticSet:
    """What defines a set, down to the last byte.

    Attributes:
        config: distributions of the scenes.
        seed: of the set.
        count: number of instances.
        backgrounds: folder of background pictures; procedural if None.
    """

    config: SynthConfig
    seed: int
    count: int
    backgrounds: Path | None = None

    def stream(self) -> SyntheticStream:
        """The instances of the set.

        Raises:
            InputError: the background folder is missing or empty.
        """
        source: Backgrounds = BackgroundFolder(self.backgrounds) if self.backgrounds else ProceduralBackgrounds()
        return SyntheticStream(self.config, self.seed, self.count, source)

    def manifest(self) -> dict[str, object]:
        """Plain JSON values that tell one set from another."""
        return {
            "format": "ego3dhands",
            "twohands": __version__,
            "seed": self.seed,
            "backgrounds": self.stream().backgrounds.name,
            "config": json.loads(json.dumps(asdict(self.config))),
        }


def generate_static(
    static_set: StaticSet, out: Path, *, workers: int = 1, progress: Callable[[int, int], None] | None = None
) -> int:
    """Writes the instances that are not there yet.

    Args:
        static_set: what to write; `count` may grow from one call to the next.
        out: folder of this set alone; instances are folders 00000, 00001, ...
        workers: processes, each with its own renderer.
        progress: called with (instances there, count).

    Returns:
        Number of instances written by this call.

    Raises:
        InputError: the folder belongs to another set or to something else, or cannot be written.
        MissingExtraError, RendererError: no renderer on this machine.
        TwoHandsError: a worker process died.
    """
    if static_set.count < 1:
        raise InputError(f"count must be at least 1, got {static_set.count}")
    claim_folder(out, static_set.manifest())
    for stale in out.glob(".*.partial"):
        shutil.rmtree(stale, ignore_errors=True)
    missing = [i for i in range(static_set.count) if not (out / instance_name(i)).is_dir()]
    there = static_set.count - len(missing)
    for _ in _write_all(static_set, out, missing, workers):
        there += 1
        if progress is not None:
            progress(there, static_set.count)
    return len(missing)


def _write_all(static_set: StaticSet, out: Path, indices: list[int], workers: int) -> Iterator[int]:
    if workers <= 1 or len(indices) < 2:
        stream = static_set.stream()
        for index in indices:
            yield _write_one(stream, out, index)
        return
    yield from in_processes(_work, indices, workers, _start_worker, (static_set, out))


def _write_one(stream: SyntheticStream, out: Path, index: int) -> int:
    frame = stream.frame(index)
    image = compose_frame(frame, stream.background(index))
    write_instance(out / instance_name(index), encode_instance(frame, image))
    return index


_job: tuple[SyntheticStream, Path] | None = None
"""Of a worker process: set once by `_start_worker`."""


def _start_worker(static_set: StaticSet, out: Path) -> None:
    global _job
    _job = (static_set.stream(), out)


def _work(index: int) -> int:
    if _job is None:
        raise RuntimeError("worker was not started")
    return _write_one(*_job, index)
