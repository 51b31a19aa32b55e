"""The stage of a run, with fresh or given weights."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor, nn

from twohands.errors import InputError
from twohands.models.blocks import freeze_batch_norm
from twohands.models.checkpoint import load_network, network_name
from twohands.models.efficientnet import LEVELS, encoder_of, load_landmarks, load_published, palm_encoder_of
from twohands.models.hand_seg_net import HandSegNetConfig
from twohands.models.pose_net_2d import PoseNet2D, PoseNet2DConfig
from twohands.models.pose_net_3d import PoseNet3DConfig
from twohands.training.config import TrainConfig
from twohands.training.pose_stages import Pose2DStage, Pose3DStage
from twohands.training.segmentation_stage import SegmentationStage
from twohands.training.stage import Stage


def build_stage(config: TrainConfig, weights: Sequence[Path] = (), *, require_weights: bool = True) -> Stage:
    """The stage of a run, with fresh or given weights.

    Args:
        config: the run.
        weights: checkpoints to start from. Stage pose_net_3d needs one of PoseNet2D; any stage may be given its own
            network to go on from. Their shapes must be those of the run.
        require_weights: False if the caller fills the networks from a saved state afterwards.

    Raises:
        InputError: weights are missing, shapes differ, or the pose networks' cues do.
        CheckpointError: a file is missing, damaged or of a network that this stage does not have.
    """
    torch.manual_seed(config.seed)
    if config.stage == "hand_seg_net":
        stage: Stage = SegmentationStage(config)
        known = {"hand_seg_net": stage.net}
    elif config.stage == "pose_net_2d":
        stage = Pose2DStage(config)
        known = {"pose_net_2d": stage.net}
    else:
        config.networks.check_cues()
        stage = Pose3DStage(config, PoseNet2D(config.networks.pose_net_2d))
        known = {"pose_net_2d": stage.net_2d, "pose_net_3d": stage.net_3d}
    filled: dict[str, Any] = {}
    for path in weights:
        filled |= _fill(known, path)
    for name, network in known.items():
        prepare_encoder(network, config, fresh=require_weights and name not in filled)
        prepare_palm(network, config, fresh=require_weights and not getattr(filled.get(name), "palm", False))
        layered = getattr(filled.get(name), "landmark_spread", 0) > 0
        prepare_landmarks(network, config, fresh=require_weights and not layered)
    if require_weights and config.stage == "pose_net_3d" and "pose_net_2d" not in filled:
        raise InputError("stage pose_net_3d needs the weights of a trained pose_net_2d (--weights FILE)")
    if config.optim.frozen_norm:
        if require_weights and (fresh := known.keys() - filled):
            raise InputError(f"frozen_norm: {fresh.pop()} has no statistics to keep; give its weights (--weights FILE)")
        freeze_batch_norm(stage)
    return stage


def prepare_encoder(network: nn.Module, config: TrainConfig, *, fresh: bool) -> None:
    """Make an encoder that others have trained ready to learn, in place; nothing where a network has none.

    Args:
        network: of the run.
        config: the run.
        fresh: whether its weights are random so far: then they are replaced by the published ones.

    Raises:
        InputError: their file is not named.
        MissingExtraError: the published weights are not installed.
        CheckpointError: they are not what is expected.
    """
    encoder = encoder_of(network)
    if encoder is None or not config.pretrained:
        return
    if fresh:
        load_published(encoder, config.encoder)
    freeze_batch_norm(encoder)
    frozen = config.optim.frozen_levels
    last = LEVELS[frozen - 1] if frozen else -1
    for part in (encoder.stem, *encoder.stages[: last + 1]) if frozen else ():
        part.requires_grad_(False)


def prepare_landmarks(network: nn.Module, config: TrainConfig, *, fresh: bool) -> None:
    """Let a published landmark layer stay as it is, in place; nothing where a network has none. Arguments and errors
    as of `prepare_encoder`."""
    if not isinstance(network, PoseNet2D) or network.landmarks is None:
        return
    if fresh:
        load_landmarks(network.landmarks, config.encoder)
    network.landmarks.requires_grad_(False)


def prepare_palm(network: nn.Module, config: TrainConfig, *, fresh: bool) -> None:
    """Let an encoder that knows palms stay as it is, in place; nothing where a network has none. Arguments and errors
    as of `prepare_encoder`."""
    palm = palm_encoder_of(network)
    if palm is None or not config.pretrained:
        return
    if fresh:
        palm.fill(config.encoder)
    freeze_batch_norm(palm)
    palm.requires_grad_(False)


def _fill(known: Mapping[str, nn.Module], path: Path) -> dict[str, Any]:
    """Load a checkpoint into the network of a stage that it belongs to; that network's name, and the shape that the
    checkpoint has.

    The pose networks may come without a judge and with fewer cues: the run's own stay fresh. HandSegNet may come from
    pictures of another size and without context, PoseNet2D from crops of another.
    """
    found = network_name(path)
    name = (
        found if found is not None and found in known else next(iter(known))
    )  # if unknown, load_network says what was expected
    loaded, wanted = load_network(name, path), known[name]
    found, asked = cast(Any, loaded.config), cast(Any, wanted.config)
    if _with_free_settings(found, asked) != asked:
        raise InputError(f"{path}: {name} has the shape {found}, but this run asks for {asked}")
    fresh, given = wanted.state_dict(), loaded.state_dict()
    wanted.load_state_dict(fresh | {key: _filled(fresh[key], values) for key, values in given.items()})
    return {name: loaded.config}


def _with_free_settings(found: Any, asked: Any) -> Any:
    """The configuration of a loaded network, with what may differ taken from the one that is asked for."""
    if isinstance(found, HandSegNetConfig) and isinstance(asked, HandSegNetConfig):
        context = max(found.context, asked.context)
        size = {"height": asked.height, "width_px": asked.width_px}
        return dataclasses.replace(found, **size, context=context, palm=found.palm or asked.palm)
    if isinstance(found, PoseNet2DConfig) and isinstance(asked, PoseNet2DConfig):
        kept = {name: getattr(asked, name) for name in ("crop_size", "surround", "landmark_spread")}
        return dataclasses.replace(found, **kept, judge=found.judge or asked.judge, cues=max(found.cues, asked.cues))
    if isinstance(found, PoseNet3DConfig) and isinstance(asked, PoseNet3DConfig):
        return dataclasses.replace(found, cues=max(found.cues, asked.cues))
    return found


def _filled(fresh: Tensor, given: Tensor) -> Tensor:
    """`fresh` with what was learnt for fewer channels in front."""
    filled = fresh.clone()
    filled[tuple(slice(size) for size in given.shape)] = given
    return filled
