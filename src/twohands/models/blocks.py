"""Residual blocks that the three networks are made of."""

from __future__ import annotations

import math
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional


def scaled(channels: int, width: float) -> int:
    """`channels` times `width`, rounded up to what matrix units take whole: a multiple of 8, beyond 32 channels of 16,
    beyond 64 of 32 (80 channels train slower than 96)."""
    asked = channels * width
    step = 8 if asked <= 32 else 16 if asked <= 64 else 32
    return max(8, step * math.ceil(asked / step - 1e-9))


class FrozenConvBn(nn.Sequential):
    """Convolution, batch normalisation by the statistics that it has, and what follows, with one convolution.

    The kernel is scaled instead of the activations: forward and backward pass take three quarters of their time.
    """

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> (B, C', H', W')."""
        convolution, norm = self[0], self[1]
        assert isinstance(convolution, nn.Conv2d) and convolution.bias is None and isinstance(norm, nn.BatchNorm2d)
        assert norm.running_mean is not None and norm.running_var is not None
        scale = norm.weight * (norm.running_var + norm.eps).rsqrt()
        kernel, bias = convolution.weight * scale[:, None, None, None], norm.bias - norm.running_mean * scale
        padding = cast(tuple[int, int], convolution.padding)
        x = functional.conv2d(x, kernel, bias, convolution.stride, padding, groups=convolution.groups)
        for layer in list(self)[2:]:
            x = layer(x)
        return x


class FrozenBatchNorm2d(nn.BatchNorm2d):
    """Batch normalisation by the statistics that it has, in training mode too."""

    def forward(self, input: Tensor) -> Tensor:
        """(B, C, H, W) -> same shape."""
        return functional.batch_norm(input, self.running_mean, self.running_var, self.weight, self.bias, eps=self.eps)


def freeze_batch_norm(module: nn.Module) -> None:
    """Let every batch normalisation keep its statistics, in place, in training mode too; all weights go on learning,
    and their names stay.

    Args:
        module: with the statistics that it is to keep.
    """
    for part in module.modules():
        if type(part) is nn.BatchNorm2d:
            part.__class__ = FrozenBatchNorm2d
        elif type(part) is nn.Sequential and [type(layer) for layer in part][:2] == [nn.Conv2d, nn.BatchNorm2d]:
            part.__class__ = FrozenConvBn


def conv_bn_relu(
    inputs: int, outputs: int, kernel: int, *, stride: int = 1, batch_norm: bool = True, relu: bool = True
) -> nn.Sequential:
    """Convolution with "same" padding, then batch normalisation and ReLU; the bias goes where no BN follows."""
    layers: list[nn.Module] = [nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=not batch_norm)]
    if batch_norm:
        layers.append(nn.BatchNorm2d(outputs))
    if relu:
        layers.append(nn.ReLU(inplace=True))
    return nn.Sequential(*layers)


class ResidualBlock(nn.Module):
    """relu(branch(x) + shortcut(x)); the base of every block, so that blocks can be counted."""

    branch: nn.Module
    shortcut: nn.Module

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> (B, C', H', W')."""
        return torch.relu(self.branch(x) + self.shortcut(x))


class BasicBlock(ResidualBlock):
    """Two 3x3 convolutions, the block of ResNet-18.

    Args:
        inputs: channels in.
        outputs: channels out.
        stride: 1, or 2 to halve the map.
    """

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        self.branch = nn.Sequential(
            conv_bn_relu(inputs, outputs, 3, stride=stride), conv_bn_relu(outputs, outputs, 3, relu=False)
        )
        self.shortcut = nn.Identity()
        if stride != 1 or inputs != outputs:
            self.shortcut = conv_bn_relu(inputs, outputs, 1, stride=stride, relu=False)


class Bottleneck(ResidualBlock):
    """1x1, 3x3, 1x1 convolutions; `planes` channels inside, 4 x `planes` out.

    Source: the encoder of the ResNet auto-encoder (docs/paper-map.md, *HandSegNet and detection*).
    """

    expansion = 4

    def __init__(self, inputs: int, planes: int, stride: int = 1) -> None:
        super().__init__()
        outputs = planes * self.expansion
        self.branch = nn.Sequential(
            conv_bn_relu(inputs, planes, 1),
            conv_bn_relu(planes, planes, 3, stride=stride),
            conv_bn_relu(planes, outputs, 1, relu=False),
        )
        self.shortcut = nn.Identity()
        if stride != 1 or inputs != outputs:
            self.shortcut = conv_bn_relu(inputs, outputs, 1, stride=stride, relu=False)


class DeconvBottleneck(ResidualBlock):
    """Bottleneck whose middle layer is a transposed 3x3 convolution when it doubles the map; 2 x `planes` out.

    Source: the decoder of the ResNet auto-encoder (docs/paper-map.md, *HandSegNet and detection*).
    """

    expansion = 2

    def __init__(self, inputs: int, planes: int, stride: int = 1) -> None:
        super().__init__()
        outputs = planes * self.expansion
        middle = conv_bn_relu(planes, planes, 3)
        self.shortcut = nn.Identity()
        if stride == 2:
            middle = nn.Sequential(
                nn.ConvTranspose2d(planes, planes, 3, stride=2, padding=1, output_padding=1, bias=False),
                nn.BatchNorm2d(planes),
                nn.ReLU(inplace=True),
            )
            self.shortcut = nn.Sequential(
                nn.ConvTranspose2d(inputs, outputs, 1, stride=2, output_padding=1, bias=False), nn.BatchNorm2d(outputs)
            )
        elif inputs != outputs:
            self.shortcut = conv_bn_relu(inputs, outputs, 1, relu=False)
        self.branch = nn.Sequential(
            conv_bn_relu(inputs, planes, 1), middle, conv_bn_relu(planes, outputs, 1, relu=False)
        )


def count_blocks(module: nn.Module) -> int:
    """Number of residual blocks inside a network, the paper's measure of depth."""
    return sum(isinstance(child, ResidualBlock) for child in module.modules())


def initialise(module: nn.Module) -> None:
    """Kaiming initialisation of every convolution and fully connected layer, zero biases."""
    for child in module.modules():
        if isinstance(child, nn.Conv2d | nn.ConvTranspose2d | nn.Linear):
            nn.init.kaiming_normal_(child.weight, nonlinearity="relu")
            if child.bias is not None:
                nn.init.zeros_(child.bias)


def calm_output(layer: nn.Conv2d | nn.Linear) -> None:
    """Small weights for an output layer, so that a fresh network answers about its bias.

    Kaiming's scale keeps activations alive between layers; at the output it only means large errors to unlearn.
    """
    nn.init.normal_(layer.weight, std=0.01)


def fold_batch_norm(module: nn.Module) -> None:
    """Merge every batch normalisation that follows a convolution in a `Sequential` into that convolution, in place.

    Args:
        module: in evaluation mode; its outputs stay the same, to rounding.
    """
    for part in module.modules():
        if not isinstance(part, nn.Sequential):
            continue
        for i in range(len(part) - 1):
            convolution, norm = part[i], part[i + 1]
            if isinstance(convolution, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d):
                part[i], part[i + 1] = nn.utils.fusion.fuse_conv_bn_eval(convolution, norm), nn.Identity()
