"""Time the complete pipeline, stage by stage, on pictures that show both hands, or on a clip.

The networks run as for `twohands track`. Reading pictures is not part of the pipeline and stands beneath it. Of a clip
(`--video`) decoding, drawing and writing are timed as well, and all of it side by side.
"""

from __future__ import annotations

import json
import os
import platform
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import tyro

from twohands.cli.bench_clip import clip_record, measure_clip, open_peer, print_clip_table
from twohands.cli.demo import examples_folder
from twohands.cli.track import option
from twohands.errors import InputError
from twohands.formats.camera_files import camera_for_image, read_camera
from twohands.formats.pictures import list_images, read_image
from twohands.inference.estimator import HandEstimator
from twohands.inference.frames import VideoFrames
from twohands.inference.weights import DEFAULT_PRESET
from twohands.studies.stage_times import ROWS, StageClock, timed_estimate
from twohands.types import PinholeCamera

WARM_UP = 5
"""Frames before the clock counts: the first ones find cold caches and sleeping cores."""
DEFAULT_FOV_DEG = 60.0


@dataclass(frozen=True)
class BenchArgs:
    """Arguments of `twohands bench`."""

    input: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="INPUT", help_behavior_hint="")] = None
    """Picture or folder of pictures, of which those are used where both hands are found; if not given, the packaged
    examples, 960x540."""
    video: Annotated[Path | None, option("CLIP")] = None
    """Time this clip instead: every stage, from the file to the files as `twohands track` works, the most memory, and
    MediaPipe beside it where it is installed (extra 'video')."""
    count: int = 200
    """Frames to time; the pictures are taken in turn, of a clip the first ones."""
    threads: int = 0
    """CPU threads; 0 takes all cores."""
    weights: Annotated[str, tyro.conf.arg(metavar="NAME")] = DEFAULT_PRESET
    """Preset that ships with the package, or a weights folder."""
    json: bool = False
    """Print JSON instead of the table."""
    peer_python: Annotated[Path | None, option("FILE")] = None
    """With --video: interpreter of the environment that holds mediapipe; this one if not given."""
    mediapipe_model: Annotated[Path | None, option("FILE")] = None
    """With --video: hand_landmarker.task, which mediapipe needs from 0.10.30 on."""


def run(args: BenchArgs) -> int:
    """Measure and print."""
    if args.count < 1:
        raise InputError(f"--count must be at least 1, got {args.count}")
    if args.threads < 0:
        raise InputError(f"--threads must be 0 (all cores) or more, got {args.threads}")
    if args.threads:
        cv2.setNumThreads(args.threads)
    if args.video is not None:
        return _run_clip(args, args.video)
    files = _files(args.input)
    reading_ms, images = _read_timed(files)
    estimator = HandEstimator.from_preset(args.weights, args.threads)
    pictures = _with_both_hands(estimator, [(image, _camera(args.input, image)) for image in images])
    times_ms = measure(estimator, pictures, args.count)
    record = _about(estimator, pictures[0][0]) | {
        "frames": args.count,
        "frames_per_second": round(1e3 * args.count / float(times_ms["total"].sum()), 2),
        "ms": {name: summary(values) for name, values in times_ms.items()},
        "reading_ms": summary(reading_ms),
    }
    if args.json:
        print(json.dumps(record))
    else:
        print_table(record)
    return 0


def _run_clip(args: BenchArgs, clip: Path) -> int:
    """Of a clip."""
    if args.input is not None:
        raise InputError(f"give a picture ({args.input}) or --video, not both")
    with VideoFrames(clip) as frames:
        first = next(iter(frames), None)
    if first is None:
        raise InputError(f"{clip}: not one frame can be decoded")
    estimator = HandEstimator.from_preset(args.weights, args.threads)
    with ExitStack() as stack:
        peer = open_peer(args.peer_python, args.mediapipe_model)
        if peer is not None:
            stack.enter_context(peer)
        record = _about(estimator, first.image) | clip_record(measure_clip(clip, estimator, args.count, peer))
        if peer is not None:
            record["mediapipe"]["name"] = f"MediaPipe Hands {peer.version}"
    if args.json:
        print(json.dumps(record))
    else:
        print(_heading(record))
        print_clip_table(record)
    return 0


