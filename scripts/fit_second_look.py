"""Fits which of a preset's two pairs of pose networks counts for a hand (`inference.second_look`; extras `synth`,
`datasets`).

    python -m scripts.fit_second_look src/twohands/weights/fast --frames PEOPLE WILD PAPER --backgrounds PHOTOS
        --digits ../shared/data/real_train/digits --judges OLDER

The pictures are those of scripts/fit_handedness.py, whose decision does not depend on the answer, and as many as
`--pasted` says of photographed hands that are cut out and put before other backgrounds, small, blurred and badly lit as
training shows them: before white paper every hand is easy. Both pairs see every candidate that is a true hand. The
weights are those of a logistic regression on which pair is better, in which a hand counts as much as the pairs' errors
differ, and all real hands together half of what all rendered ones do (`REAL_SHARE`). Prints the mean error of the
joints of the pair that is said to count, beside those of either pair and of the better one in truth, of pictures held
out in turn; writes the weights into the card's "decision".

Networks know pictures like those that they learnt from better than anybody's camera, and are sure of them. With
`--judges FOLDER`, the pose networks of other weights look in place of the first ones as well. If these never saw
people or digits, the fit learns how far to believe such networks elsewhere.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
from scipy.optimize import minimize
from scipy.special import expit
from scripts.fit_hand_check import CHANGED, COLOURS
from scripts.fit_handedness import FOLDS, add_picture_options, judged_by, planned, true_side

from twohands.errors import InputError, TwoHandsError
from twohands.geometry.boxes import box_from_points
from twohands.inference.decision import SECOND_FEATURES
from twohands.inference.detection import HandFinder
from twohands.inference.estimator import HandEstimator
from twohands.inference.keypoints import Keypoints
from twohands.inference.second_look import second_features
from twohands.inference.weights import write_card
from twohands.training.config import DataConfig, folder_list
from twohands.training.sources import open_source
from twohands.training.transforms import jitter_colours
from twohands.types import HandSample

LARGEST_ERROR: Final = 0.5
"""Of a joint, in sizes of the hand: farther off is no worse."""
REAL: Final = "digits"
"""Kind of the pictures that are photographs of hands, as `planned` calls it."""
REAL_SHARE: Final = 0.5
"""How much all real hands count together, as a share of all rendered ones (docs/history/journal.md, *Looked for in
every quarter turn*)."""
PENALTY: Final = 1e-3
"""Of half the square of a weight times its feature's standard deviation."""


class Both(NamedTuple):
    """A hand that both pairs have seen: kind and number of its picture, `second_features`, and mean errors of the
    joints of either, in sizes of the hand."""

    kind: str
    scene: int
    features: np.ndarray
    first: float
    second: float

    @property
    def real(self) -> bool:
        """Whether it is a photographed one."""
        return self.kind.startswith(REAL)


def main() -> int:
    """Reads the options, looks, fits, prints and writes."""
    parser = argparse.ArgumentParser(description="Fits which pair of pose networks counts for a hand.")
    parser.add_argument("preset", type=Path, help="weights folder; its card is written")
    add_picture_options(parser, count=300, digits=300, photographs=0)
    parser.add_argument("--pasted", type=int, default=500, help="photographed hands before other backgrounds")
    parser.add_argument(
        "--judges", nargs="*", default=[], help="presets whose pose networks stand in for the first ones"
    )
    parser.add_argument("--dry-run", action="store_true", help="leave the card alone")
    options = parser.parse_args()
    try:
        own = HandEstimator.from_preset(options.preset)
        if own.stages.second is None:
            raise InputError(f"{own.card.name}: it has no second pose networks")
        judges = [judged_by(own, HandEstimator.from_preset(judge)) for judge in options.judges]
        cv2.setNumThreads(1)
        hands = []
        for scene, (kind, sample_of) in enumerate(planned(options) + pasted(options)):
            sample = sample_of()
            hands += hands_seen(own, sample, kind, scene)
            for judge in judges:
                hands += hands_seen(judge, sample, f"{kind} by {judge.card.name}", scene)
        print_errors(hands, held_out(hands))
        if not options.dry_run:
            write_weights(options.preset, fit(hands))
    except TwoHandsError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def pasted(options: argparse.Namespace) -> list[tuple[str, Callable[[], HandSample]]]:
    """Kind of every picture of a photographed hand before another background, and what gives it; none without digits
    and backgrounds."""
    if options.digits is None or not options.backgrounds:
        return []
    shown = DataConfig(
        source=str(options.digits),
        backgrounds=folder_list(options.backgrounds),
        procedural=0.15,
        clutter=0.3,
        remixed=0.3,
        empty=0.0,
        validation=0,
        variants=20,
        seed=options.seed,
    )
    source, _ = open_source(shown)

    def changed(number: int) -> HandSample:
        rng = np.random.default_rng([options.seed, number])
        sample = source[int(rng.integers(len(source)))]
        return replace(sample, image=jitter_colours(sample.image, COLOURS, rng)) if rng.random() < CHANGED else sample

    return [(f"{REAL}, pasted", partial(changed, number)) for number in range(options.pasted)]


