"""Fits the `placement` of a preset's card to labelled pictures that it was not trained on: which ranges are usual, what
is wrong with estimated ones, `range_errors`, how far hands are by their body, `body_weights`, and what is said of the
errors, `range_sigma`.

    python scripts/fit_range_errors.py src/twohands/weights/fast --data SET SET_2 --backgrounds PHOTOS [--write]

A set is a folder of labelled pictures, or of frames as `twohands generate frames` makes them, before photographs. Every
set counts alike. Prints the numbers, how many ranges are right without and with them, and how many lie within the
standard deviation that is said of them; `--write` puts them on the card.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from twohands.datasets.opening import open_dataset
from twohands.errors import InputError, TwoHandsError
from twohands.files import appearing
from twohands.geometry.body import BODY_TERMS, USUAL_LENGTH_M, Body
from twohands.inference.decision import PlacementConfig
from twohands.inference.estimator import HandEstimator
from twohands.inference.placement import (
    PlacedHands,
    distances_of,
    palm_misfit,
    palm_span,
    posterior_ranges,
    pulled,
    range_sigma,
)
from twohands.skeleton import N_JOINTS, ROOT, WRIST
from twohands.types import HandSample

SMOOTH: Final = 0.03
"""Error of a range's logarithm up to which its square counts, beyond which its size does: few hands are far off."""
BODY_SMOOTH: Final = 0.08
"""The same of what a body says."""
STEPS: Final = 9
"""Values of each number that are tried at a time."""
ROUNDS: Final = 4
"""Each narrows the span of values to a third."""
BARS_M: Final = (0.035, 0.0525, 0.07)
WITHIN: Final = 0.683
"""Share of errors that lie within one standard deviation."""
EVENNESS: Final = 10.0
"""What the square of the farthest share's distance from `WITHIN` costs beside a mean logarithm of likelihood."""
POWERS: Final = np.linspace(0, 1.5, 16)
SPAN_POWERS: Final = np.linspace(-3, 3, 13)
CARD: Final = "card.json"
SPREADS: Final = np.geomspace(0.05, 1.0, 25)
CORRELATIONS: Final = np.linspace(0, 0.95, 20)
OF_BODIES: Final = ("body_weights", "body_spread", "body_correlation")
FITTED: Final = ("usual_range_m", "usual_spread", "correlation", "range_errors", "range_sigma", *OF_BODIES)
"""Of `PlacementConfig`."""


class Ranges(NamedTuple):
    """Of the hands found in one picture, one or both, each (B,) but the scores: estimated metres, joints' scores
    (B, 21), true metres, NaN where there is no such hand, the palm's misfit and span in hand lengths, and what the body
    has them go with, terms and the rest (B, `BODY_TERMS` + 1) of `Body.distance_terms`, NaN for nobody's hands."""

    estimated: np.ndarray
    scores: np.ndarray
    true: np.ndarray
    misfit: np.ndarray
    span: np.ndarray
    body: np.ndarray


class Off(NamedTuple):
    """Of all hands of one set, each (N,): errors of their likely ranges as shares, scores (N, 21), misfits and spans of
    their palms."""

    errors: np.ndarray
    scores: np.ndarray
    misfit: np.ndarray
    span: np.ndarray


