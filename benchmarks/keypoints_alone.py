"""PoseNet2D by itself, in training or shipped: hands of real and generated pictures in crops cut by their true boxes.

Masks are HandSegNet's, boxes are those of the reference joints, so that nothing is missed and no side is wrong. What
the network says then is all that it can. Figures of a part, as shares of all its hands:

- good: half of the joints lie within .1 of the hand's size, the longer side of its box;
- joints: those within .1;
- hand, mirrored: the hand classifier says yes to the crop, and no to the same crop mirrored.

Run from the repository root:

    python -m benchmarks.keypoints_alone runs/pose2d/pose_net_2d.safetensors \
        src/twohands/weights/fast/pose_net_2d.onnx --generated data/people --count 250

With `--upright`, crops are rolled by the known joints so that the fingers point up, as for networks whose card says so
(`views.upright_within_deg`).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from benchmarks import real_pictures
from benchmarks.real_pictures import SHARED, Part

from twohands.errors import TwoHandsError
from twohands.geometry.boxes import apply_homography
from twohands.inference.detection import HandFinder
from twohands.inference.engine import load_networks
from twohands.inference.estimator import HandEstimator
from twohands.inference.keypoints import joint_boxes
from twohands.inference.stages import StageTruth
from twohands.inference.weights import DEFAULT_PRESET, preset_folder, read_card
from twohands.models.checkpoint import load_network
from twohands.models.pose_net_2d import PoseNet2D
from twohands.skeleton import N_JOINTS, SIDES
from twohands.training.pose_stages import read_out
from twohands.training.stage import normalised
from twohands.types import HandCrop, HandSample

CLOSE = 0.1
"""Share of the hand's size within which a joint counts as found."""
SMALLEST_PX = 4
"""Boxes with a shorter side are left out."""
BATCH = 32


class KnownCrop(NamedTuple):
    """A crop cut by a hand's true box, and the joints (21, 2) that are known, in pixels of the picture."""

    crop: HandCrop
    joints_px: np.ndarray


class Answers(NamedTuple):
    """What a network says of N crops.

    Attributes:
        errors: (N, 21) distance from the known joints as a share of the hand's size.
        hand, mirrored: (N,) bool, the hand classifier is right about the crop, and about the same crop mirrored; None
            for a network without one.
    """

    errors: np.ndarray
    hand: np.ndarray | None
    mirrored: np.ndarray | None


def known_crops(part: Part, estimator: HandEstimator, count: int | None = None) -> Iterator[KnownCrop]:
    """Crops of all known hands of a part, or of its first pictures, as the pipeline cuts them from true boxes."""
    for sample in islice(part.samples(), count):
        hands = part.reference.get(sample.source, {}) if part.reference else real_pictures.reference_of(sample)
        yield from crops_of(sample, [hands.get(side) for side in SIDES], estimator)


def crops_of(sample: HandSample, hands: list, estimator: HandEstimator) -> Iterator[KnownCrop]:
    """Crops of the hands of one picture.

    Args:
        sample: the picture.
        hands: joints (21, 2) of the left and the right hand in pixels, None for one that is not known.
        estimator: whose HandSegNet gives the masks and whose card says how crops are cut.
    """
    joints_px = np.full((2, N_JOINTS, 2), np.nan)
    for side, joints in enumerate(hands):
        if joints is not None:
            joints_px[side] = joints
    boxes = joint_boxes(joints_px, sample.image.shape[:2], np.full((2, 4), np.nan), SMALLEST_PX)
    present = np.isfinite(boxes).all(axis=1)
    if not present.any():
        return
    masks, found = estimator.segment(sample.image, StageTruth(boxes_px=boxes, present=present))
    finder = HandFinder(estimator.stages, estimator.card, sample.image, sample.camera)
    sides = np.flatnonzero(present)
    if estimator.card.views.upright:
        crops = finder.joint_crops(masks, found.boxes_px, joints_px[sides], sides, np.zeros(len(sides), int))
    else:
        crops = finder.crops(masks, found.boxes_px, sides, estimated=False)
    for crop in crops:
        yield KnownCrop(crop, joints_px[crop.side])


