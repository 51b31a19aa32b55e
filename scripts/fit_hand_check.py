"""Fits HandCheck's layer to crops of hands and of other things (extras `synth`, `train`, `datasets`).

    python -m scripts.fit_hand_check src/twohands/weights/fast --encoder hand_landmark_full.tflite
        --frames PEOPLE WILD PAPER --backgrounds PHOTOS PANORAMAS --digits ../shared/data/real_train/digits
        --cache out/check_1.npz [out/check_2.npz ...]

Hands are those of cached frames and of photographed digits, in the places where they are and where the preset's own
networks see them. All else is nothing: what these networks take for hands in the pictures of people and in photographs
without hands, and other places there. The encoder stays as published, so every crop is looked at once, and kept in the
cache as what the layer sees. Every cache is of one process, with a seed of its own; `--look MINUTES` fills it.

Fits a logistic regression with a quadratic penalty, on whether there is a hand; prints how often it is right, by kind
of crop, of pictures held out; writes `hand_check.onnx` and the card's section of it into the folder
of the preset's second pose networks.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
import torch
from scipy.optimize import minimize
from scipy.special import expit
from scripts.fit_handedness import photograph, true_side
from torch import nn

from twohands.errors import InputError, TwoHandsError
from twohands.export.onnx import export_network
from twohands.geometry.boxes import upright_crop, warp_image
from twohands.geometry.network_input import network_input
from twohands.geometry.rotation import rotation_about_z
from twohands.inference.detection import HandFinder
from twohands.inference.engine import OpenVinoNetwork
from twohands.inference.estimator import HandEstimator
from twohands.inference.weights import HAND_CHECK, read_card, second_folder, write_card
from twohands.models.efficientnet import load_published
from twohands.models.hand_check import HandCheck, HandCheckConfig
from twohands.skeleton import LEFT, N_JOINTS, RIGHT
from twohands.training.batches import with_parts
from twohands.training.config import AugmentConfig, DataConfig, folder_list
from twohands.training.sources import backgrounds_of, open_source
from twohands.training.transforms import PhotometricConfig, jitter_colours
from twohands.types import HandSample

MARGIN: Final = 1.4
"""Side of a crop over the larger side of the hand's box: hands are as large then as those that the encoder has seen."""
NOTHING: Final = -1
"""Beside LEFT and RIGHT, what a crop shows."""
PHOTOGRAPHS: Final = 0.4
"""Share of the pictures without anybody."""
PARTS: Final = AugmentConfig(cut=0.2, handless=0.15)
COLOURS: Final = PhotometricConfig(
    brightness=0.15,
    contrast=0.3,
    gamma=0.5,
    hue=0.03,
    saturation=0.4,
    blur=2.0,
    motion=8.0,
    coarse=2.0,
    noise=0.04,
    texture=0.1,
)
"""Changes of so large a share of the crops as `CHANGED`."""
CHANGED: Final = 0.6
JITTER: Final = (0.055, 0.12, 12.0)
"""Standard deviations of where a crop is cut: shift as a share of the hand's size, logarithm of the size, degrees."""
SMALLEST_PX: Final = 8.0
"""Side of the smallest hands."""
NEAREST: Final = 0.8
"""Other places are at least so far from every joint of a hand, in sides of the place."""
HELD_OUT: Final = 0.1
"""Share of the pictures that are held out."""
PENALTY: Final = 1e-3
"""Of the square of a weight times its feature's standard deviation, beside the mean loss of a crop. 3e-4 to 3e-3 are
alike in crops held out."""


class Look(NamedTuple):
    """A crop: its number of picture, kind, what it shows, and what the layer sees of it, (1152,)."""

    picture: int
    kind: str
    shown: int
    features: np.ndarray


