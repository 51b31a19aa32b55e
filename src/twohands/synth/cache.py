"""A store of rendered frames on disk, for training on machines where rendering would starve the trainer.

Frames are kept without background, as plain memory-mapped arrays; each read puts another background behind them, so
one rendered frame serves many training samples.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np

from twohands.errors import DataFormatError
from twohands.geometry.camera import project
from twohands.synth.backgrounds import Backgrounds, ProceduralBackgrounds
from twohands.synth.compositing import compose
from twohands.synth.config import SynthConfig
from twohands.synth.production import MANIFEST, claim_folder, in_processes
from twohands.synth.scene import instance_rng
from twohands.synth.stream import SyntheticStream, labelled
from twohands.types import HandSample, PinholeCamera

_VARIANT_STREAM = 1 << 41
GLARE_RATE = 0.15
"""Share of arms lit so brightly that parts of them are white, as in pictures of Ego3DHands."""


def _layout(config: SynthConfig, count: int) -> dict[str, tuple[tuple[int, ...], type]]:
    size = (count, config.height, config.width)
    return {
        "rgba": ((*size, 4), np.uint8),
        "labels": (size, np.uint8),
        "joints": ((count, 2, 22, 3), np.float32),
        "present": ((count, 2), np.bool_),
        "intrinsics": ((count, 4), np.float32),
        "done": ((count,), np.bool_),
    }


def build_cache(
    folder: Path,
    config: SynthConfig,
    seed: int,
    count: int,
    *,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Renders `count` frames into `folder`; an interrupted build goes on where it stopped.

    Args:
        folder: of this cache alone.
        config: distributions; its width and height are the frames' size.
        seed: of the set.
        count: number of frames.
        workers: processes, each with its own renderer.
        progress: called with (frames done, count) now and then.

    Raises:
        InputError: the folder holds something else.
        TwoHandsError: a worker process died.
    """
    claim_folder(folder, {"format": "frames-2", "seed": seed, "count": count, "config": asdict(config)})
    for name, (shape, dtype) in _layout(config, count).items():
        file = folder / f"{name}.npy"
        if not file.exists():
            np.lib.format.open_memmap(file, mode="w+", dtype=dtype, shape=shape).flush()
    missing = [int(i) for i in np.flatnonzero(~np.load(folder / "done.npy", mmap_mode="r"))]
    finished = count - len(missing)
    for _ in in_processes(_render_frame, missing, workers, _start_worker, (folder, config, seed, count)):
        finished += 1
        if progress is not None:
            progress(finished, count)


_job: tuple[SyntheticStream, dict[str, np.ndarray]] | None = None
"""Of a worker process: set once by `_start_worker`."""


def _start_worker(folder: Path, config: SynthConfig, seed: int, count: int) -> None:
    global _job
    arrays = {name: np.load(folder / f"{name}.npy", mmap_mode="r+") for name in _layout(config, count)}
    _job = SyntheticStream(config, seed, count), arrays


def _render_frame(index: int) -> int:
    if _job is None:
        raise RuntimeError("worker was not started")
    stream, arrays = _job
    frame = stream.frame(index)
    arrays["rgba"][index, ..., :3] = frame.rgb
    arrays["rgba"][index, ..., 3] = frame.alpha
    arrays["labels"][index] = frame.part_labels
    arrays["joints"][index] = frame.joints_m
    arrays["present"][index] = frame.present
    camera = frame.camera
    arrays["intrinsics"][index] = camera.fx, camera.fy, camera.cx, camera.cy
    arrays["done"][index] = True
    return index


