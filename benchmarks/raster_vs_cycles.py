"""How many times slower Cycles is than the raster renderer: same scenes, same size, same machine, same minutes.

    python benchmarks/raster_vs_cycles.py

Prints what a labelled frame of 480x270 takes with both, Cycles with 16 samples, denoised, on all cores; and the ratio
of the wall times. That of the processor times stands beside it, for machines with other work.

Needs the extra `blender`.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from twohands.synth.render.blender import BlenderRenderer
from twohands.synth.render.choice import Renderer
from twohands.synth.render.raster import RasterRenderer
from twohands.synth.scene.config import PRESETS
from twohands.synth.scene.spec import SceneSpec
from twohands.synth.sets.instances import sample_scene

SCENES = 4
WIDTH, HEIGHT = 480, 270
BEST_OF = 2


def cost(renderer: Renderer, scene: SceneSpec) -> np.ndarray:
    """(2,) wall and processor seconds of a frame, the least of some after a warm-up."""
    taken = []
    for _ in range(1 + BEST_OF):
        start = time.perf_counter(), time.process_time()
        renderer.render(scene)
        taken.append((time.perf_counter() - start[0], time.process_time() - start[1]))
    return np.min(taken[1:], axis=0)


def main() -> None:
    """Measures and prints."""
    raster, cycles = RasterRenderer(WIDTH, HEIGHT), BlenderRenderer(WIDTH, HEIGHT, samples=16)
    for preset in ("paper", "wild"):
        config = replace(PRESETS[preset], people=0.0, width=WIDTH, height=HEIGHT)
        scenes = [sample_scene(config, 5, i) for i in range(SCENES)]
        costs = np.array([[cost(renderer, scene) for renderer in (raster, cycles)] for scene in scenes])  # (S, 2, 2)
        (fast, fast_cpu), (slow, slow_cpu) = costs.mean(0)
        least = (costs[:, 1, 0] / costs[:, 0, 0]).min()
        print(
            f"{preset}: raster {1000 * fast:.1f} ms, Cycles {slow:.2f} s, ratio {slow / fast:.0f} "
            f"(least of {SCENES} scenes {least:.0f}; processor time {slow_cpu / fast_cpu:.0f})",
            flush=True,
        )


if __name__ == "__main__":
    main()
