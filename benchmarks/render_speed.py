"""Speed of the generator: scenes, labelled frames, whole items of the training stream, and instances on disk.

    python benchmarks/render_speed.py

For the presets paper and wild. One process draws scenes, renders them, and does both with background and labels; then
two processes, each with its own OpenGL context, give whole items at 480x270 and write whole instances at 960x540, with
the ratio to the rate that is asked for on two otherwise idle cores. Where others work too, look at the CPU time.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from twohands.executors.local import LocalProcesses
from twohands.synth.render.raster import RasterRenderer
from twohands.synth.scene.config import PRESETS, SynthConfig
from twohands.synth.sets.instances import sample_scene
from twohands.synth.sets.static import StaticSet, generate_static
from twohands.synth.sets.stream import SyntheticStream

COUNT = 60
"""Items per run in one process."""
WORKERS = 2
STREAM_ITEMS, WARM_UP = 200, 16
"""Items that the workers make, and how many of them pass before the clock starts."""
INSTANCES = 60
TARGETS = {"paper": (100.0, 20.0), "wild": (40.0, 20.0)}
"""Stream items and instances per second of two workers on two cores."""


@dataclass(frozen=True)
class OpenStream:
    """Makes a worker's function, from an index to the seconds of CPU that its item took: pictures stay where they are,
    as if they were used there."""

    config: SynthConfig

    def __call__(self) -> Callable[[int], float]:
        """Called once in every worker."""
        cv2.setNumThreads(1)
        stream = SyntheticStream(self.config, 0, WARM_UP + STREAM_ITEMS)

        def work(index: int) -> float:
            start = time.process_time()
            stream[index]
            return time.process_time() - start

        return work


def rates(work: Callable[[int], object]) -> tuple[float, float]:
    """Items per second, the best of three runs after a warm-up, and milliseconds of CPU per item of that process."""
    for i in range(10):
        work(i)
    best, cpu = 0.0, float("inf")
    for _ in range(3):
        start, cpu_start = time.perf_counter(), time.process_time()
        for i in range(COUNT):
            work(i)
        best = max(best, COUNT / (time.perf_counter() - start))
        cpu = min(cpu, (time.process_time() - cpu_start) / COUNT * 1e3)
    return best, cpu


def stream_rate(config: SynthConfig) -> tuple[float, float]:
    """Items per second of `WORKERS` processes, start-up not counted, and milliseconds of CPU per item."""
    results = LocalProcesses(WORKERS).run(OpenStream(config), range(WARM_UP + STREAM_ITEMS))
    for _ in range(WARM_UP):
        next(results)
    start = time.perf_counter()
    cpu = float(np.mean(list(results)))
    return STREAM_ITEMS / (time.perf_counter() - start), cpu * 1e3


def disk_rate(config: SynthConfig) -> tuple[float, float]:
    """Instances per second from the first on, written by `WORKERS` processes, and kilobytes of one instance."""
    moments: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "set"
        static_set = StaticSet(config, seed=0, count=WARM_UP + INSTANCES)
        generate_static(
            static_set, out, workers=WORKERS, progress=lambda there, count: moments.append(time.perf_counter())
        )
        size = sum(path.stat().st_size for path in out.rglob("*.*") if path.is_file())
    return INSTANCES / (moments[-1] - moments[WARM_UP - 1]), size / static_set.count / 1e3


def main() -> None:
    """Measures and prints."""
    print(f"{RasterRenderer(32, 32).ctx.info['GL_RENDERER']}; {os.cpu_count()} cores")
    cv2.setNumThreads(1)
    for name, preset in PRESETS.items():
        measure(name, preset)


def measure(name: str, preset: SynthConfig) -> None:
    """One preset."""
    config = replace(preset, width=480, height=270)
    stream = SyntheticStream(config, 0, COUNT)
    scenes = [sample_scene(config, 0, i) for i in range(COUNT)]
    steps: list[tuple[str, Callable[[int], object]]] = [
        ("scenes", lambda i: sample_scene(config, 0, i)),
        ("labelled frames, 480x270", lambda i: stream.renderer.render(scenes[i])),
        ("backgrounds", lambda i: stream.background(i, scenes[i].camera)),
        ("stream items", lambda i: stream[i]),
        ("instances encoded, 960x540", StaticSet(replace(preset, width=960, height=540), 0, COUNT).open()),
    ]
    print(f"{name}, one process")
    for what, work in steps:
        rate, cpu = rates(work)
        print(f"  {what:28s} {rate:8.1f} /s {cpu:8.1f} ms of CPU each", flush=True)
    items, instances = TARGETS[name]
    print(f"{name}, {WORKERS} processes")
    rate, cpu = stream_rate(config)
    print(
        f"  {'stream items, 480x270':28s} {rate:8.1f} /s {cpu:8.1f} ms of CPU each, {rate / items:.2f} of {items:g} /s"
    )
    rate, size = disk_rate(replace(preset, width=960, height=540))
    print(
        f"  {'instances, 960x540':28s} {rate:8.1f} /s {size:8.0f} kB each, {rate / instances:.2f} of {instances:g} /s"
    )


if __name__ == "__main__":
    main()
