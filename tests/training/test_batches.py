"""Batches are a pure function of (source, config, step)."""

import dataclasses
import multiprocessing
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.builders import make_sample, make_samples
from tests.training.drawn import with_arm
from tests.training.tiny import NETWORKS, tiny_run

from twohands.errors import InputError
from twohands.geometry.part_labels import hand_classes
from twohands.geometry.segmentation import UNCERTAIN, certain_masks
from twohands.models.checkpoint import save_network
from twohands.models.presets import build_network
from twohands.training.batches import ECHO_GAP, BatchDataset, IndexRange, Joined, pose_batch, segmentation_batch
from twohands.training.config import AugmentConfig, DataConfig
from twohands.training.hand_views import cut_at_border, hand_box, part_without_hands
from twohands.training.loading import batch_loader, validation_batches
from twohands.training.pose_targets import Segmentation, crop_matrix, false_hand, shows_other_hand
from twohands.training.segmenter import Segmenter, segmentation_of
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
    config = tiny_run("pose_net_2d", batch_images=6)
    alone = BatchDataset(SAMPLES, config)
    for step in range(4):
        for world_size in (2, 3):
            parts = [BatchDataset(SAMPLES, config, rank, world_size) for rank in range(world_size)]
            assert [pick for part in parts for pick in part.picks(step)] == alone.picks(step)
        batches = [BatchDataset(SAMPLES, config, rank, 2)[step] for rank in range(2)]
        whole = alone[step]
        assert all(torch.equal(torch.cat([part[name] for part in batches]), whole[name]) for name in whole)
    with pytest.raises(InputError, match="batch of 6 pictures cannot be shared evenly by 4 processes"):
        BatchDataset(SAMPLES, config, 0, 4)


class Counted:
    """A source that knows how often each of its pictures was made."""

    def __init__(self, count: int) -> None:
        self.pictures, self.made = make_samples(1) * count, [0] * count

    def __len__(self) -> int:
        return len(self.pictures)

    def __getitem__(self, index: int):
        self.made[index] += 1
        return self.pictures[index]


def test_an_echoed_picture_is_made_once_and_shown_twice_with_other_changes():
    source, config = Counted(200), tiny_run("hand_seg_net", batch_images=4, data=DataConfig(echo=2))
    data = BatchDataset(source, config)
    batches = [data[step] for step in range(30)]
    picks = [data.picks(step) for step in range(30)]
    assert [pick[2:] for pick in picks[ECHO_GAP:]] == [pick[:2] for pick in picks[:-ECHO_GAP]]
    assert max(source.made) == 1
    assert not torch.equal(batches[0]["image"][0], batches[ECHO_GAP]["image"][2])
    alone = BatchDataset(source, config)  # a resumed run has kept nothing
    assert equal(alone[17], batches[17])


def test_uses_of_a_picture_must_divide_a_step():
    with pytest.raises(InputError, match="echo 3 does not divide a step's 4 pictures"):
        BatchDataset(SAMPLES, tiny_run("hand_seg_net", batch_images=4, data=DataConfig(echo=3)))
    with pytest.raises(InputError, match="echo must be at least 1, got 0"):
        DataConfig(echo=0)


@pytest.mark.parametrize(("stage", "make"), [("hand_seg_net", segmentation_batch), ("pose_net_2d", pose_batch)])
def test_hands_leave_the_pictures_of_every_stage(stage, make):
    def generators() -> list[np.random.Generator]:
        return [np.random.default_rng(seed) for seed in range(len(SAMPLES))]

    plain = tiny_run(stage, augment=AugmentConfig(cut=0.0))
    rngs = generators()
    for rng in rngs:
        rng.random()  # which says whether to cut
    cut = [cut_at_border(sample, rng) for sample, rng in zip(SAMPLES, rngs, strict=True)]
    assert any(one.image.shape != sample.image.shape for one, sample in zip(cut, SAMPLES, strict=True))
    always = dataclasses.replace(plain, augment=AugmentConfig(cut=1.0))
    assert equal(make(SAMPLES, always, generators()), make(cut, plain, rngs))
    assert equal(make(SAMPLES, always, ()), make(SAMPLES, plain, ()))


