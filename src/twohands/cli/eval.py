"""Measure the pipeline, or any other system, on a dataset: predictions are written first and scored later.

`predict` runs the networks and writes a predictions file, `score` scores such a file without any network, `run` does
both and keeps nothing unless asked to; `import` reads other systems' predictions; `budget` says what each stage costs;
`sweep` tries settings of the range smoothing; `report` sets predictions side by side; `results` makes one page of
finished reports. docs/evaluation.md describes metrics, protocols and files.
"""

from __future__ import annotations

import contextlib
import json
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, TypeVar

import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table
from rich.text import Text

from twohands.cli.output import check_output_folder, page_bytes, write_file
from twohands.datasets.base import HandDataset
from twohands.datasets.opening import DatasetOptions, OpenedDataset, open_dataset
from twohands.datasets.read_ahead import read_ahead
from twohands.errors import DataFormatError, InputError
from twohands.evaluation.comparison import Comparison, Protocol, compare
from twohands.evaluation.importing import import_predictions, read_foreign
from twohands.evaluation.predictions import (
    Fingerprint,
    Predictions,
    check_predictions_path,
    load_predictions,
    predict,
    save_predictions,
)
from twohands.evaluation.protocols import evaluate
from twohands.evaluation.report import EvaluationReport, table_row
from twohands.evaluation.results import headlines, inserted, results_page, sweep_findings, sweep_table
from twohands.evaluation.summary import Summary, budget_costs, budget_results, is_number, summarise
from twohands.evaluation.summary import Table as TextTable
from twohands.formats.structured import parse_json
from twohands.inference.budget import STUDIES, Study, error_budget, studies_without_masks
from twohands.inference.budget import VERSION as BUDGET_VERSION
from twohands.inference.estimator import HandEstimator
from twohands.inference.ground_truth import HeatmapTargets, Stage, TruthfulEstimator
from twohands.inference.leaving import CARRIED_FRAMES
from twohands.inference.smoothing_sweep import DEGREES, LENGTHS, smoothing_sweep
from twohands.inference.smoothing_sweep import VERSION as SWEEP_VERSION
from twohands.inference.video import VideoEstimator
from twohands.inference.weights import DEFAULT_PRESET, preset_folder, weights_id
from twohands.peers.base import Handedness
from twohands.peers.mediapipe_hands import MediaPipeHands, Placement
from twohands.types import HandSample, TwoHandPose

Read = TypeVar("Read")
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


@dataclass(frozen=True)
class System:
    """What is measured."""

    weights: str = DEFAULT_PRESET
    """Preset that ships with the package, or a weights folder."""
    truth: tuple[Stage, ...] = ()
    """Stages to replace by ground truth, for isolated results."""
    smooth: bool = False
    """Take the frames of each folder as video: hands that were there a frame before are remembered (not a peer's), and
    ranges are smoothed and leaving hands carried on."""
    peer: Literal["mediapipe"] | None = None
    """Measure another system instead of ours."""
    peer_python: Path | None = None
    """Interpreter of the environment that holds the peer (docs/evaluation.md)."""
    mediapipe_model: Path | None = None
    """Peer mediapipe: hand_landmarker.task, for its Tasks API; the legacy solution of 0.10.21 if not given."""
    handedness: Handedness = "matched"
    """Peer: which hand is which by its own word, or matched with the labels."""
    placement: Placement = "solver"
    """Peer: placed by our solver with the true hand length, or by PnP at its own size."""


MeasuredSystem: TypeAlias = Annotated[System, tyro.conf.arg(name="")]


@dataclass(frozen=True)
class Predict:
    """Run a system and write a predictions file."""

    dataset: DatasetPath
    """Folder of the dataset (docs/datasets.md)."""
    out: Path
    """Predictions file to write, ending in .npz."""
    system: MeasuredSystem = field(default_factory=System)
    data: Data = field(default_factory=DatasetOptions)
    count: int | None = None
    """Only the first COUNT instances."""
    overwrite: bool = False
    """Replace an existing predictions file."""


@dataclass(frozen=True)
class Score:
    """Score a predictions file; no network is run."""

    predictions: PredictionsPath
    """Predictions file."""
    dataset: DatasetPath
    """The dataset it was made from."""
    data: Data = field(default_factory=DatasetOptions)
    rules: ScoringRules = field(default_factory=Rules)
    report: Path | None = None
    """Write the report there: JSON for a name ending in .json, a Markdown table otherwise."""
    overwrite: bool = False
    """Replace an existing report."""


