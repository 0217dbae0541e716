"""What replay writes for people and spreadsheets: estimates.csv and report.html."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sins_align.ros.chart import Chart, Series, chart_svg
from sins_align.ros.replay import Outcome, Replay
from sins_align.ros.result import (
    mounting_sigma,
    odometer_lever_sigma,
    roll_pitch_heading,
    roll_pitch_heading_sigma,
)
from sins_align.ros.result_table import HEAD, footer, result_rows, verdict
from sins_align.ros.truth import Truth
from sins_align.ros.whole_file import write_text_whole
from sins_align.types import Array, Estimate, OdometerEstimate, Update
from sins_align.units import ARCMIN, DEG

_ANGLES = ("roll", "pitch", "heading")
_MAX_POINTS = 1000  # of a line: more than there are pixels
_XYZ = ("x", "y", "z")
COLUMNS = (
    "stamp_ns", "elapsed_s", "state",
    "roll_deg", "pitch_deg", "heading_deg",
    "roll_sigma_arcmin", "pitch_sigma_arcmin", "heading_sigma_arcmin",
    *(f"lever_{axis}_m" for axis in _XYZ), *(f"lever_{axis}_sigma_m" for axis in _XYZ),
    *(f"gyro_bias_{axis}_rad_s" for axis in _XYZ),
    *(f"gyro_bias_{axis}_sigma_rad_s" for axis in _XYZ),
    *(f"accel_bias_{axis}_m_s2" for axis in _XYZ),
    *(f"accel_bias_{axis}_sigma_m_s2" for axis in _XYZ),
    "consistency",
    "odometer_scale_error", "odometer_scale_sigma",
    "odometer_latency_s", "odometer_latency_sigma_s",
    *(f"mounting_{angle}_deg" for angle in ("roll", "pitch", "yaw")),
    *(f"mounting_{angle}_sigma_deg" for angle in ("roll", "pitch", "yaw")),
    *(f"odometer_lever_{axis}_m" for axis in _XYZ),
    *(f"odometer_lever_{axis}_sigma_m" for axis in _XYZ),
)  # fmt: skip
_ODOMETER = COLUMNS.index("odometer_scale_error") - 3
_NUMBERS = len(COLUMNS) - 3

_STYLE = """\
body{font:15px/1.45 system-ui,sans-serif;color:#222;max-width:62rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.35rem;margin:0}p{margin:.3rem 0}.good{color:#176b2c}.bad{color:#a03000}
table{border-collapse:collapse;margin:1rem 0;font-variant-numeric:tabular-nums}
th,td{padding:.15rem .8rem;text-align:right;border-bottom:1px solid #ddd}
th:first-child,td:first-child{text-align:left;padding-left:0}
.charts{display:grid;grid-template-columns:repeat(auto-fit,minmax(26rem,1fr));gap:1rem}
svg{width:100%;height:auto}footer{color:#666;font-size:.9rem;margin-top:1rem}"""


def estimate_numbers(estimate: Estimate | None) -> Array:
    """The numbers of one row of estimates.csv, NaN where there is no value."""
    if estimate is None:
        return np.full(_NUMBERS, np.nan)
    lever_arm = estimate.lever_arm
    lever = np.full(6, np.nan)
    if lever_arm is not None:
        lever = np.concatenate((lever_arm.r_b, np.sqrt(np.diag(lever_arm.covariance))))
        lever[~np.tile(lever_arm.observable, 2)] = np.nan
    return np.concatenate(
        (
            np.array(roll_pitch_heading(estimate.q_nb)) / DEG,
            roll_pitch_heading_sigma(estimate) / ARCMIN,
            lever,
            estimate.gyro_bias, estimate.gyro_bias_sigma,
            estimate.accel_bias, estimate.accel_bias_sigma,
            [estimate.consistency],
            _odometer_numbers(estimate.odometer),
        )
    )  # fmt: skip


def _odometer_numbers(odometer: OdometerEstimate | None) -> Array:
    if odometer is None:
        return np.full(_NUMBERS - _ODOMETER, np.nan)
    return np.concatenate(
        (
            [odometer.scale_error, odometer.scale_sigma],
            [odometer.latency_s, odometer.latency_sigma_s],
            odometer.mounting_rpy / DEG, mounting_sigma(odometer) / DEG,
            odometer.lever_arm_b, odometer_lever_sigma(odometer),
        )
    )  # fmt: skip


def write_estimates(path: Path, updates: Sequence[Update]) -> None:
    """One row a block; a cell is empty where there is no value. OSError as `write_whole`."""
    lines = [",".join(COLUMNS)]
    for update in updates:
        cells = ["" if x != x else f"{x:.12g}" for x in estimate_numbers(update.estimate).tolist()]
        status = update.status
        head = (str(update.stamp_ns), f"{status.elapsed_s:.6f}", status.state.value)
        lines.append(",".join((*head, *cells)))
    write_text_whole(path, "\n".join(lines) + "\n")


def write_report(path: Path, outcome: Outcome) -> None:
    """One file that needs nothing else: table and charts. OSError as `write_whole`."""
    document = outcome.document
    title = html.escape(outcome.title)
    good = "good" if document["aligned"] else "bad"
    node, method = document["node"], document["method"]
    parts = [
        '<!doctype html><html lang="en"><head><meta charset="utf-8">',
        f"<title>{title}</title><style>{_STYLE}</style></head><body><h1>{title}</h1>",
        f'<p>{node}, method {method}: <b class="{good}">{html.escape(verdict(document))}</b></p>',
    ]
    if outcome.estimate is not None:
        parts.append(_table(outcome.estimate, outcome.truth))
    parts.append(f'<div class="charts">{"".join(_charts(outcome))}</div>')
    lines = "<br>".join(map(html.escape, footer(document)))
    parts.append(f"<footer>{lines}</footer></body></html>\n")
    write_text_whole(path, "\n".join(parts))


def _table(estimate: Estimate, truth: Truth | None) -> str:
    columns = len(HEAD) if truth else 3
    rows = [HEAD, *result_rows(estimate, truth)]
    cells = [
        "".join(
            f"<{tag}>{html.escape(cell)}</{tag}>"
            for cell in row[:columns]
        )
        for tag, row in zip(["th"] + ["td"] * (len(rows) - 1), rows, strict=True)
    ]  # fmt: skip
    return f"<table><tr>{'</tr><tr>'.join(cells)}</tr></table>"


def _charts(outcome: Outcome) -> list[str]:
    """The charts over time, from the first attitude on."""
    time, values = _history(outcome.replay)
    if len(time) < 2:
        return []
    document = outcome.document
    threshold = outcome.replay.session.config.completion.heading_threshold / ARCMIN
    bounds = [("limit", document["heading_limit_arcmin"]), ("threshold", threshold)]
    roll, pitch, heading = (Series(name, values[3 + k]) for k, name in enumerate(_ANGLES))
    charts = [
        Chart("Heading [deg]", (Series("heading", values[2]),), modulus=360.0),
        Chart(
            "1 sigma [arcmin]",
            (
                roll, pitch, heading,
                *(Series(name, np.full_like(time, bound)) for name, bound in bounds if bound),
            ),
            logarithmic=True,
        ),
        Chart("Levels [deg]", (Series("roll", values[0]), Series("pitch", values[1]))),
    ]  # fmt: skip
    if np.isfinite(values[6:9]).any():
        lever = tuple(Series(axis, values[6 + k]) for k, axis in enumerate(_XYZ))
        sigma = tuple(Series(axis, values[9 + k]) for k, axis in enumerate(_XYZ))
        charts.append(Chart("Lever arm [m]", lever))
        charts.append(Chart("Lever arm, 1 sigma [m]", sigma, logarithmic=True))
    charts += _odometer_charts(values[_ODOMETER:])
    return [chart_svg(chart, time) for chart in charts]


def _odometer_charts(values: Array) -> list[Chart]:
    """values : (K, N), the odometer's part of `estimate_numbers`."""
    if not np.isfinite(values[0]).any():
        return []
    mounting = (Series("pitch", values[5]), Series("yaw", values[6]))
    return [
        Chart("Odometer scale error [%]", (Series("estimate", 100.0 * values[0]),)),
        Chart("Odometer latency [s]", (Series("estimate", values[2]),)),
        Chart("Mounting [deg]", mounting),
    ]


def _history(replay: Replay) -> tuple[Array, Array]:
    """Time since the first sample (N,) [s], and `estimate_numbers` (_NUMBERS, N).

    Heading is unwrapped; where the alignment began anew a column of NaN parts the lines.
    """
    records = replay.records[:: 1 + len(replay.records) // _MAX_POINTS]
    begin = replay.session.counts.first_stamp_ns
    if len(records) < 2 or begin is None:
        return np.empty(0), np.empty((_NUMBERS, 0))
    time = np.array([record.estimate.stamp_ns - begin for record in records]) * 1e-9
    values = np.array([estimate_numbers(record.estimate) for record in records]).T
    values[2] = np.rad2deg(np.unwrap(np.deg2rad(values[2])))
    steps = np.diff(time)
    breaks = np.flatnonzero((steps <= 0.0) | (steps > 3.0 * np.median(steps))) + 1
    return np.insert(time, breaks, time[breaks]), np.insert(values, breaks, np.nan, axis=1)
