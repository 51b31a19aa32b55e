"""An evaluation's summary as one HTML file that needs nothing beside it: tables, PCK curves, pictures.

Needs matplotlib (extra `view`).
"""

from __future__ import annotations

import base64
import html
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from twohands.errors import MissingExtraError
from twohands.evaluation.comparison import Comparison
from twohands.evaluation.curves import PANELS
from twohands.evaluation.published import GENERATED_CAVEAT
from twohands.evaluation.report import format_number
from twohands.evaluation.summary import COMMON_TITLE, Summary, Table, is_number
from twohands.skeleton import BONES, ROOT, SIDES
from twohands.types import HandPose, HandSample, TwoHandPose
from twohands.visualization.overlay import draw_overlay
from twohands.visualization.views import render_views

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SYSTEM_COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#7d838e")
"""Okabe-Ito, dark enough for lines on white."""
_DASHES: Final = ("-", (0, (6, 2)), (0, (2, 1.5)), (0, (7, 2, 1.5, 2)))
_CASE_SIDE_PX: Final = 480


@dataclass(frozen=True, slots=True)
class Case:
    """One picture of the report.

    Attributes:
        sample: the labelled picture.
        pose: what the first system said about it.
        caption: what to see.
        side: the hand that it is about; None for both.
    """

    sample: HandSample
    pose: TwoHandPose
    caption: str
    side: int | None = None


def worst_hands(comparison: Comparison, count: int) -> list[tuple[int, int, str]]:
    """The hands with the largest camera-space error, and hands missed or invented.

    Args:
        comparison: of one system.
        count: how many of each.

    Returns:
        (index of the image, side, caption), errors first.
    """
    known = np.where(np.isfinite(comparison.camera_mm), comparison.camera_mm, np.nan)
    measured = np.isfinite(known).any(axis=2)
    errors = np.where(measured, np.nansum(known, axis=2) / np.maximum(np.isfinite(known).sum(axis=2), 1), -1.0)
    found: list[tuple[int, int, str]] = []
    for flat in np.argsort(errors, axis=None, kind="stable")[::-1][:count]:
        index, side = divmod(int(flat), 2)
        if errors[index, side] < 0:
            break
        root = comparison.root[index, side]
        caption = f"{SIDES[side]}: CS-MPJPE {errors[index, side]:.0f} mm, range {100 * root[3]:.1f} cm off"
        found.append((index, side, f"{caption}, direction {root[2]:.1f} deg off"))
    gone = comparison.present & ~comparison.found
    invented = comparison.judged & ~comparison.present & comparison.found
    for wrong, what in ((gone, "missed"), (invented, "found, but there is none")):
        found += [(int(i), int(side), f"{SIDES[side]}: {what}") for i, side in np.argwhere(wrong)[:count]]
    return found