@pytest.mark.parametrize(("stage", "make"), [("hand_seg_net", segmentation_batch), ("pose_net_2d", pose_batch)])
def test_parts_without_hands_are_pictures_of_every_stage(stage, make):
    armed = [with_arm(sample) for sample in make_samples(12, present=(True, False))]

    def generators() -> list[np.random.Generator]:
        return [np.random.default_rng(seed) for seed in range(len(armed))]

    plain, rngs = tiny_run(stage, augment=AugmentConfig()), generators()
    for rng in rngs:
        rng.random()  # which says whether to take a part
    parts = [part_without_hands(sample, rng) for sample, rng in zip(armed, rngs, strict=True)]
    assert any(part is not sample for part, sample in zip(parts, armed, strict=True))
    always = dataclasses.replace(plain, augment=AugmentConfig(handless=1.0))
    assert equal(make(armed, always, generators()), make(parts, plain, rngs))
    assert equal(make(armed, always, ()), make(armed, plain, ()))


def test_random_changes_differ_between_epochs_and_seeds():
    def first_image(seed: int, step: int) -> torch.Tensor:
        return BatchDataset(SAMPLES[:1], tiny_run("hand_seg_net", batch_images=1, seed=seed))[step]["image"]

    assert torch.equal(first_image(0, 0), first_image(0, 0))
    assert not torch.equal(first_image(0, 0), first_image(0, 1))
    assert not torch.equal(first_image(0, 0), first_image(1, 0))


@pytest.mark.parametrize("stage", ["hand_seg_net", "pose_net_2d"])
def test_workers_change_nothing(stage):
    config = tiny_run(stage, iterations=5)
    alone = [batch for _, batch in batch_loader(BatchDataset(SAMPLES, config), 2)]
    config = dataclasses.replace(config, data=dataclasses.replace(config.data, workers=2))
    helped = [batch for _, batch in batch_loader(BatchDataset(SAMPLES, config), 2)]
    assert len(alone) == len(helped) == 3
    assert all(equal(a, b) for a, b in zip(alone, helped, strict=True))


def test_every_usable_hand_is_a_crop():
    config = tiny_run("pose_net_2d", batch_images=2)
    one = make_sample(np.random.default_rng(0), present=(False, True))
    none = make_sample(np.random.default_rng(0), present=(False, False))
    assert BatchDataset([one, one], config)[0]["side"].tolist() == [1, 1]
    nobody = BatchDataset([none, none], config)[0]
    shapes = {name: values.shape[1:] for name, values in BatchDataset(SAMPLES, config)[0].items()}
    assert {name: values.shape[1:] for name, values in nobody.items()} == shapes
    assert {len(values) for values in nobody.values()} == {0}


def judging(config, **augment):
    """Without other random changes than these."""
    return dataclasses.replace(config, augment=AugmentConfig(**augment))


def test_mirrored_crops_are_no_hands_of_their_side():
    config = judging(tiny_run("pose_net_2d"), mirrored=1.0, predicted=0.0)
    centred = dataclasses.replace(config.crop, shift=0.0, smallest=1.0, largest=1.0, roll=0.0)
    config = dataclasses.replace(config, crop=centred)
    mirrored = pose_batch(SAMPLES, config, [np.random.default_rng(i) for i in range(len(SAMPLES))])
    plain = pose_batch(SAMPLES, config, ())  # as for validation
    assert mirrored["hand"].tolist() == [0.0] * 10 and plain["hand"].tolist() == [1.0] * 10
    assert torch.equal(mirrored["image"], plain["image"].flip(2))
    assert not mirrored["weight"].any() and not mirrored["canonical_weight"].any()


