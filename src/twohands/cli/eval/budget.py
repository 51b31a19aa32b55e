"""`twohands eval budget`: feed each stage with ground truth in turn; what do the others cost?"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twohands.cli.eval.arguments import Data, DatasetPath, Rules, ScoringRules, count_of, protocol_of, this_command
from twohands.cli.eval.console import print_table, with_progress
from twohands.cli.eval.files import read_own_json, refuse_existing
from twohands.cli.output import write_file
from twohands.datasets.base import HandDataset
from twohands.datasets.opening import DatasetOptions, open_dataset
from twohands.errors import InputError
from twohands.evaluation.predictions import Fingerprint, Predictions
from twohands.evaluation.summary import budget_costs, budget_results
from twohands.inference.estimator import HandEstimator
from twohands.inference.weights import DEFAULT_PRESET, preset_folder, weights_id
from twohands.studies.budget import STUDIES, VERSION, Study, error_budget, studies_without_masks
from twohands.studies.ground_truth import HeatmapTargets, TruthfulEstimator
from twohands.types import HandSample, TwoHandPose


@dataclass(frozen=True)
class Budget:
    """Feed each stage with ground truth in turn and print what the others cost."""

    dataset: DatasetPath
    """Folder of the dataset (docs/datasets.md)."""
    weights: str = DEFAULT_PRESET
    """Preset that ships with the package, or a weights folder."""
    data: Data = field(default_factory=DatasetOptions)
    rules: ScoringRules = field(default_factory=Rules)
    count: int | None = None
    """Only the first COUNT instances."""
    out: Path | None = None
    """Write the budget there as JSON, for `eval report --budget`."""
    overwrite: bool = False
    """Replace an existing file."""


def run(args: Budget) -> int:
    """Carry out `twohands eval budget`."""
    if args.out is not None:
        refuse_existing(args.out, args.overwrite, "--out")
    dataset = open_dataset(args.dataset, args.data)
    samples = dataset.samples
    count = count_of(args.count, samples)
    estimator = HandEstimator.from_preset(args.weights)
    targets = HeatmapTargets.from_folder(preset_folder(args.weights))
    has_labels = all(samples[index].labels is not None for index in {0, count - 1})
    studies = STUDIES if has_labels else studies_without_masks()
    notes = () if has_labels else ("No part labels: masks are estimated in every study.",)

    def estimator_of(study: Study) -> Callable[[HandSample], TwoHandPose]:
        return TruthfulEstimator(estimator, study.truth, targets)

    budget = error_budget(
        with_progress(samples, count, f"{len(studies)} studies"),
        estimator_of,
        dataset=samples.name,
        weights=weights_id(preset_folder(args.weights), estimator.card),
        studies=studies,
        protocol=protocol_of(dataset, args.rules),
        notes=notes,
        command=this_command(),
    ).to_dict()
    print_table(f"{samples.name}: {count} images, weights {budget['weights']}", budget_results(budget))
    print_table("what each stage costs, fitted", budget_costs(budget))
    for note in notes:
        print(note)
    if args.out is not None:
        write_file(args.out, json.dumps(budget, indent=1, allow_nan=False).encode())
        print(f"budget written to {args.out}")
    return 0


def read_budget(path: Path, predictions: Predictions, labels: HandDataset) -> dict[str, Any]:
    """A budget of the same images as the predictions, or of the first of them."""
    budget = read_own_json(path, _checked_budget, "an error budget of twohands eval budget")
    identity, images = budget["dataset_id"], min(budget["images"], len(predictions))
    found = predictions.dataset_id
    if images < len(predictions):
        fingerprint = Fingerprint()
        for sample in with_progress(labels, images, "reading labels"):
            fingerprint.add(sample)
        found = str(fingerprint)
    if identity != found:
        raise InputError(f"{path}: the budget is of other data ({identity}) than the predictions ({found})")
    return budget


def _checked_budget(budget: dict[str, Any]) -> dict[str, Any]:
    """The same if it can be set out."""
    if (version := budget["version"]) != VERSION:
        raise ValueError(f"expected a budget of version {VERSION}, got {version}")
    _ = budget_results(budget), budget_costs(budget), budget["dataset_id"], budget["images"]  # every number is there
    return budget