@dataclass(frozen=True, slots=True)
class Looker:
    """What looks at crops: the preset, and the encoder."""

    estimator: HandEstimator
    encode: Callable[[np.ndarray], np.ndarray]
    size: int

    def looks(self, sample: HandSample, number: int, rng: np.random.Generator) -> Iterator[Look]:
        """All crops of one picture."""
        for kind, shown, joints_px in self.places(sample, rng):
            if np.ptp(joints_px, axis=0).max() < SMALLEST_PX:
                continue
            image = warp_image(sample.image, upright_crop(joints_px, size=self.size, margin=MARGIN), self.size)
            if rng.random() < CHANGED:
                image = jitter_colours(image, COLOURS, rng)
            yield Look(number, kind, shown, self.encode(network_input(image[None]))[0].astype(np.float16))

    def places(self, sample: HandSample, rng: np.random.Generator) -> Iterator[tuple[str, int, np.ndarray]]:
        """Kind, what is there, and joints (21, 2) of every place of a picture that is looked at."""
        present = np.array(sample.present) & np.isfinite(sample.joints_px).all(axis=(1, 2))
        for joints_px in self.candidates(sample):
            side = true_side(joints_px, sample) if present.any() else None
            yield "candidates", NOTHING if side is None else side, moved_joints(joints_px, rng)
        for side in np.flatnonzero(present):
            yield "hands", int(side), moved_joints(sample.joints_px[side], rng)
        for _ in range(1 if present.any() else 2):
            joints_px = anywhere(sample.image.shape[:2], rng)
            apart = np.linalg.norm(sample.joints_px[present] - joints_px.mean(axis=0), axis=-1)
            if not present.any() or apart.min() > NEAREST * np.ptp(joints_px, axis=0).max():
                yield "elsewhere", NOTHING, joints_px

    def candidates(self, sample: HandSample) -> np.ndarray:
        """Joints (B, 21, 2) of what the preset's networks take for hands."""
        masks, boxes = self.estimator.segment(sample.image)
        sides = np.flatnonzero(boxes.present)
        if not len(sides):
            return np.zeros((0, N_JOINTS, 2))
        finder = HandFinder(self.estimator.stages, self.estimator.card, sample.image, sample.camera)
        return finder.looked(masks, boxes.boxes_px, finder.crops(masks, boxes.boxes_px, sides)).joints_px


def main() -> int:
    """Reads the options, looks or fits, prints and writes."""
    parser = argparse.ArgumentParser(description="Fits the layer of a preset's HandCheck.")
    parser.add_argument("preset", type=Path, help="weights folder; that of its second pose networks is written")
    parser.add_argument("--encoder", type=Path, required=True, help="hand_landmark_full.tflite")
    parser.add_argument("--cache", type=Path, nargs="+", required=True, help="files of crops; with --look, one")
    parser.add_argument("--look", type=float, metavar="MINUTES", help="fill the cache, and fit nothing")
    parser.add_argument("--frames", type=Path, nargs="*", default=[], help="folders of cached frames")
    parser.add_argument("--digits", type=Path, help="folder of photographed digits")
    parser.add_argument("--backgrounds", type=Path, nargs="*", default=[], help="folders of photographs and panoramas")
    parser.add_argument("--crop-size", type=int, default=HandCheckConfig.crop_size)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--dry-run", action="store_true", help="write nothing")
    options = parser.parse_args()
    try:
        network = HandCheck(HandCheckConfig(options.crop_size))
        note = {"encoder": load_published(network.encoder, options.encoder)}
        if options.look is not None:
            save(options.cache[0], look_around(options, network))
            return 0
        looks = load(options.cache)
        weights, biases = fit(looks)
        print_held_out(looks)
        if not options.dry_run:
            write(options.preset, network, weights, biases, note | {"crops": counted(looks)})
    except TwoHandsError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def look_around(options: argparse.Namespace, network: HandCheck) -> list[Look]:
    """Crops of as many pictures as there is time for."""
    if not (options.frames and options.digits and options.backgrounds):
        raise InputError("--look needs --frames, --digits and --backgrounds")
    cv2.setNumThreads(1)
    behind = folder_list(options.backgrounds)
    names = ",".join(str(folder) for folder in (*options.frames, options.digits, options.digits))
    shown = DataConfig(source=names, backgrounds=behind, procedural=0.15, clutter=0.3, remixed=0.3, empty=0.2)
    source, _ = open_source(replace(shown, validation=0, variants=20, seed=options.seed))
    empty = backgrounds_of(DataConfig(backgrounds=behind, procedural=0.0, clutter=0.2, remixed=0.3))
    looker = Looker(HandEstimator.from_preset(options.preset, threads=1), encoder_of(network), options.crop_size)
    looks: list[Look] = []
    begun, number = time.monotonic(), 0
    while time.monotonic() - begun < 60 * options.look:
        number += 1
        rng = np.random.default_rng([options.seed, number])
        if rng.random() < PHOTOGRAPHS:
            sample = photograph(empty, options.seed, number)
        else:
            sample = with_parts([source[int(rng.integers(len(source)))]], PARTS, [rng])[0]
        looks += looker.looks(sample, number, rng)
    print(f"{len(looks)} crops of {number} pictures", file=sys.stderr)
    return looks


