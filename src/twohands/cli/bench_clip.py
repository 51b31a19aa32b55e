"""Time a clip: every stage by itself, then all of them side by side as `twohands track` runs them.

The first pass does one thing after the other, so that each has its time; MediaPipe, where it is installed, sees every
frame right after us, so that both meet the same load. The second pass is `track` with its overlay, from the file to the
files.
"""

from __future__ import annotations

import math
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from twohands.batch.clip import ClipJob, write_clip
from twohands.errors import InputError
from twohands.inference.clip_files import ClipFiles
from twohands.inference.estimator import DEFAULT_HAND_LENGTH_M, HandEstimator
from twohands.inference.frames import Frame, VideoFrames
from twohands.inference.video import VideoEstimator
from twohands.peers.mediapipe_hands import MediaPipeHands
from twohands.studies.stage_times import ROWS, StageClock, timed_estimate
from twohands.types import PinholeCamera
from twohands.visualization.live import draw_live
from twohands.visualization.movie import Movie

DECODE: Final = "decoding"
CLIP: Final = "sides, smoothing"
DRAW: Final = "overlay, two views"
ENCODE: Final = "H.264"
FILES: Final = "hands.jsonl and its kin"
CLIP_ROWS: Final = (DECODE, *ROWS, CLIP, DRAW, ENCODE, FILES)
"""Every name under which time counts, in the order of the work."""
ESTIMATES: Final = (*ROWS, CLIP)
"""Those that are estimates, not reading, drawing or writing."""
WARM_UP: Final = 5
"""Frames before the clock counts."""
DEFAULT_FOV_DEG: Final = 60.0
"""The camera decides where hands are, not how long it takes to find out."""


@dataclass(frozen=True, slots=True)
class ClipTimes:
    """What was measured on a clip.

    Attributes:
        stages_ms: row of `CLIP_ROWS` -> (N,) milliseconds of every frame.
        peer_ms: (N,) the same of MediaPipe; None where it is not installed.
        both: frames with both hands.
        rested: frames in which HandSegNet rested.
        together_s: seconds that `track` takes for the same frames.
        end_s: time of the last one in the clip.
    """

    stages_ms: dict[str, np.ndarray]
    peer_ms: np.ndarray | None
    both: int
    rested: int
    together_s: float
    end_s: float

    @property
    def frames(self) -> int:
        """How many frames there were."""
        return len(self.stages_ms[DECODE])

    @property
    def estimates_ms(self) -> np.ndarray:
        """(N,) milliseconds of the estimates alone."""
        return np.sum([self.stages_ms[name] for name in ESTIMATES], axis=0)

    @property
    def together_over_estimates(self) -> float:
        """Time of everything side by side over that of the estimates alone."""
        return self.together_s / (1e-3 * float(self.estimates_ms.sum()))


def measure_clip(clip: Path, estimator: HandEstimator, count: int, peer: MediaPipeHands | None) -> ClipTimes:
    """Times the first `count` frames of a clip, and those alone.

    Raises:
        InputError: the clip cannot be read, or holds too few frames.
    """
    with tempfile.TemporaryDirectory() as folder:
        stages_ms, peer_ms, both, rested, end_s = _one_by_one(clip, estimator, count, peer, Path(folder) / "alone")
        together_s = _together(clip, estimator, end_s, Path(folder) / "together")
    return ClipTimes(stages_ms, peer_ms, both, rested, together_s, end_s)


def open_peer(python: Path | None, model: Path | None) -> MediaPipeHands | None:
    """MediaPipe as it follows hands through a video; None where it is not installed and nobody has asked for it.

    Raises:
        InputError: the interpreter that was named has none.
    """
    try:
        return MediaPipeHands(python, handedness="own", video=True, model=model)
    except InputError:
        if python is None and model is None:
            return None
        raise


