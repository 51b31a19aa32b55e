"""Several processes make the steps of one: same batches, same gradients, same statistics."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from tests.training import one_of_many
from tests.training.one_of_many import STAGES, STEPS, config, pictures, start, train_all

from twohands.models.checkpoint import load_tensors
from twohands.training.batches import BatchDataset
from twohands.training.parallel import process_layout
from twohands.training.stages import build_stage

ROOT = Path(one_of_many.__file__).parents[2]


@pytest.fixture(scope="module")
def folders(tmp_path_factory) -> dict[int, Path]:
    """Number of processes -> folder with the run of every stage."""
    found = {count: tmp_path_factory.mktemp(f"processes{count}") for count in (1, 2)}
    start("pose_net_3d", found[2])  # written once, read by both
    train_all(found[1])
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    command += ["-m", "tests.training.one_of_many", str(found[2])]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": ""}
    ended = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=900)
    assert ended.returncode == 0, ended.stderr[-3000:]
    return found


@pytest.mark.parametrize("stage", STAGES)
def test_two_processes_end_like_one(folders, stage):
    """Weights, averages and batch statistics, compared with how far they have moved; rounding grows from step to step,
    but parts averaged without regard to their hands, or batch statistics of each part, are ten times further apart."""
    one, two = (load_tensors(folders[count] / stage / "state.safetensors")[0] for count in (1, 2))
    fresh = build_stage(config(stage), start(stage, folders[1])).state_dict()
    assert one.keys() == two.keys()
    for what, share in (("weight", 0.05), ("bias", 0.05), ("running_mean", 1e-3), ("running_var", 1e-3)):
        for kind in ("stage", "average"):
            names = [name for name in fresh if name.endswith(what)]
            moved = torch.cat([(one[f"{kind}.{name}"] - fresh[name]).flatten() for name in names]).norm()
            apart = torch.cat([(one[f"{kind}.{name}"] - two[f"{kind}.{name}"]).flatten() for name in names]).norm()
            assert moved > 0 and apart < share * moved, (what, kind, float(moved), float(apart))


@pytest.mark.parametrize("stage", STAGES)
def test_the_log_is_that_of_one_process(folders, stage):
    logs = []
    for count in (1, 2):
        rows = [line.split(",") for line in (folders[count] / stage / "log.csv").read_text().splitlines()[1:]]
        logs.append({(int(row[0]), row[3]): float(row[4]) for row in rows if row[2] == "train"})
    assert logs[0].keys() == logs[1].keys() and len({step for step, _ in logs[0]}) == STEPS
    for key, value in logs[0].items():
        assert logs[1][key] == pytest.approx(value, rel=1e-3), key


def test_the_parts_are_uneven_and_some_are_empty():
    """What makes the comparison above a hard one. Named case: a process whose crops show no hand, beside one with
    hands, let its batch normalisation see them."""
    shares = [
        [BatchDataset(pictures(), config("pose_net_2d"), rank, 2)[step]["hand"] for rank in (0, 1)]
        for step in range(STEPS)
    ]
    hands = [[int(part.sum()) for part in pair] for pair in shares]
    assert all(max(pair) > 0 for pair in hands)
    assert any(0 in map(len, pair) for pair in shares)
    assert any(len(part) > 0 and part.sum() == 0 for pair in shares for part in pair)
    assert any(a != b and min(a, b) > 0 for a, b in hands)


def test_the_layout_is_what_torchrun_says(monkeypatch):
    for name in ("WORLD_SIZE", "LOCAL_WORLD_SIZE"):
        monkeypatch.delenv(name, raising=False)
    assert process_layout() == (1, 1)
    monkeypatch.setenv("WORLD_SIZE", "6")
    monkeypatch.setenv("LOCAL_WORLD_SIZE", "2")
    assert process_layout() == (2, 3)
