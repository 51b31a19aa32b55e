"""How often ranges lie within what is said of them (`range_sigma_m`), on labelled pictures: one markdown table.

    python -m benchmarks.range_coverage --data test-static=data/test-static wild=data/test-wild --ge2019 GE2019 \\
        --count 300 --insert docs/results.md

Each set is measured twice. With the length given: that of the skeleton itself of generated hands, and of the crops the
median over their labels, in whose skeleton hands are compared (`benchmarks.real_hands`), which says of our own skeleton
no more than what a user types. And with the length that is assumed of everybody.

What is said of a length that nobody knows is said of all people, but all hands of a set may be one person's. A hand
that is larger by a factor and farther away by the same gives the same picture and the same estimate. So where the
length is typed or assumed, every hand counts once for each of the generator's adults, as large as theirs.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from benchmarks.documents import insert
from benchmarks.real_hands import read_ge2019, typical_hand_length_m, with_anatomical_joints

from twohands.datasets.opening import open_dataset
from twohands.errors import InputError, TwoHandsError
from twohands.evaluation.summary import markdown_table
from twohands.formats.profiles import ScaleSource
from twohands.geometry.anatomy import HAND_LENGTH
from twohands.inference.estimator import DEFAULT_HAND_LENGTH_M, HandEstimator
from twohands.inference.range_sigma import with_sources
from twohands.inference.weights import DEFAULT_PRESET
from twohands.skeleton import ROOT, WRIST
from twohands.synth.scene.body import load_asset
from twohands.types import HandSample

MARKER: Final = "range coverage"
SIGMAS: Final = (0.5, 1.0, 1.5, 2.0, 3.0)
COLUMNS: Final = (
    "pictures",
    "hand length",
    "hands",
    *(f"{sigmas:g}" for sigmas in SIGMAS),
    "median sigma",
    "median error",
)


@dataclass(frozen=True, slots=True)
class Row:
    """Hands of one set, found and labelled.

    Attributes:
        name: of the set.
        length: how the hand length was known, for people.
        errors: (N, A) metres, of N hands, each as large as those of A adults.
        sigmas: (N, 1) metres, what was said.
        ranges: (N, A) metres, true.
    """

    name: str
    length: str
    errors: np.ndarray
    sigmas: np.ndarray
    ranges: np.ndarray

    def cells(self) -> list[str]:
        """Of the table."""
        shares = [f"{(self.errors < sigmas * self.sigmas).mean():.2f}" for sigmas in SIGMAS]
        median = [f"{100 * np.median(values / self.ranges):.1f} %" for values in (self.sigmas, self.errors)]
        return [self.name, self.length, f"{len(self.errors)}", *shares, *median]


@dataclass(frozen=True, slots=True)
class Adults:
    """How large hands are.

    Attributes:
        lengths_m: (A,) wrist to middle knuckle.
        palm_shares: (A,) of that length in the length from the wrist to the tip of the middle finger, relative to what
            is usual.
    """

    lengths_m: np.ndarray
    palm_shares: np.ndarray

    @classmethod
    def of_generator(cls) -> Adults:
        """Every eighth of the generator's."""
        asset = load_asset()
        hands = np.array([np.asarray(asset.body(each).joints)[0, 1:] for each in asset.coefficients[::8]])
        chains = np.linalg.norm(np.diff(hands[:, [WRIST, ROOT, 10, 11, 12]], axis=1), axis=-1)
        shares = chains[:, 0] / chains.sum(axis=1)
        return cls(chains[:, 0], shares / np.exp(np.log(shares).mean()))

    def factors(self, source: ScaleSource, length_m: float) -> np.ndarray:
        """(A,) by how much the hands of people may be larger than one of a known length of which the estimator was told
        by `source`; (1,) 1 where they may not."""
        return {"assumed": self.lengths_m / length_m, "typed": self.palm_shares}.get(source, np.ones(1))


