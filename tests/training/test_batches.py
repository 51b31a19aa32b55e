"""Batches are a pure function of (source, config, step)."""

import dataclasses

import numpy as np
import pytest
import torch
from tests.builders import make_sample, make_samples
from tests.training.tiny import tiny_run

from twohands.errors import InputError
from twohands.training.batches import BatchDataset, IndexRange, batch_loader, validation_batches
from twohands.training.sources import split

SAMPLES = make_samples(5)


def equal(a: dict, b: dict) -> bool:
    return a.keys() == b.keys() and all(torch.equal(a[name], b[name]) for name in a)


def test_every_picture_comes_once_per_epoch_in_a_new_order():
    data = BatchDataset(make_samples(1) * 6, tiny_run("pose_net_2d", batch_images=4))
    picks = [pick for step in range(6) for pick in data.picks(step)]  # 24 positions, 4 epochs
    orders = [[index for epoch, index in picks if epoch == e] for e in range(4)]
    assert [sorted(order) for order in orders] == [list(range(6))] * 4
    assert len({tuple(order) for order in orders}) > 1
    assert data.picks(1) == BatchDataset(data.source, data.config).picks(1)  # without having seen step 0


def test_processes_share_the_pictures():
    config = tiny_run("pose_net_2d", batch_images=2)
    parts = [BatchDataset(SAMPLES * 4, config, rank, 2).picks(0) for rank in (0, 1)]
    alone = BatchDataset(SAMPLES * 4, dataclasses.replace(config, batch_images=4)).picks(0)
    assert parts[0] + parts[1] == alone


def test_random_changes_differ_between_epochs_and_seeds():
    def first_image(seed: int, step: int) -> torch.Tensor:
        return BatchDataset(SAMPLES[:1], tiny_run("hand_seg_net", batch_images=1, seed=seed))[step]["image"]

    assert torch.equal(first_image(0, 0), first_image(0, 0))
    assert not torch.equal(first_image(0, 0), first_image(0, 1))
    assert not torch.equal(first_image(0, 0), first_image(1, 0))


@pytest.mark.parametrize("stage", ["hand_seg_net", "pose_net_2d"])
def test_workers_change_nothing(stage):
    config = tiny_run(stage, iterations=5)
    alone = list(batch_loader(BatchDataset(SAMPLES, config), 2))
    config = dataclasses.replace(config, data=dataclasses.replace(config.data, workers=2))
    helped = list(batch_loader(BatchDataset(SAMPLES, config), 2))
    assert len(alone) == len(helped) == 3
    assert all(equal(a, b) for a, b in zip(alone, helped, strict=True))


def test_every_usable_hand_is_a_crop():
    config = tiny_run("pose_net_2d", batch_images=2)
    one = make_sample(np.random.default_rng(0), present=(False, True))
    none = make_sample(np.random.default_rng(0), present=(False, False))
    assert BatchDataset([one, one], config)[0]["side"].tolist() == [1, 1]
    assert BatchDataset([none, none], config)[0] == {}


def test_validation_is_plain_and_whole():
    batches = validation_batches(SAMPLES, tiny_run("pose_net_2d"))
    assert sum(len(batch["image"]) for batch in batches) == 10
    again = validation_batches(SAMPLES, tiny_run("pose_net_2d", seed=7))
    assert all(equal(a, b) for a, b in zip(batches, again, strict=True))


def test_split_and_ranges():
    train, held_out = split(SAMPLES * 8, 256)
    assert (len(train), len(held_out)) == (36, 4)
    assert held_out[0] is (SAMPLES * 8)[36]
    assert len(split(SAMPLES * 8, 2)[1]) == 2
    with pytest.raises(IndexError):
        IndexRange(SAMPLES, 1, 3)[2]


def test_an_empty_source_is_refused():
    with pytest.raises(InputError, match="no training pictures"):
        BatchDataset([], tiny_run("pose_net_2d"))
