"""`twohands track` of a video file, a stream or a camera: decoded, estimated, drawn and written at the same time."""

from __future__ import annotations

import math
import os
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from twohands.cli.output import check_output_folder
from twohands.errors import InputError
from twohands.inference.background import Behind, ahead
from twohands.inference.clip_files import CSV, JSONL, NPZ, ClipFiles
from twohands.inference.frames import CameraFrames, Frame, VideoFrames
from twohands.inference.look_ahead import LookAhead
from twohands.inference.trail import Trail
from twohands.inference.video import VideoEstimator
from twohands.skeleton import SIDES
from twohands.types import PinholeCamera, TwoHandPose
from twohands.visualization.live import draw_live
from twohands.visualization.movie import Movie
from twohands.visualization.view_page import REPORT, ClipReport

OVERLAY: Final = "overlay.mp4"
EXIT_NOTHING_DECODED: Final = 1
_SAY_EVERY_S: Final = 2.0

Estimate = Callable[..., TwoHandPose]
"""`HandEstimator.estimate` or its like: (image, camera, hand length, index=, time_s=, previous=) -> pose."""


@dataclass(frozen=True, slots=True)
class ClipJob:
    """What is to be done with a clip.

    Attributes:
        source: as the user names it.
        out: folder for the results.
        camera_for: camera of frames of a size, or InputError where that cannot be.
        hand_length_m: |wrist - middle knuckle|, metres.
        mirrored: frames are turned back before anything else.
        smooth: smooth ranges, and carry leaving hands on.
        look_ahead_s: seconds that come after a frame and count for its range; 0 smooths with what was before alone.
        overlay: write the overlay as well.
        lines: print the lines of hands.jsonl.
        weights: what estimates.
        more: what else the header of hands.jsonl says.
    """

    source: str
    out: Path
    camera_for: Callable[[int, int], PinholeCamera]
    hand_length_m: float
    mirrored: bool
    smooth: bool
    look_ahead_s: float
    overlay: bool
    lines: bool
    weights: str
    more: dict[str, Any]


@dataclass
class Tally:
    """What has happened in a clip so far.

    Attributes:
        frames: that were estimated.
        skipped: that could not be used with the camera, and
        reason: of the first of them.
        found: frames in which the left and the right hand were found.
        side_changes: how often a hand has taken the other side.
        rested: frames in which HandSegNet has rested.
        seconds: since the beginning.
    """

    frames: int = 0
    skipped: int = 0
    reason: str = ""
    found: list[int] = field(default_factory=lambda: [0, 0])
    side_changes: int = 0
    rested: int = 0
    seconds: float = 0.0


def track_clip(job: ClipJob, frames: VideoFrames | CameraFrames, estimate: Estimate) -> int:
    """Tracks a clip and prints what came of it.

    Args:
        job: what is to be done.
        frames: open; closed by whoever opened it.
        estimate: of single frames.

    Returns:
        0, or 1 where no frame could be decoded or used.
    """
    return _report(job, frames, write_clip(job, frames, estimate))


def write_clip(job: ClipJob, frames: VideoFrames | CameraFrames, estimate: Estimate) -> Tally:
    """Tracks a clip: results into files, and with `ClipJob.lines` on standard output; args as `track_clip`."""
    causal = job.smooth and not job.look_ahead_s
    tally, video = Tally(), VideoEstimator() if causal else VideoEstimator(None)
    smoother = LookAhead(job.look_ahead_s) if job.smooth and job.look_ahead_s else None
    waiting: deque[np.ndarray] = deque()
    started = time.monotonic()
    with ExitStack() as stack:
        live = isinstance(frames, CameraFrames)
        incoming: Iterator[Frame] = iter(frames) if live else ahead(frames)
        writer: Behind[tuple[np.ndarray, TwoHandPose]] | None = None
        camera: PinholeCamera | None = None
        progress = _progress(frames)
        for frame in incoming:
            image = np.ascontiguousarray(frame.image[:, ::-1]) if job.mirrored else frame.image
            try:
                fitted = _camera(job, camera, image)
                pose = video.update(_estimate(job, estimate, image, fitted, frame))
            except InputError as error:
                tally.skipped, tally.reason = tally.skipped + 1, tally.reason or f"frame {frame.index}: {error}"
                continue
            if writer is None:
                camera, writer = fitted, _open_writer(stack, job, fitted, frames.rate)
            waiting.append(image)
            for known in [pose] if smoother is None else smoother.push(pose):
                writer.put((waiting.popleft(), replace(known, masks=None)))
            tally.frames += 1
            for side, hand in enumerate(pose.hands):
                tally.found[side] += hand.present
            progress(tally.frames)
        if smoother is not None and writer is not None:
            for known in smoother.finish():
                writer.put((waiting.popleft(), replace(known, masks=None)))
    tally.side_changes, tally.rested, tally.seconds = video.side_changes, video.rested, time.monotonic() - started
    return tally


