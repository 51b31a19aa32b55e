"""The training loop: step, validate, save, resume."""

from __future__ import annotations

import copy
import csv
import ctypes
import json
import platform
import signal
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from lightning_fabric import Fabric
from torch import Tensor, nn

from twohands.errors import CheckpointError, InputError, TwoHandsError
from twohands.files import write_whole
from twohands.models.checkpoint import load_tensors, save_network, save_tensors
from twohands.training.batches import (
    Batch,
    BatchDataset,
    OpenSegmentation,
    SampleSource,
    Segmenter,
    batch_loader,
    validation_batches,
)
from twohands.training.config import OptimConfig, TrainConfig
from twohands.training.muon import Muon, is_hidden
from twohands.training.parallel import process_layout, share_batch_norm
from twohands.training.schedule import learning_rate, progress, update_average
from twohands.training.stages import Stage, build_stage

STATE_FILE = "state.safetensors"
CONFIG_FILE = "config.json"
LOG_FILE = "log.csv"
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""Numbers of glibc's mallopt, from malloc.h."""
LOG_COLUMNS = ("iteration", "minutes", "split", "metric", "value")


@dataclass(frozen=True)
class TrainResult:
    """How a run ended.

    Attributes:
        iterations: optimizer steps done, over all resumes.
        minutes: wall-clock minutes, over all resumes.
        figures: last validation, empty without held-out pictures.
        checkpoints: network name -> file with the weights to use (averaged ones if the run averages).
    """

    iterations: int
    minutes: float
    figures: dict[str, float]
    checkpoints: dict[str, Path]


def build_optimizer(stage: Stage, config: OptimConfig) -> torch.optim.Optimizer:
    """The optimizer of a run; each group keeps its relative learning rate under the key "share".

    AdamW and Muon spare vectors (biases, batch normalisation) from weight decay; Adam, as in the paper, does not. Muon
    moves the hidden layers (`muon.is_hidden`).
    """
    groups: list[dict[str, Any]] = []
    for parameters, share in stage.parameter_groups():
        if config.optimizer in ("adamw", "muon"):
            wide = [p for p in parameters if p.ndim > 1]
            flat = [p for p in parameters if p.ndim <= 1]
            if config.optimizer == "muon":
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


