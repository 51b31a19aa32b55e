"""Which random numbers belong to which set: kinds and splits never draw the same scenes, whatever seed they are given.

A user gives one whole number. What reaches the scenes is a 128-bit number made from it, the kind of set and the split,
by numpy's `SeedSequence`, so that seed 0 of a training cache has nothing in common with seed 0 of a static test set.
"""

from __future__ import annotations

from typing import Final, Literal

import numpy as np

from twohands.errors import InputError

Kind = Literal["static", "dynamic", "frames", "stream"]
Split = Literal["train", "val", "test"]

KINDS: Final[dict[str, int]] = {"static": 0, "dynamic": 1, "frames": 2, "stream": 3}
"""Numbers are written into the seeds: never change one, add new ones at the end."""
SPLITS: Final[dict[str, int]] = {"train": 0, "val": 1, "test": 2}


def stream_seed(seed: int, kind: Kind, split: Split = "train") -> int:
    """The seed that one kind and split of set draws its scenes from.

    Args:
        seed: the user's, 0 or larger.
        kind: kind of set.
        split: part of it.

    Returns:
        A number in [0, 2**128); two triples of arguments share one with probability 2**-128.

    Raises:
        InputError: the seed is negative, or the kind or split unknown.
    """
    if seed < 0:
        raise InputError(f"seed must be 0 or a larger whole number, got {seed}")
    if kind not in KINDS or split not in SPLITS:
        raise InputError(f"expected a kind of {', '.join(KINDS)} and a split of {', '.join(SPLITS)}: {kind}, {split}")
    words = np.random.SeedSequence(entropy=seed, spawn_key=(KINDS[kind], SPLITS[split])).generate_state(4, np.uint32)
    return sum(int(word) << (32 * place) for place, word in enumerate(words))
