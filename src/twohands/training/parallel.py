"""Several processes that train as one: what they add up, so that their steps are those of a single process.

Everything here is the identity in a single process. `torchrun` starts the processes and describes them in the
environment; gradients are averaged by torch's DistributedDataParallel.
"""

from __future__ import annotations

import os
from typing import Any

import torch
from torch import Tensor, distributed, nn

from twohands.errors import InputError


def process_layout() -> tuple[int, int]:
    """(processes on this machine, machines), as `torchrun` started them; (1, 1) without it."""
    here, all_of_them = int(os.environ.get("LOCAL_WORLD_SIZE", 1)), int(os.environ.get("WORLD_SIZE", 1))
    return here, all_of_them // here


def is_first_process() -> bool:
    """Whether this process speaks for all; the only one without `torchrun`."""
    return int(os.environ.get("RANK", 0)) == 0


def share_of_batch(batch_images: int, world_size: int) -> int:
    """Pictures of a step for each process.

    Raises:
        InputError: they cannot be shared out evenly.
    """
    if batch_images % world_size:
        raise InputError(f"a batch of {batch_images} pictures cannot be shared evenly by {world_size} processes")
    return batch_images // world_size


class _SumOverProcesses(torch.autograd.Function):
    """Sum of a tensor over all processes; the gradient is the sum of theirs."""

    @staticmethod
    def forward(ctx: Any, values: Tensor) -> Tensor:
        total = values.detach().clone()
        distributed.all_reduce(total)
        return total

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        total = gradients[0].contiguous().clone()
        distributed.all_reduce(total)
        return total


def _world_size() -> int:
    return distributed.get_world_size() if distributed.is_available() and distributed.is_initialized() else 1


def mean_over_processes(value: Tensor) -> Tensor:
    """Mean of a number without gradient over all processes, each of which must call this."""
    world = _world_size()
    return value if world == 1 else _SumOverProcesses.apply(value.detach()) / world  # type: ignore[operator]


class SharedBatchNorm2d(nn.BatchNorm2d):
    """Batch normalisation by the statistics of all processes' hands together; a process may have none.

    `torch.nn.SyncBatchNorm` does the same, but on GPUs alone.
    """

    def forward(self, input: Tensor) -> Tensor:
        """(B, C, H, W) -> same shape; B may differ between processes."""
        if not self.training or _world_size() == 1:
            return super().forward(input)
        values = input.float()
        count = _SumOverProcesses.apply(values.new_tensor([values.numel() / self.num_features]))
        mean = _SumOverProcesses.apply(values.sum(dim=(0, 2, 3))) / count  # type: ignore[operator]
        centred = values - mean[:, None, None]
        variance = _SumOverProcesses.apply(centred.square().sum(dim=(0, 2, 3))) / count  # type: ignore[operator]
        with torch.no_grad():
            assert self.running_mean is not None and self.running_var is not None and self.momentum is not None
            self.running_mean.lerp_(mean, self.momentum)
            self.running_var.lerp_(variance * count / (count - 1), self.momentum)  # type: ignore[operator]
            assert self.num_batches_tracked is not None
            self.num_batches_tracked += 1
        scale = self.weight * (variance + self.eps).rsqrt()
        return (centred * scale[:, None, None] + self.bias[:, None, None]).to(input.dtype)


def share_batch_norm(network: nn.Module) -> None:
    """Let every batch normalisation of a network use the statistics of all processes, in place; names and values of
    its weights stay."""
    for child in network.modules():
        if type(child) is nn.BatchNorm2d:
            child.__class__ = SharedBatchNorm2d