def test_what_a_segmentation_invents_is_no_hand():
    sample = make_sample(np.random.default_rng(0), present=(True, False))
    box = hand_box(sample, 0)
    invented = Segmentation(hand_classes(sample.labels), np.stack([box, box + 5]))
    batch = pose_batch([sample], tiny_run("pose_net_2d"), (), lambda images: [invented])
    assert batch["side"].tolist() == [0, 1] and batch["hand"].tolist() == [1.0, 0.0]
    size, crop = batch["image"].shape[1], tiny_run("pose_net_2d").crop
    expected = crop_matrix(box + 5, sample.camera, 1, size, crop)
    np.testing.assert_allclose(batch["image_from_crop"][1], expected, rtol=1e-5)


def test_pictures_without_hands_show_another_ones_outlines():
    """Whatever the process that makes the batch, and in the place of the other picture's hands."""
    nobody = make_sample(np.random.default_rng(1), present=(False, False))
    source = [nobody, *SAMPLES]
    config = judging(tiny_run("pose_net_2d", batch_images=6), predicted=0.0)
    config = dataclasses.replace(config, crop=dataclasses.replace(config.crop, roll=0.0))
    batch = BatchDataset(source, config)[0]
    assert batch["hand"].sum() == 10 and len(batch["hand"]) in (10, 12)  # the lot may fall on itself
    shares = [BatchDataset(source, config, rank, 2)[0] for rank in range(2)]
    assert all(torch.equal(torch.cat([share[name] for share in shares]), batch[name]) for name in batch)
    alone = pose_batch([nobody], config, [np.random.default_rng(0)], None, {0: SAMPLES[0]})
    assert alone["hand"].tolist() == [0.0, 0.0] and alone["side"].tolist() == [0, 1]
    box = hand_box(SAMPLES[0], 1)
    expected = crop_matrix(box, nobody.camera, 1, alone["image"].shape[1], config.crop)
    np.testing.assert_allclose(alone["image_from_crop"][1], expected, rtol=1e-5)


def test_outlines_of_a_picture_of_another_size_are_scaled():
    """Named case: they were left out, half of all where frames of two sizes are mixed."""
    nobody = make_sample(np.random.default_rng(1), present=(False, False))
    height, width = nobody.image.shape[:2]
    large = dataclasses.replace(nobody, image=np.zeros((2 * height, 2 * width, 3), np.uint8), labels=None)
    config = judging(tiny_run("pose_net_2d"), predicted=0.0)
    config = dataclasses.replace(config, crop=dataclasses.replace(config.crop, roll=0.0))
    batch = pose_batch([large], config, [np.random.default_rng(0)], None, {0: SAMPLES[0]})
    size = batch["image"].shape[1]
    assert batch["side"].tolist() == [0, 1] and not batch["hand"].any()
    for side in (0, 1):
        expected = crop_matrix(2 * hand_box(SAMPLES[0], side), large.camera, side, size, config.crop)
        np.testing.assert_allclose(batch["image_from_crop"][side], expected, rtol=1e-5)


def test_crops_without_hands_are_rolled_as_often_as_those_with():
    """Named case: a rolled crop was always a hand, or one mirrored, and the judge could learn to tell by that."""
    config = judging(tiny_run("pose_net_2d"), predicted=0.0)
    nobody = make_sample(np.random.default_rng(1), present=(False, False))
    samples, others = [nobody] * 40, dict.fromkeys(range(40), SAMPLES[0])
    batch = pose_batch(samples, config, [np.random.default_rng(i) for i in range(40)], None, others)
    upright = dataclasses.replace(config, crop=dataclasses.replace(config.crop, roll=0.0))
    plain = pose_batch(samples, upright, [np.random.default_rng(i) for i in range(40)], None, others)
    turned = (batch["image_from_crop"] - plain["image_from_crop"]).abs().amax(dim=(1, 2)) > 1e-3
    assert config.crop.roll > 0 and len(turned) == 80 and 25 < int(turned.sum()) < 55
    assert not batch["hand"].any()


def test_a_rolled_crop_without_a_hand_shows_the_same_middle():
    sample, crop = SAMPLES[0], tiny_run("pose_net_2d").crop
    box, size = hand_box(sample, 0), 64
    centre = np.array([size / 2, size / 2, 1.0])
    for seed in range(20):
        rng = np.random.default_rng(seed)
        target = false_hand(sample.image, hand_classes(sample.labels), box, sample.camera, 0, size, crop, rng=rng)
        u, v, w = target.image_from_crop @ centre
        assert np.linalg.norm([u / w, v / w] - (box[:2] + box[2:]) / 2) < 0.05 * (box[2:] - box[:2]).max()


