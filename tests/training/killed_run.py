"""A small training run in a process of its own, for `test_kill.py` to kill: goes on where it has been killed.

python -m tests.training.killed_run FOLDER [WORKERS]
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import torch
from tests.builders import make_samples
from tests.training.tiny import tiny_run

from twohands.models.checkpoint import save_network
from twohands.models.pose_net_2d import PoseNet2D
from twohands.training.trainer import train


def run(folder: Path, workers: int) -> None:
    """Two networks, averages, Muon, random crops, validation; the state is saved after every step."""
    config = tiny_run("pose_net_3d", iterations=24, log_every=1, validate_every=10, checkpoint_minutes=0.0)
    config = dataclasses.replace(config, data=dataclasses.replace(config.data, workers=workers))
    start = folder.parent / f"{folder.name}_start" / "pose_net_2d.safetensors"
    torch.manual_seed(5)
    save_network("pose_net_2d", PoseNet2D(config.networks.pose_net_2d), start)
    samples = make_samples(8)
    train(config, samples[:6], samples[6:], folder, weights=[start], resume=(folder / "config.json").is_file())


if __name__ == "__main__":
    run(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0)
