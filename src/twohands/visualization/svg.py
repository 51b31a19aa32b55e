"""Charts as SVG text: small, sharp at any size, nothing to install, and they follow the page's light or dark colours.

Colours are CSS classes `s0` and `s1` of the page (first and second data set).
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

WIDTH, HEIGHT = 360, 190
_LEFT, _RIGHT, _TOP, _BOTTOM = 38, 14, 8, 34
_PLOT_WIDTH, _PLOT_HEIGHT = WIDTH - _LEFT - _RIGHT, HEIGHT - _TOP - _BOTTOM


def histogram(samples: Sequence[np.ndarray], edges: np.ndarray, label: str) -> str:
    """Shares of values per bin: bars for the first sample, an outline for the second.

    Values beyond the last edges count in the outermost bins, so that the shares of a sample add up to 1.

    Args:
        samples: one or two arrays of any shape; NaN are left out.
        edges: (n + 1,) ascending.
        label: what the values are, with their unit.

    Returns:
        An `<svg>` element.
    """
    shares = [bin_shares(values, edges) for values in samples]
    top = nice_ceiling(max((float(share.max()) for share in shares), default=0.0) or 1.0)
    x = _LEFT + (edges - edges[0]) / (edges[-1] - edges[0]) * _PLOT_WIDTH
    parts = [_axes(top), *_x_ticks(float(edges[0]), float(edges[-1]))]
    for series, share in enumerate(shares):
        y = _TOP + (1 - share / top) * _PLOT_HEIGHT
        floor = _TOP + _PLOT_HEIGHT
        if series == 0:
            bars = zip(x[:-1], x[1:], y, share, strict=True)
            parts += [
                f'<rect class="s0" x="{a + 0.5:.1f}" y="{v:.1f}" width="{max(b - a - 1, 0.5):.1f}" '
                f'height="{floor - v:.1f}"><title>{100 * s:.1f} %</title></rect>'
                for a, b, v, s in bars
                if s > 0
            ]
        else:
            steps = " ".join(f"{a:.1f},{v:.1f} {b:.1f},{v:.1f}" for a, b, v in zip(x[:-1], x[1:], y, strict=True))
            outline = f"{x[0]:.1f},{floor} {steps} {x[-1]:.1f},{floor}"
            parts.append(f'<polyline class="s1" points="{outline}"/>')
    parts.append(_text(_LEFT + _PLOT_WIDTH / 2, HEIGHT - 3, label, "middle"))
    return _svg(parts, WIDTH, HEIGHT, label)


def ranges(samples: Sequence[np.ndarray], names: Sequence[str], low: float, high: float, label: str) -> str:
    """One row per column of the samples: a line from the 5th to the 95th percentile, a bar over the middle half, a dot
    at the median.

    Args:
        samples: one or two (n, k) arrays.
        names: (k,) of the rows.
        low, high: ends of the axis.
        label: what the values are, with their unit.

    Returns:
        An `<svg>` element.
    """
    row_height = _PLOT_HEIGHT / len(names)

    def at(value: float) -> float:
        return _LEFT + 10 + (min(max(value, low), high) - low) / (high - low) * (_PLOT_WIDTH - 10)

    parts = list(_x_ticks(low, high, _LEFT + 10))
    for row, name in enumerate(names):
        middle = _TOP + (row + 0.5) * row_height
        parts.append(_text(_LEFT + 4, middle + 4, name, "end"))
        for series, values in enumerate(samples):
            column = values[:, row][np.isfinite(values[:, row])] if len(values) else np.empty(0)
            if not len(column):
                continue
            y = middle + (series - (len(samples) - 1) / 2) * min(9.0, row_height / 2.2)
            p5, p25, p50, p75, p95 = (at(float(p)) for p in np.percentile(column, (5, 25, 50, 75, 95)))
            kind = f"s{series}"
            parts += [
                f'<line class="{kind} thin" x1="{p5:.1f}" x2="{p95:.1f}" y1="{y:.1f}" y2="{y:.1f}"/>',
                f'<line class="{kind} thick" x1="{p25:.1f}" x2="{p75:.1f}" y1="{y:.1f}" y2="{y:.1f}"/>',
                f'<circle class="dot" cx="{p50:.1f}" cy="{y:.1f}" r="3"/>',
            ]
    parts.append(_text(_LEFT + _PLOT_WIDTH / 2, HEIGHT - 3, label, "middle"))
    return _svg(parts, WIDTH, HEIGHT, label)


def heat_map(heat: np.ndarray, label: str) -> str:
    """A picture of counts: cells from the page's ground to its accent colour, linear up to the largest count.

    Args:
        heat: (rows, columns) not negative.
        label: what is counted.

    Returns:
        An `<svg>` element.
    """
    rows, columns = heat.shape
    cell = WIDTH / columns
    top = float(heat.max()) or 1.0
    parts = [f'<rect class="ground" x="0" y="0" width="{WIDTH}" height="{rows * cell:.1f}"/>']
    for row, column in np.argwhere(heat > 0):
        parts.append(
            f'<rect class="heat" x="{column * cell:.1f}" y="{row * cell:.1f}" width="{cell + 0.2:.1f}" '
            f'height="{cell + 0.2:.1f}" opacity="{heat[row, column] / top:.2f}"/>'
        )
    return _svg(parts, WIDTH, round(rows * cell), label)


def bin_shares(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(n,) shares of the finite values per bin, those beyond the ends in the outermost bins; zeros if there is none."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return np.zeros(len(edges) - 1)
    counts, _ = np.histogram(np.clip(finite, edges[0], edges[-1]), edges)
    return counts / finite.size


def nice_ceiling(value: float) -> float:
    """The smallest of 1, 2, 2.5, 5, 10 times a power of ten that is not below a positive value."""
    power = 10.0 ** np.floor(np.log10(value))
    return next(float(step * power) for step in (1, 2, 2.5, 5, 10) if step * power >= value * (1 - 1e-9))


def nice_ticks(low: float, high: float, count: int = 5) -> list[float]:
    """Round numbers within [low, high], about `count` of them."""
    step = nice_ceiling((high - low) / count)
    first = np.ceil(low / step - 1e-9)
    last = np.floor(high / step + 1e-9)
    return [float(i * step) + 0.0 for i in np.arange(first, last + 1)]  # + 0.0: never "-0"


def _axes(top: float) -> str:
    lines = []
    for share in (0.0, top / 2, top):
        y = _TOP + (1 - share / top) * _PLOT_HEIGHT
        lines.append(f'<line class="grid" x1="{_LEFT}" x2="{WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
        lines.append(_text(_LEFT - 4, y + 4, f"{100 * share:g} %", "end"))
    return "".join(lines)


def _x_ticks(low: float, high: float, left: float = _LEFT) -> list[str]:
    parts = []
    for value in nice_ticks(low, high):
        x = left + (value - low) / (high - low) * (WIDTH - _RIGHT - left)
        parts.append(f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="{_TOP}" y2="{_TOP + _PLOT_HEIGHT + 3}"/>')
        parts.append(_text(x, _TOP + _PLOT_HEIGHT + 14, f"{value:g}", "middle"))
    return parts


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(text)}</text>'


def _svg(parts: Sequence[str], width: int, height: int, label: str) -> str:
    head = f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{escape(label, quote=True)}">'
    return head + "".join(parts) + "</svg>"
