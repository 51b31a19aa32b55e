"""Arguments that several verbs of `twohands eval` share, and what they mean."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import tyro

from twohands.datasets.base import HandDataset
from twohands.datasets.opening import DatasetOptions, OpenedDataset
from twohands.errors import InputError
from twohands.evaluation.comparison import Protocol

DatasetPath: TypeAlias = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DATASET")]
PredictionsPath: TypeAlias = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="PREDICTIONS")]
Data: TypeAlias = Annotated[DatasetOptions, tyro.conf.arg(name="")]


@dataclass(frozen=True)
class Rules:
    """What counts; by default what published numbers on the dataset use."""

    joints: Literal["auto", "all", "visible"] = "auto"
    """Score all labelled joints, or those that the labels call visible; auto: visible on rhd, all elsewhere."""
    fps: float | None = None
    """The instances of one folder are consecutive frames at so many a second: acceleration errors are scored too."""


ScoringRules: TypeAlias = Annotated[Rules, tyro.conf.arg(name="")]


def protocol_of(dataset: OpenedDataset, rules: Rules) -> Protocol:
    """How a dataset is scored: what the rules ask for, else what published numbers on it use."""
    visible = dataset.visible_only if rules.joints == "auto" else rules.joints == "visible"
    return Protocol(visible_only=visible, all_hands_labelled=dataset.all_hands_labelled, fps=rules.fps)


def count_of(count: int | None, samples: HandDataset) -> int:
    """How many instances `--count` asks for.

    Raises:
        InputError: fewer than one.
    """
    if count is not None and count < 1:
        raise InputError(f"--count must be at least 1, got {count}")
    return len(samples) if count is None else min(count, len(samples))


def this_command() -> str:
    """This command, without the way to its program."""
    return shlex.join(["twohands", *sys.argv[1:]])
