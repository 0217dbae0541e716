"""The figures of odo_align on simulated drives: sghf and wander_kf, any heading.

RMS at a time is over all runs, with the filter's own attitude where no heading is shown yet.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from evidence.checks import Case, Cases, Check, upper
from evidence.monte_carlo import every_seed, misalignment, rms
from evidence.odo_figures import (
    NEES,
    below_since,
    divergence,
    heading_errors,
    nees,
    rows,
    shown_nees,
)
from evidence.odo_runs import Drive, every_drive, make_config
from sins_align.limits import heading_limit
from sins_align.odo.coarse import CoarseAligner
from sins_align.odo.epoch import integrate_epoch
from sins_align.odo.pairing import Pairing
from sins_align.simulate import VehicleOptions, simulate_vehicle
from sins_align.types import Array, ImuBlock
from sins_align.units import ARCMIN, DEG

# The default, and the filter that it starts from.
METHODS = {name: {"method": name} for name in ("wander_kf", "sghf")}


def _coarse_errors(options: VehicleOptions) -> Array:
    """(T, 4) phi [rad] and sigma of heading, of the coarse alignment alone, by the second."""
    run = simulate_vehicle(options)
    config = make_config(options, {})
    assert config.position is not None
    aligner = CoarseAligner(config.position, config.grade, config.odometer)
    pairing = Pairing(config.odometer)
    pairing.add_odometer(run.odometer)
    pairing.add_imu(ImuBlock(*run.imu))
    table = np.full((round(options.duration_s) + 1, 4), np.nan)
    while (paired := pairing.next(0.0)) is not None:
        epoch = integrate_epoch(paired, config.sampling)
        aligner.add(epoch)
        found = aligner.attitude
        if found is not None:
            phi = misalignment(found.C_nb, run.truth.C_nb_at(found.stamp_ns))
            second = round((found.stamp_ns - options.start_stamp_ns) * 1e-9)
            table[second:] = *phi, math.sqrt(found.covariance[2, 2])
    return table


def coarse(seeds: int) -> Cases:
    """Coarse alignment alone: heading from nothing, and from ground that tilts by 2 deg."""
    for scenario, bounds in (("ring", {60: None, 120: 5.0, 180: 1.2}), ("static", {60: 0.4})):
        flat = VehicleOptions(
            scenario=scenario, duration_s=max(bounds) + 3.0, ground_roll_deg=0.0,
            ground_pitch_deg=0.0,
        )  # fmt: skip
        tilted = replace(flat, ground_roll_deg=2.0, ground_pitch_deg=-2.0)
        tables = {}
        for name, options in (
            ("random tilt", replace(flat, ground_roll_deg=None, ground_pitch_deg=None)),
            ("no tilt", flat),
            ("tilt of 2 deg", tilted),
        ):
            tables[name] = table = np.array(every_seed(_coarse_errors, options, range(seeds)))
            lines, checks = [], []
            for t, bound in bounds.items():
                error, sigma = table[:, t, 2] / DEG, table[:, t, 3] / DEG
                level = table[:, t, :2] / ARCMIN
                lines.append(
                    f"      {t:4d} s  heading deg: mean {error.mean():8.4f}  RMS {rms(error):7.4f}"
                    f"  max {np.abs(error).max():7.4f}  sigma {rms(sigma):7.4f}"
                    f"  NEES {rms(error / sigma) ** 2:5.2f}  level ': RMS {rms(level):6.3f}"
                )
                if bound is not None:
                    checks.append(upper(f"heading RMS at {t} s [deg]", rms(error), bound))
            if name == "tilt of 2 deg":
                at = max(bounds)
                change = (table - tables["no tilt"])[:, at, 2]
                share = np.abs(change / table[:, at, 3]).max()
                checks.append(upper("largest change of heading by the tilt / sigma", share, 0.5))
            yield Case(f"coarse, {scenario}, {name}", seeds, lines, checks)


# RMS and largest heading error at 600 s [arcmin]; 1 deg and 10' from when on [s]; level [arcmin].
ACCURACY = {
    "ring": (2.5, 6.0, 65, 150, 0.15),
    "figure8": (2.8, 6.0, 65, 150, 0.15),
    "urban": (2.8, 6.0, 65, 150, 0.15),
    "moving_start": (2.8, 6.0, 95, 160, 0.15),
    "static": (6.5, 18.0, 25, 150, 0.4),
    "straight": (6.5, 18.0, 65, 160, 0.4),
}
# Heading RMS on the ring with the paper's grade [arcmin], by the method.
PAPER_GRADE = {"wander_kf": 0.6, "sghf": 0.8}
# How much later than wander_kf sghf may be aligned [s].
LATER_S = 30.0


def accuracy(seeds: int) -> Cases:
    """Accuracy after 600 s, when it gets there, and whether sigma says so."""
    for scenario in ACCURACY:
        runs = every_drive(VehicleOptions(scenario=scenario), METHODS, seeds)
        for method, drives in runs.items():
            checks = _accuracy_checks(scenario, drives)
            yield Case(f"{method}, {scenario}, fog", seeds, rows(drives), checks)
        yield _aligned_later(f"{scenario}, fog", runs)
    runs = every_drive(VehicleOptions(scenario="ring", grade="paper_odo"), METHODS, seeds)
    for method, drives in runs.items():
        error = heading_errors(drives)[:, -1]
        checks = [
            upper("heading RMS at 600 s [']", rms(error), PAPER_GRADE[method]),
            upper("heading max at 600 s [']", np.abs(error).max(), 1.5),
            *_honesty(drives),
            _scale_check(drives),
        ]
        yield Case(f"{method}, ring, paper_odo", seeds, rows(drives), checks)
    yield _aligned_later("ring, paper_odo", runs)


def _accuracy_checks(scenario: str, drives: list[Drive]) -> list[Check]:
    bound, most, degree_s, ten_s, level = ACCURACY[scenario]
    curve = rms(heading_errors(drives), axis=0)
    error = heading_errors(drives)[:, -1]
    levels = rms(np.array([d.phi[-1, :2] for d in drives]), axis=0) / ARCMIN
    checks = [
        upper("heading RMS at 600 s [']", rms(error), bound),
        upper("heading max at 600 s [']", np.abs(error).max(), most),
        upper("heading RMS below 1 deg from [s]", below_since(curve, 60.0), degree_s),
        upper("heading RMS below 10' from [s]", below_since(curve, 10.0), ten_s),
        upper("level RMS at 600 s, the larger one [']", levels.max(), level),
        *_honesty(drives),
    ]
    if scenario not in ("static", "straight"):
        checks.append(upper("heading RMS at 120 s [']", curve[120], 20.0))
    if scenario != "static":
        checks.append(_scale_check(drives))
    return checks


def _aligned_later(name: str, runs: Mapping[str, list[Drive]]) -> Case:
    """How much later sghf is aligned than wander_kf, run by run."""
    wander, own = (np.array([d.aligned_s for d in runs[m]]) for m in ("wander_kf", "sghf"))
    both = np.isfinite(wander) & np.isfinite(own)
    later = own[both] - wander[both]
    counts = (
        f"      wander_kf aligned in {np.isfinite(wander).sum()} runs, median at"
        f" {np.median(wander):.0f} s; sghf in {np.isfinite(own).sum()}, at {np.median(own):.0f} s;"
        f" neither in {(np.isinf(wander) & np.isinf(own)).sum()}"
    )
    lines = [counts]
    if later.size:
        lines.append(
            f"      sghf later by: median {np.median(later):.1f} s, most {later.max():.1f} s,"
            f" least {later.min():.1f} s"
        )
    checks = [
        upper("largest delay of sghf [s]", max(0.0, later.max(initial=0.0)), LATER_S),
        upper("runs that only wander_kf aligns", (np.isfinite(wander) & ~both).sum(), 0.0),
    ]
    return Case(f"sghf after wander_kf, {name}", len(own), lines, checks)


def _honesty(drives: list[Drive]) -> list[Check]:
    """Heading sigma against heading error, and what else would be a lie."""
    return [
        Check("heading NEES at 600 s", nees(drives, 600), *NEES),
        Check("heading NEES, all that was shown", shown_nees(drives), *NEES),
        *divergence(drives),
    ]


def _scale_check(drives: list[Drive]) -> Check:
    worst = max(abs(d.scale_error[-1]) for d in drives)
    return upper("scale error at 600 s, largest [%]", 100.0 * worst, 0.03)


FAULTS: dict[str, dict[str, Any]] = {
    "slip of +50 %, 2 s, ten times": {"slip_count": 10},
    "1 % outliers": {"outlier_fraction": 0.01},
    "odometer stuck at 0 for 30 s": {"stuck": ((300.0, 30.0),)},
    "dropout for 30 s": {"dropouts": ((300.0, 30.0),)},
    "mounting 0.3, 0.3 deg": {"mounting_rpy_deg": (0.0, 0.3, 0.3)},
    "latency 100 ms and lever arm": {
        "odometer_latency_s": 0.1,
        "odometer_lever_arm_m": (1.2, -0.3, 0.5),
    },
    "reversing": {"scenario": "reverse"},
    "scale +2 % at 300 s": {"scale_step": (300.0, 0.02)},
    "scale +2 % at 500 s": {"scale_step": (500.0, 0.02)},
    "odometer stuck at 0 from 100 s, urban": {"scenario": "urban", "stuck": ((100.0, 30.0),)},
}


def faults(seeds: int) -> Cases:
    """An odometer that fails, and a vehicle that is not what was declared; on the ring."""
    for name, changes in FAULTS.items():
        options = VehicleOptions(**{"scenario": "ring", **changes})
        for method, drives in every_drive(options, METHODS, seeds).items():
            error = heading_errors(drives)[:, -1]
            checks = [upper("heading RMS at 600 s [']", rms(error), 3.0), *divergence(drives)]
            if options.scale_step is not None:
                at = round(options.scale_step[0]) + 15
                worst = max(abs(d.scale_error[at]) for d in drives)
                checks.append(upper("scale error 15 s later, largest [%]", 100.0 * worst, 0.2))
            yield Case(f"{method}, {name}", seeds, rows(drives), checks)


def latitudes(seeds: int) -> Cases:
    """From the southern hemisphere to the pole: static against sec L, and the ring."""
    wander = {"wander_kf": METHODS["wander_kf"]}
    scaled = {}
    for latitude in (40.0, -60.0, 0.0, 75.0, 85.0):
        options = VehicleOptions(scenario="static", latitude_deg=latitude)
        drives = every_drive(options, wander, seeds)["wander_kf"]
        error = heading_errors(drives)[:, -1]
        limit = heading_limit(options.imu_grade, latitude * DEG) / ARCMIN
        ratio = rms(error) / limit
        scaled[latitude] = rms(error) * math.cos(latitude * DEG)
        checks = [
            Check(f"heading RMS over theory ({limit:.2f}')", ratio, 0.6, 1.4),
            Check("RMS cos L against that at 40 deg", scaled[latitude] / scaled[40.0], 0.9, 1.1),
            *_honesty(drives),
        ]
        yield Case(f"wander_kf, static, latitude {latitude:g}", seeds, rows(drives), checks)
    for latitude in (-60.0, 0.0, 75.0, 85.0):
        options = VehicleOptions(scenario="ring", latitude_deg=latitude)
        methods = METHODS if latitude in (-60.0, 75.0) else wander
        for method, drives in every_drive(options, methods, seeds).items():
            name = f"{method}, ring, latitude {latitude:g}"
            yield Case(name, seeds, rows(drives), _honesty(drives))
    options = VehicleOptions(scenario="static", latitude_deg=89.9)
    drives = every_drive(options, wander, seeds)["wander_kf"]
    shown = sum(bool(np.nansum(d.published)) for d in drives)
    told = sum("unobservable" in d.status.reason for d in drives)
    checks = [
        upper("runs that ever show a heading", shown, 0.0),
        Check("runs whose status says unobservable", told, seeds, seeds),
    ]
    lines = [f"      status: {drives[0].status.reason}", f"      remedy: {drives[0].status.remedy}"]
    yield Case("wander_kf, static, latitude 89.9", seeds, lines, checks)


SECTIONS = (coarse, accuracy, faults, latitudes)
