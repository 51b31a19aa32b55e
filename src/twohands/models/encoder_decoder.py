"""The slim network of our own presets: a residual U-shape, for masks and for heatmaps alike."""

from __future__ import annotations

import itertools

import torch
from torch import Tensor, nn

from twohands.models.blocks import BasicBlock, conv_bn_relu, scaled

CHANNELS = (64, 128, 192, 256)
"""Channels at strides 4, 8, 16 and 32, before the width multiplier."""
STEM_CHANNELS = 32
"""Channels at stride 2."""


class EncoderDecoder(nn.Module):
    """Residual encoder down to stride 32 and decoder back to stride 4 or 2, joined by skips.

    Ours; the paper has no such network. It sees the whole picture at its bottom, so it needs one stage where the pose
    machine needs several, and it is made of 3x3 convolutions, which matrix units run several times faster than the
    bottlenecks of the same depth.

    Args:
        outputs: number of maps.
        width: multiplier of all channel numbers.
        finest: stride of the maps, 4 or 2.
    """

    def __init__(self, outputs: int, width: float, finest: int = 4) -> None:
        super().__init__()
        if finest not in (2, 4):
            raise ValueError(f"finest stride must be 2 or 4, got {finest}")
        stem, *sizes = (scaled(c, width) for c in (STEM_CHANNELS, *CHANNELS))
        self.bottom_channels = sizes[-1]
        self.stem = nn.ModuleList([conv_bn_relu(3, stem, 5, stride=2), conv_bn_relu(stem, sizes[0], 3, stride=2)])
        self.down = nn.ModuleList([nn.Sequential(BasicBlock(sizes[0], sizes[0]), BasicBlock(sizes[0], sizes[0]))])
        for wide, narrow in itertools.pairwise(sizes):
            self.down.append(nn.Sequential(BasicBlock(wide, narrow, 2), BasicBlock(narrow, narrow)))
        steps = [*sizes[::-1], stem] if finest == 2 else sizes[::-1]
        self.lateral, self.up = nn.ModuleList(), nn.ModuleList()
        for below, here in itertools.pairwise(steps):
            self.lateral.append(conv_bn_relu(below, here, 1, relu=False))
            self.up.append(BasicBlock(here, here))
        self.head = nn.Sequential(BasicBlock(steps[-1], steps[-1]), nn.Conv2d(steps[-1], outputs, 1))

    def forward(self, x: Tensor) -> Tensor:
        """(B, 3, H, W), H and W multiples of 32, to (B, outputs, H / finest, W / finest)."""
        return self.decode(self.encode(x))

    def encode(self, x: Tensor) -> list[Tensor]:
        """(B, 3, H, W) to one (B, C, h, w) for strides 2, 4, 8, 16 and 32."""
        encoded: list[Tensor] = []
        for layer in (*self.stem, *self.down):
            x = layer(x)
            encoded.append(x)
        encoded.pop(1)  # the second half of the stem has the size of the first level
        return encoded

    def decode(self, encoded: list[Tensor]) -> Tensor:
        """What `encode` gave to (B, outputs, H / finest, W / finest)."""
        x = encoded[-1]
        for skip, lateral, layer in zip(encoded[-2::-1], self.lateral, self.up, strict=False):
            x = nn.functional.interpolate(lateral(x), scale_factor=2.0, mode="nearest")
            x = layer(torch.relu(x + skip))
        return self.head(x)
