"""The encoder of MediaPipe Hands' palm detector, which has seen real hands in whole pictures.

A training input: `palm_detection_full.tflite` of the wheel `mediapipe` 0.10.21 (Apache-2.0). What its makers put behind
it, scores, boxes and seven points of palms, is left out.

Source: F. Zhang et al., "MediaPipe Hands: on-device real-time hand tracking", 2020, section 2.1.
"""

from __future__ import annotations

import itertools
from pathlib import Path

from torch import Tensor, nn
from torch.nn import functional

from twohands.errors import CheckpointError, InputError
from twohands.models.published import BATCH_NORM_EPS, MEDIAPIPE, described, fill_layers
from twohands.models.tflite import read_convolutions, read_slopes

CHANNELS = (32, 64, 128, 256, 256)
"""At strides 2, 4, 8, 16 and 32."""
BLOCKS = 4
"""At every stride, behind the one that halves the map."""
AGAIN = 2
"""At strides 8 and 16, on the way back."""
HEADS = (6, 108, 2, 36)
"""Numbers of their outputs, which are left out."""
FILE = "palm_detection_full.tflite"


def _conv_norm(inputs: int, outputs: int, kernel: int = 1, stride: int = 1) -> nn.Sequential:
    convolution = nn.Conv2d(inputs, outputs, kernel, stride, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(outputs, eps=BATCH_NORM_EPS))


class PalmBlock(nn.Module):
    """Filters every channel by itself, mixes them, and adds its input, halved and with empty channels where needed.

    Args:
        inputs, outputs: channels.
        stride: 1, or 2 to halve the map.
    """

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        self.stride, self.more = stride, outputs - inputs
        self.depthwise = nn.Conv2d(inputs, inputs, 5, stride, groups=inputs, bias=False)
        self.project = _conv_norm(inputs, outputs)
        self.act = nn.PReLU(outputs)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> (B, C', H / stride, W / stride)."""
        first = 2 if self.stride == 1 else 1
        y = self.project(self.depthwise(functional.pad(x, (first, 2, first, 2))))
        if self.stride == 2:
            x = functional.max_pool2d(x, 2)
        if self.more:
            x = functional.pad(x, (0, 0, 0, 0, 0, self.more))
        return self.act(x + y)


class WayBack(nn.Module):
    """Doubles a map and adds it to the one that the encoder had at that size."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.lateral = nn.Sequential(*_conv_norm(inputs, outputs), nn.PReLU(outputs))
        self.blocks = nn.Sequential(*(PalmBlock(outputs, outputs) for _ in range(AGAIN)))

    def forward(self, x: Tensor, level: Tensor) -> Tensor:
        """(B, C, H, W) and (B, C', 2 H, 2 W) -> (B, C', 2 H, 2 W)."""
        x = functional.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)
        return self.blocks(level + self.lateral(x))


class PalmEncoder(nn.Module):
    """Down to stride 32 and back to stride 8, as published.

    Attributes:
        channels: at strides 2, 4, 8, 16 and 32.
    """

    channels = CHANNELS

    def __init__(self) -> None:
        super().__init__()
        self.stem = nn.Sequential(*_conv_norm(3, CHANNELS[0], 5, 2), nn.PReLU(CHANNELS[0]))
        self.stages = nn.ModuleList()
        inputs = CHANNELS[0]
        for level, outputs in enumerate(CHANNELS):
            halving = [PalmBlock(inputs, outputs, 2)] if level else []
            self.stages.append(nn.Sequential(*halving, *(PalmBlock(outputs, outputs) for _ in range(BLOCKS))))
            inputs = outputs
        self.back = nn.ModuleList()
        for outputs in CHANNELS[3:1:-1]:
            self.back.append(WayBack(inputs, outputs))
            inputs = outputs

    def forward(self, x: Tensor) -> list[Tensor]:
        """(B, 3, H, W), H and W multiples of 32, to one (B, C, h, w) for strides 2, 4, 8, 16 and 32."""
        x = self.stem(functional.pad(x, (1, 2, 1, 2)))
        encoded: list[Tensor] = []
        for stage in self.stages:
            x = stage(x)
            encoded.append(x)
        for level, back in zip((3, 2), self.back, strict=True):
            x = back(x, encoded[level])
            encoded[level] = x
        return encoded

    def fill(self, file: str | Path) -> dict[str, str]:
        """Their kernels and slopes, for pictures normalised as ours are, in place.

        Args:
            file: `FILE`.

        Returns:
            What to say of it on a card: name, source, licence, and the file's SHA-256.

        Raises:
            InputError: no file is named.
            MissingExtraError: what reads the file is not installed.
            CheckpointError: the file is not the one that is expected.
        """
        if not file:
            raise InputError(
                f"this encoder starts from {FILE} of {MEDIAPIPE} (Apache-2.0): name it with --set encoder=FILE"
            )
        stored = [layer for layer in read_convolutions(file) if len(layer[1]) not in HEADS]
        parts = list(self.modules())
        norms = {a: b for a, b in itertools.pairwise(parts) if isinstance(b, nn.BatchNorm2d)}
        layers = [(part, norms.get(part)) for part in parts if isinstance(part, nn.Conv2d)]
        slopes = [part for part in parts if isinstance(part, nn.PReLU)]
        try:
            fill_layers(layers, stored)
            for part, values in zip(slopes, read_slopes(file), strict=True):
                part.load_state_dict({"weight": values})
        except (RuntimeError, ValueError) as error:
            reason = str(error).splitlines()[0]
            raise CheckpointError(f"{file} does not hold the expected weights: {reason}") from error
        return described("MediaPipe Hands, palm detection", f"{FILE} of {MEDIAPIPE}", Path(file))