def peak_memory_mb() -> float | None:
    """The most memory that this process has had, megabytes; None where the system does not say."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    unit = 2**20 if sys.platform == "darwin" else 2**10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def clip_record(times: ClipTimes) -> dict[str, Any]:
    """What was measured, as JSON values: medians and 90th percentiles are milliseconds a frame."""
    estimates_ms = times.estimates_ms
    peer = None
    if times.peer_ms is not None:
        peer = summary(times.peer_ms) | {"frames_per_second": _rate(times.peer_ms)}
    memory_mb = peak_memory_mb()
    return {
        "frames": times.frames,
        "both_hands": times.both,
        "rested": times.rested,
        "ms": {name: summary(values) for name, values in times.stages_ms.items()},
        "estimates": summary(estimates_ms) | {"frames_per_second": _rate(estimates_ms)},
        "end_to_end": {
            "frames_per_second": round(times.frames / times.together_s, 2),
            "over_estimates_alone": round(times.together_over_estimates, 3),
        },
        "peak_memory_mb": None if memory_mb is None else round(memory_mb, 1),
        "mediapipe": peer,
    }


def print_clip_table(record: dict[str, Any]) -> None:
    """Prints `clip_record`."""
    from rich.console import Console
    from rich.table import Table

    print(
        f"{record['frames']} frames of {record['picture']}, both hands in {record['both_hands']}; "
        f"HandSegNet rested in {record['rested']}"
    )
    table = Table()
    table.add_column("stage", no_wrap=True)
    for name in ("mean ms", "median ms", "p90 ms"):
        table.add_column(name, justify="right")
    rows = record["ms"] | {"estimates alone": record["estimates"]}
    if record["mediapipe"] is not None:
        rows |= {record["mediapipe"]["name"]: record["mediapipe"]}
    for name, values in rows.items():
        if name == "estimates alone":
            table.add_section()
        table.add_row(name, *(f"{values[key]:.2f}" for key in ("mean", "median", "p90")))
    Console().print(table)
    end = record["end_to_end"]
    print(
        f"estimates alone {record['estimates']['frames_per_second']:.1f} frames per second; from file to files "
        f"{end['frames_per_second']:.1f}, {end['over_estimates_alone']:.2f} times the time of the estimates"
    )
    if record["mediapipe"] is None:
        print("MediaPipe is not installed here: --peer-python names the interpreter of an environment that has it")
    else:
        print(f"{record['mediapipe']['name']} {record['mediapipe']['frames_per_second']:.1f} frames per second")
    if record["peak_memory_mb"] is not None:
        print(f"most memory: {record['peak_memory_mb']:.0f} MB")


def summary(values_ms: np.ndarray) -> dict[str, float]:
    """Mean, median and 90th percentile, rounded to microseconds. The mean counts: frames differ by their nature."""
    named = {"mean": np.mean(values_ms), "median": np.median(values_ms), "p90": np.percentile(values_ms, 90)}
    return {name: round(float(value), 3) for name, value in named.items()}


def _one_by_one(
    clip: Path, estimator: HandEstimator, count: int, peer: MediaPipeHands | None, out: Path
) -> tuple[dict[str, np.ndarray], np.ndarray | None, int, int, float]:
    """Every stage by itself."""
    clock, video = StageClock(), VideoEstimator(decision=estimator.card.decision)
    timed = timed_estimate(estimator, clock)
    rows: list[list[float]] = []
    peer_ms: list[float] = []
    both, end_s = 0, 0.0
    with ExitStack() as stack:
        frames = stack.enter_context(VideoFrames(clip))
        decoded: Iterator[Frame] = iter(frames)
        take = clock.timed(DECODE, lambda: next(decoded, None))
        frame = take()
        if frame is None:
            raise InputError(f"{clip}: not one frame can be decoded")
        height, width = frame.image.shape[:2]
        camera = PinholeCamera.from_fov(DEFAULT_FOV_DEG, width, height)
        for _ in range(WARM_UP):
            estimator.estimate(frame.image, camera)
        if peer is not None:
            peer.detect(frame.image)
        out.mkdir()
        files = stack.enter_context(
            ClipFiles(out, camera, source=clip.name, weights=estimator.card.name, hand_length_m=DEFAULT_HAND_LENGTH_M)
        )
        movie = stack.enter_context(Movie(out / "overlay.mp4", width, height, frames.rate or 30.0))
        update = clock.timed(CLIP, video.update)
        draw, encode = clock.timed(DRAW, draw_live), clock.timed(ENCODE, movie.write)
        write = clock.timed(FILES, files.write)
        start_s = frame.time_s
        while frame is not None and len(rows) < count:
            shown: Frame = frame

            def estimate(trail: Any, shown: Frame = shown) -> Any:
                known = {"index": shown.index, "time_s": shown.time_s, "previous": trail}
                return timed(shown.image, camera, DEFAULT_HAND_LENGTH_M, **known)

            pose = update(estimate).without_masks()
            if peer is not None:
                begun = time.perf_counter()
                peer.detect(shown.image)
                peer_ms.append(1e3 * (time.perf_counter() - begun))
            encode(draw(shown.image, pose), shown.time_s - start_s)
            write(pose)
            both += all(hand.present for hand in pose.hands)
            rows.append([1e3 * clock.seconds[name] for name in CLIP_ROWS])
            end_s = shown.time_s
            clock.reset()
            frame = take()
    columns = dict(zip(CLIP_ROWS, np.array(rows).T, strict=True))
    return columns, np.array(peer_ms) if peer_ms else None, both, video.rested, end_s


def _together(clip: Path, estimator: HandEstimator, end_s: float, out: Path) -> float:
    """Seconds that `track` takes for the frames up to a time, from the file to the files."""
    job = ClipJob(
        str(clip),
        out,
        lambda width, height: PinholeCamera.from_fov(DEFAULT_FOV_DEG, width, height),
        DEFAULT_HAND_LENGTH_M,
        mirrored=False,
        smooth=True,
        look_ahead_s=0.0,
        overlay=True,
        weights=estimator.card.name,
        more={},
        decision=estimator.card.decision,
    )
    with VideoFrames(clip, end_s=math.nextafter(end_s, math.inf)) as frames:
        return write_clip(job, frames, estimator.estimate).seconds


def _rate(times_ms: np.ndarray) -> float:
    return round(1e3 * len(times_ms) / float(times_ms.sum()), 2)
