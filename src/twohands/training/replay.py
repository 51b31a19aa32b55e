"""Batches learnt from again, changed on the device: a GPU takes many steps in the time that one batch is made.

Ours, after data echoing (Choi et al., "Faster neural network training with data echoing", 2019). `DataConfig.echo` uses
a picture again where it was made, and pays for every use with a worker's time; this costs the workers nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import torch
from torch import Tensor
from torch.nn import functional

from twohands.errors import TwoHandsError
from twohands.training.batches import Batch
from twohands.training.config import StageName

KEPT_BATCHES = 64
"""So many of the last batches are drawn from."""
ZOOM = 0.3
"""Largest change of log2 of a picture's scale."""
SHIFT = 0.08
"""Largest shift of a picture, as a fraction of its size."""
STAYS = 0.6
"""A change that leaves less of a hand's box in the picture is not made: what is to be seen of the hand is unknown."""
CROP_ZOOM, CROP_SHIFT = 0.12, 0.04
"""The same two of a crop: small, because in use the box that it is cut by is hardly off."""
GAIN = 0.1
"""Largest relative change of a colour channel."""
GAMMA = 0.25
"""Largest change of log2 of the gamma exponent."""
NOISE = 0.015
"""Largest standard deviation of noise, as a fraction of 255."""


class Pool:
    """The last rows of batches, drawn in any order.

    Args:
        rows: how many.
    """

    def __init__(self, rows: int) -> None:
        self.rows = rows
        self._kept: Batch = {}
        self._next, self._filled = 0, 0

    def add(self, batch: Batch) -> None:
        """Keep a batch; its rows take the places of the oldest where all are taken."""
        if not self._kept:
            self._kept = {name: values.new_empty((self.rows, *values.shape[1:])) for name, values in batch.items()}
        count = len(batch["image"])
        places = (torch.arange(count, device=batch["image"].device) + self._next) % self.rows
        for name, values in batch.items():
            self._kept[name][places] = values
        self._next, self._filled = (self._next + count) % self.rows, min(self._filled + count, self.rows)

    def draw(self, rows: int, rng: torch.Generator) -> Batch:
        """So many different rows, at most all that are kept, each with all of its fields.

        Args:
            rows: of the batch to be drawn.
            rng: of the CPU.
        """
        chosen = torch.randperm(self._filled, generator=rng)[:rows].to(self._kept["image"].device)
        return {name: values[chosen] for name, values in self._kept.items()}


def replayed(
    made: Iterable[tuple[float, Batch | TwoHandsError]],
    uses: int,
    stage: StageName,
    seed: int,
    to_device: Callable[[Batch], Batch],
) -> Iterator[tuple[float, Batch | TwoHandsError]]:
    """Several batches for each that was made: as many rows as it has, of it and those before it, changed.

    Args:
        made: batches, each with the seconds that it took to make, or what is wrong in place of one.
        uses: batches for each; with 1 those that were made come out as they are.
        stage: whose batches they are.
        seed: of the draws.
        to_device: where they are kept and changed.

    Yields:
        Batches, each with its share of the seconds.
    """
    if uses == 1:
        yield from made
        return
    pool: Pool | None = None
    rng = torch.Generator().manual_seed(seed)
    change = changed_pictures if stage == "hand_seg_net" else changed_crops
    for seconds, batch in made:
        if isinstance(batch, TwoHandsError):
            yield seconds, batch
            continue
        rows = len(batch["image"])
        if rows:
            pool = pool or Pool(KEPT_BATCHES * rows)
            pool.add(to_device(batch))
        for _ in range(uses):
            yield seconds / uses, change(pool.draw(rows, rng), rng) if pool and rows else batch


def changed_crops(batch: Batch, rng: torch.Generator) -> Batch:
    """Crops of hands, nearer or farther, moved, in other colours.

    A crop that is zoomed and moved is what the same camera sees through another cut: the pose and the distance stay.

    Args:
        batch: of `batches.pose_batch`, not changed.
        rng: of the CPU.
    """
    image, joints = batch["image"], batch["joints_px"]
    count, size = len(image), image.shape[2]
    scale, shift = _drawn_moves(count, CROP_ZOOM, CROP_SHIFT, rng, image.device)
    moved = _sampled(image.permute(0, 3, 1, 2), _sources(scale, shift), "bilinear")
    shift = shift * size
    old_from_new = torch.zeros(count, 3, 3, device=image.device)
    old_from_new[:, 0, 0] = old_from_new[:, 1, 1] = 1 / scale
    old_from_new[:, :2, 2] = size / 2 - (size / 2 + shift) / scale[:, None]
    old_from_new[:, 2, 2] = 1
    joints = size / 2 + shift[:, None] + (joints - size / 2) * scale[:, None, None]
    inside = ((joints >= 0) & (joints < size)).all(dim=-1)
    weight = batch["weight"] * inside
    return batch | {
        "image": recoloured(moved.round().to(torch.uint8).permute(0, 2, 3, 1), rng),
        "joints_px": torch.where(weight[..., None] > 0, joints, 0.0),
        "weight": weight,
        "rays_from_crop": batch["rays_from_crop"] @ old_from_new,
        "image_from_crop": batch["image_from_crop"] @ old_from_new,
    }


