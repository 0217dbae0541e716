"""Line charts over time as inline SVG: no library, and nothing to load."""

from __future__ import annotations

import html
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from sins_align.types import Array

COLOURS = ("#1f5fa8", "#c25a00", "#2b8a3e", "#888888", "#a0307a")
WIDTH, HEIGHT = 480, 260
LEFT, RIGHT, TOP, BOTTOM = 68, 12, 46, 34
LEGEND_STEP = 76
MIN_SPAN = 1e-4  # of a vertical axis: closer numbers would not fit beside it


Mapping = Callable[[Any], Any]  # numbers or arrays of them, to pixels


class Series(NamedTuple):
    """A named line; a value that is not finite leaves a gap."""

    name: str
    values: Array


class Chart(NamedTuple):
    """Lines over a common time.

    modulus : what the numbers at the vertical axis start again at, 0: nothing
    """

    title: str
    series: tuple[Series, ...]
    logarithmic: bool = False
    modulus: float = 0.0


def chart_svg(chart: Chart, time_s: Array) -> str:
    """The chart as an SVG element; `time_s` begins at 0 or later and ends later."""
    lines = [_scaled(series.values, chart.logarithmic) for series in chart.series]
    low, high = _limits(np.concatenate(lines), chart.logarithmic)
    end = float(time_s.max())
    x_of = _mapping(0.0, end, LEFT, WIDTH - RIGHT)
    y_of = _mapping(low, high, HEIGHT - BOTTOM, TOP)
    parts = [
        (
            f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" font-family="system-ui,sans-serif"'
            f' font-size="12" fill="#333"><text x="{LEFT}" y="16" font-weight="600">'
            f"{html.escape(chart.title)}</text>"
        )
    ]
    parts += _grid(x_of, y_of, (0.0, end), (low, high), chart)
    for k, (series, line) in enumerate(zip(chart.series, lines, strict=True)):
        colour = COLOURS[k % len(COLOURS)]
        name = html.escape(series.name)
        parts.append(
            f'<text x="{LEFT + LEGEND_STEP * k}" y="34" fill="{colour}">{name}</text>'
            f'<path d="{_path(x_of(time_s), y_of(line))}" fill="none" stroke="{colour}"'
            ' stroke-width="1.5"/>'
        )
    parts.append("</svg>")
    return "".join(parts)


def ticks(low: float, high: float, count: int = 5) -> list[float]:
    """Some `count` round numbers within [low, high]; low < high."""
    raw = (high - low) / count
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= raw)
    first, last = math.ceil(low / step), math.floor(high / step)
    return [k * step for k in range(first, last + 1)]


def _scaled(values: Array, logarithmic: bool) -> Array:
    if not logarithmic:
        return values
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(values > 0.0, np.log10(values), np.nan)


def _limits(values: Array, logarithmic: bool) -> tuple[float, float]:
    """Ends of the vertical axis: what contains all values, whole decades if logarithmic."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    if logarithmic:
        low, high = math.floor(low), math.ceil(high)
        return (low, high) if low < high else (low, low + 1.0)
    margin = max(0.05 * (high - low), 0.5 * MIN_SPAN)
    return low - margin, high + margin


def _mapping(low: float, high: float, first: float, last: float) -> Mapping:
    """The linear map from an interval to pixels."""
    scale = (last - first) / (high - low)
    return lambda values: first + (np.asarray(values) - low) * scale


def _grid(
    x_of: Mapping, y_of: Mapping, span_s: tuple[float, float], span: tuple[float, float],
    chart: Chart,
) -> list[str]:  # fmt: skip
    parts = []
    right, bottom = WIDTH - RIGHT, HEIGHT - BOTTOM
    levels = ticks(*span)
    if chart.logarithmic:
        levels = [level for level in levels if level == round(level)]
    digits = max(0, -math.floor(math.log10(levels[1] - levels[0]))) if len(levels) > 1 else 3
    for level in levels:
        y = float(y_of(level))
        number = 10.0**level if chart.logarithmic else round(level, digits) + 0.0
        if chart.modulus:
            number %= chart.modulus
        text = f"{number:g}" if chart.logarithmic else f"{number:.{digits}f}"
        parts.append(
            f'<path d="M{LEFT} {y:.1f}H{right}" stroke="#ddd"/>'
            f'<text x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{text}</text>'
        )
    for second in ticks(*span_s, count=6):
        x = float(x_of(second))
        parts.append(
            f'<path d="M{x:.1f} {TOP}V{bottom}" stroke="#eee"/>'
            f'<text x="{x:.1f}" y="{bottom + 15}" text-anchor="middle">{second:g}</text>'
        )
    parts.append(f'<text x="{right}" y="{HEIGHT - 4}" text-anchor="end">time [s]</text>')
    return parts


def _path(x: Array, y: Array) -> str:
    """SVG path through the points; starts anew after a value that is not finite."""
    commands = []
    pen = "M"
    for px, py in zip(x.tolist(), y.tolist(), strict=True):
        if py != py:
            pen = "M"
            continue
        commands.append(f"{pen}{px:.1f} {py:.1f}")
        pen = "L"
    return "".join(commands)
