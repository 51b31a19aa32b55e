"""The same bytes from a Ray cluster as from this machine's processes, also where workers die on the way.

Ray (extra `cluster`) is not part of the tests' environment: its wheel has 79 MB, and these tests take a minute or two.
To run them: pip install -c constraints.txt '.[synth,cluster]' pytest; pytest tests/synth/production/test_ray_cluster.py
"""

from __future__ import annotations

import importlib.util
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest
from tests.synth.production.fake_production import FakeSet, make
from tests.synth.production.test_produce import contents

from twohands.cli.main import main
from twohands.errors import InputError, MissingExtraError, TwoHandsError
from twohands.executors.local import LocalProcesses
from twohands.executors.ray_cluster import RayCluster, import_ray
from twohands.synth.production.produce import Made, produce
from twohands.synth.scene.config import SynthConfig
from twohands.synth.sets.static import StaticSet

needs_ray = pytest.mark.skipif(
    importlib.util.find_spec("ray") is None,
    reason="ray is not installed (extra 'cluster'; not part of make test: with its tests it takes over a minute)",
)
TINY = SynthConfig(width=128, height=72)
OPTIONS = ["--config.width", "128", "--config.height", "72", "--format", "webdataset", "--shard-size", "5"]


@pytest.fixture(scope="module")
def cluster():
    """A cluster of two worker processes that lives for all tests of this module; runs find it open and leave it so."""
    ray = import_ray()
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    ray.init(address="local", num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    yield RayCluster()
    ray.shutdown()


@dataclass(frozen=True)
class Mortal(FakeSet):
    """A fake set whose worker is killed at some instances.

    Attributes:
        marks: folder that remembers the deaths.
        deaths: index -> how often the worker dies of it.
    """

    marks: Path = Path()
    deaths: tuple[tuple[int, int], ...] = ()

    def open(self) -> Callable[[int], Made]:
        return partial(_make_or_die, self)


def _make_or_die(fake: Mortal, index: int) -> Made:
    for death in range(dict(fake.deaths).get(index, 0)):
        mark = fake.marks / f"{index}-{death}"
        if not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
    return make(fake.seed, index)


def _open_failure() -> Callable[[int], None]:
    raise MissingExtraError("rendering", "synth")


def _open_pid() -> Callable[[int], int]:
    return _pid


def _pid(_: int) -> int:
    return os.getpid()


def _made_with_pid() -> dict[str, str]:
    return {"renderer": f"process {os.getpid()}"}


def test_workers_must_not_be_negative():
    with pytest.raises(InputError, match="workers must be 0"):
        RayCluster(workers=-1)


@pytest.mark.parametrize(
    "address", ["", "here", "here:", ":6379", "here:0", "here:x", "here:70000", "ray://here:10001"]
)
def test_an_address_is_host_and_port(address):
    with pytest.raises(InputError, match="must be 'auto' or HOST:PORT"):
        RayCluster(address)


def test_without_ray_the_extra_is_named(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtraError) as caught:
        RayCluster().check()
    assert caught.value.extra == "cluster"
    for kind in ("static", "dynamic"):
        assert main(["generate", kind, "--engine", "ray", "--out", str(tmp_path / kind)]) == 2
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 1 and "pip install 'twohands[cluster]'" in lines[0], lines
        assert not (tmp_path / kind).exists()


def test_engine_and_address_go_together(tmp_path, capsys):
    assert main(["generate", "static", "--ray-address", "auto", "--out", str(tmp_path / "set")]) == 2
    assert "--ray-address needs --engine ray" in capsys.readouterr().err
    assert main(["generate", "frames", "--engine", "ray", "--out", str(tmp_path / "set")]) == 2
    assert "leave --engine out" in capsys.readouterr().err
    assert not (tmp_path / "set").exists()


def test_an_address_without_a_cluster_is_one_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("twohands.executors.ray_cluster.import_ray", lambda: None)
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))  # taken, but not listening
        address = f"127.0.0.1:{unused.getsockname()[1]}"
        command = ["generate", "static", "--engine", "ray", "--ray-address", address, "--out", str(tmp_path / "set")]
        assert main(command) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and f"no Ray cluster answers at '{address}'" in lines[0], lines
    assert not (tmp_path / "set").exists()


