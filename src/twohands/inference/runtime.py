"""OpenVINO's entry point, opened once."""

from __future__ import annotations

import os
from typing import Any
from weakref import WeakValueDictionary

_CORES: WeakValueDictionary[int, Any] = WeakValueDictionary()
"""Of every process by its number."""


def openvino_core() -> Any:
    """The `openvino.Core` of this process, to be held by all that it opens; it closes with the last of them.

    OpenVINO's CPU plugin gives the calling thread a stack for signal handlers and frees it with its core. Of several
    cores the one closed last puts back a stack that is freed already, and the next signal (Ctrl-C, a child process that
    ended) kills the process. `openvino.compile_model` opens a core with every call, so it is of no use here.

    Closed it must be: a forked process can open OpenVINO only if no idle threads of its parent's are left behind. Nor
    can it use its parent's core.
    """
    core = _CORES.get(os.getpid())
    if core is None:
        import openvino

        core = _CORES[os.getpid()] = openvino.Core()
    return core
