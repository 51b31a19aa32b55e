"""Collects backgrounds in which HandSegNet sees hands that are not there, to train it on (extra `synth`).

    python scripts/mine_backgrounds.py --backgrounds PHOTOS PANORAMAS --data FRAMES --count 20000 --seed 1 --out MINED

Every other background is looked at alone, the others behind a frame that shows a single hand: clutter beside an arm is
taken for the other one sooner. MINED is one more folder for `twohands train hand_seg_net --backgrounds`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from twohands.cli.output import check_output_folder
from twohands.errors import TwoHandsError
from twohands.executors.local import LocalProcesses
from twohands.geometry.boxes import box_iou
from twohands.inference.estimator import HandEstimator
from twohands.skeleton import LEFT, RIGHT
from twohands.synth.backgrounds.base import Background, Backgrounds
from twohands.synth.sets.cache import FrameCache
from twohands.training.batches import ONE_HAND_IOU
from twohands.training.config import DataConfig, folder_list
from twohands.training.hand_views import hand_box
from twohands.training.sources import backgrounds_of
from twohands.types import PinholeCamera

SIZE = (640, 360)
"""Of backgrounds looked at alone; the others are as large as the frames."""
SETTINGS = DataConfig(procedural=0.6, clutter=0.4, remixed=0.4)


class Kept:
    """Another source's backgrounds; remembers the last one.

    Args:
        source: gives the backgrounds.
    """

    def __init__(self, source: Backgrounds) -> None:
        self.source, self.name, self.unreadable = source, source.name, source.unreadable
        self.last = np.empty((0, 0, 3), np.uint8)

    def sample(self, rng: np.random.Generator, camera: PinholeCamera) -> Background:
        """A random background for a camera."""
        background = self.source.sample(rng, camera)
        self.last = background.picture
        return background


def opened(options: argparse.Namespace) -> Callable[[int], bool]:
    """What a process does with a number: look at a background, and write it if there is a hand to HandSegNet."""
    cv2.setNumThreads(1)
    estimator = HandEstimator.from_preset(options.weights, threads=1)
    backgrounds = Kept(backgrounds_of(replace(SETTINGS, backgrounds=folder_list(options.backgrounds))))
    frames = []
    for folder in options.data:
        cache = FrameCache(folder, backgrounds, variants=20)
        single = np.flatnonzero(np.load(folder / "present.npy").sum(axis=1) == 1)
        frames.append((cache, single))
    return partial(mined, options, estimator, backgrounds, frames)


def mined(
    options: argparse.Namespace,
    estimator: HandEstimator,
    backgrounds: Kept,
    frames: list[tuple[FrameCache, np.ndarray]],
    number: int,
) -> bool:
    """Looks at one background, and writes it where HandSegNet sees a hand that is none.

    Args:
        options: the seed, and the folder to write to.
        estimator: looks.
        backgrounds: where it comes from.
        frames: caches, and in each the frames with a single hand; every odd number puts one before the background.
        number: of the background.

    Returns:
        Whether it was written.
    """
    rng = np.random.default_rng([options.seed, number])
    if number % 2 and frames:
        cache, single = frames[rng.integers(len(frames))]
        sample = cache[int(rng.choice(single) + len(cache.indices) * rng.integers(cache.variants))]
        image, hands = sample.image, [hand_box(sample, side) for side in (LEFT, RIGHT)]
    else:
        camera = PinholeCamera.from_fov(rng.uniform(50, 110), *SIZE)
        image, hands = backgrounds.sample(rng, camera).picture, []
    boxes = estimator.segment(image)[1]
    true_px = [box for box in hands if box is not None]
    found = any(all(box_iou(box, true) < ONE_HAND_IOU for true in true_px) for box in boxes.boxes_px[boxes.present])
    if found:
        cv2.imwrite(str(options.out / f"{number:06d}.png"), backgrounds.last[..., ::-1])
    return found


def main() -> int:
    """Looks, and says how many were kept."""
    parser = argparse.ArgumentParser(description="Collects backgrounds that HandSegNet errs in.")
    parser.add_argument("--backgrounds", type=Path, nargs="*", default=[], help="folders of photographs and panoramas")
    parser.add_argument("--data", type=Path, nargs="*", default=[], help="folders of cached frames")
    parser.add_argument("--weights", default="fast", help="preset or folder whose HandSegNet looks")
    parser.add_argument("--count", type=int, default=20000, help="backgrounds to look at")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, required=True, help="a new folder")
    options = parser.parse_args()
    try:
        check_output_folder(options.out, overwrite=False)
        processes = LocalProcesses(options.workers)
        opened(options)  # what is wrong with a folder is better said here than by every process
        options.out.mkdir(parents=True, exist_ok=True)
        kept = sum(processes.run(partial(opened, options), range(options.count)))
    except TwoHandsError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"{kept} of {options.count} backgrounds in {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
