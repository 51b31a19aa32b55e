"""PoseNet3D: from 21 heatmaps to the canonical 3D pose (paper section 4.3)."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor, nn
from torch.nn import functional

from twohands.errors import InputError
from twohands.models.blocks import BasicBlock, calm_output, conv_bn_relu, initialise, scaled
from twohands.skeleton import N_JOINTS, ROOT


@dataclass(frozen=True)
class PoseNet3DConfig:
    """Shape of PoseNet3D."""

    width: float = 1.0
    """Multiplier of all channel numbers; 1 is the paper's size."""
    fc_relu: bool = False
    """ReLU between the fully connected layers; the authors' later code has none."""
    cues: int = 0
    """Maps beside those of the joints (ours), see `PoseNet2DConfig.cues`."""

    def __post_init__(self) -> None:
        if not self.width > 0:
            raise InputError(f"pose_net_3d: width must be positive, got {self.width}")
        if self.cues < 0:
            raise InputError(f"pose_net_3d: cues must not be negative, got {self.cues}")


class PoseNet3D(nn.Module):
    """ResNet-18 on the heatmaps: 8 residual blocks, 2 fully connected layers, then the output layer.

    Source: paper section 4.3; docs/paper-map.md, *PoseNet3D*.
    """

    def __init__(self, config: PoseNet3DConfig) -> None:
        super().__init__()
        self.config = config
        sizes = [scaled(c, config.width) for c in (64, 128, 256, 512)]
        first = conv_bn_relu(N_JOINTS + config.cues, sizes[0], 7, stride=2)
        layers: list[nn.Module] = [first, nn.MaxPool2d(3, stride=2, padding=1)]
        channels = sizes[0]
        for size, stride in zip(sizes, (1, 2, 2, 2), strict=True):
            layers += [BasicBlock(channels, size, stride), BasicBlock(size, size)]
            channels = size
        self.features = nn.Sequential(*layers)
        between = nn.ReLU if config.fc_relu else nn.Identity
        output = nn.Linear(channels, 3 * N_JOINTS)
        self.regressor = nn.Sequential(
            nn.Linear(channels, channels), between(), nn.Linear(channels, channels), between(), output
        )
        initialise(self)
        calm_output(output)
        nn.init.zeros_(first[0].weight[:, N_JOINTS:])  # type: ignore[index]  # cues mean nothing yet

    def forward(self, heatmaps: Tensor) -> Tensor:
        """Canonical pose of a left-like hand.

        Args:
            heatmaps: (B, 21 + cues, M, M), see `PoseNet2D.heatmaps`.

        Returns:
            (B, 21, 3) canonical joints, x right, y down, z forward, unit = hand length. The output is shifted so
            that the root is exactly 0, as the canonical frame demands; the layer itself is free.
        """
        x = functional.interpolate(heatmaps, size=(64, 64), mode="bilinear", align_corners=False)
        x = self.features(x).mean(dim=(2, 3))  # (B, C)
        joints = self.regressor(x).reshape(-1, N_JOINTS, 3)
        return joints - joints[:, ROOT : ROOT + 1]