def test_a_network_without_a_judge_sees_hands_alone():
    config = tiny_run("pose_net_2d")
    networks = dataclasses.replace(NETWORKS, pose_net_2d=dataclasses.replace(NETWORKS.pose_net_2d, judge=False))
    config = judging(dataclasses.replace(config, networks=networks), mirrored=1.0)
    nobody = make_sample(np.random.default_rng(1), present=(False, False))
    batch = pose_batch(
        [SAMPLES[0], nobody], config, [np.random.default_rng(i) for i in range(2)], None, {1: SAMPLES[1]}
    )
    assert batch["hand"].tolist() == [1.0, 1.0]


@pytest.fixture(scope="module")
def segmented_run(tmp_path_factory):
    """A run whose crops come from a HandSegNet (untrained) at every opportunity."""
    checkpoint = tmp_path_factory.mktemp("segmentation") / "hand_seg_net.safetensors"
    torch.manual_seed(0)
    network = build_network("hand_seg_net", NETWORKS.hand_seg_net)
    network.net.head[-1].bias.data += 2.0  # finds something everywhere
    save_network("hand_seg_net", network, checkpoint)
    config = tiny_run("pose_net_2d")
    return dataclasses.replace(
        config,
        data=dataclasses.replace(config.data, segmentation=str(checkpoint)),
        augment=dataclasses.replace(config.augment, predicted=1.0),
    )


def test_a_segmenter_answers_for_every_picture(segmented_run):
    segmenter = Segmenter(Path(segmented_run.data.segmentation))
    found = segmenter([sample.image for sample in SAMPLES])
    assert len(found) == len(SAMPLES)
    for sample, answer in zip(SAMPLES, found, strict=True):
        assert answer.classes.shape == sample.image.shape[:2]
        assert certain_masks(answer.classes).max() <= 2 and answer.classes.max() <= 2 + UNCERTAIN
        assert answer.boxes_px.shape == (2, 4)


def test_hands_seen_but_faintly_are_learnt_from():
    """At a score of 0.1, far too low to be a candidate in use; at 0.01 there is nothing."""
    energies = np.zeros((2, 27, 48), np.float32)
    energies[1, 5:15, 10:20] = 0.1
    seg_logits = np.zeros((3, 27, 48), np.float32)
    seg_logits[2, 5:15, 10:20] = 1.0
    scores = np.array([0.01, 0.1])
    found = segmentation_of(seg_logits, energies, scores, (270, 480))
    assert np.isnan(found.boxes_px[0]).all()
    np.testing.assert_array_equal(found.boxes_px[1], [100, 50, 200, 150])
    assert (found.classes[60:140, 110:190] == 2).all() and not (found.classes == 1).any()
    nothing = segmentation_of(seg_logits, energies, scores / 10, (270, 480))
    assert np.isnan(nothing.boxes_px).all()


def test_crops_follow_the_predicted_boxes_and_masks(segmented_run):
    """Boxes shifted by 3 pixels and masks that swap the hands' places show in the crops."""
    sample = SAMPLES[0]
    boxes = np.stack([hand_box(sample, side) for side in (0, 1)]) + np.array([3.0, 0.0, 3.0, 0.0])
    classes = np.array([0, 2, 1], np.uint8)[hand_classes(sample.labels)]
    batch = pose_batch([sample], segmented_run, (), lambda images: [Segmentation(classes, boxes)])
    size = segmented_run.networks.pose_net_2d.crop_size
    assert batch["side"].tolist() == [0, 1]
    for i, side in enumerate((0, 1)):
        expected = crop_matrix(boxes[side], sample.camera, side, size, segmented_run.crop)
        np.testing.assert_allclose(batch["image_from_crop"][i], expected, rtol=1e-5)
    plain_masks = Segmentation(hand_classes(sample.labels), boxes)
    plain = pose_batch([sample], segmented_run, (), lambda images: [plain_masks])
    assert torch.equal(batch["joints_px"], plain["joints_px"])
    assert not torch.equal(batch["image"], plain["image"])