def main() -> int:
    """Reads the options, looks at the pictures and prints."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("preset", type=Path, help="weights folder")
    parser.add_argument("--data", type=Path, nargs="+", required=True, help="folders of labelled pictures or of frames")
    parser.add_argument("--backgrounds", nargs="+", help="of frames; invented ones if not given")
    parser.add_argument("--count", type=int, help="pictures of a set; all if not given")
    parser.add_argument("--only", choices=("sigma", "bodies"), help="leave all else as the card has it")
    parser.add_argument("--write", action="store_true", help="put the numbers on the preset's card")
    options = parser.parse_args()
    try:
        shipped = HandEstimator.from_preset(options.preset)
        every_body = (0.0,) * BODY_TERMS
        config = dataclasses.replace(shipped.card.placement, range_errors=None, body_weights=every_body)
        estimator = HandEstimator(shipped.networks, dataclasses.replace(shipped.card, placement=config))
        sets = [
            found_in(estimator, itertools.islice(samples_of(folder, options.backgrounds), options.count))
            for folder in options.data
        ]
        as_shipped = shipped.card.placement
        alone = dataclasses.replace(as_shipped, body_weights=()) if options.only else fitted_ranges(sets)
        off = [said_errors(found, alone) for found in sets]
        if options.only != "bodies":
            alone = dataclasses.replace(alone, range_sigma=fitted_sigma(off))
        if options.only == "sigma":
            config = dataclasses.replace(as_shipped, range_sigma=alone.range_sigma)
        else:
            config = fitted_bodies([one for found in sets for one in found], alone)
        said = {name: np.round(getattr(config, name), 3).tolist() for name in FITTED}
        print(json.dumps(said))
        for folder, found, one in zip(options.data, sets, off, strict=True):
            print(f"{folder.name}: {len(one.errors)} hands, {share_within(one, alone):.3f} within one sigma")
            print_errors(found, alone)
            print_errors([of for of in found if np.isfinite(of.body).all()], config, ", those of a body")
        if options.write:
            write_to_card(options.preset / CARD, said)
    except TwoHandsError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def samples_of(folder: Path, backgrounds: Sequence[str] | None) -> Iterable[HandSample]:
    """Labelled pictures of a folder.

    Raises:
        TwoHandsError: it holds none.
    """
    from twohands.synth.sets.cache import FrameCache

    if not FrameCache.is_cache(folder):
        samples = open_dataset(folder).samples
        return (samples[i] for i in range(len(samples)))
    from twohands.training.config import DataConfig, folder_list
    from twohands.training.sources import backgrounds_of

    cache = FrameCache(
        folder, backgrounds_of(DataConfig(backgrounds=folder_list(backgrounds))) if backgrounds else None
    )
    return (cache[i] for i in range(len(cache)))


def found_in(estimator: HandEstimator, samples: Iterable[HandSample]) -> list[Ranges]:
    """Pictures in which a labelled hand was found."""
    found = [ranges_in(estimator, sample) for sample in samples]
    return [one for one in found if np.isfinite(one.true).any()]


def ranges_in(estimator: HandEstimator, sample: HandSample) -> Ranges:
    """What the pipeline finds in a picture, by the pose networks whose ranges count, and what is true."""
    lengths_m = np.linalg.norm(sample.joints_m[:, ROOT] - sample.joints_m[:, WRIST], axis=-1)
    lengths_m = np.where(np.isfinite(lengths_m), lengths_m, USUAL_LENGTH_M)
    stages, true = estimator.stages, np.where(sample.present, np.linalg.norm(sample.joints_m[:, ROOT], axis=-1), np.nan)
    seen = [Ranges(np.zeros(0), np.zeros((0, N_JOINTS)), *np.zeros((3, 0)), np.zeros((0, BODY_TERMS + 1)))]
    bodies: list[Body | None] = [None]

    def body(*where: Any) -> Body | None:
        bodies.append(None if stages.body is None else stages.body(*where))
        return bodies[-1]

    def refine(hands: PlacedHands, ranged: PlacedHands, *known: Any) -> Any:
        camera, of_rows_m, bodies_m = known[2:]
        canonical, sides = pulled(estimator.card.placement, ranged, camera, of_rows_m), ranged.keypoints.sides
        misfit = palm_misfit(canonical, ranged.keypoints.joints_px, camera, of_rows_m, ranged.placed)
        told = np.full((2, BODY_TERMS + 1), np.nan)
        if bodies[-1] is not None and np.isfinite(bodies_m).all():
            terms, beside = bodies[-1].distance_terms(camera.fx, lengths_m)
            told = np.column_stack([terms, [beside, beside]])
        found = ranged.placed.radius_m, ranged.keypoints.joint_scores, true[sides]
        one = Ranges(*found, misfit, palm_span(canonical), told[sides])
        seen.append(Ranges(*(part[ranged.placed.valid] for part in one)))
        return stages.refine(hands, ranged, *known)

    watching = dataclasses.replace(stages, refine=refine, body=body)
    watched = HandEstimator(estimator.networks, estimator.card, watching)
    pose = watched.estimate(sample.image, sample.camera, lengths_m)
    ranges_m = [hand.range_m for hand in pose.hands if hand.range_m is not None]
    # what else was seen is of the picture turned
    return next((one for one in seen if one.estimated.tolist() == ranges_m), seen[0])


def likely(found: Ranges, config: PlacementConfig) -> np.ndarray:
    """(B,) metres: `posterior_ranges`."""
    bodies_m = distances_of(found.body[:, :-1], found.body[:, -1], config) if config.body_weights else None
    return posterior_ranges(found.estimated, found.scores.mean(axis=-1), config, bodies_m)


def usual_ranges(sets: Sequence[Sequence[Ranges]]) -> PlacementConfig:
    """Mean, spread and correlation of the true ranges' logarithms; every set counts alike, for the correlation every
    set with pictures of both hands. Without any, what is known of both is as it was.

    Raises:
        InputError: there is no hand.
    """
    logs = [np.log(np.concatenate([one.true for one in found] or [np.zeros(0)])) for found in sets]
    logs = [known for known in (one[np.isfinite(one)] for one in logs) if len(known)]
    if not logs:
        raise InputError("no labelled hand was found in these pictures")
    mean = np.mean([known.mean() for known in logs])
    variance = np.mean([((known - mean) ** 2).mean() for known in logs])
    pairs = [[np.log(one.true) - mean for one in found if np.isfinite(one.true).sum() == 2] for found in sets]
    together = [np.prod(off, axis=1).mean() for off in pairs if off]
    config = PlacementConfig(usual_range_m=float(np.exp(mean)), usual_spread=float(np.sqrt(variance)))
    return dataclasses.replace(config, correlation=float(np.mean(together) / variance)) if together else config


def fitted_ranges(sets: Sequence[Sequence[Ranges]]) -> PlacementConfig:
    """What is usual, and how far estimated ranges are off."""
    usual = usual_ranges(sets)
    return dataclasses.replace(usual, range_errors=fitted([one for found in sets for one in found], usual))


def fitted(found: Sequence[Ranges], usual: PlacementConfig) -> tuple[float, float]:
    """The `range_errors` with the least mean loss of the ranges' logarithms."""
    best, span = np.log([0.05, 0.1]), np.log(20.0)
    for _ in range(ROUNDS):
        steps = np.linspace(-span, span, STEPS)
        tried = [(float(np.exp(best[0] + a)), float(np.exp(best[1] + b))) for a in steps for b in steps]
        best = np.log(min(tried, key=lambda errors: loss(found, dataclasses.replace(usual, range_errors=errors))))
        span /= 3
    return float(np.exp(best[0])), float(np.exp(best[1]))


