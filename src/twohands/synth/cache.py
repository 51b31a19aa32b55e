"""A store of rendered frames on disk, for training on machines where rendering would starve the trainer.

Frames are kept without background, as plain memory-mapped arrays; each read puts another background behind them, so
one rendered frame serves many training samples.
"""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np

from twohands.errors import DataFormatError, InputError
from twohands.synth.backgrounds import Backgrounds, ProceduralBackgrounds
from twohands.synth.compositing import compose
from twohands.synth.config import SynthConfig
from twohands.synth.scene import instance_rng
from twohands.synth.stream import SyntheticStream, hand_sample
from twohands.types import HandSample, PinholeCamera, RenderedFrame

_VARIANT_STREAM = 1 << 41


def _layout(config: SynthConfig, count: int) -> dict[str, tuple[tuple[int, ...], type]]:
    size = (count, config.height, config.width)
    return {
        "rgba": ((*size, 4), np.uint8),
        "labels": (size, np.uint8),
        "joints": ((count, 2, 22, 3), np.float32),
        "present": ((count, 2), np.bool_),
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
        InputError: the folder holds a cache of another configuration.
    """
    folder.mkdir(parents=True, exist_ok=True)
    manifest = {"version": 1, "seed": seed, "count": count, "config": asdict(config)}
    path = folder / "manifest.json"
    if path.exists() and json.loads(path.read_text()) != json.loads(json.dumps(manifest)):
        raise InputError(f"{folder} holds a cache of another configuration: choose an empty folder")
    for name, (shape, dtype) in _layout(config, count).items():
        file = folder / f"{name}.npy"
        if not file.exists():
            np.lib.format.open_memmap(file, mode="w+", dtype=dtype, shape=shape).flush()
    path.write_text(json.dumps(manifest, indent=1))
    missing = np.flatnonzero(~np.load(folder / "done.npy", mmap_mode="r"))
    chunks = [chunk for chunk in np.array_split(missing, max(len(missing) // 50, 1)) if len(chunk)]
    jobs = [(folder, config, seed, count, chunk) for chunk in chunks]
    finished = count - len(missing)
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        for done in pool.imap_unordered(_render_chunk, jobs):
            finished += done
            if progress is not None:
                progress(finished, count)


_streams: dict[tuple[SynthConfig, int, int], SyntheticStream] = {}


def _render_chunk(job: tuple[Path, SynthConfig, int, int, np.ndarray]) -> int:
    folder, config, seed, count, indices = job
    stream = _streams.setdefault((config, seed, count), SyntheticStream(config, seed, count))
    arrays = {name: np.load(folder / f"{name}.npy", mmap_mode="r+") for name in _layout(config, count)}
    for index in indices:
        frame = stream.frame(int(index))
        arrays["rgba"][index, ..., :3] = frame.rgb
        arrays["rgba"][index, ..., 3] = frame.alpha
        arrays["labels"][index] = frame.part_labels
        arrays["joints"][index] = frame.joints_m
        arrays["present"][index] = frame.present
        arrays["done"][index] = True
    return len(indices)


def vary_arms(rgb: np.ndarray, labels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Lights each arm anew: a random exposure, contrast and tint per arm, as lamps at different places give.

    Args:
        rgb: (H, W, 3) uint8.
        labels: (H, W) uint8 part labels, 1..7 left, 8..14 right.
        rng: one draw per arm.

    Returns:
        A varied copy, (H, W, 3) uint8.
    """
    tables = np.empty((3, 256, 3), np.uint8)
    tables[0] = np.arange(256)[:, None]
    for side in (0, 1):
        gain = np.exp(rng.normal(0.08, 0.28) + rng.normal(0, 0.07, 3))
        gamma = np.exp(rng.normal(0, 0.15))
        tables[1 + side] = np.clip(255 * (np.arange(256)[:, None] / 255) ** gamma * gain, 0, 255)
    out = rgb.copy()
    for side in (0, 1):
        mask = (labels >= 1 + 7 * side) & (labels <= 7 + 7 * side)
        if mask.any():
            pixels = rgb[mask]
            out[mask] = np.stack([tables[1 + side][pixels[:, c], c] for c in range(3)], axis=1)
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
            manifest = json.loads((folder / "manifest.json").read_text())
            self.seed = int(manifest["seed"])
            self._arrays = {
                name: np.load(folder / f"{name}.npy", mmap_mode="r") for name in ("rgba", "labels", "joints", "present")
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
        height, width = self._arrays["labels"].shape[1:]
        self.camera = PinholeCamera.ego3dhands(width, height)

    @staticmethod
    def is_cache(folder: Path) -> bool:
        """Whether `build_cache` has written to this folder."""
        return (folder / "manifest.json").is_file() and (folder / "rgba.npy").is_file()

    def __len__(self) -> int:
        return len(self.indices) * self.variants

    def __getitem__(self, index: int) -> HandSample:
        if not 0 <= index < len(self):
            raise IndexError(f"sample {index} of {len(self)}")
        at = self.indices[index % len(self.indices)]
        arrays = self._arrays
        rgba = np.asarray(arrays["rgba"][at])
        labels = np.asarray(arrays["labels"][at])
        rng = instance_rng(self.seed, _VARIANT_STREAM + index)
        background = self.backgrounds.sample(rng, self.camera.width, self.camera.height)
        if rng.random() < self.empty_rate:
            nothing = np.full((2, 22, 3), np.nan)
            absent = np.zeros(2, bool)
            zeros = np.zeros(labels.shape, np.float32)
            blank = RenderedFrame(background, zeros.astype(np.uint8), zeros, labels * 0, nothing, absent, self.camera)
            return hand_sample(blank, f"{self.name} #{index}")
        colour = vary_arms(rgba[..., :3], labels, rng)
        frame = RenderedFrame(
            rgb=compose(colour, rgba[..., 3], background),
            alpha=rgba[..., 3],
            depth_m=np.zeros(labels.shape, np.float32),
            part_labels=labels,
            joints_m=np.asarray(arrays["joints"][at], np.float64),
            present=np.asarray(arrays["present"][at]),
            camera=self.camera,
        )
        return hand_sample(frame, f"{self.name} #{index}")