def test_a_mask_of_the_other_hand_is_not_learnt_as_this_hands(segmented_run):
    """Named case: where HandSegNet swaps close hands, the crop that lights up the right hand was the left one's."""
    sample = SAMPLES[0]
    both = np.concatenate([hand_box(sample, 0), hand_box(sample, 1)])
    boxes = np.tile([both[[0, 4]].min(), both[[1, 5]].min(), both[[2, 6]].max(), both[[3, 7]].max()], (2, 1))
    swapped = np.array([0, 2, 1], np.uint8)[hand_classes(sample.labels)]
    answers = Segmentation(hand_classes(sample.labels), boxes), Segmentation(swapped, boxes)
    assert [shows_other_hand(sample, side, answer) for answer in answers for side in (0, 1)] == [False] * 2 + [True] * 2
    batch = pose_batch([sample], segmented_run, (), lambda images: [answers[1]])
    true = pose_batch([sample], segmented_run, ())
    assert batch["hand"].tolist() == [1.0, 1.0, 0.0, 0.0] and batch["side"].tolist() == [0, 1, 0, 1]
    assert all(torch.equal(values[:2], true[name]) for name, values in batch.items())
    unlabelled = dataclasses.replace(sample, labels=None)
    assert not shows_other_hand(unlabelled, 0, answers[1])


def test_the_share_of_predicted_crops_is_as_asked(segmented_run):
    segmenter = Segmenter(Path(segmented_run.data.segmentation))
    asked = []

    def count(images):
        asked.extend(images)
        return segmenter(images)

    half = dataclasses.replace(segmented_run, augment=dataclasses.replace(segmented_run.augment, predicted=0.5))
    pose_batch(SAMPLES[:1] * 200, half, [np.random.default_rng(i) for i in range(200)], count)
    assert 70 < len(asked) < 130
    asked.clear()
    pose_batch(SAMPLES[:1] * 3, half, (), count)  # validation: all of them
    assert len(asked) == 3
    asked.clear()
    nobody = make_sample(np.random.default_rng(1), present=(False, False))
    pose_batch([nobody] * 9, half, [np.random.default_rng(i) for i in range(9)], count)  # what might be invented there
    assert len(asked) == 9


def test_a_hand_that_was_missed_keeps_its_true_crop(segmented_run):
    def blind(images):
        return [Segmentation(np.zeros(image.shape[:2], np.uint8), np.full((2, 4), np.nan)) for image in images]

    assert equal(pose_batch(SAMPLES, segmented_run, (), blind), pose_batch(SAMPLES, segmented_run, ()))


def test_a_box_around_something_else_is_not_this_hands(segmented_run):
    """A tenth of the smaller box's area in common is too little: the hand keeps its true crop."""
    sample = SAMPLES[0]
    boxes = np.stack([hand_box(sample, side) for side in (0, 1)])
    far = boxes + np.array([0.95, 0.0, 0.95, 0.0]) * (boxes[:, [2]] - boxes[:, [0]])
    wrong = Segmentation(np.zeros(sample.image.shape[:2], np.uint8), far)
    batch = pose_batch([sample], segmented_run, (), lambda images: [wrong])
    assert equal(batch, pose_batch([sample], segmented_run, ()))


def test_workers_load_the_segmentation_themselves(segmented_run):
    config = dataclasses.replace(segmented_run, iterations=2)
    alone = [batch for _, batch in batch_loader(BatchDataset(SAMPLES, config), 0)]
    config = dataclasses.replace(config, data=dataclasses.replace(config.data, workers=1))
    helped = [batch for _, batch in batch_loader(BatchDataset(SAMPLES, config), 0)]
    assert all(equal(a, b) for a, b in zip(alone, helped, strict=True))