def changed_pictures(batch: Batch, rng: torch.Generator) -> Batch:
    """Pictures for HandSegNet, mirrored, nearer or farther, moved, in other colours.

    Args:
        batch: of `batches.segmentation_batch`, not changed.
        rng: of the CPU.
    """
    image, classes, boxes, present = (batch[name] for name in ("image", "classes", "boxes_px", "present"))
    count, height, width = classes.shape
    flip = (torch.rand(count, generator=rng) < 0.5).to(image.device)
    scale, shift = _drawn_moves(count, ZOOM, SHIFT, rng, image.device)
    size = torch.tensor([width, height], dtype=torch.float32, device=image.device)
    middle = size / 2

    def moved(scale: Tensor, shift: Tensor) -> Tensor:
        """(B, 2, 4) boxes after it, not clipped."""
        place = middle + shift * size
        corners = (boxes.view(count, 2, 2, 2) - middle) * scale[:, None, None, None] + place[:, None, None]
        return corners.view(count, 2, 4)

    whole = moved(scale, shift)
    stays = (_area(_clipped(whole, size)) >= STAYS * _area(whole)) | ~present
    kept = stays.all(dim=1)
    scale, shift = torch.where(kept, scale, 1.0), torch.where(kept[:, None], shift, 0.0)
    boxes = _clipped(moved(scale, shift), size)

    matrix = _sources(scale, shift)
    matrix[flip, 0] = matrix[flip, 0] * torch.tensor([-1.0, 1.0, 1.0], device=image.device)
    image = _sampled(image.permute(0, 3, 1, 2), matrix, "bilinear").round().to(torch.uint8).permute(0, 2, 3, 1)
    classes = _sampled(classes[:, None], matrix, "nearest")[:, 0].to(torch.uint8)
    other = torch.tensor([0, 2, 1], dtype=torch.uint8, device=image.device)
    classes = torch.where(flip[:, None, None], other[classes.long()], classes)
    mirrored = boxes.flip(1) * torch.tensor([-1.0, 1.0, -1.0, 1.0], device=image.device)
    mirrored = (mirrored + torch.tensor([width, 0.0, width, 0.0], device=image.device))[..., [2, 1, 0, 3]]
    boxes = torch.where(flip[:, None, None], mirrored, boxes)
    present = torch.where(flip[:, None], present.flip(1), present)
    return {
        "image": recoloured(image, rng),
        "classes": classes,
        "boxes_px": torch.where(present[..., None], boxes, 0.0),
        "present": present,
    }


def recoloured(image: Tensor, rng: torch.Generator) -> Tensor:
    """Pictures under other light, with noise.

    Args:
        image: (B, H, W, 3) uint8.
        rng: of the CPU; the noise is drawn where the pictures are, by torch's own generator there.

    Returns:
        (B, H, W, 3) uint8; black stays black before the noise.
    """
    count = len(image)

    def drawn(*shape: int) -> Tensor:
        return (2 * torch.rand(count, *shape, generator=rng) - 1).to(image.device)

    gain, gamma = 1 + GAIN * drawn(1, 1, 3), torch.exp2(GAMMA * drawn(1, 1, 1))
    sigma = (NOISE * torch.rand(count, 1, 1, 1, generator=rng)).to(image.device)
    values = (image.float() / 255) ** gamma * gain
    values = values + sigma * torch.randn(image.shape, device=image.device)
    return (values.clamp(0, 1) * 255).round().to(torch.uint8)


def _drawn_moves(
    count: int, zoom: float, shift: float, rng: torch.Generator, device: torch.device
) -> tuple[Tensor, Tensor]:
    """Scales (N,), by at most so much in log2, and shifts (N, 2) as fractions of the size, for as many pictures."""
    scales = torch.exp2((2 * torch.rand(count, generator=rng) - 1) * zoom)
    shifts = (2 * torch.rand(count, 2, generator=rng) - 1) * shift
    return scales.to(device), shifts.to(device)


def _sources(scale: Tensor, shift: Tensor) -> Tensor:
    """(N, 2, 3) matrices that say where every pixel comes from, in grid_sample's units, -1 to 1 from border to border,
    for pictures scaled (N,) about their middle and shifted (N, 2), as fractions of their size."""
    matrix = torch.zeros(len(scale), 2, 3, device=scale.device)
    matrix[:, 0, 0] = matrix[:, 1, 1] = 1 / scale
    matrix[:, :, 2] = -2 * shift / scale[:, None]
    return matrix


def _sampled(values: Tensor, sources: Tensor, mode: str) -> Tensor:
    """Pictures (N, C, H, W) taken from where `_sources` says; the edge goes on outside."""
    grid = functional.affine_grid(sources, [len(values), 1, *values.shape[2:]], align_corners=False)
    return functional.grid_sample(values.float(), grid, mode, padding_mode="border", align_corners=False)


def _clipped(boxes: Tensor, size: Tensor) -> Tensor:
    return torch.minimum(boxes.clamp_min(0), size.repeat(2))


def _area(boxes: Tensor) -> Tensor:
    return (boxes[..., 2:] - boxes[..., :2]).clamp_min(0).prod(dim=-1)
