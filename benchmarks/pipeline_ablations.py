"""What single steps of the pipeline bring, with the same weights on the same pictures: one markdown table per ablation.

    python -m benchmarks.pipeline_ablations STATIC --dynamic DYNAMIC --out out/pipeline

STATIC and DYNAMIC are folders made by `twohands generate static` and `twohands generate dynamic`. Nothing is trained;
what needs training is in `benchmarks/ablations.py`. Every row changes what it names and nothing else. Hand lengths are
those of the labels. Errors run over the hands that were found, in shares a miss is a failure.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import shlex
import sys
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from twohands.cli.output import check_output_folder, write_file
from twohands.datasets.base import HandDataset
from twohands.datasets.opening import open_dataset
from twohands.datasets.read_ahead import read_ahead
from twohands.errors import InputError, TwoHandsError
from twohands.evaluation.comparison import compare, without_picture
from twohands.evaluation.predictions import Predictions, predict
from twohands.evaluation.protocols import metrics_of
from twohands.evaluation.report import format_number
from twohands.evaluation.summary import markdown_table
from twohands.geometry.projection import Method, project_global, range_weights
from twohands.inference.decision import PictureView
from twohands.inference.engine import Networks, SecondNetworks, load_networks
from twohands.inference.estimator import HandEstimator
from twohands.inference.keypoints import read_out
from twohands.inference.stages import Stages
from twohands.inference.weights import DEFAULT_PRESET, WeightsCard, preset_folder, weights_id
from twohands.studies.budget import STUDIES
from twohands.studies.ground_truth import HeatmapTargets, TruthfulEstimator
from twohands.studies.smoothing_sweep import smoothing_sweep
from twohands.types import GlobalPose, HandCrop, HandSample, PinholeCamera, TwoHandPose

Estimate = Callable[[HandSample], TwoHandPose]
ALWAYS = (-math.inf, math.inf)
ROLLS: dict[str, tuple[float, ...]] = {
    "none": (),
    "15 degrees": (15.0,),
    "15 and -15 degrees": (15.0, -15.0),
    "10 and 20 degrees to either side": (10.0, -10.0, 20.0, -20.0),
    "10, 20 and 30 degrees to either side": (10.0, -10.0, 20.0, -20.0, 30.0, -30.0),
}
Values = dict[str, float]
"""Numbers by the keys of `evaluation.protocols`."""

ISOLATED = "A row estimates what it names and is given the rest; one with dots goes on with the row above."
RULES = (
    "2D errors in pixels of 480x270. Shares, 0..1, run over all hands, and a miss is a failure; other errors over the "
    "hands that were found."
)
COLUMNS = {
    "error_2d_median": "2D, median (px)",
    "direction_1.5deg": "direction within 1.5 deg",
    "direction_3deg": "within 3 deg",
    "range_3.5cm": "range within 3.5 cm",
    "range_7cm": "within 7 cm",
    "range_median": "range, median (cm)",
    "auc_20_50_spherical": "canonical AUC 20-50 mm",
    "cs_mpjpe": "CS-MPJPE (mm)",
    "missed": "missed",
    "false": "invented",
}
SMOOTHING_COLUMNS = {
    "range_3.5cm": "range within 3.5 cm",
    "range_7cm": "within 7 cm",
    "range_median": "range, median (cm)",
    "range_median_added": "added (cm)",
    "cs_mpjpe": "CS-MPJPE (mm)",
    "acceleration_radial": "radial jitter (m/s2)",
    "acceleration_radial_less": "less (%)",
}


@dataclass(frozen=True, slots=True)
class Ablation:
    """Variants of the pipeline that differ in one thing.

    Attributes:
        title: of the table.
        about: what a reader must know.
        variants: name of the row -> the pipeline.
    """

    title: str
    about: str
    variants: dict[str, Estimate]


@dataclass(frozen=True, slots=True)
class Table:
    """The measured variants.

    Attributes:
        title, about: as in `Ablation`.
        rows: name of the row -> all its numbers.
        columns: key of a number -> its heading.
    """

    title: str
    about: str
    rows: dict[str, Values]
    columns: dict[str, str]

    def to_markdown(self) -> str:
        """A section with the table."""
        body = [
            [name, *(format_number(round(values.get(key, math.nan), 3) + 0.0) for key in self.columns)]  # no -0.000
            for name, values in self.rows.items()
        ]
        lines = markdown_table([["", *self.columns.values()], *body])
        return "\n".join([f"## {self.title}", "", self.about, "", *lines])

    def to_dict(self) -> dict[str, Any]:
        """JSON values, all numbers of every row; NaN becomes None."""
        rows = [
            {"name": name} | {key: None if math.isnan(value) else value for key, value in values.items()}
            for name, values in self.rows.items()
        ]
        return {"title": self.title, "about": self.about, "rows": rows}


class Memory:
    """What networks have said about the picture at hand: variants that ask the same thing share the answer."""

    def __init__(self) -> None:
        self._answers: dict[tuple[Hashable, bytes], Any] = {}

    def networks(self, networks: Networks) -> Networks:
        """The same networks, run once for every input."""
        second = networks.second
        return dataclasses.replace(
            networks,
            hand_seg_net=self._once(networks.hand_seg_net),
            second=None if second is None else dataclasses.replace(second, **self._pose_networks(second)),
            **self._pose_networks(networks),
        )

    def clear(self) -> None:
        """Forget everything; for the next picture."""
        self._answers.clear()

    def _pose_networks(self, pair: Networks | SecondNetworks) -> dict[str, Any]:
        return {name: self._once(getattr(pair, name)) for name in ("pose_net_2d", "pose_net_3d")}

    def _once(self, network: Callable[[np.ndarray], Any]) -> Callable[[np.ndarray], Any]:
        def call(batch: np.ndarray) -> Any:
            key = network, batch.tobytes()
            if key not in self._answers:
                self._answers[key] = network(batch)
            return self._answers[key]

        return call


def reading(networks: Networks, card: WeightsCard, decoder: str) -> HandEstimator:
    """A pipeline that reads joints from the maps by another rule; their scores, by which the range is solved, as the
    card says.

    Args:
        networks, card: as `HandEstimator`.
        decoder: "subpixel" or "softargmax", as in a card, or "argmax": the centre of the highest cell.
    """
    peaks_only = decoder == "argmax"

    def changed(plain: Stages) -> Stages:
        other = dataclasses.replace(plain.card, heatmap_decode="softargmax" if peaks_only else decoder)

        def read(heatmaps: np.ndarray, crops: list[HandCrop]) -> tuple[np.ndarray, np.ndarray]:
            _, scores = plain.read_out(heatmaps, crops)
            joints_px, _ = read_out(other, highest_cells(heatmaps) if peaks_only else heatmaps, crops)
            return joints_px, scores

        second = None if plain.second is None else changed(plain.second)
        return dataclasses.replace(plain, read_out=read, second=second)

    return HandEstimator(networks, card, changed(Stages.of(networks, card)))


def highest_cells(maps: np.ndarray) -> np.ndarray:
    """Maps (..., M, M) with 1 in the highest cell and 0 elsewhere, whose mean is that cell's centre."""
    flat = maps.reshape(*maps.shape[:-2], -1)
    only = np.zeros_like(flat)
    np.put_along_axis(only, flat.argmax(axis=-1, keepdims=True), 1.0, axis=-1)
    return only.reshape(maps.shape)


