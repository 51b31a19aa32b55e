"""What 8-bit arithmetic must know about a preset: how large the activations get in its own pipeline."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from twohands.inference.estimator import HandEstimator
from twohands.inference.int8 import activation_peaks, worth_rounding
from twohands.inference.weights import write_card
from twohands.synth.scene.config import PAPER, WILD
from twohands.synth.sets.stream import SyntheticStream
from twohands.types import HandSample

NETWORKS: Final = ("hand_seg_net", "pose_net_2d")
"""PoseNet3D stays in floating point: it takes a tenth of the time and lost 5 % of accuracy in 8 bits."""
SHOWN: Final = 24
"""Inputs that show what an activation's rounding does."""
SEED: Final = 8
COUNTS: Final = {PAPER: 64, WILD: 32}
"""Generated pictures of each kind."""


def generated_pictures() -> Iterator[HandSample]:
    """Pictures of both presets at 480x270.

    Raises:
        MissingExtraError, RendererError: no renderer on this machine.
    """
    for config, count in COUNTS.items():
        stream = SyntheticStream(replace(config, width=480, height=270), SEED, count)
        yield from (stream[i] for i in range(count))


def add_int8(folder: Path, pictures: Iterable[HandSample]) -> None:
    """Let the large networks of a preset run in 8 bits: measure their activations and write the peaks on the card.

    Networks that it takes of another preset keep the peaks that the card has for them, and its second pose networks,
    which are a preset of their own, theirs.

    Args:
        folder: of the preset; its card is replaced.
        pictures: like those to come.

    Raises:
        CheckpointError: the preset cannot be read.
    """
    path = folder / "card.json"
    card = json.loads(path.read_text(encoding="utf-8"))
    shipped = HandEstimator.from_preset(folder)
    kept = {name: peaks for name, peaks in card.get("int8", {}).items() if name in shipped.card.networks}
    inputs: dict[str, list[np.ndarray]] = {name: [] for name in NETWORKS}
    recorders = {name: _recorded(getattr(shipped.networks, name), inputs[name]) for name in NETWORKS}
    estimator = HandEstimator(replace(shipped.networks, **recorders), shipped.card)
    for picture in pictures:
        estimator.estimate(picture.image, picture.camera)
    own = [name for name in NETWORKS if name not in shipped.card.networks]
    card["int8"] = kept | {name: _peaks(folder / f"{name}.onnx", inputs[name]) for name in own}
    write_card(folder, card)


def _peaks(path: Path, given: list[np.ndarray]) -> dict[str, float]:
    """Of the activations of a network that are worth rounding."""
    step = max(1, len(given) // SHOWN)
    return worth_rounding(path, activation_peaks(path, given), given[::step][:SHOWN])


def _recorded(network: Callable[[np.ndarray], Any], inputs: list[np.ndarray]) -> Callable[[np.ndarray], Any]:
    """The same function, keeping what it is given."""

    def call(batch: np.ndarray) -> Any:
        inputs.append(batch)
        return network(batch)

    return call
