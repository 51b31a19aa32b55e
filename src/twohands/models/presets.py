"""The networks by name, and the shapes of them that the two recipes use."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from torch import nn

from twohands.errors import InputError
from twohands.models.hand_check import HandCheck, HandCheckConfig
from twohands.models.hand_seg_net import HandSegNet, HandSegNetConfig
from twohands.models.pose_net_2d import PoseNet2D, PoseNet2DConfig
from twohands.models.pose_net_3d import PoseNet3D, PoseNet3DConfig

NetworkName = Literal["hand_seg_net", "pose_net_2d", "pose_net_3d"]


@dataclass(frozen=True)
class NetworkKind:
    """A network class and the class of its configuration."""

    network: type[nn.Module]
    config: type[Any]


NETWORKS: dict[str, NetworkKind] = {
    "hand_seg_net": NetworkKind(HandSegNet, HandSegNetConfig),
    "pose_net_2d": NetworkKind(PoseNet2D, PoseNet2DConfig),
    "pose_net_3d": NetworkKind(PoseNet3D, PoseNet3DConfig),
    "hand_check": NetworkKind(HandCheck, HandCheckConfig),
}


@dataclass(frozen=True)
class NetworkConfigs:
    """Shapes of the three networks of one preset."""

    hand_seg_net: HandSegNetConfig = field(default_factory=HandSegNetConfig)
    pose_net_2d: PoseNet2DConfig = field(default_factory=PoseNet2DConfig)
    pose_net_3d: PoseNet3DConfig = field(default_factory=PoseNet3DConfig)

    def check_cues(self) -> None:
        """See that the pose networks can work together.

        Raises:
            InputError: their cues differ.
        """
        given, taken = self.pose_net_2d.cues, self.pose_net_3d.cues
        if given != taken:
            raise InputError(f"pose_net_2d gives {given} cues, but pose_net_3d takes {taken}")


PAPER = NetworkConfigs()
"""The paper's networks (sections 4.1 to 4.3)."""

SLIM = NetworkConfigs(
    HandSegNetConfig("efficientnet-lite0", height=192, width_px=352, context=2),
    PoseNet2DConfig(
        "encoder-decoder", crop_size=128, stages=1, width=1.25, activation="softmax", sigma=1.5, judge=True, cues=8
    ),
    PoseNet3DConfig(width=0.5, fc_relu=True, cues=8),
)
"""Ours: small enough to learn and to run on two CPU cores."""


def config_from_dict(name: str, values: Mapping[str, Any]) -> Any:
    """The configuration of a network from plain JSON values.

    Raises:
        InputError: unknown network, or unknown or missing fields.
    """
    if name not in NETWORKS:
        raise InputError(f"unknown network '{name}'; known: {', '.join(NETWORKS)}")
    kind = NETWORKS[name].config
    unknown = sorted(set(values) - {field.name for field in dataclasses.fields(kind)})
    if unknown:
        raise InputError(f"{name}: unknown configuration fields {', '.join(unknown)}")
    return kind(**values)


def build_network(name: str, config: Any) -> nn.Module:
    """A network with fresh weights.

    Raises:
        InputError: unknown network, or a configuration of another one.
    """
    if name not in NETWORKS:
        raise InputError(f"unknown network '{name}'; known: {', '.join(NETWORKS)}")
    if type(config) is not NETWORKS[name].config:
        raise InputError(f"{name} cannot be built from a {type(config).__name__}")
    return NETWORKS[name].network(config)
