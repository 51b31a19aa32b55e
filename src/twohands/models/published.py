"""How kernels that others have published come into encoders of ours."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor, nn

BATCH_NORM_EPS = 1e-3
MEDIAPIPE = "the wheel mediapipe 0.10.21"


def fill_layers(
    layers: Sequence[tuple[nn.Conv2d, nn.BatchNorm2d | None]], stored: Sequence[tuple[Tensor, Tensor]]
) -> None:
    """Kernels of which normalisations are a part already: those behind them change nothing but add the biases.

    Args:
        layers: convolutions in the order in which they run, with what normalises them, if anything does; changed in
            place. The first one is fed (x - 128) / 256 of grey values x.
        stored: a kernel and bias for each; the first one wants x / 255.

    Raises:
        ValueError, RuntimeError: they do not fit.
    """
    for i, ((convolution, norm), (kernel, bias)) in enumerate(zip(layers, stored, strict=True)):
        if i == 0:  # x / 255 = (256 ours + 128) / 255
            kernel, bias = 256 / 255 * kernel, bias + 128 / 255 * kernel.sum(dim=(1, 2, 3))
        convolution.load_state_dict({"weight": kernel})
        if norm is None:
            if bias.any():
                raise ValueError("a bias where none is expected")
            continue
        ones, zeros = torch.ones_like(bias), torch.zeros_like(bias)
        statistics = {"running_mean": zeros, "running_var": ones - BATCH_NORM_EPS}
        norm.load_state_dict({"weight": ones, "bias": bias, **statistics}, strict=False)


def described(name: str, source: str, path: Path) -> dict[str, str]:
    """What a card says of a published encoder: name, source, licence, and the file's SHA-256."""
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return {"name": name, "source": source, "licence": "Apache-2.0", "sha256": digest}
