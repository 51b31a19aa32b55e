"""How far the few numbers of the decision matter: each changed alone, weights and pictures the same (extra `synth`).

    python -m scripts.sweep_decision fast --frames PEOPLE WILD PAPER --backgrounds PHOTOS PANORAMAS
        --digits ../shared/data/real_train/digits --count 60 --out docs/results/decision.md

The pictures are those that `scripts/fit_handedness.py` takes, of seeds that no network was trained on. Every setting
runs through the whole decision of `inference.detection`; the learnt weights stay as the card has them. Writes one
table; whoever finds a better value puts it into `inference.decision` by hand, and fits the weights again.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from scripts.fit_handedness import COLUMNS, SAVED_EVERY, add_picture_options, counted, outcome_of, planned

from twohands.errors import InputError, TwoHandsError
from twohands.files import write_whole
from twohands.inference.estimator import HandEstimator
from twohands.inference.stages import Stages
from twohands.inference.weights import preset_folder, read_card, weights_id
from twohands.types import HandCrop, HandSample

TRIED: Final[dict[str, tuple[float, ...]]] = {
    "candidate_threshold": (0.01, 0.06, 0.12),
    "mirror_below_logit": (1.0, 5.0, 99.0),
    "same_place_iou": (0.25, 0.55, 0.7),
}
"""Values beside the card's own."""


def main() -> int:
    """Reads the options, looks, and writes the table."""
    parser = argparse.ArgumentParser(description="Changes every number of the decision alone and counts errors.")
    parser.add_argument("preset", help="weights folder or preset")
    add_picture_options(parser, count=60, digits=60, photographs=60)
    parser.add_argument("--out", type=Path, required=True, help="markdown file")
    options = parser.parse_args()
    try:
        cv2.setNumThreads(1)
        folder = preset_folder(options.preset)
        card = read_card(folder)
        if not card.decides:
            raise InputError(f"{card.name}: its card has no fitted decision")
        settings = list(settings_of(card.decision))
        decider = Remembering(HandEstimator.from_preset(options.preset, threads=1))
        rows = np.zeros((len(settings), len(COLUMNS)), int)
        plan = planned(options)
        for number, (_, sample_of) in enumerate(plan):
            rows += decider.errors(sample_of(), [setting for _, _, setting in settings])
            if number % SAVED_EVERY == 0 or number + 1 == len(plan):
                write_whole(options.out, page(weights_id(folder, card), settings, rows).encode())
                print(f"{number + 1} of {len(plan)} pictures", file=sys.stderr, flush=True)
    except TwoHandsError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def settings_of(decision: Any) -> Iterator[tuple[str, float, dict[str, float]]]:
    """Name, value and overrides of every setting; the card's own values first."""
    yield "as shipped", float("nan"), {}
    for name, values in TRIED.items():
        for value in sorted({*values, getattr(decision, name)}):
            if value != getattr(decision, name):
                yield name, value, {name: value}


class Remembering:
    """Looks at one picture after the other with many settings; of every picture, and every crop of it, the networks
    see each only once.

    Args:
        estimator: with the card's own settings.
    """

    def __init__(self, estimator: HandEstimator) -> None:
        self.estimator = estimator
        self._plain = estimator.stages
        self._maps: dict[int, Any] = {}
        self._located: dict[tuple[int, bytes], tuple[np.ndarray, np.ndarray]] = {}

    def errors(self, sample: HandSample, settings: Sequence[dict[str, float]]) -> np.ndarray:
        """(N, 6) int by `COLUMNS` of every setting."""
        self._maps, self._located = {}, {}
        rows = []
        for setting in settings:
            card = self.estimator.card
            card = replace(card, decision=replace(card.decision, **setting))
            networks = self.estimator.networks
            seen_once = {"hand_maps": self._hand_maps, "locate": self._locate, "lift": self._plain.lift}
            stages = replace(Stages.of(networks, card), **seen_once)
            pose = HandEstimator(networks, card, stages).estimate(sample.image, sample.camera)
            outcome = np.zeros(2, int)
            for side, hand in enumerate(pose.hands):
                if hand.joints_px is not None:
                    outcome[side] = outcome_of(hand.joints_px, side, sample)
            rows.append(counted(outcome, sample.present))
        return np.array(rows)

    def _hand_maps(self, image: np.ndarray) -> Any:
        if id(image) not in self._maps:
            self._maps[id(image)] = self._plain.hand_maps(image)
        return self._maps[id(image)]

    def _locate(self, crops: list[HandCrop]) -> tuple[np.ndarray, np.ndarray]:
        keys = [(crop.side, crop.image.tobytes()) for crop in crops]
        for key, crop in zip(keys, crops, strict=True):
            if key not in self._located:
                self._located[key] = self._plain.locate([crop])
        maps, logits = zip(*(self._located[key] for key in keys), strict=True)
        return np.concatenate(maps), np.concatenate(logits)


def page(weights: str, settings: Sequence[tuple[str, float, dict[str, float]]], rows: np.ndarray) -> str:
    """The table as a page."""
    lines = [
        "# The decision's numbers, each changed alone",
        "",
        f"```\npython -m scripts.sweep_decision {shlex.join(sys.argv[1:])}\n```",
        "",
        f"Weights {weights}. {rows[0, 0]} pictures with {rows[0, 1]} hands.",
        "",
        "| setting | value | " + " | ".join(COLUMNS[2:]) + " |",
        "| --- | ---: |" + " ---: |" * len(COLUMNS[2:]),
    ]
    for (name, value, _), row in zip(settings, rows, strict=True):
        counts = " | ".join(map(str, row[2:]))
        lines.append(f"| {name} | {'' if np.isnan(value) else format(value, 'g')} | {counts} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
