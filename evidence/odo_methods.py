"""All methods of odo_align on the same drives; nodes; the two fadings of sghf."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from evidence.checks import Case, Cases, Check, upper
from evidence.monte_carlo import every_seed, rms
from evidence.odo_figures import divergence, heading_errors, nees, ratios
from evidence.odo_paper_sghf import figures, table_1
from evidence.odo_recording import Start
from evidence.odo_runs import Drive, Parameters, drive, every_drive
from sins_align.parameter_table import LARGE_AZIMUTH_METHODS, WANDER_METHODS
from sins_align.simulate import VehicleOptions
from sins_align.types import Array
from sins_align.units import ARCMIN

TIMES_S = (60, 120, 300, 600)


def table(runs: Mapping[str, Sequence[Drive]], times_s: Sequence[int] = TIMES_S) -> list[str]:
    """A row for each name; not a number where a run has no estimate of its own yet.

    worst: the largest heading error ever called aligned [arcmin], and the largest ever shown over
    its sigma; aligned, begun: how many runs are and how many have a filter of the large-azimuth
    model, with the median time; lost: runs without an estimate at the end
    """
    times = " ".join(f"{t:7d}s" for t in times_s)
    what = "max 600s  NEES  level ' scale %: RMS    max  worst '  /sigma"
    text = [f"      heading ':   RMS {times} {what}   aligned, s     begun, s  lost"]
    for name, drives in runs.items():
        error = heading_errors(drives)
        levels = rms(np.array([d.phi[600, :2] for d in drives])) / ARCMIN
        scale = 100.0 * np.array([d.scale_error[600] for d in drives])
        shown = np.array([d.published for d in drives]) == 1.0
        believed = np.abs(error)[np.array([d.aligned for d in drives]) & shown]
        aligned = np.array([d.aligned_s for d in drives])
        large = np.array([d.is_large for d in drives]) == 1.0
        begun = large[large.any(axis=1)].argmax(axis=1)
        text.append(
            f"      {name:16s} {' '.join(f'{rms(error[:, t]):8.3f}' for t in times_s)}"
            f" {np.abs(error[:, 600]).max():8.3f} {nees(drives, 600):5.2f} {levels:8.4f}"
            f" {rms(scale):13.5f} {np.abs(scale).max():6.4f} {believed.max(initial=0.0):8.2f}"
            f" {np.abs(ratios(drives))[shown].max(initial=0.0):7.2f}"
            f" {_when(aligned[np.isfinite(aligned)]):>12s} {_when(begun):>12s}"
            f" {(~shown[:, -1]).sum():5d}"
        )
    return text


def _when(times_s: Array) -> str:
    return f"{times_s.size}, {np.median(times_s):.0f}" if times_s.size else "0"


def methods(seeds: int) -> Cases:
    """All methods side by side: the same samples, the same start."""
    settings: dict[str, Parameters] = {}
    for coarse in ("wander", "inertial"):
        for method in LARGE_AZIMUTH_METHODS:
            settings[f"{method}, {coarse}"] = {"method": method, "coarse": coarse}
        if coarse == "wander":
            settings |= {method: {"method": method} for method in WANDER_METHODS}
    for scenario in ("ring", "urban"):
        for grade in ("paper_odo", "fog"):
            options = VehicleOptions(scenario=scenario, grade=grade)
            runs = every_drive(options, settings, seeds)
            checks = [
                Check(f"{check.name}: {name}", check.value, check.low, check.high)
                for name in ("sghf, wander", "sghf, inertial")
                for check in divergence(runs[name])
            ]
            yield Case(f"all methods, {scenario}, {grade}", seeds, table(runs), checks)
            if grade == "paper_odo":
                if scenario == "ring":
                    yield table_1(runs, seeds)
                for coarse in ("inertial", "wander"):
                    yield figures(scenario, coarse, runs[f"sghf, {coarse}"])


def nodes(seeds: int) -> Cases:
    """Three nodes over the azimuth against seven."""
    settings = {
        f"{count} nodes, {coarse}": {"gauss_hermite_nodes": count, "coarse": coarse}
        for coarse in ("wander", "inertial")
        for count in (3, 7)
    }
    for scenario, grade in (("ring", "fog"), ("ring", "paper_odo"), ("urban", "fog")):
        options = VehicleOptions(scenario=scenario, grade=grade)
        runs = every_drive(options, settings, seeds)
        checks = []
        for coarse in ("wander", "inertial"):
            three, seven = (
                rms(heading_errors(runs[f"{count} nodes, {coarse}"])[:, 600]) for count in (3, 7)
            )
            name = f"heading RMS at 600 s, 3 over 7 nodes, {coarse}"
            checks.append(Check(name, three / seven, 0.95, 1.05))
        yield Case(f"sghf, {scenario}, {grade}", seeds, table(runs), checks)


FADED: dict[str, dict[str, Any]] = {
    "clean": {},
    "slip of +50 %, 2 s, ten times": {"slip_count": 10},
    "scale +2 % at 500 s": {"scale_step": (500.0, 0.02)},
    "latency 100 ms": {"odometer_latency_s": 0.1},
}


def fading(seeds: int) -> Cases:
    """Strong tracking of sghf on the ring: guarded, none, and as published."""
    settings = {name: {"fading": name} for name in ("guarded", "none", "published")}
    for name, changes in FADED.items():
        options = VehicleOptions(scenario="ring", **changes)
        runs = every_drive(options, settings, seeds)
        lines = table(runs, (120, 300, 515, 600))
        error = heading_errors(runs["guarded"])[:, 600]
        checks = [
            upper("guarded: heading RMS at 600 s [']", rms(error), 3.0),
            *divergence(runs["guarded"]),
        ]
        if options.scale_step is not None:
            at = round(options.scale_step[0]) + 15
            for kind, drives in runs.items():
                scale = 100.0 * np.abs([d.scale_error[at] for d in drives])
                lines.append(f"      {kind}: scale error 15 s later, largest {scale.max():.4f} %")
                if kind == "guarded":
                    name_ = "guarded: scale error 15 s later, largest [%]"
                    checks.append(upper(name_, scale.max(), 0.2))
        yield Case(f"fading on the ring, {name}", seeds, lines, checks)


def start_errors(seeds: int) -> Cases:
    """On the ring from a heading wrong by so much, its sigma: without coarse heading and guards."""
    # How far the filters' own equations reach; it is why they start from wander_kf.
    settings: dict[str, Parameters] = {
        method: {"method": method, "coarse": "inertial", "gauss_hermite_nodes": 7}
        for method in ("ghf", "ckf", "ekf")
    }
    lines, checks = [], []
    for error_deg in (5.0, 30.0, 60.0):
        start = Start(error_deg, error_deg)
        for method, parameters in settings.items():
            options = VehicleOptions(scenario="ring")
            drives = every_seed(drive, options, range(seeds), parameters, start)
            end = np.abs(heading_errors(drives)[:, 600])
            reached = (end < 10.0).sum()
            lines.append(
                f"      {method} from {error_deg:3g} deg: median {np.median(end):9.3f}',"
                f" below 10' {reached} of {seeds}, NEES {nees(drives, 600):.3g}"
            )
            if error_deg == 5.0:
                checks.append(Check(f"{method}: runs below 10' from 5 deg", reached, seeds, seeds))
    yield Case("ring, fog, from a wrong heading", seeds, lines, checks)


SECTIONS = (methods, nodes, fading, start_errors)
