"""Reads a data set in a thread of its own while the samples before are worked on."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Final

from twohands.datasets.base import HandDataset
from twohands.types import HandSample

AHEAD: Final = 4
"""Samples that wait in memory; a picture of 960x540 with part labels takes 2 MB."""


def read_ahead(dataset: HandDataset, count: int) -> Iterator[HandSample]:
    """The first samples of a data set, in order.

    Args:
        dataset: is only read from one thread at a time.
        count: how many.

    Raises:
        DataFormatError: as the data set, when its turn has come.
    """
    with ThreadPoolExecutor(1) as pool:
        waiting: deque[Future[HandSample]] = deque()
        try:
            for index in range(count):
                waiting.append(pool.submit(dataset.__getitem__, index))
                if len(waiting) > AHEAD:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for sample in waiting:
                sample.cancel()
