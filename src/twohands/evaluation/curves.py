"""PCK curves: the panels of the paper's figures on STB and Ego3DHands, drawn for any system."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from twohands.evaluation import metrics as m
from twohands.evaluation.comparison import Comparison
from twohands.skeleton import LEFT, RIGHT


@dataclass(frozen=True, slots=True)
class Panel:
    """One set of axes.

    Attributes:
        key: stable name.
        title, unit: what is plotted along x.
        thresholds: (T,) along x.
        errors: gives the errors (N, 2, J) in that unit.
        marks: thresholds that the paper speaks of.
    """

    key: str
    title: str
    unit: str
    thresholds: m.FloatArray
    errors: Callable[[Comparison], m.FloatArray]
    marks: tuple[float, ...] = ()


PANELS: Final = (
    Panel("2d", "2D PCK, width 480", "px", m.AUC_2D_PX, lambda c: c.joints_px),
    Panel("3d", "3D PCK, canonical, spherical alignment", "mm", m.AUC_0_50_MM, lambda c: c.spherical_mm, (20.0,)),
    Panel("theta", "Spherical PCK, theta", "deg", m.AUC_ANGLE_DEG, lambda c: c.root[..., 0:1], (3.0,)),
    Panel("phi", "Spherical PCK, phi", "deg", m.AUC_ANGLE_DEG, lambda c: c.root[..., 1:2], (3.0,)),
    Panel("range", "Spherical PCK, range", "cm", m.AUC_RANGE_CM, lambda c: 1e2 * c.root[..., 3:4], (7.0,)),
    Panel("camera", "3D PCK in camera space", "mm", np.linspace(0.0, 150.0, 101), lambda c: c.camera_mm),
)


@dataclass(frozen=True, slots=True)
class Curve:
    """One system in one panel.

    Attributes:
        panel: which one.
        shares: (T,) 0..1, mean of left and right; NaN without any hand.
        auc: area under it over the panel's whole range, 0..1.
    """

    panel: Panel
    shares: m.FloatArray
    auc: float

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> Curve:
        """A curve from its JSON values; None becomes NaN."""
        panel = next(panel for panel in PANELS if panel.key == content["panel"])
        shares = np.array([np.nan if share is None else share for share in content["shares"]], float)
        return cls(panel, shares, float("nan") if content["auc"] is None else content["auc"])


def pck_curves(comparison: Comparison) -> tuple[Curve, ...]:
    """A curve for every panel; misses are failures at every threshold."""
    return tuple(_curve(panel, panel.errors(comparison)) for panel in PANELS)


def _curve(panel: Panel, errors: m.FloatArray) -> Curve:
    known = [errors[:, side] for side in (LEFT, RIGHT) if not np.isnan(errors[:, side]).all()]
    if not known:
        return Curve(panel, np.full(panel.thresholds.shape, np.nan), float("nan"))
    shares = np.mean([m.pck_curve(side, panel.thresholds) for side in known], axis=0)
    return Curve(panel, shares, float(np.mean([m.pck_auc(side, panel.thresholds) for side in known])))