def vary_arms(rgb: np.ndarray, labels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Lights each arm anew: a random exposure, contrast and tint per arm, as lamps at different places give.

    Args:
        rgb: (H, W, 3) uint8.
        labels: (H, W) uint8 part labels, 1..7 left, 8..14 right.
        rng: one draw per arm.

    Returns:
        A varied copy, (H, W, 3) uint8.
    """
    out = rgb.copy()
    for first in (1, 8):
        glare = rng.uniform(0.2, 1.0) if rng.random() < GLARE_RATE else 0.0
        warmth = rng.normal(0, 0.09)  # lamps differ between blue and yellow much more than towards green
        tint = np.array([warmth, 0.0, -warmth]) + rng.normal(0, 0.03, 3)
        gain = np.exp(rng.normal(0.05, 0.28) + glare + tint)
        gamma = np.exp(rng.normal(0, 0.15))
        table = np.clip(255 * (np.arange(256)[:, None] / 255) ** gamma * gain, 0, 255).astype(np.uint8)
        arm = cv2.inRange(labels, np.array(first), np.array(first + 6))
        cv2.copyTo(cv2.LUT(rgb, table[None]), arm, out)
    return out


class FrameCache:
    """Reads a cache as labelled samples, every frame `variants` times over with different backgrounds.

    Args:
        folder: written by `build_cache`.
        backgrounds: source of backgrounds; procedural if None.
        frames: (start, stop) of the frames to use, to split training from validation; all if None.
        variants: how many samples one frame gives.
        empty_rate: share of samples that show the background alone, so that a network learns what no hand looks like.

    Raises:
        DataFormatError: the folder holds no finished cache.
    """

    def __init__(
        self,
        folder: Path,
        backgrounds: Backgrounds | None = None,
        frames: tuple[int, int] | None = None,
        variants: int = 1,
        empty_rate: float = 0.0,
    ) -> None:
        try:
            manifest = json.loads((folder / MANIFEST).read_text())
            self.seed = int(manifest["seed"])
            self._arrays = {
                name: np.load(folder / f"{name}.npy", mmap_mode="r")
                for name in ("rgba", "labels", "joints", "present", "intrinsics")
            }
            done = np.load(folder / "done.npy", mmap_mode="r")
        except (OSError, ValueError, KeyError) as error:
            raise DataFormatError(f"{folder} holds no frame cache: {error}") from error
        start, stop = frames or (0, len(done))
        if not done[start:stop].all():
            raise DataFormatError(f"frame cache {folder} is not finished: build it again to go on")
        self.indices = range(start, stop)
        self.variants, self.empty_rate = variants, empty_rate
        self.backgrounds = backgrounds or ProceduralBackgrounds()
        self.name = f"{folder.name} frames {start}..{stop}"
        self._height, self._width = self._arrays["labels"].shape[1:]

    @staticmethod
    def is_cache(folder: Path) -> bool:
        """Whether `build_cache` has written to this folder."""
        return (folder / MANIFEST).is_file() and (folder / "rgba.npy").is_file()

    def __len__(self) -> int:
        return len(self.indices) * self.variants

    def __getitem__(self, index: int) -> HandSample:
        if not 0 <= index < len(self):
            raise IndexError(f"sample {index} of {len(self)}")
        variant, offset = divmod(index, len(self.indices))
        at = self.indices[offset]
        arrays = self._arrays
        rgba = np.asarray(arrays["rgba"][at])
        labels = np.asarray(arrays["labels"][at])
        # Keyed by the frame itself, so that held-out frames never share a draw with training ones.
        rng = instance_rng(self.seed, _VARIANT_STREAM + variant * len(arrays["present"]) + at)
        background = self.backgrounds.sample(rng, self._width, self._height)
        fx, fy, cx, cy = map(float, arrays["intrinsics"][at])
        camera = PinholeCamera(fx, fy, cx, cy, self._width, self._height)
        if rng.random() < self.empty_rate:
            nothing = np.full((2, 22, 3), np.nan)
            absent = np.zeros(2, bool)
            return self._sample(background, np.zeros_like(labels), nothing, absent, camera, index)
        colour = vary_arms(np.ascontiguousarray(rgba[..., :3]), labels, rng)
        return self._sample(
            compose(colour, rgba[..., 3], background),
            labels,
            np.asarray(arrays["joints"][at], np.float64),
            np.asarray(arrays["present"][at]),
            camera,
            index,
        )

    def _sample(
        self,
        image: np.ndarray,
        labels: np.ndarray,
        joints_m: np.ndarray,
        present: np.ndarray,
        camera: PinholeCamera,
        index: int,
    ) -> HandSample:
        hand = joints_m[:, 1:]
        return HandSample(
            image=image,
            camera=camera,
            present=present,
            joints_px=project(hand, camera),
            joints_m=hand,
            valid=labelled(hand, present),
            labels=labels,
            source=f"{self.name} #{index}",
        )
