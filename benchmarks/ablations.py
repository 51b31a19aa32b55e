"""The paper's ablations of the pose networks, each row trained alike: markdown tables.

    python -m benchmarks.ablations --data FRAMES --out runs/ablations --iterations 800

The full networks are beyond a CPU, so the rows are those of a small one: recipe `ours` with a fresh PoseNet2D 0.4
times as wide as our slim one, upright crops, the background blacked out as in the paper, and PoseNet2D fixed while
PoseNet3D learns. The slim network has no form without batch normalisation: that pair of rows trains a narrow pose
machine of two stages, on batches of a quarter. Every row changes what it names and nothing else. Stages are studied
alone, as in the paper's isolated analysis: true boxes and masks, and for PoseNet3D the maps of the 2D row that it
starts from. Figures are those of the held-out pictures at the ends of the folders. The rows are trained one after the
other; a run that was killed goes on with the same command, finished rows are not trained again.

What needs no training is in `benchmarks/pipeline_ablations.py`.
"""

from __future__ import annotations

import argparse
import dataclasses
import re
import shlex
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from twohands.errors import TwoHandsError
from twohands.evaluation.summary import markdown_table
from twohands.models.pose_net_2d import PoseNet2DConfig
from twohands.models.presets import SLIM
from twohands.training.config import StageName, TrainConfig, recipe, with_override
from twohands.training.sources import open_source
from twohands.training.trainer import TrainResult, train

SMALL = (
    *("max_minutes=0", "optim.optimizer=adamw", "optim.along_rate=0", "crop.background=0"),
    *("data.empty=0", "data.clutter=0", "data.remixed=0", "crop.roll=0", "augment.mirrored=0"),
    *("networks.pose_net_3d.width=0.5", "networks.pose_net_3d.cues=0", "loss.place=0"),
)
"""What all rows change in recipe `ours`."""
SLIM_2D = dataclasses.replace(SLIM.pose_net_2d, width=0.5, judge=False, cues=0)
POSE_MACHINE = dataclasses.replace(SLIM_2D, variant="vgg", crop_size=256, stages=2, width=0.25)


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        name: what a reader calls it; unique.
        stage: the network that is trained.
        settings: what differs from the recipe, as for `twohands train --set`.
        start: 2D row whose network makes the maps, for PoseNet3D.
        network: PoseNet2D.
        pictures: per step.
    """

    name: str
    stage: StageName
    settings: tuple[str, ...] = ()
    start: str = ""
    network: PoseNet2DConfig = SLIM_2D
    pictures: int = 16

    @property
    def folder(self) -> str:
        """Name of the row's run."""
        return re.sub(r"\W+", "_", self.name)


BASE = "2D: masks, z-heatmaps"
PLAIN = "2D: masks, plain heatmaps"
ROWS = (
    Row(BASE, "pose_net_2d"),
    Row("2D: no segmentation", "pose_net_2d", ("crop.background=1.0",)),
    Row(PLAIN, "pose_net_2d", ("loss.z_heatmaps=false",)),
    Row("3D: L_j", "pose_net_3d", ("loss.bone=0", "loss.projection=0"), BASE),
    Row("3D: L_j + L_bone", "pose_net_3d", ("loss.projection=0",), BASE),
    Row("3D: L_j + L_bone + L_proj", "pose_net_3d", (), BASE),
    Row("3D: all three, plain heatmaps", "pose_net_3d", ("loss.z_heatmaps=false",), PLAIN),
    Row("2D: pose machine", "pose_net_2d", network=POSE_MACHINE, pictures=4),
    Row(
        "2D: pose machine, no batch norm",
        "pose_net_2d",
        ("networks.pose_net_2d.batch_norm=false",),
        network=POSE_MACHINE,
        pictures=4,
    ),
)
ERRORS_2D = {"image_px_median": ("median, px", 1.0, 2), "image_px_mean": ("mean, px", 1.0, 2)}
ERRORS_3D = {
    "canonical_median": ("median, % of the hand length", 100.0, 2),
    "canonical_mean": ("mean, %", 100.0, 2),
    "bone_mean": ("bone length, %", 100.0, 2),
}
"""Figure of `Stage.validate` -> column, factor, digits."""
ABOUT = """Every row is a fresh network, smaller than the shipped ones, trained for the same number of steps on the same
pictures; it changes what it names and nothing else. True boxes and masks; figures of held-out
pictures, 480x270."""


