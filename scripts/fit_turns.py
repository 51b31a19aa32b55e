"""Fits what HandSegNet says of a picture's turn (`geometry.picture_turn.turn_logits`; extras `train`, `synth`,
`datasets`).

    python -m scripts.fit_turns src/twohands/weights/fast --frames PEOPLE SHOWN WILD PAPER --backgrounds PHOTOS
        PANORAMAS --digits ../shared/data/real_train/digits

One layer on what the network knows of the whole picture, a logistic regression on the means of its maps in nine areas.
It learns from frames of `twohands generate frames`, photographs without people, and photographed digits, each turned by
every number of quarters. Prints how many are told right of pictures held out in turn, and of how many upright ones
another turn is believed; writes the layer into the network, whose other outputs stay as they are, to the bit, and says
so on the card.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
import torch
from scipy.optimize import minimize
from scipy.special import log_softmax, softmax
from scripts.fit_handedness import FOLDS, frame_count, photograph

from twohands.datasets.digits import Digits
from twohands.errors import InputError, TwoHandsError
from twohands.export.onnx import export_network
from twohands.geometry.network_input import canvas_size, letterbox, network_input
from twohands.geometry.picture_turn import TURN_AREAS, TURNS, area_means
from twohands.inference.turning import turned_image
from twohands.inference.weights import WeightsCard, network_files, read_card, write_card
from twohands.models.checkpoint import load_network, read_note
from twohands.models.hand_seg_net import HandSegNet

PENALTY: Final = 0.01
"""Of half the square of a weight times its feature's standard deviation, beside the mean loss of a picture; of 0.03,
0.01 and 0.003 the one with which pictures held out are likeliest."""
TURNED: Final = 0.02
"""Chance that a camera lies on its side or hangs head down before anything is seen, which the layer's bias holds: so
seldom does what a picture says of it have to be right. Assumed; nobody has counted."""

Picture = tuple[str, int, Callable[[], np.ndarray]]
"""Kind, by how many quarters it is turned, and what gives it."""


def main() -> int:
    """Reads the options, looks, fits, prints and writes."""
    parser = argparse.ArgumentParser(description="Fits what a preset's HandSegNet says of a picture's turn.")
    parser.add_argument("preset", type=Path, help="weights folder; its HandSegNet and card are written")
    parser.add_argument("--frames", type=Path, nargs="*", default=[], help="folders of cached frames")
    parser.add_argument("--count", type=int, default=1000, help="of pictures of every folder, at most")
    parser.add_argument("--digits", type=Path, help="folder of photographed digits")
    parser.add_argument("--digits-count", type=int, default=150)
    parser.add_argument("--backgrounds", type=Path, nargs="*", default=[], help="folders of photographs and panoramas")
    parser.add_argument("--photographs", type=int, default=400, help="backgrounds without people, at most")
    parser.add_argument("--dry-run", action="store_true", help="leave network and card alone")
    options = parser.parse_args()
    try:
        card = read_card(options.preset)
        path = network_files(options.preset, card)["hand_seg_net"]
        network = saying_turn(path)
        plan = list(planned(options))
        if not plan:
            raise InputError("no pictures: name --frames, --digits or --backgrounds")
        features, turns = looked(network, card, plan)
        print_held_out([kind for kind, _, _ in plan], features, turns)
        weights, bias = fit(features, turns)
        if not options.dry_run:
            write(options.preset, path, network, weights, bias)
    except TwoHandsError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def saying_turn(path: Path) -> HandSegNet:
    """A HandSegNet of a file, with the layer that is to be fitted.

    Raises:
        CheckpointError: the file cannot be read.
        InputError: its variant has no such layer.
    """
    read = load_network("hand_seg_net", path)
    assert isinstance(read, HandSegNet)
    network = HandSegNet(replace(read.config, turn=True))
    network.load_state_dict(read.state_dict(), strict=read.config.turn)
    return network.eval()


def planned(options: argparse.Namespace) -> Iterator[Picture]:
    """The pictures that are looked at."""
    from twohands.synth.sets.cache import FrameCache
    from twohands.training.config import DataConfig, folder_list
    from twohands.training.sources import backgrounds_of

    behind = backgrounds_of(DataConfig(backgrounds=folder_list(options.backgrounds)))
    for folder in options.frames:
        cache = FrameCache(folder, behind, frames=(0, min(options.count, frame_count(folder))))
        for i in range(len(cache)):
            turned = max(cache.stored(i)[0].turns, 0)  # frames without whole people, `NO_PEOPLE`, are upright
            yield folder.name, turned, partial(lambda cache, i: cache[i].image, cache, i)
    if options.digits is not None:
        digits = Digits(options.digits, "training")
        for i in np.linspace(0, len(digits) - 1, min(options.digits_count, len(digits))).astype(int).tolist():
            yield "digits", 0, partial(lambda i: digits[i].image, i)
    if options.backgrounds:
        for i in range(options.photographs):
            yield "photographs", 0, partial(lambda i: photograph(behind, 1, i).image, i)


def looked(network: HandSegNet, card: WeightsCard, plan: list[Picture]) -> tuple[np.ndarray, np.ndarray]:
    """What the layer sees of N pictures at every further turn, (N, TURNS, F), and by how much these are turned then,
    (N, TURNS)."""
    features, turns = [], []
    for number, (_, turned, picture) in enumerate(plan):
        image = picture()
        canvases = [letterboxed(turned_image(image, further), card) for further in range(TURNS)]
        views: list[np.ndarray] = [np.zeros(0)] * TURNS
        for alike in (slice(0, TURNS, 2), slice(1, TURNS, 2)):  # in size
            with torch.inference_mode():
                known = network.levels(torch.from_numpy(network_input(np.stack(canvases[alike]))))[0]
            views[alike] = [area_means(maps).ravel() for maps in known.numpy()]
        features.append(views)
        turns.append((turned + np.arange(TURNS)) % TURNS)
        if number % 100 == 0:
            print(f"{number} of {len(plan)} pictures", file=sys.stderr, flush=True)
    return np.array(features, np.float32), np.array(turns)


def letterboxed(image: np.ndarray, card: WeightsCard) -> np.ndarray:
    """A picture as HandSegNet sees it."""
    return letterbox(image, canvas_size((image.shape[0], image.shape[1]), card.seg_input_size))[0]


def fit(features: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Multinomial logistic regression.

    Args:
        features: (..., F).
        turns: (...) int.

    Returns:
        Weights (F, TURNS) and bias (TURNS,).
    """
    rows, right = features.reshape(-1, features.shape[-1]).astype(np.float64), turns.ravel()
    mean, spread = rows.mean(axis=0), rows.std(axis=0) + 1e-3
    rows = (rows - mean) / spread
    wanted = np.eye(TURNS)[right]

    def loss(values: np.ndarray) -> tuple[float, np.ndarray]:
        weights = values.reshape(-1, TURNS)
        scores = rows @ weights[:-1] + weights[-1]
        value = -(log_softmax(scores, axis=1) * wanted).sum(axis=1).mean() + PENALTY / 2 * (weights[:-1] ** 2).sum()
        slope = (softmax(scores, axis=1) - wanted) / len(rows)
        return float(value), np.vstack([rows.T @ slope + PENALTY * weights[:-1], slope.sum(axis=0)]).ravel()

    start = np.zeros((rows.shape[1] + 1) * TURNS)
    found = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": 500}).x.reshape(-1, TURNS)
    weights = found[:-1] / spread[:, None]
    return weights, found[-1] - mean @ weights


