"""The same metrics over parts of a data set: by distance from the camera, by overlap of the hands, by how
much of a hand is in view, by side."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np

from twohands.evaluation import metrics as m
from twohands.evaluation.comparison import Comparison
from twohands.evaluation.protocols import metrics_of

RANGE_EDGES_M: Final = (0.0, 0.3, 0.4, 0.5, 0.6, 0.8, np.inf)
OVERLAP_EDGES: Final = (0.0, 0.25, 0.5, np.inf)
VISIBLE_EDGES: Final = (0.0, 0.25, 0.5, 0.75, np.inf)

COLUMNS: Final[tuple[tuple[str, str, str], ...]] = (
    ("missed", "missed", ""),
    ("error_2d_mean", "2D", "px"),
    ("error_3d_spherical_mean", "canonical", "mm"),
    ("direction_median", "direction", "deg"),
    ("range_median", "range", "cm"),
    ("range_relative_median", "range", "%"),
    ("cs_mpjpe", "CS-MPJPE", "mm"),
)
"""Metric key, heading, unit. 2D and canonical: mean, pooled; direction and range: median; CS-MPJPE: mean."""


@dataclass(frozen=True, slots=True)
class Part:
    """One row.

    Attributes:
        name: which hands.
        hands: how many are present.
        values: metric key -> value, of COLUMNS; NaN where there is nothing to measure.
    """

    name: str
    hands: int
    values: dict[str, float]


@dataclass(frozen=True, slots=True)
class Breakdown:
    """One table.

    Attributes:
        key: stable name.
        title: what the parts differ in.
        parts: those that hold any hand.
    """

    key: str
    title: str
    parts: tuple[Part, ...]

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> Breakdown:
        """A table from its JSON values; None becomes NaN."""
        parts = [
            Part(part["name"], part["hands"], {k: np.nan if v is None else v for k, v in part["values"].items()})
            for part in content["parts"]
        ]
        return cls(content["key"], content["title"], tuple(parts))


def breakdowns(comparison: Comparison) -> tuple[Breakdown, ...]:
    """Tables by range, overlap, joints in view and side; parts without any hand, and tables without any part, are left
    out."""
    range_m, overlap, share = comparison.range_m, comparison.overlap, comparison.visible_share
    alone = comparison.present & ~comparison.present[:, ::-1]
    together = comparison.present & ~alone
    ranges = [
        (_between(low, high, 100, "cm"), (range_m >= low) & (range_m < high)) for low, high in pairwise(RANGE_EDGES_M)
    ]
    overlaps = [("alone in the picture", alone), ("beside the other hand", together & (overlap == 0))]
    overlaps += [
        (f"box covered {_between(low, high, 100, '%')}", together & (overlap > low) & (overlap <= high))
        for low, high in pairwise(OVERLAP_EDGES)
    ]
    visible = [
        (_between(low, high, 100, "%"), (share >= low) & (share < high)) for low, high in pairwise(VISIBLE_EDGES)
    ]
    left = np.broadcast_to([True, False], comparison.present.shape)
    tables = (
        Breakdown("distance", "By distance of the root joint", _parts(comparison, ranges)),
        Breakdown("overlap", "By overlap with the other hand's box", _parts(comparison, overlaps)),
        Breakdown("joints in view", "By the share of a hand's joints that are in view", _parts(comparison, visible)),
        Breakdown("side", "By side", _parts(comparison, [("left", left), ("right", ~left)])),
    )
    return tuple(table for table in tables if table.parts)


def _parts(comparison: Comparison, groups: list[tuple[str, m.BoolArray]]) -> tuple[Part, ...]:
    found: list[Part] = []
    for name, keep in groups:
        hands = int((comparison.present & keep).sum())
        if hands:
            metrics = {metric.key: metric.value for metric in metrics_of(comparison.of_hands(keep))}
            found.append(Part(name, hands, {key: metrics[key] for key, _, _ in COLUMNS}))
    return tuple(found)


def _between(low: float, high: float, factor: int, unit: str) -> str:
    if np.isinf(high):
        return f"over {factor * low:.0f} {unit}"
    return f"{factor * low:.0f}-{factor * high:.0f} {unit}" if low else f"up to {factor * high:.0f} {unit}"
