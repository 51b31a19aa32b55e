"""Kills a run of the generator at random moments, lets it go on, and compares the result with an undisturbed run.

    python benchmarks/kill_test.py --kills 20

Every round starts `twohands generate static` with two workers and ends it with SIGKILL after a random time: the process
that writes, all of its processes, or one of its workers. Then the run is finished. Prints what happened; exit code 1 if
a byte differs, a process outlives its run, or too much work was lost.
"""

from __future__ import annotations

import argparse
import filecmp
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

WAIT_S = 20.0
START_S = 4.0


def command(out: Path, count: int, layout: str) -> list[str]:
    """The run: small pictures, so that there are many instances to be killed between."""
    size = ["--config.width", "128", "--config.height", "72", "--shard-size", "25"]
    options = ["--count", str(count), "--seed", "5", "--workers", "2", "--format", layout]
    return [sys.executable, "-m", "twohands.cli.main", "generate", "static", "--out", str(out), *options, *size]


def workers_of(pid: int) -> list[int]:
    """Process ids of a run's workers, from /proc; multiprocessing's own helper process is none."""
    try:
        children = [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
        return [child for child in children if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()]
    except OSError:
        return []


def kill_at_random(arguments: list[str], out: Path, rng: random.Random) -> str:
    """Starts a run and kills it; returns who was killed, or "finished" if it was too quick.

    One time in four the moment is drawn from the run's first seconds, else from those after some new instances.
    """
    run = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    if rng.random() < 0.25:
        time.sleep(rng.uniform(0.1, START_S))
    else:
        wanted = listed(out) + rng.randint(1, 30)
        while run.poll() is None and listed(out) < wanted:
            time.sleep(0.01)
        time.sleep(rng.uniform(0, 0.3))
    if run.poll() is not None:
        return "finished"
    family = workers_of(run.pid)
    victim = rng.choice(["writer", "all", "worker"])
    if victim == "worker" and family:
        os.kill(rng.choice(family), signal.SIGKILL)
    elif victim == "all":
        os.killpg(run.pid, signal.SIGKILL)
    else:
        victim = "writer"
        os.kill(run.pid, signal.SIGKILL)
    run.wait(timeout=WAIT_S)
    deadline = time.monotonic() + WAIT_S
    while any(Path(f"/proc/{pid}").exists() for pid in family):
        if time.monotonic() > deadline:
            sys.exit(f"processes {family} outlived their run by {WAIT_S:.0f} s")
        time.sleep(0.05)
    return victim


def listed(out: Path) -> int:
    """Whole lines of the index: instances that are safe."""
    index = out / "index.jsonl"
    return index.read_text().count("\n") if index.is_file() else 0


def differences(one: Path, two: Path) -> list[str]:
    """Paths that are not the same bytes in both folders, hidden ones included."""
    names = {p.relative_to(root) for root in (one, two) for p in root.rglob("*") if not p.is_dir()}
    both = {name for name in names if (one / name).is_file() and (two / name).is_file()}
    differ = [name for name in both if not filecmp.cmp(one / name, two / name, shallow=False)]
    return sorted(map(str, [*(names - both), *differ]))


def main() -> int:
    """Runs the test."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--count", type=int, default=2000, help="instances; more than the kills leave time for")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    parser.add_argument("--format", choices=["ego3dhands", "webdataset"], default="ego3dhands")
    args = parser.parse_args()
    rng = random.Random(args.seed)
    with tempfile.TemporaryDirectory() as folder:
        killed, whole = Path(folder) / "killed", Path(folder) / "whole"
        for number in range(args.kills):
            before = listed(killed)
            victim = kill_at_random(command(killed, args.count, args.format), killed, rng)
            there = listed(killed)
            print(f"kill {number + 1:2d}: {victim:8s} {before} -> {there} instances", flush=True)
            if there < before:
                print("instances were lost")
                return 1
        for out in (killed, whole):
            subprocess.run(command(out, args.count, args.format), check=True, stdout=subprocess.DEVNULL)
        different = differences(killed, whole)
    print("identical" if not different else f"{len(different)} files differ: {', '.join(different[:5])}")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
