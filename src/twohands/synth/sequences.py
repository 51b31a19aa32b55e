"""Fills a folder with a dynamic set: sequences of frames in the Ego3DHands layout, one folder per sequence.

One person, one set of lights and one background clip per sequence; only the arms and the view of the clip move. Frame
k of sequence i is a pure function of (config, motion, seed, i, k, frames, fps) and of the background files.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from twohands import __version__
from twohands.ego3dhands_format import instance_name
from twohands.errors import InputError
from twohands.skeleton import LEFT, RIGHT
from twohands.synth.body import BONES_PER_SIDE, Body, forward_kinematics, load_asset, posed_joints
from twohands.synth.clips import Clip, ClipAssignment, ClipSource, assign_clips, open_clip
from twohands.synth.compositing import compose_frame
from twohands.synth.config import SynthConfig
from twohands.synth.motion import Arm, HandMotion, MotionConfig, in_picture, plan_motion
from twohands.synth.pose import ArmAnatomy
from twohands.synth.production import claim_folder, in_processes
from twohands.synth.render.raster import RasterRenderer
from twohands.synth.scene import (
    SceneSpec,
    moved,
    sample_camera,
    sample_clothes,
    sample_lighting,
    sample_shape,
    sample_skin,
    viewed,
)
from twohands.synth.writer import encode_instance, write_instance
from twohands.types import RenderedFrame

SEQUENCE_FILE = "sequence.json"
_MOTION_STREAM, _LOOK_STREAM, _CLIP_STREAM = 1 << 42, 1 << 43, 1 << 45
"""Offsets of the seeds of a sequence's parts, apart from each other and from those of single instances."""
CHUNK = 50
"""Frames of one job: enough for the plan of the motion to be worth its second, few enough to share out."""


@dataclass(frozen=True)
class SequenceSet:
    """What defines a dynamic set, down to the last byte.

    Attributes:
        config: distributions of person, light and hand box; `drop_rate` does not apply, hands leave and return.
        motion: distributions of the motion.
        seed: of the set.
        sequences: number of sequences.
        frames: frames per sequence.
        fps: frames per second.
        backgrounds: folder of videos, frames, panoramas and stills; procedural rooms if None.
    """

    config: SynthConfig = field(default_factory=SynthConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)
    seed: int = 0
    sequences: int = 100
    frames: int = 500
    fps: float = 30.0
    backgrounds: Path | None = None

    def __post_init__(self) -> None:
        if self.sequences < 1 or self.frames < 1:
            raise InputError(f"sequences and frames must be at least 1, got {self.sequences} and {self.frames}")
        if not 1 <= self.fps <= 1000:
            raise InputError(f"fps must lie in [1, 1000], got {self.fps}")

    def clips(self) -> ClipAssignment:
        """The background of every sequence.

        Raises:
            InputError: the folder is missing or holds nothing that can be read.
        """
        return assign_clips(self.backgrounds, self.seed, self.sequences)

    def manifest(self, clips: ClipAssignment) -> dict[str, object]:
        """Plain JSON values that tell one set from another; the number of sequences may grow."""
        return {
            "format": "ego3dhands dynamic",
            "twohands": __version__,
            "seed": self.seed,
            "frames": self.frames,
            "fps": self.fps,
            "backgrounds": clips.name,
            "config": json.loads(json.dumps(asdict(self.config))),
            "motion": json.loads(json.dumps(asdict(self.motion))),
        }


