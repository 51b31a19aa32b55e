"""Batches that are learnt from again, changed on the device."""

import dataclasses
from itertools import count, islice

import pytest
import torch
from tests.training.test_batches import Counted
from tests.training.test_trainer import SAMPLES, start_weights
from tests.training.tiny import tiny_run

from twohands.errors import InputError, TwoHandsError
from twohands.training.batches import Batch, segmentation_batch
from twohands.training.config import DataConfig
from twohands.training.replay import Pool, changed_crops, changed_pictures, recoloured, replayed
from twohands.training.trainer import train

RIGHT_COLOUR, LEFT_COLOUR = 220, 120


def rows(first: int, number: int) -> dict[str, torch.Tensor]:
    """A batch whose pictures tell the row's number, and with it what crops have."""
    numbers = torch.arange(first, first + number)
    return {
        "image": numbers.view(-1, 1, 1, 1).expand(-1, 2, 2, 3).to(torch.uint8),
        "number": numbers,
        "joints_px": torch.zeros(number, 21, 2),
        "weight": torch.zeros(number, 21),
        "rays_from_crop": torch.eye(3).repeat(number, 1, 1),
        "image_from_crop": torch.eye(3).repeat(number, 1, 1),
    }


def numbers_of(batch: Batch | TwoHandsError) -> list[int]:
    assert not isinstance(batch, TwoHandsError)
    return batch["number"].tolist()


def test_a_pool_keeps_the_last_rows_and_draws_each_with_its_own_fields():
    pool, rng = Pool(10), torch.Generator().manual_seed(0)
    for first in (0, 4, 8, 12):
        pool.add(rows(first, 4))
    drawn = pool.draw(10, rng)
    assert sorted(drawn["number"].tolist()) == list(range(6, 16))
    assert torch.equal(drawn["image"][:, 0, 0, 0].long(), drawn["number"])
    assert len(pool.draw(99, rng)["number"]) == 10
    assert pool.draw(3, rng)["number"].tolist() != pool.draw(3, rng)["number"].tolist()


def test_each_batch_that_is_made_gives_as_many_as_are_asked_for():
    made = [(1.0, rows(0, 4)), (3.0, rows(4, 4)), (1.0, rows(8, 0)), (1.0, InputError("torn"))]
    given = list(replayed(made, 3, "pose_net_2d", 0, lambda batch: batch))
    assert [seconds for seconds, _ in given] == [1 / 3] * 3 + [1.0] * 3 + [1 / 3] * 3 + [1.0]
    assert isinstance(given[-1][1], InputError)
    shown = [numbers_of(batch) for _, batch in given[:-1]]
    assert [len(numbers) for numbers in shown] == [4] * 6 + [0] * 3
    assert all(set(numbers) == {0, 1, 2, 3} for numbers in shown[:3])
    assert max(max(numbers) for numbers in shown[3:6]) > 3
    once = [(1.0, rows(0, 4))]
    assert list(replayed(once, 1, "pose_net_2d", 0, lambda batch: batch)) == once


def squares(size: tuple[int, int] = (96, 160)) -> dict[str, torch.Tensor]:
    """A bright right hand and a darker left one; both are squares that fill their boxes."""
    height, width = size
    image = torch.zeros(1, height, width, 3, dtype=torch.uint8)
    classes = torch.zeros(1, height, width, dtype=torch.uint8)
    boxes = torch.tensor([[[20.0, 30.0, 52.0, 62.0], [90.0, 20.0, 130.0, 60.0]]])
    for side, colour in enumerate((LEFT_COLOUR, RIGHT_COLOUR)):
        u0, v0, u1, v1 = boxes[0, side].int().tolist()
        image[0, v0:v1, u0:u1], classes[0, v0:v1, u0:u1] = colour, side + 1
    return {"image": image, "classes": classes, "boxes_px": boxes, "present": torch.tensor([[True, True]])}


def test_pictures_masks_and_boxes_change_together():
    batch, rng, mirrored, scales = squares(), torch.Generator().manual_seed(1), 0, []
    for _ in range(40):
        changed = changed_pictures(batch, rng)
        bright = changed["image"][0].float().mean(dim=-1)
        assert changed["present"].all()
        for side in (0, 1):
            mask = changed["classes"][0] == side + 1
            box = changed["boxes_px"][0, side]
            v, u = mask.nonzero(as_tuple=True)
            seen = torch.tensor([u.min(), v.min(), u.max() + 1, v.max() + 1])
            assert (seen - box).abs().max() <= 1.5
        left, right = ((changed["classes"][0] == side) for side in (1, 2))
        flipped = bool(bright[left].mean() > bright[right].mean())
        mirrored += flipped
        first, second = (changed["boxes_px"][0, side, 0] for side in (0, 1))
        assert first < second  # the left hand of a mirror image is on the left again
        box = changed["boxes_px"][0, 1 if flipped else 0]
        scales.append(float(box[2] - box[0]) / 32)
    assert 8 < mirrored < 32
    assert min(scales) < 0.9 and max(scales) > 1.1
    assert torch.equal(batch["image"], squares()["image"])


