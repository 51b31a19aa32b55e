"""Several systems on one data set: everything that the report shows, as JSON values and as Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np

from twohands.evaluation.breakdown import COLUMNS, Breakdown, breakdowns
from twohands.evaluation.comparison import Comparison, Protocol
from twohands.evaluation.curves import PANELS, Curve, pck_curves
from twohands.evaluation.predictions import Predictions
from twohands.evaluation.protocols import metrics_of, report_of
from twohands.evaluation.published import GENERATED_CAVEAT, Published, published_for
from twohands.evaluation.report import EvaluationReport, Metric, format_number, metric_from_dict

VERSION: Final = 3
Table = list[list[str]]
"""Rows of text; the first is the heading."""

HEADLINE: Final = (
    "presence_accuracy",
    "missed",
    "false",
    "miou",
    "box_accuracy",
    "error_2d_median",
    "epe_2d_mean",
    "auc_2d",
    "epe_3d_spherical_mean",
    "epe_3d_spherical_median",
    "auc_20_50_spherical",
    "auc_0_50_spherical",
    "pa_mpjpe",
    "bone_length",
    "direction_median",
    "direction_3deg",
    "range_median",
    "range_relative_median",
    "range_7cm",
    "cs_mpjpe",
    "cs_median",
    "mrrpe",
    "failure_100mm",
    "acceleration_tangential",
    "acceleration_radial",
)
"""Metrics of the first table; the rest follows in a table of its own."""


COMMON: Final = (
    "error_2d_median",
    "error_2d_mean",
    "error_3d_spherical_mean",
    "pa_mpjpe",
    "bone_length",
    "direction_median",
    "range_median",
    "range_relative_median",
    "cs_mpjpe",
    "cs_median",
)
"""Metrics of the table over hands that every system found: errors only, shares would say nothing."""

COMMON_TITLE: Final = "Over the hands that every system found, with a range"


@dataclass(frozen=True, slots=True)
class SystemResult:
    """One system.

    Attributes:
        name: short name for headings.
        report: all metrics.
        parts: the same by range, overlap, joints in view and side.
        curves: PCK.
        common: the metrics over the hands that every system found, with a range; empty for a single system.
        command: what made its predictions; "" where unknown.
    """

    name: str
    report: EvaluationReport
    parts: tuple[Breakdown, ...]
    curves: tuple[Curve, ...]
    common: tuple[Metric, ...] = ()
    command: str = ""


@dataclass(frozen=True, slots=True)
class Summary:
    """Everything about one data set.

    Attributes:
        kind: which data set (`datasets.opening.Kind`).
        systems: in the order of the columns.
        budget: an error budget's JSON values, or None.
        command: what makes this report again.
        notes: what a reader must know.
    """

    kind: str
    systems: tuple[SystemResult, ...]
    budget: dict[str, Any] | None = None
    command: str = ""
    notes: tuple[str, ...] = field(default=())

    @property
    def published(self) -> tuple[Published, ...]:
        """The paper's numbers for this data set."""
        return published_for(self.kind)

    def to_dict(self) -> dict[str, Any]:
        """JSON values; NaN becomes None."""
        return {
            "version": VERSION,
            "kind": self.kind,
            "command": self.command,
            "notes": list(self.notes),
            "systems": [
                {
                    "name": system.name,
                    "command": system.command,
                    "report": system.report.to_dict(),
                    "common": [_jsonable(asdict(metric)) for metric in system.common],
                    "parts": [_jsonable(asdict(part)) for part in system.parts],
                    "curves": [
                        {
                            "panel": curve.panel.key,
                            "unit": curve.panel.unit,
                            "thresholds": curve.panel.thresholds.tolist(),
                            "shares": _jsonable(curve.shares.tolist()),
                            "auc": _jsonable(curve.auc),
                        }
                        for curve in system.curves
                    ],
                }
                for system in self.systems
            ],
            "published": [asdict(number) for number in self.published],
            "budget": self.budget,
        }

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> Summary:
        """Undoes `to_dict`.

        Raises:
            KeyError, TypeError, ValueError, StopIteration: these are not its values.
        """
        if content["version"] != VERSION:
            raise ValueError(f"expected a report of version {VERSION}, got {content['version']}")
        systems = [
            SystemResult(
                system["name"],
                EvaluationReport.from_dict(system["report"]),
                tuple(Breakdown.from_dict(part) for part in system["parts"]),
                tuple(Curve.from_dict(curve) for curve in system["curves"]),
                tuple(metric_from_dict(metric) for metric in system["common"]),
                system["command"],
            )
            for system in content["systems"]
        ]
        return cls(content["kind"], tuple(systems), content["budget"], content["command"], tuple(content["notes"]))

    def headline_table(self) -> Table:
        """Metric by system, the important ones."""
        return self.metrics_table([key for key in HEADLINE if key in self.metric_keys()])

    def common_table(self) -> Table:
        """Errors over the hands that every system found, with a range: nobody gains by missing the difficult ones.

        Empty for a single system, and where there is no such hand, as beside a system that gives no ranges at all.
        """
        found = [{metric.key: metric for metric in system.common} for system in self.systems]
        table: Table = [["metric", "unit", *(system.name for system in self.systems), "hands"]]
        for key in COMMON:
            metrics = [metrics[key] for metrics in found if key in metrics]
            if metrics and metrics[0].count:
                name, unit, count = metrics[0].name, metrics[0].unit, str(metrics[0].count)
                table.append([name, unit, *(format_number(metric.value) for metric in metrics), count])
        return table if len(table) > 1 else []

    def full_table(self) -> Table:
        """Metric by system, all of them."""
        return self.metrics_table(self.metric_keys())

    def published_table(self) -> Table:
        """The paper's numbers beside each system's; empty where the paper has none."""
        if not self.published:
            return []
        table = [["metric", "published", "by", *(system.name for system in self.systems), "before comparing"]]
        for number in self.published:
            ours = [_value(system.report, number.metric) for system in self.systems]
            name = self.metric_name(number.metric)
            printed = number.printed + (f" {number.unit}" if number.unit else "")
            table.append([name, printed, number.system, *ours, number.caveat])
        return table

    def part_tables(self) -> list[tuple[str, Table]]:
        """Title and table of each breakdown, one row a part and system."""
        tables: list[tuple[str, Table]] = []
        for index, breakdown in enumerate(self.systems[0].parts):
            head = [
                breakdown.key,
                "hands",
                "system",
                *(f"{name} ({unit})" if unit else name for _, name, unit in COLUMNS),
            ]
            rows: Table = [head]
            for position, part in enumerate(breakdown.parts):
                for turn, system in enumerate(self.systems):
                    values = system.parts[index].parts[position].values
                    first = [part.name, str(part.hands)] if turn == 0 else ["", ""]
                    rows.append([*first, system.name, *(format_number(values[key]) for key, _, _ in COLUMNS)])
            tables.append((breakdown.title, rows))
        return tables

    def auc_table(self) -> Table:
        """Area under each PCK curve by system."""
        table = [["curve", "range", *(system.name for system in self.systems)]]
        for index, panel in enumerate(PANELS):
            span = f"{panel.thresholds[0]:g}-{panel.thresholds[-1]:g} {panel.unit}"
            table.append([panel.title, span, *(format_number(system.curves[index].auc) for system in self.systems)])
        return table

    def budget_tables(self) -> tuple[Table, Table] | None:
        """The error budget's two tables: results, and what each stage costs; None without a budget."""
        return None if self.budget is None else (budget_results(self.budget), budget_costs(self.budget))

    def budget_texts(self) -> list[str]:
        """How to read the error budget, and how many images it is about where these are not all, a paragraph each."""
        images = (self.budget or {}).get("images")
        fewer = [] if images == self.systems[0].report.images else [f"Over the first {images} images."]
        return [BUDGET_TEXT, *fewer]

    def to_markdown(self) -> str:
        """The whole report as one document."""
        first = self.systems[0].report
        lines = ["# Results", ""]
        if self.command:
            lines += ["Made by this command, not by hand:", "", "```", self.command, "```", ""]
        lines += [*self.about(), ""]
        for note in self.notes:
            lines += [f"> {note}", ""]
        lines += ["## Summary", "", *markdown_table(self.headline_table()), ""]
        if table := self.common_table():
            lines += [f"## {COMMON_TITLE}", "", *markdown_table(table), ""]
        if table := self.published_table():
            lines += ["## Beside published numbers", ""]
            if self.kind == "ego3dhands":
                lines += [GENERATED_CAVEAT, ""]
            lines += [*markdown_table(table), ""]
        if tables := self.budget_tables():
            lines += ["## Error budget", ""]
            for text in self.budget_texts():
                lines += [text, ""]
            lines += [*markdown_table(tables[0]), ""]
            lines += ["What each stage costs (fitted):", "", *markdown_table(tables[1]), ""]
        for title, table in self.part_tables():
            lines += [f"## {title}", "", *markdown_table(table), ""]
        lines += ["## Areas under the curves", "", *markdown_table(self.auc_table()), ""]
        lines += ["## All metrics", "", *markdown_table(self.full_table()), ""]
        lines += [f"Labels {first.dataset_id}.", ""]
        return "\n".join(lines)

    def about(self) -> list[str]:
        """Which data, which systems, which rules, as sentences."""
        first = self.systems[0].report
        rules = [
            "joint errors over visible joints only"
            if first.protocol.get("visible_only")
            else "all labelled joints count",
            "missed hands fail every share, and are left out of means and medians of errors",
        ]
        if not first.protocol.get("all_hands_labelled", True):
            rules.append("not every hand is labelled, so finding one without label is neither right nor wrong")
        text = [f"Data: {first.dataset}, {first.images} images. Rules: {'; '.join(rules)}."]
        text += [f"- {system.name}: {system.report.weights}" for system in self.systems]
        return text

    def metric_keys(self) -> list[str]:
        """Keys of all metrics that any system has, those of the first system first."""
        keys: dict[str, None] = {}
        for system in self.systems:
            keys.update((metric.key, None) for metric in system.report.metrics)
        return list(keys)

    def metric_name(self, key: str) -> str:
        """Name for people of a metric's key."""
        for system in self.systems:
            for metric in system.report.metrics:
                if metric.key == key:
                    return metric.name
        return key

    def metrics_table(self, keys: Sequence[str]) -> Table:
        """Metric by system: name, unit, a value for each system, count.

        Args:
            keys: of metrics that at least one system has.
        """
        table = [["metric", "unit", *(system.name for system in self.systems), "count"]]
        for key in keys:
            found = [metric for system in self.systems for metric in system.report.metrics if metric.key == key]
            counts = [_count(system.report, key) for system in self.systems]
            count = counts[0] if len(set(counts)) == 1 else " / ".join(counts)
            table.append(
                [found[0].name, found[0].unit, *(_value(system.report, key) for system in self.systems), count]
            )
        return table


