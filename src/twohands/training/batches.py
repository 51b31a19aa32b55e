"""Batches as a pure function of (source, config, step): same numbers whatever the worker count, and after a resume."""

from __future__ import annotations

import bisect
import itertools
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from twohands.errors import InputError
from twohands.geometry.boxes import box_iou
from twohands.geometry.part_labels import hand_classes
from twohands.geometry.segmentation import as_one_hand
from twohands.skeleton import LEFT, N_JOINTS, RIGHT
from twohands.training.config import AugmentConfig, TrainConfig
from twohands.training.hand_views import cut_at_border, hand_box, part_without_hands
from twohands.training.parallel import share_of_batch
from twohands.training.pose_targets import (
    PoseTarget,
    Segmentation,
    false_hand,
    mirrored_hand,
    pose_target,
    shows_other_hand,
)
from twohands.training.segmentation_targets import segmentation_target
from twohands.training.segmenter import OpenSegmentation, Segment, Segmenter
from twohands.types import HandSample

Batch = dict[str, Tensor]
Rngs = Sequence[np.random.Generator]
ECHO_GAP = 8
"""Steps between two uses of a picture (`DataConfig.echo`); even, so that two workers meet their own pictures again."""
ONE_HAND_IOU = 0.3
"""Two boxes that overlap more than this around a single hand are taken for parts of it."""