def train(
    config: TrainConfig,
    source: SampleSource,
    held_out: SampleSource,
    out: Path,
    *,
    weights: Sequence[Path] = (),
    resume: bool = False,
    report: Callable[[str], None] = lambda line: None,
    stop_after: int | None = None,
    open_segmentation: OpenSegmentation = Segmenter,
) -> TrainResult:
    """Train one stage until its budget of iterations or minutes is used up.

    The folder holds `config.json`, `log.csv` (iteration, minutes, split, metric, value), the resumable
    `state.safetensors`, and one `<network>.safetensors` per trained network.

    On one CPU process without a limit of minutes, a run that was interrupted, even killed, and resumed ends bitwise
    like one that was not. Under `torchrun`, several processes share every batch and end, to rounding, like one; all of
    them must see `out` and the pictures. Only the first one validates, writes and reports.

    Args:
        config: the run.
        source: training pictures.
        held_out: pictures for validation; may be empty.
        out: folder of the run.
        weights: checkpoints to start from, see `build_stage`; not used when resuming.
        resume: continue the run in `out`, under the given config.
        report: gets one line of progress now and then.
        stop_after: leave, with everything saved, when this many iterations are done.
        open_segmentation: opens `config.data.segmentation` for the pose stages.

    Raises:
        InputError: `out` holds another run, `resume` finds none, or the processes cannot share a batch evenly.
        TwoHandsError: a picture cannot be used; after the state was saved.
        KeyboardInterrupt: after the state was saved.
    """
    state_path = out / STATE_FILE
    if resume and not state_path.is_file():
        raise InputError(f"{out} holds no training run to resume")
    if not resume and (out / CONFIG_FILE).exists():
        raise InputError(f"{out} already holds a training run; choose another folder, or resume it")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: cannot be made ({error.strerror})") from error
    if config.threads:
        torch.set_num_threads(config.threads)
    _keep_freed_memory()

    processes, machines = process_layout()
    fabric = Fabric(precision=config.precision, devices=processes, num_nodes=machines)
    fabric.launch()
    batches = BatchDataset(source, config, fabric.global_rank, fabric.world_size, open_segmentation)
    first = fabric.is_global_zero
    state = fresh_state(config, () if resume else weights, resume)
    share_batch_norm(state.stage)
    model, optimizer = fabric.setup(state.stage, state.optimizer)
    if state.average is not None:
        state.average.to(fabric.device)
    if resume:
        state.restore(state_path, config)
    if first:
        if not resume:
            state.save(state_path, config)  # before the config: a run that was killed at once can be resumed too
        _cut_log(out / LOG_FILE, state.iteration)
        write_whole(out / CONFIG_FILE, (json.dumps(config.to_dict(), indent=2) + "\n").encode())

    held_out_batches = validation_batches(held_out, config, open_segmentation) if first else []
    log = _Log(out / LOG_FILE, report) if first else None
    figures: dict[str, float] = {}
    running = Running(config, fabric.world_size)
    checked = -1

    def keep() -> None:
        if first:
            state.save(state_path, config)
            _save_networks(state, config, out, figures)

    def check() -> None:
        if log is not None and held_out_batches:
            figures.update(validate(fabric, state.best, held_out_batches))
            log.write(state, "validation", figures)

    if state.iteration == 0:
        check()  # where the run starts from
    interrupted = False
    clock, saved = time.monotonic() - state.elapsed_s, time.monotonic()
    with _StopSignal() as stop:
        for making_s, batch in batch_loader(batches, state.iteration):
            if isinstance(batch, TwoHandsError):
                keep()
                raise batch
            done = progress(config, state.iteration, state.elapsed_s) if first else 0.0
            # The first process's clock decides for all, so that all make the same steps.
            done, interrupts, items = _sums(fabric, done, stop.asked, len(batch["image"]))
            interrupted = interrupts > 0
            if done >= 1 or state.iteration == stop_after or interrupted:
                break
            if items:
                start = time.perf_counter()
                rate = learning_rate(config.optim, state.iteration, done)
                batch = fabric.to_device(batch)
                values = take_step(fabric, model, optimizer, batch, state.iteration, rate, config.optim)
                if state.average is not None:
                    update_average(state.average, state.stage, config.optim.ema, state.iteration)
                running.add(values, making_s, time.perf_counter() - start)
            state.iteration += 1
            state.elapsed_s = time.monotonic() - clock
            if log is not None and state.iteration % config.log_every == 0 and running.steps:
                log.write(state, "train", running.losses())
                log.write(state, "speed", running.speeds())
                running.clear()
            if state.iteration % config.validate_every == 0:
                check()
                checked = state.iteration
            if time.monotonic() - saved > 60 * config.checkpoint_minutes:
                keep()
                saved = time.monotonic()
        if not interrupted and state.iteration != checked:
            check()
        keep()
    if interrupted:
        raise KeyboardInterrupt
    files = {name: out / f"{name}.safetensors" for name in state.best.networks()}
    return TrainResult(state.iteration, state.elapsed_s / 60, figures, files)


def _keep_freed_memory() -> None:
    """Let glibc keep what a step frees for the next one. By default it returns large blocks to the system, which hands
    them out again page by page and filled with zeros: about a tenth of a step's time."""
    if platform.libc_ver()[0] == "glibc":
        libc = ctypes.CDLL(None)
        for parameter in (_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD):
            libc.mallopt(parameter, 2**31 - 1)


def _sums(fabric: Fabric, *values: float) -> list[float]:
    """Sums of numbers over all processes."""
    if fabric.world_size == 1:
        return list(values)
    numbers = torch.tensor(values, dtype=torch.float64, device=fabric.device)
    return fabric.all_reduce(numbers, reduce_op="sum").tolist()  # type: ignore[union-attr]


class Running:
    """What happened since the last row of the log.

    Args:
        config: the run.
        world_size: number of processes.
    """

    def __init__(self, config: TrainConfig, world_size: int) -> None:
        self._pictures = config.batch_images
        self._makers = max(1, config.data.workers) * world_size
        self._world_size = world_size
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self.steps = 0
        self._making_s = self._step_s = 0.0
        self._sums: dict[str, float] = {}

    def add(self, losses: dict[str, float], making_s: float, step_s: float) -> None:
        """One step: its losses, the seconds that a worker took for this process's part of the batch, and the step's."""
        self.steps += 1
        self._making_s += making_s
        self._step_s += step_s
        for name, value in losses.items():
            self._sums[name] = self._sums.get(name, 0.0) + value

    def losses(self) -> dict[str, float]:
        """Mean losses."""
        return {name: value / self.steps for name, value in self._sums.items()}

    def speeds(self) -> dict[str, float]:
        """Pictures per second over all processes: stream_per_s that the workers can make, step_per_s that the steps
        can take. The smaller one is the bottleneck."""
        pictures = self.steps * self._pictures
        return {
            "stream_per_s": pictures / self._world_size * self._makers / max(self._making_s, 1e-9),
            "step_per_s": pictures / max(self._step_s, 1e-9),
        }