def typical_images(comparison: Comparison) -> list[tuple[int, str]]:
    """Index and caption of the images whose camera-space error is the best, the median and the worst.

    Only images whose labelled hands were all found count.
    """
    whole = (comparison.present == comparison.found).all(axis=1) & comparison.present.any(axis=1)
    finite = np.isfinite(comparison.camera_mm)
    means = np.where(finite, comparison.camera_mm, 0.0).sum(axis=(1, 2)) / np.maximum(finite.sum(axis=(1, 2)), 1)
    usable = np.flatnonzero(whole & finite.any(axis=(1, 2)))
    if not usable.size:
        return []
    order = usable[np.argsort(means[usable], kind="stable")]
    picks = {"Best": order[0], "Median": order[len(order) // 2], "Worst": order[-1]}
    unique: dict[int, str] = {}
    for name, index in picks.items():
        unique.setdefault(int(index), f"{name} image with all hands found, CS-MPJPE {means[index]:.0f} mm")
    return list(unique.items())


def draw_curves(summary: Summary) -> Figure:
    """The PCK curves of all systems, one panel a kind of error.

    Source: paper, figures of PCK on STB and Ego3DHands (their own curves cannot be read back).

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError("PCK curves", "view") from error
    figure = Figure(figsize=(11.4, 7.0), dpi=100, facecolor="white", layout="constrained")
    axes = figure.subplots(2, 3)
    lines = []
    for index, (panel, ax) in enumerate(zip(PANELS, axes.flat, strict=True)):
        for mark in panel.marks:
            ax.axvline(mark, color="#c4c8cf", lw=1.0, ls=(0, (2, 2)), zorder=1)
        lines = [
            ax.plot(
                panel.thresholds,
                100 * system.curves[index].shares,
                color=_SYSTEM_COLOURS[turn % len(_SYSTEM_COLOURS)],
                ls=_DASHES[turn % len(_DASHES)],
                lw=2.0,
                zorder=3,
                label=_drawable(system.name),
            )[0]
            for turn, system in enumerate(summary.systems)
        ]
        aucs = [f"AUC {format_number(system.curves[index].auc)}" for system in summary.systems]
        ax.legend(lines, aucs, loc="best", fontsize=8.5, framealpha=0.85, edgecolor="none", labelcolor="#2f333a")
        ax.set_title(panel.title, fontsize=10, color="#2f333a")
        ax.set(xlim=(panel.thresholds[0], panel.thresholds[-1]), ylim=(0, 100))
        ax.set_xlabel(f"error threshold ({panel.unit})", fontsize=9, color="#4a4f58")
        ax.set_ylabel("correct (%)" if index % 3 == 0 else "", fontsize=9, color="#4a4f58")
        ax.tick_params(labelsize=8.5, colors="#4a4f58")
        ax.grid(color="#e3e6ea", lw=0.8)
        ax.set_axisbelow(True)
        for spine in ax.spines.values():
            spine.set_color("#c4c8cf")
    figure.legend(handles=lines, loc="outside lower center", ncols=min(3, len(lines)), frameon=False, fontsize=9.5)
    return figure


def render_page(summary: Summary, typical: Sequence[Case], worst: Sequence[Case]) -> str:
    """The whole report as one HTML document.

    Args:
        summary: all numbers.
        typical: images to show in three views.
        worst: hands to show cut out.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    first = summary.systems[0]
    parts = [f"<h1>{_text(first.report.dataset)}</h1>"]
    about, *systems = summary.about()
    parts.append(f"<p>{_text(about)}</p><ul>{''.join(f'<li>{_text(line[2:])}</li>' for line in systems)}</ul>")
    parts += [f'<p class="note">{_text(note)}</p>' for note in summary.notes]
    parts.append(f"<h2>Summary</h2>{_table(summary.headline_table())}")
    if table := summary.common_table():
        parts.append(f"<h2>{COMMON_TITLE}</h2>{_table(table)}")
    parts.append(
        f"<h2>PCK curves</h2><figure>{_svg(draw_curves(summary))}<figcaption>{_CURVES_TEXT}</figcaption></figure>"
    )
    if table := summary.published_table():
        caveat = f"<p>{_text(GENERATED_CAVEAT)}</p>" if summary.kind == "ego3dhands" else ""
        parts.append(f"<h2>Beside published numbers</h2>{caveat}{_table(table)}")
    if tables := summary.budget_tables():
        about_it = "".join(f"<p>{_text(text)}</p>" for text in summary.budget_texts())
        parts.append(f"<h2>Error budget</h2>{about_it}{_table(tables[0])}")
        parts.append(f"<h3>What each stage costs (fitted)</h3>{_table(tables[1])}")
    for title, table in summary.part_tables():
        parts.append(f"<h2>{_text(title)}</h2>{_PART_TEXT}{_table(table)}")
    if typical:
        parts.append(f"<h2>Three views</h2><p>{_text(first.name)}; labels as thin lines.</p>")
        parts += [_views(case) for case in typical]
    if worst:
        parts.append(f"<h2>Worst cases</h2><p>{_text(first.name)}; labels in white.</p>")
        parts.append(f'<div class="cases">{"".join(_cut_out(case) for case in worst)}</div>')
    parts.append(f"<details><summary>All metrics</summary>{_table(summary.full_table())}</details>")
    if summary.command:
        parts.append(f"<p>Made by</p><pre>{html.escape(summary.command)}</pre>")
    body = "\n".join(parts)
    title = _text(f"twohands: {first.report.dataset}")
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{_STYLE}</style></head>\n<body>{body}</body></html>\n"
    )


_CURVES_TEXT: Final = (
    "As in the paper. Mean of left and right; a missed hand is wrong at every threshold, which is why curves "
    "may end below 100 %. Dotted: thresholds that the paper's text speaks of (3 degrees, 7 cm) and 20 mm."
)

_PART_TEXT: Final = "<p>2D and canonical: mean; direction and range of the root joint: median.</p>"

_STYLE: Final = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, "Segoe UI", Helvetica, Arial, sans-serif; color: #23262b; background: #fff;
       max-width: 1180px; margin: 32px auto; padding: 0 24px; }
