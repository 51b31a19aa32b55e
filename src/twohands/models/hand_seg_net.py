"""HandSegNet: from a picture to hand masks and energies (SPEC 2)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from twohands.errors import InputError
from twohands.models.blocks import Bottleneck, DeconvBottleneck, calm_output, conv_bn_relu, initialise, scaled

DOWN_PLANES = (64, 128, 256, 512)
UP_PLANES = (256, 128, 64, 32)


@dataclass(frozen=True)
class HandSegNetConfig:
    """Shape of HandSegNet."""

    height: int = 288
    """Rows of the input, a multiple of 32."""
    width_px: int = 512
    """Columns of the input, a multiple of 32."""
    width: float = 1.0
    """Multiplier of all channel numbers; 1 is the paper's size."""
    skips: bool = False
    """Add encoder maps to decoder maps of the same size (U-shape); the paper has none."""
    output_stride: int = 1
    """1: the last layer doubles the map to input size. 2: it stays at half size and is interpolated, 4x cheaper."""

    def __post_init__(self) -> None:
        for name in ("height", "width_px"):
            if getattr(self, name) <= 0 or getattr(self, name) % 32:
                raise InputError(f"hand_seg_net: {name} must be a positive multiple of 32, got {getattr(self, name)}")
        if not self.width > 0:
            raise InputError(f"hand_seg_net: width must be positive, got {self.width}")
        if self.output_stride not in (1, 2):
            raise InputError(f"hand_seg_net: output_stride must be 1 or 2, got {self.output_stride}")


class HandSegNet(nn.Module):
    """Residual auto-encoder: 4 down layers and 4 up layers of 2 blocks each, 16 residual blocks.

    The last doubling to input size is a plain transposed convolution, not a seventeenth block, so that the count is
    the paper's.

    Source: paper section 4.1, SPEC 2 (channel numbers are ours; the paper gives none).
    """

    def __init__(self, config: HandSegNetConfig) -> None:
        super().__init__()
        self.config = config
        stem = scaled(64, config.width)
        down = [scaled(planes, config.width) for planes in DOWN_PLANES]
        up = [scaled(planes, config.width) for planes in UP_PLANES]
        self.stem = conv_bn_relu(3, stem, 7, stride=2)
        self.pool = nn.MaxPool2d(3, stride=2, padding=1)

        self.down = nn.ModuleList()
        channels, encoder_channels = stem, [stem]
        for planes, stride in zip(down, (1, 2, 2, 2), strict=True):
            outputs = planes * Bottleneck.expansion
            self.down.append(nn.Sequential(Bottleneck(channels, planes, stride), Bottleneck(outputs, planes)))
            channels = outputs
            encoder_channels.append(channels)

        self.up, self.skips = nn.ModuleList(), nn.ModuleList()
        mates = encoder_channels[-2::-1]  # maps of stride 16, 8, 4, 2
        for planes, mate in zip(up, mates, strict=True):
            outputs = planes * DeconvBottleneck.expansion
            self.up.append(nn.Sequential(DeconvBottleneck(channels, planes, 2), DeconvBottleneck(outputs, planes)))
            if config.skips:
                self.skips.append(conv_bn_relu(mate, outputs, 1, relu=False))
            channels = outputs

        self.top = nn.Sequential()
        if config.output_stride == 1:
            self.top = nn.Sequential(
                nn.ConvTranspose2d(channels, channels, 3, stride=2, padding=1, output_padding=1, bias=False),
                nn.BatchNorm2d(channels),
                nn.ReLU(inplace=True),
            )
        self.segmentation = nn.Conv2d(channels, 3, 1)
        self.energy = nn.Conv2d(channels, 2, 1)
        initialise(self)
        calm_output(self.segmentation)
        calm_output(self.energy)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Logits of masks and energies.

        Args:
            x: (B, 3, H, W) normalised RGB, (uint8 - 128) / 256; H and W multiples of 32.

        Returns:
            Segmentation logits (B, 3, H, W), classes background, left, right; energy logits (B, 2, H, W), left and
            right, to be passed through a sigmoid.
        """
        encoded = [self.stem(x)]
        x = self.pool(encoded[0])
        for layer in self.down:
            x = layer(x)
            encoded.append(x)
        for i, layer in enumerate(self.up):
            x = layer(x)
            if self.config.skips:
                x = x + self.skips[i](encoded[-2 - i])
        x = self.top(x)
        maps = torch.cat([self.segmentation(x), self.energy(x)], dim=1)  # (B, 5, H, W) or half of it
        if self.config.output_stride == 2:
            maps = functional.interpolate(maps, scale_factor=2.0, mode="bilinear", align_corners=False)
        return maps[:, :3], maps[:, 3:]
