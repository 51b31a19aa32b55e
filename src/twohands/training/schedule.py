"""Learning rate over a run, and averaged weights."""

from __future__ import annotations

import math

import torch
from torch import nn

from twohands.training.config import OptimConfig, TrainConfig

FINAL_SHARE = 0.01


def progress(config: TrainConfig, iteration: int, elapsed_s: float) -> float:
    """How much of the budget is used, 0..1: iterations or minutes, whichever is further; 1 ends the run."""
    used = iteration / config.iterations
    if config.max_minutes > 0:
        used = max(used, elapsed_s / (60 * config.max_minutes))
    return min(used, 1.0)


def learning_rate(config: OptimConfig, iteration: int, done: float) -> float:
    """Learning rate of one iteration.

    Args:
        config: "step": halved every `halve_every` iterations (paper, supplement). "cosine": linear warm-up, then half a
            cosine over the budget, down to 1 %.
        iteration: 0-based.
        done: share of the budget that is used, 0..1.
    """
    if config.schedule == "step":
        return config.learning_rate * 0.5 ** (iteration // config.halve_every)
    warm = min(1.0, (iteration + 1) / max(1, config.warm_up))
    return config.learning_rate * warm * (FINAL_SHARE + (1 - FINAL_SHARE) * 0.5 * (1 + math.cos(math.pi * done)))


@torch.no_grad()
def update_average(average: nn.Module, model: nn.Module, decay: float, iteration: int) -> None:
    """Move averaged weights towards the current ones, in place; buffers (BN statistics) are averaged alike.

    The decay grows from 0.1 to its full value, min(decay, (1 + t) / (10 + t)), so that the start is soon forgotten.
    """
    rate = 1 - min(decay, (1 + iteration) / (10 + iteration))
    kept, fresh = average.state_dict(), model.state_dict()
    for name, tensor in kept.items():
        if tensor.is_floating_point():
            tensor.lerp_(fresh[name], rate)
        else:
            tensor.copy_(fresh[name])
