"""An odometer that counts backwards, in another unit, or not at all: said, and not believed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from odo_sessions import align, config_of, vehicle

from sins_align.odo.epoch import integrate_epoch
from sins_align.odo.pairing import Pairing
from sins_align.odo.plausibility import OdometerPlausibility, Slope
from sins_align.session import Session
from sins_align.simulate import VehicleRun
from sins_align.types import Estimate, ImuBlock, OdometerSamples, State, Update
from sins_align.units import ARCMIN

LIMITS = {"heading_threshold_arcmin": 20.0, "level_threshold_arcsec": 60.0, "hold_s": 3.0}


def spoiled(run: VehicleRun, factor: float, until_s: float) -> OdometerSamples:
    """Speeds times `factor` for the first `until_s`."""
    odometer = run.odometer
    early = (odometer.stamp_ns - run.options.start_stamp_ns) * 1e-9 < until_s
    speed = np.where(early, factor * odometer.speed, odometer.speed)
    return OdometerSamples(odometer.stamp_ns, speed, odometer.variance)


def drive(run: VehicleRun, odometer: OdometerSamples, **parameters: Any) -> list[Update]:
    session = Session(config_of(run, **{**LIMITS, **parameters}))
    return session.add_odometer(odometer) + session.add_imu(run.imu)


def slopes(run: VehicleRun) -> tuple[list[Slope], set[str]]:
    """Of the whole drive, and what was found."""
    config = config_of(run)
    pairing = Pairing(config.odometer)
    pairing.add_odometer(run.odometer)
    pairing.add_imu(ImuBlock(*run.imu))
    plausibility = OdometerPlausibility(np.array([1.0, 0.0, 0.0]))
    found, keys = [], set()
    while (paired := pairing.next(config.odometer.latency)) is not None:
        plausibility.add(integrate_epoch(paired, config.sampling))
        slope = plausibility.slope()
        found += [] if slope is None else [slope]
        keys |= {f.reason.key for f in plausibility.findings}
    return found, keys


@pytest.mark.parametrize(
    "changes",
    [{}, {"slip_count": 6}, {"outlier_fraction": 0.02}, {"odometer_latency_s": 0.5},
     {"odometer_rate_hz": 1.0, "odometer_quantum_m": 0.1}, {"stuck": ((60.0, 20.0),)},
     {"dropouts": ((60.0, 20.0),)}, {"grade": "tactical"}, {"lost_fraction": 0.01}],
    ids=str,
)  # fmt: skip
@pytest.mark.parametrize("scenario", ["urban", "ring", "reverse", "straight"])
def test_no_false_alarm(scenario: str, changes: dict[str, Any]) -> None:
    found, keys = slopes(vehicle(scenario, 150.0, rate_hz=50.0, **changes))
    assert not keys
    if not changes:
        assert max(abs(s.value - 1.0) for s in found) < 0.03
        assert np.median([s.sigma for s in found]) < 0.01


def test_a_vehicle_that_stands_tells_nothing() -> None:
    assert slopes(vehicle("static", 60.0, rate_hz=50.0)) == ([], set())


@pytest.mark.parametrize(
    ("factor", "key"),
    [(-1.0, "odometer_opposite"), (3.6, "odometer_scale"), (2.24, "odometer_scale")],
)  # fmt: skip
@pytest.mark.parametrize("scenario", ["ring", "urban"])
def test_wrong_for_two_minutes(scenario: str, factor: float, key: str) -> None:
    """Named, not aligned meanwhile, and aligned by itself when it is right again."""
    run = vehicle(scenario, 330.0, rate_hz=50.0)
    updates = drive(run, spoiled(run, factor, 120.0))
    start_ns = run.options.start_stamp_ns
    wrong = [u for u in updates if 40e9 < u.stamp_ns - start_ns < 120e9]
    assert all(
        u.status.state is not State.ALIGNED for u in updates if u.stamp_ns < start_ns + 12e10
    )
    assert all(key in u.status.keys for u in wrong)
    assert all("topic odom" in u.status.remedy or "m/s" in u.status.remedy for u in wrong)
    last = updates[-1]
    assert last.status.state is State.ALIGNED
    assert last.status.keys == ()
    assert last.estimate is not None
    assert error(run, last.estimate) < 4.0 * last.estimate.sigma[2]
    assert last.estimate.sigma[2] < 20.0 * ARCMIN


def error(run: VehicleRun, estimate: Estimate) -> float:
    from odo_sessions import misalignment

    return abs(float(misalignment(run, estimate)[2]))


def test_what_is_said_is_the_unit() -> None:
    run = vehicle("ring", 60.0, rate_hz=50.0)
    last = drive(run, spoiled(run, 0.001, 1e9))[-1].status
    assert "odometer_scale" in last.keys and "by 0.00 of" in last.reason


@pytest.mark.parametrize("method", ["wander_kf", "sghf"])
@pytest.mark.parametrize("scenario", ["ring", "urban", "moving_start", "straight"])
def test_reversed_for_ever_is_never_aligned(scenario: str, method: str) -> None:
    run = vehicle(scenario, 200.0, rate_hz=50.0)
    updates = drive(run, spoiled(run, -1.0, 1e9), method=method)
    assert State.ALIGNED not in {u.status.state for u in updates}
    assert "odometer_opposite" in updates[-1].status.keys


def test_an_odometer_that_falls_silent_is_named() -> None:
    run = vehicle("ring", 200.0, rate_hz=50.0, dropouts=((150.0, 20.0),))
    updates = drive(run, run.odometer)
    start_ns = run.options.start_stamp_ns
    at = {round((u.stamp_ns - start_ns) * 1e-9): u.status for u in updates}
    assert at[148].state is State.ALIGNED
    assert "odometer_silent" in at[168].keys
    assert at[168].state is not State.ALIGNED
    assert "odom" in at[168].remedy
    assert updates[-1].status.state is State.ALIGNED


def test_one_that_falls_silent_while_the_vehicle_stands_is_not() -> None:
    run = vehicle("static", 150.0, dropouts=((20.0, 200.0),))
    _, updates = align(run)
    assert not any("odometer_silent" in u.status.keys for u in updates)
