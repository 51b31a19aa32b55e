"""One process of those that `torchrun` starts for `test_parallel.py`: trains every stage in a folder each.

torchrun --nproc-per-node 2 -m tests.training.one_of_many FOLDER
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
import torch
from tests.builders import make_sample
from tests.training.tiny import tiny_run

from twohands.models.checkpoint import save_network
from twohands.models.pose_net_2d import PoseNet2D
from twohands.training.config import OptimConfig, StageName, TrainConfig
from twohands.training.trainer import train

STAGES: tuple[StageName, ...] = ("hand_seg_net", "pose_net_2d", "pose_net_3d")
STEPS = 3
SEED = 30
"""Deals the hands out unevenly: 3 and 2; none, but a crop without one, and 2; not even a crop and 2."""
SHOWN = [(True, True), (False, False), (False, True), (False, False), (True, True), (True, False)]
"""Hands in the pictures: with 2 processes and 4 pictures a step, some parts of a batch have none."""


def pictures() -> list:
    """The training pictures; where no hand is shown both are beside the picture, so that no other picture's outlines
    are laid over it. The last picture is empty: they are laid over that one."""
    found = []
    for i, shown in enumerate(SHOWN):
        sample = make_sample(np.random.default_rng(i), present=shown if any(shown) else (True, True))
        beside = 0 if any(shown) else [1e4, 0]
        found.append(dataclasses.replace(sample, joints_px=sample.joints_px + beside))
    return [*found, make_sample(np.random.default_rng(len(SHOWN)), present=(False, False))]


def config(stage: StageName) -> TrainConfig:
    """A few plain gradient steps, whose size is that of the gradient: Adam would blow up rounding."""
    optim = OptimConfig("sgd", learning_rate=5e-4, clip=20.0, ema=0.9, along_rate=0.5)
    run = tiny_run(stage, iterations=STEPS, batch_images=4, log_every=1, truth_maps=2, seed=SEED)
    return dataclasses.replace(run, optim=optim)


def train_all(folder: Path) -> None:
    """Train the three stages, each in a folder of its own."""
    for stage in STAGES:
        train(config(stage), pictures(), [], folder / stage, weights=start(stage, folder))


def start(stage: StageName, folder: Path) -> list[Path]:
    """The PoseNet2D that the last stage starts from, the same for all processes."""
    if stage != "pose_net_3d":
        return []
    torch.manual_seed(5)
    path = folder / "start" / "pose_net_2d.safetensors"
    if not path.exists():
        save_network("pose_net_2d", PoseNet2D(config(stage).networks.pose_net_2d), path)
    return [path]


if __name__ == "__main__":
    train_all(Path(sys.argv[1]))
