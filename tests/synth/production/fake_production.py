"""A set whose instances are made without a renderer, to test what becomes of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from twohands.synth.production.produce import Made


@dataclass(frozen=True)
class FakeSet:
    """Instances of two files; those of odd number have a note."""

    count: int
    seed: int = 0
    size: int = 1000

    def __len__(self) -> int:
        return self.count

    def instance_name(self, index: int) -> str:
        return f"{index // 4:04d}/{index % 4:05d}"  # sequences of four

    def identity(self) -> dict[str, object]:
        return {"kind": "fake", "seed": self.seed}

    def made_with(self) -> dict[str, str]:
        return {"fake": "1"}

    def expected_bytes(self) -> int:
        return self.size

    def open(self) -> Callable[[int], Made]:
        return partial(make, self.seed)


def make(seed: int, index: int) -> Made:
    rng = np.random.default_rng([seed, index])
    files = {"b.bin": rng.bytes(700 + index), "a.txt": f"{index}\n".encode()}
    return Made(files, ("odd",) if index % 2 else ())