def encoder_of(network: HandCheck) -> Callable[[np.ndarray], np.ndarray]:
    """What the layer sees of crops (B, 3, S, S): (B, 1152)."""
    features = HandCheck(network.config)
    features.load_state_dict(network.state_dict())
    features.head = nn.Identity()  # type: ignore[assignment]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{HAND_CHECK}.onnx"
        export_network(features, path)
        channels = network.encoder.channels[-1]
        compiled = OpenVinoNetwork(path, input_channels=3, output_channels=(channels,), threads=1)
    return lambda batch: compiled(batch)[0]


def moved_joints(joints_px: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Joints (21, 2) a little elsewhere, larger or smaller, and turned (`JITTER`)."""
    middle, size = joints_px.mean(axis=0), np.ptp(joints_px, axis=0).max()
    turn, scale = math.radians(rng.normal(0, JITTER[2])), np.exp(rng.normal(0, JITTER[1]))
    rotation = scale * rotation_about_z(turn)[:2, :2]
    return middle + (joints_px - middle) @ rotation.T + rng.normal(0, JITTER[0], 2) * size


def anywhere(image_size: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Joints (21, 2) of no hand, spread over a square of any size, anywhere in a picture of size (H, W)."""
    size = np.exp(rng.uniform(np.log(36), np.log(0.8 * min(image_size))))
    return rng.uniform(0, 1, 2) * image_size[::-1] + size * rng.uniform(-0.5, 0.5, (N_JOINTS, 2))


def fit(looks: Looks) -> tuple[np.ndarray, np.ndarray]:
    """Weights (2, 1152) and biases (2,) of the layer: whether it is a hand, where hands and other things count alike,
    however many there are, and whether a hand is a left one."""
    hands = looks.shown != NOTHING
    shares = np.where(hands, 0.5 / hands.mean(), 0.5 / (1 - hands.mean()))
    of_hands = looks.rows(hands)
    found = (
        regression(looks.features, hands, shares),
        regression(of_hands.features, of_hands.shown == LEFT, np.ones(len(of_hands.shown))),
    )
    weights, biases = zip(*found, strict=True)
    return np.stack(weights), np.array(biases)


def regression(features: np.ndarray, true: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, float]:
    """Weights (F,) and bias of a logistic regression.

    Args:
        features: (N, F).
        true: (N,) bool.
        counts: (N,) how much each counts.
    """
    middle, spread = features.mean(axis=0), features.std(axis=0) + 0.05
    scaled, sign, share = (features - middle) / spread, np.where(true, 1.0, -1.0), counts / counts.sum()

    def cost(values: np.ndarray) -> tuple[float, np.ndarray]:
        weights, bias = values[:-1], values[-1]
        margin = sign * (scaled @ weights.astype(np.float32) + bias)
        slope = -share * sign * expit(-margin)
        loss = share @ np.logaddexp(0, -margin) + PENALTY * weights @ weights
        return float(loss), np.append(slope.astype(np.float32) @ scaled + 2 * PENALTY * weights, slope.sum())

    found = minimize(cost, np.zeros(features.shape[1] + 1), jac=True, method="L-BFGS-B", options={"maxiter": 500}).x
    weights = found[:-1] / spread
    return weights, float(found[-1] - weights @ middle)


class Looks(NamedTuple):
    """All crops: kind (N,), shown (N,), picture (N,), features (N, 1152) float32."""

    kind: np.ndarray
    shown: np.ndarray
    picture: np.ndarray
    features: np.ndarray

    def rows(self, chosen: np.ndarray) -> Looks:
        """Some of them, (N,) bool."""
        return Looks(*(values[chosen] for values in self))


def print_held_out(looks: Looks) -> None:
    """How often a layer that is fitted to the other pictures is right about those held out."""
    out = np.random.default_rng(0).random(looks.picture.max() + 1)[looks.picture] < HELD_OUT
    weights, biases = fit(looks.rows(~out))
    kept = looks.rows(out)
    said, left = (kept.features @ weights.T + biases).T
    right = (left > 0) == (kept.shown == LEFT)
    print(f"{'crops held out':16s} {'hands':>6s} {'passed':>7s} {'side':>7s} {'others':>7s} {'refused':>8s}")
    for kind in dict.fromkeys(kept.kind.tolist()):
        hands, others = ((kept.kind == kind) & (kept.shown != NOTHING), (kept.kind == kind) & (kept.shown == NOTHING))
        parts = (said[hands] > 0, right[hands], said[others] < 0)
        passed, sides, refused = (f"{100 * part.mean():.1f} %" if len(part) else "-" for part in parts)
        print(f"{kind:16s} {hands.sum():6d} {passed:>7s} {sides:>7s} {others.sum():7d} {refused:>8s}")


def counted(looks: Looks) -> dict[str, int]:
    """How many crops there are of each kind, for the card."""
    shown = {"left hands": LEFT, "right hands": RIGHT, "other things": NOTHING}
    return {name: int((looks.shown == code).sum()) for name, code in shown.items()}


def save(path: Path, looks: Sequence[Look]) -> None:
    """Writes a cache."""
    path.parent.mkdir(parents=True, exist_ok=True)
    names = ("picture", "kind", "shown", "features")
    np.savez(path, **{name: np.array([getattr(look, name) for look in looks]) for name in names})  # type: ignore[arg-type]


def load(paths: Sequence[Path]) -> Looks:
    """Reads caches; pictures of one are others than those of the next.

    Raises:
        InputError: one cannot be read.
    """
    parts, pictures = [], 0
    for path in paths:
        try:
            with np.load(path) as file:
                part = Looks(file["kind"], file["shown"], file["picture"] + pictures, file["features"])
        except (OSError, ValueError, KeyError) as error:
            raise InputError(f"{path} is no cache of crops: {error}") from error
        parts.append(part._replace(features=part.features.astype(np.float32)))
        pictures = int(part.picture.max()) + 1
    return Looks(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def write(preset: Path, network: HandCheck, weights: np.ndarray, biases: np.ndarray, note: dict) -> None:
    """Puts the network and its section of the card into the folder of the second pose networks."""
    card = read_card(preset)
    if not card.second:
        raise InputError(f"{preset}: its card names no second pose networks, beside which HandCheck could be")
    with torch.no_grad():
        network.head.weight.copy_(torch.from_numpy(weights))
        network.head.bias.copy_(torch.from_numpy(biases))
    folder = second_folder(preset, card)
    said = json.loads((folder / "card.json").read_text(encoding="utf-8"))
    said[HAND_CHECK] = {"crop_size": network.config.crop_size, "crop_margin": MARGIN, **note}
    export_network(network, folder / f"{HAND_CHECK}.onnx", note)
    write_card(folder, said)


if __name__ == "__main__":
    sys.exit(main())
