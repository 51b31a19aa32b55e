"""Labels in place of what a stage would estimate: the isolated studies and the error budget.

Source: paper, section 5 ("isolated studies").
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal, get_args

import numpy as np

from twohands.errors import CheckpointError, InputError
from twohands.evaluation.completion import hand_lengths_m
from twohands.geometry.boxes import apply_homography, box_in_picture
from twohands.geometry.canonical import canonical_from_camera
from twohands.geometry.heatmaps import encode_heatmaps
from twohands.geometry.part_labels import hand_classes
from twohands.inference.estimator import HandEstimator
from twohands.inference.stages import StageTruth
from twohands.inference.trail import Trail
from twohands.types import HandSample, TwoHandPose

Stage = Literal["presence", "masks", "boxes", "joints-2d", "heatmaps", "canonical"]
"""What can be replaced. "heatmaps" are read by PoseNet3D, from "joints-2d" the range is solved."""
STAGES: Final[tuple[Stage, ...]] = get_args(Stage)


@dataclass(frozen=True, slots=True)
class HeatmapTargets:
    """How the maps looked that a preset's PoseNet2D was trained to give.

    Attributes:
        sigma: standard deviation of the Gaussian at canonical depth 0, in map cells.
        with_depth: whether the spread carries the depth (z-heatmaps, paper section 4.2).
        probabilities: whether every map has the mass of a Gaussian of `sigma` and peak 1, as softmax maps do.
        map_size: side of the maps in cells.
    """

    sigma: float = 2.0
    with_depth: bool = True
    probabilities: bool = False
    map_size: int = 32

    @classmethod
    def from_folder(cls, folder: Path) -> HeatmapTargets:
        """Reads what the weights' card says; where it is silent, the paper's maps.

        Raises:
            CheckpointError: the card cannot be read.
        """
        try:
            card = json.loads((folder / "card.json").read_text(encoding="utf-8"))
            net = card["pose_net_2d"]
            loss = card.get("training", {}).get("pose_net_2d", {}).get("loss", {})
            return cls(
                sigma=float(net.get("sigma", 2.0)),
                with_depth=bool(loss.get("z_heatmaps", True)),
                probabilities=net.get("activation") == "softmax",
                map_size=int(net.get("map_size", 32)),
            )
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise CheckpointError(f"{folder / 'card.json'}: not a readable card: {error}") from None


def stage_truth(sample: HandSample, stages: tuple[Stage, ...]) -> StageTruth:
    """Ground truth for the stages named, taken from a sample's labels; heatmaps need crops, see `TruthfulEstimator`.

    Args:
        sample: a labelled image.
        stages: what to replace.

    Returns:
        What `HandEstimator.estimate` takes; all None for no stage.

    Raises:
        InputError: masks are asked for, but the sample has no part labels.
    """
    if "masks" in stages and sample.labels is None:
        raise InputError(f"{sample.source}: has no part labels to replace the masks by")
    return StageTruth(
        masks=hand_classes(sample.labels) if "masks" in stages and sample.labels is not None else None,
        boxes_px=_true_boxes(sample) if "boxes" in stages else None,
        present=sample.present if "presence" in stages else None,
        joints_px=sample.joints_px if "joints-2d" in stages else None,
        canonical=np.asarray(canonical_from_camera(sample.joints_m).joints) if "canonical" in stages else None,
    )


class TruthfulEstimator:
    """An estimator some of whose stages are replaced by each sample's labels.

    The hand length is always that of each labelled hand: it is an input of the method, not an estimate (paper 4.4).

    Args:
        estimator: the pipeline.
        stages: what to replace.
        targets: how true heatmaps look; needed for the stage "heatmaps" only.

    Raises:
        InputError: heatmaps without boxes: the maps belong to crops that must be known beforehand.
    """

    def __init__(
        self, estimator: HandEstimator, stages: tuple[Stage, ...] = (), targets: HeatmapTargets | None = None
    ) -> None:
        if "heatmaps" in stages and "boxes" not in stages:
            raise InputError("true heatmaps need true boxes: add boxes to --truth")
        self.estimator = estimator
        self.stages = stages
        self._targets = targets or HeatmapTargets()

    def __call__(self, sample: HandSample, previous: TwoHandPose | Trail | None = None, index: int = 0) -> TwoHandPose:
        """Estimates one sample; `previous` and `index` as for `HandEstimator.estimate`.

        Raises:
            InputError: as `stage_truth`.
        """
        truth = stage_truth(sample, self.stages)
        if "heatmaps" in self.stages:
            truth = replace(truth, heatmaps=self._true_heatmaps(sample, truth))
        length_m = hand_lengths_m(sample)
        return self.estimator.estimate(sample.image, sample.camera, length_m, truth, index=index, previous=previous)

    def _true_heatmaps(self, sample: HandSample, truth: StageTruth) -> np.ndarray | None:
        """(2, 21, M, M) maps of the crops that the pipeline cuts from the true boxes; zeros for an absent hand."""
        assert truth.boxes_px is not None
        canonical = np.asarray(canonical_from_camera(sample.joints_m).joints)
        card, maps = self.estimator.card, {}
        no_mask = np.zeros(sample.image.shape[:2], np.uint8)
        for side in (0, 1):
            if not np.isfinite(truth.boxes_px[side]).all():
                continue
            masks = no_mask if truth.masks is None else truth.masks
            crop = self.estimator.stages.crop(sample.image, masks, truth.boxes_px[side], side, sample.camera)
            joints = apply_homography(np.linalg.inv(crop.image_from_crop), sample.joints_px[side]) - card.surround
            maps[side] = true_heatmaps(joints, canonical[side, :, 2], card.seen_size, self._targets)
        if not maps:
            return None
        empty = np.zeros_like(next(iter(maps.values())))
        return np.stack([maps.get(side, empty) for side in (0, 1)])


def true_heatmaps(joints_crop_px: np.ndarray, z: np.ndarray, crop_size: int, targets: HeatmapTargets) -> np.ndarray:
    """Maps as a perfect PoseNet2D would give them.

    Args:
        joints_crop_px: (21, 2) pixels of the part of the crop of which there are maps; joints outside have empty ones.
        z: (21,) canonical depth.
        crop_size: side of that part in pixels.
        targets: how they look.

    Returns:
        (21, M, M) float32.
    """
    inside = np.all((joints_crop_px >= 0) & (joints_crop_px <= crop_size), axis=-1)
    seen = np.where(inside[:, None], joints_crop_px, np.nan)
    depth = z if targets.with_depth else None
    maps = np.asarray(
        encode_heatmaps(seen, crop_size=crop_size, map_size=targets.map_size, sigma=targets.sigma, z=depth)
    )
    if targets.probabilities:
        mass = maps.sum(axis=(1, 2), keepdims=True)
        maps = maps / np.maximum(mass, 1e-12) * (2 * np.pi * targets.sigma**2)
    return maps.astype(np.float32)


def _true_boxes(sample: HandSample) -> np.ndarray:
    """(2, 4) tight boxes of the joints of present hands, within the picture as estimated ones are; NaN else."""
    height, width = sample.image.shape[:2]
    boxes_px = box_in_picture(sample.joints_px, width, height)
    return np.where(sample.present[:, None], np.asarray(boxes_px), np.nan)