h1 { font-size: 26px; margin: 0 0 8px; } h2 { font-size: 19px; margin: 36px 0 8px; } h3 { font-size: 16px; }
p { max-width: 82ch; } p.note { border-left: 3px solid #d55e00; padding-left: 12px; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 13.5px; }
.wide { overflow-x: auto; }
th, td { padding: 4px 12px 4px 0; text-align: left; vertical-align: top; }
th { border-bottom: 1.5px solid #8b919b; font-weight: 600; vertical-align: bottom; }
td { border-bottom: 1px solid #e8eaee; } td.n, th.n { text-align: right; } td.n, td.s { white-space: nowrap; }
th.n { max-width: 13ch; }
td.long { max-width: 46ch; color: #4a4f58; }
tr.next td { border-top: 1px solid #8b919b; }
figure { margin: 8px 0 20px; } figure svg, figure img { max-width: 100%; height: auto; display: block; }
figcaption { color: #4a4f58; font-size: 13.5px; max-width: 82ch; margin-top: 4px; }
.cases { display: grid; grid-template-columns: repeat(auto-fill, minmax(340px, 1fr)); gap: 16px; }
.cases figure { margin: 0; } .cases img { width: 100%; border-radius: 4px; }
details { margin-top: 36px; } summary { cursor: pointer; font-size: 19px; font-weight: 600; }
pre { background: #f5f6f8; padding: 10px 12px; white-space: pre-wrap; }
"""


def _table(table: Table) -> str:
    """Numbers flush right, in columns of equal digits; a row that starts a group has a line above."""
    head, *rows = table
    numeric = [
        bool(rows)
        and all(is_number(row[column]) or not row[column] for row in rows)
        and any(row[column] for row in rows)
        for column in range(len(head))
    ]

    def cell(tag: str, text: str, column: int) -> str:
        kind = "n" if numeric[column] else "long" if len(text) > 44 else "s"
        return f'<{tag} class="{kind}">{_text(text)}</{tag}>'

    grouped = any(row[0] == "" for row in rows)
    lines = [f"<tr>{''.join(cell('th', text, column) for column, text in enumerate(head))}</tr>"]
    for number, row in enumerate(rows):
        start = ' class="next"' if grouped and number and row[0] else ""
        lines.append(f"<tr{start}>{''.join(cell('td', text, column) for column, text in enumerate(row))}</tr>")
    return f'<div class="wide"><table>{"".join(lines)}</table></div>'


def _views(case: Case) -> str:
    data = render_views(case.sample.image, case.pose, title=_drawable(case.sample.source), truth=case.sample)
    return f"<figure>{_img(data, 'png', case.caption)}<figcaption>{_text(case.caption)}</figcaption></figure>"


def _cut_out(case: Case) -> str:
    ok, data = cv2.imencode(".jpg", case_picture(case)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])
    assert ok
    caption = f"{_text(case.sample.source)}<br>{_text(case.caption)}"
    return f"<figure>{_img(data.tobytes(), 'jpeg', case.caption)}<figcaption>{caption}</figcaption></figure>"


def case_picture(case: Case) -> np.ndarray:
    """The surroundings of one hand with the estimate drawn over it and the labels in white.

    Returns:
        (S, S, 3) uint8 RGB, S = 480 pixels.
    """
    sample, pose = case.sample, case.pose
    points = [sample.joints_px[side] for side in (0, 1) if sample.present[side] and case.side in (None, side)]
    points += [
        h.joints_px for side, h in enumerate(pose.hands) if h.joints_px is not None and case.side in (None, side)
    ]
    height, width = sample.image.shape[:2]
    joints = np.concatenate([*points, np.empty((0, 2))])
    joints = np.clip(joints[np.isfinite(joints).all(axis=1)], 0, [width, height])
    if not len(joints):
        joints = np.array([[0.0, 0.0], [width, height]])
    low, high = joints.min(axis=0), joints.max(axis=0)
    side_px = float(np.clip(1.35 * (high - low).max(), min(height, width) / 4, min(height, width)))
    corner = np.clip((low + high - side_px) / 2, 0, np.array([width, height]) - side_px)
    scale = _CASE_SIDE_PX / side_px
    turn = np.array([[scale, 0, -scale * corner[0]], [0, scale, -scale * corner[1]]])
    # OpenCV maps pixel centres, we map pixel corners
    shift = turn[:, 2] + 0.5 * scale - 0.5
    matrix = np.column_stack([turn[:, :2], shift])
    size = (_CASE_SIDE_PX, _CASE_SIDE_PX)
    picture = cv2.warpAffine(sample.image, matrix, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    shown = [side for side in (0, 1) if case.side in (None, side)]
    for side in shown:
        if sample.present[side]:
            _draw_labels(picture, sample.joints_px[side] @ turn[:, :2].T + turn[:, 2])
    hands = [hand if side in shown else HandPose(present=False) for side, hand in enumerate(pose.hands)]
    left, right = (
        hand if hand.joints_px is None else replace(hand, joints_px=hand.joints_px @ turn[:, :2].T + turn[:, 2])
        for hand in hands
    )
    return draw_overlay(picture, replace(pose, left=left, right=right, masks=None))


def _draw_labels(picture: np.ndarray, joints_px: np.ndarray) -> None:
    """White bones with a dark rim, drawn into the picture."""
    for colour, thickness in (((24, 24, 28), 4), ((255, 255, 255), 2)):
        for start, end in BONES:
            if np.isfinite(joints_px[[start, end]]).all():
                a, b = (tuple(int(x) for x in np.rint(16 * (joints_px[i] - 0.5))) for i in (start, end))
                cv2.line(picture, a, b, colour, thickness, cv2.LINE_AA, 4)
        if np.isfinite(joints_px[ROOT]).all():
            centre = tuple(int(x) for x in np.rint(16 * (joints_px[ROOT] - 0.5)))
            cv2.circle(picture, centre, 16 * (thickness + 2), colour, -1, cv2.LINE_AA, 4)


def _svg(figure: Figure) -> str:
    """The figure as an SVG element whose text stays text."""
    import matplotlib

    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "twohands", "font.family": "sans-serif"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    return re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)


def _img(data: bytes, kind: str, alt: str) -> str:
    return f'<img alt="{html.escape(alt)}" src="data:image/{kind};base64,{base64.b64encode(data).decode()}">'


def _drawable(name: str) -> str:
    """A name that fonts can draw: its bytes that are no text are escapes."""
    return name.encode(errors="backslashreplace").decode()


def _text(text: str) -> str:
    """Escaped; `words` in backticks are set as code."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(text, quote=False))
