"""Batches as a pure function of (source, config, step): same numbers whatever the worker count, and after a resume."""

from __future__ import annotations

import signal
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from twohands.datasets.targets import PoseTarget, pose_target, segmentation_target
from twohands.errors import InputError
from twohands.skeleton import LEFT, RIGHT
from twohands.training.config import TrainConfig
from twohands.types import HandSample

Batch = dict[str, Tensor]
Rngs = Sequence[np.random.Generator]


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


def pose_batch(samples: Sequence[HandSample], config: TrainConfig, rngs: Rngs) -> Batch:
    """Crops for PoseNet2D and PoseNet3D: every usable hand of the pictures.

    Args:
        samples: labelled pictures.
        config: the run.
        rngs: one generator per sample for random changes, or none at all for plain crops.

    Returns:
        The fields of `PoseTarget`, stacked over N hands; N may be 0.
    """
    size = config.networks.pose_net_2d.crop_size
    targets: list[PoseTarget] = []
    for i, sample in enumerate(samples):
        for side in (LEFT, RIGHT):
            target = pose_target(
                sample,
                side,
                size,
                config.crop,
                photometric=config.augment.photometric,
                masks=config.augment.masks,
                rng=rngs[i] if rngs else None,
            )
            if target is not None:
                targets.append(target)
    if not targets:
        return {}
    arrays = ("image", "joints_px", "weight", "canonical", "canonical_weight", "rays_from_crop", "image_from_crop")
    batch = {name: torch.from_numpy(np.stack([getattr(t, name) for t in targets])) for name in arrays}
    batch["distance"] = torch.tensor([t.distance for t in targets], dtype=torch.float32)
    batch["side"] = torch.tensor([t.side for t in targets])
    return batch


def build_batch(samples: Sequence[HandSample], config: TrainConfig, rngs: Rngs) -> Batch:
    """The batch that the configured stage needs."""
    return (segmentation_batch if config.stage == "hand_seg_net" else pose_batch)(samples, config, rngs)


class BatchDataset(Dataset[Batch]):
    """Maps a step number to its batch.

    Every epoch is a fresh permutation of the source; the random changes of a picture depend on (seed, epoch, index).

    Args:
        source: the training pictures.
        config: the run.
        rank: this process among `world_size`; each takes its own pictures.
        world_size: number of processes that train together.
    """

    def __init__(self, source: SampleSource, config: TrainConfig, rank: int = 0, world_size: int = 1) -> None:
        if len(source) == 0:
            raise InputError("no training pictures: the source is empty")
        self.source, self.config, self.rank, self.world_size = source, config, rank, world_size
        self._order: tuple[int, np.ndarray] | None = None

    def __len__(self) -> int:
        return self.config.iterations

    def picks(self, step: int) -> list[tuple[int, int]]:
        """(epoch, index into the source) of every picture of a step."""
        first = (step * self.world_size + self.rank) * self.config.batch_images
        return [self._pick(position) for position in range(first, first + self.config.batch_images)]

    def _pick(self, position: int) -> tuple[int, int]:
        epoch, offset = divmod(position, len(self.source))
        if self._order is None or self._order[0] != epoch:
            rng = np.random.default_rng([self.config.seed, epoch])
            self._order = (epoch, rng.permutation(len(self.source)))
        return epoch, int(self._order[1][offset])

    def __getitem__(self, step: int) -> Batch:
        picks = self.picks(step)
        rngs = [np.random.default_rng([self.config.seed, epoch, index, 1]) for epoch, index in picks]
        return build_batch([self.source[index] for _, index in picks], self.config, rngs)


class StepsFrom(Sampler[int]):
    """The step numbers start, start + 1, ..., stop - 1."""

    def __init__(self, start: int, stop: int) -> None:
        self.steps = range(start, stop)

    def __iter__(self) -> Iterator[int]:
        return iter(self.steps)

    def __len__(self) -> int:
        return len(self.steps)


def batch_loader(dataset: BatchDataset, start: int) -> DataLoader[Batch]:
    """Loads the batches of the steps from `start` on, in order, ahead of their use."""
    workers = dataset.config.data.workers
    return DataLoader(
        dataset,
        batch_size=None,
        sampler=StepsFrom(start, len(dataset)),
        num_workers=workers,
        prefetch_factor=4 if workers else None,
        worker_init_fn=_calm_worker,
        collate_fn=_unchanged,
    )


def validation_batches(source: SampleSource, config: TrainConfig) -> list[Batch]:
    """All held-out pictures, unchanged, in order; kept in memory because they are used again and again."""
    size = max(config.batch_images, 16)
    starts = range(0, len(source), size)
    batches = (
        build_batch([source[i] for i in range(start, min(start + size, len(source)))], config, ()) for start in starts
    )
    return [batch for batch in batches if batch]


def _calm_worker(_: int) -> None:
    """Leave the cores and the keyboard to the training process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(0)
    torch.set_num_threads(1)


def _unchanged(batch: Any) -> Any:
    return batch
