"""The large-azimuth methods through a session: start, witness, time to alignment, bits."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from odo_sessions import Curve, align, config_of, curve_of, misalignment, vehicle

from sins_align.grades import ConfigError
from sins_align.session import Session
from sins_align.simulate import VehicleOptions, VehicleRun, simulate_vehicle
from sins_align.types import Estimate, State, Update

ARCMIN = math.radians(1.0 / 60.0)
DEGREE = math.radians(1.0)
SECOND = 1_000_000_000
MOST_SIGMA = 4.0
END_S = 200.0
METHODS = ("sghf", "ghf", "ckf", "ekf", "ukf")
DRIVES = [(scenario, seed) for scenario in ("ring", "figure8") for seed in (1, 2)]
every_drive = pytest.mark.parametrize(("scenario", "seed"), DRIVES)


@cache
def driven(scenario: str, seed: int, **parameters: Any) -> tuple[VehicleRun, list[Update], Curve]:
    run = vehicle(scenario, END_S, seed=seed)
    _, updates = align(run, **parameters)
    return run, updates, curve_of(run, updates)


def estimates(updates: Sequence[Update]) -> list[Estimate]:
    return [update.estimate for update in updates if update.estimate is not None]


def aligned_since(run: VehicleRun, updates: Sequence[Update]) -> float:
    """When `aligned` is said for the first time [s]."""
    stamps = [u.stamp_ns for u in updates if u.status.state is State.ALIGNED]
    return (stamps[0] - run.options.start_stamp_ns) * 1e-9 if stamps else math.inf


# -- accuracy


# From the coarse alignment a filter begins late, and without what that knew of biases and scale.
SIGMAS = {"wander": 8.0 * ARCMIN, "inertial": 15.0 * ARCMIN}


@every_drive
@pytest.mark.parametrize("coarse", ["wander", "inertial"])
@pytest.mark.parametrize("method", METHODS)
def test_heading(method: str, coarse: str, scenario: str, seed: int) -> None:
    """All of them, from either start: never beyond 4 sigma, and near the floor at the end."""
    _, _, curve = driven(scenario, seed, method=method, coarse=coarse)
    assert curve.time_s[-1] > END_S - 3.0
    assert (curve.sigma[:, 2] < 3.0 * DEGREE).all()
    assert curve.ratio.max() < MOST_SIGMA
    assert abs(curve.phi[-1, 2]) < 2.0 * SIGMAS[coarse]
    assert curve.sigma[-1, 2] < SIGMAS[coarse]
    assert np.abs(curve.phi[-1, :2]).max() < 0.3 * ARCMIN


LATER_S = 30.0


@every_drive
def test_the_default_is_aligned_not_much_later_than_the_wander_filter(
    scenario: str, seed: int
) -> None:
    run, default, _ = driven(scenario, seed)
    _, named, _ = driven(scenario, seed, method="sghf", coarse="wander", fading="guarded")
    assert [u.stamp_ns for u in default] == [u.stamp_ns for u in named]
    assert bits(default[-1].estimate) == bits(named[-1].estimate) != ()
    _, wander, _ = driven(scenario, seed, method="wander_kf")
    limits = [aligned_since(run, updates) for updates in (default, wander)]
    assert limits[1] < END_S - LATER_S
    assert limits[0] <= limits[1] + LATER_S


@every_drive
def test_two_starts_find_the_same_heading(scenario: str, seed: int) -> None:
    """Within 3 sigma of both, and the levels within one.

    The coarse alignment does not use the data as well as the wander filter: they are not the same.
    """
    ends = [driven(scenario, seed, coarse=c)[2] for c in ("wander", "inertial")]
    assert ends[0].phi[-1, 2] != ends[1].phi[-1, 2]
    off = np.abs(ends[0].phi[-1] - ends[1].phi[-1])
    assert (off < np.array([1.0, 1.0, 3.0]) * np.hypot(ends[0].sigma[-1], ends[1].sigma[-1])).all()


# -- the witness


@every_drive
def test_witness(scenario: str, seed: int) -> None:
    """As soon as there is another filter, to the end; it is wander_kf itself that it tells of."""
    run, updates, _ = driven(scenario, seed, method="sghf")
    given = estimates(updates)
    witnessed = [e.witness is not None for e in given]
    first = witnessed.index(True)
    assert all(witnessed[first:])
    assert given[first].sigma[2] < 2.5 * DEGREE
    assert first < 0.5 * len(given)
    beside = {e.stamp_ns: e for e in estimates(driven(scenario, seed, method="wander_kf")[1])}
    compared, largest = 0, 0.0
    for estimate in given[first:]:
        witness, other = estimate.witness, beside.get(estimate.stamp_ns)
        assert witness is not None
        assert witness.name == "wander_kf"
        assert 0.0 <= witness.square < 1.0
        if other is None:
            continue  # epochs are paired with another delay of the odometer
        compared += 1
        # phi of the estimate against the witness: estimate = (I - [phi x]) witness.
        expected = misalignment(run, estimate) - misalignment(run, other)
        off = np.abs(witness.phi - expected)
        assert (off < np.array([0.005, 0.005, 0.5]) * ARCMIN).all()
        largest = max(largest, abs(expected[2]))
        covariance = estimate.misalignment_covariance + other.misalignment_covariance
        square = witness.phi @ np.linalg.solve(covariance, witness.phi) / 3.0
        assert witness.square == pytest.approx(square, rel=0.1, abs=1e-3)
    assert compared > 20
    assert largest > 0.6 * ARCMIN


@pytest.mark.parametrize(
    "parameters",
    [{"method": "sghf", "coarse": "inertial"}, {"method": "ckf", "coarse": "inertial"},
     {"method": "wander_kf"}, {"method": "wander_ekf"}],
)  # fmt: skip
def test_without_a_witness(parameters: dict[str, Any]) -> None:
    _, updates, _ = driven("ring", 1, **parameters)
    given = estimates(updates)
    assert len(given) > 50
    assert all(estimate.witness is None for estimate in given)


def test_the_wander_filter_is_given_out_until_the_other_one_starts() -> None:
    """And its own estimate is the last before, but for rounding."""
    _, updates, _ = driven("figure8", 1, method="sghf")
    beside = {u.stamp_ns: u for u in driven("figure8", 1, method="wander_kf")[1]}
    before = [e for e in estimates(updates) if e.witness is None]
    assert before
    for estimate in before:
        other = beside[estimate.stamp_ns].estimate
        assert other is not None
        np.testing.assert_allclose(estimate.q_nb, other.q_nb, atol=1e-9)
        np.testing.assert_allclose(
            estimate.misalignment_covariance, other.misalignment_covariance, rtol=1e-6, atol=1e-15
        )


# -- the same samples, the same bits


def bits(estimate: Estimate | None) -> tuple[object, ...]:
    """Every bit of an estimate."""
    if estimate is None:
        return ()
    arrays = [
        estimate.q_nb, estimate.misalignment_covariance, estimate.gyro_bias,
        estimate.gyro_bias_sigma, estimate.accel_bias, estimate.accel_bias_sigma,
    ]  # fmt: skip
    odometer, witness = estimate.odometer, estimate.witness
    numbers = [estimate.consistency]
    if odometer is not None:
        numbers += [odometer.scale_error, odometer.scale_sigma, odometer.latency_s]
        arrays += [odometer.mounting_rpy, odometer.lever_arm_b, odometer.lever_arm_covariance]
    if witness is not None:
        arrays.append(witness.phi)
        numbers.append(witness.square)
    return estimate.stamp_ns, *(array.tobytes() for array in arrays), *map(repr, numbers)


def trace(updates: Sequence[Update]) -> list[tuple[object, ...]]:
    return [(u.stamp_ns, bits(u.estimate), u.status) for u in updates]


def hand_over(
    run: VehicleRun, piece_ns: int, lead_ns: int, session: Session
) -> Iterator[list[Update]]:
    """In pieces of the IMU; the odometer is ahead of it by lead_ns, or behind."""
    imu, odometer = run.imu, run.odometer
    begin = known = 0
    for until in range(int(imu.stamp_ns[0]), int(imu.stamp_ns[-1]) + piece_ns, piece_ns):
        end = int(np.searchsorted(imu.stamp_ns, until, "right"))
        now = max(known, int(np.searchsorted(odometer.stamp_ns, until + lead_ns, "right")))
        if now > known:
            yield session.add_odometer(odometer.select(slice(known, now)))
        if end > begin:
            yield session.add_imu(imu.select(slice(begin, end)))
        begin, known = end, now
    yield session.add_odometer(odometer.select(slice(known, None)))


@pytest.mark.parametrize("coarse", ["wander", "inertial"])
@pytest.mark.parametrize(
    ("piece_ns", "lead_ns"),
    [(10_000_000, SECOND), (70_000_000, -300_000_000), (SECOND, 0), (5 * SECOND, SECOND)],
)
def test_handing_over_changes_no_bit(piece_ns: int, lead_ns: int, coarse: str) -> None:
    """Both filters beside each other, an odometer that slips, and one that loses samples."""
    faults = {"slip_count": 3, "outlier_fraction": 0.01, "dropouts": ((80.0, 5.0),)}
    run = vehicle("ring", 160.0, seed=4, odometer_latency_s=0.1, lost_fraction=0.005, **faults)
    _, expected = align(run, coarse=coarse)
    pieces = Session(config_of(run, coarse=coarse))
    found = [update for part in hand_over(run, piece_ns, lead_ns, pieces) for update in part]
    assert trace(found) == trace(expected)
    last = estimates(expected)[-1]
    assert (last.witness is not None) is (coarse == "wander")


# -- what was once wrong


def town(seed: int, duration_s: float, **changes: Any) -> VehicleRun:
    options = {"rate_hz": 200.0, "scenario": "urban", "seed": seed, "duration_s": duration_s}
    return simulate_vehicle(VehicleOptions(**{**options, **changes}))


@pytest.mark.parametrize("coarse", ["wander", "inertial"])
def test_a_gap_that_loses_the_azimuth(coarse: str) -> None:
    """0.3 s in a turn: the filter is given up before its model is wrong for good."""
    run = town(402, 400.0, grade="rlg")
    time_s = (run.imu.stamp_ns - run.imu.stamp_ns[0]) * 1e-9
    whole = ~((time_s > 300.0) & (time_s < 300.3))
    session = Session(config_of(run, coarse=coarse))
    updates = [*session.add_odometer(run.odometer), *session.add_imu(run.imu.select(whole))]
    curve = curve_of(run, updates)
    before, after = curve.time_s < 300.0, curve.time_s > 301.0
    assert curve.sigma[before][-1, 2] < 5.0 * ARCMIN
    assert curve.sigma[after][0, 2] > 10.0 * ARCMIN
    assert curve.ratio.max() < MOST_SIGMA
    if coarse == "wander":
        assert curve.time_s[-1] > 397.0 and curve.sigma[-1, 2] < 10.0 * ARCMIN
    else:
        assert any("the azimuth was lost" in update.status.reason for update in updates)


def test_an_odometer_stuck_before_the_azimuth_is_known() -> None:
    """What the wheel misses is no measurement of the azimuth: 19' off at 7 sigma, once."""
    run = town(8, 200.0, stuck=((100.0, 30.0),))
    _, updates = align(run, method="sghf")
    curve = curve_of(run, updates)
    assert curve.ratio.max() < MOST_SIGMA
    _, beside = align(run, method="wander_kf")
    at = curve.at(128.0)
    other = curve_of(run, beside)
    assert curve.sigma[at, 2] > 0.8 * other.sigma[other.at(128.0), 2]


# -- settings


@pytest.mark.parametrize(
    ("key", "value"),
    [("method", "sgkf"), ("coarse", "wonder"), ("fading", "publish"), ("fading", True),
     ("gauss_hermite_nodes", 1), ("gauss_hermite_nodes", 2.5)],
)  # fmt: skip
def test_a_value_that_is_not_known_fails_with_the_key(key: str, value: object) -> None:
    run = vehicle("ring", 5.0)
    with pytest.raises(ConfigError, match=key):
        config_of(run, **{key: value})


def test_methods_differ() -> None:
    """Each setting reaches the filter: no two of them end with the same bits."""
    settings: list[dict[str, Any]] = [{"method": method} for method in METHODS]
    settings += [{"method": "ghf", "gauss_hermite_nodes": 7}, {"coarse": "inertial"}]
    run = vehicle("ring", END_S, seed=1, scale_step=(100.0, 0.02))
    ends = [bits(align(run, **parameters)[0].estimate) for parameters in settings]
    faded = [bits(align(run, fading=fading)[0].estimate) for fading in ("none", "published")]
    assert all(ends)
    assert len(set(ends + faded)) == len(ends + faded) - 1
    # Without fading sghf is ghf.
    assert faded[0] == ends[METHODS.index("ghf")]
