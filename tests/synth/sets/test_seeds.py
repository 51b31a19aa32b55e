"""All keys of random numbers: apart from each other, and for ever the same."""

from __future__ import annotations

import numpy as np
import pytest

from twohands.errors import InputError
from twohands.synth.sets.seeds import (
    INSTANCE_PARTS,
    KINDS,
    SEQUENCE_PARTS,
    SPLITS,
    instance_rng,
    sequence_rng,
    stream_seed,
)


def test_kinds_splits_and_seeds_share_nothing():
    seeds = {stream_seed(seed, kind, split) for seed in range(50) for kind in KINDS for split in SPLITS}
    assert len(seeds) == 50 * 4 * 3
    assert all(0 <= seed < 2**128 for seed in seeds)
    assert stream_seed(7, "frames") == stream_seed(7, "frames", "train")
    with pytest.raises(InputError, match="seed must be 0 or"):
        stream_seed(-1, "static")


@pytest.mark.parametrize("parts", [INSTANCE_PARTS, SEQUENCE_PARTS])
def test_parts_leave_room_between_each_other(parts: dict[str, int]) -> None:
    """No index below 2**40 of one part is an index of another."""
    assert np.diff(sorted(parts.values())).min() >= 1 << 40


def test_keys_are_those_of_the_sets_made_so_far() -> None:
    def draw(*key: int) -> float:
        return np.random.default_rng(np.random.SeedSequence(entropy=9, spawn_key=key)).random()

    assert instance_rng(9, 5).random() == draw(5)
    assert instance_rng(9, 5, "light").random() == draw((1 << 42) + 5)
    assert sequence_rng(9, 5, "motion").random() == draw(1 << 42, 5)
    assert sequence_rng(9, 5, "noise", 3).random() == draw((1 << 47) + 3, 5)
