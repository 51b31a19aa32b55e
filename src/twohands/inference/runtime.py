"""OpenVINO's entry point, so opened that signals stay harmless."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any


def open_core() -> Any:
    """A new `openvino.Core`, its CPU plugin loaded.

    The plugin gives the thread that loads it a stack for signal handlers and frees it with the core, often without
    taking it back: when another thread closes the core, or when of several cores not the newest goes first. The next
    signal (Ctrl-C, a child process that ended) would then kill the process. So a thread loads it that ends at once.
    """
    with ThreadPoolExecutor(max_workers=1) as thread:
        return thread.submit(_open).result()


def _open() -> Any:
    import openvino

    core = openvino.Core()
    core.get_property("CPU", "FULL_DEVICE_NAME")  # loads the plugin
    return core