def hands_seen(estimator: HandEstimator, sample: HandSample, kind: str, scene: int) -> list[Both]:
    """The candidates of one picture that are hands, each as that of its true side."""
    body = estimator.body(sample.image)
    masks, boxes = estimator.segment(sample.image, body=body)
    sides = np.flatnonzero(boxes.present)
    if not len(sides):
        return []
    palms = estimator.palms(sample.image)
    finder = HandFinder(estimator.stages, estimator.card, sample.image, sample.camera, body=body, palms=palms)
    first, second = finder.both_looked(masks, boxes.boxes_px, finder.crops(masks, boxes.boxes_px, sides))
    features, hands = second_features(first, second), []
    for row, side in enumerate(sides):
        if int(side) in {true_side(seen.joints_px[row], sample) for seen in (first, second)}:
            errors = [mean_error(seen, row, sample, int(side)) for seen in (first, second)]
            hands.append(Both(kind, scene, features[row], *errors))
    return hands


def mean_error(seen: Keypoints, row: int, sample: HandSample, side: int) -> float:
    """Of a hand's known joints, none more than `LARGEST_ERROR`."""
    true_px = np.asarray(sample.joints_px[side], np.float64)
    known = np.asarray(sample.valid[side]) & np.isfinite(true_px).all(axis=-1)
    box = np.asarray(box_from_points(true_px[known]))
    off = np.linalg.norm(seen.joints_px[row][known] - true_px[known], axis=-1) / max((box[2:] - box[:2]).max(), 1e-9)
    return float(np.minimum(off, LARGEST_ERROR).mean())


def fit(hands: Sequence[Both]) -> np.ndarray:
    """(F,) weights of `SECOND_FEATURES`.

    Raises:
        InputError: there is no hand.
    """
    if not hands:
        raise InputError("no hand was found in these pictures")
    features = np.array([hand.features for hand in hands])
    gain, real = np.array([hand.first - hand.second for hand in hands]), np.array([hand.real for hand in hands])
    gain = balanced(gain, real)
    spread = np.maximum(features.std(axis=0), 1e-9)
    spread[0] = 1.0

    def cost(weights: np.ndarray) -> tuple[float, np.ndarray]:
        margin = np.sign(gain) * (features @ (weights / spread))
        slope = -(gain * expit(-margin)) @ features / spread / np.abs(gain).sum()
        loss = (np.abs(gain) * np.logaddexp(0, -margin)).sum() / np.abs(gain).sum()
        return float(loss + PENALTY / 2 * weights @ weights), slope + PENALTY * weights

    return minimize(cost, np.zeros(features.shape[1]), jac=True, method="L-BFGS-B").x / spread


def balanced(gain: np.ndarray, real: np.ndarray) -> np.ndarray:
    """What the second pair gains of hands, (N,), so that real ones, (N,) bool, count `REAL_SHARE` of all others."""
    sums = [np.abs(gain[rows]).sum() for rows in (real, ~real)]
    return np.where(real, gain * REAL_SHARE * sums[1] / sums[0], gain) if min(sums) > 0 else gain


def held_out(hands: Sequence[Both]) -> np.ndarray:
    """(N,) bool: whether the second pair is said to count, by weights fitted to the other pictures."""
    folds, says = np.array([hand.scene % FOLDS for hand in hands]), np.zeros(len(hands), bool)
    for fold in np.unique(folds):
        weights = fit([hand for hand, own in zip(hands, folds, strict=True) if own != fold])
        rows = np.flatnonzero(folds == fold)
        says[rows] = np.array([hands[row].features for row in rows]) @ weights > 0
    return says


def print_errors(hands: Sequence[Both], says: np.ndarray) -> None:
    """Mean errors by kind, in hundredths of the hand's size."""
    print(f"{'pictures':24s} {'hands':>6s} {'second':>7s} {'first':>6s} {'second':>7s} {'chosen':>7s} {'better':>7s}")
    kinds, errors = np.array([hand.kind for hand in hands]), np.array([[hand.first, hand.second] for hand in hands])
    for kind in (*dict.fromkeys(kinds.tolist()), "all"):
        rows = (kinds == kind) | (kind == "all")
        chosen = np.where(says, errors[:, 1], errors[:, 0])
        first, second = 100 * errors[rows].mean(axis=0)
        least = 100 * errors[rows].min(axis=1).mean()
        shares = f"{rows.sum():6d} {100 * says[rows].mean():6.1f}% {first:6.2f} {second:7.2f}"
        print(f"{kind:24s} {shares} {100 * chosen[rows].mean():7.2f} {least:7.2f}")


def write_weights(folder: Path, weights: np.ndarray) -> None:
    """Puts them on the card; what else its "decision" says stays."""
    card = json.loads((folder / "card.json").read_text(encoding="utf-8"))
    named = {name: round(float(weight), 4) for name, weight in zip(SECOND_FEATURES, weights, strict=True)}
    card["decision"] = card.get("decision", {}) | {"second": named}
    write_card(folder, card)


if __name__ == "__main__":
    sys.exit(main())
