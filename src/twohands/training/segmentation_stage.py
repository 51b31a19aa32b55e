"""What one training step of HandSegNet computes, and how it is validated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import nn

from twohands.geometry.heatmaps import encode_energy
from twohands.models.hand_seg_net import HandSegNet
from twohands.training import losses
from twohands.training.batches import Batch
from twohands.training.config import TrainConfig
from twohands.training.stage import Losses, Stage, normalised


class SegmentationStage(Stage):
    """HandSegNet: cross-entropy of the masks plus mean squared error of the energies. Source: paper, supplement."""

    def __init__(self, config: TrainConfig) -> None:
        super().__init__()
        self.config = config
        self.net = HandSegNet(config.networks.hand_seg_net)

    def forward(self, batch: Batch, iteration: int) -> Losses:
        segmentation, energy = self.net(normalised(batch["image"]))
        height, width = energy.shape[-2:]
        target = encode_energy(batch["boxes_px"], batch["present"], height, width)
        loss = self.config.loss
        each = around = None
        if loss.small_hands:
            each = losses.hand_weights(batch["boxes_px"], batch["present"], height, width, loss.small_hands)
            around = torch.where((each == 1).any(dim=1), each.prod(dim=1), each.amax(dim=1))
        return {
            "segmentation": losses.segmentation_loss(segmentation, batch["classes"].long(), around),
            "energy": loss.energy * losses.energy_loss(energy, target, loss.energy_kind, each),
        }

    def validate(self, batches: Sequence[Batch]) -> dict[str, float]:
        """miou: mean over pictures of the mean over left and right, an absent hand without prediction counts 1
        (docs/evaluation.md); presence: share of hands whose energy peak says rightly whether they are there."""
        ious: list[float] = []
        presence: list[float] = []
        for batch in batches:
            segmentation, energy = self.net(normalised(batch["image"]))
            predicted = segmentation.argmax(dim=1)
            for hand in (1, 2):
                a, b = predicted == hand, batch["classes"] == hand
                union = (a | b).sum(dim=(1, 2))
                iou = (a & b).sum(dim=(1, 2)) / union.clamp_min(1)
                ious += torch.where(union > 0, iou, 1.0).tolist()
            found = torch.sigmoid(energy.float()).amax(dim=(2, 3)) >= 0.5
            presence += (found == batch["present"]).float().flatten().tolist()
        return {"miou": float(np.mean(ious)), "presence": float(np.mean(presence))}

    def networks(self) -> dict[str, nn.Module]:
        return {"hand_seg_net": self.net}
