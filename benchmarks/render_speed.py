"""Speed of the raster renderer: labelled frames per second of one warmed-up process.

    python benchmarks/render_speed.py

Prints frames/s for rendering alone and for whole stream items (scene, rendering, background, labels).
"""

from __future__ import annotations

import time
from collections.abc import Callable

from twohands.synth.config import SynthConfig
from twohands.synth.render.raster import RasterRenderer
from twohands.synth.scene import sample_scene
from twohands.synth.stream import SyntheticStream

COUNT = 120


def rate(work: Callable[[int], object]) -> float:
    """Items per second, the best of three runs after a warm-up."""
    for i in range(10):
        work(i)
    best = 0.0
    for _ in range(3):
        start = time.perf_counter()
        for i in range(COUNT):
            work(i)
        best = max(best, COUNT / (time.perf_counter() - start))
    return best


def main() -> None:
    """Measures and prints."""
    for width, height in ((480, 270), (960, 540)):
        measure(width, height)


def measure(width: int, height: int) -> None:
    """One picture size."""
    config = SynthConfig(width=width, height=height)
    renderer = RasterRenderer(width, height)
    scenes = [sample_scene(config, 0, i) for i in range(COUNT)]
    print(f"{width}x{height}: renderer {renderer.ctx.info['GL_RENDERER']}")
    print(f"  labelled frames rendered  {rate(lambda i: renderer.render(scenes[i])):7.1f} /s")
    stream = SyntheticStream(config, 0, COUNT)
    print(f"  whole stream items        {rate(lambda i: stream[i]):7.1f} /s")


if __name__ == "__main__":
    main()
