"""Fills a folder with a static set in the Ego3DHands layout: resumable, same bytes for any number of workers."""

from __future__ import annotations

import json
import multiprocessing
import os
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from twohands import __version__
from twohands.ego3dhands_format import instance_name
from twohands.errors import InputError
from twohands.synth.backgrounds import BackgroundFolder, Backgrounds, ProceduralBackgrounds
from twohands.synth.compositing import compose_frame
from twohands.synth.config import SynthConfig
from twohands.synth.stream import SyntheticStream
from twohands.synth.writer import encode_instance, write_instance

MANIFEST = "manifest.json"


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
    """
    if static_set.count < 1:
        raise InputError(f"count must be at least 1, got {static_set.count}")
    _claim(out, static_set.manifest())
    missing = [i for i in range(static_set.count) if not (out / instance_name(i)).is_dir()]
    there = static_set.count - len(missing)
    for _ in _write_all(static_set, out, missing, workers):
        there += 1
        if progress is not None:
            progress(there, static_set.count)
    return len(missing)


def _claim(out: Path, manifest: dict[str, object]) -> None:
    """Makes the folder this set's own, or checks that it already is."""
    path = out / MANIFEST
    if path.is_file():
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise InputError(f"{path} is damaged: choose another --out") from error
        if found != manifest:
            differ = sorted(k for k in {*found, *manifest} if found.get(k) != manifest.get(k))
            raise InputError(f"{out} holds another set ({', '.join(differ)} differ): choose another --out")
        return
    if out.is_dir() and any(out.iterdir()):
        raise InputError(f"output {out} is not empty and holds no set of ours: choose another --out")
    try:
        out.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{path.name}.partial")
        partial.write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
        os.replace(partial, path)
    except OSError as error:
        raise InputError(f"output {out}: cannot be written: {error.strerror}") from error


def _write_all(static_set: StaticSet, out: Path, indices: list[int], workers: int) -> Iterator[int]:
    if workers <= 1 or len(indices) < 2:
        stream = static_set.stream()
        for index in indices:
            yield _write_one(stream, out, index)
        return
    with multiprocessing.get_context("spawn").Pool(workers, _start_worker, (static_set, out)) as pool:
        yield from pool.imap_unordered(_work, indices, chunksize=4)


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
