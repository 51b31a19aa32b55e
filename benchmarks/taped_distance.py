"""What hands at taped distances bring where camera and hand length are wrong: one markdown table.

    python -m benchmarks.taped_distance --data data/test-static --count 300 --insert docs/calibration.md

Every picture is estimated with the camera as it is, and with focal lengths 20 % too small and too large; the hand
length is 20 % too small and too large in either. Hands that are drawn stand at their true distances; the ranges of
those of all other pictures count, with the focal length and the hand length that follow (`calibration.tape`).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from benchmarks.documents import insert

from twohands.calibration.tape import FOCAL_SPREAD, fit_tape, length_spread, ranges, zoomed
from twohands.datasets.opening import open_dataset
from twohands.errors import InputError, TwoHandsError
from twohands.evaluation.summary import markdown_table
from twohands.inference.estimator import HandEstimator
from twohands.inference.weights import DEFAULT_PRESET
from twohands.skeleton import ROOT, WRIST
from twohands.types import HandPose, HandSample, PinholeCamera

MARKER: Final = "taped distance"
FOCALS: Final = {"right": 1.0, "20 % too small": 0.8, "20 % too large": 1.2}
LENGTHS: Final = (0.8, 1.2)
COLUMNS: Final = ("focal length", "before", "one hand", "five hands", "five, length alone")


class Known(NamedTuple):
    """A hand that was found: number of its picture, its estimate, and the true distance of its root, metres."""

    picture: int
    hand: HandPose
    distance_m: float


def main() -> int:
    """Reads the options, measures and prints."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="generated pictures of one camera and hand length")
    parser.add_argument("--weights", default=DEFAULT_PRESET)
    parser.add_argument("--count", type=int, default=300, help="pictures")
    parser.add_argument("--draws", type=int, default=200, help="of hands at known distances")
    parser.add_argument("--insert", type=Path, help="document that gets the table, between its markers")
    options = parser.parse_args()
    try:
        estimator = HandEstimator.from_preset(options.weights)
        dataset = open_dataset(options.data).samples
        samples = [dataset[i] for i in range(min(len(dataset), options.count))]
        camera, length_m = setting(samples)
        rows = [list(COLUMNS)]
        for name, focal in FOCALS.items():
            wrong = zoomed(camera, focal)
            rows.append([name, *cells(found(estimator, samples, wrong, length_m), wrong, length_m, options.draws)])
        table = "\n".join(markdown_table(rows))
        print(table)
        if options.insert is not None:
            insert(options.insert, table, MARKER)
    except (TwoHandsError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def setting(samples: Sequence[HandSample]) -> tuple[PinholeCamera, float]:
    """The camera of all pictures, and the hand length of all hands, metres.

    Raises:
        InputError: there is no picture, or they differ.
    """
    bones_m = [np.linalg.norm(sample.joints_m[:, ROOT] - sample.joints_m[:, WRIST], axis=-1) for sample in samples]
    lengths_m = np.concatenate([[np.nan], *bones_m])
    lengths_m = lengths_m[np.isfinite(lengths_m)]
    if not len(lengths_m) or any(sample.camera != samples[0].camera for sample in samples) or np.ptp(lengths_m) > 1e-4:
        raise InputError("pictures of one camera with hands of one length are expected, as those of style paper")
    return samples[0].camera, float(lengths_m.mean())


def found(
    estimator: HandEstimator, samples: Sequence[HandSample], camera: PinholeCamera, length_m: float
) -> list[Known]:
    """The hands that are there and placed, estimated with a camera that may be wrong."""
    hands = []
    for picture, sample in enumerate(samples):
        for side, hand in enumerate(estimator.estimate(sample.image, camera, length_m).hands):
            if sample.present[side] and hand.valid:
                hands.append(Known(picture, hand, float(np.linalg.norm(sample.joints_m[side, ROOT]))))
    return hands


def cells(hands: Sequence[Known], camera: PinholeCamera, length_m: float, draws: int) -> Iterator[str]:
    """Of one row, behind its name: median errors of ranges as shares, over all draws and the hands of other pictures.

    Raises:
        InputError: too few hands were found.
    """
    pictures, true_m = np.array([known.picture for known in hands]), np.array([known.distance_m for known in hands])
    if len(set(pictures)) < 6:
        raise InputError("hands of six pictures or more are needed, five of which are drawn")
    estimates = [known.hand for known in hands]
    before = [np.abs(ranges(estimates, camera, length_m * wrong) / true_m - 1) for wrong in LENGTHS]
    shares = [np.nanmedian(errors) for errors in before]
    low, high = (f"{100 * share:.0f}" for share in sorted(shares))
    yield f"{low} %" if low == high else f"{low} to {high} %"
    for count, spread in ((1, FOCAL_SPREAD), (5, FOCAL_SPREAD), (5, 0.0)):
        rng, errors = np.random.default_rng(0), []
        for draw in range(draws):
            drawn = rng.choice(len(hands), count, replace=False)
            wrong_m = length_m * LENGTHS[draw % len(LENGTHS)]
            fit = fit_tape(
                [estimates[i] for i in drawn],
                camera,
                true_m[drawn],
                wrong_m,
                focal_spread=spread,
                length_spread=length_spread("assumed"),
            )
            others = np.flatnonzero(~np.isin(pictures, pictures[drawn]))
            placed_m = ranges([estimates[i] for i in others], zoomed(camera, fit.focal_scale), fit.hand_length_m)
            errors.append(np.abs(placed_m / true_m[others] - 1))
        yield f"{100 * np.nanmedian(np.concatenate(errors)):.1f} %"


if __name__ == "__main__":
    sys.exit(main())