def fitted_bodies(found: Sequence[Ranges], config: PlacementConfig) -> PlacementConfig:
    """How far hands are by their body, and how surely, with the least mean loss; no picture with a body, no weights."""
    known = [one for one in found if len(one.body) and np.isfinite(one.body).all() and np.isfinite(one.true).all()]
    if not known:
        return config
    told, true = np.concatenate([one.body for one in known]), np.concatenate([one.true for one in known])
    terms, beyond = told[:, :-1], np.log(true) - told[:, -1]
    fit = least_squares(
        lambda weights: terms @ weights - beyond, np.zeros(BODY_TERMS), loss="soft_l1", f_scale=BODY_SMOOTH
    )
    config = dataclasses.replace(config, body_weights=tuple(fit.x.tolist()))
    tried = [
        dataclasses.replace(config, body_spread=spread, body_correlation=correlation)
        for spread in SPREADS.tolist()
        for correlation in CORRELATIONS.tolist()
    ]
    return min(tried, key=lambda each: loss(known, each))


def loss(found: Sequence[Ranges], config: PlacementConfig) -> float:
    """Mean smoothed size of the errors of the likely ranges' logarithms."""
    off = np.abs(np.concatenate([np.log(likely(one, config) / one.true) for one in found]))
    off = off[np.isfinite(off)]
    return float(np.where(off < SMOOTH, off**2 / (2 * SMOOTH), off - SMOOTH / 2).mean())