@dataclass(frozen=True)
class Run:
    """Run a system, score it, print the table."""

    dataset: DatasetPath
    """Folder of the dataset (docs/datasets.md)."""
    system: MeasuredSystem = field(default_factory=System)
    data: Data = field(default_factory=DatasetOptions)
    rules: ScoringRules = field(default_factory=Rules)
    count: int | None = None
    """Only the first COUNT instances."""
    report: Path | None = None
    """Write the report there: JSON for a name ending in .json, a Markdown table otherwise."""
    overwrite: bool = False
    """Replace an existing report."""


@dataclass(frozen=True)
class Import:
    """Turn another system's predictions (.json or .npz) into a predictions file."""

    foreign: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")]
    """Its predictions; the format is in docs/evaluation.md."""
    dataset: DatasetPath
    """The dataset they are about."""
    out: Path
    """Predictions file to write, ending in .npz."""
    data: Data = field(default_factory=DatasetOptions)
    count: int | None = None
    """They are about the first COUNT instances only."""
    hand_length_cm: float | None = None
    """Hand length (wrist to middle knuckle) where a range must be solved; each labelled hand's own if not given."""
    overwrite: bool = False
    """Replace an existing predictions file."""


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


@dataclass(frozen=True)
class Report:
    """Set predictions side by side: report.json, report.md and one self-contained report.html."""

    dataset: DatasetPath
    """The dataset that all predictions were made from."""
    predictions: tuple[Path, ...]
    """Predictions files; the first is the system that pictures show."""
    out: Path
    """Folder of the report."""
    names: tuple[str, ...] = ()
    """Short names for the columns, one for each file; the files' names if not given."""
    data: Data = field(default_factory=DatasetOptions)
    rules: ScoringRules = field(default_factory=Rules)
    budget: Path | None = None
    """Error budget to include, from `eval budget --out`."""
    cases: int = 6
    """How many of the worst hands to show, and of the missed and invented ones."""
    note: tuple[str, ...] = ()
    """Remarks for the reader."""
    overwrite: bool = False
    """Replace an existing report."""


@dataclass(frozen=True)
class Sweep:
    """Try settings of the range smoothing on predictions of video; no network is run."""

    predictions: PredictionsPath
    """Predictions file, made without --smooth; the frames of one folder are one sequence."""
    dataset: DatasetPath
    """The dataset it was made from."""
    data: Data = field(default_factory=DatasetOptions)
    fps: float = 30.0
    """Frames a second."""
    lengths: tuple[int, ...] = LENGTHS
    """Queue lengths, in frames."""
    degrees: tuple[int, ...] = DEGREES
    """Degrees of the polynomial."""
    out: Path | None = None
    """Write the sweep there as JSON, for `eval results --sweeps`."""
    overwrite: bool = False
    """Replace an existing file."""


@dataclass(frozen=True)
class Results:
    """Make one Markdown page of finished reports and sweeps; docs/results/generated.md is made like this."""

    reports: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="REPORT")]
    """Files report.json of `eval report`, one section each."""
    out: Path
    """Markdown file to write."""
    sweeps: tuple[Path, ...] = ()
    """Files of `eval sweep --out`."""
    insert: Path | None = None
    """A Markdown file that gets the headlines, between its markers "generated sets"."""
    note: tuple[str, ...] = ()
    """Remarks for the reader."""
    overwrite: bool = False
    """Replace an existing page."""


def run(args: Predict | Score | Run | Import | Budget | Report | Sweep | Results) -> int:
    """Carry out `twohands eval`."""
    match args:
        case Predict():
            return _run_predict(args)
        case Import():
            return _run_import(args)
        case Budget():
            return _run_budget(args)
        case Report():
            return _run_report(args)
        case Sweep():
            return _run_sweep(args)
        case Results():
            return _run_results(args)
        case _:
            return _run_score(args)


def _run_predict(args: Predict) -> int:
    check_predictions_path(args.out, overwrite=args.overwrite)
    dataset = open_dataset(args.dataset, args.data)
    predictions = _predict(dataset, args.system, args.count)
    save_predictions(args.out, predictions, overwrite=args.overwrite)
    print(f"{len(predictions)} predictions written to {args.out}")
    return 0


