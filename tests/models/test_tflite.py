"""Kernels of TensorFlow Lite files."""

import numpy as np
import pytest
import torch
from tests.tflite_files import tflite_file

from twohands.errors import CheckpointError
from twohands.models.tflite import read_convolutions


@pytest.mark.parametrize("kind", [np.float16, np.float32])
def test_kernels_and_biases_come_in_their_order_and_torchs_layout(tmp_path, kind):
    rng = np.random.default_rng(0)
    shapes = [(8, 3, 3, 3), (8, 1, 5, 5), (4, 8, 1, 1)]
    layers = [(rng.normal(size=shape).astype(kind), rng.normal(size=shape[0]).astype(kind)) for shape in shapes]
    path = tmp_path / "net.tflite"
    path.write_bytes(tflite_file(layers))
    for given, found in zip(layers, read_convolutions(path), strict=True):
        for theirs, ours in zip(given, found, strict=True):
            assert torch.equal(ours, torch.from_numpy(theirs.astype(np.float32)))


@pytest.mark.parametrize("damage", ["missing", "empty", "text", "cut"])
def test_a_file_that_is_none_is_refused_in_one_line(tmp_path, damage):
    path = tmp_path / "net.tflite"
    whole = tflite_file([(np.ones((8, 3, 3, 3), np.float16), np.zeros(8, np.float16))])
    content = {"empty": b"", "text": b"weights of a network", "cut": whole[:200]}.get(damage)
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(CheckpointError, match=r"net\.tflite") as caught:
        read_convolutions(path)
    assert "\n" not in str(caught.value)
