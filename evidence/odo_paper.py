"""Any heading to begin with, and Zhao and Qi's experiments with it: EKF against linear KF.

The linear filter has the errors of sin and cos of the azimuth as states: the heading that it
begins with is a choice of axes. The paper's extended Kalman filter has the azimuth's own error
as a state, is linearised about a heading that may be wrong, and starts here with 104 deg of
1 sigma: that of a heading of which nothing is known. Both have the same model otherwise, but
the EKF has no soft weighting and does not begin anew, of which the paper knows nothing: both
take the innovations of a heading that is wrong by more than a right angle for outliers.

The text of the paper that there is has lost the numbers of its table 1 and all of its curves:
what is said of them in words is what is checked. Its data are real; these are simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from evidence.checks import Case, Cases, Check, upper
from evidence.monte_carlo import every_seed, rms
from evidence.odo_figures import below_since, divergence, heading_errors, rows
from evidence.odo_recording import Start
from evidence.odo_runs import Drive, drive
from sins_align.simulate import VehicleOptions
from sins_align.types import Array
from sins_align.units import ARCMIN

UNKNOWN_DEG = 104.0  # 1 sigma of a uniform angle
WIDE_DEG = 1000.0  # more than there is, for the sake of convergence
WRONG_DEG = (-65.0, -125.0, -175.0, 180.0)
FIGURE_TIMES_S = (4, 5, 7, 10, 15, 20, 25, 30, 35, 45, 60, 90, 120, 180, 300, 600, 870)
LAST_S = 30  # over which the paper's table 1 averages

STATIC = VehicleOptions(scenario="static", duration_s=600.0)
RING = VehicleOptions(scenario="ring", duration_s=600.0)
TOWN = VehicleOptions(scenario="urban", duration_s=870.0)


def _kf(error_deg: float) -> Start:
    return Start(error_deg)


def _ekf(error_deg: float) -> Start:
    return Start(error_deg, UNKNOWN_DEG)


def _runs(options: VehicleOptions, seeds: int, start: Start | None = None) -> list[Drive]:
    method = "wander_kf" if start is None or start.sigma_deg is None else "wander_ekf"
    return every_seed(drive, options, range(seeds), {"method": method}, start)


def _curve(name: str, values: Array, unit: str = "'") -> str:
    """A curve (T,) at the times of the figures."""
    points = " ".join(f"{t}s:{values[t]:.4g}{unit}" for t in FIGURE_TIMES_S if t < values.size)
    return f"      {name}: {points}"


def _compare(drives: Sequence[Drive], name: str) -> list[str]:
    """RMS and median of the heading error over time, and how many runs found it."""
    error = np.abs(heading_errors(drives))
    end = error[:, -1]
    found = f"{(end < 60.0).sum()} of {len(drives)} runs end below 1 deg"
    return [
        f"      {name}: {found}, RMS {rms(end):.4g}', median {np.median(end):.4g}'",
        _curve("  RMS", rms(error, axis=0)),
    ]


def headings(seeds: int) -> Cases:
    """Static, and driving, from a wrong heading: the linear filter, and the paper's EKF."""
    first: Array | None = None
    for wrong in WRONG_DEG:
        linear, extended = _runs(STATIC, seeds, _kf(wrong)), _runs(STATIC, seeds, _ekf(wrong))
        error = heading_errors(linear)
        curve = rms(error, axis=0)
        first = error if first is None else first
        checks = [
            upper("KF: RMS below 5 deg from [s]", below_since(curve, 300.0), 15.0),
            upper("KF: RMS below 1 deg from [s]", below_since(curve, 60.0), 35.0),
            upper("KF: curves differ by [']", float(np.nanmax(np.abs(error - first))), 0.01),
            *divergence(linear),
        ]
        lines = [*_compare(linear, "KF "), *_compare(extended, "EKF")]
        yield Case(f"static, heading wrong by {wrong:g} deg", seeds, lines, checks)
    ends, lines = [], []
    for wrong in (5.0, 30.0, 60.0, 120.0, 175.0):
        linear, extended = _runs(RING, seeds, _kf(wrong)), _runs(RING, seeds, _ekf(wrong))
        ends.append(heading_errors(linear)[:, -1])
        lines += _compare(linear, f"KF  from {wrong:g} deg")
        lines += _compare(extended, f"EKF from {wrong:g} deg")
    spread = float(np.ptp(np.array(ends), axis=0).max())
    checks = [upper("KF: ends of a run differ by, at most [']", spread, 0.2)]
    yield Case("ring, from any heading", seeds, lines, checks)


