"""Which random numbers belong to which set: kinds and splits never draw the same scenes, whatever seed they are given.

A user gives one whole number. What reaches the scenes is a 128-bit number made from it, the kind of set and the split,
by numpy's `SeedSequence`, so that seed 0 of a training cache has nothing in common with seed 0 of a static test set.

Within a set, every part of an instance or a sequence has random numbers of its own: all their keys stand here.
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


InstancePart = Literal["scene", "background", "variant", "light", "sensor", "clips", "fabric", "kind", "people"]
SequencePart = Literal["motion", "look", "things", "clip", "camera", "noise", "fabric", "kind", "people"]

INSTANCE_PARTS: Final[dict[str, int]] = {
    "scene": 0,
    "background": 1 << 40,
    "variant": 1 << 41,
    "light": 1 << 42,
    "sensor": 1 << 43,
    "clips": 1 << 44,
    "fabric": 1 << 48,
    "kind": 1 << 49,
    "people": 1 << 50,
}
"""What is added to an instance's index, for every part of it; like KINDS, never change one. "variant" counts the
variants of cached frames; "clips", with index 0, is for the order of a dynamic set's backgrounds; "kind"
decides whether a scene is one of whole people, which "people" then draws."""
SEQUENCE_PARTS: Final[dict[str, int]] = {
    "motion": 1 << 42,
    "look": 1 << 43,
    "things": 1 << 44,
    "clip": 1 << 45,
    "camera": 1 << 46,
    "noise": 1 << 47,
    "fabric": 1 << 48,
    "kind": 1 << 49,
    "people": 1 << 50,
}
"""The same for a sequence, to which its frame is added; the index is a second number of the key."""


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


def instance_rng(seed: int, index: int, part: InstancePart = "scene") -> np.random.Generator:
    """The generator that owns one part of instance `index` of the set with this seed, whatever the number of workers.

    Args:
        seed: of the set, see `stream_seed`.
        index: of the instance, 0 <= index < 2**40.
        part: of it.
    """
    return np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=(INSTANCE_PARTS[part] + index,)))


def sequence_rng(seed: int, index: int, part: SequencePart, frame: int = 0) -> np.random.Generator:
    """The generator that owns one part of sequence `index`, or of one of its frames.

    Args:
        seed: of the set, see `stream_seed`.
        index: of the sequence, 0 or larger.
        part: of it.
        frame: 0 for what stays the same in all frames.
    """
    key = (SEQUENCE_PARTS[part] + frame, index)
    return np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=key))
