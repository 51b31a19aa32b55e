"""Trains on from shipped weights in minutes on one GPU (extra `train`): all networks at once.

    python scripts/burst_training.py src/twohands/weights --data FRAMES --backgrounds PHOTOS --minutes 9 --out burst

A GPU takes its steps far faster than processes can make crops. So the processes never stop making them, the GPU keeps
all of them in its memory and draws every batch from all that it has, each crop several times over, in other light and
with other things in front of it. No two runs are alike: what is drawn depends on how fast crops are made.

`--data` are folders of cached frames (`twohands generate frames`). The weights, for `scripts/average_weights.py`, are
written to a folder for each preset.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import threading
import time
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lightning_fabric import Fabric
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset

from twohands.cli.output import check_output_folder
from twohands.errors import TwoHandsError
from twohands.inference.weights import network_files, read_card
from twohands.models.checkpoint import save_network
from twohands.models.presets import NetworkName
from twohands.training.batches import Batch, BatchDataset, pose_batch, segmentation_batch, with_border
from twohands.training.config import TrainConfig, folder_list, recipe, with_override
from twohands.training.loading import HeldOutBatches, StepsFrom, calm_worker
from twohands.training.log import Running
from twohands.training.pose_targets import Segmentation
from twohands.training.schedule import learning_rate, update_average
from twohands.training.segmenter import Segmenter
from twohands.training.sources import open_source
from twohands.training.state import fresh_state
from twohands.training.trainer import take_step, validate

SETTINGS = (
    "loss.place=60",
    "loss.judge=4",
    "loss.soft_argmax=2",
    "crop.min_joints=1",
    "data.empty=0.16",
    "data.procedural=0.3",
    "data.clutter=0.3",
    "data.variants=40",
    "data.validation=510",
    "augment.cut=0",
    "optim.frozen_norm=true",
)
"""What differs from recipe `ours`."""
BORDER = 0.12
"""Share of the pictures that are cut so that a hand is leaving them: before their crops are, all alike."""
PICTURES = 8
"""That a process makes crops of at a time."""
REPEATS = 3
"""Crops of one hand in one picture, each cut, turned and masked in its own way: most of the work is the picture."""
FIRST_STREAM = 3
"""Of random numbers; those before are `BatchDataset`'s."""
FIRST_CROPS = 12_000
"""That must be there before the first step."""
COVERED = 0.25
"""Share of the crops over which a part of another one is laid."""
LEAST_BATCH = 8
REPORT_S = 15.0
"""Seconds between two reports."""
END = 1_000_000_000
"""More steps than a run will take."""


class Makers(Dataset[dict[str, Batch]]):
    """Maps a number to crops ("pose") and pictures ("segmentation"); the first ones to plain crops ("held_out").

    Args:
        pose: the run of the pose stages, `data.segmentation` a HandSegNet.
        segmentation: the run of HandSegNet.
        held_out: how many numbers give held-out crops.
        device: where HandSegNet runs, one for each process.
    """

    def __init__(self, pose: TrainConfig, segmentation: TrainConfig, held_out: int, device: str) -> None:
        self.pose, self.segmentation, self.held_out, self.device = pose, segmentation, held_out, device

    @cached_property
    def opened(self) -> tuple[BatchDataset, HeldOutBatches, Segmenter]:
        """Opened by each process for itself."""
        segmenter = Segmenter(Path(self.pose.data.segmentation), self.device)
        training, held_out = open_source(self.pose.data)
        return BatchDataset(training, self.pose), HeldOutBatches(held_out, self.pose, lambda _: segmenter), segmenter

    def __getitem__(self, number: int) -> dict[str, Batch]:
        training, held_out, segmenter = self.opened
        if number < self.held_out:
            return {"held_out": held_out[number]} if number < len(held_out) else {}
        picks = training.picks(number - self.held_out)

        def rngs(stream: int) -> list[np.random.Generator]:
            return [np.random.default_rng([self.pose.seed, *pick, stream]) for pick in picks]

        samples = with_border([training.source[index] for _, index in picks], BORDER, rngs(FIRST_STREAM))
        others = training.others(picks, samples)
        found: dict[int, Segmentation] = {}

        def segment(images: Sequence[np.ndarray]) -> list[Segmentation]:
            new = [image for image in images if id(image) not in found]
            found.update(zip(map(id, new), segmenter(new) if new else (), strict=True))
            return [found[id(image)] for image in images]

        crops = [pose_batch(samples, self.pose, rngs(FIRST_STREAM + 1 + k), segment, others) for k in range(REPEATS)]
        return {
            "pose": {name: torch.cat([one[name] for one in crops]) for name in crops[0]},
            "segmentation": segmentation_batch(samples, self.segmentation, rngs(FIRST_STREAM + 1 + REPEATS)),
        }


