"""Batches made ahead of their use, by worker processes."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from typing import Any

import cv2
import torch
from torch.utils.data import DataLoader, Dataset, Sampler

from twohands.errors import TwoHandsError
from twohands.training.batches import Batch, BatchBuilder, BatchDataset, SampleSource
from twohands.training.config import TrainConfig
from twohands.training.segmenter import OpenSegmentation, Segmenter

WORKER_NICENESS = 19


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
