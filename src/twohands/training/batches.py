"""Batches as a pure function of (source, config, step): same numbers whatever the worker count, and after a resume."""

from __future__ import annotations

import bisect
import itertools
import os
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol, cast

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from twohands.datasets.hand_views import cut_at_border, hand_box
from twohands.datasets.pose_targets import (
    PoseTarget,
    Segmentation,
    false_hand,
    mirrored_hand,
    pose_target,
    shows_other_hand,
)
from twohands.datasets.segmentation_targets import segmentation_target
from twohands.errors import InputError, TwoHandsError
from twohands.geometry.boxes import box_iou
from twohands.geometry.part_labels import hand_classes
from twohands.geometry.segmentation import (
    as_one_hand,
    boxes_from_energy,
    hand_scores,
    letterbox,
    masks_from_logits,
    network_input,
)
from twohands.models.blocks import fold_batch_norm
from twohands.models.checkpoint import load_network
from twohands.models.hand_seg_net import HandSegNetConfig
from twohands.skeleton import LEFT, N_JOINTS, RIGHT
from twohands.training.config import TrainConfig
from twohands.training.parallel import share_of_batch
from twohands.types import HandSample

Batch = dict[str, Tensor]
Rngs = Sequence[np.random.Generator]
Segment = Callable[[Sequence[np.ndarray]], list[Segmentation]]
"""Masks and boxes of pictures, each (H, W, 3) uint8."""
OpenSegmentation = Callable[[Path], Segment]
"""What finds masks and boxes, from a file of HandSegNet."""
WORKER_NICENESS = 19
FAINT_THRESHOLD = 0.05
"""HandSegNet's score from which on the pose networks learn from its boxes and masks. In use, only higher scores come
before them; but mistakes with such scores are too rare for the judge to learn from, and shown faint mistakes alone, it
takes every faint hand for one."""
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
    samples = with_border(samples, augment.cut, rngs)
    targets = [
        segmentation_target(
            sample,
            net.height,
            net.width_px,
            photometric=augment.photometric,
            zoom=augment.zoom,
            rng=rngs[i] if rngs else None,
        )
        for i, sample in enumerate(samples)
    ]
    names = ("image", "classes", "boxes_px", "present")
    return {name: torch.from_numpy(np.stack([getattr(t, name) for t in targets])) for name in names}


def with_border(samples: Sequence[HandSample], share: float, rngs: Rngs) -> Sequence[HandSample]:
    """The pictures, a share of them cut so that a hand is leaving them (`AugmentConfig.cut`)."""
    if not (rngs and share):
        return samples
    return [cut_at_border(one, rng) if rng.random() < share else one for one, rng in zip(samples, rngs, strict=True)]


class Segmenter:
    """A trained HandSegNet, as the pose stages will meet it but for its second look in doubt: the network and how its
    maps are read.

    Args:
        checkpoint: written by the trainer, or the ONNX file of a preset.
        device: where it runs.

    Raises:
        CheckpointError: missing, damaged, or of another network.
    """

    def __init__(self, checkpoint: Path, device: str = "cpu") -> None:
        net = load_network("hand_seg_net", checkpoint).eval()
        config = cast(HandSegNetConfig, net.config)
        self.size = (config.height, config.width_px)
        fold_batch_norm(net)
        self.net = net.to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.device = device

    @torch.inference_mode()
    def __call__(self, images: Sequence[np.ndarray]) -> list[Segmentation]:
        """Masks and boxes, see `Segment`."""
        canvases, places = zip(*(letterbox(image, self.size) for image in images), strict=True)
        inputs = torch.from_numpy(network_input(np.stack(canvases))).contiguous(memory_format=torch.channels_last)
        with torch.autocast(self.device, torch.bfloat16):
            logits, energies = self.net(inputs.to(self.device))
        # Back to one plane after the other: reductions over planes of interleaved channels are slow.
        logits, energies = (
            np.ascontiguousarray(m.float().cpu().numpy()) for m in (logits, torch.sigmoid(energies.float()))
        )
        found = []
        for i, image in enumerate(images):
            seg_logits, energy = places[i].content(logits[i]), places[i].content(energies[i])
            scores = hand_scores(energy, seg_logits)
            found.append(segmentation_of(seg_logits, energy, scores, image.shape[:2]))
        return found


