"""One video file, stream or camera: decoded, estimated, drawn and written at the same time."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from twohands.errors import InputError
from twohands.formats.profiles import IntrinsicsSource, ScaleSource
from twohands.inference.background import Behind, ahead
from twohands.inference.clip_files import CSV, JSONL, NPZ, ClipFiles
from twohands.inference.decision import DecisionConfig
from twohands.inference.frames import CameraFrames, Frame, VideoFrames
from twohands.inference.look_ahead import LookAhead
from twohands.inference.range_sigma import with_sources
from twohands.inference.tracker import DEFAULT_SMOOTHING
from twohands.inference.trail import Trail
from twohands.inference.video import VideoEstimator
from twohands.types import PinholeCamera, TwoHandPose
from twohands.visualization.live import draw_live
from twohands.visualization.movie import Movie
from twohands.visualization.view_page import REPORT, ClipReport

OVERLAY: Final = "overlay.mp4"
RESULTS: Final = frozenset((JSONL, NPZ, CSV, OVERLAY, REPORT))
"""Names of all files that `write_clip` writes."""

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
        weights: what estimates.
        more: what else the header of hands.jsonl says.
        decision: of the weights' card; None for an estimator that has none.
    """

    source: str
    out: Path
    camera_for: Callable[[int, int], PinholeCamera]
    hand_length_m: float
    mirrored: bool
    smooth: bool
    look_ahead_s: float
    overlay: bool
    weights: str
    more: dict[str, Any]
    decision: DecisionConfig | None = None


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


def sourced(estimate: Estimate, scale_source: ScaleSource, camera_source: IntrinsicsSource) -> Estimate:
    """An estimate whose hands say how length and camera are known."""

    def with_them(*args: Any, **options: Any) -> TwoHandPose:
        return with_sources(estimate(*args, **options), scale_source, camera_source)

    return with_them


def write_clip(
    job: ClipJob,
    frames: VideoFrames | CameraFrames,
    estimate: Estimate,
    *,
    take_line: Callable[[str], None] | None = None,
    progress: Callable[[int], None] | None = None,
) -> Tally:
    """Tracks a clip; its results go into files, of which there is none where no frame can be used.

    Args:
        job: what is to be done.
        frames: open; closed by whoever opened it.
        estimate: of single frames.
        take_line: called with every line of hands.jsonl, from another thread.
        progress: called with the number of frames that are done, after each.

    Raises:
        OSError: the disk is full, or the folder cannot be written; what was written until then stays.
    """
    causal = job.smooth and not job.look_ahead_s
    tally, video = Tally(), VideoEstimator(DEFAULT_SMOOTHING if causal else None, decision=job.decision)
    smoother = LookAhead(job.look_ahead_s) if job.smooth and job.look_ahead_s else None
    waiting: deque[np.ndarray] = deque()
    started = time.monotonic()
    with ExitStack() as stack:
        live = isinstance(frames, CameraFrames)
        incoming: Iterator[Frame] = iter(frames) if live else ahead(frames)
        writer: Behind[tuple[np.ndarray, TwoHandPose]] | None = None
        camera: PinholeCamera | None = None
        for frame in incoming:
            image = np.ascontiguousarray(frame.image[:, ::-1]) if job.mirrored else frame.image
            try:
                fitted = _camera(job, camera, image)
                pose = video.update(_estimate(job, estimate, image, fitted, frame))
            except InputError as error:
                tally.skipped, tally.reason = tally.skipped + 1, tally.reason or f"frame {frame.index}: {error}"
                continue
            if writer is None:
                camera, writer = fitted, _open_writer(stack, job, fitted, frames.rate, take_line)
            waiting.append(image)
            for known in [pose] if smoother is None else smoother.push(pose):
                writer.put((waiting.popleft(), known.without_masks()))
            tally.frames += 1
            for side, hand in enumerate(pose.hands):
                tally.found[side] += hand.present
            if progress is not None:
                progress(tally.frames)
        if smoother is not None and writer is not None:
            for known in smoother.finish():
                writer.put((waiting.popleft(), known.without_masks()))
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
    stack: ExitStack,
    job: ClipJob,
    camera: PinholeCamera,
    rate: float | None,
    take_line: Callable[[str], None] | None,
) -> Behind[tuple[np.ndarray, TwoHandPose]]:
    """Opens the results' files, and a thread that draws and writes."""
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
        if take_line is not None:
            take_line(line)
        if movie is not None and pose.time_s is not None:
            first_s.append(pose.time_s) if not first_s else None
            movie.write(draw_live(image, pose), pose.time_s - first_s[0])
            report.write(image, pose.time_s - first_s[0])

    return stack.enter_context(Behind(write))