@torch.no_grad()
def answers(network: PoseNet2D, known: list[KnownCrop]) -> Answers:
    """What a network in evaluation mode says of crops of its own size."""
    errors, right = np.empty((len(known), N_JOINTS)), np.zeros((2, len(known)), bool)
    for start in range(0, len(known), BATCH):
        some = known[start : start + BATCH]
        images = normalised(torch.from_numpy(np.stack([one.crop.image for one in some])))
        maps, hand_logit = network.judged(images)
        joints = read_out(network, network.heatmaps(maps)).double()
        homography = torch.from_numpy(np.stack([one.crop.image_from_crop for one in some]))
        found_px = np.asarray(apply_homography(homography, joints))
        known_px = np.stack([one.joints_px for one in some])
        rows = slice(start, start + len(some))
        errors[rows] = np.linalg.norm(found_px - known_px, axis=-1) / np.ptp(known_px, axis=1).max(axis=-1)[:, None]
        if hand_logit is not None:
            mirrored = network.judged(images.flip(3))[1]
            assert mirrored is not None
            right[0, rows], right[1, rows] = hand_logit[:, 0] > 0, mirrored[:, 0] < 0
    return Answers(errors, *(None if network.judge is None else about for about in right))


def line(name: str, found: Answers) -> str:
    """A row of the table, in the order of `HEADING`."""
    good = np.median(found.errors, axis=1) < CLOSE
    shares = [good, found.errors < CLOSE, found.hand, found.mirrored]
    cells = ["-" if share is None else f"{100 * share.mean():.0f} %" for share in shares]
    median = f"{np.median(found.errors):.3f}"
    return f"| {' | '.join([name, str(len(found.errors)), *cells[:2], median, *cells[2:]])} |"


HEADING = "| part | hands | good | joints | median | hand | mirrored |\n| --- | " + " | ".join(6 * ["---:"]) + " |"


def main() -> int:
    """See the module's docstring."""
    args = _parser().parse_args()
    if args.threads:
        torch.set_num_threads(args.threads)
    parts = [real_pictures.ge2019, real_pictures.people, real_pictures.some_frames, real_pictures.digits]
    chosen = [(part(args.shared), None) for part in parts] if args.shared.is_dir() else []
    chosen += [(real_pictures.generated(folder, folder.name), args.count) for folder in args.generated]
    folder = preset_folder(args.weights)
    card = read_card(folder)
    if args.upright:
        card = replace(card, views=replace(card.views, upright_within_deg=0.0))
    segmenting = load_networks(folder, card, args.threads)
    crops: dict[int, dict[str, list[KnownCrop]]] = {}
    for path in args.networks:
        network = load_network("pose_net_2d", path).eval()
        assert isinstance(network, PoseNet2D)
        size = network.config.crop_size
        if size not in crops:
            estimator = HandEstimator(segmenting, replace(card, crop_size=size))
            crops[size] = {part.name: list(known_crops(part, estimator, count)) for part, count in chosen}
        print(f"\n{path}\n\n{HEADING}")
        for name, known in crops[size].items():
            if known:
                print(line(name, answers(network, known)), flush=True)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    option = parser.add_argument
    option("networks", nargs="+", type=Path, help="checkpoints or exported files of PoseNet2D")
    option("--weights", default=DEFAULT_PRESET, help="preset or folder whose HandSegNet gives the masks")
    option("--shared", type=Path, default=SHARED, help="folder of the real pictures; none if it is missing")
    option("--generated", type=Path, nargs="*", default=[], help="generated test sets")
    option("--count", type=int, help="so many pictures of each of these; all if not given")
    option("--upright", action="store_true", help="roll crops so that the fingers point up")
    option("--threads", type=int, default=0, help="CPU threads; 0 takes all cores")
    return parser


if __name__ == "__main__":
    try:
        sys.exit(main())
    except TwoHandsError as error:
        sys.exit(f"error: {error}")
