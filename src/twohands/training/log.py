"""The log of a training run: rows of a table, a line each to report, and the means between them."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

from twohands.files import write_whole
from twohands.training.config import TrainConfig
from twohands.training.state import TrainState

LOG_COLUMNS = ("iteration", "minutes", "split", "metric", "value")


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


class RunLog:
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


def cut_log(path: Path, iteration: int) -> None:
    """Drop rows written after the state that a run starts from, all of them if it starts anew, and a last one that a
    kill has cut short."""
    if not path.exists():
        return
    header, *rows = path.read_text(encoding="utf-8").split("\n")[:-1]
    kept = [row for row in rows if iteration and int(row.split(",", 1)[0]) <= iteration]
    write_whole(path, ("\n".join([header, *kept]) + "\n").encode())
