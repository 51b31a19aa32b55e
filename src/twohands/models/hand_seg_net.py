"""HandSegNet: from a picture to hand masks and energies (paper section 4.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, cast, get_args

from torch import Tensor, nn
from torch.nn import functional

from twohands.errors import InputError
from twohands.geometry.picture_turn import TURN_MAPS
from twohands.models.blocks import Bottleneck, DeconvBottleneck, calm_output, conv_bn_relu, initialise, scaled
from twohands.models.efficientnet import PretrainedEncoderDecoder
from twohands.models.encoder_decoder import EncoderDecoder

DOWN_PLANES = (64, 128, 256, 512)
UP_PLANES = (256, 128, 64, 32)
MAPS = 5
"""3 classes and 2 energies."""
HandSegNetVariant = Literal["auto-encoder", "encoder-decoder", "efficientnet-lite0"]


@dataclass(frozen=True)
class HandSegNetConfig:
    """Shape of HandSegNet."""

    variant: HandSegNetVariant = "auto-encoder"
    """auto-encoder: bottleneck blocks, no skips (the paper's); encoder-decoder: slim residual U-shape, see
    `models.encoder_decoder`; efficientnet-lite0: U-shape on an encoder that knows photographs (ours), see
    `models.efficientnet`."""
    height: int = 288
    """Rows of the input, a multiple of 32."""
    width_px: int = 512
    """Columns of the input, a multiple of 32."""
    width: float = 1.0
    """Multiplier of all channel numbers; 1 is the paper's size."""
    context: int = 0
    """Residual blocks between encoder and decoder (efficientnet-lite0 only)."""
    palm: bool = False
    """Whether an encoder that knows real hands sees the picture as well, see `models.palm` (efficientnet-lite0
    only)."""
    turn: bool = False
    """Whether it also says by how many quarters an upright picture was turned (efficientnet-lite0 only); fitted by
    scripts/fit_turns.py, since no loss teaches it."""

    def __post_init__(self) -> None:
        if self.variant not in get_args(HandSegNetVariant):
            raise InputError(
                f"hand_seg_net: unknown variant {self.variant!r}; one of {', '.join(get_args(HandSegNetVariant))}"
            )
        for name in ("height", "width_px"):
            if getattr(self, name) <= 0 or getattr(self, name) % 32:
                raise InputError(f"hand_seg_net: {name} must be a positive multiple of 32, got {getattr(self, name)}")
        if not self.width > 0:
            raise InputError(f"hand_seg_net: width must be positive, got {self.width}")
        if self.context < 0 or (self.context and self.variant != "efficientnet-lite0"):
            raise InputError(f"hand_seg_net: {self.variant} cannot have {self.context} blocks of context")
        if self.palm and self.variant != "efficientnet-lite0":
            raise InputError(f"hand_seg_net: {self.variant} cannot have an encoder that knows palms")
        if self.turn and self.variant != "efficientnet-lite0":
            raise InputError(f"hand_seg_net: {self.variant} cannot say how a picture is turned")


class AutoEncoder(nn.Module):
    """Residual auto-encoder: 4 down layers and 4 up layers of 2 blocks each, 16 residual blocks.

    The last doubling to input size is a plain transposed convolution, not a seventeenth block, so that the count is
    the paper's.

    Source: paper section 4.1 (channel numbers are ours; the paper gives none).
    """

    def __init__(self, outputs: int, width: float) -> None:
        super().__init__()
        stem = scaled(64, width)
        self.stem = conv_bn_relu(3, stem, 7, stride=2)
        self.pool = nn.MaxPool2d(3, stride=2, padding=1)
        channels = stem
        layers: list[nn.Module] = []
        for planes, stride in zip(DOWN_PLANES, (1, 2, 2, 2), strict=True):
            inside = scaled(planes, width)
            below = inside * Bottleneck.expansion
            layers.append(nn.Sequential(Bottleneck(channels, inside, stride), Bottleneck(below, inside)))
            channels = below
        self.down = nn.Sequential(*layers)
        layers = []
        for planes in UP_PLANES:
            inside = scaled(planes, width)
            above = inside * DeconvBottleneck.expansion
            layers.append(nn.Sequential(DeconvBottleneck(channels, inside, 2), DeconvBottleneck(above, inside)))
            channels = above
        self.up = nn.Sequential(*layers)
        self.top = nn.Sequential(
            nn.ConvTranspose2d(channels, channels, 3, stride=2, padding=1, output_padding=1, bias=False),
            nn.BatchNorm2d(channels),
            nn.ReLU(inplace=True),
        )
        self.head = nn.Conv2d(channels, outputs, 1)

    def forward(self, x: Tensor) -> Tensor:
        """(B, 3, H, W), H and W multiples of 32, to (B, outputs, H, W)."""
        return self.head(self.top(self.up(self.down(self.pool(self.stem(x))))))


class HandSegNet(nn.Module):
    """Masks of the left and the right hand, and where each of them is even if hidden (energies)."""

    def __init__(self, config: HandSegNetConfig) -> None:
        super().__init__()
        self.config = config
        if config.variant == "auto-encoder":
            self.net: nn.Module = AutoEncoder(MAPS, config.width)
        elif config.variant == "encoder-decoder":
            self.net = EncoderDecoder(MAPS, config.width, finest=2)
        else:
            self.net = PretrainedEncoderDecoder(MAPS, config.width, config.context, palm=config.palm)
        initialise(self)
        for layer in self.modules():
            if isinstance(layer, nn.Conv2d) and layer.out_channels == MAPS:
                calm_output(layer)
        self.turn: nn.Conv2d | None = None
        if isinstance(self.net, PretrainedEncoderDecoder) and config.turn:
            self.turn = nn.Conv2d(self.net.context_channels, TURN_MAPS, 1)
            nn.init.zeros_(self.turn.weight)  # it says nothing
            nn.init.zeros_(cast(Tensor, self.turn.bias))
            self.turn.requires_grad_(False)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Logits of masks and energies.

        Args:
            x: (B, 3, H, W) normalised RGB, (uint8 - 128) / 256; H and W multiples of 32.

        Returns:
            Segmentation logits (B, 3, H, W), classes background, left, right; energy logits (B, 2, H, W), left and
            right, to be passed through a sigmoid.
        """
        maps = self.net(x)
        if maps.shape[-2:] != x.shape[-2:]:
            maps = functional.interpolate(maps, size=x.shape[-2:], mode="bilinear", align_corners=False)
        return maps[:, :3], maps[:, 3:]

    def coarse(self, x: Tensor) -> tuple[Tensor, ...]:
        """The same before it is enlarged: (B, 3, h, w) and (B, 2, h, w), of the U-shapes smaller than the input; and of
        a network that says how a picture is turned, `TURN_MAPS` for `geometry.picture_turn.turn_logits`."""
        if self.turn is None:
            maps = self.net(x)
            return maps[:, :3], maps[:, 3:]
        levels = self.levels(x)
        maps = cast(PretrainedEncoderDecoder, self.net).refine(levels)
        return maps[:, :3], maps[:, 3:], self.turn(levels[0])

    def levels(self, x: Tensor) -> list[Tensor]:
        """`PretrainedEncoderDecoder.understand` of pictures (B, 3, H, W); of variant efficientnet-lite0 alone."""
        net = cast(PretrainedEncoderDecoder, self.net)
        return net.understand(net.encode(x), None if net.palm is None else net.palm(x))
