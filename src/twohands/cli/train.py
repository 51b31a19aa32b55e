"""Train one of the three networks, or fine-tune the shipped weights for your camera.

The order is hand_seg_net and pose_net_2d (in any order), then pose_net_3d on the trained pose_net_2d. A run can be
interrupted and resumed. Any setting of the run can be changed with --set, e.g. --set optim.learning_rate=5e-4; the
run's folder holds all of them in config.json.

With --your-camera instead of a STAGE, the networks of preset fast go on learning, on pictures as your camera would take
them, and --out becomes a weights folder for twohands track.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import tyro

from twohands.cli.output import check_output_folder
from twohands.errors import DataFormatError, InputError

if TYPE_CHECKING:
    from twohands.training.config import TrainConfig
    from twohands.training.pose_targets import Segmentation
    from twohands.training.segmenter import Segment


@dataclass(frozen=True)
class TrainArgs:
    """Arguments of `twohands train`."""

    out: Path
    """Folder of the run."""
    stage: Annotated[
        tyro.conf.Positional[Literal["hand_seg_net", "pose_net_2d", "pose_net_3d"] | None],
        tyro.conf.arg(metavar="STAGE", help_behavior_hint=""),
    ] = None
    """Which network: hand_seg_net, pose_net_2d or pose_net_3d; none with --your-camera."""
    your_camera: Path | None = None
    """Fine-tune for this camera: a file as for twohands track --camera. Takes no --data, --recipe, --weights and
    --segmentation of its own."""
    data: tuple[str, ...] = ()
    """Folders of training pictures (instances, tar shards, frames or photographed digits), or "synthetic" to render
    them on the fly; needed unless resuming."""
    backgrounds: tuple[Path, ...] = ()
    """Folders of photographs to put behind the hands of frames, of digits and of "synthetic", beside procedural
    backgrounds."""
    recipe: Literal["ours", "paper"] = "ours"
    """ours: slim networks, half an hour each on two cores; paper: networks, losses and schedule of the publication."""
    weights: tuple[Path, ...] = ()
    """Checkpoints to start from, of a run or of a preset (its .onnx files); pose_net_3d needs one of pose_net_2d."""
    segmentation: Path | None = None
    """Pose stages: trained HandSegNet, of a run or of a preset, whose masks and boxes are mixed in, so that they learn
    from its errors."""
    max_minutes: Annotated[float | None, tyro.conf.arg(aliases=["--minutes"])] = None
    """Wall-clock budget over all resumes, 0 for none; default: the recipe's. Fine-tuning: of all networks together,
    default 30."""
    iterations: int | None = None
    """Most optimizer steps; default: the recipe's."""
    batch: int | None = None
    """Pictures per step, over all processes; default: the recipe's."""
    seed: int | None = None
    """Seed of weights, order and random changes; default 0."""
    workers: int | None = None
    """Processes that prepare batches; default 2. They get what the steps leave of the processors."""
    threads: int | None = None
    """CPU threads of the training process; default: torch's choice."""
    set: tuple[str, ...] = ()
    """Further settings, NAME=VALUE."""
    resume: bool = False
    """Continue the run in --out, with its own settings except for those given here."""


