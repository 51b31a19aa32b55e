"""Fits the `range_errors` of a preset's card (`inference.placement`), and how large it says their errors are, to
labelled pictures that it was not trained on.

    python scripts/fit_range_errors.py src/twohands/weights/fast --data HELD_OUT HELD_OUT_2

Prints the numbers, how many ranges are right without and with them, and how many lie within the standard deviation that
is said of them; put them on the card by hand.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from twohands.datasets.opening import open_dataset
from twohands.errors import InputError, TwoHandsError
from twohands.inference.decision import PlacementConfig
from twohands.inference.estimator import HandEstimator
from twohands.inference.placement import palm_misfit, posterior, posterior_ranges
from twohands.skeleton import N_JOINTS, ROOT, WRIST
from twohands.types import GlobalPose, HandPose, HandSample, PinholeCamera

SMOOTH: Final = 0.03
"""Error of a range's logarithm up to which its square counts, beyond which its size does: few hands are far off."""
STEPS: Final = 9
"""Values of each number that are tried at a time."""
ROUNDS: Final = 4
"""Each narrows the span of values to a third."""
BARS_M: Final = (0.035, 0.0525, 0.07)


class Ranges(NamedTuple):
    """Of the hands found in one picture, one or both, each (B,) but the scores: estimated metres, joints' scores
    (B, 21), true metres, NaN where there is no such hand, and the palm's misfit in hand lengths."""

    estimated: np.ndarray
    scores: np.ndarray
    true: np.ndarray
    misfit: np.ndarray


def main() -> int:
    """Reads the options, looks at the pictures and prints."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("preset", type=Path, help="weights folder")
    parser.add_argument("--data", nargs="+", required=True, help="folders of labelled pictures")
    options = parser.parse_args()
    try:
        shipped = HandEstimator.from_preset(options.preset)
        config = dataclasses.replace(shipped.card.placement, range_errors=None)
        estimator = HandEstimator(shipped.networks, dataclasses.replace(shipped.card, placement=config))
        found = [ranges_in(estimator, sample) for folder in options.data for sample in open_dataset(folder).samples]
        errors = fitted([one for one in found if np.isfinite(one.true).any()])
    except TwoHandsError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    scale, power = fitted_sigma(found, errors)
    print(f'"range_errors": [{errors[0]:.3f}, {errors[1]:.3f}], "sigma_scale": {scale:.2f}, "sigma_power": {power:.2f}')
    (share, spread, misfit), usual = said_errors(found, errors), PlacementConfig().usual_spread
    print(f"within one standard deviation: {(share < np.minimum(scale * spread * misfit**power, usual)).mean():.3f}")
    for name, chosen in (("as projected", None), ("likely", errors)):
        off = np.concatenate([np.abs(likely(one, chosen) - one.true) for one in found])
        off = off[np.isfinite(off)]
        shares = ", ".join(f"{(off < bar).mean():.4f} within {100 * bar:g} cm" for bar in BARS_M)
        mean, median = 100 * off.mean(), 100 * np.median(off)
        print(f"{name}: {len(off)} hands, {shares}, mean {mean:.2f} cm, median {median:.2f} cm")
    return 0


def ranges_in(estimator: HandEstimator, sample: HandSample) -> Ranges:
    """What the pipeline finds in a picture, and what is true."""
    lengths_m = np.linalg.norm(sample.joints_m[:, ROOT] - sample.joints_m[:, WRIST], axis=-1)
    pose = estimator.estimate(sample.image, sample.camera, np.where(np.isfinite(lengths_m), lengths_m, 0.1))
    sides = [side for side, hand in enumerate(pose.hands) if hand.range_m is not None]
    true = np.where(sample.present, np.linalg.norm(sample.joints_m[:, ROOT], axis=-1), np.nan)
    estimated = np.array([pose.hands[side].range_m for side in sides], np.float64)
    scores = np.array([pose.hands[side].joint_scores for side in sides], np.float64).reshape(-1, N_JOINTS)
    misfit = [misfit_of(pose.hands[side], sample.camera) for side in sides]
    return Ranges(estimated, scores, true[sides], np.array(misfit, np.float64))


def misfit_of(hand: HandPose, camera: PinholeCamera) -> float:
    """`placement.palm_misfit` of a hand that was found, as projected."""
    radius, theta, phi = (np.array([value]) for value in (hand.range_m, hand.theta_deg, hand.phi_deg))
    assert hand.canonical is not None and hand.joints_px is not None and hand.joints_m is not None
    length = np.linalg.norm(hand.joints_m[WRIST] - hand.joints_m[ROOT]) / np.linalg.norm(hand.canonical[WRIST])
    place = GlobalPose(hand.joints_m[None], radius, np.radians(theta), np.radians(phi), np.zeros(1), np.ones(1, bool))
    return float(palm_misfit(hand.canonical[None], hand.joints_px[None], camera, np.array([length]), place)[0])


def likely(found: Ranges, errors: tuple[float, float] | None) -> np.ndarray:
    """(B,) metres: `posterior_ranges`, or as estimated."""
    return posterior_ranges(found.estimated, found.scores, PlacementConfig(range_errors=errors))


def fitted(found: Sequence[Ranges]) -> tuple[float, float]:
    """The two numbers with the least mean loss of the ranges' logarithms.

    Raises:
        InputError: there is no hand.
    """
    if not found:
        raise InputError("no labelled hand was found in these pictures")
    best, span = np.log([0.05, 0.1]), np.log(20.0)
    for _ in range(ROUNDS):
        steps = np.linspace(-span, span, STEPS)
        tried = [(float(np.exp(best[0] + a)), float(np.exp(best[1] + b))) for a in steps for b in steps]
        best = np.log(min(tried, key=lambda errors: loss(found, errors)))
        span /= 3
    return float(np.exp(best[0])), float(np.exp(best[1]))


def fitted_sigma(found: Sequence[Ranges], errors: tuple[float, float]) -> tuple[float, float]:
    """`sigma_scale` and `sigma_power`: the power under which errors over their standard deviation are likeliest, taken
    for Laplacian, and the scale within which 68.3 % of them lie."""
    off, spread, misfit = said_errors(found, errors)
    powers = np.linspace(0, 1.5, 31)

    def lack(power: float) -> float:
        sigma = spread * misfit**power
        return float(np.log((off / sigma).mean()) + np.log(sigma).mean())

    power = float(min(powers, key=lack))
    return float(np.quantile(off / (spread * misfit**power), 0.683)), power


def said_errors(found: Sequence[Ranges], errors: tuple[float, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of all hands, each (N,): errors of their likely ranges as shares, standard deviations of the posterior, and
    misfits over the typical one."""
    config = PlacementConfig(range_errors=errors)
    rows = []
    for one in found:
        ranges, spread = posterior(one.estimated, one.scores, config)
        rows.append(np.stack([np.abs(one.true / ranges - 1), spread, one.misfit / config.sigma_misfit]))
    off, spread, misfit = np.concatenate(rows, axis=1)
    known = np.isfinite(off)
    return off[known], spread[known], misfit[known]


def loss(found: Sequence[Ranges], errors: tuple[float, float]) -> float:
    """Mean smoothed size of the errors of the likely ranges' logarithms."""
    off = np.abs(np.concatenate([np.log(likely(one, errors) / one.true) for one in found]))
    off = off[np.isfinite(off)]
    return float(np.where(off < SMOOTH, off**2 / (2 * SMOOTH), off - SMOOTH / 2).mean())


if __name__ == "__main__":
    sys.exit(main())
