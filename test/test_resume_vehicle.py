"""Going on from a stored alignment on a vehicle, whose odometer comes when it comes."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from odo_sessions import bits, config_of, hand_over, misalignment, trace
from resumed_runs import FIRST, SECOND, VEHICLES, document_of
from scipy.stats import chi2

from sins_align.session import Session
from sins_align.simulate import VehicleOptions, VehicleRun, simulate_vehicle, vehicle_route
from sins_align.stored import StoredAlignment, stored_alignment
from sins_align.types import Estimate, Update
from sins_align.units import ARCMIN, DEG


def stand_then_drive(monkeypatch: pytest.MonkeyPatch, stand_s: float, speed: float) -> None:
    """Scenario `straight`: stand first, on ground as level as that of `static`."""

    def plan(draft: Any) -> None:
        draft.speed.hold(stand_s)
        draft.speed.change(speed, speed)
        draft.speed.hold(1000.0)

    kinds = {**vehicle_route._KINDS, "straight": vehicle_route._Kind(plan, 0.0)}
    monkeypatch.setattr(vehicle_route, "_KINDS", kinds)


PARKED = VehicleOptions(
    scenario="static", rate_hz=50.0, duration_s=150.0, heading_deg=70.0, ground_roll_deg=1.0,
    ground_pitch_deg=-0.5,
)  # fmt: skip
STATIONARY = {**FIRST, "aiding": "stationary"}


def parked(seed: int, grade: str, **parameters: Any) -> StoredAlignment:
    run = simulate_vehicle(replace(PARKED, seed=seed, grade=grade))
    session = Session(config_of(run, **{**FIRST, **parameters}))
    session.add_odometer(run.odometer)
    session.add_imu(run.imu)
    return stored_alignment(document_of("odo_align", session))


def resume_drive(
    run: VehicleRun, stored: StoredAlignment, **parameters: Any
) -> tuple[Session, list[Update]]:
    session = Session(replace(config_of(run, **{**FIRST, **parameters}), initial=stored))
    updates = session.add_odometer(run.odometer)
    return session, updates + session.add_imu(run.imu)


def nees(run: VehicleRun, estimate: Estimate) -> float:
    phi = misalignment(run, estimate)
    return float(phi @ np.linalg.solve(estimate.misalignment_covariance, phi))


def test_a_parked_vehicle_without_odometer() -> None:
    """It sways by 5", of which the stored attitude is any phase."""
    squares = []
    for seed in range(VEHICLES):
        stored = parked(seed, "fog", aiding="stationary")
        run = simulate_vehicle(replace(PARKED, seed=seed + 1000, duration_s=45.0))
        session, _ = resume_drive(run, stored, aiding="stationary")
        estimate = session.estimate
        assert estimate is not None
        assert estimate.misalignment_covariance[2, 2] < 1.01 * stored.misalignment_covariance[2, 2]
        squares.append(nees(run, estimate))
    low, high = chi2.ppf([0.0005, 0.9995], 3 * VEHICLES) / VEHICLES
    assert low < np.mean(squares) < high


def test_a_vehicle_that_stands_and_then_drives_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """ENU turns by 52" meanwhile, and sigma of the levels is 7"."""
    stand_then_drive(monkeypatch, 40.0, 20.0)
    squares = []
    for seed in range(VEHICLES):
        stored = parked(seed, "rlg")
        run = simulate_vehicle(
            replace(PARKED, scenario="straight", seed=seed + 1000, grade="rlg", duration_s=140.0)
        )
        session, updates = resume_drive(run, stored)
        assert not any("stored_dropped" in u.status.keys for u in updates)
        estimate = session.estimate
        assert estimate is not None
        assert estimate.misalignment_covariance[2, 2] < 1.1 * stored.misalignment_covariance[2, 2]
        squares.append(nees(run, estimate))
    low, high = chi2.ppf([0.0005, 0.9995], 3 * VEHICLES) / VEHICLES
    assert low < np.mean(squares) < high


def test_a_vehicle_that_drives_straight_on_is_not_standing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """To the grade tactical its v / R is nothing: only the odometer tells."""
    stored = replace_heading_sigma(parked(1, "rlg"), 1.0 * DEG)
    smooth = {"road_motion_deg": 0.0, "direction_noise_deg": 0.0}
    stand_then_drive(monkeypatch, 0.0, 10.0)
    options = replace(PARKED, scenario="straight", grade="tactical", seed=7, duration_s=60.0)
    run = simulate_vehicle(replace(options, **smooth))
    later = run.imu.select(run.imu.stamp_ns > run.imu.stamp_ns[0] + 12 * SECOND)
    session = Session(replace(config_of(run, **FIRST), initial=stored))
    updates = session.add_odometer(run.odometer) + session.add_imu(later)
    assert any("the vehicle drives" in u.status.reason for u in updates)