class Pool:
    """Examples in the GPU's memory; when it is full, new ones take the places of the oldest.

    Args:
        size: most examples.
        device: where.
    """

    def __init__(self, size: int, device: str) -> None:
        self.size, self.device, self.written = size, device, 0
        self.fields: dict[str, Tensor] = {}

    def __len__(self) -> int:
        return min(self.written, self.size)

    def add(self, batch: Batch) -> None:
        """Keep a batch, whose first dimension counts examples."""
        number = len(batch["image"])
        if not self.fields:
            self.fields = {
                name: torch.zeros((self.size, *values.shape[1:]), dtype=values.dtype, device=self.device)
                for name, values in batch.items()
            }
        at = torch.arange(self.written, self.written + number, device=self.device) % self.size
        for name, values in batch.items():
            self.fields[name][at] = values.to(self.device)
        if self.device == "cuda":
            torch.cuda.current_stream().synchronize()
        self.written += number

    def draw(self, number: int) -> Batch:
        """Random examples, some perhaps twice."""
        at = torch.randint(len(self), (number,), device=self.device)
        return {name: values[at] for name, values in self.fields.items()}


def relit(image: Tensor, strength: float = 1.0) -> Tensor:
    """Pictures (B, H, W, 3) uint8 in other light: gain, tint and gamma of each, and noise."""

    def lot(spread: float, *shape: int) -> Tensor:
        return torch.exp(spread * strength * torch.randn(len(image), 1, 1, *shape, device=image.device))

    x = (image.float() / 255).clamp_(1e-3, 1).pow_(lot(0.12, 1)).mul_(lot(0.1, 1) * lot(0.03, 3))
    noise = 0.01 * strength * torch.rand(len(image), 1, 1, 1, device=image.device)
    return (x + noise * torch.randn_like(x)).clamp_(0, 1).mul_(255).round_().to(torch.uint8)


def covered(image: Tensor, share: float, background: float) -> Tensor:
    """Crops (B, S, S, 3) uint8, over a share of which a rectangle of another one is laid, dimmed like what is no hand.

    Args:
        image: crops.
        share: of the crops.
        background: brightness of what is no hand (`CropConfig.background`).
    """
    size, device = image.shape[1], image.device

    def lot(*shape: int) -> Tensor:
        return torch.rand(len(image), *shape, device=device)

    extent = size * (0.15 + 0.3 * lot(2, 1))
    low = size * lot(2, 1) - extent / 2
    cells = torch.arange(size, device=device) + 0.5
    rows, columns = ((cells > low) & (cells < low + extent)).unbind(1)
    mask = rows[:, :, None] & columns[:, None, :] & (lot(1, 1) < share)
    other = (image.roll(1, 0).float() * (background * (0.7 + 0.5 * lot(1, 1, 1)))).to(torch.uint8)
    return torch.where(mask[..., None], other, image)


def mirrored(batch: Batch) -> Batch:
    """HandSegNet's pictures mirrored: left hands become right ones."""
    image, classes, boxes = batch["image"].flip(2), batch["classes"].flip(2), batch["boxes_px"].flip(1)
    other = torch.where(classes == 0, 0, 3 - classes.int()).to(classes.dtype)
    boxes = torch.stack(
        [image.shape[2] - boxes[..., 2], boxes[..., 1], image.shape[2] - boxes[..., 0], boxes[..., 3]], -1
    )
    present = batch["present"].flip(1)
    return {
        "image": image,
        "classes": other,
        "boxes_px": torch.where(present[..., None], boxes, batch["boxes_px"].flip(1)),
        "present": present,
    }


def half_mirrored(batch: Batch) -> Batch:
    """Half of the pictures as they are, half mirrored."""
    half = len(batch["image"]) // 2
    other = mirrored({name: values[half:] for name, values in batch.items()})
    return {name: torch.cat([values[:half], other[name]]) for name, values in batch.items()}


def smaller(batch: Batch, size: int) -> Batch:
    """The same crops with fewer pixels, `size` to a side."""
    factor = size / batch["image"].shape[1]
    if factor == 1:
        return batch
    image = batch["image"].permute(0, 3, 1, 2).float()
    image = nn.functional.interpolate(image, size=(size, size), mode="bilinear", align_corners=False)
    back = batch["rays_from_crop"].new_tensor([1 / factor, 1 / factor, 1])
    changed = {name: batch[name] * back for name in ("rays_from_crop", "image_from_crop") if name in batch}
    image = image.round().to(torch.uint8).permute(0, 2, 3, 1).contiguous()
    return {**batch, **changed, "image": image, "joints_px": batch["joints_px"] * factor}


