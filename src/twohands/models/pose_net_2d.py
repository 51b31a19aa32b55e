"""PoseNet2D: from a crop of one hand to 21 heatmaps (paper section 4.2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import torch
from torch import Tensor, nn

from twohands.errors import InputError
from twohands.models.blocks import BasicBlock, calm_output, conv_bn_relu, initialise, scaled
from twohands.models.efficientnet import HANDS, LITE0, PretrainedEncoderDecoder
from twohands.models.encoder_decoder import EncoderDecoder
from twohands.skeleton import N_JOINTS

TRUNK_CHANNELS = 128
"""Channels that the judge of a pretrained encoder sees."""
CROP_STEP = 32
"""Crops have a multiple of so many rows and columns: the encoder-decoder halves them five times."""


PoseNet2DVariant = Literal["cpm9", "vgg", "encoder-decoder", "efficientnet-lite0", "mediapipe-hands"]
PRETRAINED = {"efficientnet-lite0": LITE0, "mediapipe-hands": HANDS}
"""Variants with a published encoder, and which."""
U_SHAPES = ("encoder-decoder", *PRETRAINED)
"""Variants that see the whole crop at their bottom: one stage, maps at stride 4, and room for judge and cues."""


@dataclass(frozen=True)
class PoseNet2DConfig:
    """Shape of PoseNet2D."""

    variant: PoseNet2DVariant = "cpm9"
    """cpm9: convolutional pose machine with 9x9 convolutions (the paper's); vgg: pose machine on 3x3 convolutions;
    encoder-decoder: slim residual U-shape (ours), see `models.encoder_decoder`; efficientnet-lite0 and
    mediapipe-hands: U-shape on an encoder that knows photographs, of anything or of hands (ours), see
    `models.efficientnet`."""
    crop_size: int = 256
    """Rows and columns of the input crop, a multiple of `CROP_STEP`; the paper's is 256."""
    stages: int = 6
    """Stages of the pose machine; the encoder-decoder has one."""
    width: float = 1.0
    """Multiplier of all channel numbers; 1 is the paper's size."""
    batch_norm: bool = True
    """Batch normalisation after every convolution but the stage outputs (pose machines only)."""
    activation: Literal["linear", "softmax"] = "linear"
    """What the maps are: linear values trained with MSE, or logits of a distribution over the cells."""
    sigma: float = 2.0
    """Standard deviation of the target Gaussian at the root's depth, in cells."""
    judge: bool = False
    """Also say whether the crop shows a hand of the side it was cut for (ours, U-shapes only)."""
    cues: int = 0
    """Further maps, for PoseNet3D alone, that no label prescribes (ours, U-shapes only)."""
    surround: int = 0
    """Pixels at each side of the crop of which there are no maps: room for what the encoder has to see around a hand, a
    multiple of `CROP_STEP` (ours, mediapipe-hands only)."""
    landmark_spread: float = 0.0
    """How near to where the published network sees the joints they are to be, standard deviation in cells; 0 leaves out
    what it says of joints, and of whether there is a hand (ours, mediapipe-hands only)."""

    def __post_init__(self) -> None:
        if self.variant not in get_args(PoseNet2DVariant):
            raise InputError(
                f"pose_net_2d: unknown variant {self.variant!r}; one of {', '.join(get_args(PoseNet2DVariant))}"
            )
        if self.activation not in ("linear", "softmax"):
            raise InputError(f"pose_net_2d: unknown activation {self.activation!r}; linear or softmax")
        if self.crop_size < CROP_STEP or self.crop_size % CROP_STEP:
            raise InputError(f"pose_net_2d: crop_size must be a positive multiple of {CROP_STEP}, got {self.crop_size}")
        if self.stages < 1 or (self.variant in U_SHAPES and self.stages != 1):
            raise InputError(f"pose_net_2d: {self.variant} cannot have {self.stages} stages")
        if self.judge and self.variant not in U_SHAPES:
            raise InputError(f"pose_net_2d: {self.variant} cannot judge its crops")
        if self.cues < 0 or (self.cues and self.variant not in U_SHAPES):
            raise InputError(f"pose_net_2d: {self.variant} cannot give {self.cues} cues")
        if self.surround % CROP_STEP or not 0 <= 2 * self.surround < self.crop_size or self.landmark_spread < 0:
            raise InputError(
                f"pose_net_2d: surround must be a multiple of {CROP_STEP} that leaves some of the crop, and "
                f"landmark_spread not negative, got {self.surround} and {self.landmark_spread}"
            )
        if (self.surround or self.landmark_spread) and self.variant != "mediapipe-hands":
            raise InputError(f"pose_net_2d: {self.variant} cannot have surround or landmark_spread")
        if not (self.width > 0 and self.sigma > 0):
            raise InputError(f"pose_net_2d: width and sigma must be positive, got {self.width} and {self.sigma}")

    @property
    def map_size(self) -> int:
        """Rows and columns of the maps: one cell for 8 pixels of the crop, for 4 of a U-shape's."""
        return self.seen_size // (4 if self.variant in U_SHAPES else 8)

    @property
    def seen_size(self) -> int:
        """Rows and columns of the part of the crop of which there are maps."""
        return self.crop_size - 2 * self.surround


def judge_trunk(inputs: int, outputs: int) -> nn.Sequential:
    """What lies between an encoder's coarsest level and its mean: (B, inputs, h, w) to (B, outputs, h, w)."""
    return nn.Sequential(conv_bn_relu(inputs, outputs, 1), BasicBlock(outputs, outputs), BasicBlock(outputs, outputs))


class PoseMachine(nn.Module):
    """Convolutional pose machine with batch normalisation, in the 9x9 and the VGG-style form.

    No centre map: a hand crop is always centred, so it would be a constant.

    Source: paper section 4.2; docs/paper-map.md, *PoseNet2D and heatmaps*.
    """

    def __init__(self, config: PoseNet2DConfig) -> None:
        super().__init__()
        bn = config.batch_norm
        c32, c128, c512 = (scaled(c, config.width) for c in (32, 128, 512))

        def pool() -> nn.Module:
            return nn.MaxPool2d(3, stride=2, padding=1)

        def conv(inputs: int, outputs: int, kernel: int) -> nn.Sequential:
            return conv_bn_relu(inputs, outputs, kernel, batch_norm=bn)

        def features9() -> list[nn.Module]:
            return [conv(3, c128, 9), pool(), conv(c128, c128, 9), pool(), conv(c128, c128, 9), pool()]

        self.shared: nn.Module
        if config.variant == "cpm9":
            self.shared = nn.Sequential(*features9(), conv(c128, c32, 5)) if config.stages > 1 else nn.Identity()
            first = [*features9(), conv(c128, c32, 5), conv(c32, c512, 9), conv(c512, c512, 1)]
            hidden, context = c512, c32
        else:
            layers: list[nn.Module] = []
            channels = 3
            for outputs, repeats in ((64, 2), (128, 2), (256, 4)):
                for _ in range(repeats):
                    layers.append(conv(channels, scaled(outputs, config.width), 3))
                    channels = scaled(outputs, config.width)
                layers.append(pool())
            for outputs in (512, 512, 256, 256, 256, 256, 128):
                layers.append(conv(channels, scaled(outputs, config.width), 3))
                channels = scaled(outputs, config.width)
            self.shared = nn.Sequential(*layers)
            first = [conv(c128, c512, 1)]
            hidden, context = c512, c128
        self.variant = config.variant
        self.first = nn.Sequential(*first, nn.Conv2d(hidden, N_JOINTS, 1))

        self.refine = nn.ModuleList()
        for _ in range(config.stages - 1):
            kernel, repeats = (11, 3) if config.variant == "cpm9" else (7, 5)
            convs = [conv(context + N_JOINTS if i == 0 else c128, c128, kernel) for i in range(repeats)]
            self.refine.append(nn.Sequential(*convs, conv(c128, c128, 1), nn.Conv2d(c128, N_JOINTS, 1)))

    def forward(self, x: Tensor) -> list[Tensor]:
        """(B, 3, S, S) -> one (B, 21, S / 8, S / 8) per stage."""
        if self.variant == "cpm9":
            features = self.shared(x) if len(self.refine) else x
            outputs = [self.first(x)]
        else:
            features = self.shared(x)  # (B, 128, M, M)
            outputs = [self.first(features)]
        for stage in self.refine:
            outputs.append(stage(torch.cat([features, outputs[-1]], dim=1)))
        return outputs


class PoseNet2D(nn.Module):
    """Heatmaps of the 21 joints of one left-like hand, and whether there is one.

    The judgement is ours. HandSegNet sees a hand at a third of the crop's resolution; what looks like a hand to it may
    be an ear, or a right hand where it says left. The paper's only test is the energy's peak.

    The cues are ours too. A heatmap says where a joint is and, by its spread, how deep; shading, foreshortening and
    what covers what say more, and PoseNet3D never sees the crop. What the cues mean is found by training both together.
    """

    def __init__(self, config: PoseNet2DConfig) -> None:
        super().__init__()
        self.config = config
        maps = N_JOINTS + config.cues
        self.net: EncoderDecoder | PretrainedEncoderDecoder | PoseMachine
        if config.variant == "encoder-decoder":
            self.net = EncoderDecoder(maps, config.width)
        elif config.variant in PRETRAINED:
            self.net = PretrainedEncoderDecoder(maps, config.width, layout=PRETRAINED[config.variant])
        else:
            self.net = PoseMachine(config)
        self.landmarks = None
        if isinstance(self.net, PretrainedEncoderDecoder) and config.landmark_spread:
            self.landmarks = nn.Linear(self.net.bottom_channels, 2 * N_JOINTS + 1)
        self.judge, self.judge_trunk = None, nn.Identity()
        if not isinstance(self.net, PoseMachine) and config.judge:
            channels = self.net.bottom_channels
            if isinstance(self.net, PretrainedEncoderDecoder):
                # What tells left from right is learnt here: ImageNet's pictures are shown mirrored too.
                self.judge_trunk = judge_trunk(channels, TRUNK_CHANNELS)
                channels = TRUNK_CHANNELS
            self.judge = nn.Sequential(nn.Linear(channels, 64), nn.ReLU(), nn.Linear(64, 1))
        initialise(self)
        for layer in self.modules():
            if isinstance(layer, nn.Conv2d) and layer.out_channels == N_JOINTS + config.cues:
                calm_output(layer)
        if self.judge is not None:
            calm_output(self.judge[-1])  # type: ignore[arg-type]

    def forward(self, x: Tensor) -> list[Tensor]:
        """Raw maps, one per stage, the last the best.

        Args:
            x: (B, 3, S, S) normalised composed crop, (uint8 - 128) / 256, right hands mirrored.

        Returns:
            List of (B, 21 + cues, M, M): map values ("linear") or logits ("softmax"), then the cues.
        """
        return self.judged(x)[0]

    def judged(
        self, x: Tensor, rows: Tensor | None = None, *, guided: bool = True
    ) -> tuple[list[Tensor], Tensor | None]:
        """Raw maps as `forward` gives them, and how sure it is of its crops.

        Args:
            x: as for `forward`.
            rows: (B,) bool, the crops whose maps are wanted; None for all.
            guided: whether the published layers have their say, where there are any. While the decoder learns they
                have not: of renderings they know less, and the decoder would learn to overrule them.

        Returns:
            Maps; and (B, 1) log-odds that the crop shows a hand of the side that it was cut for (a left-like one), None
            for a network that does not judge. Published layers add a second column: log-odds that there is a hand.
        """
        if isinstance(self.net, PoseMachine):
            return self.net(x if rows is None else x[rows]), None
        everything = self.net.encode(x)
        encoded = self._seen(everything)
        hand_logit = None if self.judge is None else self.judge(self.judge_trunk(encoded[-1]).mean(dim=(2, 3)))
        if rows is not None:
            encoded = [level[rows] for level in encoded]
        maps = self.net.decode(encoded)
        if self.landmarks is not None and guided:
            said = self.landmarks(everything[-1].float().mean(dim=(2, 3)))
            points, there = (said if rows is None else said[rows])[:, :-1], said[:, -1:]
            maps = torch.cat([maps[:, :N_JOINTS] + self._nearness(points), maps[:, N_JOINTS:]], dim=1)
            hand_logit = there if hand_logit is None else torch.cat([hand_logit, there], dim=1)
        return [maps], hand_logit

    def _seen(self, encoded: list[Tensor]) -> list[Tensor]:
        """An encoder's levels in the part of the crop of which there are maps. A cell of the coarsest level is as large
        as `CROP_STEP`; with maps padded at the end it looks at its last pixel, so each level's window begins a cell
        early."""
        if not self.config.surround:
            return encoded
        levels = []
        for level in encoded:
            cells = level.shape[-1] * self.config.surround // self.config.crop_size
            size = level.shape[-1] - 2 * cells
            levels.append(level[:, :, cells - 1 : cells - 1 + size, cells - 1 : cells - 1 + size])
        return levels

    def _nearness(self, points: Tensor) -> Tensor:
        """(B, 21, M, M) logarithm of how near cells are to where the published network sees the joints, (B, 42) pixels
        of the crop."""
        points = points.reshape(-1, N_JOINTS, 2, 1)
        size = self.config.map_size
        step = self.config.seen_size / size
        centres = torch.arange(size, device=points.device) + 0.5
        off = ((points - self.config.surround) / step - centres) ** 2  # (B, 21, 2, M)
        return -(off[:, :, 1, :, None] + off[:, :, 0, None, :]) / (2 * self.config.landmark_spread**2)

    def probabilities(self, maps: Tensor) -> Tensor:
        """Softmax over the cells of each of the joints' maps, (B, 21, M, M), sum 1 per joint."""
        return maps.flatten(2).float().softmax(dim=2).view(maps.shape)

    def heatmaps(self, outputs: Sequence[Tensor]) -> Tensor:
        """What PoseNet3D consumes: the last stage's maps, with a peak of about 1 for a joint at the root's depth, and
        the cues as they are.

        Softmax maps are probabilities times 2 pi sigma^2, the peak's inverse for the target Gaussian at z = 0.

        Args:
            outputs: result of `forward`.

        Returns:
            (B, 21 + cues, M, M).
        """
        if self.config.activation == "linear":
            return outputs[-1]
        maps, cues = outputs[-1][:, :N_JOINTS], outputs[-1][:, N_JOINTS:]
        maps = self.probabilities(maps) * (2 * math.pi * self.config.sigma**2)
        return torch.cat([maps, cues.float()], dim=1) if self.config.cues else maps
