"""The training loop: step, validate, save, resume."""

from __future__ import annotations

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

from twohands.errors import InputError, TwoHandsError
from twohands.files import write_whole
from twohands.models.checkpoint import save_network
from twohands.training.batches import Batch, BatchDataset, SampleSource
from twohands.training.config import OptimConfig, TrainConfig
from twohands.training.loading import batch_loader, validation_batches
from twohands.training.log import RunLog, Running, cut_log
from twohands.training.parallel import process_layout, share_batch_norm
from twohands.training.replay import replayed
from twohands.training.schedule import learning_rate, progress, update_average
from twohands.training.segmenter import OpenSegmentation, Segmenter
from twohands.training.stage import Stage
from twohands.training.state import TrainState, fresh_state

STATE_FILE = "state.safetensors"
CONFIG_FILE = "config.json"
LOG_FILE = "log.csv"
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""Numbers of glibc's mallopt, from malloc.h."""


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

    On one CPU process without a limit of minutes or replay, a run that was interrupted, even killed, and resumed ends
    bitwise like one that was not. Under `torchrun`, several processes share every batch and end, to rounding, like one
    (without replay); all of them must see `out` and the pictures. Only the first one validates, writes and reports.

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
        cut_log(out / LOG_FILE, state.iteration)
        write_whole(out / CONFIG_FILE, (json.dumps(config.to_dict(), indent=2) + "\n").encode())

    held_out_batches = validation_batches(held_out, config, open_segmentation) if first else []
    log = RunLog(out / LOG_FILE, report) if first else None
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
    uses = config.data.replay
    made = batch_loader(batches, state.iteration // uses)
    clock, saved = time.monotonic() - state.elapsed_s, time.monotonic()
    with _StopSignal() as stop:
        for making_s, batch in replayed(made, uses, config.stage, config.seed + state.iteration, fabric.to_device):
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