def solving(networks: Networks, card: WeightsCard, method: Method, *, weighted: bool = False) -> HandEstimator:
    """A pipeline that places the root by another method.

    Args:
        networks, card: as `HandEstimator`.
        method: as `project_global`.
        weighted: whether the joints count as in the pipeline; else all alike.
    """

    def place(
        canonical: np.ndarray,
        joints_px: np.ndarray,
        joint_scores: np.ndarray,
        camera: PinholeCamera,
        lengths_m: np.ndarray,
    ) -> GlobalPose:
        weights = range_weights(joint_scores) if weighted else None
        return project_global(canonical, joints_px, camera, lengths_m, method=method, weights=weights)

    return HandEstimator(networks, card, dataclasses.replace(Stages.of(networks, card), place=place))


def viewing(networks: Networks, card: WeightsCard, **rules: Any) -> HandEstimator:
    """A pipeline that sees pictures and hands otherwise: fields of `ViewConfig`."""
    return HandEstimator(networks, dataclasses.replace(card, views=dataclasses.replace(card.views, **rules)))


def pulling(networks: Networks, card: WeightsCard, ray_share: float) -> HandEstimator:
    """A pipeline that pulls joints farther to where they are seen, or less far."""
    placement = dataclasses.replace(card.placement, ray_share=ray_share)
    return HandEstimator(networks, dataclasses.replace(card, placement=placement))


