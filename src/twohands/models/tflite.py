"""Kernels of TensorFlow Lite files, in which others publish networks."""

from __future__ import annotations

import struct
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
        return _convolutions(model, tflite)
    except (struct.error, TypeError, ValueError, IndexError, KeyError, AttributeError) as error:
        raise CheckpointError(f"{path} is no readable TensorFlow Lite file: {error}") from error


def _convolutions(model: Any, tflite: Any) -> list[tuple[Tensor, Tensor]]:
    graph, operator = model.Subgraphs(0), tflite.BuiltinOperator
    sources: dict[int, int] = {}  # tensor -> the stored one that it widens
    found: list[tuple[Tensor, Tensor]] = []

    def stored(number: int) -> Tensor:
        tensor = graph.Tensors(sources.get(number, number))
        kind = {tflite.TensorType.FLOAT32: np.float32, tflite.TensorType.FLOAT16: np.float16}[tensor.Type()]
        content: NDArray[Any] = model.Buffers(tensor.Buffer()).DataAsNumpy()
        values = np.frombuffer(content.tobytes(), kind).reshape(tensor.ShapeAsNumpy())
        return torch.from_numpy(values.astype(np.float32))

    for i in range(graph.OperatorsLength()):
        node = graph.Operators(i)
        kind, inputs = model.OperatorCodes(node.OpcodeIndex()).BuiltinCode(), node.InputsAsNumpy()
        if kind == operator.DEQUANTIZE:
            sources[int(node.OutputsAsNumpy()[0])] = int(inputs[0])
        elif kind == operator.CONV_2D:  # outputs, rows, columns, inputs
            found.append((stored(int(inputs[1])).permute(0, 3, 1, 2).contiguous(), stored(int(inputs[2]))))
        elif kind == operator.DEPTHWISE_CONV_2D:  # 1, rows, columns, outputs
            found.append((stored(int(inputs[1])).permute(3, 0, 1, 2).contiguous(), stored(int(inputs[2]))))
    return found
