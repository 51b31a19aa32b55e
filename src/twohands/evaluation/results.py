"""Markdown from finished reports: docs/results/generated.md, and the short tables that docs/results.md begins with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from twohands.errors import InputError
from twohands.evaluation.published import GENERATED_CAVEAT, Published
from twohands.evaluation.report import format_number
from twohands.evaluation.summary import COMMON_TITLE, HEADLINE, Summary, Table, markdown_table

SWEEP_COLUMNS: Final = (
    ("range_mean", "range, mean (cm)", min),
    ("range_median", "range, median (cm)", min),
    ("range_7cm", "within 7 cm", max),
    ("cs_mpjpe", "CS-MPJPE (mm)", min),
    ("acceleration_radial", "acceleration error, radial (m/s2)", min),
)
"""Metric key, heading, and whether less or more is better."""

HEADLINES: Final = (
    ("presence_accuracy", "presence"),
    ("miou", "mIoU"),
    ("error_2d_median", "2D, median (px)"),
    ("direction_3deg", "direction within 3 deg"),
    ("range_median", "range, median (cm)"),
    ("range_7cm", "within 7 cm"),
    ("cs_mpjpe", "CS-MPJPE (mm)"),
)
"""Metric key and heading of the table that has one row for each set and system."""

SWEEP_TEXT: Final = (
    "The root joint's range smoothed by a polynomial over the latest frames, current frame included, as it would run "
    "live. Fade: what a frame counts beside the next newer one. Direction and pose are each frame's own."
)


def results_page(
    summaries: Sequence[Summary], sweeps: Sequence[dict[str, Any]] = (), *, command: str = "", notes: Sequence[str] = ()
) -> str:
    """The page.

    Args:
        summaries: a report each; one section a data set.
        sweeps: JSON values of `studies.smoothing_sweep.Sweep`, one table each.
        command: what makes the page again.
        notes: what a reader must know.

    Returns:
        Markdown.
    """
    lines = ["# Results on generated sets", "", "Made by commands, not by hand; the last one is", "", *_code(command)]
    for note in notes:
        lines += [f"> {note}", ""]
    for summary in summaries:
        lines += _dataset(summary)
    for sweep in sweeps:
        lines += _sweep(sweep)
    return "\n".join(lines)


def headlines(summaries: Sequence[Summary]) -> str:
    """What a reader wants first: a row for each set and system, and what each stage costs where that was measured."""
    table: Table = [["set", "system", *(name for _, name in HEADLINES)]]
    costs: list[str] = []
    for summary in summaries:
        known = summary.metric_keys()
        columns = [summary.metrics_table([key])[1][2:-1] if key in known else None for key, _ in HEADLINES]
        for index, system in enumerate(summary.systems):
            name = f"{system.report.dataset}, {system.report.images} images" if index == 0 else ""
            table.append([name, system.name, *("n/a" if column is None else column[index] for column in columns)])
        if tables := summary.budget_tables():
            costs += [
                "",
                f"What each stage costs, {summary.systems[0].name} on {summary.systems[0].report.dataset}:",
                "",
            ]
            costs += markdown_table(tables[1])
    return "\n".join([*markdown_table(table), *costs])


def inserted(document: str, text: str, name: str) -> str:
    """A document with `text` between the markers of this name, instead of what stood there; where there are none, text
    and markers come after the first line, its title.

    Raises:
        InputError: one marker without the other, or in the wrong order.
    """
    opening, closing = f"<!-- {name} -->", f"<!-- /{name} -->"
    block = f"{opening}\n\n{text}\n\n{closing}"
    begin, end = document.find(opening), document.find(closing)
    if (begin < 0) != (end < 0) or end < begin:
        raise InputError(f"expected {opening} and later {closing}, or neither")
    if begin < 0:
        title, _, rest = document.partition("\n")
        return f"{title}\n\n{block}\n{rest}"
    return document[:begin] + block + document[end + len(closing) :]


def comparison_table(summary: Summary) -> Table:
    """Metric by system with the paper's printed numbers behind the first: ours, paper, others."""
    own = [number for number in summary.published if number.system.startswith("paper")]
    shown = [key for key in summary.metric_keys() if key in HEADLINE or any(number.metric == key for number in own)]
    head, *rows = summary.metrics_table(shown)
    table: Table = [[*head[:3], "paper", *head[3:]]]
    for key, row in zip(shown, rows, strict=True):
        table.append([*row[:3], _printed([number for number in own if number.metric == key]), *row[3:]])
    return table