def main() -> int:
    """Reads the options, measures and prints."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", nargs="*", default=[], metavar="NAME=FOLDER", help="sets of generated pictures")
    parser.add_argument("--ge2019", type=Path, help="folder of the real crops")
    parser.add_argument("--weights", default=DEFAULT_PRESET)
    parser.add_argument("--count", type=int, help="pictures of a set; all if not given")
    parser.add_argument("--insert", type=Path, help="document that gets the table, between its markers")
    options = parser.parse_args()
    try:
        estimator = HandEstimator.from_preset(options.weights)
        table = "\n".join(markdown_table([list(COLUMNS), *(row.cells() for row in rows(estimator, options))]))
        print(table)
        if options.insert is not None:
            insert(options.insert, table, MARKER)
    except (TwoHandsError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def rows(estimator: HandEstimator, options: argparse.Namespace) -> Iterable[Row]:
    """Two for each set.

    Raises:
        InputError: no set, or a name without a folder.
    """
    if not options.data and options.ge2019 is None:
        raise InputError("no pictures: give --data or --ge2019")
    adults = Adults.of_generator()
    for word in options.data:
        name, equals, folder = word.partition("=")
        if not equals:
            raise InputError(f"--data {word}: NAME=FOLDER expected")
        dataset = open_dataset(Path(folder)).samples
        samples = [dataset[i] for i in range(min(len(dataset), options.count or len(dataset)))]
        lengths = [_lengths(sample) for sample in samples]
        for source in ("board", "assumed"):
            yield measured(estimator, samples, lengths, f"{name}, {len(samples)}", source, adults)
    if options.ge2019 is not None:
        samples = read_ge2019(options.ge2019)
        lengths = [np.full(2, typical_hand_length_m(samples) / HAND_LENGTH)] * len(samples)
        name = f"ge2019, {len(samples)} photographs"
        for source in ("typed", "assumed"):
            yield measured(estimator, samples, lengths, name, source, adults, anatomical=True)


def measured(
    estimator: HandEstimator,
    samples: Sequence[HandSample],
    lengths_m: Sequence[np.ndarray],
    name: str,
    source: ScaleSource,
    adults: Adults,
    *,
    anatomical: bool = False,
) -> Row:
    """One row.

    Args:
        estimator: that is asked.
        samples: labelled pictures with their cameras.
        lengths_m: (2,) of both hands of each.
        name: of the row.
        source: how the estimator knows them; "assumed": it does not.
        adults: as large as whose the hands may be.
        anatomical: whether labels are those of `geometry.anatomy`.
    """
    found = []
    for sample, lengths in zip(samples, lengths_m, strict=True):
        length = DEFAULT_HAND_LENGTH_M if source == "assumed" else lengths
        pose = with_sources(estimator.estimate(sample.image, sample.camera, length), source, "file")
        for side, hand in enumerate(pose.hands):
            if sample.present[side] and hand.range_m is not None and hand.range_sigma_m is not None:
                shown = with_anatomical_joints(hand) if anatomical else hand
                true = np.linalg.norm(sample.joints_m[side, ROOT]) * adults.factors(source, lengths[side])
                found.append((np.abs((shown.range_m or np.nan) - true), [hand.range_sigma_m], true))
    if not found:
        raise InputError(f"{name}: no labelled hand was found, or the card says nothing of ranges")
    said = {"board": "given", "typed": "given as typed", "assumed": "assumed"}[source]
    return Row(name, said, *(np.array(each) for each in zip(*found, strict=True)))


def _lengths(sample: HandSample) -> np.ndarray:
    """(2,) metres; of a hand that is not there, what is assumed."""
    lengths_m = np.linalg.norm(sample.joints_m[:, ROOT] - sample.joints_m[:, WRIST], axis=-1)
    return np.where(np.isfinite(lengths_m), lengths_m, DEFAULT_HAND_LENGTH_M)


if __name__ == "__main__":
    sys.exit(main())
