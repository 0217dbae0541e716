"""The status of both nodes: false claims, honesty of sigma, time to go, the latitude."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from joblib import Parallel, delayed
from scipy.stats import binomtest, chi2

from evidence.checks import Case, Cases, Check, upper
from evidence.status_plans_odo import odo_plan
from evidence.status_plans_swing import swing_plan
from evidence.status_runs import ETA_AT_S, FALSE_RATIO, Moment, Plan, Record, run
from sins_align.simulate import SwingOptions, VehicleOptions
from sins_align.units import ARCMIN

# Runs for each of the seeds asked for: 720 and 540 of 30.
SWING_RUNS, ODO_RUNS = 24, 18
MOST_FALSE = 0.003
# The settings say other than the sensors do. What a gyro's bias does to a base that does not turn
# no estimate can tell from heading.
MISDECLARED = ("gyro bias", "gyro noise", "imu_sampling")
LEAST_ETA = 0.8
# Two-sided, of a mean normalised square over many runs.
CONFIDENCE = 0.99
# Of the latitude: how long a run lasts, how wrong it is, and right runs for each wrong one.
LATITUDE_S, WRONG_DEG, RIGHT_RUNS = 300.0, 1.0, 10.0 / 3.0
LATITUDES_DEG = (0.0, 65.0)


def run_number(node: str, number: int) -> Record:
    """The run of that number: a pure function of it."""
    return run(swing_plan(number) if node == "swing" else odo_plan(number))


def all_records(seeds: int, jobs: int = 2) -> list[Record]:
    """The runs of both nodes."""
    work = [("swing", n) for n in range(SWING_RUNS * seeds)]
    work += [("odo", n) for n in range(ODO_RUNS * seeds)]
    return list(Parallel(n_jobs=jobs)(delayed(run_number)(*what) for what in work))


def share_bounds(count: int, runs: int) -> tuple[float, float]:
    """Clopper and Pearson's two-sided 95 % bounds of a share."""
    bounds = binomtest(count, runs).proportion_ci(0.95, method="exact")
    return float(bounds.low), float(bounds.high)


def status_calibration(seeds: int) -> Cases:
    """Drawn at random, half of them with faults: false claims, sigma, and the time to go."""
    records = all_records(seeds)
    yield _false_case(records)
    for node in ("swing", "odo"):
        yield _nees_case(node, [r for r in records if r.node == node and not r.faults])
    yield _eta_case("clean", [r for r in records if not r.faults])
    yield _eta_case("faults included", records)


def _false_case(records: Sequence[Record]) -> Case:
    """How many runs claim what is not true, and which."""
    groups: dict[str, list[Record]] = {"all": list(records)}
    for node in ("swing", "odo"):
        own = [r for r in records if r.node == node]
        groups[node] = own
        groups[f"{node}, clean"] = [r for r in own if not r.faults]
        groups[f"{node}, faulty"] = [r for r in own if r.faults]
        groups[f"{node}, declared"] = [r for r in own if is_declared(r)]
    declared = groups["declared"] = [r for r in records if is_declared(r)]
    gaussian = 100.0 * math.erfc(FALSE_RATIO / math.sqrt(2.0))
    lines = [f"      beyond {FALSE_RATIO:g} sigma at any one moment, Gaussian: {gaussian:.2f} %"]
    lines += [_counts(name, own) for name, own in groups.items() if own]
    lines += _by_fault(records)
    false = [r for r in records if r.is_false]
    lines += [describe(r) for r in sorted(false, key=lambda r: (r.node, bool(r.faults)))]
    checks = []
    for name, own in (("all", records), ("sensors as declared", declared)):
        for when, count in (
            ("at any time", sum(r.is_false for r in own)),
            ("at the first claim", sum(r.is_false_at_first for r in own)),
        ):
            share = 100.0 * count / len(own)
            checks.append(upper(f"false claims {when}, {name} [%]", share, 100.0 * MOST_FALSE))
    return Case("false claims", len(records), lines, checks)


def is_declared(record: Record) -> bool:
    """Whether the settings say what the sensors are."""
    return not any(fault.partition(":")[0] in MISDECLARED for fault in record.faults)


