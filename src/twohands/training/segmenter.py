"""HandSegNet as the pose stages meet it: masks and boxes of pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import cast

import numpy as np
import torch
from torch import Tensor

from twohands.geometry.network_input import canvas_size, letterbox, network_input
from twohands.geometry.segmentation import boxes_from_energy, class_leads, hand_scores, masks_from_logits
from twohands.models.blocks import fold_batch_norm
from twohands.models.checkpoint import load_network
from twohands.models.hand_seg_net import HandSegNetConfig
from twohands.training.pose_targets import Segmentation

Segment = Callable[[Sequence[np.ndarray]], list[Segmentation]]
"""Masks and boxes of pictures, each (H, W, 3) uint8."""
OpenSegmentation = Callable[[Path], Segment]
"""What finds masks and boxes, from a file of HandSegNet."""
FAINT_THRESHOLD = 0.05
"""HandSegNet's score from which on the pose networks learn from its boxes and masks. In use, only higher scores come
before them; but mistakes with such scores are too rare for the judge to learn from, and shown faint mistakes alone, it
takes every faint hand for one."""


class Segmenter:
    """A trained HandSegNet, as the pose stages will meet it but for its second look in doubt: the network and how its
    maps are read.

    Args:
        checkpoint: written by the trainer, or the ONNX file of a preset.
        device: where it runs.

    Raises:
        CheckpointError: missing, damaged, or of another network.
    """

    def __init__(self, checkpoint: Path, device: str = "cpu") -> None:
        net = load_network("hand_seg_net", checkpoint).eval()
        config = cast(HandSegNetConfig, net.config)
        self.size = (config.height, config.width_px)
        fold_batch_norm(net)
        self.net = net.to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.device = device

    @torch.inference_mode()
    def __call__(self, images: Sequence[np.ndarray]) -> list[Segmentation]:
        """Masks and boxes, see `Segment`."""
        found: dict[int, Segmentation] = {}
        forms = [canvas_size(image.shape[:2], self.size) for image in images]
        for form in set(forms):
            rows = [i for i, own in enumerate(forms) if own == form]
            canvases, places = zip(*(letterbox(images[i], form) for i in rows), strict=True)
            logits, energies = self._maps(np.stack(canvases))
            for k, i in enumerate(rows):
                seg_logits, energy = places[k].content(logits[k]), places[k].content(energies[k])
                scores = hand_scores(energy, class_leads(seg_logits))
                found[i] = segmentation_of(seg_logits, energy, scores, images[i].shape[:2])
        return [found[i] for i in range(len(images))]

    def _maps(self, canvases: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Logits of masks (B, 3, h, w) and energies (B, 2, h, w), 0..1, of inputs (B, h, w, 3) uint8."""
        inputs = torch.from_numpy(network_input(canvases)).contiguous(memory_format=torch.channels_last)
        with torch.autocast(self.device, torch.bfloat16):
            logits, energies = self.net(inputs.to(self.device))
        return _planes(logits), _planes(torch.sigmoid(energies.float()))


def _planes(maps: Tensor) -> np.ndarray:
    """One plane after the other: reductions over planes of interleaved channels are slow."""
    return np.ascontiguousarray(maps.float().cpu().numpy())


def segmentation_of(
    seg_logits: np.ndarray, energies: np.ndarray, scores: np.ndarray, image_size: tuple[int, int]
) -> Segmentation:
    """What HandSegNet's maps say, hands that are seen but faintly (`FAINT_THRESHOLD`) included.

    Args:
        seg_logits, energies, scores: (3, h, w), (2, h, w) and (2,) as `inference.estimator` has them.
        image_size: (H, W) of the picture.
    """
    boxes = boxes_from_energy(energies, image_size, scores, threshold=FAINT_THRESHOLD)
    return Segmentation(masks_from_logits(seg_logits, image_size, boxes.present), boxes.boxes_px)