class Learner:
    """A run of one stage, from weights whose batch statistics it keeps.

    Args:
        config: the run.
        weights: files to start from, see `build_stage`.
        device: where.
    """

    def __init__(self, config: TrainConfig, weights: Sequence[Path], device: str) -> None:
        self.config = config
        self.fabric = Fabric(accelerator=device, precision=config.precision, devices=1)
        self.state = fresh_state(config, weights, resume=False)
        self.model, self.optimizer = self.fabric.setup(self.state.stage, self.state.optimizer)
        self.state.best.to(device)
        self.running = Running(config, 1)

    def step(self, batch: Batch, rate: float) -> None:
        """One step, and the averaged weights after it."""
        state, optim = self.state, self.config.optim
        values = take_step(self.fabric, self.model, self.optimizer, batch, state.iteration, rate, optim)
        update_average(state.best, state.stage, optim.ema, state.iteration)
        state.iteration += 1
        self.running.add(values, 0.0, 0.0)

    def report(self) -> str:
        """Mean losses since the last report."""
        losses = self.running.losses()
        self.running.clear()
        return " ".join(f"{name} {value:.4f}" for name, value in losses.items())

    def save(self, folder: Path, note: dict[str, Any]) -> None:
        """Write the averaged weights."""
        for name, network in self.state.best.networks().items():
            save_network(name, network, folder / f"{name}.safetensors", note=note)


def learner_of(preset: Path, config: TrainConfig, names: Sequence[NetworkName], device: str) -> Learner:
    """Of networks of a preset, in crops of its size."""
    card = read_card(preset)
    files = network_files(preset, card)
    config = with_override(config, f"networks.pose_net_2d.crop_size={card.crop_size}")
    return Learner(config, [files[name] for name in names], device)


class Stock:
    """What processes make all the time, received by a thread.

    Args:
        makers: what they do.
        workers: number of processes.
        pools: most crops and most pictures that are kept.
        device: where.
    """

    def __init__(self, makers: Makers, workers: int, pools: Sequence[int], device: str) -> None:
        self.crops, self.pictures = (Pool(size, device) for size in pools)
        self.held_out: list[Batch] = []
        self.trouble: BaseException | None = None
        self._makers, self._workers, self._device, self._closed = makers, workers, device, threading.Event()
        self._thread = threading.Thread(target=self._receive)

    def __enter__(self) -> Stock:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closed.set()
        self._thread.join()

    def _receive(self) -> None:
        made = DataLoader(
            self._makers,
            batch_size=None,
            sampler=StepsFrom(0, END),
            num_workers=self._workers,
            multiprocessing_context="spawn",  # processes that are forked cannot use the GPU
            worker_init_fn=calm_worker,
        )
        try:
            with torch.cuda.stream(torch.cuda.Stream() if self._device == "cuda" else None):
                for item in made:
                    if self._closed.is_set():
                        break
                    self._keep(item)
        except BaseException as error:
            self.trouble = error

    def _keep(self, item: dict[str, Batch]) -> None:
        for name, batch in item.items():
            if not len(batch["image"]):
                continue
            if name == "held_out":
                self.held_out.append({key: values.to(self._device) for key, values in batch.items()})
            else:
                (self.crops if name == "pose" else self.pictures).add(batch)

    def check(self) -> None:
        """Raise what has ended the thread, if anything has."""
        if self.trouble is not None:
            raise self.trouble


def configs(options: argparse.Namespace) -> tuple[TrainConfig, TrainConfig]:
    """The runs of the pose stages and of HandSegNet."""
    further = (
        f"optim.learning_rate={options.rate}",
        f"iterations={END}",
        f"batch_images={PICTURES}",
        f"seed={options.seed}",
        f"data.source={folder_list(options.data)}",
        f"data.backgrounds={folder_list(options.backgrounds)}",
        f"data.segmentation={options.weights / 'fast' / 'hand_seg_net.onnx'}",
    )
    pose, segmentation = recipe("ours", "pose_net_3d"), recipe("ours", "hand_seg_net")
    return with_override(pose, *SETTINGS, *further), with_override(segmentation, *SETTINGS, *further)


