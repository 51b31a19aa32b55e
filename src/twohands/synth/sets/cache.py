"""A store of rendered frames on disk, for training on machines where rendering would starve the trainer.

Frames are kept without background, as plain memory-mapped arrays; each read puts another background behind them, so
one rendered frame serves many training samples.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from twohands.errors import DataFormatError, InputError
from twohands.executors.local import LocalProcesses
from twohands.files import appearing
from twohands.formats.instance_index import MANIFEST_FILE
from twohands.geometry.camera import project
from twohands.synth.backgrounds.base import Backgrounds
from twohands.synth.backgrounds.behind import room_behind
from twohands.synth.backgrounds.procedural import ProceduralBackgrounds
from twohands.synth.production.manifest import claimed_folder, environment
from twohands.synth.production.produce import check_room
from twohands.synth.render.choice import RendererName, open_fabrics, renderer_version
from twohands.synth.render.compositing import compose
from twohands.synth.render.sensor import expose, sample_sensor, sample_webcam
from twohands.synth.scene.config import SynthConfig
from twohands.synth.sets.seeds import instance_rng, stream_seed
from twohands.synth.sets.stream import SyntheticStream, labelled
from twohands.types import HandSample, PinholeCamera

FORMAT = "frames-3"
"""Of the manifest. Earlier ones are read just the same: "frames-2" had no whole people, "frames-1" drew the scenes of a
static set of the same seed."""
NO_PEOPLE = -1
"""Stands in "turns" for frames that show no whole people."""
GLARE_RATE, PERSON_GLARE_RATE = 0.1, 0.02
"""Share of arms lit so brightly that parts of them are white, as in pictures of Ego3DHands, and of whole people, for
whom cameras expose."""


def _layout(config: SynthConfig, count: int) -> dict[str, tuple[tuple[int, ...], type]]:
    size = (count, config.height, config.width)
    return {
        "rgba": ((*size, 4), np.uint8),
        "labels": (size, np.uint8),
        "joints": ((count, 2, 22, 3), np.float32),
        "present": ((count, 2), np.bool_),
        "intrinsics": ((count, 4), np.float32),
        "turns": ((count,), np.int8),
        "done": ((count,), np.bool_),
    }


def build_cache(
    folder: Path,
    config: SynthConfig,
    seed: int,
    count: int,
    *,
    workers: int = 1,
    renderer: RendererName = "raster",
    fabrics: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[str, ...]:
    """Renders `count` frames into `folder`; an interrupted build goes on where it stopped.

    Args:
        folder: of this cache alone.
        config: distributions; its width and height are the frames' size.
        seed: of the set.
        count: number of frames.
        workers: processes, each with its own renderer.
        renderer: who draws.
        fabrics: folder of tileable pictures for sleeves and gloves; plain and striped ones if None.
        progress: called with (frames done, count) now and then.

    Returns:
        A line for every picture of the user's that was skipped, sorted.

    Raises:
        InputError: the folder holds something else, there is no room for the frames, or the seed is negative.
        MissingExtraError, RendererError: no renderer on this machine.
        TwoHandsError: a worker process died.
    """
    if count < 1:
        raise InputError(f"count must be at least 1, got {count}")
    identity = {"format": FORMAT, "kind": "frames", "renderer": renderer, "seed": seed, "count": count}
    identity["config"] = asdict(config)
    cloths = open_fabrics(fabrics, renderer)
    identity["fabrics"] = cloths.name if cloths else None
    stream = SyntheticStream(config, stream_seed(seed, "frames"), count, renderer_name=renderer, fabrics=cloths)
    layout = _layout(config, count)
    with claimed_folder(folder, identity, environment(renderer_version(renderer))):
        absent = {name: spec for name, spec in layout.items() if not (folder / f"{name}.npy").exists()}
        check_room(folder, sum(int(np.prod(shape)) * np.dtype(dtype).itemsize for shape, dtype in absent.values()))
        for name, (shape, dtype) in absent.items():
            _allocate(folder / f"{name}.npy", shape, dtype)
        missing = [int(i) for i in np.flatnonzero(~np.load(folder / "done.npy", mmap_mode="r"))]
        finished = count - len(missing)
        notes: set[str] = set()
        for unreadable in LocalProcesses(workers).run(partial(_open_frames, stream, folder, tuple(layout)), missing):
            notes.update(unreadable)
            finished += 1
            if progress is not None:
                progress(finished, count)
    return tuple(sorted(notes))


def _allocate(path: Path, shape: tuple[int, ...], dtype: type) -> None:
    """An array of zeros on disk, which appears whole or not at all. Its room is reserved: a worker that found the disk
    full while writing through a memory map would be killed."""
    try:
        with appearing(path) as place:
            np.lib.format.open_memmap(place, mode="w+", dtype=dtype, shape=shape).flush()
            if hasattr(os, "posix_fallocate"):
                with place.open("r+b") as file:
                    os.posix_fallocate(file.fileno(), 0, place.stat().st_size)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error


def _open_frames(stream: SyntheticStream, folder: Path, names: tuple[str, ...]) -> Callable[[int], tuple[str, ...]]:
    """What a worker does with an index."""
    return partial(_render_frame, stream, {name: np.load(folder / f"{name}.npy", mmap_mode="r+") for name in names})


def _render_frame(stream: SyntheticStream, arrays: dict[str, np.ndarray], index: int) -> tuple[str, ...]:
    """Puts a frame into the arrays; returns `SyntheticStream.unreadable`."""
    frame = stream.frame(index)
    arrays["rgba"][index, ..., :3] = frame.rgb
    arrays["rgba"][index, ..., 3] = frame.alpha
    arrays["labels"][index] = frame.part_labels
    arrays["joints"][index] = frame.joints_m
    arrays["present"][index] = frame.present
    camera = frame.camera
    arrays["intrinsics"][index] = camera.fx, camera.fy, camera.cx, camera.cy
    arrays["turns"][index] = NO_PEOPLE if frame.turns is None else frame.turns
    arrays["done"][index] = True
    return stream.unreadable


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
        arm = cv2.inRange(labels, np.array(first), np.array(first + 6))
        cv2.copyTo(lit_anew(rgb, rng), arm, out)
    return out


def lit_anew(rgb: np.ndarray, rng: np.random.Generator, glare_rate: float = GLARE_RATE) -> np.ndarray:
    """The picture (H, W, 3) uint8 in a random exposure, contrast and tint; in a share of them parts are white."""
    glare = rng.uniform(0.2, 1.2) if rng.random() < glare_rate else 0.0
    warmth = rng.normal(0, 0.09)  # lamps differ between blue and yellow much more than towards green
    tint = np.array([warmth, 0.0, -warmth]) + rng.normal(0, 0.03, 3)
    gain = np.exp(rng.normal(0.05, 0.28) + glare + tint)
    gamma = np.exp(rng.normal(0, 0.15))
    table = np.clip(255 * (np.arange(256)[:, None] / 255) ** gamma * gain, 0, 255).astype(np.uint8)
    return np.asarray(cv2.LUT(rgb, table[None]))


@dataclass(frozen=True, slots=True, eq=False)
class StoredFrame:
    """A rendered frame without background, as `RenderedFrame` has it.

    Attributes:
        rgb: (H, W, 3) uint8, straight colour.
        alpha: (H, W) uint8; what has alpha and no label is no part of a labelled hand.
        labels: (H, W) uint8 part labels 0..14.
        joints_m: (2, 22, 3) float64, camera frame, metres; NaN for an absent hand.
        present: (2,) bool.
        turns: see `room_behind`; `NO_PEOPLE` where nobody whole is in it.
    """

    rgb: np.ndarray
    alpha: np.ndarray
    labels: np.ndarray
    joints_m: np.ndarray
    present: np.ndarray
    turns: int

    @property
    def whole(self) -> bool:
        """Whether whole people are in it, and not arms before solids."""
        return self.turns != NO_PEOPLE

    def behind(self, backgrounds: Backgrounds, rng: np.random.Generator, camera: PinholeCamera) -> np.ndarray:
        """(H, W, 3) uint8, a background that fits it."""
        if self.whole:
            return room_behind(backgrounds, rng, camera, self.turns).picture
        return backgrounds.sample(rng, camera).picture

    def relit(self, rng: np.random.Generator) -> np.ndarray:
        """(H, W, 3) uint8, its colours in another light: one lamp lights an arm and the rest of its person."""
        return lit_anew(self.rgb, rng, PERSON_GLARE_RATE) if self.whole else vary_arms(self.rgb, self.labels, rng)


class FrameCache:
    """Reads a cache as labelled samples, every frame `variants` times over with different backgrounds.

    Args:
        folder: written by `build_cache`.
        backgrounds: source of backgrounds; procedural if None.
        frames: (start, stop) of the frames to use, to split training from validation; all if None.
        variants: how many samples one frame gives.
        empty_rate: share of samples without hands, so that a network learns what none looks like: the background and,
            where there are solids for one, the person's body, its arms taken out; whole people are left out.

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
            manifest = json.loads((folder / MANIFEST_FILE).read_text())
            self.seed = int(manifest["seed"])
            self._sensor = float(manifest["config"].get("sensor", 0.0))
            self._arrays = {
                name: np.load(folder / f"{name}.npy", mmap_mode="r")
                for name in ("rgba", "labels", "joints", "present", "intrinsics")
            }
            done = np.load(folder / "done.npy", mmap_mode="r")
            turns = folder / "turns.npy"
            self._turns = np.load(turns, mmap_mode="r") if turns.exists() else np.full(len(done), NO_PEOPLE, np.int8)
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
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
        return (folder / MANIFEST_FILE).is_file() and (folder / "rgba.npy").is_file()

    def __len__(self) -> int:
        return len(self.indices) * self.variants

    def stored(self, offset: int) -> tuple[StoredFrame, PinholeCamera]:
        """One of the used frames as it was rendered, 0 <= offset < len(indices), and its camera."""
        at = self.indices[offset]
        arrays = self._arrays
        rgba = np.asarray(arrays["rgba"][at])
        frame = StoredFrame(
            cv2.cvtColor(rgba, cv2.COLOR_RGBA2RGB),
            rgba[..., 3],
            np.asarray(arrays["labels"][at]),
            np.asarray(arrays["joints"][at], np.float64),
            np.asarray(arrays["present"][at]),
            int(self._turns[at]),
        )
        fx, fy, cx, cy = map(float, arrays["intrinsics"][at])
        return frame, PinholeCamera(fx, fy, cx, cy, self._width, self._height)

    def __getitem__(self, index: int) -> HandSample:
        if not 0 <= index < len(self):
            raise IndexError(f"sample {index} of {len(self)}")
        variant, offset = divmod(index, len(self.indices))
        frame, camera = self.stored(offset)
        labels, joints_m, present = frame.labels, frame.joints_m, frame.present
        # Keyed by the frame itself, so that held-out frames never share a draw with training ones.
        number = variant * len(self._arrays["present"]) + self.indices[offset]
        rng = instance_rng(self.seed, number, "variant")
        background = frame.behind(self.backgrounds, rng, camera)
        if rng.random() < self.empty_rate:
            hidden = frame.alpha > 0 if frame.whole else labels > 0
            image = compose(frame.rgb, np.where(hidden, np.uint8(0), frame.alpha), background)
            labels, joints_m, present = np.zeros_like(labels), np.full((2, 22, 3), np.nan), np.zeros(2, bool)
        else:
            image = compose(frame.relit(rng), frame.alpha, background)
        hand = joints_m[:, 1:]
        return HandSample(
            image=expose(image, (sample_webcam if frame.whole else sample_sensor)(self._sensor, rng), rng),
            camera=camera,
            present=present,
            joints_px=project(hand, camera),
            joints_m=hand,
            valid=labelled(hand, present),
            labels=labels,
            source=f"{self.name} #{index}",
        )
