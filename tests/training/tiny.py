"""Training runs small enough for a test."""

import dataclasses

from twohands.models.hand_seg_net import HandSegNetConfig
from twohands.models.pose_net_2d import PoseNet2DConfig
from twohands.models.pose_net_3d import PoseNet3DConfig
from twohands.models.presets import NetworkConfigs
from twohands.training.config import AugmentConfig, StageName, TrainConfig, recipe

NETWORKS = NetworkConfigs(
    HandSegNetConfig("encoder-decoder", height=64, width_px=96, width=0.5),
    PoseNet2DConfig(
        "encoder-decoder", crop_size=128, stages=1, width=0.25, activation="softmax", sigma=1.5, judge=True, cues=3
    ),
    PoseNet3DConfig(width=0.125, fc_relu=True, cues=3),
)


def tiny_run(stage: StageName, **changes) -> TrainConfig:
    """Our recipe with tiny networks, two pictures per step, no workers, no budget of minutes."""
    config = recipe("ours", stage)
    config = dataclasses.replace(
        config,
        networks=NETWORKS,
        batch_images=2,
        max_minutes=0.0,
        precision="32-true",
        threads=1,
        data=dataclasses.replace(config.data, workers=0),
    )
    return dataclasses.replace(config, **changes)


def plain(config: TrainConfig) -> TrainConfig:
    """Without random changes, averaging and warm-up, with large steps: for learning by heart."""
    return dataclasses.replace(
        config,
        augment=AugmentConfig(),
        crop=dataclasses.replace(config.crop, shift=0.0, smallest=1.0, largest=1.0, roll=0.0),
        optim=dataclasses.replace(config.optim, learning_rate=5e-3, ema=0.0, warm_up=1, weight_decay=0.0),
    )