BUDGET_TEXT: Final = (
    "Each row runs the pipeline with labels in place of every stage but those named. 2D and canonical pose: mean over "
    "all joints; direction and range of the root joint: median; hands found only. The first row is the global step "
    "alone, on labels, where the paper claims an error of 0. What a stage costs is the difference of two rows; medians "
    "do not add up exactly."
)


def summarise(
    kind: str,
    systems: Sequence[tuple[str, Predictions, Comparison]],
    protocol: Protocol,
    *,
    budget: dict[str, Any] | None = None,
    command: str = "",
    notes: tuple[str, ...] = (),
) -> Summary:
    """Gathers the report of (name, predictions, comparison) of each system."""
    placed = np.all([comparison.present & comparison.valid for _, _, comparison in systems], axis=0)
    results = tuple(
        SystemResult(
            name,
            report_of(predictions, comparison, protocol),
            breakdowns(comparison),
            pck_curves(comparison),
            metrics_of(comparison.of_hands(placed)) if len(systems) > 1 else (),
            predictions.command,
        )
        for name, predictions, comparison in systems
    )
    return Summary(kind, results, budget, command, notes)


def budget_results(budget: dict[str, Any]) -> Table:
    """One row a study: what was estimated, the errors, hands missed."""
    both = "key bone / fitted"
    head = [
        "estimated",
        "2D (px)",
        "canonical (mm)",
        "direction (deg)",
        f"range (cm), {both}",
        f"CS-MPJPE (mm), {both}",
    ]
    table: Table = [[*head, "missed"]]
    for row in budget["rows"]:
        metrics = row["metrics"]
        numbers = [_fixed(metrics["fitted"][key]) for key in BUDGET_COLUMNS[:3]]
        numbers += [
            " / ".join(_fixed(metrics[how][key]) for how in ("keybone", "fitted")) for key in BUDGET_COLUMNS[3:]
        ]
        table.append([row["estimated"], *numbers, _whole(metrics["fitted"]["missed"])])
    return table


