"""The static set (paper section 3.1) as a production: single pictures, each with its own scene."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from twohands.executors.base import Executor
from twohands.executors.local import LocalProcesses
from twohands.formats.ego3dhands import instance_name
from twohands.synth.backgrounds.base import Backgrounds
from twohands.synth.backgrounds.photographs import BackgroundFolder
from twohands.synth.backgrounds.procedural import ProceduralBackgrounds
from twohands.synth.production.manifest import environment
from twohands.synth.production.produce import Layout, Made, Outcome, Plan, produce
from twohands.synth.render.choice import RendererName, open_fabrics, renderer_version
from twohands.synth.scene.config import SynthConfig
from twohands.synth.sets.seeds import Split, stream_seed
from twohands.synth.sets.stream import SyntheticStream
from twohands.synth.sets.writer import encode_instance

BYTES_PER_PIXEL = 1.7
"""All seven files of an instance together, on the average of both kinds of backgrounds."""
WORKER_BACKGROUNDS = 64
"""Decoded background pictures that a worker keeps: 100 MB."""


@dataclass(frozen=True)
class StaticSet:
    """What defines a set, down to the last byte; a `produce.Production`.

    Attributes:
        config: distributions of the scenes.
        seed: of the set, 0 or larger.
        count: number of instances.
        backgrounds: folder of background pictures; procedural if None.
        split: part of the set; no two splits share a scene, whatever their seeds.
        renderer: who draws.
        fabrics: folder of tileable pictures for sleeves and gloves; plain and striped ones if None.
    """

    config: SynthConfig
    seed: int
    count: int
    backgrounds: Path | None = None
    split: Split = "train"
    renderer: RendererName = "raster"
    fabrics: Path | None = None

    def stream(self) -> SyntheticStream:
        """The instances of the set.

        Raises:
            InputError: the seed is negative, a folder of pictures is missing, unreadable or empty, or the renderer
                draws no fabrics.
        """
        seed = stream_seed(self.seed, "static", self.split)
        fabrics = open_fabrics(self.fabrics, self.renderer)
        return SyntheticStream(self.config, seed, self.count, self._backgrounds(), self.renderer, fabrics)

    def __len__(self) -> int:
        return self.count

    def instance_name(self, index: int) -> str:
        """Five digits."""
        return instance_name(index)

    def identity(self) -> dict[str, Any]:
        """See `Production.identity`."""
        stream = self.stream()
        return {
            "kind": "static",
            "split": self.split,
            "renderer": self.renderer,
            "seed": self.seed,
            "backgrounds": stream.backgrounds.name,
            "fabrics": stream.fabrics.name if stream.fabrics else None,
            "config": json.loads(json.dumps(asdict(self.config))),
        }

    def made_with(self) -> dict[str, str]:
        """See `Production.made_with`."""
        return environment(renderer_version(self.renderer))

    def expected_bytes(self) -> int:
        """See `Production.expected_bytes`."""
        return round(BYTES_PER_PIXEL * self.config.width * self.config.height)

    def open(self) -> Callable[[int], Made]:
        """See `Production.open`."""
        return partial(_make, self.stream())

    def _backgrounds(self) -> Backgrounds:
        if self.backgrounds is None:
            return ProceduralBackgrounds()
        return BackgroundFolder(self.backgrounds, keep=WORKER_BACKGROUNDS)


def generate_static(
    static_set: StaticSet,
    out: Path,
    *,
    workers: int = 1,
    executor: Executor | None = None,
    layout: Layout = "ego3dhands",
    shard_size: int = 1000,
    announce: Callable[[Plan], None] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Outcome:
    """Writes the instances of a static set that are not there yet: `produce`, with local processes by default.

    Args:
        static_set: what to write; `count` may grow from one call to the next.
        workers: processes, each with its own renderer; not used where an executor is given.
        out, executor, layout, shard_size, announce, progress: see `produce`.

    Raises:
        See `produce`.
    """
    return produce(
        static_set,
        out,
        executor or LocalProcesses(workers),
        layout=layout,
        shard_size=shard_size,
        announce=announce,
        progress=progress,
    )


def _make(stream: SyntheticStream, index: int) -> Made:
    frame = stream.frame(index)
    return Made(encode_instance(frame, stream.picture(index, frame)), stream.unreadable)