def _run_score(args: Score | Run) -> int:
    if args.report is not None:
        _refuse_existing(args.report, args.overwrite, "--report")
    predictions = load_predictions(args.predictions) if isinstance(args, Score) else None
    dataset = open_dataset(args.dataset, args.data)
    if isinstance(args, Run):
        predictions = _predict(dataset, args.system, args.count)
    assert predictions is not None
    report = evaluate(
        predictions, _samples(dataset.labels, len(predictions), "scoring"), _protocol(dataset, args.rules)
    )
    _print_report(report)
    if len(predictions) < len(dataset.samples):
        print(f"only the first {len(predictions)} of {len(dataset.samples)} images")
    if args.report is not None:
        text = (
            json.dumps(report.to_dict(), indent=1, allow_nan=False)
            if args.report.suffix == ".json"
            else report.to_markdown()
        )
        write_file(args.report, page_bytes(text))
        print(f"report written to {args.report}")
    return 0


def _run_import(args: Import) -> int:
    check_predictions_path(args.out, overwrite=args.overwrite)
    if args.hand_length_cm is not None and not args.hand_length_cm > 0:
        raise InputError(f"--hand-length-cm must be above 0, got {args.hand_length_cm}")
    foreign = read_foreign(args.foreign)
    samples = open_dataset(args.dataset, args.data).labels
    predictions = import_predictions(
        foreign,
        _samples(samples, _count(args.count, samples), "importing"),
        dataset=samples.name,
        hand_length_m=None if args.hand_length_cm is None else args.hand_length_cm / 100,
    )
    save_predictions(args.out, predictions, overwrite=args.overwrite)
    print(f"{len(predictions)} predictions of '{foreign.system}' written to {args.out}")
    return 0


def _run_budget(args: Budget) -> int:
    if args.out is not None:
        _refuse_existing(args.out, args.overwrite, "--out")
    dataset = open_dataset(args.dataset, args.data)
    samples = dataset.samples
    count = _count(args.count, samples)
    estimator = HandEstimator.from_preset(args.weights)
    targets = HeatmapTargets.from_folder(preset_folder(args.weights))
    has_labels = all(samples[index].labels is not None for index in {0, count - 1})
    studies = STUDIES if has_labels else studies_without_masks()
    notes = () if has_labels else ("No part labels: masks are estimated in every study.",)

    def estimator_of(study: Study) -> Callable[[HandSample], TwoHandPose]:
        return TruthfulEstimator(estimator, study.truth, targets)

    budget = error_budget(
        _samples(samples, count, f"{len(studies)} studies"),
        estimator_of,
        dataset=samples.name,
        weights=weights_id(preset_folder(args.weights), estimator.card),
        studies=studies,
        protocol=_protocol(dataset, args.rules),
        notes=notes,
        command=_command(),
    ).to_dict()
    _print_table(f"{samples.name}: {count} images, weights {budget['weights']}", budget_results(budget))
    _print_table("what each stage costs, fitted", budget_costs(budget))
    for note in notes:
        print(note)
    if args.out is not None:
        write_file(args.out, json.dumps(budget, indent=1, allow_nan=False).encode())
        print(f"budget written to {args.out}")
    return 0


def _run_report(args: Report) -> int:
    from twohands.visualization.evaluation_page import render_page, typical_images, worst_hands

    check_output_folder(args.out, overwrite=args.overwrite)
    files = [load_predictions(path) for path in args.predictions]
    if not files:
        raise InputError("--predictions needs at least one file")
    if args.cases < 0:
        raise InputError(f"--cases must be at least 0, got {args.cases}")
    names = args.names or tuple(path.stem for path in args.predictions)
    if len(names) != len(files) or len(set(names)) != len(names):
        raise InputError(f"--names must be {len(files)} different names, one for each file, got {', '.join(names)}")
    if len({len(file) for file in files}) > 1:
        raise InputError(
            f"the files hold {', '.join(str(len(file)) for file in files)} images; they must hold the same"
        )
    dataset = open_dataset(args.dataset, args.data)
    protocol = _protocol(dataset, args.rules)
    compared: list[tuple[str, Predictions, Comparison]] = []
    for name, file in zip(names, files, strict=True):
        compared.append((name, file, compare(file, _samples(dataset.labels, len(file), f"scoring {name}"), protocol)))
    budget = None if args.budget is None else _read_budget(args.budget, files[0], dataset.labels)
    notes = args.note
    if len(files[0]) < len(dataset.samples):
        notes = (*notes, f"Only the first {len(files[0])} of {len(dataset.samples)} images.")
    summary = summarise(dataset.kind, compared, protocol, budget=budget, command=_command(), notes=notes)
    first = compared[0][2]

    def case(index: int, caption: str, side: int | None = None):
        from twohands.visualization.evaluation_page import Case

        sample = dataset.samples[index]
        return Case(sample, files[0].pose(index, sample.camera), caption, side)

    typical = [case(index, caption) for index, caption in typical_images(first)]
    worst = [case(index, caption, side) for index, side, caption in worst_hands(first, args.cases)]
    page = render_page(summary, typical, worst)
    _write_report(args, summary, page)
    return 0