def sweep_table(sweep: dict[str, Any]) -> Table:
    """One row a setting, the unsmoothed ranges first."""
    table: Table = [["queue", "degree", "fade", *(name for _, name, _ in SWEEP_COLUMNS)]]
    for row in sweep["rows"]:
        setting = [row[name] for name in ("length", "degree", "fade")]
        shown = ["off", "-", "-"] if None in setting else [f"{value:g}" for value in setting]
        table.append([*shown, *(_number(row["metrics"].get(key)) for key, _, _ in SWEEP_COLUMNS)])
    return table


def sweep_findings(sweep: dict[str, Any]) -> list[str]:
    """The best setting by every column, one sentence each, and the one that is the default."""
    found: list[str] = []
    for key, name, better in SWEEP_COLUMNS:
        rows = [row for row in sweep["rows"] if row["metrics"].get(key) is not None]
        if rows:
            best = better(rows, key=lambda row: row["metrics"][key])  # the first, and shortest queue, of equal ones
            found.append(f"Best by {name}: {best['name']}, {_number(best['metrics'][key])}.")
    return [*found, f"The tracker's default: {sweep['rows'][-1]['name']}."]


def _dataset(summary: Summary) -> list[str]:
    report = summary.systems[0].report
    lines = [f"## {report.dataset}: {report.images} images", "", *summary.about(), ""]
    for note in summary.notes:
        lines += [f"> {note}", ""]
    lines += [*markdown_table(comparison_table(summary)), ""]
    if summary.kind == "ego3dhands":
        lines += [GENERATED_CAVEAT, ""]
    printed = [(summary.metric_name(number.metric), number) for number in summary.published]
    if caveats := list(dict.fromkeys(f"- {name}: {number.caveat}." for name, number in printed if number.caveat)):
        lines += ["Before comparing with the paper:", "", *caveats, ""]
    if others := [(name, number) for name, number in printed if not number.system.startswith("paper")]:
        table = [["printed by others", "metric", "value"]]
        table += [[number.system, name, f"{number.printed} {number.unit}".strip()] for name, number in others]
        lines += [*markdown_table(table), ""]
    if table := summary.common_table():
        lines += [f"### {COMMON_TITLE}", "", *markdown_table(table), ""]
    if tables := summary.budget_tables():
        lines += ["### Error budget", ""]
        for text in summary.budget_texts():
            lines += [text, ""]
        lines += [*markdown_table(tables[0]), ""]
        lines += ["What each stage costs (fitted):", "", *markdown_table(tables[1]), ""]
    for title, table in summary.part_tables():
        lines += [f"### {title}", "", *markdown_table(table), ""]
    commands = [system.command for system in summary.systems]
    commands += [str((summary.budget or {}).get("command", "")), summary.command]
    return [*lines, "### Commands", "", *_code("\n".join(c for c in commands if c))]


def _sweep(sweep: dict[str, Any]) -> list[str]:
    lines = [f"## Range smoothing over video: {sweep['dataset']}", "", SWEEP_TEXT, ""]
    lines += [
        f"{sweep['frames']} frames in {sweep['sequences']} sequences at {sweep['fps']:g} frames a second; "
        f"weights {sweep['weights']}.",
        "",
    ]
    lines += [*markdown_table(sweep_table(sweep)), "", *(f"- {line}" for line in sweep_findings(sweep)), ""]
    return [*lines, *_code(sweep["command"])]


def _printed(numbers: Sequence[Published]) -> str:
    """The paper's numbers for one metric, each with what it is about where there are several kinds; "" for none."""
    kinds = [number.system.removeprefix("paper").strip(" ,+") for number in numbers]
    return "; ".join(f"{n.printed} ({kind})" if kind else n.printed for n, kind in zip(numbers, kinds, strict=True))


def _number(value: float | None) -> str:
    return "n/a" if value is None else format_number(value)


def _code(text: str) -> list[str]:
    return ["```", text, "```", ""] if text else []