def segmentation_of(
    seg_logits: np.ndarray, energies: np.ndarray, scores: np.ndarray, image_size: tuple[int, int]
) -> Segmentation:
    """What HandSegNet's maps say, hands that are seen but faintly (`FAINT_THRESHOLD`) included.

    Args:
        seg_logits, energies, scores: (3, h, w), (2, h, w) and (2,) as `inference.estimator` has them.
        image_size: (H, W) of the picture.
    """
    boxes = boxes_from_energy(energies, image_size, scores, threshold=FAINT_THRESHOLD)
    return Segmentation(masks_from_logits(seg_logits, image_size, boxes.present), boxes.boxes_px)


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
    samples = with_border(samples, config.augment.cut, rngs)
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

    Every epoch is a fresh permutation of the source; the random changes of a picture depend on (seed, epoch, index).

    Args:
        source: the training pictures.
        config: the run.
        rank: this process among `world_size`; each takes its own part of every batch.
        world_size: number of processes that train together.
        open_segmentation: opens `config.data.segmentation`, in every worker.

    Raises:
        InputError: no pictures, or a batch that the processes cannot share evenly.
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
        self._order: tuple[int, np.ndarray] | None = None
        self._build = BatchBuilder(config, open_segmentation)

    def __len__(self) -> int:
        return self.config.iterations

    def picks(self, step: int) -> list[tuple[int, int]]:
        """(epoch, index into the source) of every picture of a step."""
        first = step * self.config.batch_images + self.rank * self.share
        return [self._pick(position) for position in range(first, first + self.share)]

    def _pick(self, position: int) -> tuple[int, int]:
        epoch, offset = divmod(position, len(self.source))
        if self._order is None or self._order[0] != epoch:
            rng = np.random.default_rng([self.config.seed, epoch])
            self._order = (epoch, rng.permutation(len(self.source)))
        return epoch, int(self._order[1][offset])

    def __getitem__(self, step: int) -> Batch:
        picks = self.picks(step)
        rngs = [np.random.default_rng([self.config.seed, epoch, index, 1]) for epoch, index in picks]
        samples = [self.source[index] for _, index in picks]
        return self._build(samples, rngs, self.others(picks, samples))

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


class TimedBatches(Dataset[tuple[float, Batch | TwoHandsError]]):
    """Batches, each with the seconds that it took to make; in place of one that cannot be made, what is wrong."""

    def __init__(self, dataset: Dataset[Batch]) -> None:
        self.dataset = dataset

    def __getitem__(self, step: int) -> tuple[float, Batch | TwoHandsError]:
        start = time.perf_counter()
        try:
            batch: Batch | TwoHandsError = self.dataset[step]
        except TwoHandsError as error:  # raised in a worker, it would come out as that worker's traceback
            batch = error
        return time.perf_counter() - start, batch


class StepsFrom(Sampler[int]):
    """The step numbers start, start + 1, ..., stop - 1."""

    def __init__(self, start: int, stop: int) -> None:
        self.steps = range(start, stop)

    def __iter__(self) -> Iterator[int]:
        return iter(self.steps)

    def __len__(self) -> int:
        return len(self.steps)


def batch_loader(dataset: BatchDataset, start: int) -> DataLoader[tuple[float, Batch | TwoHandsError]]:
    """Loads the batches of the steps from `start` on, in order, ahead of their use, as `TimedBatches` does."""
    return _loader(dataset, StepsFrom(start, len(dataset)), dataset.config.data.workers)


class HeldOutBatches(Dataset[Batch]):
    """Maps a number to a batch of held-out pictures, unchanged, in order."""

    def __init__(
        self, source: SampleSource, config: TrainConfig, open_segmentation: OpenSegmentation = Segmenter
    ) -> None:
        self.source, self.size = source, max(config.batch_images, 16)
        self.build = BatchBuilder(config, open_segmentation)

    def __len__(self) -> int:
        return -(-len(self.source) // self.size)

    def __getitem__(self, number: int) -> Batch:
        start = number * self.size
        return self.build([self.source[i] for i in range(start, min(start + self.size, len(self.source)))], ())


def validation_batches(
    source: SampleSource, config: TrainConfig, open_segmentation: OpenSegmentation = Segmenter
) -> list[Batch]:
    """All held-out pictures, unchanged, in order; kept in memory because they are used again and again.

    A worker makes them if there are to be any: renderer and OpenVINO do not survive a fork, so this process, from which
    the workers of the training are forked, must not open them.

    Raises:
        TwoHandsError: a picture cannot be used.
    """
    dataset = HeldOutBatches(source, config, open_segmentation)
    kept = []
    for _, batch in _loader(dataset, StepsFrom(0, len(dataset)), min(1, config.data.workers)):
        if isinstance(batch, TwoHandsError):
            raise batch
        if len(batch["image"]):
            kept.append({name: values.clone() for name, values in batch.items()})  # the worker's memory goes back
    return kept


def _loader(dataset: Dataset[Batch], steps: StepsFrom, workers: int) -> DataLoader[tuple[float, Batch | TwoHandsError]]:
    return DataLoader(
        TimedBatches(dataset),
        batch_size=None,
        sampler=steps,
        num_workers=workers,
        prefetch_factor=4 if workers else None,
        worker_init_fn=calm_worker,
        collate_fn=_unchanged,
    )


def calm_worker(_: int) -> None:
    """Leave requests to end and, where there are too few for all, the cores to the training process: it finishes its
    step and ends its workers, and its threads wait for each other, so that one that has to share its core holds up all
    of them."""
    if hasattr(os, "nice"):
        os.nice(WORKER_NICENESS)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    cv2.setNumThreads(0)
    torch.set_num_threads(1)


def _unchanged(batch: Any) -> Any:
    return batch