def _counts(name: str, records: Sequence[Record]) -> str:
    runs, aligned = len(records), sum(r.first is not None for r in records)

    def share(count: int) -> str:
        low, high = share_bounds(count, runs)
        return f"{count:3d} = {100.0 * count / runs:5.2f} % [{100.0 * low:.2f}, {100.0 * high:.2f}]"

    ever, first = sum(r.is_false for r in records), sum(r.is_false_at_first for r in records)
    return (
        f"      {name:14s} {runs:5d} runs, {aligned:5d} aligned; false at any time"
        f" {share(ever)}, at the first claim {share(first)}"
    )


def _by_fault(records: Sequence[Record]) -> Iterable[str]:
    """Runs that have a fault, alone or among others."""
    for node in ("swing", "odo"):
        own = [r for r in records if r.node == node]
        for kind in sorted({fault.partition(":")[0] for r in own for fault in r.faults}):
            with_it = [r for r in own if any(f.startswith(f"{kind}:") for f in r.faults)]
            yield (
                f"      {node:5s} {kind:21s} {len(with_it):4d} runs,"
                f" {sum(r.first is not None for r in with_it):4d} aligned,"
                f" {sum(r.is_false for r in with_it):3d} false"
            )


def describe(record: Record) -> str:
    """A false claim, for who looks into it."""
    worst, first = record.worst, record.first
    assert worst is not None
    assert first is not None
    return (
        f"      FALSE {record.node} {record.number}: {record.scenario}, {record.grade},"
        f" {'; '.join(record.faults) or 'clean'}: {worst.ratio:.1f} sigma"
        f" ({worst.heading_error / ARCMIN:+.2f}' of {worst.heading_sigma / ARCMIN:.2f}') at"
        f" {worst.time_s:.0f} s; {first.ratio:.1f} at the first claim at {first.time_s:.0f} s"
    )


def _nees_case(node: str, records: Sequence[Record]) -> Case:
    """Mean normalised squares, within what so many runs allow.

    Early ones are below 1: sigma of heading has room for a swing centre that moves by
    `position_noise_m` and for a wheel with `odometer_noise_m`, neither of which is simulated; so
    has that of the levels on a swing that tells the accelerometers' biases. Where the motion does
    not tell them, what comes of the levels is what was drawn of the biases.
    """
    checks = []
    drawn = sum(r.bias_square for r in records) / (2 * len(records))
    lines = [f"      accelerometers' biases across the vertical: mean square / 2 drawn {drawn:.3f}"]
    for name, moments in (
        ("first claim", [r.first for r in records if r.first is not None]),
        ("end", [r.last for r in records if r.last is not None]),
    ):
        for what, square, freedom in (
            ("heading", _heading_square, 1),
            ("levels", _level_square, 2),
        ):
            checks.append(mean_square_check(f"{what}, {name}", list(map(square, moments)), freedom))
        ratios = [m.ratio for m in moments]
        lines.append(
            f"      {name}: {len(moments)} runs, heading error / sigma: median"
            f" {np.median(ratios):.2f} (Gaussian 0.67), 95 % {np.quantile(ratios, 0.95):.2f}"
            f" (1.96), most {max(ratios):.2f}"
        )
    return Case(f"{node}, normalised squares, clean", len(records), lines, checks)


def _heading_square(moment: Moment) -> float:
    return moment.ratio**2


def _level_square(moment: Moment) -> float:
    return moment.level_square


def mean_square_check(name: str, squares: Sequence[float], freedom: int) -> Check:
    """Their mean over its expectation, within the two-sided chi-square bounds."""
    count = freedom * len(squares)
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = (float(chi2.ppf(p, count)) / count for p in (tail, 1.0 - tail))
    return Check(f"{name}: NEES / {freedom}", sum(squares) / count, low, high)


