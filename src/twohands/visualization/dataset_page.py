"""One self-contained HTML page about a dataset, or two side by side: what its hands look like, in charts."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from html import escape

import cv2
import numpy as np

from twohands.datasets.inspection.distributions import Distributions
from twohands.datasets.inspection.inspect import DatasetReport
from twohands.skeleton import FINGERS
from twohands.visualization.svg import heat_map, histogram, ranges

MAX_PROBLEMS = 50
SHEET_QUALITY = 85
_HISTOGRAMS: tuple[tuple[str, str, Callable[[Distributions], np.ndarray], np.ndarray, str], ...] = (
    (
        "Range",
        "Distance of the root joint (middle knuckle) from the camera.",
        lambda d: 100 * d.range_m,
        np.linspace(0, 100, 41),
        "cm",
    ),
    (
        "Direction, down",
        "Angle of the root joint below the optical axis (theta).",
        lambda d: d.theta_deg,
        np.linspace(-50, 50, 41),
        "degrees",
    ),
    (
        "Direction, right",
        "Angle of the root joint to the right of the optical axis (phi).",
        lambda d: d.phi_deg,
        np.linspace(-60, 60, 41),
        "degrees",
    ),
    (
        "Palm orientation",
        "0: the palm faces the camera, 90: seen from its edge, 180: the back of the hand faces it.",
        lambda d: d.palm_deg,
        np.linspace(0, 180, 37),
        "degrees",
    ),
    (
        "Direction of pointing",
        "From wrist to middle knuckle in the picture. 0: up, 90: right, -90: left.",
        lambda d: d.pointing_deg,
        np.linspace(-180, 180, 37),
        "degrees",
    ),
    (
        "Hand overlap",
        "Intersection over union of the two hands' joint boxes, of pictures with both hands.",
        lambda d: d.overlap,
        np.linspace(0, 1, 26),
        "IoU",
    ),
    (
        "Visible fraction",
        "Share of a hand's 21 joints whose pixel shows that hand or its arm.",
        lambda d: d.visible,
        np.linspace(0, 1, 22),
        "share of the joints",
    ),
    (
        "Skin tone",
        "Individual typology angle of the hand's median colour, as lit: above 55 very light, below -30 very dark.",
        lambda d: d.skin_ita_deg,
        np.linspace(-90, 90, 37),
        "ITA, degrees",
    ),
    (
        "Hand length",
        "Wrist to middle knuckle. The official data scales every hand to 10 cm.",
        lambda d: 100 * d.hand_length_m,
        np.linspace(4.875, 15.125, 42),  # 10 cm in the middle of a bin
        "cm",
    ),
)
_STYLE = """
:root { --ground: #ffffff; --ink: #1d2530; --soft: #5d6b7c; --line: #d9dfe6; --panel: #f5f7f9;
  --one: #2f6fb0; --two: #d1581f; }
@media (prefers-color-scheme: dark) { :root { --ground: #14181d; --ink: #e4e9ef; --soft: #9aa7b5; --line: #333c46;
  --panel: #1c2229; --one: #5b9bdc; --two: #f08a4b; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 1240px; padding: 24px 20px 60px; background: var(--ground); color: var(--ink);
  font: 15px/1.45 system-ui, sans-serif; }
h1 { font-size: 24px; margin: 0 0 4px; } h2 { font-size: 17px; margin: 30px 0 10px; }
h3 { font-size: 15px; margin: 0 0 2px; } p { margin: 0 0 8px; }
.soft { color: var(--soft); font-size: 13px; }
table { border-collapse: collapse; } td, th { text-align: left; padding: 3px 18px 3px 0; vertical-align: top;
  border-bottom: 1px solid var(--line); font-weight: normal; } th { color: var(--soft); }
td { font-variant-numeric: tabular-nums; overflow-wrap: anywhere; }
.charts { display: grid; grid-template-columns: repeat(auto-fill, minmax(340px, 1fr)); gap: 16px; }
.chart { background: var(--panel); border-radius: 6px; padding: 12px 14px; min-width: 0; }
svg { width: 100%; height: auto; display: block; margin-bottom: 6px; }
svg text { font: 11px system-ui, sans-serif; fill: var(--soft); }
.grid { stroke: var(--line); } rect.s0 { fill: var(--one); } polyline.s1 { fill: none; stroke: var(--two);
  stroke-width: 2; } line.s0 { stroke: var(--one); } line.s1 { stroke: var(--two); } .thin { stroke-width: 1.5; }
.thick { stroke-width: 6; } .dot { fill: var(--ground); stroke: var(--ink); stroke-width: 1.5; }
.ground { fill: var(--ground); stroke: var(--line); } rect.heat { fill: var(--one); }
.second rect.heat { fill: var(--two); } .key { display: inline-block; width: 12px; height: 12px; border-radius: 2px;
  margin-right: 6px; vertical-align: -1px; } .key.s0 { background: var(--one); }
.key.s1 { border: 2px solid var(--two); }
figure { margin: 0; } img { max-width: 100%; height: auto; border-radius: 6px; } .scroll { overflow-x: auto; }
li { overflow-wrap: anywhere; }
"""


def dataset_page(reports: Sequence[DatasetReport], sheets: Sequence[np.ndarray | None]) -> str:
    """The page of one data set, or of two in the same charts.

    Args:
        reports: one or two.
        sheets: their contact sheets, (H, W, 3) uint8 RGB; None where there is none.

    Returns:
        HTML that needs no other file and no network.
    """
    sets = [report.distributions for report in reports]
    names = " and ".join(report.name for report in reports)
    body = [
        f"<h1>{escape(names)}</h1>",
        f'<p class="soft">{_legend(reports)}</p>',
        "<h2>Contents</h2>",
        _contents(reports),
        *_problems(reports),
        "<h2>Distributions</h2>",
        '<div class="charts">',
        *(
            _chart(title, text, histogram([values(d) for d in sets], edges, unit), _medians(sets, values))
            for title, text, values, edges, unit in _HISTOGRAMS
        ),
        _chart(
            "Finger flexion",
            "Sum of a finger's bends from the wrist to the tip. 0: straight, about 250: fist. Line: 5 to 95 %, "
            "bar: middle half, dot: median.",
            ranges([d.flexion_deg for d in sets], FINGERS, 0, 300, "degrees"),
        ),
        *(_heat(d, series) for series, d in enumerate(sets)),
        "</div>",
        *(_sheet(report.name, sheet) for report, sheet in zip(reports, sheets, strict=True) if sheet is not None),
    ]
    head = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(names)}: data set report</title><style>{_STYLE}</style></head>"
    )
    return head + "<body>" + "\n".join(body) + "</body></html>\n"


def summary(report: DatasetReport) -> list[tuple[str, str]]:
    """(what, value) of everything that is counted or checked, for tables."""
    low, median, high = (100 * value for value in report.range_m)
    rows = [
        ("instances", str(report.instances)),
        ("skipped", str(report.skipped)),
        ("hands", ", ".join(f"{name} {count}" for name, count in report.presence.items())),
        ("image sizes", ", ".join(f"{w}x{h}: {count}" for (w, h), count in report.image_sizes.items())),
        ("missing files", ", ".join(f"{name}: {count}" for name, count in report.missing_files.items()) or "none"),
        ("root joint's range", f"{low:.1f} to {high:.1f} cm, median {median:.1f} cm"),
        ("joints outside the image", f"{100 * report.joints_outside:.1f} %"),
        ("2D joints from projected 3D", f"{report.reprojection_px:.2g} px at most"),
        ("joints below the visible surface", f"{1e3 * report.surface_gap_m:.1f} mm (median)"),
        ("problems", str(len(report.problems)) if report.problems else "none"),
    ]
    return [row for row in rows if not row[1].startswith("nan")]


def _legend(reports: Sequence[DatasetReport]) -> str:
    return " &nbsp; ".join(
        f'<span class="key s{series}"></span>{escape(report.name)}: {report.instances} pictures, '
        f"{sum(report.distributions.hands)} hands"
        for series, report in enumerate(reports)
    )


def _contents(reports: Sequence[DatasetReport]) -> str:
    tables = [dict(summary(report)) for report in reports]
    head = "".join(f"<th>{escape(report.name)}</th>" for report in reports)
    keys = list(dict.fromkeys(key for table in tables for key in table))
    rows = "".join(
        f"<tr><th>{escape(key)}</th>" + "".join(f"<td>{escape(t.get(key, 'unknown'))}</td>" for t in tables) + "</tr>"
        for key in keys
    )
    return f'<div class="scroll"><table><tr><th></th>{head}</tr>{rows}</table></div>'


def _problems(reports: Sequence[DatasetReport]) -> list[str]:
    parts = []
    for report in reports:
        if not report.problems:
            continue
        items = "".join(f"<li>{escape(p.source)}: {escape(p.message)}</li>" for p in report.problems[:MAX_PROBLEMS])
        more = len(report.problems) - MAX_PROBLEMS
        items += f"<li>and {more} more</li>" if more > 0 else ""
        parts.append(f"<h2>Problems of {escape(report.name)}</h2><ul>{items}</ul>")
    return parts


def _chart(title: str, text: str, svg: str, captions: Sequence[str] = ()) -> str:
    return (
        f'<div class="chart"><h3>{escape(title)}</h3><p class="soft">{escape(text)}</p>{svg}'
        f'<p class="soft">{"<br>".join(map(escape, captions))}</p></div>'
    )


def _medians(sets: Sequence[Distributions], values: Callable[[Distributions], np.ndarray]) -> list[str]:
    """ "median 38.2, middle 90 %: 25.1 to 51.3" of each set."""
    parts = []
    for d in sets:
        finite = values(d)[np.isfinite(values(d))]
        if finite.size:
            low, median, high = np.percentile(finite, (5, 50, 95))
            numbers = f"median {median:.3g}, middle 90 %: {low:.3g} to {high:.3g}"
        else:
            numbers = "not labelled"
        parts.append(f"{d.name}: {numbers}" if len(sets) > 1 else numbers)
    return parts


def _heat(d: Distributions, series: int) -> str:
    inside = int(d.heat.sum())
    total = 21 * sum(d.hands)
    text = f"Where the joints lie in the picture. {inside} of {total} joints are inside."
    chart = _chart(f"2D heat map: {d.name}", text, heat_map(d.heat, "2D heat map of the joints"))
    return chart.replace('class="chart"', 'class="chart second"', 1) if series else chart


def _sheet(name: str, sheet: np.ndarray) -> str:
    ok, data = cv2.imencode(".jpg", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, SHEET_QUALITY])
    source = base64.b64encode(data.tobytes()).decode() if ok else ""
    return (
        f'<h2>Contact sheet of {escape(name)}</h2><figure><img alt="instances with their joints drawn in" '
        f'src="data:image/jpeg;base64,{source}"></figure>'
    )
