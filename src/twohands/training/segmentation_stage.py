"""What one training step of HandSegNet computes, and how it is validated."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from twohands.geometry.heatmaps import encode_energy
from twohands.models.checkpoint import load_network
from twohands.models.hand_seg_net import MAPS, HandSegNet
from twohands.training import losses
from twohands.training.batches import Batch
from twohands.training.config import TrainConfig
from twohands.training.stage import Losses, Stage, normalised

CLASSES = MAPS - 2


class SegmentationStage(Stage):
    """HandSegNet: cross-entropy of the masks plus mean squared error of the energies. Source: paper, supplement.

    With a teacher, a trained HandSegNet, its answers are part of the targets; it does not learn itself.
    """

    def __init__(self, config: TrainConfig) -> None:
        super().__init__()
        self.config = config
        self.net = HandSegNet(config.networks.hand_seg_net)
        self._teacher: list[HandSegNet] = []  # not a submodule: it is neither saved nor trained
        if config.teacher:
            teacher = cast(HandSegNet, load_network("hand_seg_net", Path(config.teacher)))
            self._teacher = [teacher.requires_grad_(False).to(memory_format=torch.channels_last)]  # type: ignore[call-overload]

    def forward(self, batch: Batch, iteration: int) -> Losses:
        image = normalised(batch["image"])
        segmentation, energy = self.net(image)
        height, width = energy.shape[-2:]
        classes = batch["classes"].long()
        target = encode_energy(batch["boxes_px"], batch["present"], height, width)
        for teacher in self._teacher:
            classes, target = self._taught(teacher, image, classes, target)
        loss = self.config.loss
        each = around = None
        if loss.small_hands:
            each = losses.hand_weights(batch["boxes_px"], batch["present"], height, width, loss.small_hands)
            around = torch.where((each == 1).any(dim=1), each.prod(dim=1), each.amax(dim=1))
        return {
            "segmentation": losses.segmentation_loss(segmentation, classes, around),
            "energy": loss.energy * losses.energy_loss(energy, target, loss.energy_kind, each),
        }

    @torch.no_grad()
    def _taught(self, teacher: HandSegNet, image: Tensor, classes: Tensor, energy: Tensor) -> tuple[Tensor, Tensor]:
        """Targets that are partly a teacher's answer: classes, as probabilities (B, 3, H, W), and energies."""
        says, says_energy = teacher.to(image.device)(image)
        share = self.config.loss.taught
        labels = functional.one_hot(classes, CLASSES).permute(0, 3, 1, 2).float()
        answers = torch.softmax(says.float(), dim=1)
        return torch.lerp(labels, answers, share), torch.lerp(energy.float(), torch.sigmoid(says_energy.float()), share)

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