def _eta_case(name: str, records: Sequence[Record]) -> Case:
    """The time to go told early, against when aligned was claimed."""
    counted = [r for r in records if r.eta_hit is not None]
    kinds = sorted({(r.node, r.scenario.partition(" ")[0].strip(",")) for r in counted})
    lines = [
        _eta_line(
            f"{node} {kind}",
            [r for r in counted if r.node == node and r.scenario.startswith(kind)],
        )
        for node, kind in kinds
    ]
    lines.append(_eta_line("all", counted))
    hits = sum(bool(r.eta_hit) for r in counted)
    share = hits / len(counted) if counted else math.nan
    check = Check("share within 30 % of the time left", share, LEAST_ETA, 1.0)
    return Case(f"time to go at {ETA_AT_S:g} s, {name}", len(counted), lines, [check])


def _eta_line(name: str, records: Sequence[Record]) -> str:
    """Share of hits; quantiles of predicted over true time, where there are both."""
    hits = sum(bool(r.eta_hit) for r in records)
    ratios = [
        r.eta_s / (r.aligned_s - ETA_AT_S)
        for r in records
        if r.first is not None and math.isfinite(r.eta_s)
    ]
    never = sum(r.first is None for r in records)
    untold = sum(r.first is not None and not math.isfinite(r.eta_s) for r in records)
    text = (
        f"      {name:20s} {hits:4d} of {len(records):4d}; {untold:4d} that came untold,"
        f" {never:4d} told that did not come; predicted / true:"
    )
    if not ratios:
        return f"{text} none"
    values = " ".join(f"{q:.2f}" for q in np.quantile(ratios, (0.1, 0.25, 0.5, 0.75, 0.9)))
    return f"{text} quantiles 10 25 50 75 90 %: {values}"


LATITUDE_KINDS = ("swing still", "swing pitch", "swing level", "odo static")


def latitude_plan(kind: str, number: int, wrong_deg: float) -> Plan:
    """A run with default thresholds and a latitude that is off by `wrong_deg`."""
    node, scenario = kind.split()
    stream = np.random.default_rng((3, number))
    latitude = float(stream.uniform(*LATITUDES_DEG) * stream.choice((-1.0, 1.0)))
    simulator: Callable[..., SwingOptions | VehicleOptions] = (
        SwingOptions if node == "swing" else VehicleOptions
    )
    options = simulator(
        scenario=scenario, grade="rlg", seed=number, rate_hz=100.0, duration_s=LATITUDE_S,
        latitude_deg=latitude,
    )  # fmt: skip
    parameters = {
        "latitude_deg": latitude + wrong_deg,
        "altitude_m": options.altitude_m,
        "imu_grade": "rlg",
    }
    faults = (f"latitude: {wrong_deg:+g} deg",) if wrong_deg else ()
    return Plan(number, scenario, "rlg", options, parameters, faults)


def run_latitude(kind: str, number: int, wrong_deg: float) -> Record:
    """The run of that number: a pure function of it."""
    return run(latitude_plan(kind, number, wrong_deg))


def status_latitude(seeds: int) -> Cases:
    """A latitude wrong by 1 deg with grade rlg, and a right one."""
    right = round(RIGHT_RUNS * seeds)
    for kind in LATITUDE_KINDS:
        work = [(kind, n, WRONG_DEG if n % 2 else -WRONG_DEG) for n in range(seeds)]
        work += [(kind, n, 0.0) for n in range(right)]
        records = Parallel(n_jobs=2)(delayed(run_latitude)(*what) for what in work)
        wrong, honest = records[:seeds], records[seeds:]
        times = [r.alarm_s for r in wrong if r.caught]
        lines = []
        if times:
            lines.append(f"      caught at: median {np.median(times):.0f} s, last {max(times):.0f}")
        lines.append(f"      of the wrong ones {sum(r.first is not None for r in wrong)} aligned")
        alarms = sum(math.isfinite(r.alarm_s) for r in honest)
        checks = [
            Check("wrong: caught before aligned", sum(r.caught for r in wrong), seeds, seeds),
            upper(f"right: false alarms in {right} runs", alarms, 0.0),
        ]
        yield Case(f"latitude, {kind}, rlg", len(records), lines, checks)


SECTIONS = (status_calibration, status_latitude)
