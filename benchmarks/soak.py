"""Ten minutes of video at 30 frames a second: the memory of `twohands track` does not grow.

    python -m benchmarks.soak --out out/soak                     # 18,000 frames of 320x180, about a quarter of an hour
    python -m benchmarks.soak --frames 3000 --from-frame 1000 --out out/soak

A packaged picture of both hands moves about; the clip is tracked with overlay and all files, in this process. Printed
is the memory (resident set, /proc) at some frames, and its growth from frame 2,000 to the end; with 5 % or more the
status is 1.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from twohands.batch.clip import ClipJob, write_clip
from twohands.cli.bench import usable_cores
from twohands.cli.demo import examples_folder
from twohands.cli.output import check_output_folder
from twohands.errors import TwoHandsError
from twohands.formats.pictures import list_images, read_image
from twohands.inference.estimator import DEFAULT_HAND_LENGTH_M, HandEstimator
from twohands.inference.frames import VideoFrames
from twohands.inference.known import assumed_camera
from twohands.inference.weights import DEFAULT_PRESET
from twohands.types import TwoHandPose
from twohands.visualization.movie import Movie

RATE = 30.0
SIZE = (320, 180)
PERIOD_S = (7.0, 11.0)
"""Of the picture's way to and fro, across and down."""
SHARE = 0.1
"""How far it goes, as a share of its size."""
LIMIT = 0.05
"""Growth from which on memory is not flat."""
STATUS = Path("/proc/self/statm")
PAGE_BYTES = 4096


@dataclass
class WatchedEstimator:
    """An estimator that notes the memory at every frame.

    Attributes:
        estimator: that works.
        memory_mb: resident set before every frame so far, megabytes.
    """

    estimator: HandEstimator
    memory_mb: list[float] = field(default_factory=list)

    def estimate(self, *given: Any, **options: Any) -> TwoHandPose:
        """As `HandEstimator.estimate`."""
        self.memory_mb.append(resident_mb())
        return self.estimator.estimate(*given, **options)


def resident_mb() -> float:
    """Memory of this process, megabytes."""
    return int(STATUS.read_text().split()[1]) * PAGE_BYTES / 1e6


def write_moving_picture(path: Path, count: int) -> None:
    """A video of `count` frames of `SIZE`, in which a picture of both hands moves to and fro."""
    image = cv2.resize(read_image(list_images(examples_folder())[0]), SIZE, interpolation=cv2.INTER_AREA)
    with Movie(path, *SIZE, RATE) as movie:
        for number in range(count):
            time_s = number / RATE
            shift = [SHARE * size * np.sin(2 * np.pi * time_s / s) for size, s in zip(SIZE, PERIOD_S, strict=True)]
            place = np.array([[1, 0, shift[0]], [0, 1, shift[1]]], np.float64)
            movie.write(cv2.warpAffine(image, place, SIZE, borderMode=cv2.BORDER_REFLECT), time_s)


def growth(memory_mb: np.ndarray, start: int) -> float:
    """Growth of memory from a frame to the end, as a share of what it was; medians of 100 frames count."""
    before, after = np.median(memory_mb[start : start + 100]), np.median(memory_mb[-100:])
    return float(after / before - 1)


def main() -> int:
    """Reads the options, tracks, prints."""
    parser = argparse.ArgumentParser(description="Tracks a long clip and watches the memory.")
    parser.add_argument("--frames", type=int, default=18000)
    parser.add_argument("--from-frame", type=int, default=2000, help="whose memory is compared with that at the end")
    parser.add_argument("--weights", default=DEFAULT_PRESET)
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    if not 0 <= options.from_frame <= options.frames - 200:
        parser.error("--from-frame must leave 200 frames to the end")
    try:
        check_output_folder(options.out, overwrite=True)
        options.out.mkdir(parents=True, exist_ok=True)
        clip = options.out / "moving.mp4"
        write_moving_picture(clip, options.frames)
        watched = WatchedEstimator(HandEstimator.from_preset(options.weights, options.threads))
        job = ClipJob(
            str(clip),
            options.out / "track",
            assumed_camera,
            DEFAULT_HAND_LENGTH_M,
            mirrored=False,
            smooth=True,
            look_ahead_s=0.0,
            overlay=True,
            weights=options.weights,
            more={},
        )
        with VideoFrames(clip) as frames:
            tally = write_clip(job, frames, watched.estimate)
    except TwoHandsError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    memory_mb = np.array(watched.memory_mb)
    for number in sorted({*range(0, len(memory_mb), max(1, options.frames // 9)), options.from_frame}):
        print(f"frame {number}: {memory_mb[number]:.1f} MB")
    grown = growth(memory_mb, options.from_frame)
    print(
        f"{tally.frames} frames in {tally.seconds:.0f} s on {usable_cores()} cores, segmentation rested in "
        f"{tally.rested}; memory grows by {100 * grown:.2f} % from frame {options.from_frame} to the end"
    )
    return int(grown >= LIMIT)


if __name__ == "__main__":
    sys.exit(main())
