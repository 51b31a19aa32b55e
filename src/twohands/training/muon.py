"""Muon: an optimizer that moves every direction of a layer alike."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

HIDDEN = 32
"""Least inputs and outputs of a layer that Muon moves: first layers and those that give maps have fewer."""
COEFFICIENTS = (3.4445, -4.7750, 2.0315)
"""Of the odd polynomial that draws singular values towards 1; chosen by its authors for speed, it ends in 0.7..1.2."""
STEPS = 5
UPDATE_RMS = 0.2
"""Root mean square of an update before the learning rate, about that of AdamW's, so that its rates carry over."""


class Muon(torch.optim.AdamW):
    """Momentum whose matrices are orthogonalised before the step, for hidden layers; AdamW for all else.

    The gradient of a layer is dominated by a few directions; a rare one, which may tell left from right, is lost beside
    them. Setting all singular values of the momentum to about 1 gives it the same weight. Convolutions count as
    matrices (outputs, inputs x rows x columns), transposed ones as (inputs, outputs x rows x columns).

    Args:
        params: groups as for AdamW; those with "muon": True must hold matrices or convolutions only. They may have a
            "momentum" of their own.
        momentum: of Muon's groups.
        further: passed on to AdamW.

    Source: K. Jordan et al., "Muon: an optimizer for hidden layers in neural networks", 2024; scale of the update from
    J. Liu et al., "Muon is scalable for LLM training", 2025, section 2.2.
    """

    def __init__(self, params: Any, *, momentum: float = 0.95, **further: Any) -> None:
        super().__init__(params, **further)
        for group in self.param_groups:
            if group.get("muon"):
                group.setdefault("momentum", momentum)

    @torch.no_grad()
    def step(self) -> None:  # type: ignore[override]
        """One update; gradients of Muon's groups are used up."""
        for group in self.param_groups:
            if group.get("muon"):
                by_shape: dict[torch.Size, list[Tensor]] = defaultdict(list)
                for parameter in group["params"]:
                    if parameter.grad is not None:
                        by_shape[parameter.shape].append(parameter)
                for alike in by_shape.values():
                    self._move(alike, group)
        super().step()

    def _move(self, alike: Sequence[Tensor], group: dict[str, Any]) -> None:
        """Move layers of one shape, all at once: a GPU has little to do for one."""
        ahead = torch.stack([self._ahead(parameter, group["momentum"]) for parameter in alike])
        updates = orthogonalised(ahead.flatten(2)).view(ahead.shape)
        size = UPDATE_RMS * max(len(alike[0]), alike[0][0].numel()) ** 0.5
        for parameter, update in zip(alike, updates, strict=True):
            parameter.mul_(1 - group["lr"] * group["weight_decay"]).add_(update, alpha=-group["lr"] * size)
            parameter.grad = None

    def _ahead(self, parameter: Tensor, share: float) -> Tensor:
        """Nesterov's mean of the gradient and the momentum that it has changed."""
        state, gradient = self.state[parameter], parameter.grad
        assert gradient is not None
        if not state:
            state["step"] = torch.zeros(())  # AdamW looks for it when a state is loaded
            state["momentum"] = torch.zeros_like(parameter)
        state["step"] += 1
        momentum = state["momentum"].lerp_(gradient, 1 - share)
        return gradient.lerp(momentum, share)


def is_hidden(parameter: Tensor) -> bool:
    """Whether Muon moves a parameter of recipe `ours`: a matrix or convolution with enough inputs and outputs."""
    return parameter.ndim > 1 and min(parameter.shape[:2]) >= HIDDEN


def orthogonalised(matrices: Tensor) -> Tensor:
    """Nearly the orthogonal matrix nearest to each given one: same singular vectors, singular values in about 0.7..1.2.

    A Newton-Schulz iteration, carried out on the Gram matrix of the shorter side, which is several times cheaper than
    on the matrix itself for the long rows of convolutions.

    Args:
        matrices: (..., R, C) float32.

    Returns:
        (..., R, C) float32.
    """
    if matrices.shape[-2] > matrices.shape[-1]:
        return orthogonalised(matrices.mT).mT
    matrices = matrices / matrices.norm(dim=(-2, -1), keepdim=True).clamp_min(1e-12)
    gram = matrices @ matrices.mT
    total = identity = torch.eye(gram.shape[-1], dtype=gram.dtype, device=gram.device)
    a, b, c = COEFFICIENTS
    for _ in range(STEPS):
        factor = a * identity + b * gram + c * (gram @ gram)
        total = factor @ total
        gram = factor @ gram @ factor
    return total @ matrices
