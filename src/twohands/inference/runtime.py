"""OpenVINO's entry point, so opened that signals stay harmless and nothing is sent, and how it reads a network."""

from __future__ import annotations

import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

_IMPORTING = threading.Lock()

CONVOLUTIONS = ("Convolution", "GroupConvolution")


def open_core() -> Any:
    """A new `openvino.Core`, its CPU plugin loaded.

    The plugin gives the thread that loads it a stack for signal handlers and frees it with the core, often without
    taking it back: when another thread closes the core, or when of several cores not the newest goes first. The next
    signal (Ctrl-C, a child process that ended) would then kill the process. So a thread loads it that ends at once.
    """
    with ThreadPoolExecutor(max_workers=1) as thread:
        return thread.submit(_open).result()


def import_openvino() -> Any:
    """The package `openvino`, without what it sends home.

    When imported, it looks up its maker's statistics server and leaves a number for this user in the home folder,
    unless the package `openvino_telemetry` is missing. So that one is missing for as long as the import takes.
    """
    name = "openvino_telemetry"
    with _IMPORTING:  # else one thread puts the name back while another still imports
        before = {name: sys.modules[name]} if name in sys.modules else {}
        sys.modules[name] = None  # type: ignore[assignment]
        try:
            import openvino
        finally:
            del sys.modules[name]
            sys.modules.update(before)
    return openvino


def _open() -> Any:
    core = import_openvino().Core()
    core.get_property("CPU", "FULL_DEVICE_NAME")  # loads the plugin
    return core


def read_network(core: Any, path: Path) -> Any:
    """`core.read_model`, every kernel a plain constant: what a file stores in 8 bits would else be multiplied out for
    every picture, and what it stores in 16 may be multiplied in these.

    Raises:
        RuntimeError: the file cannot be read.
    """
    from openvino import opset13 as opset

    model = core.read_model(path)
    for node in model.get_ordered_ops():
        if path.suffix == ".tflite":
            if node.get_type_name() == "Convert" and node.input_value(0).get_node().get_type_name() == "Constant":
                node.output(0).replace(opset.constant(constant_values(node.output(0))).output(0))
            continue
        if node.get_type_name() not in CONVOLUTIONS:
            continue
        kernel = node.input_value(1)
        if kernel.get_node().get_input_size():
            node.input(1).replace_source_output(opset.constant(constant_values(kernel)).output(0))
    return model


def constant_values(source: Any) -> np.ndarray:
    """Values of a weight as float32, stored as such, as float16 to be converted, or as bytes to be converted and
    scaled; of grouped convolutions, in the shape that they want.

    Args:
        source: an output of a node.
    """
    node = source.get_node()
    kind = node.get_type_name()
    if kind == "Multiply":
        return constant_values(node.input_value(0)) * constant_values(node.input_value(1))
    if kind == "Reshape":
        return constant_values(node.input_value(0)).reshape(tuple(node.output(0).shape))
    return constant_values(node.input_value(0)) if kind == "Convert" else np.asarray(node.data, np.float32)