def test_validation_is_plain_and_whole():
    batches = validation_batches(SAMPLES, tiny_run("pose_net_2d"))
    assert sum(len(batch["image"]) for batch in batches) == 10
    again = validation_batches(SAMPLES, tiny_run("pose_net_2d", seed=7))
    assert all(equal(a, b) for a, b in zip(batches, again, strict=True))


def test_validation_pictures_are_never_opened_by_the_process_that_forks_workers():
    """Named case: it rendered them, and its workers hung, for a renderer does not survive a fork."""

    class Seen(list):
        def __getitem__(self, index):
            assert multiprocessing.parent_process() is not None
            return super().__getitem__(index)

    config = tiny_run("pose_net_2d")
    alone = validation_batches(SAMPLES, config)
    config = dataclasses.replace(config, data=dataclasses.replace(config.data, workers=2))
    helped = validation_batches(Seen(SAMPLES), config)
    assert all(equal(a, b) for a, b in zip(alone, helped, strict=True))


def test_a_validation_picture_that_cannot_be_used_is_said():
    class Damaged(list):
        def __getitem__(self, index):
            raise InputError("a.png: not an image")

    for workers in (0, 1):
        config = tiny_run("pose_net_2d")
        config = dataclasses.replace(config, data=dataclasses.replace(config.data, workers=workers))
        with pytest.raises(InputError, match=r"^a.png: not an image$"):
            validation_batches(Damaged(SAMPLES), config)


def test_split_and_ranges():
    train, held_out = split(SAMPLES * 8, 256)
    assert (len(train), len(held_out)) == (36, 4)
    assert held_out[0] is (SAMPLES * 8)[36]
    assert len(split(SAMPLES * 8, 2)[1]) == 2
    with pytest.raises(IndexError):
        IndexRange(SAMPLES, 1, 3)[2]


def test_joined_sources_follow_each_other():
    joined = Joined((SAMPLES[:2], [], SAMPLES[2:]))
    assert len(joined) == len(SAMPLES)
    assert all(joined[i] is sample for i, sample in enumerate(SAMPLES))
    for index in (-1, len(SAMPLES)):
        with pytest.raises(IndexError):
            joined[index]
    assert len(Joined(())) == 0


def test_an_empty_source_is_refused():
    with pytest.raises(InputError, match="no training pictures"):
        BatchDataset([], tiny_run("pose_net_2d"))


def test_a_single_hand_found_as_either_is_shown_whole_too(segmented_run):
    """HandSegNet calls its upper half a left and its lower half a right hand: both halves are the hand's, and the judge
    refuses them as the other one."""
    sample = make_sample(np.random.default_rng(1), present=(True, False))
    u0, v0, u1, v1 = hand_box(sample, 0)
    middle = (v0 + v1) / 2
    halves = np.where(np.arange(sample.image.shape[0])[:, None] < middle, np.uint8(1), np.uint8(2))
    classes = np.where(hand_classes(sample.labels) > 0, halves, np.uint8(0))
    boxes = np.array([[u0, v0, u1, v1 - 4], [u0, v0 + 4, u1, v1]])
    upright = dataclasses.replace(segmented_run, crop=dataclasses.replace(segmented_run.crop, roll=0.0))

    def batch(classes, boxes, united):
        rngs = [np.random.default_rng(0)]
        run = judging(upright, predicted=1.0, united=united)
        return pose_batch([sample], run, rngs, lambda images: [Segmentation(classes, boxes)])

    shown = batch(classes, boxes, united=1.0)
    assert shown["side"].tolist() == [0, 1] and shown["hand"].tolist() == [1.0, 0.0]
    whole = np.tile([u0, v0, u1, v1], (2, 1))
    for side in (0, 1):
        expected = batch(np.where(classes > 0, np.uint8(side + 1), np.uint8(0)), whole, united=0.0)
        assert torch.equal(shown["image_from_crop"][side], expected["image_from_crop"][side])
        assert torch.equal(shown["image"][side], expected["image"][side])
    apart = boxes + np.array([[0.0, 0.0, 0.0, 0.0], [0.0, 0.9, 0.0, 0.9]]) * (v1 - v0)
    assert equal(batch(classes, apart, united=1.0), batch(classes, apart, united=0.0))