def _static_means(drives: Sequence[Drive]) -> Array:
    """(runs, 3) misalignment east, north, up, mean over the last seconds [arcmin]."""
    return np.array([d.phi[-LAST_S:].mean(axis=0) for d in drives]) / ARCMIN


def paper_static(seeds: int) -> Cases:
    """Zhao and Qi, table 1 and figures 1 to 3: static, EKF against linear KF."""
    linear, extended = _runs(STATIC, seeds, _kf(-65.0)), _runs(STATIC, seeds, _ekf(-65.0))
    lines = ["      the paper's own numbers are lost; mean of the last 30 s, E, N, U"]
    means = {"KF ": _static_means(linear), "EKF": _static_means(extended)}
    for name, values in means.items():
        for what, row in (
            ("first run", values[0]),
            ("mean", values.mean(axis=0)),
            ("RMS", rms(values, axis=0)),
        ):
            numbers = " ".join(f"{v:9.4f}" for v in row)
            lines.append(f"      {name} {what:10s} {numbers} '")
    # "The same accuracy": the KF with both states, and the non-linear error model.
    ratio = rms(means["EKF"][:, 2]) / rms(means["KF "][:, 2])
    apart = float(rms(means["EKF"] - means["KF "], axis=0)[:2].max())
    checks = [
        Check("heading RMS, EKF over KF", ratio, 0.7, 1.4),
        upper("levels of the two differ by, RMS [']", apart, 0.1),
    ]
    yield Case("table 1: static, azimuth wrong by -65 deg", seeds, lines, checks)

    small = _runs(STATIC, seeds, Start(1.0, 1.0))
    lines = [_curve("EKF, RMS", rms(heading_errors(small), axis=0))]
    lines += [_curve("EKF, run 0", heading_errors(small)[0])]
    checks = [upper("RMS at the end over that of KF", _end(small) / _end(linear), 1.1)]
    yield Case("fig. 1: static, a small error of 1 deg", seeds, lines, checks)

    wide = np.abs(heading_errors(_runs(STATIC, seeds, Start(-175.0, WIDE_DEG))))
    lines = [_curve(f"EKF from -175 deg, sigma {WIDE_DEG:g} deg, median", np.median(wide, axis=0))]
    since = []
    for wrong in WRONG_DEG[:3]:
        curves = np.abs(heading_errors(_runs(STATIC, seeds, _ekf(wrong))))
        lines.append(_curve(f"EKF from {wrong:g} deg, run 0", curves[0]))
        lines.append(_curve(f"EKF from {wrong:g} deg, median", np.median(curves, axis=0)))
        since.append(below_since(np.median(curves, axis=0), 60.0))
    lines.append(_curve("KF from any, run 0", np.abs(heading_errors(linear))[0]))
    lines.append(_curve("KF from any, median", np.median(np.abs(heading_errors(linear)), axis=0)))
    lines.append(
        f"      EKF, median below 1 deg from {since} s: the paper's order, later from worse"
    )
    checks = [Check("from worse it takes longer", float(since == sorted(since)), 1.0, 1.0)]
    yield Case("fig. 2 and 3: static, wrong by -65, -125, -175 deg", seeds, lines, checks)


def _end(drives: Sequence[Drive]) -> float:
    return float(rms(heading_errors(drives)[:, -1]))


def paper_driving(seeds: int) -> Cases:
    """Zhao and Qi, figure 4: 870 s of driving from an unknown heading."""
    for scenario in ("urban", "moving_start", "figure8", "ring"):
        options = replace(TOWN, scenario=scenario)
        drives = _runs(options, seeds)
        error = heading_errors(drives)
        curve = rms(error, axis=0)
        lines, checks = rows(drives), divergence(drives)
        if scenario == "urban":
            phi = np.array([d.phi for d in drives]) / ARCMIN
            for axis, name in enumerate(("east", "north", "up")):
                lines.append(_curve(f"KF, run 0, phi {name}", phi[0, :, axis]))
            for wrong in (-65.0, -175.0):
                lines += _compare(_runs(options, seeds, _ekf(wrong)), f"EKF from {wrong:g} deg")
            checks = [
                upper("heading RMS at 870 s [']", rms(error[:, -1]), 1.5),
                upper("heading max at 870 s [']", np.abs(error[:, -1]).max(), 3.0),
                upper("heading RMS below 10' from [s]", below_since(curve, 10.0), 160.0),
                *checks,
            ]
        yield Case(f"fig. 4: 870 s, {scenario}", seeds, lines, checks)


SECTIONS = (headings, paper_static, paper_driving)