def in_words(views: Sequence[PictureView]) -> str:
    """HandSegNet's further views, for a reader."""
    sizes = (f"{view.size[0]}x{view.size[1]}{', mirrored' if view.mirrored else ''}" for view in views)
    return "; ".join(sizes) or "none"


def isolated(complete: TruthfulEstimator, targets: HeatmapTargets) -> dict[str, Estimate]:
    """The studies of the error budget, the last of which is the complete pipeline itself."""
    studies = {
        study.name: TruthfulEstimator(complete.estimator, study.truth, targets) for study in STUDIES if study.truth
    }
    return {**studies, "complete": complete}


def ablations(complete: TruthfulEstimator, floating: Networks | None) -> list[Ablation]:
    """Everything that is tried on single pictures.

    Args:
        complete: the pipeline as it is shipped.
        floating: its networks in floating point, where they are shipped in 8 bits.
    """
    networks, card = complete.estimator.networks, complete.estimator.card
    views = card.views
    low, high = views.tta_score_range

    def read_by(decoder: str) -> Estimate:
        return complete if decoder == card.heatmap_decode else TruthfulEstimator(reading(networks, card, decoder))

    as_projected = dataclasses.replace(card, placement=dataclasses.replace(card.placement, range_errors=None))
    places: dict[str, Estimate] = {
        "key bone": TruthfulEstimator(solving(networks, as_projected, "keybone")),
        "all joints alike": TruthfulEstimator(solving(networks, as_projected, "all-joints")),
        "all joints, weighted": TruthfulEstimator(solving(networks, as_projected, "all-joints", weighted=True)),
        "fitted": complete,
    }
    if card.placement.range_errors is not None:
        places["fitted"] = TruthfulEstimator(HandEstimator(networks, as_projected))
        places["fitted, the likely range"] = complete

    found = [
        Ablation(
            "Read-out of the heatmaps",
            f"Ours for these weights: {card.heatmap_decode}. The joints' scores are the same in all rows.",
            {
                "argmax, the highest cell's centre": read_by("argmax"),
                "subpixel, parabola through the peak": read_by("subpixel"),
                "softargmax, mean within a window": read_by("softargmax"),
            },
        ),
        Ablation(
            "The root's place",
            "The paper's: key bone. Ours: the last row. In the first three the root keeps its own pixel.",
            places,
        ),
        Ablation(
            "Joints pulled to their lines of sight",
            "Ours: PoseNet2D's joints correct PoseNet3D's across the line of sight, by so much. The paper: not at all.",
            {
                "0": TruthfulEstimator(pulling(networks, card, 0.0)),
                f"{card.placement.ray_share:g}": complete,
                "1": TruthfulEstimator(pulling(networks, card, 1.0)),
            },
        ),
        Ablation(
            "Second crop",
            "Ours: PoseNet2D sees a hand again where HandSegNet's box and that of the joints differ. Paper: one crop.",
            {
                "never": TruthfulEstimator(viewing(networks, card, recrop_below_iou=0.0)),
                f"overlap below {views.recrop_below_iou:g}": complete,
                "always": TruthfulEstimator(viewing(networks, card, recrop_below_iou=math.inf)),
            },
        ),
        Ablation(
            "More views of the picture",
            "Ours: where it is uncertain, HandSegNet sees the picture again. The paper: one view.",
            {
                "never": TruthfulEstimator(viewing(networks, card, tta_views=())),
                f"a score between {low:g} and {high:g}: {in_words(views.tta_views)}": complete,
                "always: the same": TruthfulEstimator(viewing(networks, card, tta_score_range=ALWAYS)),
            },
        ),
        Ablation(
            "More views of a hand",
            "By the pose networks, as cameras see it that are rolled so far; the median counts. The paper: one view.",
            {
                name: complete
                if rolls == views.tta_rolls_deg
                else TruthfulEstimator(viewing(networks, card, tta_rolls_deg=rolls))
                for name, rolls in ROLLS.items()
            },
        ),
    ]
    if card.hand_logit:
        silent = HandEstimator(networks, dataclasses.replace(card, hand_logit=False))
        found.append(
            Ablation(
                "Hand classifier",
                "Ours: PoseNet2D says whether a crop shows a hand of its side. Without: HandSegNet's word is taken.",
                {"off": TruthfulEstimator(silent), "on": complete},
            )
        )
    if floating is not None:
        found.append(
            Ablation(
                "Arithmetic",
                "As compiled for this processor.",
                {
                    f"floating point: {floating.runtime}": TruthfulEstimator(HandEstimator(floating, card)),
                    f"8 bits: {networks.runtime}": complete,
                },
            )
        )
    return found