class SampleSource(Protocol):
    """Anything that yields labelled pictures by index."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> HandSample: ...


@dataclass(frozen=True)
class IndexRange:
    """The pictures start..stop of another source."""

    source: SampleSource
    start: int
    stop: int

    def __len__(self) -> int:
        return self.stop - self.start

    def __getitem__(self, index: int, /) -> HandSample:
        if not 0 <= index < len(self):
            raise IndexError(index)
        return self.source[self.start + index]


@dataclass(frozen=True)
class Picked:
    """Some pictures of another source."""

    source: SampleSource
    indices: tuple[int, ...]

    @classmethod
    def evenly(cls, source: SampleSource, count: int) -> Picked:
        """So many pictures, evenly spread over all."""
        return cls(source, tuple(len(source) * i // count for i in range(count)))

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, index: int, /) -> HandSample:
        if not 0 <= index < len(self):
            raise IndexError(index)
        return self.source[self.indices[index]]


@dataclass(frozen=True)
class Joined:
    """Several sources, one after the other."""

    sources: tuple[SampleSource, ...]

    @cached_property
    def _ends(self) -> list[int]:
        return list(itertools.accumulate(len(source) for source in self.sources))

    def __len__(self) -> int:
        return self._ends[-1] if self.sources else 0

    def __getitem__(self, index: int, /) -> HandSample:
        if not 0 <= index < len(self):
            raise IndexError(index)
        at = bisect.bisect_right(self._ends, index)
        return self.sources[at][index - (self._ends[at - 1] if at else 0)]


def segmentation_batch(samples: Sequence[HandSample], config: TrainConfig, rngs: Rngs) -> Batch:
    """Pictures for HandSegNet.

    Args:
        samples: B labelled pictures.
        config: the run.
        rngs: one generator per sample for random changes, or none at all for plain pictures.

    Returns:
        image (B, H, W, 3) uint8, classes (B, H, W) uint8, boxes_px (B, 2, 4) float32, present (B, 2) bool.
    """
    net, augment = config.networks.hand_seg_net, config.augment
    samples = with_parts(samples, augment, rngs)
    targets = [
        segmentation_target(
            sample,
            net.height,
            net.width_px,
            photometric=augment.photometric,
            zoom=augment.zoom,
            two_tones=augment.two_tones,
            rng=rngs[i] if rngs else None,
        )
        for i, sample in enumerate(samples)
    ]
    names = ("image", "classes", "boxes_px", "present")
    return {name: torch.from_numpy(np.stack([getattr(t, name) for t in targets])) for name in names}


def with_parts(samples: Sequence[HandSample], augment: AugmentConfig, rngs: Rngs) -> Sequence[HandSample]:
    """The pictures, a share of them cut so that a hand is leaving them (`AugmentConfig.cut`), another share to a part
    that shows none (`AugmentConfig.handless`)."""
    if not rngs or not (augment.cut or augment.handless):
        return samples
    return [_part_of(one, augment, rng) for one, rng in zip(samples, rngs, strict=True)]


def _part_of(sample: HandSample, augment: AugmentConfig, rng: np.random.Generator) -> HandSample:
    lot = rng.random()
    if lot < augment.cut:
        return cut_at_border(sample, rng)
    return part_without_hands(sample, rng) if lot < augment.cut + augment.handless else sample


def pose_batch(
    samples: Sequence[HandSample],
    config: TrainConfig,
    rngs: Rngs,
    segment: Segment | None = None,
    others: Mapping[int, HandSample] = MappingProxyType({}),
) -> Batch:
    """Crops for PoseNet2D and PoseNet3D: every usable hand of the pictures, and what a judge must learn to refuse.

    Args:
        samples: labelled pictures.
        config: the run.
        rngs: one generator per sample for random changes, or none at all for plain crops.
        segment: finds masks and boxes, for all pictures without `rngs`; with them for those without hands and for the
            share `augment.predicted` of the others. None for true ones.
        others: for samples without hands, by number, another sample whose masks are laid over the picture, so that
            PoseNet2D's judge learns to look at more than outlines.

    Returns:
        The fields of `PoseTarget`, stacked over N crops, and lot (N,) float32, a random number in [0, 1) for each; N
        may be 0.
    """
    size = config.networks.pose_net_2d.crop_size
    judged = config.networks.pose_net_2d.judge
    samples = with_parts(samples, config.augment, rngs)
    targets: list[PoseTarget] = []
    lots: list[float] = []
    shares = [config.augment.predicted if any(sample.present) else 1.0 for sample in samples]
    chosen = [i for i in range(len(samples)) if not rngs or rngs[i].random() < shares[i]]
    predicted: dict[int, Segmentation] = {}
    if segment is not None and chosen:
        found = segment([samples[i].image for i in chosen])
        predicted = dict(zip(chosen, found, strict=True))
    for i, sample in enumerate(samples):
        rng = rngs[i] if rngs else None
        before = len(targets)
        seen = _seen_by_side(sample, predicted.get(i), config.augment.united if judged else 0.0, rng)
        for side in (LEFT, RIGHT):
            target = pose_target(
                sample,
                side,
                size,
                config.crop,
                photometric=config.augment.photometric,
                masks=config.augment.masks,
                predicted=seen[side],
                rng=rng,
            )
            if target is not None and judged and rng is not None and rng.random() < config.augment.mirrored:
                target = mirrored_hand(target)
            if target is not None:
                targets.append(target)
        if judged:
            targets += _false_hands(sample, others.get(i), seen, config, rng)
        new = len(targets) - before
        lots += rng.random(new).tolist() if rng is not None else [0.0] * new

    def stacked(name: str, *shape: int, kind: type = np.float32) -> Tensor:
        return torch.from_numpy(np.array([getattr(t, name) for t in targets], kind).reshape(len(targets), *shape))

    return {
        "image": stacked("image", size, size, 3, kind=np.uint8),
        "joints_px": stacked("joints_px", N_JOINTS, 2),
        "weight": stacked("weight", N_JOINTS),
        "canonical": stacked("canonical", N_JOINTS, 3),
        "canonical_weight": stacked("canonical_weight", N_JOINTS),
        "rays_from_crop": stacked("rays_from_crop", 3, 3),
        "image_from_crop": stacked("image_from_crop", 3, 3),
        "distance": stacked("distance"),
        "side": stacked("side", kind=np.int64),
        "hand": stacked("hand"),
        "lot": torch.tensor(lots, dtype=torch.float32),
    }


def _seen_by_side(
    sample: HandSample, found: Segmentation | None, united: float, rng: np.random.Generator | None
) -> tuple[Segmentation | None, Segmentation | None]:
    """What HandSegNet says of either hand; in the share `united` of single hands that it took for both, that both of
    its candidates are that one hand, which is how the estimator asks the judge whose it is."""
    doubted = found is not None and sum(sample.present) == 1 and box_iou(*found.boxes_px) > ONE_HAND_IOU
    if found is None or not doubted or rng is None or rng.random() >= united:
        return found, found
    left, right = (as_one_hand(found.classes, found.boxes_px, side) for side in (LEFT, RIGHT))
    return Segmentation(left[0], np.tile(left[1], (2, 1))), Segmentation(right[0], np.tile(right[1], (2, 1)))


def _false_hands(
    sample: HandSample,
    other: HandSample | None,
    seen: Sequence[Segmentation | None],
    config: TrainConfig,
    rng: np.random.Generator | None,
) -> list[PoseTarget]:
    """Crops where no such hand is: what HandSegNet invented or took for the other hand, and the outlines of another
    picture's hands."""
    found: list[tuple[int, np.ndarray, np.ndarray]] = []
    for side, answer in enumerate(seen):
        if answer is None or not np.isfinite(answer.boxes_px[side]).all():
            continue
        if not sample.present[side] or shows_other_hand(sample, side, answer):
            found.append((side, answer.classes, answer.boxes_px[side]))
    if other is not None and other.labels is not None:
        size_px = sample.image.shape[1::-1]
        classes = cv2.resize(hand_classes(other.labels), size_px, interpolation=cv2.INTER_NEAREST)
        scale = np.tile(np.divide(size_px, other.labels.shape[::-1]), 2)
        boxes = [(side, hand_box(other, side)) for side in (LEFT, RIGHT)]
        found += [(side, classes, box * scale) for side, box in boxes if box is not None]
    size, photometric = config.networks.pose_net_2d.crop_size, config.augment.photometric
    return [
        false_hand(sample.image, classes, box, sample.camera, side, size, config.crop, photometric=photometric, rng=rng)
        for side, classes, box in found
    ]


