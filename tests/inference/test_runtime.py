"""OpenVINO beside signals and forks."""

import subprocess
import sys

import pytest
from tests.oracles import write_tiny_weights

OPEN = """
import os, signal, sys, threading, time
from pathlib import Path
from threading import Thread
import numpy as np
from twohands.inference.engine import load_networks
from twohands.inference.weights import read_card

folder = Path(sys.argv[1])
def opened():
    return load_networks(folder, read_card(folder))
def at_rest():
    own, threads = str(threading.get_native_id()), Path("/proc/self/task")
    stats = [task / "stat" for task in threads.iterdir() if task.name != own] if threads.exists() else []
    try:
        return all(stat.read_text().rpartition(")")[2].split()[0] == "S" for stat in stats)
    except OSError:  # a thread has ended meanwhile
        return False
def answer(networks):
    return networks.hand_seg_net(np.zeros((1, 3, 32, 64), np.float32))[0].sum()
"""


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    return write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny")


def output_of(script, folder):
    command = [sys.executable, "-c", OPEN + script, str(folder)]
    return subprocess.run(command, capture_output=True, text=True, timeout=600)


@pytest.mark.parametrize(
    "close",
    ["while networks: del networks[0]", "thread = Thread(target=networks.clear); thread.start(); thread.join()"],
)
def test_a_signal_after_the_networks_are_gone(tiny, close):
    """Named case: handlers ran on a stack that OpenVINO had freed, so that a training run died of a segmentation fault
    when its workers ended, before its last checkpoint."""
    script = f"""
networks = [opened(), opened()]
{close}
signal.signal(signal.SIGTERM, lambda *_: print("told"))
os.kill(os.getpid(), signal.SIGTERM)
"""
    run = output_of(script, tiny)
    assert (run.returncode, run.stdout) == (0, "told\n"), run.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="no fork")
@pytest.mark.parametrize("parent", ["", "del before"], ids=["open", "closed"])
def test_a_forked_process_opens_networks_of_its_own(tiny, parent):
    """Its parent's threads are not there, whether they serve or wait for another network.

    They must be at rest: a thread on its way to sleep may hold a lock, which nobody opens in the child (2 of 240 such
    children hung on a busy machine, of 840 after half a second none). Where /proc says what threads do it is asked.
    """
    script = f"""
before = opened()
expected = answer(before)
{parent}
quiet = 0
while quiet < 5:
    time.sleep(0.1)
    quiet = quiet + 1 if at_rest() else 0
child = os.fork()
if not child:
    os._exit(int(answer(opened()) != expected))
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    run = output_of(script, tiny)
    assert run.returncode == 0, run.stderr


def test_threads_that_open_openvino_at_once(tiny):
    """Named case: the networks of a preset are opened side by side, and each hid the package of statistics and put it
    back while the others still imported."""
    script = """
from concurrent.futures import ThreadPoolExecutor
from twohands.inference.runtime import import_openvino
sys.modules["openvino_telemetry"] = mine = type(sys)("openvino_telemetry")
together = threading.Barrier(8)
def imported(_):
    together.wait()
    return import_openvino()
with ThreadPoolExecutor(8) as pool:
    print(len(set(pool.map(imported, range(8)))), sys.modules["openvino_telemetry"] is mine)
"""
    run = output_of(script, tiny)
    assert (run.returncode, run.stdout) == (0, "1 True\n"), run.stderr