def burst(options: argparse.Namespace) -> None:
    """The run, from the first crop to the written weights.

    Raises:
        TwoHandsError: folders or weights cannot be used, or the loss is not finite.
    """
    begin = time.monotonic()
    device = "cuda" if torch.cuda.is_available() else "cpu"
    torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = True

    def say(text: str) -> None:
        print(f"{time.monotonic() - begin:7.1f} s  {text}", flush=True)

    pose, segmentation = configs(options)
    open_source(pose.data)  # what is wrong with it is better said here than by every process
    pose_networks = ("pose_net_2d", "pose_net_3d")
    learners = {
        "accurate": learner_of(options.weights / "accurate", pose, pose_networks, device),
        "fast": learner_of(options.weights / "fast", pose, pose_networks, device),
        "hand_seg_net": learner_of(options.weights / "fast", segmentation, ("hand_seg_net",), device),
    }
    sizes = {name: learners[name].config.networks.pose_net_2d.crop_size for name in ("accurate", "fast")}
    figures: dict[str, dict[str, float]] = {}

    def check(held_out: Sequence[Batch]) -> None:
        for name, size in sizes.items():
            learner = learners[name]
            figures[name] = validate(learner.fabric, learner.state.best, [smaller(batch, size) for batch in held_out])
            say(f"{name}: " + " ".join(f"{key} {value:.4f}" for key, value in figures[name].items()))

    makers = Makers(learners["accurate"].config, segmentation, options.held_out, device)
    with Stock(makers, options.workers, options.pools, device) as stock:
        while len(stock.crops) < options.first:
            stock.check()
            time.sleep(0.1)
        held_out = list(stock.held_out)
        say(f"{len(stock.crops)} crops, {len(stock.pictures)} pictures, {len(held_out)} held-out batches")
        check(held_out)
        start = shown = time.monotonic()
        end = begin + 60 * options.minutes
        while (now := time.monotonic()) < end:
            stock.check()
            rate = learning_rate(pose.optim, learners["fast"].state.iteration, (now - start) / (end - start))
            batch = stock.crops.draw(options.batch)
            batch["image"] = covered(relit(batch["image"]), COVERED, pose.crop.background)
            batch["lot"] = torch.rand_like(batch["lot"])
            for name, size in sizes.items():
                learners[name].step(smaller(batch, size), rate)
            picture = half_mirrored(stock.pictures.draw(options.batch // 4))
            picture["image"] = relit(picture["image"], 0.7)
            learners["hand_seg_net"].step(picture, rate)
            if now - shown > REPORT_S:
                shown = now
                say(f"step {learners['fast'].state.iteration}, {stock.crops.written} crops made, rate {rate:.1e}")
                for name, learner in learners.items():
                    say(f"  {name} {learner.report()}")
        crops = stock.crops.written
    check(held_out)
    note = {
        "recipe": "burst",
        "seed": options.seed,
        "iterations": learners["fast"].state.iteration,
        "batch": options.batch,
        "minutes": round((time.monotonic() - begin) / 60, 2),
        "crops": crops,
        "data": ", ".join(folder.name for folder in options.data),
        "backgrounds": ", ".join(folder.name for folder in options.backgrounds),
        "crop": dataclasses.asdict(pose.crop),
        "loss": dataclasses.asdict(pose.loss),
    }
    for name in sizes:
        learners[name].save(options.out / name, {**note, "validation": figures[name]})
    learners["hand_seg_net"].save(options.out / "fast", {**note, "batch": options.batch // 4})
    say(f"weights are in {options.out}")


def main() -> int:
    """Reads the options and trains."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("weights", type=Path, help="folder of the presets fast and accurate to start from")
    parser.add_argument("--data", type=Path, nargs="+", required=True, help="folders of cached frames")
    parser.add_argument("--backgrounds", type=Path, nargs="*", default=[], help="folders of photographs, panoramas")
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    parser.add_argument("--minutes", type=float, required=True, help="from start to the last step")
    parser.add_argument("--workers", type=int, default=14, help="processes that make crops")
    parser.add_argument("--batch", type=int, default=1024, help="crops of a step; a fourth as many whole pictures")
    parser.add_argument("--pools", type=int, nargs=2, default=(330_000, 60_000), help="most crops, most pictures")
    parser.add_argument("--first", type=int, default=FIRST_CROPS, help="crops before the first step")
    parser.add_argument("--held-out", type=int, default=32, help="held-out batches, of 16 pictures")
    parser.add_argument("--rate", type=float, default=8e-4, help="first learning rate")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if options.batch < LEAST_BATCH:
        parser.error(f"--batch must be at least {LEAST_BATCH}, got {options.batch}")
    if not 0 < options.first <= options.pools[0]:
        parser.error(f"--first must be positive and not more than --pools keeps, got {options.first}")
    try:
        check_output_folder(options.out, overwrite=False)
        burst(options)
    except TwoHandsError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
