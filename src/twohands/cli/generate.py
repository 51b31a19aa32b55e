"""Render labelled synthetic data: both hands, egocentric view, in the Ego3DHands layout or as tar shards.

Same seed, same bytes, whatever the number of workers. A run may be killed at any moment; the same command goes on and
writes only what is missing. Kinds of sets and splits never share scenes, even with the same seed.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from twohands.cli.progress import progress_of
from twohands.errors import InputError
from twohands.synth.scene.config import PAPER, PRESETS, SynthConfig
from twohands.synth.scene.motion import MotionConfig
from twohands.types import PinholeCamera

if TYPE_CHECKING:
    from twohands.executors.base import Executor
    from twohands.synth.production.produce import Outcome, Plan, Production

FRAME_STEP = 16
"""Widths of 16:9 frames are multiples of this."""
SHOWN_NOTES = 20


@dataclass(frozen=True)
class GenerateArgs:
    """Arguments of `twohands generate`."""

    kind: Annotated[tyro.conf.Positional[Literal["static", "dynamic", "frames"]], tyro.conf.arg(metavar="KIND")]
    """static: single pictures in the Ego3DHands layout; dynamic: sequences in that layout, hands and background in
    motion; frames: hands without background, 16:9 and memory-mapped, a quick source for `twohands train`."""
    out: Path
    """Folder of the set."""
    count: int = 100
    """Number of instances (static, frames)."""
    sequences: int = 10
    """Number of sequences (dynamic)."""
    frames: int = 500
    """Frames per sequence (dynamic)."""
    fps: float = 30.0
    """Frames per second (dynamic)."""
    frame_width: int = 480
    """Width of frames, a multiple of 16. Distant hands are as sharp as in pictures of 960 only at 960, which takes four
    times the space."""
    seed: int = 0
    """Seed of the set, 0 or larger."""
    split: Literal["train", "val", "test"] = "train"
    """Part of the set; splits share no scene, whatever their seeds. Give each its own folder of backgrounds."""
    backgrounds: Path | None = None
    """Folder of background pictures, for dynamic sets also of videos, numbered frames and 360-degree panoramas;
    procedural ones if not given."""
    fabrics: Path | None = None
    """Folder of tileable pictures of cloth for sleeves and gloves (raster); plain and striped ones if not given."""
    format: Literal["ego3dhands", "webdataset"] = "ego3dhands"
    """ego3dhands: a folder per instance, as the official data; webdataset: tar shards."""
    shard_size: int = 1000
    """Instances per tar shard."""
    renderer: Literal["raster", "blender"] = "raster"
    """raster: OpenGL, milliseconds a picture; blender: the same scenes and labels, path-traced by Blender's Cycles,
    over a hundred times slower (extra 'blender', Python 3.11)."""
    workers: int = 0
    """Processes; 0 takes all cores, of the machine or of the cluster: one process each, but for Blender a single one,
    which uses them all."""
    engine: Literal["local", "ray"] = "local"
    """Who makes a static or dynamic set: processes of this machine, or a Ray cluster, with the same bytes (extra
    'cluster')."""
    ray_address: str | None = None
    """HOST:PORT of a running Ray cluster's head, "auto" for the cluster that this machine belongs to; if not given, one
    is started on this machine (ray)."""
    preset: Literal["paper", "wild", "people"] = "paper"
    """paper: one character and one camera, as in the paper; wild: all kinds of adults, cameras and clothes, hands that
    meet, whole people; people: only these. Settings given as --config.NAME change it."""
    config: SynthConfig = field(default_factory=SynthConfig)
    """Distributions of the scenes; the defaults are those of the preset."""
    motion: MotionConfig = field(default_factory=MotionConfig)
    """Distributions of the motion (dynamic)."""


def defaults(words: Sequence[str]) -> GenerateArgs:
    """What the options start from: the settings of the preset that is asked for."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--preset", nargs="?")
    preset = parser.parse_known_args(words)[0].preset
    return GenerateArgs(kind=tyro.MISSING, out=tyro.MISSING, config=PRESETS.get(preset, PAPER))


def run(args: GenerateArgs) -> int:
    """Generate, with progress, rate and time left."""
    if args.workers < 0:
        raise InputError(f"--workers must be 0 (all cores) or more, got {args.workers}")
    for name in ("count", "sequences", "frames"):
        if getattr(args, name) < 1:
            raise InputError(f"--{name} must be at least 1, got {getattr(args, name)}")
    if args.ray_address is not None and args.engine != "ray":
        raise InputError("--ray-address needs --engine ray")
    if args.engine == "ray":  # its workers have other working directories
        folders = {"backgrounds": args.backgrounds, "fabrics": args.fabrics}
        args = dataclasses.replace(args, **{name: path and path.absolute() for name, path in folders.items()})
    if args.fabrics is not None and args.config.sleeves == args.config.gloves == 0:
        raise InputError("--fabrics needs people with sleeves or gloves: take --preset wild, or set --config.sleeves")
    return {"static": _static, "dynamic": _dynamic, "frames": _frames}[args.kind](args)