def print_held_out(kinds: list[str], features: np.ndarray, turns: np.ndarray) -> None:
    """Shares of pictures told right, each by a layer that has seen no turn of it."""
    fold = np.random.default_rng(0).permutation(len(kinds)) % FOLDS
    said = np.zeros((*turns.shape, TURNS))
    for held_out in range(FOLDS):
        weights, bias = fit(features[fold != held_out], turns[fold != held_out])
        said[fold == held_out] = features[fold == held_out] @ weights + bias
    likely = (said + prior()).argmax(axis=-1)
    print(f"{'kind':16s} pictures  told right  upright ones believed turned  turned ones believed so")
    for kind in dict.fromkeys(kinds):
        mine = np.array(kinds) == kind
        right, upright = said[mine].argmax(axis=-1) == turns[mine], turns[mine] == 0
        believed = likely[mine] == turns[mine]
        print(f"{kind:16s} {mine.sum():8d} {right.mean():11.3f} {1 - believed[upright].mean():29.3f}", end="")
        print(f" {believed[~upright].mean():24.3f}")


def prior() -> np.ndarray:
    """(TURNS,) logarithms of the chances of all turns before anything is seen (`TURNED`)."""
    return np.log([1 - TURNED, *[TURNED / (TURNS - 1)] * (TURNS - 1)])


def write(preset: Path, path: Path, network: HandSegNet, weights: np.ndarray, bias: np.ndarray) -> None:
    """Puts the layer into the network, and the network and what it says into the preset."""
    assert network.turn is not None and network.turn.bias is not None
    by_area = weights.reshape(TURN_AREAS**2, -1, TURNS).transpose(0, 2, 1)  # (area, turn, channel)
    with torch.no_grad():
        network.turn.weight.copy_(torch.from_numpy(by_area.reshape(-1, by_area.shape[2], 1, 1)))
        network.turn.bias.copy_(torch.from_numpy(np.tile((bias + prior()) / TURN_AREAS**2, TURN_AREAS**2)))
    card = json.loads((preset / "card.json").read_text(encoding="utf-8"))
    export_network(network, path, read_note(path))
    card["hand_seg_net"]["turn"] = True
    write_card(preset, card)


if __name__ == "__main__":
    sys.exit(main())