def replace_heading_sigma(stored: StoredAlignment, sigma: float) -> StoredAlignment:
    P = stored.misalignment_covariance + np.diag([1e-9, 1e-9, sigma**2])
    return replace(stored, misalignment_covariance=P)


MESSY = {
    "odometer_latency_s": 0.1,
    "odometer_jitter_s": 0.005,
    "stamp_jitter_s": 1e-4,
    "outlier_fraction": 0.01,
    "lost_fraction": 0.01,
    "dropouts": ((25.0, 3.0), (40.0, 6.0)),
}


@functools.cache
def stored_and_next(grade: str, heading_sigma: float) -> tuple[StoredAlignment, VehicleRun]:
    """It stands through the check and drives off; what is stored is not as good as it gets."""
    options = replace(PARKED, seed=1002, grade=grade, rate_hz=100.0, duration_s=75.0)
    with pytest.MonkeyPatch.context() as patch:
        stand_then_drive(patch, 42.0, 10.0)
        run = simulate_vehicle(replace(options, scenario="straight", **MESSY))
    return replace_heading_sigma(parked(2, grade), heading_sigma), run


def assert_same_bits(
    session: Session, found: list[Update], expected: tuple[Session, list[Update]]
) -> None:
    assert trace(found) == trace(expected[1])
    assert [u.stamp_ns for u in found] == sorted({u.stamp_ns for u in found})
    assert bits(session.estimate) == bits(expected[0].estimate) != ()
    assert bits(session.conclusion) == bits(expected[0].conclusion)


@pytest.mark.parametrize("case", [("fog", 0.0), ("fog", 1.0 * DEG), ("rlg", 2.0 * ARCMIN)])
@pytest.mark.parametrize(
    ("imu_ns", "lead_ns"),
    [(10_000_000, 0), (70_000_000, -700_000_000), (SECOND, SECOND), (20_000_000, -1_400_000_000)],
)
def test_handing_over_changes_no_bit(case: tuple[str, float], imu_ns: int, lead_ns: int) -> None:
    """What is stored and what is new are weighed at their stamps, not when samples arrive.

    The odometer is late by no more than odom_timeout_s less what the longest epoch is longer.
    """
    stored, run = stored_and_next(*case)
    expected = resume_drive(run, stored)
    session = Session(replace(config_of(run, **FIRST), initial=stored))
    found = [u for part in hand_over(run, imu_ns, lead_ns, session) for u in part]
    assert_same_bits(session, found, expected)


@settings(max_examples=6, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    st.lists(st.integers(0, 7500), max_size=20),
    st.lists(st.floats(-1.4, 1.0), min_size=22, max_size=22),
    st.lists(st.booleans(), min_size=22, max_size=22),
)
def test_any_pieces_and_asking_change_no_bit(
    cuts: list[int], leads_s: list[float], ask: list[bool]
) -> None:
    stored, run = stored_and_next("fog", 1.0 * DEG)
    expected = resume_drive(run, stored)
    pieces = Session(replace(config_of(run, **FIRST), initial=stored))
    found: list[Update] = []
    given_ = 0
    edges = sorted({0, len(run.imu), *(c for c in cuts if c < len(run.imu))})
    for (a, b), lead_s, asked in zip(pairwise(edges), leads_s, ask, strict=False):
        for c in range(a, b, 50):
            d = min(c + 50, b)
            until = int(run.imu.stamp_ns[d - 1]) + round(lead_s * 1e9)
            known = max(given_, int(np.searchsorted(run.odometer.stamp_ns, until, "right")))
            found += pieces.add_odometer(run.odometer.select(slice(given_, known)))
            found += pieces.add_imu(run.imu.select(slice(c, d)))
            given_ = known
        if asked:
            before = bits(pieces.estimate)
            assert bits(pieces.conclusion) is not None and bits(pieces.estimate) == before
            assert pieces.eta_s >= 0.0 or math.isnan(pieces.eta_s)
    found += pieces.add_odometer(run.odometer.select(slice(given_, None)))
    assert_same_bits(pieces, found, expected)


def test_what_is_carried_is_given_out_to_the_last_sample() -> None:
    """With an odometer that is late: the steps wait for it, the attitude does not."""
    stored, run = stored_and_next("rlg", 2.0 * ARCMIN)
    session = Session(replace(config_of(run, **FIRST), initial=stored))
    session.add_odometer(run.odometer.select(run.odometer.stamp_ns < run.imu.stamp_ns[4000]))
    updates = session.add_imu(run.imu.select(slice(0, 4120)))
    estimate = session.estimate
    assert estimate is not None and estimate.odometer is not None
    assert estimate.stamp_ns == run.imu.stamp_ns[4119] > updates[-1].stamp_ns + SECOND
    assert nees(run, estimate) < 25.0
