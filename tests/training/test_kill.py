"""A run that is killed at random moments, and resumed each time, ends bitwise like an undisturbed one."""

import json
import multiprocessing
import os
import random
import signal
import subprocess
import sys
import time
from multiprocessing.process import BaseProcess
from pathlib import Path

import torch
from tests.training import killed_run

from twohands.models.checkpoint import load_tensors

ROOT = Path(killed_run.__file__).parents[2]
KILLS = 4


def steps_done(folder: Path) -> int:
    """Steps that the log tells of, also of those that a kill takes back."""
    log = folder / "log.csv"
    return log.read_text().count(",train,loss,") if log.is_file() else 0


def start(folder: Path) -> BaseProcess:
    """Starts or resumes the run in a process of its own; torch, which takes seconds, is imported once for all."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([killed_run.__name__])
    process = context.Process(target=killed_run.run, args=(folder, 0))
    process.start()
    return process


def end(run: BaseProcess) -> None:
    """Waits for the end of a run that nobody kills."""
    run.join(600)
    assert run.exitcode == 0


def kill_after_some_steps(folder: Path, rng: random.Random) -> None:
    """Starts or resumes the run, lets it do a few steps, kills it at a random moment of the next one: while it
    computes, validates or writes."""
    run = start(folder)
    wanted = steps_done(folder) + rng.randint(1, 4)
    while run.is_alive() and steps_done(folder) < wanted:
        time.sleep(0.005)
    time.sleep(rng.uniform(0, 0.2))
    assert run.is_alive(), "ended before it was killed"
    run.kill()
    run.join()


def train_rows(folder: Path) -> list[tuple[str, ...]]:
    """Rows of the log without their times."""
    rows = [line.split(",") for line in (folder / "log.csv").read_text().splitlines()]
    return [(row[0], *row[2:]) for row in rows if row[2] in ("train", "validation")]


def test_killed_and_resumed_equals_undisturbed(tmp_path):
    rng = random.Random(time.time_ns())
    killed, whole = tmp_path / "killed", tmp_path / "whole"
    for _ in range(KILLS):
        kill_after_some_steps(killed, rng)
    for folder in (killed, whole):
        end(start(folder))
    for name in ("state", "pose_net_2d", "pose_net_3d"):
        a, b = (load_tensors(folder / f"{name}.safetensors")[0] for folder in (killed, whole))
        assert a.keys() == b.keys()
        assert all(torch.equal(a[key], b[key]) for key in a), name
    assert train_rows(killed) == train_rows(whole)


def test_killed_before_the_first_step(tmp_path):
    """The folder is resumable as soon as it claims to be a run."""
    folder = tmp_path / "run"
    run = start(folder)
    while run.is_alive() and not (folder / "config.json").is_file():
        time.sleep(0.001)
    run.kill()
    run.join()
    assert (folder / "state.safetensors").is_file()
    end(start(folder))


def test_a_request_to_end_that_reaches_the_workers_too_ends_the_run_after_the_step(tmp_path):
    """Named case: the workers died of it first, and the run with them; schedulers signal all of a job's processes."""
    folder = tmp_path / "run"
    command = [sys.executable, "-m", "tests.training.killed_run", str(folder), "1"]
    run = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True, start_new_session=True)
    while run.poll() is None and steps_done(folder) < 2:
        time.sleep(0.005)
    os.killpg(run.pid, signal.SIGTERM)
    errors = run.communicate(timeout=600)[1]
    assert errors.rstrip().endswith("KeyboardInterrupt") and "DataLoader worker" not in errors
    state = json.loads(load_tensors(folder / "state.safetensors")[1]["state"])
    assert state["iteration"] == steps_done(folder)
