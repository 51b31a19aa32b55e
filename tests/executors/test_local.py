"""Processes that share work: order kept, errors handed over, deaths noticed."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from twohands.errors import InputError, TwoHandsError
from twohands.executors import local
from twohands.executors.local import LocalProcesses

BIG = 20_000_000


def open_big():
    """Answers that no pipe takes at once."""
    return lambda index: bytes([index % 256]) * BIG


def open_picky():
    def work(index):
        if index == 5:
            raise InputError("five is refused")
        return index

    return work


def test_results_come_in_the_order_of_the_indices():
    results = list(LocalProcesses(2).run(open_big, iter(range(7, 13))))
    assert [(len(r), r[0]) for r in results] == [(BIG, i) for i in range(7, 13)]


def open_late_first():
    """The first one waits until another process has done the last one, for a minute at most."""

    def work(index):
        path, began = Path(os.environ["TWOHANDS_TEST_MARK"]), time.monotonic()
        if index == 5:
            path.touch()
        while index == 0 and not path.exists() and time.monotonic() < began + 60:
            time.sleep(0.01)
        return index

    return work


def test_without_order_a_slow_job_holds_nobody_up(tmp_path, monkeypatch):
    monkeypatch.setenv("TWOHANDS_TEST_MARK", str(tmp_path / "mark"))
    assert list(LocalProcesses(2).run(open_late_first, range(6), in_order=False)) == [1, 2, 3, 4, 5, 0]


def test_an_error_comes_after_the_results_before_it():
    seen = []
    with pytest.raises(InputError, match="five is refused"):
        for result in LocalProcesses(2).run(open_picky, range(20)):
            seen.append(result)
    assert seen == list(range(5))


def test_a_worker_killed_in_the_middle_of_its_answer_is_noticed():
    """Named case: half an answer in a pipe shared by all workers left the run waiting for ever."""
    before = set(multiprocessing.active_children())
    results = LocalProcesses(2).run(open_big, range(40))
    next(results)
    workers = sorted(set(multiprocessing.active_children()) - before, key=lambda process: process.pid)
    assert len(workers) == 2
    os.kill(workers[0].pid, signal.SIGKILL)  # it waits for a reader, most of its next answer unsent
    with pytest.raises(TwoHandsError, match="a worker process died"):
        for _ in results:
            pass
    for worker in workers:
        worker.join(60)
        assert not worker.is_alive()


def interrupted_import():
    signal.raise_signal(signal.SIGINT)
    return open_picky


class OpenerOfAnInterruptedImport:
    """Ctrl-C comes while a worker unpickles it, as it imports what a worker needs."""

    def __call__(self):
        return open_picky()

    def __reduce__(self):
        return interrupted_import, ()


PROGRAM = """
import os, sys, time
from twohands.executors.local import LocalProcesses

def open_slow():
    def work(index):
        open(os.path.join(sys.argv[1], str(os.getpid())), "w").close()
        time.sleep(600)
    return work

if __name__ == "__main__":
    list(LocalProcesses(2).run(open_slow, range(2), in_order=False))
"""


def _runs(pid: str) -> bool:
    """Whether a process runs; one that has ended may be there until somebody asks what became of it."""
    try:
        return Path("/proc", pid, "stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="processes are looked up in /proc")
def test_workers_of_a_killed_process_end_in_the_middle_of_their_jobs(tmp_path):
    """Named case: a worker went on with its clip, and moved away what the resumed run was writing."""
    (tmp_path / "program.py").write_text(PROGRAM)
    (tmp_path / "pids").mkdir()
    command = [sys.executable, str(tmp_path / "program.py"), str(tmp_path / "pids")]
    process = subprocess.Popen(command)
    try:
        until = time.monotonic() + 600
        while len(pids := list((tmp_path / "pids").iterdir())) < 2:
            assert process.poll() is None and time.monotonic() < until
            time.sleep(0.05)
    finally:
        process.kill()
        process.wait()
    until = time.monotonic() + 60
    while any(_runs(pid.name) for pid in pids):
        assert time.monotonic() < until
        time.sleep(0.05)


def open_tidy():
    """Waits until it is told to leave, and removes its file then."""

    def work(index):
        path = Path(os.environ["TWOHANDS_TEST_MARK"], str(index))
        path.touch()
        try:
            time.sleep(600)
        finally:
            path.unlink()

    return work


@pytest.mark.skipif(sys.platform == "win32", reason="processes are told nothing before they end")
def test_busy_workers_are_let_go_together_and_clean_up(tmp_path, monkeypatch):
    """Named case: Ctrl-C waited 5 s for each of N busy workers, and left downloads and half-written folders."""
    monkeypatch.setenv("TWOHANDS_TEST_MARK", str(tmp_path))

    def indices():
        """Interrupts once all four are busy: three hold a number more, the fourth is about to get one."""
        yield from range(7)
        until = time.monotonic() + 600
        while len(list(tmp_path.iterdir())) < 4:
            assert time.monotonic() < until
            time.sleep(0.05)
        interrupted_s.append(time.monotonic())
        raise KeyboardInterrupt

    interrupted_s: list[float] = []
    before = set(multiprocessing.active_children())
    with pytest.raises(KeyboardInterrupt):
        list(LocalProcesses(4).run(open_tidy, indices()))
    assert time.monotonic() - interrupted_s[0] < 4 * local.GRACE_S
    assert set(multiprocessing.active_children()) == before
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="no signal masks")
def test_an_interrupt_does_not_reach_a_worker_that_still_imports(capfd):
    """Named case: Ctrl-C in the first second printed tracebacks of workers; who started them ends them."""
    assert list(LocalProcesses(2).run(OpenerOfAnInterruptedImport(), range(4))) == list(range(4))
    assert "Traceback" not in capfd.readouterr().err
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