def _run_sweep(args: Sweep) -> int:
    if args.out is not None:
        _refuse_existing(args.out, args.overwrite, "--out")
    predictions = load_predictions(args.predictions)
    labels = open_dataset(args.dataset, args.data).labels
    sweep = smoothing_sweep(
        predictions,
        _samples(labels, len(predictions), "reading labels"),
        fps=args.fps,
        lengths=args.lengths,
        degrees=args.degrees,
        command=_command(),
    ).to_dict()
    _print_table(f"{sweep['dataset']}: {sweep['frames']} frames, weights {sweep['weights']}", sweep_table(sweep))
    for line in sweep_findings(sweep):
        print(line)
    if args.out is not None:
        write_file(args.out, json.dumps(sweep, indent=1, allow_nan=False).encode())
        print(f"sweep written to {args.out}")
    return 0


def _run_results(args: Results) -> int:
    _refuse_existing(args.out, args.overwrite, "--out")
    summaries = [_read_json(path, Summary.from_dict, "a report.json of twohands eval report") for path in args.reports]
    if not summaries:
        raise InputError("at least one report.json is needed")
    sweeps = [_read_json(path, _checked_sweep, "a sweep of twohands eval sweep") for path in args.sweeps]
    page = results_page(summaries, sweeps, command=_command(), notes=args.note)
    short = None if args.insert is None else _with_headlines(args.insert, summaries)
    write_file(args.out, page_bytes(page))
    if args.insert is not None and short is not None:
        write_file(args.insert, page_bytes(short))
    print(f"{len(summaries)} reports and {len(sweeps)} sweeps set out in {args.out}")
    return 0