def predict_all(
    samples: Iterable[HandSample], estimates: Iterable[Estimate], memory: Memory, *, dataset: str, weights: str
) -> tuple[list[HandSample], dict[Estimate, Predictions]]:
    """Runs variants over pictures, each of which is read once.

    Args:
        samples: N labelled pictures.
        estimates: the variants; one that is there twice runs once.
        memory: of their networks.
        dataset, weights: for the predictions.

    Returns:
        N labels without pictures, and every variant's predictions, without masks.
    """
    labels: list[HandSample] = []
    poses: dict[Estimate, list[TwoHandPose]] = {estimate: [] for estimate in estimates}
    for sample in samples:
        for estimate, said in poses.items():
            said.append(dataclasses.replace(estimate(sample), masks=None))
        labels.append(without_picture(sample))
        memory.clear()

    def gathered(said: list[TwoHandPose]) -> Predictions:
        turn = iter(said)
        return predict(labels, lambda _: next(turn), dataset=dataset, weights=weights, settings={})

    return labels, {estimate: gathered(said) for estimate, said in poses.items()}


def measured(ablation: Ablation, predictions: dict[Estimate, Predictions], labels: Sequence[HandSample]) -> Table:
    """All numbers of an ablation's variants."""
    rows = {name: numbers(predictions[estimate], labels) for name, estimate in ablation.variants.items()}
    return Table(ablation.title, ablation.about, rows, COLUMNS)


def numbers(predictions: Predictions, labels: Sequence[HandSample]) -> Values:
    """Every metric's value by its key."""
    return {metric.key: metric.value for metric in metrics_of(compare(predictions, labels))}


def smoothing(predictions: Predictions, labels: Sequence[HandSample], fps: float) -> Table:
    """Queue length x degree of the range's smoothing over video.

    Beside the sweep's own numbers, what a setting adds to the median error and takes off the jitter.
    """
    rows: dict[str, Values] = {}
    for row in smoothing_sweep(predictions, labels, fps=fps).rows:
        values = {key: metric.value for key, metric in row.metrics.items()}
        rows[row.name] = values
    off = rows["no smoothing"]
    for values in rows.values():
        values["range_median_added"] = values["range_median"] - off["range_median"]
        if (jitter := off.get("acceleration_radial", 0.0)) > 0:  # missing where no hand was found in three frames
            values["acceleration_radial_less"] = 100 * (1 - values["acceleration_radial"] / jitter)
    about = "Of the root's range, causal. Jitter: mean error of the root's acceleration along the line of sight."
    return Table("Smoothing over video", about, rows, SMOOTHING_COLUMNS)


