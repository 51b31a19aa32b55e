"""Render labelled synthetic data: both hands, egocentric view, in the Ego3DHands layout.

Same seed, same bytes, whatever the number of workers. A rerun writes only what is missing.
"""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from twohands.synth.config import SynthConfig
from twohands.synth.motion import MotionConfig

FRAME_SIZE = (480, 270)


@dataclass(frozen=True)
class GenerateArgs:
    """Arguments of `twohands generate`."""

    kind: Annotated[tyro.conf.Positional[Literal["static", "dynamic", "frames"]], tyro.conf.arg(metavar="KIND")]
    """static: single pictures in the Ego3DHands layout; dynamic: sequences in that layout, hands and background in
    motion; frames: hands without background, 480x270 and memory-mapped, a quick source for `twohands train`."""
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
    seed: int = 0
    """Seed of the set."""
    backgrounds: Path | None = None
    """Folder of background pictures, for dynamic sets also of videos, numbered frames and 360-degree panoramas;
    procedural ones if not given."""
    workers: int = 0
    """Processes; 0 takes all cores."""
    config: SynthConfig = field(default_factory=SynthConfig)
    """Distributions of the scenes."""
    motion: MotionConfig = field(default_factory=MotionConfig)
    """Distributions of the motion (dynamic)."""


def run(args: GenerateArgs) -> int:
    """Generate, with a progress bar."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from twohands.synth.cache import build_cache
    from twohands.synth.generate import StaticSet, generate_static

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    workers = args.workers or os.cpu_count() or 1
    if args.kind == "frames":
        config = dataclasses.replace(args.config, width=FRAME_SIZE[0], height=FRAME_SIZE[1])
        with Progress(*columns) as bar:
            task = bar.add_task("frames", total=args.count)
            build_cache(
                args.out,
                config,
                args.seed,
                args.count,
                workers=workers,
                progress=lambda done, _: bar.update(task, completed=done),
            )
        print(f"{args.count} frames in {args.out}; train on them with twohands train STAGE --data {args.out}")
        return 0
    if args.kind == "dynamic":
        return _run_dynamic(args, workers)
    static_set = StaticSet(args.config, args.seed, args.count, args.backgrounds)
    if args.backgrounds is None:
        print("backgrounds: procedural; give photographs with --backgrounds FOLDER")
    with Progress(*columns) as bar:
        task = bar.add_task("instances", total=args.count)
        written = generate_static(
            static_set,
            args.out,
            workers=workers,
            progress=lambda done, _: bar.update(task, completed=done),
        )
    print(f"{written} instances written to {args.out} ({args.count - written} were there already)")
    return 0


def _run_dynamic(args: GenerateArgs, workers: int) -> int:
    """Generate sequences, with a progress bar."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from twohands.synth.sequences import SequenceSet, generate_sequences

    dynamic_set = SequenceSet(
        args.config, args.motion, args.seed, args.sequences, args.frames, args.fps, args.backgrounds
    )
    clips = dynamic_set.clips()
    if args.backgrounds is None:
        print("backgrounds: procedural rooms; give videos, panoramas or photographs with --backgrounds FOLDER")
    for path, reason in clips.skipped:
        print(f"background skipped: {path.name}: {reason}")
    total = args.sequences * args.frames
    with Progress(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()) as bar:
        task = bar.add_task("frames", total=total)
        written = generate_sequences(
            dynamic_set,
            args.out,
            clips=clips,
            workers=workers,
            progress=lambda done, _: bar.update(task, completed=done),
        )
    print(f"{written} frames written to {args.out} ({total - written} were there already)")
    return 0
