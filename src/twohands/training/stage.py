"""A stage of training: its networks, its losses, its validation figures, and which of its parameters learn how."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor, nn

from twohands.models.efficientnet import encoder_of
from twohands.training.batches import Batch
from twohands.training.config import OptimConfig, TrainConfig

Losses = dict[str, Tensor]


def normalised(image: Tensor) -> Tensor:
    """(B, H, W, 3) uint8 -> (B, 3, H, W) float32, (x - 128) / 256; the memory layout stays channels-last."""
    return (image.permute(0, 3, 1, 2).float() - 128) / 256


@dataclass(frozen=True)
class ParameterGroup:
    """Parameters that learn alike.

    Attributes:
        parameters: of one network.
        share: their learning rate relative to the run's.
        pretrained: whether others have trained them, so that they move gently: AdamW instead of Muon.
    """

    parameters: list[nn.Parameter]
    share: float
    pretrained: bool = False


def network_groups(network: nn.Module, share: float, config: OptimConfig) -> list[ParameterGroup]:
    """What learns of one network; an encoder that others have trained is a group of its own."""
    encoder = encoder_of(network)
    theirs = [] if encoder is None else [p for p in encoder.parameters() if p.requires_grad]
    known = {id(p) for p in theirs}
    own = [p for p in network.parameters() if p.requires_grad and id(p) not in known]
    groups = [ParameterGroup(own, share), ParameterGroup(theirs, share * config.encoder_rate, pretrained=True)]
    return [group for group in groups if group.parameters]


class Stage(nn.Module):
    """One stage: its networks, its losses, its validation figures."""

    config: TrainConfig

    def forward(self, batch: Batch, iteration: int) -> Losses:
        """Weighted losses of one batch, to be summed; called in training mode."""
        raise NotImplementedError

    def validate(self, batches: Sequence[Batch]) -> dict[str, float]:
        """Figures over held-out batches; called in evaluation mode without gradients."""
        raise NotImplementedError

    def networks(self) -> dict[str, nn.Module]:
        """The trained networks by name, as they are saved."""
        raise NotImplementedError

    def parameter_groups(self) -> list[ParameterGroup]:
        """The parameters that learn."""
        return [group for net in self.networks().values() for group in network_groups(net, 1.0, self.config.optim)]