def _estimate(
    job: ClipJob, estimate: Estimate, image: np.ndarray, camera: PinholeCamera, frame: Frame
) -> Callable[[Trail | None], TwoHandPose]:
    def run(previous: Trail | None) -> TwoHandPose:
        return estimate(image, camera, job.hand_length_m, index=frame.index, time_s=frame.time_s, previous=previous)

    return run


def _camera(job: ClipJob, camera: PinholeCamera | None, image: np.ndarray) -> PinholeCamera:
    """The clip's camera; of the first frame's size, and of no other from then on.

    Raises:
        InputError: the size changes, or does not fit the camera that was given.
    """
    height, width = image.shape[:2]
    if camera is None:
        return job.camera_for(width, height)
    if (camera.width, camera.height) != (width, height):
        raise InputError(
            f"the size changes from {camera.width}x{camera.height} to {width}x{height}; frames of one size expected"
        )
    return camera


def _open_writer(
    stack: ExitStack, job: ClipJob, camera: PinholeCamera, rate: float | None
) -> Behind[tuple[np.ndarray, TwoHandPose]]:
    """Opens the results' files, and a thread that draws and writes."""
    check_output_folder(job.out, overwrite=True)
    job.out.mkdir(parents=True, exist_ok=True)
    size = (camera.width, camera.height) if job.overlay else None
    report = stack.enter_context(ClipReport(job.out, job.out / JSONL, os.path.basename(job.source), size, rate or 30.0))
    files = stack.enter_context(
        ClipFiles(
            job.out,
            camera,
            source=job.source,
            weights=job.weights,
            hand_length_m=job.hand_length_m,
            more=job.more | {"mirrored": job.mirrored, "smoothed": job.smooth, "look_ahead_s": job.look_ahead_s},
        )
    )
    movie = None
    if job.overlay:
        movie = stack.enter_context(Movie(job.out / OVERLAY, camera.width, camera.height, rate or 30.0))
    first_s: list[float] = []

    def write(item: tuple[np.ndarray, TwoHandPose]) -> None:
        image, pose = item
        line = files.write(pose)
        if job.lines:
            print(line, flush=True)
        if movie is not None and pose.time_s is not None:
            first_s.append(pose.time_s) if not first_s else None
            movie.write(draw_live(image, pose), pose.time_s - first_s[0])
            report.write(image, pose.time_s - first_s[0])

    return stack.enter_context(Behind(write))


def _progress(frames: VideoFrames | CameraFrames) -> Callable[[int], None]:
    """Says on a terminal how far it is."""
    if not sys.stderr.isatty():
        return lambda done: None
    started, said = time.monotonic(), [0.0]

    def say(done: int) -> None:
        now = time.monotonic()
        if now - said[0] > _SAY_EVERY_S:
            said[0] = now
            of = f"/{frames.total}" if frames.total else ""
            print(f"\rframe {frames.decoded}{of}, {done / (now - started):.1f}/s ", end="", file=sys.stderr, flush=True)

    return say


def _report(job: ClipJob, frames: VideoFrames | CameraFrames, tally: Tally) -> int:
    if sys.stderr.isatty():
        print(file=sys.stderr)
    if tally.skipped:
        say(f"{tally.skipped} frames skipped, the first: {tally.reason}")
    if frames.unreadable:
        say(f"{frames.unreadable} of {frames.decoded + frames.unreadable} frames unreadable")
    if not tally.frames:
        say(f"{job.source}: not one frame could be used")
        return EXIT_NOTHING_DECODED
    if not job.lines:
        hands = ", ".join(f"{side} in {count}" for side, count in zip(SIDES, tally.found, strict=True))
        print(f"{tally.frames} frames, {tally.frames / max(tally.seconds, 1e-9):.1f} a second; hands: {hands}; "
              f"side changes: {tally.side_changes}; segmentation rested in {tally.rested}")  # fmt: skip
        names = [JSONL, NPZ, CSV, REPORT] + [OVERLAY] * job.overlay
        print(f"written to {job.out}: {', '.join(names)}")
    return 0


def default_out(source: str) -> Path:
    """out/track/NAME of a clip, a camera or an address."""
    name = os.path.basename(source.rstrip("/")) or "stream"
    stem = name.rpartition(".")[0] or name
    return Path("out") / "track" / "".join(c if c.isalnum() or c in "-_. " else "_" for c in stem)


def check_times(start: float, end: float | None) -> tuple[float, float]:
    """First and last time in seconds, checked."""
    end_s = math.inf if end is None else end
    if not (start >= 0 and end_s > start):
        raise InputError(f"--start and --end: 0 <= start < end expected, got {start:g} and {end_s:g} s")
    return start, end_s


def check_look_ahead(seconds: float) -> float:
    """The look-ahead in seconds, checked; 0 for none."""
    if seconds:
        LookAhead(seconds)
    return seconds


def say(message: str) -> None:
    """One line on stderr; stdout is for results."""
    print(f"twohands: {message}", file=sys.stderr)