class Sequence:
    """One sequence: everything that stays, and how the rest moves.

    Args:
        sequence_set: the set.
        index: of the sequence.

    Raises:
        InputError: no motion fits the hand box.
    """

    def __init__(self, sequence_set: SequenceSet, index: int) -> None:
        self.set, self.index = sequence_set, index
        config = sequence_set.config
        rng = _rng(sequence_set.seed, _LOOK_STREAM, index)
        self.shape = sample_shape(config, rng)
        self.skin, self.lighting = sample_skin(config, rng), sample_lighting(config, rng)
        self.clothes = sample_clothes(config, rng)
        self.camera, self.view = sample_camera(config, rng)
        self.lighting = replace(self.lighting, positions=moved(self.view, self.lighting.positions))
        body = load_asset().body(self.shape)
        self.scale = 1.0 if config.hand_length is None else config.hand_length / body.hand_length_m
        self._body = body
        self.arms = (Arm(body, ArmAnatomy(body, LEFT)), Arm(body, ArmAnatomy(body, RIGHT)))

    def __len__(self) -> int:
        return self.set.frames

    @property
    def body(self) -> Body:
        """The person at rest."""
        return self._body

    @property
    def times(self) -> np.ndarray:
        """(frames,) seconds."""
        return np.arange(self.set.frames) / self.set.fps

    @cached_property
    def motion(self) -> tuple[HandMotion, HandMotion]:
        """(LEFT, RIGHT), planned when first needed; some seconds for 500 frames."""
        rng = _rng(self.set.seed, _MOTION_STREAM, self.index)
        return plan_motion(self.set.config, self.set.motion, self.arms, self.camera, self.view, self.times, rng)

    def scene(self, frame: int) -> SceneSpec:
        """What to render for one frame; nothing has to be rendered before it.

        A hand is present while any of its 21 joints is in the picture; an absent one is not drawn.

        Raises:
            IndexError: there is no such frame.
        """
        if not 0 <= frame < self.set.frames:
            raise IndexError(f"frame {frame} of {self.set.frames}")
        rotations = np.tile(np.eye(3), (2 * BONES_PER_SIDE, 1, 1))
        for arm, motion in zip(self.arms, self.motion, strict=True):
            posed = arm.rotations(motion.states(self.times[frame : frame + 1])[0])
            if posed is None:
                raise RuntimeError(f"sequence {self.index}: the wrist is out of reach in frame {frame}")
            first = arm.anatomy.first
            rotations[first : first + BONES_PER_SIDE] = posed
        transforms = forward_kinematics(self._body, rotations)
        joints = posed_joints(self._body, transforms)
        seen = moved(self.view, joints)
        present = np.array([in_picture(hand[1:], self.camera) for hand in seen])
        return SceneSpec(
            camera=self.camera,
            shape=self.shape,
            transforms=viewed(self.view, transforms),
            scale=self.scale,
            joints_m=np.where(present[:, None, None], seen * self.scale, np.nan),
            present=present,
            skin=self.skin,
            lighting=self.lighting,
            index=frame,
            view=self.view,
            clothes=self.clothes,
        )

    def clip(self, source: ClipSource) -> Clip:
        """The background in motion.

        Raises:
            InputError: the source cannot be read.
        """
        rng = _rng(self.set.seed, _CLIP_STREAM, self.index)
        return open_clip(source, rng, self.set.frames, self.set.fps, self.camera)


class SequenceRenderer:
    """Frames of a dynamic set; keeps the last sequence at hand.

    Args:
        sequence_set: the set.
        sources: background of every sequence.

    Raises (on the first frame):
        MissingExtraError, RendererError: no renderer on this machine.
    """

    def __init__(self, sequence_set: SequenceSet, sources: tuple[ClipSource, ...]) -> None:
        self.set, self.sources = sequence_set, sources
        self._opened = lru_cache(maxsize=1)(self._open)

    @cached_property
    def renderer(self) -> RasterRenderer:
        """One OpenGL context per process, made when first needed."""
        return RasterRenderer(self.set.config.width, self.set.config.height)

    def _open(self, index: int) -> tuple[Sequence, Clip]:
        sequence = Sequence(self.set, index)
        return sequence, sequence.clip(self.sources[index])

    def frame(self, sequence: int, frame: int) -> tuple[RenderedFrame, np.ndarray]:
        """The hands, and (H, W, 3) uint8 the picture with its background."""
        planned, clip = self._opened(sequence)
        rendered = self.renderer.render(planned.scene(frame))
        return rendered, compose_frame(rendered, clip.frame(frame))


