"""Figures from predictions on the pictures of `benchmarks.real_pictures`: nothing here runs a network.

A reference hand is matched as `tools/score_people.py` does it: by a found hand whose palm is within half of the hand's
size. References are what MediaPipe found, a floor and not the truth.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from benchmarks.real_hands import hand_figures
from benchmarks.real_pictures import Part, Reference, reference_of

from twohands.evaluation.comparison import compare, sequences
from twohands.evaluation.predictions import Predictions
from twohands.evaluation.protocols import evaluate
from twohands.skeleton import LEFT, SIDES
from twohands.types import HandSample

PALM = [0, 5, 9, 13, 17]
"""Joints whose mean is the palm's place."""
BOOK = "asl_book.mkv"
"""The clip in which both hands are seen most of the time."""
SAME_HAND = 0.5
"""How far, in hand sizes, a hand moves at most from where it was last seen."""
CLEARLY_NEARER = 0.25
"""By so many hand sizes the other side's last place must be nearer than the own one's, for a change of sides."""
REMEMBERED_FRAMES = 5
"""For so many frames a hand is remembered that is no longer found."""


@dataclass(frozen=True, slots=True)
class Measured:
    """One figure.

    Attributes:
        value: a share 0..1, or in the unit of the figure; NaN where there was nothing to measure.
        count: pictures, hands or frames that it runs over.
    """

    value: float
    count: int


Figures = dict[str, Measured]
"""PART.FIGURE -> what was measured."""


def found_hands(predictions: Predictions) -> Reference:
    """What was found in each picture, in the form of a reference."""
    return {
        source: {
            side: predictions.joints_px[i, s].tolist() if predictions.present[i, s] else None
            for s, side in enumerate(SIDES)
        }
        for i, source in enumerate(predictions.sources)
    }


def matched(part: str, tool: ModuleType, reference: Reference, predictions: Predictions) -> Figures:
    """Found hands beside reference hands: "same_side", "other_side", "none" (shares of the reference hands), "good"
    (share of the hands on their own side whose median joint is within a tenth of the hand's size), "good_of_all" (the
    same of all reference hands), "error" (their median joint error over the hand's size) and "unexplained" (found hands
    that no reference hand explains, over pictures)."""
    score: Mapping[str, Any] = tool.score(reference, found_hands(predictions))
    hands, pictures, same = score["reference"], score["pictures"], score["same_side"]
    good = score["good_share_below_0.1"]
    return {
        f"{part}.same_side": Measured(_share(same, hands), hands),
        f"{part}.other_side": Measured(_share(score["other_side"], hands), hands),
        f"{part}.none": Measured(_share(score["none"], hands), hands),
        f"{part}.good": Measured(good if same else float("nan"), same),
        f"{part}.good_of_all": Measured(_share(good * same, hands), hands),
        f"{part}.error": Measured(score["error_median_of_size"], same),
        f"{part}.unexplained": Measured(_share(score["unexplained"], pictures), pictures),
    }


def people_figures(part: Part, predictions: Predictions, tool: ModuleType) -> Figures:
    """Photographs, or single frames, with reference hands."""
    assert part.reference is not None
    return matched(part.name, tool, part.reference, predictions)


def clip_figures(part: Part, predictions: Predictions, tool: ModuleType) -> Figures:
    """Videos with reference hands in some frames; further "side_changes" per 100 frames, and "book_both"."""
    assert part.reference is not None
    frames, changes = len(predictions), 0
    for clip in sequences(predictions.sources):
        changes += side_changes(predictions.joints_px[clip], predictions.present[clip])
    book = [i for i, name in enumerate(predictions.sources) if name.startswith(f"{BOOK}/") and name in part.reference]
    both = int(predictions.present[book].all(axis=1).sum())
    return matched(part.name, tool, part.reference, predictions) | {
        "clips.side_changes": Measured(100 * _share(changes, frames), frames),
        "clips.book_both": Measured(_share(both, len(book)), len(book)),
    }


def side_changes(joints_px: np.ndarray, present: np.ndarray) -> int:
    """How often a hand of a video takes the other side.

    It does where it is found within half a hand's size of where the other side's hand was last seen, at most five
    frames before, and that is clearly nearer than where its own side's was: hands that touch do not count.

    Args:
        joints_px: (T, 2, 21, 2) pixels, frames in order.
        present: (T, 2) bool.
    """
    palms = joints_px[:, :, PALM].mean(axis=2)  # (T, 2, 2)
    sizes = np.ptp(joints_px, axis=2).max(axis=-1)  # (T, 2)
    seen: list[tuple[int, np.ndarray] | None] = [None, None]
    changes = 0
    for frame in range(len(joints_px)):
        places = [last[1] if last and frame - last[0] <= REMEMBERED_FRAMES else None for last in seen]
        for side in np.flatnonzero(present[frame]):
            palm, size = palms[frame, side], sizes[frame, side]
            own, other = (
                np.inf if place is None else float(np.linalg.norm(palm - place)) / size
                for place in (places[side], places[1 - side])
            )
            changed = other < SAME_HAND and other + CLEARLY_NEARER < own
            changes += changed
            if changed and not present[frame, 1 - side]:
                seen[1 - side] = None  # it is this hand: nothing is left where it was
            seen[side] = frame, palm
    return changes


