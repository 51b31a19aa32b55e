"""The outcome of an evaluation: every number with its unit, its count and the rule that made it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Final

VERSION: Final = 1


@dataclass(frozen=True, slots=True)
class Metric:
    """One number.

    Attributes:
        key: stable name for programs.
        name: name for people.
        value: the number; NaN where there is nothing to measure.
        unit: its unit; "" for a share of 0..1.
        count: what the number runs over: hands, images, or image pairs of hands.
        rule: how it was aggregated and what became of missed hands.
        left, right: the same number for one hand only, None where it has no sides.
    """

    key: str
    name: str
    value: float
    unit: str
    count: int
    rule: str
    left: float | None = None
    right: float | None = None


@dataclass(frozen=True, slots=True)
class EvaluationReport:
    """All metrics of one predictions file.

    Attributes:
        dataset, dataset_id, weights, settings: as in the predictions.
        images: number of images scored.
        protocol: what counted (`comparison.Protocol`).
        metrics: in the order of the table.
    """

    dataset: str
    dataset_id: str
    weights: str
    settings: dict[str, Any]
    images: int
    metrics: tuple[Metric, ...]
    protocol: dict[str, Any] = field(default_factory=dict[str, Any])

    def __getitem__(self, key: str) -> Metric:
        for metric in self.metrics:
            if metric.key == key:
                return metric
        raise KeyError(key)

    def to_dict(self) -> dict[str, Any]:
        """JSON values; NaN becomes None."""
        content = {"version": VERSION} | asdict(self)
        content["metrics"] = [
            {name: _json_number(value) for name, value in asdict(metric).items()} for metric in self.metrics
        ]
        return content

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> EvaluationReport:
        """Undoes `to_dict`, but for the sides' numbers: JSON does not tell "nothing to measure" from "no sides"."""
        values = {
            name: content[name] for name in ("dataset", "dataset_id", "weights", "settings", "images", "protocol")
        }
        return cls(**values, metrics=tuple(metric_from_dict(metric) for metric in content["metrics"]))

    def to_markdown(self) -> str:
        """A table for documents: metric, value, left, right, unit, count."""
        rows = [("metric", "value", "left", "right", "unit", "count"), ("---", *("---:",) * 3, "---", "---:")]
        rows += [table_row(metric) for metric in self.metrics]
        title = f"{self.dataset} ({self.images} images, id {self.dataset_id}), weights {self.weights}"
        return "\n".join([title, "", *(f"| {' | '.join(row)} |" for row in rows)]) + "\n"


def metric_from_dict(content: dict[str, Any]) -> Metric:
    """A metric from JSON values; None becomes NaN."""
    known: dict[str, Any] = content | ({"value": math.nan} if content["value"] is None else {})
    return Metric(**known)


def json_values(metrics: Mapping[str, Metric]) -> dict[str, float | None]:
    """The numbers alone, by key, as JSON has them: NaN becomes None."""
    return {key: _json_number(metric.value) for key, metric in metrics.items()}


def table_row(metric: Metric) -> tuple[str, str, str, str, str, str]:
    """(metric, value, left, right, unit, count) as text."""
    numbers = (format_number(number) for number in (metric.value, metric.left, metric.right))
    value, left, right = numbers
    return metric.name, value, left, right, metric.unit, str(metric.count)


def format_number(number: float | None) -> str:
    """Four significant digits, at most three behind the point.

    "n/a" for a number (NaN) for which there was nothing to measure, "-" for one (None) that has no sides.
    """
    if number is None:
        return "-"
    if math.isnan(number):
        return "n/a"
    if math.isinf(number):
        return "inf"
    if number == int(number) and abs(number) < 1e6:
        return str(int(number))
    return f"{number:.3f}" if abs(number) < 100 else f"{number:.1f}"


def _json_number(value: Any) -> Any:
    return None if isinstance(value, float) and math.isnan(value) else value