def generate_sequences(
    sequence_set: SequenceSet,
    out: Path,
    *,
    clips: ClipAssignment | None = None,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Writes the frames that are not there yet.

    Args:
        sequence_set: what to write; `sequences` may grow from one call to the next.
        out: folder of this set alone; frames are folders 00000/00000, 00000/00001, ..., 00001/00000, ...
        clips: `sequence_set.clips()` where the caller has it already.
        workers: processes, each with its own renderer.
        progress: called with (frames there, all frames).

    Returns:
        Number of frames written by this call.

    Raises:
        InputError: the folder belongs to another set or to something else or cannot be written; no background can be
            read; no motion fits the hand box.
        MissingExtraError, RendererError: no renderer on this machine.
        TwoHandsError: a worker process died.
    """
    clips = clips or sequence_set.clips()
    claim_folder(out, sequence_set.manifest(clips))
    for stale in (*out.glob(".*.partial"), *out.glob("*/.*.partial")):
        shutil.rmtree(stale, ignore_errors=True) if stale.is_dir() else stale.unlink(missing_ok=True)
    for index, source in enumerate(clips.sources):
        _describe(out / instance_name(index), sequence_set, index, source)
    jobs = list(_jobs(sequence_set, out))
    total = sequence_set.sequences * sequence_set.frames
    missing = sum(len(frames) for _, frames in jobs)
    there = total - missing
    for written in _write_all(sequence_set, clips.sources, out, jobs, workers):
        there += written
        if progress is not None:
            progress(there, total)
    return missing


def _rng(seed: int, stream: int, index: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=(stream, index)))


def _describe(folder: Path, sequence_set: SequenceSet, index: int, source: ClipSource) -> None:
    """Writes `sequence.json` where it is missing."""
    path = folder / SEQUENCE_FILE
    if path.is_file():
        return
    facts = {
        "sequence": index,
        "frames": sequence_set.frames,
        "fps": sequence_set.fps,
        "background": source.name,
    }
    try:
        folder.mkdir(exist_ok=True)
        partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
        partial.write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")
        os.replace(partial, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error


Job = tuple[int, tuple[int, ...]]
"""A sequence and some of its frames."""


def _jobs(sequence_set: SequenceSet, out: Path) -> Iterator[Job]:
    for index in range(sequence_set.sequences):
        folder = out / instance_name(index)
        missing = [k for k in range(sequence_set.frames) if not (folder / instance_name(k)).is_dir()]
        for first in range(0, len(missing), CHUNK):
            yield index, tuple(missing[first : first + CHUNK])


def _write_all(
    sequence_set: SequenceSet, sources: tuple[ClipSource, ...], out: Path, jobs: list[Job], workers: int
) -> Iterator[int]:
    if workers <= 1 or len(jobs) < 2:
        renderer = SequenceRenderer(sequence_set, sources)
        for index, frames in jobs:
            for frame in frames:
                yield _write_frames(renderer, out, (index, (frame,)))
        return
    yield from in_processes(_work, jobs, workers, _start_worker, (sequence_set, sources, out))


def _write_frames(renderer: SequenceRenderer, out: Path, job: Job) -> int:
    index, frames = job
    for k in frames:
        rendered, image = renderer.frame(index, k)
        write_instance(out / instance_name(index) / instance_name(k), encode_instance(rendered, image))
    return len(frames)


_job: tuple[SequenceRenderer, Path] | None = None
"""Of a worker process: set once by `_start_worker`."""


def _start_worker(sequence_set: SequenceSet, sources: tuple[ClipSource, ...], out: Path) -> None:
    global _job
    _job = (SequenceRenderer(sequence_set, sources), out)


def _work(job: Job) -> int:
    if _job is None:
        raise RuntimeError("worker was not started")
    return _write_frames(*_job, job)
