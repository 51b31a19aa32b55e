"""All that changes during a run: networks, averaged networks and optimizer, saved and restored."""

from __future__ import annotations

import copy
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from twohands.errors import CheckpointError, InputError
from twohands.models.checkpoint import load_tensors, save_tensors
from twohands.training.config import OptimConfig, TrainConfig
from twohands.training.muon import Muon, is_hidden
from twohands.training.stage import Stage
from twohands.training.stages import build_stage


def build_optimizer(stage: Stage, config: OptimConfig) -> torch.optim.Optimizer:
    """The optimizer of a run; each group keeps its relative learning rate under the key "share".

    AdamW and Muon spare vectors (biases, batch normalisation) from weight decay; Adam, as in the paper, does not. Muon
    moves the hidden layers (`muon.is_hidden`), but not those that others have trained.
    """
    groups: list[dict[str, Any]] = []
    for group in stage.parameter_groups():
        parameters, share = group.parameters, group.share
        if config.optimizer in ("adamw", "muon"):
            wide = [p for p in parameters if p.ndim > 1]
            flat = [p for p in parameters if p.ndim <= 1]
            if config.optimizer == "muon" and not group.pretrained:
                hidden, wide = [p for p in wide if is_hidden(p)], [p for p in wide if not is_hidden(p)]
                groups.append({"params": hidden, "share": share, "weight_decay": config.weight_decay, "muon": True})
            groups.append({"params": wide, "share": share, "weight_decay": config.weight_decay})
            groups.append({"params": flat, "share": share, "weight_decay": 0.0})
        else:
            groups.append({"params": parameters, "share": share, "weight_decay": config.weight_decay})
    if config.optimizer == "sgd":
        return torch.optim.SGD(groups, lr=config.learning_rate)
    kind = {"adam": torch.optim.Adam, "adamw": torch.optim.AdamW, "muon": Muon}[config.optimizer]
    return kind(groups, lr=config.learning_rate, betas=(0.9, 0.999), fused=True)


@dataclass
class TrainState:
    """All that changes during a run: what a resume needs."""

    stage: Stage
    average: Stage | None
    optimizer: torch.optim.Optimizer
    iteration: int = 0
    elapsed_s: float = 0.0

    @property
    def best(self) -> Stage:
        """The stage to validate and to export."""
        return self.stage if self.average is None else self.average

    def save(self, path: Path, config: TrainConfig) -> None:
        """Write one safetensors file, atomically."""
        tensors = {f"stage.{name}": tensor for name, tensor in self.stage.state_dict().items()}
        if self.average is not None:
            tensors |= {f"average.{name}": tensor for name, tensor in self.average.state_dict().items()}
        for index, entries in self.optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer.{index}.{name}": value for name, value in entries.items() if value is not None}
        header = {"iteration": self.iteration, "elapsed_s": self.elapsed_s, "config": config.to_dict()}
        save_tensors(tensors, {"format": "twohands-training-state-1", "state": json.dumps(header)}, path)

    def restore(self, path: Path, config: TrainConfig) -> None:
        """Continue from a written file.

        Raises:
            CheckpointError: missing, damaged, or of a run with other networks.
            InputError: of a run with another optimizer, without averaged weights, or that trained what this one keeps
                fixed.
        """
        tensors, metadata = load_tensors(path)
        if "state" not in metadata:
            raise CheckpointError(f"{path} is not a saved training state")
        header = json.loads(metadata["state"])
        before = header["config"]["optim"]["optimizer"]
        if before != config.optim.optimizer:
            raise InputError(f"{path} is the state of a run with {before}, not {config.optim.optimizer}")
        averaged = _below("average.", tensors)
        if self.average is not None and not averaged:
            raise InputError(f"{path} is the state of a run without averaged weights: resume it with optim.ema=0")
        try:
            self.stage.load_state_dict(_below("stage.", tensors))
            if self.average is not None:
                self.average.load_state_dict(averaged)
        except RuntimeError as error:
            raise CheckpointError(f"{path}: saved by a run with other networks") from error
        entries: dict[int, dict[str, Tensor]] = {}
        for name, tensor in _below("optimizer.", tensors).items():
            index, key = name.split(".", 1)
            entries.setdefault(int(index), {})[key] = tensor
        groups = self.optimizer.state_dict()["param_groups"]
        if entries.keys() - {index for group in groups for index in group["params"]}:
            raise InputError(f"{path} is the state of a run that trained PoseNet2D along: optim.along_rate cannot be 0")
        self.optimizer.load_state_dict({"state": entries, "param_groups": groups})
        for parameter, values in self.optimizer.state.items():  # same memory layout, else other rounding
            for key, value in values.items():
                if value.shape == parameter.shape:
                    values[key] = torch.empty_like(parameter).copy_(value)
        self.iteration, self.elapsed_s = int(header["iteration"]), float(header["elapsed_s"])


def fresh_state(config: TrainConfig, weights: Sequence[Path], resume: bool) -> TrainState:
    """Networks, averaged networks and optimizer, before any step."""
    stage = build_stage(config, weights, require_weights=not resume)
    stage = stage.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    average = None
    if config.optim.ema:
        average = copy.deepcopy(stage).requires_grad_(False).eval()
    return TrainState(stage, average, build_optimizer(stage, config.optim))


def _below(prefix: str, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}
