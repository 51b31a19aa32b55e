"""Fits how sides add up over video (`inference.side_keeping`) to labelled sequences that nothing was trained on.

    twohands generate dynamic --split val --seed 7101 --preset wild --config.webcam 1 --frames 150 --out data/webcam
    python -m scripts.fit_sides src/twohands/weights/fast --data data/webcam

Every frame is looked at by itself; then what it says of the true hands goes through the memory of the pipeline, with
one number after the other changed. Printed are the mean of -log(chance of the true side) after each frame, how many
hands would be on the wrong side, and how far hands are seen from where they were expected; put the best into
`inference.decision` by hand.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Final

import numpy as np
from scripts.fit_handedness import true_side

from twohands.datasets.base import HandDataset
from twohands.datasets.opening import open_dataset
from twohands.errors import InputError, TwoHandsError
from twohands.inference.decision import DecisionConfig
from twohands.inference.estimator import HandEstimator
from twohands.inference.side_keeping import SIGNS, SideMemory, boxes_of
from twohands.types import HandPose, HandSample, TwoHandPose

TRIED: Final[dict[str, tuple[float, ...]]] = {
    "side_trust": (0.1, 0.2, 0.3, 0.5, 0.7, 1.0),
    "side_reach": (0.1, 0.15, 0.2, 0.25, 0.35, 0.5),
    "side_limit": (3.0, 4.0, 6.0, 8.0, 12.0),
}


def main() -> int:
    """Reads the options, looks at the sequences and prints."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("preset", type=Path, help="weights folder")
    parser.add_argument("--data", nargs="+", required=True, help="folders of dynamic sets")
    options = parser.parse_args()
    try:
        estimator = HandEstimator.from_preset(options.preset)
        clips = [clip for folder in options.data for clip in clips_in(estimator, open_dataset(folder).samples)]
        if not any(hand.present for clip in clips for pose in clip for hand in pose.hands):
            raise InputError("no hand was found in these sequences")
    except TwoHandsError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(table(clips, estimator.card.decision), end="")
    return 0


def clips_in(estimator: HandEstimator, samples: HandDataset | Sequence[HandSample]) -> list[list[TwoHandPose]]:
    """Of every sequence, what single frames say of its true hands (`on_true_sides`)."""
    clips = []
    numbers = range(len(samples))
    for _, frames in groupby(numbers, key=lambda number: samples[number].source.rpartition("/")[0]):
        poses, previous = [], None
        for number in frames:
            sample = samples[number]
            previous = estimator.estimate(sample.image, sample.camera, index=number, previous=previous)
            poses.append(on_true_sides(previous, sample))
        clips.append(poses)
    return clips


def on_true_sides(pose: TwoHandPose, sample: HandSample) -> TwoHandPose:
    """The hands that are true ones on their true sides, with the log-odds of these; the others absent."""
    hands = [HandPose(present=False), HandPose(present=False)]
    for side, hand in enumerate(pose.hands):
        true = None if hand.joints_px is None or hand.side_logit is None else true_side(hand.joints_px, sample)
        if true is not None and hand.side_logit is not None and not hands[true].present:
            hands[true] = replace(hand, side_logit=hand.side_logit if true == side else -hand.side_logit)
    return replace(pose, left=hands[0], right=hands[1], masks=None)


def true_side_logits(clip: Sequence[TwoHandPose], config: DecisionConfig) -> np.ndarray:
    """(N,) log-odds of the true side of every hand of a clip, after its frame."""
    memory, logits = SideMemory(config), []
    for pose in clip:
        known = memory.left_logits(boxes_of(pose))
        logits += [
            SIGNS[side] * known[side] + memory.said(hand) for side, hand in enumerate(pose.hands) if hand.present
        ]
        memory = memory.after(pose)
    return np.array(logits)


def loss(clips: Sequence[Sequence[TwoHandPose]], config: DecisionConfig) -> tuple[float, int]:
    """Mean of -log(chance of the true side) over all hands, and how many are on the wrong side."""
    logits = np.concatenate([true_side_logits(clip, config) for clip in clips])
    return float(np.logaddexp(0.0, -logits).mean()), int((logits < 0).sum())


def spread(clips: Sequence[Sequence[TwoHandPose]], config: DecisionConfig) -> float:
    """Root mean square, along one axis, of how far hands are seen from where they were expected, over their sizes."""
    squares = []
    for clip in clips:
        memory = SideMemory(config)
        for pose in clip:
            for box_px, track in zip(boxes_of(pose), memory.tracks, strict=True):
                if track is not None and not track.unseen and np.isfinite(box_px).all():
                    off = (box_px[:2] + box_px[2:]) / 2 - track.middle - track.step
                    squares.append(float((off**2).mean()) / track.size**2)
            memory = memory.after(pose)
    return float(np.sqrt(np.mean(squares))) if squares else float("nan")


def table(clips: Sequence[Sequence[TwoHandPose]], config: DecisionConfig) -> str:
    """All that was tried, as markdown."""
    alone = np.array(
        [SideMemory(config).said(hand) for clip in clips for pose in clip for hand in pose.hands if hand.present]
    )
    lines = [
        f"{len(clips)} sequences, {sum(map(len, clips))} frames, {len(alone)} hands; by single frames "
        f"{(alone < 0).sum()} on the wrong side. Hands are seen {spread(clips, config):.3f} of their size from where "
        "they were expected (one axis, root mean square).",
        "",
        "| number | value | -log(chance of the true side) | on the wrong side |",
        "| --- | ---: | ---: | ---: |",
    ]
    for name, values in TRIED.items():
        for value in values:
            mean, wrong = loss(clips, replace(config, **{name: value}))
            lines.append(f"| {name} | {value:g} | {mean:.4f} | {wrong} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