def said_errors(found: Sequence[Ranges], config: PlacementConfig) -> Off:
    """The errors of likely ranges beside what tells how large they are."""
    off = np.concatenate([np.abs(one.true / likely(one, config) - 1) for one in found])
    known = np.isfinite(off)
    told = (np.concatenate([getattr(one, name) for one in found])[known] for name in ("scores", "misfit", "span"))
    return Off(off[known], *told)


def fitted_sigma(sets: Sequence[Off]) -> tuple[float, float, float, float]:
    """`range_sigma`: the share within which 68.3 % of the errors lie, and the powers under which errors over their
    standard deviation are likeliest, taken for Laplacian, while no set's share is far from that of all (`EVENNESS`).
    Every set counts alike."""
    off = Off(*(np.concatenate(parts) for parts in zip(*sets, strict=True)))
    weights = np.concatenate([np.full(len(one.errors), 1 / len(one.errors)) for one in sets])
    weights /= weights.sum()

    def fit(powers: tuple[float, float, float]) -> tuple[float, tuple[float, float, float, float]]:
        """What the powers lack, and `range_sigma` with them."""
        config = PlacementConfig(range_sigma=(1.0, *powers), usual_spread=np.inf)
        sigma = range_sigma(off.scores, off.misfit, off.span, config)
        over = off.errors / sigma
        order = np.argsort(over)
        share = over[order][np.searchsorted(np.cumsum(weights[order]), WITHIN)]
        parts = np.split(over < share, np.cumsum([len(one.errors) for one in sets])[:-1])
        uneven = max(abs(part.mean() - WITHIN) for part in parts)
        lack = np.log(weights @ over) + weights @ np.log(sigma) + EVENNESS * uneven**2
        return float(lack), (float(share), *powers)

    return min(map(fit, itertools.product(POWERS.tolist(), POWERS.tolist(), SPAN_POWERS.tolist())))[1]


def share_within(off: Off, config: PlacementConfig) -> float:
    """How many errors lie within what is said of them."""
    said = range_sigma(off.scores, off.misfit, off.span, config)
    return float((off.errors < said).mean())


def print_errors(found: Sequence[Ranges], config: PlacementConfig, which: str = "") -> None:
    """Errors of ranges as projected, and as they are likely."""
    if not any(np.isfinite(one.true).any() for one in found):
        return
    for name, chosen in (("as projected", dataclasses.replace(config, range_errors=None)), ("likely", config)):
        off = np.concatenate([np.abs(likely(one, chosen) - one.true) for one in found])
        off = off[np.isfinite(off)]
        shares = ", ".join(f"{(off < bar).mean():.4f} within {100 * bar:g} cm" for bar in BARS_M)
        print(f"  {name}{which}: {shares}, mean {100 * off.mean():.2f} cm, median {100 * np.median(off):.2f} cm")


def write_to_card(path: Path, numbers: dict[str, Any]) -> None:
    """Puts numbers into the section placement of a card, which keeps all else."""
    card = json.loads(path.read_text(encoding="utf-8"))
    card["placement"] = {**card.get("placement", {}), **numbers}
    with appearing(path) as partial:
        partial.write_text(json.dumps(card, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