def budget_costs(budget: dict[str, Any]) -> Table:
    """One row a stage: what it adds to the study that has it perfect."""
    rows = {row["study"]: row for row in budget["rows"]}
    head = [
        "stage",
        "added to",
        "2D (px)",
        "canonical (mm)",
        "direction (deg)",
        "range (cm)",
        "CS-MPJPE (mm)",
        "missed",
    ]
    table: Table = [head]
    for row in budget["rows"]:
        if row["against"] is None:
            continue
        now, before = row["metrics"]["fitted"], rows[row["against"]]["metrics"]["fitted"]
        costs = [_difference(now[key], before[key], "+.3f") for key in BUDGET_COLUMNS]
        missed = _difference(now["missed"], before["missed"], "+.0f")
        table.append([row["stage"], rows[row["against"]]["estimated"], *costs, missed])
    return table


BUDGET_COLUMNS: Final = ("error_2d_mean", "error_3d_spherical_mean", "direction_median", "range_median", "cs_mpjpe")


def markdown_table(table: Table) -> list[str]:
    """Lines of a Markdown table; a column of numbers is set flush right."""
    head, *rows = table
    marks = ["---:" if rows and all(is_number(row[column]) for row in rows) else "---" for column in range(len(head))]
    return [f"| {' | '.join(cell.replace('|', '/') for cell in row)} |" for row in (head, marks, *rows)]


