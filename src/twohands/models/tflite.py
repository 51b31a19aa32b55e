"""Kernels of TensorFlow Lite files, in which others publish networks."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from twohands.errors import CheckpointError, MissingExtraError


def read_convolutions(path: str | Path) -> list[tuple[Tensor, Tensor]]:
    """Kernels and biases of a network's convolutions, in the order in which they run.

    Args:
        path: a .tflite file with weights of 16 or 32 bits.

    Returns:
        One (kernel (outputs, inputs / groups, rows, columns), bias (outputs,)) for each, float32.

    Raises:
        MissingExtraError: the reader is not installed.
        CheckpointError: the file cannot be read or is none of that kind.
    """
    return _read(path, _convolutions)


def read_slopes(path: str | Path) -> list[Tensor]:
    """Slopes (channels,) of a network's leaky ReLUs below zero, in the order in which they run, float32; errors as of
    `read_convolutions`."""
    return _read(path, _slopes)


def read_layer(path: str | Path, name: str) -> tuple[Tensor, Tensor]:
    """Weights (outputs, inputs) and biases (outputs,) of the fully connected layer whose weights have this in their
    name, float32; errors as of `read_convolutions`."""
    weights, biases = _read(path, lambda model, tflite: _layer(model, tflite, name))
    return weights, biases


def _read(path: str | Path, of: Callable[[Any, Any], list[Any]]) -> list[Any]:
    try:
        import tflite
    except ImportError as error:
        raise MissingExtraError("reading a published encoder", "train") from error
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise CheckpointError(f"{path}: cannot be read: {error.strerror}") from error
    if content[4:8] != b"TFL3":
        raise CheckpointError(f"{path} is no TensorFlow Lite file")
    try:
        model = tflite.Model.GetRootAsModel(content, 0)
        return of(model, tflite)
    except (struct.error, TypeError, ValueError, IndexError, KeyError, AttributeError, StopIteration) as error:
        raise CheckpointError(f"{path} is no readable TensorFlow Lite file: {error}") from error


def _convolutions(model: Any, tflite: Any) -> list[tuple[Tensor, Tensor]]:
    orders = {  # of outputs, inputs / groups, rows and columns
        tflite.BuiltinOperator.CONV_2D: (0, 3, 1, 2),
        tflite.BuiltinOperator.DEPTHWISE_CONV_2D: (3, 0, 1, 2),
    }
    return [
        (kernel.permute(orders[kind]).contiguous(), bias)
        for kind, _, (kernel, bias) in _stored(model, tflite, tuple(orders))
    ]


def _slopes(model: Any, tflite: Any) -> list[Tensor]:
    return [slopes.flatten() for _, _, (slopes,) in _stored(model, tflite, (tflite.BuiltinOperator.PRELU,))]


def _layer(model: Any, tflite: Any, name: str) -> list[Tensor]:
    layers = {said: stored for _, said, stored in _stored(model, tflite, (tflite.BuiltinOperator.FULLY_CONNECTED,))}
    return next(layers[said] for said in layers if name in said.split("/"))


def _stored(model: Any, tflite: Any, kinds: tuple[int, ...]) -> Iterator[tuple[int, str, list[Tensor]]]:
    """Kind of every node of some kinds, the name of the first tensor that the file stores for it, and all of these."""
    graph = model.Subgraphs(0)
    sources: dict[int, int] = {}  # tensor -> the stored one that it widens

    def stored(number: int) -> Tensor:
        tensor = graph.Tensors(sources.get(number, number))
        kind = {tflite.TensorType.FLOAT32: np.float32, tflite.TensorType.FLOAT16: np.float16}[tensor.Type()]
        content: NDArray[Any] = model.Buffers(tensor.Buffer()).DataAsNumpy()
        values = np.frombuffer(content.tobytes(), kind).reshape(tensor.ShapeAsNumpy())
        return torch.from_numpy(values.astype(np.float32))

    for i in range(graph.OperatorsLength()):
        node = graph.Operators(i)
        kind, inputs = model.OperatorCodes(node.OpcodeIndex()).BuiltinCode(), node.InputsAsNumpy()
        if kind == tflite.BuiltinOperator.DEQUANTIZE:
            sources[int(node.OutputsAsNumpy()[0])] = int(inputs[0])
        elif kind in kinds:
            name = graph.Tensors(int(inputs[1])).Name() or b""
            yield kind, name.decode(), [stored(int(number)) for number in inputs[1:]]