def first_of(dataset: HandDataset, limit: int | None) -> Iterable[HandSample]:
    """The samples of a data set, with progress on a terminal."""
    count = len(dataset) if limit is None else min(limit, len(dataset))
    console = Console(stderr=True)
    return track(
        read_ahead(dataset, count),
        dataset.name,
        count,
        console=console,
        disable=not console.is_terminal,
        transient=True,
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures, prints the tables and writes them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("static", type=Path, help="folder of single pictures")
    parser.add_argument("--dynamic", type=Path, required=True, help="folder of video, one folder a sequence")
    parser.add_argument("--fps", type=float, default=30.0, help="its frames a second")
    parser.add_argument("--weights", default=DEFAULT_PRESET, help="preset that ships with the package, or a folder")
    parser.add_argument("--limit", type=int, help="only the first LIMIT pictures of either")
    parser.add_argument("--out", type=Path, required=True, help="the tables as OUT.md, all numbers as OUT.json")
    args = parser.parse_args(arguments)
    if args.limit is not None and args.limit < 3:
        raise InputError(f"--limit must be at least 3, got {args.limit}: smoothing needs video")
    check_output_folder(args.out.parent, overwrite=True)
    pictures, video = (open_dataset(folder).samples for folder in (args.static, args.dynamic))
    folder, memory = preset_folder(args.weights), Memory()
    shipped = HandEstimator.from_preset(folder)
    card, weights = shipped.card, weights_id(folder, shipped.card)
    complete = TruthfulEstimator(HandEstimator(memory.networks(shipped.networks), card))
    floating = memory.networks(load_networks(folder, dataclasses.replace(card, int8={}))) if card.int8 else None
    tried = ablations(complete, floating)
    studies = isolated(complete, HeatmapTargets.from_folder(folder))

    every = [*(estimate for ablation in tried for estimate in ablation.variants.values()), *studies.values()]
    stills, said = predict_all(first_of(pictures, args.limit), every, memory, dataset=pictures.name, weights=weights)
    frames, said_in_video = predict_all(
        first_of(video, args.limit), studies.values(), memory, dataset=video.name, weights=weights
    )
    static = measured(Ablation("Isolated and complete, static", ISOLATED, studies), said, stills)
    dynamic = measured(Ablation("Isolated and complete, dynamic", ISOLATED, studies), said_in_video, frames)
    both = {"static": static.rows["complete"], "dynamic": dynamic.rows["complete"]}
    tables = [
        *(measured(ablation, said, stills) for ablation in tried),
        static,
        dynamic,
        Table("Static and dynamic", "The complete pipeline.", both, COLUMNS),
        smoothing(said_in_video[complete], frames, args.fps),
    ]

    given = sys.argv[1:] if arguments is None else arguments
    about = {
        "command": shlex.join(["python", "-m", "benchmarks.pipeline_ablations", *given]),
        "weights": weights,
        "runtime": shipped.networks.runtime,
        "static": f"{pictures.name}, {len(stills)} pictures with {hands_in(stills)} hands",
        "dynamic": f"{video.name}, {len(frames)} pictures with {hands_in(frames)} hands",
    }
    text = page(about, tables)
    print(text)
    content = about | {"tables": [table.to_dict() for table in tables]}
    write_file(args.out.with_name(f"{args.out.name}.md"), f"{text}\n".encode())
    write_file(args.out.with_name(f"{args.out.name}.json"), f"{json.dumps(content, indent=1)}\n".encode())


def page(about: dict[str, str], tables: Sequence[Table]) -> str:
    """All tables as one document."""
    head = [
        "# Ablations of the pipeline",
        f"```\n{about['command']}\n```",
        f"Weights {about['weights']}, {about['runtime']}. Static: {about['static']}. Dynamic: {about['dynamic']}.",
        RULES,
    ]
    return "\n\n".join([*head, *(table.to_markdown() for table in tables)])


def hands_in(labels: Sequence[HandSample]) -> int:
    """How many hands are labelled."""
    return int(sum(sample.present.sum() for sample in labels))


if __name__ == "__main__":
    try:
        main()
    except TwoHandsError as error:
        sys.exit(f"error: {error}")