def workers_of(args: GenerateArgs) -> int:
    """Number of processes."""
    return args.workers or (1 if args.renderer == "blender" else os.cpu_count()) or 1


def executor_of(args: GenerateArgs, production: Production) -> Executor:
    """Who does the work.

    Raises:
        MissingExtraError: Ray is asked for and not installed.
        InputError: nothing answers at the address of the Ray cluster.
    """
    if args.engine == "ray":
        from twohands.executors.ray_cluster import RayCluster

        workers = workers_of(args) if args.renderer == "blender" else args.workers
        cluster = RayCluster(args.ray_address, workers, production.made_with)
        cluster.check()
        return cluster

    from twohands.executors.local import LocalProcesses

    return LocalProcesses(workers_of(args))


def _static(args: GenerateArgs) -> int:
    from twohands.synth.sets.static import StaticSet

    if args.backgrounds is None:
        print("backgrounds: procedural; give photographs with --backgrounds FOLDER")
    static_set = StaticSet(
        args.config, args.seed, args.count, args.backgrounds, args.split, args.renderer, args.fabrics
    )
    report(write(static_set, args, executor_of(args, static_set)), args, len(static_set))
    return 0


def write(production: Production, args: GenerateArgs, executor: Executor) -> Outcome:
    """Carries out a production run with progress; says how to go on where it is interrupted."""
    from twohands.synth.production.produce import produce

    with progress_of("instances") as progress:

        def announce(plan: Plan) -> None:
            print(describe(plan))
            progress(plan.there, plan.there + plan.missing)

        try:
            return produce(
                production,
                args.out,
                executor,
                layout=args.format,
                shard_size=args.shard_size,
                announce=announce,
                progress=progress,
            )
        except KeyboardInterrupt:
            print(f"{args.out} is sound as far as it goes: run the same command again to go on", file=sys.stderr)
            raise


def describe(plan: Plan) -> str:
    """One line: what is there, what is to be made, what room it takes."""
    size = f"about {plan.bytes_needed / 1e9:.2f} GB, {plan.bytes_free / 1e9:.1f} GB free"
    return f"{plan.missing} instances to make ({size}), {plan.there} are there already"


def report(outcome: Outcome, args: GenerateArgs, total: int) -> None:
    """What was written of `total` instances, and what the workers had to say."""
    print(f"{outcome.written} instances written to {args.out} ({total - outcome.written} were there already)")
    _name_skipped(outcome.notes)


def _name_skipped(notes: Sequence[str]) -> None:
    """The user's files that could not be read, if any."""
    if notes:
        print(f"{len(notes)} files were skipped:")
        for note in notes[:SHOWN_NOTES]:
            print(f"  {note}")
        if len(notes) > SHOWN_NOTES:
            print(f"  ... and {len(notes) - SHOWN_NOTES} more")


def _frames(args: GenerateArgs) -> int:
    from twohands.synth.sets.cache import build_cache

    if args.backgrounds or args.split != "train" or args.format != "ego3dhands":
        raise InputError("frames have no background, split or format: leave --backgrounds, --split and --format out")
    if args.engine != "local":
        raise InputError("frames are made on this machine alone: leave --engine out")
    if args.frame_width < FRAME_STEP or args.frame_width % FRAME_STEP:
        raise InputError(f"--frame-width must be a multiple of {FRAME_STEP}, got {args.frame_width}")
    config = _at_frame_size(args.config, args.frame_width)
    with progress_of("frames") as progress:
        notes = build_cache(
            args.out,
            config,
            args.seed,
            args.count,
            workers=workers_of(args),
            renderer=args.renderer,
            fabrics=args.fabrics,
            progress=progress,
        )
    print(f"{args.count} frames in {args.out}; train on them with twohands train STAGE --data {args.out}")
    _name_skipped(notes)
    return 0


def _at_frame_size(config: SynthConfig, width: int) -> SynthConfig:
    """The same scenes in pictures of this width; given intrinsics shrink with them."""
    height = width * 9 // 16
    intrinsics = config.intrinsics
    if intrinsics is not None:
        camera = PinholeCamera(*intrinsics, config.width, config.height).resized(width, height)
        intrinsics = (camera.fx, camera.fy, camera.cx, camera.cy)
    return dataclasses.replace(config, width=width, height=height, intrinsics=intrinsics)


def _dynamic(args: GenerateArgs) -> int:
    from twohands.synth.sets.sequences import SequenceSet

    if args.backgrounds is None:
        print("backgrounds: procedural rooms; give videos, panoramas or photographs with --backgrounds FOLDER")
    dynamic_set = SequenceSet(
        args.config,
        args.motion,
        args.seed,
        args.sequences,
        args.frames,
        args.fps,
        args.backgrounds,
        args.split,
        args.renderer,
        args.fabrics,
    )
    for path, reason in dynamic_set.clips.skipped:
        print(f"background skipped: {path.name}: {reason}")
    report(write(dynamic_set, args, executor_of(args, dynamic_set)), args, len(dynamic_set))
    return 0