def test_a_cluster_that_does_not_start_is_one_line(tmp_path, capsys, monkeypatch):
    """Named case: on a machine with too much to do Ray gives up with a plain Exception."""

    class SlowRay:
        @staticmethod
        def is_initialized():
            return False

        @staticmethod
        def init(**_):
            raise Exception("The current node timed out during startup.")

    monkeypatch.setattr("twohands.executors.ray_cluster.import_ray", lambda: SlowRay)
    assert main(["generate", "static", "--engine", "ray", "--out", str(tmp_path / "set")]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and "no Ray cluster could be started: The current node timed out" in lines[0], lines


@needs_ray
@pytest.mark.parametrize("layout", ["ego3dhands", "webdataset"])
def test_a_cluster_writes_the_same_bytes(tmp_path, cluster, layout):
    """Rendered instances, every file of the set, the index included."""
    static_set = StaticSet(TINY, seed=3, count=12)
    pids = set(cluster.run(_open_pid, range(8)))
    assert len(pids) == 2 and os.getpid() not in pids
    checked = RayCluster(made_with=static_set.made_with)
    assert produce(static_set, tmp_path / "ray", checked, layout=layout, shard_size=5).written == 12
    assert produce(static_set, tmp_path / "here", LocalProcesses(2), layout=layout, shard_size=5).written == 12
    assert contents(tmp_path / "ray") == contents(tmp_path / "here")
    if layout == "webdataset":
        assert len(list((tmp_path / "ray").glob("shard-*.tar"))) == 3


@needs_ray
def test_more_workers_than_cores_do_not_wait_for_ever(cluster):
    assert len(set(RayCluster(workers=50).run(_open_pid, range(12)))) == 2


@needs_ray
def test_errors_of_workers_arrive_as_they_were(cluster):
    with pytest.raises(MissingExtraError) as caught:
        list(cluster.run(_open_failure, [0]))
    assert caught.value.extra == "synth"


@needs_ray
def test_a_machine_that_makes_other_bytes_is_refused(cluster):
    with pytest.raises(InputError, match=r"other bytes .*renderer is process \d+ there, process \d+ here"):
        list(RayCluster(made_with=_made_with_pid).run(_open_pid, [0]))


@needs_ray
def test_a_killed_worker_is_replaced(tmp_path, cluster):
    mortal = Mortal(11, marks=tmp_path, deaths=((4, 1), (7, 1)))
    assert produce(mortal, tmp_path / "ray", cluster).written == 11
    assert (tmp_path / "4-0").exists() and (tmp_path / "7-0").exists()
    produce(FakeSet(11), tmp_path / "here", LocalProcesses(1))
    assert contents(tmp_path / "ray") == contents(tmp_path / "here")


@needs_ray
def test_where_workers_keep_dying_a_rerun_goes_on(tmp_path, cluster):
    """What came before the deadly instance is kept."""
    mortal = Mortal(20, marks=tmp_path, deaths=((14, 2),))
    with pytest.raises(TwoHandsError, match=r"worker of the Ray cluster died.*same command again"):
        produce(mortal, tmp_path / "ray", RayCluster(restarts=0))
    there = sorted((tmp_path / "ray").glob("*/*"))
    assert 6 <= len(there) <= 14  # two workers hold up to eight jobs
    assert produce(mortal, tmp_path / "ray", RayCluster(restarts=1)).written == 20 - len(there)
    produce(FakeSet(20), tmp_path / "here", LocalProcesses(1))
    assert contents(tmp_path / "ray") == contents(tmp_path / "here")


@needs_ray
@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_command_goes_on(tmp_path, capsys, how):
    """Ctrl-C, to the whole process group as a terminal sends it, and the end of the command itself; what was written
    stays as it was, and the same command makes the rest."""
    command = ["generate", "static", "--out", str(tmp_path / "ray"), "--seed", "5", *OPTIONS]
    cluster = ["--engine", "ray", "--workers", "2"]
    errors = _interrupted([*command, *cluster, "--count", "400"], tmp_path / "ray" / "index.jsonl", how)
    if how == signal.SIGINT:
        assert errors.splitlines()[-1] == "twohands: interrupted" and "Traceback" not in errors, errors
        assert "run the same command again" in errors
    kept = contents(tmp_path / "ray")["index.jsonl"]
    count = len(kept.splitlines()) + 3
    done = subprocess.run(
        [sys.executable, "-m", "twohands.cli.main", *command, *cluster, "--count", str(count)],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert contents(tmp_path / "ray")["index.jsonl"].startswith(kept)
    produce(StaticSet(TINY, 5, count), tmp_path / "here", LocalProcesses(2), layout="webdataset", shard_size=5)
    assert contents(tmp_path / "ray") == contents(tmp_path / "here")


def _interrupted(arguments: list[str], index: Path, how: signal.Signals) -> str:
    """Starts a command, stops it as soon as its index holds something, returns what it said on stderr."""
    command = [sys.executable, "-m", "twohands.cli.main", *arguments]
    said = index.parent.with_suffix(".stderr")  # not a pipe, which stays open until Ray's last process has noticed
    with said.open("w") as file:
        run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=file, start_new_session=True)
    while run.poll() is None and not (index.is_file() and index.stat().st_size):
        time.sleep(0.05)
    assert run.poll() is None
    if how == signal.SIGINT:
        os.killpg(run.pid, how)
    else:
        os.kill(run.pid, how)
    assert run.wait(timeout=120) == (130 if how == signal.SIGINT else -how)
    return said.read_text()