def is_number(text: str) -> bool:
    """Whether a cell holds numbers only, such as "1.2", "+3 / n/a", and not "" or words."""
    pieces = text.replace(" / ", " ").split()
    numbers = [piece in ("n/a", "-", "inf") or piece.lstrip("+-").replace(".", "", 1).isdigit() for piece in pieces]
    return bool(pieces) and all(numbers)


def _value(report: EvaluationReport, key: str) -> str:
    return next((format_number(metric.value) for metric in report.metrics if metric.key == key), "n/a")


def _count(report: EvaluationReport, key: str) -> str:
    return next((str(metric.count) for metric in report.metrics if metric.key == key), "0")


def _fixed(number: float | None) -> str:
    return "n/a" if number is None else f"{number:.3f}"


def _whole(number: float | None) -> str:
    return "n/a" if number is None else f"{number:.0f}"


def _difference(now: float | None, before: float | None, form: str) -> str:
    if now is None or before is None:
        return "n/a"
    return format(round(now - before, 3) + 0.0, form)  # + 0.0 takes the sign off a zero


def _jsonable(value: Any) -> Any:
    """NaN and infinity become None, tuples lists."""
    if isinstance(value, dict):
        return {key: _jsonable(item) for key, item in value.items()}  # pyright: ignore
    if isinstance(value, list | tuple):
        return [_jsonable(item) for item in value]  # pyright: ignore
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
