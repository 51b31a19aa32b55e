"""How many times slower Cycles is than the raster renderer: same scenes, same size, same machine, same minute.

    python benchmarks/raster_vs_cycles.py

Prints what a labelled frame of 480x270 takes with both, Cycles with 16 samples, denoised, on all cores; and the ratio.
Needs the extra `blender`.
"""

from __future__ import annotations

import time
from dataclasses import replace

from twohands.synth.config import PRESETS
from twohands.synth.render.blender import BlenderRenderer
from twohands.synth.render.choice import Renderer
from twohands.synth.render.raster import RasterRenderer
from twohands.synth.scene import SceneSpec, sample_scene

SCENES = 6
WIDTH, HEIGHT = 480, 270
ROUNDS = 20
"""Raster frames between two of Cycles, of the same scene."""


def seconds(renderer: Renderer, scene: SceneSpec, rounds: int) -> float:
    """Wall time of a frame, the average of several of the same scene."""
    start = time.perf_counter()
    for _ in range(rounds):
        renderer.render(scene)
    return (time.perf_counter() - start) / rounds


def main() -> None:
    """Measures and prints."""
    raster, cycles = RasterRenderer(WIDTH, HEIGHT), BlenderRenderer(WIDTH, HEIGHT, samples=16)
    for preset, config in PRESETS.items():
        scenes = [sample_scene(replace(config, width=WIDTH, height=HEIGHT), 5, i) for i in range(SCENES)]
        seconds(raster, scenes[0], ROUNDS), seconds(cycles, scenes[0], 1)  # warm
        taken = [(seconds(raster, scene, ROUNDS), seconds(cycles, scene, 1)) for scene in scenes]
        fast, slow = (sum(times) / SCENES for times in zip(*taken, strict=True))
        least = min(b / a for a, b in taken)
        print(
            f"{preset}: raster {1000 * fast:.1f} ms, Cycles {slow:.2f} s, ratio {slow / fast:.0f} "
            f"(least of {SCENES} scenes {least:.0f})"
        )


if __name__ == "__main__":
    main()