def _about(estimator: HandEstimator, image: np.ndarray) -> dict[str, Any]:
    """What was measured, and where."""
    return {
        "weights": estimator.card.name,
        "runtime": estimator.networks.runtime,
        "processor": processor(),
        "cores": usable_cores(),
        "picture": f"{image.shape[1]}x{image.shape[0]}",
    }


def _heading(record: dict[str, Any]) -> str:
    return f"weights {record['weights']}, {record['runtime']}; {record['processor']}, cores: {record['cores']}"


def measure(
    estimator: HandEstimator, pictures: list[tuple[np.ndarray, PinholeCamera]], count: int
) -> dict[str, np.ndarray]:
    """Milliseconds of every stage for `count` frames after a warm-up.

    Args:
        estimator: whose stages are timed; it stays as it is.
        pictures: images with their cameras, taken in turn.
        count: frames.

    Returns:
        Stage name -> (count,), in the order of the pipeline, and at the end their sum, "total".
    """
    clock = StageClock()
    estimate = timed_estimate(estimator, clock)
    rows = []
    for i in range(WARM_UP + count):
        clock.reset()
        estimate(*pictures[i % len(pictures)])
        rows.append([1e3 * clock.seconds[name] for name in ROWS])
    columns = np.array(rows[WARM_UP:]).T
    return {**dict(zip(ROWS, columns, strict=True)), "total": columns.sum(axis=0)}


def summary(values_ms: np.ndarray) -> dict[str, float]:
    """Median and 90th percentile, rounded to microseconds."""
    return {"median": round(float(np.median(values_ms)), 3), "p90": round(float(np.percentile(values_ms, 90)), 3)}


def processor() -> str:
    """The processor's name as the system gives it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def usable_cores() -> int:
    """Cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def print_table(record: dict[str, Any]) -> None:
    """Print one row per stage."""
    from rich.console import Console
    from rich.table import Table

    print(_heading(record))
    print(f"{record['frames']} frames of {record['picture']}, both hands in each")
    table = Table()
    table.add_column("stage", no_wrap=True)
    for name in ("median ms", "p90 ms"):
        table.add_column(name, justify="right")
    for name, values in record["ms"].items():
        table.add_section() if name == "total" else None
        table.add_row(name, f"{values['median']:.2f}", f"{values['p90']:.2f}")
    Console().print(table)
    print(f"{record['frames_per_second']:.1f} frames per second")
    print(f"beside it, reading a picture file: {record['reading_ms']['median']:.2f} ms")


def _files(source: Path | None) -> list[Path]:
    folder = examples_folder() if source is None else source
    return list_images(folder) if folder.is_dir() else [folder]


def _read_timed(files: list[Path]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Milliseconds per file, and the pictures."""
    times, images = [], []
    for path in files:
        start = time.perf_counter()
        images.append(read_image(path))
        times.append(1e3 * (time.perf_counter() - start))
    return np.array(times), images


def _camera(source: Path | None, image: np.ndarray) -> PinholeCamera:
    """Intrinsics decide where hands are, not how long it takes to find out."""
    height, width = image.shape[:2]
    if source is None:
        return camera_for_image(read_camera(examples_folder() / "camera.json"), width, height)
    return PinholeCamera.from_fov(DEFAULT_FOV_DEG, width, height)


def _with_both_hands(
    estimator: HandEstimator, pictures: list[tuple[np.ndarray, PinholeCamera]]
) -> list[tuple[np.ndarray, PinholeCamera]]:
    """The pictures in which both hands are found."""
    both = [picture for picture in pictures if all(hand.present for hand in estimator.estimate(*picture).hands)]
    if not both:
        raise InputError("no picture shows both hands; what is timed is the complete pipeline with two of them")
    return both