def digit_figures(part: Part, predictions: Predictions, tool: ModuleType) -> Figures:
    """One right hand in each picture: "right" found at its place, and pictures with a "ghost" left hand."""
    assert part.reference is not None
    found = matched("digits", tool, part.reference, predictions)
    count = len(predictions)
    return {
        "digits.right": found["digits.same_side"],
        "digits.ghost": Measured(_share(int(predictions.present[:, LEFT].sum()), count), count),
        "digits.error": found["digits.error"],
    }


def ge2019_figures(part: Part, predictions: Predictions, tool: ModuleType) -> Figures:
    """As `benchmarks.real_hands` has them."""
    del tool
    samples = list(part.samples())
    values = {f.name: f.value for f in hand_figures(samples, predictions, compare(predictions, samples))}
    count, found = len(samples), int(predictions.present[:, LEFT].sum())
    return {
        "ge2019.found": Measured(values["left hand found"] / 100, count),
        "ge2019.ghosts": Measured(values["right hand found, which is not there"] / 100, count),
        "ge2019.error_px": Measured(values["2D error, median"], found),
        "ge2019.pa_mm": Measured(values["PA-MPJPE"], found),
        "ge2019.range_cm": Measured(values["range error, median"], found),
    }


def official_figures(part: Part, predictions: Predictions, tool: ModuleType) -> Figures:
    """The authors' samples: "both" hands found with joints within half a hand's size (share of the samples), and of
    the worse hand the median 2D error in a picture 480 wide and the range error."""
    samples = list(part.samples())
    comparison = compare(predictions, samples)
    reference = {sample.source: reference_of(sample) for sample in samples}
    score = tool.score(reference, found_hands(predictions))
    both = score["same_side"] == score["reference"] and not score["unexplained"]
    found = comparison.found & comparison.present
    errors_px = np.median(comparison.joints_px, axis=2)[found]
    ranges_cm = 1e2 * comparison.root[..., 3][found]
    return {
        "official.both": Measured(float(both), len(samples)),
        "official.error_px": Measured(_worst(errors_px), len(errors_px)),
        "official.range_cm": Measured(_worst(ranges_cm), len(ranges_cm)),
    }


def photo_figures(part: Part, predictions: Predictions, tool: ModuleType) -> Figures:
    """Photographs without hands: the share of those in which "any" hand is found."""
    del part, tool
    count = len(predictions)
    return {"research.any": Measured(_share(int(predictions.present.any(axis=1).sum()), count), count)}


def generated_figures(part: Part, predictions: Predictions, tool: ModuleType) -> Figures:
    """A generated test set: metrics of the evaluation, and "side_errors", the share of the hands that were found which
    were found on the other side."""
    reference: Reference = {}

    def noted() -> Iterator[HandSample]:
        for sample in part.samples():
            reference[sample.source] = reference_of(sample)
            yield sample

    report = evaluate(predictions, noted())
    score = tool.score(reference, found_hands(predictions))
    near = score["same_side"] + score["other_side"]
    keys = {
        "presence": "presence_accuracy",
        "miou": "miou",
        "error_px": "error_2d_median",
        "range_cm": "range_median",
        "within_7cm": "range_7cm",
    }
    metrics = {metric.key: metric for metric in report.metrics}
    known = {name: metrics[key] for name, key in keys.items() if key in metrics}
    return {
        **{f"{part.name}.{name}": Measured(float(m.value), m.count) for name, m in known.items()},
        f"{part.name}.side_errors": Measured(_share(score["other_side"], near), near),
    }


SCORES: dict[str, Callable[[Part, Predictions, ModuleType], Figures]] = {
    "people": people_figures,
    "clips": clip_figures,
    "frames": people_figures,
    "ge2019": ge2019_figures,
    "digits": digit_figures,
    "official": official_figures,
    "research": photo_figures,
    "generated": generated_figures,
    "paper": generated_figures,
    "wild": generated_figures,
}
"""How each part is scored; "stills" are not."""


def _share(happened: int, count: int) -> float:
    return happened / count if count else float("nan")


def _worst(errors: np.ndarray) -> float:
    return float(np.max(errors)) if len(errors) else float("nan")