def _with_headlines(path: Path, summaries: Sequence[Summary]) -> str:
    """The document with these headlines."""
    try:
        return inserted(path.read_text(encoding="utf-8"), headlines(summaries), "generated sets")
    except (OSError, UnicodeError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None


def _checked_sweep(sweep: dict[str, Any]) -> dict[str, Any]:
    """The same if it can be set out."""
    if sweep["version"] != SWEEP_VERSION:
        raise ValueError(f"expected a sweep of version {SWEEP_VERSION}, got {sweep['version']}")
    _ = sweep_table(sweep), sweep_findings(sweep), [sweep[k] for k in ("dataset", "sequences", "fps", "command")]
    return sweep


def _read_json(path: Path, read: Callable[[dict[str, Any]], Read], what: str) -> Read:
    """A file of our own; one that is none, or of another version, is named."""
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        return read(parse_json(path.read_bytes()))
    except (OSError, DataFormatError, ValueError, KeyError, TypeError, AttributeError, StopIteration) as error:
        reason = f" ({error})" if isinstance(error, ValueError | DataFormatError) else ""
        raise DataFormatError(f"{path}: not {what}{reason}") from None


def _write_report(args: Report, summary: Summary, page: str) -> None:
    files = {
        "report.json": json.dumps(summary.to_dict(), indent=1, allow_nan=False).encode(),
        "report.md": page_bytes(summary.to_markdown()),
        "report.html": page_bytes(page),
    }
    for name, content in files.items():
        write_file(args.out / name, content)
    print(f"report.json, report.md and report.html written to {args.out}")


def _predict(dataset: OpenedDataset, system: System, count: int | None) -> Predictions:
    samples = _samples(dataset.samples, _count(count, dataset.samples), "predicting")
    with contextlib.ExitStack() as stack:
        if system.peer == "mediapipe":
            if system.truth:
                raise InputError("--truth replaces stages of our pipeline; a peer has none of them")
            peer = stack.enter_context(
                MediaPipeHands(
                    system.peer_python,
                    handedness=system.handedness,
                    placement=system.placement,
                    model=system.mediapipe_model,
                )
            )
            name, settings = peer.name, peer.settings

            def estimate(sample: HandSample, previous: TwoHandPose | None = None) -> TwoHandPose:
                return peer(sample)

        else:
            estimator = HandEstimator.from_preset(system.weights)
            targets = HeatmapTargets.from_folder(preset_folder(system.weights))
            estimate = TruthfulEstimator(estimator, system.truth, targets)
            name = weights_id(preset_folder(system.weights), estimator.card)
            settings = _settings(estimator, system)
        if system.smooth:
            settings = settings | {"smoothed": True, "carried_frames": CARRIED_FRAMES}
        system_under_test = _Video(estimate) if system.smooth else estimate
        predictions = predict(samples, system_under_test, dataset=dataset.samples.name, weights=name, settings=settings)
    return replace(predictions, command=_command())


def _settings(estimator: HandEstimator, system: System) -> dict[str, Any]:
    return {
        "card": asdict(estimator.card),
        "hand_length_m": "each hand's own, from its labels",
        "camera": "the dataset's",
        "truth": list(system.truth),
    }


class _Video:
    """An estimator over the frames of folders, each a clip of its own: told what it said of the frame before, with
    smooth ranges, leaving hands carried on, and sides that hands keep (`inference.video`)."""

    def __init__(self, estimate: Callable[[HandSample, TwoHandPose | None], TwoHandPose]) -> None:
        self._estimate = estimate
        self._video = VideoEstimator()
        self._folder: str | None = None
        self._frame = 0

    def __call__(self, sample: HandSample) -> TwoHandPose:
        folder = sample.source.rpartition("/")[0]
        if folder != self._folder:
            self._video.reset()
            self._folder, self._frame = folder, 0
        pose = self._video.update(lambda previous: replace(self._estimate(sample, previous), index=self._frame))
        self._frame += 1
        return pose


def _protocol(dataset: OpenedDataset, rules: Rules) -> Protocol:
    visible = dataset.visible_only if rules.joints == "auto" else rules.joints == "visible"
    return Protocol(visible_only=visible, all_hands_labelled=dataset.all_hands_labelled, fps=rules.fps)


def _count(count: int | None, samples: HandDataset) -> int:
    if count is not None and count < 1:
        raise InputError(f"--count must be at least 1, got {count}")
    return len(samples) if count is None else min(count, len(samples))


def _samples(dataset: HandDataset, count: int, doing: str) -> Iterator[HandSample]:
    console = Console(stderr=True)
    samples = read_ahead(dataset, min(count, len(dataset)))
    return iter(
        track(
            samples,
            doing,
            total=min(count, len(dataset)),
            console=console,
            disable=not console.is_terminal,
            transient=True,
        )
    )


def _read_budget(path: Path, predictions: Predictions, labels: HandDataset) -> dict[str, Any]:
    """A budget of the same images as the predictions, or of the first of them."""
    budget = _read_json(path, _checked_budget, "an error budget of twohands eval budget")
    identity, images = budget["dataset_id"], min(budget["images"], len(predictions))
    found = predictions.dataset_id
    if images < len(predictions):
        fingerprint = Fingerprint()
        for sample in _samples(labels, images, "reading labels"):
            fingerprint.add(sample)
        found = str(fingerprint)
    if identity != found:
        raise InputError(f"{path}: the budget is of other data ({identity}) than the predictions ({found})")
    return budget


def _checked_budget(budget: dict[str, Any]) -> dict[str, Any]:
    """The same if it can be set out."""
    if (version := budget["version"]) != BUDGET_VERSION:
        raise ValueError(f"expected a budget of version {BUDGET_VERSION}, got {version}")
    _ = budget_results(budget), budget_costs(budget), budget["dataset_id"], budget["images"]  # every number is there
    return budget


def _command() -> str:
    """This command, without the way to its program."""
    return shlex.join(["twohands", *sys.argv[1:]])


def _refuse_existing(path: Path, overwrite: bool, option: str) -> None:
    """See, before any work is done, whether a file may be written."""
    check_output_folder(path.parent, overwrite=True)
    if path.exists() and not overwrite:
        raise InputError(f"{path}: exists already; choose another {option}, or allow it with --overwrite")


def _print_report(report: EvaluationReport) -> None:
    title = f"{report.dataset}: {report.images} images, labels {report.dataset_id}, weights {report.weights}"
    head = ["metric", "value", "left", "right", "unit", "count"]
    _print_table(title, [head, *(list(table_row(metric)) for metric in report.metrics)])


def _print_table(title: str, rows: TextTable) -> None:
    table = Table(title=Text(title), title_justify="left")  # names of folders may look like markup
    for column, name in enumerate(rows[0]):
        numbers = all(is_number(row[column]) for row in rows[1:])
        table.add_column(name, justify="right" if numbers else "left")
    for row in rows[1:]:
        table.add_row(*row)
    Console().print(table)