class BatchBuilder:
    """Builds the batch that the configured stage needs; cheap to send to another process."""

    def __init__(self, config: TrainConfig, open_segmentation: OpenSegmentation) -> None:
        self.config, self.open_segmentation = config, open_segmentation

    @cached_property
    def segmenter(self) -> Segment | None:
        """One per process, loaded when first needed."""
        checkpoint = self.config.data.segmentation
        return self.open_segmentation(Path(checkpoint)) if checkpoint else None

    def __call__(
        self, samples: Sequence[HandSample], rngs: Rngs, others: Mapping[int, HandSample] = MappingProxyType({})
    ) -> Batch:
        """See `segmentation_batch` and `pose_batch`."""
        if self.config.stage == "hand_seg_net":
            return segmentation_batch(samples, self.config, rngs)
        return pose_batch(samples, self.config, rngs, self.segmenter, others)


class BatchDataset(Dataset[Batch]):
    """Maps a step number to its batch.

    Every epoch is a fresh permutation of the source; the random changes of a picture depend on (seed, epoch, index) and
    on which of its uses it is.

    Args:
        source: the training pictures.
        config: the run.
        rank: this process among `world_size`; each takes its own part of every batch.
        world_size: number of processes that train together.
        open_segmentation: opens `config.data.segmentation`, in every worker.

    Raises:
        InputError: no pictures, or a batch that the processes and the uses of a picture cannot share evenly.
    """

    def __init__(
        self,
        source: SampleSource,
        config: TrainConfig,
        rank: int = 0,
        world_size: int = 1,
        open_segmentation: OpenSegmentation = Segmenter,
    ) -> None:
        if len(source) == 0:
            raise InputError("no training pictures: the source is empty")
        self.source, self.config, self.rank = source, config, rank
        self.share = share_of_batch(config.batch_images, world_size)
        if self.share % config.data.echo:
            raise InputError(f"data.echo {config.data.echo} does not divide a step's {self.share} pictures")
        self._made: OrderedDict[int, HandSample] = OrderedDict()
        self._order: tuple[int, np.ndarray] | None = None
        self._build = BatchBuilder(config, open_segmentation)

    def __len__(self) -> int:
        return self.config.iterations

    def picks(self, step: int) -> list[tuple[int, int]]:
        """(epoch, index into the source) of every picture of a step: those used for the first time, then those for the
        second, and so on."""
        echo = self.config.data.echo
        fresh = self.share // echo
        picks: list[tuple[int, int]] = []
        for use in range(echo):
            met = step + (echo - 1 - use) * ECHO_GAP
            first = met * (self.config.batch_images // echo) + self.rank * fresh
            picks += [self._pick(position) for position in range(first, first + fresh)]
        return picks

    def _pick(self, position: int) -> tuple[int, int]:
        epoch, offset = divmod(position, len(self.source))
        if self._order is None or self._order[0] != epoch:
            rng = np.random.default_rng([self.config.seed, epoch])
            self._order = (epoch, rng.permutation(len(self.source)))
        return epoch, int(self._order[1][offset])

    def __getitem__(self, step: int) -> Batch:
        picks = self.picks(step)
        fresh = self.share // self.config.data.echo
        uses = ([1] if i < fresh else [1, i // fresh] for i in range(self.share))
        rngs = [np.random.default_rng([self.config.seed, *pick, *use]) for pick, use in zip(picks, uses, strict=True)]
        samples = [self._sample(index) for _, index in picks]
        return self._build(samples, rngs, self.others(picks, samples))

    def _sample(self, index: int) -> HandSample:
        """A picture of the source; kept until its last use."""
        if self.config.data.echo == 1:
            return self.source[index]
        if index not in self._made:
            self._made[index] = self.source[index]
            if len(self._made) > self.share * (ECHO_GAP + 1):
                self._made.popitem(last=False)
        return self._made[index]

    def others(self, picks: Sequence[tuple[int, int]], samples: Sequence[HandSample]) -> dict[int, HandSample]:
        """What `pose_batch` lays over pictures without hands, by number; nothing without a judge to learn from it."""
        if self.config.stage == "hand_seg_net" or not self.config.networks.pose_net_2d.judge:
            return {}
        found: dict[int, HandSample] = {}
        for i, (epoch, index) in enumerate(picks):
            if not any(samples[i].present):
                pick = np.random.default_rng([self.config.seed, epoch, index, 2]).integers(len(self.source))
                found[i] = self.source[int(pick)]
        return found
