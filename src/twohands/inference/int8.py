"""8-bit arithmetic for the convolutions of a network, from nothing but the peaks of its activations.

Weights get one scale per output channel, which they carry in themselves. What follows a ReLU or feeds a convolution
gets one scale, from a peak that was measured once, on pictures like those to come (`activation_peaks`), and is stored
in the weights' card. OpenVINO turns the rounding steps that are put in here into 8-bit kernels, three times as fast as
float32 where the processor has dot products of bytes. What the network is given stays as it is, and so its first layer,
and what is lost upon by rounding (`worth_rounding`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twohands.errors import CheckpointError
from twohands.inference.runtime import CONVOLUTIONS, constant_values, open_core, read_network

ACTIVATION_LEVELS = 256
"""Of what a ReLU lets through; what has either sign gets one less, symmetric about zero."""
WEIGHT_LEVELS = 255
"""Symmetric about zero."""
RECTIFIERS = ("Relu", "Clamp")
"""What is rounded from 0 on. ReLU6 comes as min(max(x, 0), 6) and is rounded as if it had either sign: the shipped
HandSegNet and its decision were chosen so (docs/history/journal.md, *What 8 bits cost*)."""
MOST_MOVED = 0.02
"""An activation whose rounding moves an output by more, root mean square, as a share of the output's standard
deviation, stays in floating point. Of some published encoders the first depthwise filters, which take differences of
neighbours, lose by it alone what the networks behind them know (docs/history/journal.md, *What 8 bits cost*)."""


def activation_peaks(path: Path, batches: Iterable[np.ndarray]) -> dict[str, float]:
    """The largest size of the values after every ReLU of a network, and of what else its convolutions are fed.

    Args:
        path: ONNX file.
        batches: inputs of the network, (B, C, H, W) float32, of any size, as many as are needed to meet what will come.

    Returns:
        Name of the node in the file -> its peak, larger than 0; ReLUs that never let anything through are left out.
    """
    core = open_core()
    model = read_network(core, path)
    nodes, own_outputs = _activations(model), len(model.outputs)
    model.add_outputs([node.output(0) for node in nodes])
    network = _opened(core, model)
    outputs = network.outputs[own_outputs:]
    peaks = np.zeros(len(nodes))
    for batch in batches:
        result = network([np.ascontiguousarray(batch, np.float32)])
        peaks = np.maximum(peaks, [np.abs(result[output]).max() for output in outputs])
    return {node.get_friendly_name(): float(peak) for node, peak in zip(nodes, peaks, strict=True) if peak > 0}


def worth_rounding(path: Path, peaks: Mapping[str, float], batches: Sequence[np.ndarray]) -> dict[str, float]:
    """The peaks of those activations that may be rounded: by itself, none moves an output by more than `MOST_MOVED`.

    Args:
        path: ONNX file.
        peaks: of `activation_peaks`.
        batches: inputs, as there; a few show it.
    """
    core = open_core()

    def outputs(peaks: Mapping[str, float]) -> list[np.ndarray]:
        model = read_network(core, path)
        quantise(model, peaks)
        network = _opened(core, model)
        found = [network([np.ascontiguousarray(batch, np.float32)]) for batch in batches]
        return [np.concatenate([np.ravel(one[port]) for one in found]) for port in network.outputs]

    exact = outputs({})

    def moved(name: str, peak: float) -> float:
        rounded = outputs({name: peak})
        return max(float((one - true).std() / max(true.std(), 1e-9)) for one, true in zip(rounded, exact, strict=True))

    return {name: peak for name, peak in peaks.items() if moved(name, peak) <= MOST_MOVED}


def quantise(model: Any, peaks: Mapping[str, float]) -> None:
    """Make a network round its activations and weights to 8 bits, in place.

    Args:
        model: as `runtime.read_network` gives it.
        peaks: of `activation_peaks`; activations beyond their peak are clipped.

    Raises:
        CheckpointError: `peaks` names a node that the network does not have.
    """
    nodes = {node.get_friendly_name(): node for node in _activations(model)}
    unknown = sorted(set(peaks) - set(nodes))
    if unknown:
        raise CheckpointError(f"card: int8 names '{unknown[0]}', which the network does not have")
    rounded = set()
    for name, peak in peaks.items():
        node = nodes[name]
        targets = list(node.output(0).get_target_inputs())
        one_sided = node.get_type_name() in RECTIFIERS
        low, levels = (0.0, ACTIVATION_LEVELS) if one_sided else (-peak, ACTIVATION_LEVELS - 1)
        rounding = _rounding(node.output(0), np.float32(low), np.float32(peak), levels)
        for target in targets:
            target.replace_source_output(rounding.output(0))
        rounded.add(rounding.get_friendly_name())
    for node in model.get_ordered_ops():
        if node.get_type_name() not in CONVOLUTIONS:
            continue
        if node.input_value(0).get_node().get_friendly_name() not in rounded:
            continue
        peak = kernel_peaks(constant_values(node.input_value(1)))
        node.input(1).replace_source_output(_rounding(node.input_value(1), -peak, peak, WEIGHT_LEVELS).output(0))
    model.validate_nodes_and_infer_types()


def kernel_peaks(kernel: np.ndarray) -> np.ndarray:
    """The largest size of a weight of every output channel, never 0.

    Args:
        kernel: (O, I, H, W) float32, or of a grouped convolution (G, O, I, H, W).

    Returns:
        (O, 1, 1, 1) or (G, O, 1, 1, 1) float32.
    """
    peaks = np.abs(kernel).max(axis=(-3, -2, -1), keepdims=True)
    return np.maximum(peaks, WEIGHT_LEVELS * np.finfo(np.float32).tiny)  # a step of it is a normal number too


def _opened(core: Any, model: Any) -> Any:
    """A network for pictures of any number and size, in floating point but for what `quantise` has rounded."""
    model.reshape([-1, model.inputs[0].partial_shape[1], -1, -1])
    return core.compile_model(model, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})


def _activations(model: Any) -> list[Any]:
    """The ReLUs that something depends on and all else that convolutions are fed but for the network's input, in the
    order of execution."""
    ordered = list(model.get_ordered_ops())
    feeding = {n.input_value(0).get_node().get_friendly_name() for n in ordered if n.get_type_name() in CONVOLUTIONS}
    return [
        node
        for node in ordered
        if (node.get_type_name() in RECTIFIERS and node.output(0).get_target_inputs())
        or (node.get_friendly_name() in feeding and node.get_type_name() != "Parameter")
    ]


def _rounding(source: Any, low: Any, high: Any, levels: int) -> Any:
    """Clip to [low, high] and round to that many levels."""
    from openvino import opset13 as opset

    low, high = opset.constant(np.asarray(low, np.float32)), opset.constant(np.asarray(high, np.float32))
    return opset.fake_quantize(source, low, high, low, high, levels)
