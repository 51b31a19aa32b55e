"""`twohands track` of a video file, a stream or a camera: what is said while it runs, and of what came of it."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from twohands.batch.clip import OVERLAY, ClipJob, Estimate, Tally, write_clip
from twohands.errors import InputError
from twohands.inference.clip_files import CSV, JSONL, NPZ
from twohands.inference.frames import CameraFrames, VideoFrames
from twohands.inference.look_ahead import LookAhead
from twohands.skeleton import SIDES
from twohands.visualization.view_page import REPORT

EXIT_NOTHING_DECODED: Final = 1
_SAY_EVERY_S: Final = 2.0


def track_clip(job: ClipJob, frames: VideoFrames | CameraFrames, estimate: Estimate, *, lines: bool) -> int:
    """Tracks a clip and prints what came of it.

    Args:
        job: what is to be done.
        frames: open; closed by whoever opened it.
        estimate: of single frames.
        lines: print the lines of hands.jsonl.

    Returns:
        0, or 1 where no frame could be decoded or used.
    """
    take_line = _print_line if lines else None
    tally = write_clip(job, frames, estimate, take_line=take_line, progress=_progress(frames))
    return _report(job, frames, tally, lines)


def _print_line(line: str) -> None:
    print(line, flush=True)


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


def _report(job: ClipJob, frames: VideoFrames | CameraFrames, tally: Tally, lines: bool) -> int:
    if sys.stderr.isatty():
        print(file=sys.stderr)
    if tally.skipped:
        say(f"{tally.skipped} frames skipped, the first: {tally.reason}")
    if frames.unreadable:
        say(f"{frames.unreadable} of {frames.decoded + frames.unreadable} frames unreadable")
    if not tally.frames:
        say(f"{job.source}: not one frame could be used")
        return EXIT_NOTHING_DECODED
    if not lines:
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