def resolve(args: TrainArgs) -> TrainConfig:
    """The run that the arguments ask for.

    Raises:
        InputError: no stage, an unknown setting, or a run that cannot be resumed.
        DataFormatError: the settings of the run to resume are damaged.
    """
    from twohands.training.config import TrainConfig, recipe

    if args.stage is None:
        raise InputError("which network? Name a STAGE (hand_seg_net, pose_net_2d, pose_net_3d), or give --your-camera")
    config_file = args.out / "config.json"
    if args.resume:
        if not config_file.is_file():
            raise InputError(f"{args.out} holds no training run to resume")
        try:
            config = TrainConfig.from_dict(json.loads(config_file.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError, AttributeError) as error:
            raise DataFormatError(f"{config_file}: not the settings of a training run: {error}") from error
        if config.stage != args.stage:
            raise InputError(f"{args.out} holds a run of stage {config.stage}, not {args.stage}")
    else:
        config = recipe(args.recipe, args.stage)
    return changed(config, args)


def changed(config: TrainConfig, args: TrainArgs) -> TrainConfig:
    """The run with everything that the arguments change.

    Raises:
        InputError: an unknown setting, settings that do not fit together, or a folder with a comma in its path.
    """
    from twohands.training.config import folder_list, with_override

    given = {
        "iterations": args.iterations,
        "max_minutes": args.max_minutes,
        "batch_images": args.batch,
        "seed": args.seed,
        "threads": args.threads,
    }
    config = dataclasses.replace(config, **{name: value for name, value in given.items() if value is not None})
    data = {
        "source": folder_list(args.data) or None,
        "workers": args.workers,
        "backgrounds": folder_list(args.backgrounds) or None,
        "segmentation": str(args.segmentation) if args.segmentation else None,
    }
    changes = {name: value for name, value in data.items() if value is not None}
    config = dataclasses.replace(config, data=dataclasses.replace(config.data, **changes))
    return with_override(config, *args.set)


def open_segmentation(checkpoint: Path) -> Segment:
    """HandSegNet of a run or of a preset; a preset's runs as in the pipeline, which takes less than half the time.

    Raises:
        CheckpointError: missing, damaged, or of another network.
    """
    from twohands.inference.engine import load_networks
    from twohands.inference.estimator import HandEstimator
    from twohands.inference.weights import read_card
    from twohands.training.segmenter import Segmenter, segmentation_of

    if checkpoint.name != "hand_seg_net.onnx" or not (checkpoint.parent / "card.json").is_file():
        return Segmenter(checkpoint)
    card = read_card(checkpoint.parent)
    # A single view of every picture, like `Segmenter`: the time is the training's.
    card = dataclasses.replace(card, views=dataclasses.replace(card.views, tta_views=()), second="")
    estimator = HandEstimator(load_networks(checkpoint.parent, card, threads=1), card)

    def segment(images: Sequence[np.ndarray]) -> list[Segmentation]:
        seen = [(estimator.stages.hand_maps(image), image.shape[:2]) for image in images]
        return [segmentation_of(maps.seg_logits, maps.energies, maps.scores, size) for maps, size in seen]

    return segment


def run(args: TrainArgs) -> int:
    """Train, printing one line per log entry; under torchrun, only the first process prints."""
    if args.your_camera is not None:
        return _fine_tune(args.your_camera, args)
    from twohands.training.parallel import is_first_process
    from twohands.training.sources import open_source
    from twohands.training.trainer import train

    def say(line: str) -> None:
        if is_first_process():
            print(line, flush=True)

    config = resolve(args)
    check_output_folder(args.out, overwrite=True)  # a run that is there already is the trainer's business
    source, held_out = open_source(config.data)
    say(f"{config.stage}, recipe {config.recipe}: {len(source)} pictures, {len(held_out)} held out")
    result = train(
        config,
        source,
        held_out,
        args.out,
        weights=args.weights,
        resume=args.resume,
        report=say,
        open_segmentation=open_segmentation,
    )
    say(f"{result.iterations} iterations in {result.minutes:.1f} min")
    for name, path in result.checkpoints.items():
        say(f"{name}: {path}")
    return 0


def _fine_tune(camera_file: Path, args: TrainArgs) -> int:
    """Carry out `twohands train --your-camera`."""
    from twohands.cli.fine_tune import DEFAULT_MINUTES, fine_tune

    refused = {
        "a STAGE": args.stage is not None,
        "--data": args.data,
        "--recipe paper": args.recipe != "ours",
        "--weights": args.weights,
        "--segmentation": args.segmentation,
        "torchrun": int(os.environ.get("WORLD_SIZE", 1)) > 1,
    }
    for name, given in refused.items():
        if given:
            raise InputError(f"--your-camera trains all networks from the shipped weights: leave {name} out")
    minutes = DEFAULT_MINUTES if args.max_minutes is None else args.max_minutes
    settings = dataclasses.replace(args, max_minutes=None)
    fine_tune(
        camera_file, args.out, minutes=minutes, resume=args.resume, change=lambda config: changed(config, settings)
    )
    return 0
