"""Muon moves all directions of a layer alike."""

import pytest
import torch
from torch import nn

from twohands.training.muon import UPDATE_RMS, Muon, orthogonalised


def spread(rows: int, columns: int) -> torch.Tensor:
    """A matrix with singular values from 1 down to 0.05."""
    torch.manual_seed(3)
    u, v = (torch.linalg.qr(torch.randn(size, min(rows, columns)))[0] for size in (rows, columns))
    return u @ torch.diag(torch.linspace(1, 0.05, min(rows, columns))) @ v.T


@pytest.mark.parametrize("shape", [(6, 40), (40, 6), (32, 32)])
def test_all_singular_values_become_about_one(shape):
    given = spread(*shape)
    u, values, v = torch.linalg.svd(given, full_matrices=False)
    assert values.max() / values.min() > 10
    result = orthogonalised(given)
    assert result.shape == shape
    inner = u.T @ result @ v.T
    assert inner.diagonal().min() > 0.6 and inner.diagonal().max() < 1.25
    torch.testing.assert_close(inner, torch.diag(inner.diagonal()), atol=1e-3, rtol=0)  # the same singular vectors


@pytest.mark.parametrize("factor", [1e-8, 1.0, 1e8])
def test_the_scale_of_the_gradient_does_not_matter(factor):
    torch.testing.assert_close(orthogonalised(factor * spread(8, 20)), orthogonalised(spread(8, 20)))


def test_no_gradient_direction_no_step():
    assert torch.equal(orthogonalised(torch.zeros(4, 9)), torch.zeros(4, 9))


def test_a_step_of_a_convolution_has_the_size_of_adamws():
    torch.manual_seed(0)
    layer = nn.Conv2d(16, 48, 3, bias=False)
    before = layer.weight.detach().clone()
    optimizer = Muon([{"params": [layer.weight], "muon": True}], lr=0.01, weight_decay=0.0)
    layer.weight.grad = torch.randn_like(layer.weight)
    optimizer.step()
    moved = (layer.weight.detach() - before).square().mean().sqrt()
    assert float(moved) == pytest.approx(0.01 * UPDATE_RMS, rel=0.2)
    assert layer.weight.grad is None


def test_weight_decay_is_apart_from_the_gradient():
    weight = nn.Parameter(torch.ones(4, 8))
    optimizer = Muon([{"params": [weight], "muon": True}], lr=0.1, weight_decay=0.5)
    weight.grad = torch.zeros_like(weight)
    optimizer.step()
    torch.testing.assert_close(weight.detach(), torch.full((4, 8), 0.95))


def test_nesterov_momentum_by_hand():
    """Rank-one gradients keep their direction: only the sign of the mixed gradient can be seen in the step."""
    weight = nn.Parameter(torch.zeros(1, 4))
    optimizer = Muon([{"params": [weight], "muon": True}], momentum=0.9, lr=1.0, weight_decay=0.0)
    steps = []
    # Momentum .1, then .9 x .1 - .1 x .6 = .03, of the gradients' sign before; ahead: .1 x -.6 + .9 x .03 = -.033.
    for gradient in (1.0, -0.6):
        before = weight.detach().clone()
        weight.grad = torch.full((1, 4), gradient)
        optimizer.step()
        steps.append(weight.detach() - before)
    assert bool((steps[0] < 0).all()) and bool((steps[1] > 0).all())
    assert float(optimizer.state[weight]["momentum"][0, 0]) == pytest.approx(0.03)


def test_other_groups_are_moved_by_adamw():
    torch.manual_seed(1)
    ours, theirs = (nn.Parameter(torch.ones(5)) for _ in range(2))
    muon = Muon([{"params": [ours]}], lr=0.01, weight_decay=0.1)
    adamw = torch.optim.AdamW([theirs], lr=0.01, weight_decay=0.1)
    for _ in range(3):
        gradient = torch.randn(5)
        for parameter, optimizer in ((ours, muon), (theirs, adamw)):
            parameter.grad = gradient.clone()
            optimizer.step()
    assert torch.equal(ours, theirs)


def test_layers_of_one_shape_move_as_each_would_alone():
    torch.manual_seed(0)
    shapes = [(40, 36, 3, 3), (40, 36, 3, 3), (64, 40), (36, 40)]
    start = [torch.randn(shape) for shape in shapes]
    together, alone = ([nn.Parameter(values.clone()) for values in start] for _ in range(2))
    settings = {"lr": 1e-2, "weight_decay": 0.1}
    optimizers = [Muon([{"params": together, "muon": True}], **settings)]
    optimizers += [Muon([{"params": [weight], "muon": True}], **settings) for weight in alone]
    for _ in range(3):
        for one, other in zip(together, alone, strict=True):
            one.grad = torch.randn(one.shape)
            other.grad = one.grad.clone()
        for optimizer in optimizers:
            optimizer.step()
    for one, other, before in zip(together, alone, start, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-5)
        assert (one - before).abs().max() > 1e-3
