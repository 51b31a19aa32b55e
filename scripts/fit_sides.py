"""Fits how sides add up over video (`inference.side_keeping`) to labelled sequences that nothing was trained on.

    twohands generate dynamic --split val --seed 7101 --preset wild --config.webcam 1 --frames 150 --out data/webcam
    python scripts/fit_sides.py src/twohands/weights/fast --data data/webcam

Every frame is looked at by itself; then what it says of the sides of the true hands adds up, with shares that are kept
and trusted as the table says. Printed is the mean of -log(chance of the true side); put the best pair into the module
by hand.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Final

import numpy as np

from twohands.datasets.base import HandDataset
from twohands.datasets.opening import open_dataset
from twohands.errors import InputError, TwoHandsError
from twohands.inference.estimator import HandEstimator
from twohands.inference.side_keeping import LOGIT_LIMIT, SAID_LOGIT
from twohands.skeleton import N_JOINTS, SIDES
from twohands.types import HandSample, TwoHandPose

KEPT: Final = (0.8, 0.85, 0.9, 0.95, 0.98, 1.0)
TRUSTED: Final = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0)
NEAR: Final = 0.4
"""A found hand is the true one whose palm is nearer than this, as a share of the longer side of the true one's box."""
PALM: Final = [0, 5, 9, 13, 17]


def main() -> int:
    """Reads the options, looks at the sequences and prints."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("preset", type=Path, help="weights folder")
    parser.add_argument("--data", nargs="+", required=True, help="folders of dynamic sets")
    options = parser.parse_args()
    try:
        estimator = HandEstimator.from_preset(options.preset)
        streams = [stream for folder in options.data for stream in streams_in(estimator, open_dataset(folder).samples)]
        if not streams:
            raise InputError("no hand was found in these sequences")
    except TwoHandsError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    alone = np.concatenate(streams)
    wrong = 100 * (alone < 0).mean()
    print(f"{len(streams)} hands in {len(alone)} frames; by single frames on the wrong side {wrong:.1f} %")
    print("kept \\ trusted" + "".join(f"{trusted:10.2f}" for trusted in TRUSTED))
    losses = np.array([[loss(streams, kept, trusted) for trusted in TRUSTED] for kept in KEPT])
    for kept, row in zip(KEPT, losses, strict=True):
        print(f"{kept:14.2f}" + "".join(f"{value:10.4f}" for value in row))
    best = np.unravel_index(int(losses.argmin()), losses.shape)
    kept, trusted = KEPT[best[0]], TRUSTED[best[1]]
    wrong = 100 * (np.concatenate([added_up(stream, kept, trusted) for stream in streams]) < 0).mean()
    print(f"best: KEPT_SHARE {kept}, TRUST {trusted}; then {wrong:.1f} % on the wrong side")
    return 0


def streams_in(estimator: HandEstimator, samples: HandDataset | Sequence[HandSample]) -> list[np.ndarray]:
    """What single frames say of every true hand of every sequence: (N,) log-odds of its true side, of the frames in
    which it was found."""
    streams = []
    numbers = range(len(samples))
    for _, frames in groupby(numbers, key=lambda number: samples[number].source.rpartition("/")[0]):
        said: tuple[list[float], list[float]] = ([], [])
        previous = None
        for number in frames:
            sample = samples[number]
            previous = estimator.estimate(sample.image, sample.camera, index=number, previous=previous)
            for side, values in enumerate(said):
                values.extend(true_side_logit(previous, sample, side))
        streams += [np.array(values) for values in said if values]
    return streams


def true_side_logit(pose: TwoHandPose, sample: HandSample, side: int) -> list[float]:
    """Log-odds that the true hand of a side is of that side, as the frame alone says; empty where it was not found."""
    if not sample.present[side]:
        return []
    true_px = sample.joints_px[side]
    size = float(np.nanmax(np.ptp(true_px, axis=0)))
    found: list[tuple[float, float]] = []
    for at in range(len(SIDES)):
        hand = pose.hands[at]
        if hand.joints_px is not None and hand.side_logit is not None:
            assert hand.joints_px.shape == (N_JOINTS, 2)
            off = float(np.linalg.norm(hand.joints_px[PALM].mean(axis=0) - true_px[PALM].mean(axis=0))) / size
            found.append((off, hand.side_logit if at == side else -hand.side_logit))
    return [logit for off, logit in sorted(found)[:1] if off < NEAR]


def added_up(stream: np.ndarray, kept: float, trusted: float) -> np.ndarray:
    """(N,) log-odds of the true side after each of N frames, as `SideMemory.after` adds them up."""
    total, totals = 0.0, []
    for said in np.clip(stream, -SAID_LOGIT, SAID_LOGIT):
        total = float(np.clip(kept * total + trusted * said, -LOGIT_LIMIT, LOGIT_LIMIT))
        totals.append(total)
    return np.array(totals)


def loss(streams: Sequence[np.ndarray], kept: float, trusted: float) -> float:
    """Mean of -log(chance of the true side) over all frames."""
    totals = np.concatenate([added_up(stream, kept, trusted) for stream in streams])
    return float(np.logaddexp(0.0, -totals).mean())


if __name__ == "__main__":
    sys.exit(main())
