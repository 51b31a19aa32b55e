"""HandCheck: whether a crop shows a hand, and which, by an encoder that has seen real hands.

Ours. PoseNet2D's judge learns from renderings and a few people's photographed hands; what it has never met, a chair's
arm or a leaf, it may take for one. The encoder of MediaPipe Hands knows what hands are not. It stays as published; one
linear layer on the means of its maps is ours.
"""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor, nn

from twohands.errors import InputError
from twohands.models.efficientnet import MOVED_HANDS, EfficientNet
from twohands.models.pose_net_2d import CROP_STEP


@dataclass(frozen=True)
class HandCheckConfig:
    """Shape of HandCheck."""

    crop_size: int = 160
    """Rows and columns of the input crop, a multiple of `CROP_STEP`."""

    def __post_init__(self) -> None:
        if self.crop_size < CROP_STEP or self.crop_size % CROP_STEP:
            raise InputError(f"hand_check: crop_size must be a positive multiple of {CROP_STEP}, got {self.crop_size}")


class HandCheck(nn.Module):
    """A published encoder and one layer."""

    def __init__(self, config: HandCheckConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = EfficientNet(MOVED_HANDS)
        self.head = nn.Linear(self.encoder.channels[-1], 2)

    def forward(self, x: Tensor) -> Tensor:
        """Log-odds (B, 2) that crops (B, 3, S, S) show a hand, and that it is a left one if they do: normalised,
        (uint8 - 128) / 256, fingers up (`geometry.boxes.upright_crop`), neither mirrored nor dimmed."""
        return self.head(self.features(x))

    def features(self, x: Tensor) -> Tensor:
        """What the layer sees, (B, 1152)."""
        return self.encoder(x)[-1].mean(dim=(2, 3))
