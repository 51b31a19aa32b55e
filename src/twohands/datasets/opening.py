"""Opens any data set that can be read: says which one a folder holds, and what its labels leave open."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, TypeAlias, cast, get_args

from twohands.datasets import freihand, interhand, rhd, stb
from twohands.datasets.base import HandDataset
from twohands.datasets.ego3dhands import LABELS_ONLY
from twohands.datasets.files import existing_folder
from twohands.datasets.shards import ShardedEgo3DHands, open_ego3dhands
from twohands.errors import InputError
from twohands.formats import ego3dhands as fmt

Kind: TypeAlias = Literal["ego3dhands", "stb", "rhd", "freihand", "interhand"]

DEFAULT_SPLIT: Final[dict[str, str]] = {
    "stb": "test",
    "rhd": "evaluation",
    "freihand": "evaluation",
    "interhand": "test",
}


@dataclass(frozen=True, slots=True)
class DatasetOptions:
    """What there is to choose about a data set beside its folder."""

    kind: Kind | None = None
    "Which data set it is; found out from the folder if not given."
    split: str | None = None
    "stb: train, test; rhd, freihand: training, evaluation; interhand: train, val, test. By default the one to test on."
    hands: rhd.Hands = "evaluated"
    "rhd: the one hand that the field evaluates, or both."
    joint_zero: stb.JointZero = "palm"
    "stb: what joint 0 is."
    background: freihand.Background = "gs"
    "freihand: version of the training pictures."
    subset: str | None = None
    "interhand: folder below annotations; the split's name by default."


@dataclass(frozen=True, slots=True)
class OpenedDataset:
    """A data set with what an evaluation must know about it.

    Attributes:
        kind: which one.
        samples: its labelled pictures.
        labels: the same samples for scoring: where decoding pictures takes long, they are black.
        all_hands_labelled: whether a hand that is not labelled is not in the picture either.
        visible_only: whether published numbers run over visible joints only.
    """

    kind: Kind
    samples: HandDataset
    labels: HandDataset
    all_hands_labelled: bool = True
    visible_only: bool = False


def detect_kind(root: str | os.PathLike[str]) -> Kind:
    """Which data set a folder holds, from the names of the files that only it has.

    Args:
        root: the folder, as in docs/datasets.md.

    Raises:
        InputError: no such folder, or none of the layouts, or more than one.
    """
    folder = existing_folder(root)
    found: list[Kind] = []
    if any((folder / split / f"anno_{split}.pickle").is_file() for split in ("training", "evaluation")):
        found.append("rhd")
    if any((folder / f"{split}_K.json").is_file() for split in ("training", "evaluation")):
        found.append("freihand")
    if any((folder / "labels").glob("B*_BB.mat")):
        found.append("stb")
    if any((folder / "annotations").glob("*/InterHand2.6M_*_data.json")):
        found.append("interhand")
    if not found and _holds_instance(folder):
        found.append("ego3dhands")
    if len(found) != 1:
        what = f"files of {' and '.join(found)}" if found else "no dataset of a known layout"
        raise InputError(f"{folder}: holds {what} (docs/datasets.md); name one with --kind {'|'.join(get_args(Kind))}")
    return found[0]


def open_dataset(root: str | os.PathLike[str], options: DatasetOptions | None = None) -> OpenedDataset:
    """Opens a data set by its folder.

    Args:
        root: the folder, as in docs/datasets.md.
        options: what to choose; None for what published numbers use.

    Raises:
        InputError: no such folder, no known layout, or a split that the data set does not have.
        DataFormatError: a label file is missing or damaged.
        MissingExtraError: STB without SciPy.
    """
    options = options or DatasetOptions()
    kind = options.kind or detect_kind(root)
    split = options.split or DEFAULT_SPLIT.get(kind, "")
    if kind == "ego3dhands":
        if options.split is not None:
            raise InputError("this layout has no --split; give the folder of the split itself")
        ego3dhands = open_ego3dhands(root)
        return OpenedDataset(kind, ego3dhands.leaving_out({fmt.DEPTH_FILE}), labels=ego3dhands.leaving_out(LABELS_ONLY))
    if kind == "rhd":
        both = options.hands == "both"
        pictures = rhd.RHD(root, cast(rhd.Split, split), hands=options.hands)
        return OpenedDataset(kind, pictures, pictures, all_hands_labelled=both, visible_only=True)
    if kind == "stb":
        samples = stb.STB(root, cast(stb.Split, split), joint_zero=options.joint_zero)
    elif kind == "freihand":
        samples = freihand.FreiHAND(root, cast(freihand.Split, split), background=options.background)
    else:
        samples = interhand.InterHand(root, cast(interhand.Split, split), subset=options.subset)
    return OpenedDataset(kind, samples, samples)


def _holds_instance(folder: Path) -> bool:
    if ShardedEgo3DHands.is_sharded(folder):
        return True
    return any(fmt.JOINTS_2D_FILE in files for _, _, files in os.walk(folder, followlinks=True))