def test_a_hand_is_not_moved_out_of_the_picture():
    batch, rng = squares(), torch.Generator().manual_seed(2)
    batch["boxes_px"][0, 0] = torch.tensor([0.0, 0.0, 8.0, 96.0])  # at the border: half of all shifts would lose it
    for _ in range(30):
        boxes = changed_pictures(batch, rng)["boxes_px"][0]
        assert ((boxes[:, 2:] - boxes[:, :2]).prod(dim=1) >= 0.6 * 0.6 * 8 * 96).all()


def test_absent_hands_stay_absent():
    config = tiny_run("hand_seg_net")
    batch = segmentation_batch(SAMPLES[:4], config, ())
    batch["present"][:, 0] = False
    batch["boxes_px"][:, 0] = 0
    changed = changed_pictures(batch, torch.Generator().manual_seed(3))
    assert (changed["present"].sum(dim=1) <= 1).all()
    assert (changed["boxes_px"][~changed["present"]] == 0).all()


def test_colours_change_and_black_stays_black():
    image = torch.full((16, 8, 8, 3), 128, dtype=torch.uint8)
    changed = recoloured(image, torch.Generator().manual_seed(0)).float().mean(dim=(1, 2))
    assert changed.std(dim=0).min() > 2 and (changed.mean() - 128).abs() < 12
    assert recoloured(torch.zeros_like(image), torch.Generator().manual_seed(0)).float().mean() < 3


def test_crops_and_joints_change_together():
    """Four bright spots stay under their joints; rays and pixels of the picture that belong to a joint stay its own."""
    spots = torch.tensor([[30.0, 40.0], [90.0, 35.0], [50.0, 100.0], [1.0, 64.0]])
    image = torch.zeros(12, 128, 128, 3, dtype=torch.uint8)
    for u, v in spots.int().tolist():
        image[:, v - 1 : v + 1, max(u - 1, 0) : u + 1] = 255
    homography = torch.tensor([[2.0, 0.1, 30.0], [-0.1, 2.0, 50.0], [1e-4, 2e-4, 1.0]])
    rays = torch.tensor([[0.01, 0.0, -0.6], [0.0, 0.01, -0.7], [0.0, 0.0, 1.0]])
    crops = {
        "image": image,
        "joints_px": spots.expand(12, 4, 2),
        "weight": torch.ones(12, 4),
        "rays_from_crop": rays.expand(12, 3, 3),
        "image_from_crop": homography.expand(12, 3, 3),
    }

    def through(matrices: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
        ends = torch.cat([points, torch.ones_like(points[..., :1])], dim=-1) @ matrices.transpose(1, 2)
        return ends[..., :2] / ends[..., 2:]

    changed = changed_crops(crops, torch.Generator().manual_seed(0))
    seen = changed["weight"] > 0
    assert 0 < (~seen).sum() < 12 and seen[:, :3].all()
    assert (changed["joints_px"][~seen] == 0).all()
    for field in ("rays_from_crop", "image_from_crop"):
        before, after = through(crops[field], crops["joints_px"]), through(changed[field], changed["joints_px"])
        torch.testing.assert_close(after[seen], before[seen], rtol=1e-4, atol=1e-3)
    grid = torch.stack(torch.meshgrid(torch.arange(128), torch.arange(128), indexing="xy"), dim=-1) + 0.5
    for bright, joints in zip(changed["image"].float().mean(dim=-1), changed["joints_px"], strict=True):
        for joint in joints[:3]:
            near = bright * ((grid - joint).norm(dim=-1) < 6)
            middle = (near[..., None] * grid).sum(dim=(0, 1)) / near.sum()
            assert (middle - joint).norm() < 0.3
    scales = (changed["joints_px"][:, 1] - changed["joints_px"][:, 0]).norm(dim=-1) / (spots[1] - spots[0]).norm()
    assert scales.min() < 0.96 and scales.max() > 1.04
    assert torch.equal(crops["image"], image)


@pytest.mark.parametrize("stage", ["hand_seg_net", "pose_net_3d"])
def test_a_run_makes_fewer_pictures_than_it_learns_from(tmp_path, stage):
    config = tiny_run(stage, iterations=9)
    config = dataclasses.replace(config, data=dataclasses.replace(config.data, replay=3, empty=0.0))
    source = Counted(6)
    result = train(config, source, [], tmp_path / "run", weights=start_weights(stage, tmp_path))
    assert result.iterations == 9
    assert sum(source.made) <= 4 * config.batch_images  # three batches; a loader may be one ahead
    resumed = dataclasses.replace(config, iterations=12)
    assert train(resumed, source, [], tmp_path / "run", resume=True).iterations == 12


def test_less_than_one_step_for_a_batch_is_refused():
    with pytest.raises(InputError, match="replay must be at least 1, got 0"):
        DataConfig(replay=0)


def test_the_same_seed_draws_the_same():
    def numbers(seed: int) -> list[list[int]]:
        made = ((0.0, rows(4 * i, 4)) for i in count())
        given = replayed(made, 2, "pose_net_2d", seed, lambda batch: batch)
        return [numbers_of(batch) for _, batch in islice(given, 8)]

    assert numbers(1) == numbers(1) != numbers(2)
