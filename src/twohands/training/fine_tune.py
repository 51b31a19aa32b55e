"""What it takes to make given weights better for one camera in some rooms: frames to render and runs to make.

HandSegNet first, then PoseNet2D and PoseNet3D together on crops by the new HandSegNet, as for the shipped weights.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

from twohands.models.checkpoint import load_network
from twohands.models.presets import NetworkConfigs
from twohands.synth.scene.config import WILD, SynthConfig
from twohands.training.config import StageName, TrainConfig, folder_list, recipe
from twohands.types import PinholeCamera

LONGER_SIDE = 480
"""Of the rendered frames, pixels: quick, but crops of distant hands are enlarged."""
FRAMES_PER_MINUTE = 100
"""Frames rendered per minute of training; each is seen on several backgrounds."""
LEAST_FRAMES = 40
SHARES: dict[StageName, float] = {"hand_seg_net": 0.4, "pose_net_3d": 0.6}
"""Stages in their order, with their shares of the minutes; pose_net_3d trains PoseNet2D along."""
LEARNING_RATE = 5e-4
"""A quarter of a fresh run's: the weights are good already."""


def scenes_for(camera: PinholeCamera) -> SynthConfig:
    """Scenes as varied as those of preset wild, all taken by one camera, at a size for training.

    The camera may be on a head, on a screen or anywhere around the hands, as in preset wild. Its lens distortion is not
    rendered.
    """
    scale = LONGER_SIDE / max(camera.width, camera.height)
    small = camera.resized(round(camera.width * scale), round(camera.height * scale))
    return dataclasses.replace(
        WILD,
        width=small.width,
        height=small.height,
        fov=None,
        principal_shift=0.0,
        intrinsics=(small.fx, small.fy, small.cx, small.cy),
    )


def frame_count(minutes: float) -> int:
    """Frames to render for so many minutes of training."""
    return max(LEAST_FRAMES, round(FRAMES_PER_MINUTE * minutes))


def shapes_of(weights: Mapping[str, Path]) -> NetworkConfigs:
    """Shapes of the three networks in given files.

    Args:
        weights: "hand_seg_net", "pose_net_2d", "pose_net_3d" -> file.

    Raises:
        CheckpointError: a file is missing or damaged.
    """
    return NetworkConfigs(**{name: load_network(name, path).config for name, path in weights.items()})  # type: ignore[arg-type]


def fine_tuning_run(
    stage: StageName, networks: NetworkConfigs, minutes: float, frames: Path, segmentation: Path
) -> TrainConfig:
    """The run of one stage.

    Args:
        stage: one of `SHARES`.
        networks: shapes of the given weights.
        minutes: of all stages together.
        frames: folder of cached frames.
        segmentation: checkpoint of HandSegNet; the pose stage's crops come from it.

    Raises:
        InputError: `frames` has a comma in its path.
    """
    config = recipe("ours", stage)
    pose = stage != "hand_seg_net"
    return dataclasses.replace(
        config,
        networks=networks,
        max_minutes=minutes * SHARES[stage],
        data=dataclasses.replace(
            config.data, source=folder_list([frames]), segmentation=str(segmentation) if pose else ""
        ),
        augment=dataclasses.replace(config.augment, zoom=dataclasses.replace(config.augment.zoom, cut=0.0)),
        optim=dataclasses.replace(config.optim, learning_rate=LEARNING_RATE),
    )