class _StopSignal:
    """While active, an interrupt or a request to end is only noted, so that the running step can be finished."""

    def __init__(self) -> None:
        self.asked = False
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> _StopSignal:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._previous[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _note(self, *_: object) -> None:
        self.asked = True


def fresh_state(config: TrainConfig, weights: Sequence[Path], resume: bool) -> TrainState:
    """Networks, averaged networks and optimizer, before any step."""
    stage = build_stage(config, weights, require_weights=not resume)
    stage = stage.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    average = None
    if config.optim.ema:
        average = copy.deepcopy(stage).requires_grad_(False).eval()
    return TrainState(stage, average, build_optimizer(stage, config.optim))


def take_step(
    fabric: Fabric,
    model: nn.Module,
    optimizer: torch.optim.Optimizer,
    batch: Batch,
    iteration: int,
    rate: float,
    config: OptimConfig,
) -> dict[str, float]:
    """One optimizer step of all processes; returns their mean losses and their sum."""
    for group in optimizer.param_groups:
        group["lr"] = rate * group["share"]
    model.train()
    optimizer.zero_grad(set_to_none=True)
    parts = model(batch, iteration)
    values = torch.stack(list(parts.values()))
    means = fabric.all_reduce(values.detach(), reduce_op="mean")
    assert isinstance(means, Tensor)
    if not torch.isfinite(means).all():
        named = ", ".join(f"{name} {value:g}" for name, value in zip(parts, means.tolist(), strict=True))
        raise InputError(f"the loss is not finite at iteration {iteration} ({named}); lower the learning rate")
    fabric.backward(values.sum())
    if config.clip:
        fabric.clip_gradients(model, optimizer, max_norm=config.clip, error_if_nonfinite=False)
    optimizer.step()
    return {"loss": float(means.sum()), **dict(zip(parts, means.tolist(), strict=True))}


@torch.no_grad()
def validate(fabric: Fabric, stage: Stage, batches: Sequence[Batch]) -> dict[str, float]:
    """Figures of a stage over held-out batches, see `Stage.validate`."""
    was_training = stage.training
    stage.eval()
    with fabric.autocast():
        figures = stage.validate([fabric.to_device(batch) for batch in batches])
    stage.train(was_training)
    return figures


def _save_networks(state: TrainState, config: TrainConfig, out: Path, figures: dict[str, float]) -> None:
    note = {
        "recipe": config.recipe,
        "stage": config.stage,
        "seed": config.seed,
        "iterations": state.iteration,
        "minutes": round(state.elapsed_s / 60, 2),
        "data": _without_paths(config.to_dict()["data"]),
        "crop": config.to_dict()["crop"],
        "loss": config.to_dict()["loss"],
        "validation": figures,
    }
    for name, network in state.best.networks().items():
        save_network(name, network, out / f"{name}.safetensors", note=note)


def _without_paths(data: dict[str, Any]) -> dict[str, Any]:
    """Settings of the data for publication: folders by their names, not by where one machine has them."""
    names = {key: [Path(part.strip()).name for part in data[key].split(",")] for key in ("source", "backgrounds")}
    return {
        **data,
        **{key: ", ".join(parts) for key, parts in names.items()},
        "segmentation": bool(data["segmentation"]),
    }


class _Log:
    """Appends rows to the log and reports one line per entry."""

    def __init__(self, path: Path, report: Callable[[str], None]) -> None:
        self.path, self.report = path, report
        if not path.exists():
            write_whole(path, (",".join(LOG_COLUMNS) + "\n").encode())

    def write(self, state: TrainState, split: str, values: dict[str, float]) -> None:
        minutes = f"{state.elapsed_s / 60:.3f}"
        with self.path.open("a", newline="", encoding="utf-8") as file:
            rows = csv.writer(file)
            for name, value in values.items():
                rows.writerow([state.iteration, minutes, split, name, f"{value:.6g}"])
        shown = "  ".join(f"{name} {value:.4g}" for name, value in values.items())
        self.report(f"{state.iteration:>7}  {float(minutes):7.2f} min  {split:<10}  {shown}")


def _cut_log(path: Path, iteration: int) -> None:
    """Drop rows written after the state that a run starts from, all of them if it starts anew, and a last one that a
    kill has cut short."""
    if not path.exists():
        return
    header, *rows = path.read_text(encoding="utf-8").split("\n")[:-1]
    kept = [row for row in rows if iteration and int(row.split(",", 1)[0]) <= iteration]
    write_whole(path, ("\n".join([header, *kept]) + "\n").encode())


def _below(prefix: str, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}