def row_config(row: Row, data: str, further: tuple[str, ...] = ()) -> TrainConfig:
    """The run of a row.

    Args:
        row: one of `ROWS`.
        data: folders of training pictures, separated by commas.
        further: settings of all rows.
    """
    config = recipe("ours", row.stage)
    config = dataclasses.replace(
        config,
        batch_images=row.pictures,
        data=dataclasses.replace(config.data, source=data),
        networks=dataclasses.replace(config.networks, pose_net_2d=row.network),
    )
    return with_override(config, *SMALL, *row.settings, *further)


def train_row(row: Row, config: TrainConfig, out: Path) -> TrainResult:
    """Train a row, or go on with it, or find that it is finished."""
    source, held_out = open_source(config.data)
    start = next((other for other in ROWS if other.name == row.start), None)
    return train(
        config,
        source,
        held_out,
        out / row.folder,
        weights=[out / start.folder / "pose_net_2d.safetensors"] if start else [],
        resume=(out / row.folder / "config.json").is_file(),
        report=lambda line: print(f"{row.name:<32} {line}", file=sys.stderr, flush=True),
    )


def table(results: Mapping[str, TrainResult], columns: Mapping[str, tuple[str, float, int]]) -> list[str]:
    """Markdown: a line per row, a column per figure."""
    body = [
        [name, str(result.iterations)]
        + [f"{factor * result.figures[key]:.{digits}f}" for key, (_, factor, digits) in columns.items()]
        for name, result in results.items()
    ]
    return markdown_table([["", "steps", *(title for title, _, _ in columns.values())], *body])


def page(results: Mapping[str, TrainResult], command: str) -> str:
    """A section with a table for each network, and a third for the pose machine.

    Args:
        results: name of the row -> its training; rows may be missing.
        command: that made them.
    """
    lines = ["# Ablations that need training", "", "```", command, "```", "", ABOUT, ""]
    tables = (
        ("PoseNet2D", "pose_net_2d", SLIM_2D, ERRORS_2D),
        ("PoseNet3D", "pose_net_3d", SLIM_2D, ERRORS_3D),
        (
            "PoseNet2D as a narrow pose machine of two stages, batches of a quarter",
            "pose_net_2d",
            POSE_MACHINE,
            ERRORS_2D,
        ),
    )
    for title, stage, network, columns in tables:
        names = [row.name for row in ROWS if row.stage == stage and row.network == network and row.name in results]
        if names:
            lines += [f"## {title}", "", *table({name: results[name] for name in names}, columns), ""]
    return "\n".join(lines)


def main() -> None:
    """Trains what is missing, prints the tables, and keeps them in the folder after every row."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True, help="folders of training pictures, separated by commas")
    parser.add_argument("--out", type=Path, required=True, help="folder of the runs")
    parser.add_argument("--iterations", type=int, default=800, help="steps of every row")
    parser.add_argument("--set", nargs="*", default=[], help="further settings of all rows, NAME=VALUE")
    args = parser.parse_args()
    further = (f"iterations={args.iterations}", *args.set)
    command = shlex.join(["python", "-m", "benchmarks.ablations", *sys.argv[1:]])
    results: dict[str, TrainResult] = {}
    text = ""
    for row in ROWS:
        results[row.name] = train_row(row, row_config(row, args.data, further), args.out)
        text = page(results, command)
        (args.out / "ablations.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    try:
        main()
    except TwoHandsError as error:
        sys.exit(f"error: {error}")
