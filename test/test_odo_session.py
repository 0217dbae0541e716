"""A vehicle from IMU and odometer to heading, through the session: accuracy, honesty of sigma,
bits, and all that an odometer, an IMU and a clock may do. Long runs are `make evidence`."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from odo_sessions import bits, hand_over, trace, vehicle
from scipy.stats import chi2

from evidence.monte_carlo import misalignment_of
from evidence.odo_data import (
    DATA,
    KINGSTON,
    LASERGYRO,
    LASERGYRO_HEADING_DEG,
    align_recording,
    heading_of,
    kingston_config,
    kingston_heading,
    lasergyro_config,
    read_recording,
    window,
    wrap,
)
from evidence.odo_figures import heading_errors
from evidence.odo_recording import Start
from evidence.odo_runs import Drive, drive, make_config
from sins_align.config import OdoConfig
from sins_align.limits import heading_limit
from sins_align.odo.standing import StandingDetector
from sins_align.session import Session
from sins_align.simulate import VehicleOptions, VehicleRun
from sins_align.soundness import is_sound
from sins_align.types import Estimate, ImuSamples, OdometerSamples, Position, State, Update
from sins_align.units import ARCMIN, DEG

SECOND = 1_000_000_000
SEEDS = 8
# Most of all: beyond this no error that belongs to its sigma is, in any of these tests.
MOST_SIGMA = 4.0

needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"there is no {DATA}")


def config_of(run: VehicleRun, **parameters: Any) -> OdoConfig:
    return make_config(run.options, parameters)


def whole(run: VehicleRun, **parameters: Any) -> tuple[Session, list[Update]]:
    session = Session(config_of(run, **parameters))
    updates = session.add_odometer(run.odometer)
    return session, updates + session.add_imu(run.imu)


def ratio(run: VehicleRun, estimate: Estimate) -> float:
    """Heading error over its sigma."""
    phi = misalignment_of(estimate, run.truth.C_nb_at(estimate.stamp_ns))
    return abs(float(phi[2] / estimate.sigma[2]))


def assert_sound(run: VehicleRun, updates: Sequence[Update]) -> None:
    """Nothing is shown that is not fit to be, and no error that its sigma does not know of."""
    for update in updates:
        estimate = update.estimate
        if estimate is not None:
            assert is_sound(estimate)
            assert estimate.sigma[2] < 3.0 * DEG
            assert ratio(run, estimate) < MOST_SIGMA


# -- accuracy, and sigma


def assert_honest(drives: Sequence[Drive], at_s: int, margin: float = 2.5) -> None:
    """Two-sided 99.9 % bounds; `margin` for declared noise above the simulated one."""
    squares = [float((d.phi[at_s, 2] / d.sigma[at_s, 2]) ** 2) for d in drives]
    low, high = chi2.ppf([0.0005, 0.9995], len(drives)) / len(drives)
    assert low / margin < np.mean(squares) < high


@pytest.mark.parametrize(
    ("scenario", "times_s", "bounds"),
    [("ring", (70, 150), (60.0, 10.0)), ("urban", (70, 150), (60.0, 12.0)),
     ("moving_start", (100, 160), (60.0, 12.0)), ("static", (30, 150), (60.0, 12.0))],
)  # fmt: skip
def test_heading(scenario: str, times_s: tuple[int, int], bounds: tuple[float, float]) -> None:
    """Below a degree, then near its floor; no heading is known, or needed, to begin with."""
    drives = [
        drive(VehicleOptions(scenario=scenario, seed=k, rate_hz=100.0, duration_s=max(times_s)), {})
        for k in range(SEEDS)
    ]
    error = heading_errors(drives)
    for at_s, bound in zip(times_s, bounds, strict=True):
        assert math.sqrt((error[:, at_s] ** 2).mean()) < bound
        assert_honest(drives, at_s)
        shown = np.array([d.published[at_s] for d in drives])
        assert shown.mean() > 0.8
    levels = np.array([d.phi[-1, :2] for d in drives]) / ARCMIN
    assert math.sqrt((levels**2).mean()) < (0.15 if scenario in ("ring", "urban") else 0.6)
    if scenario != "static":
        assert max(abs(d.scale_error[-1]) for d in drives) < 0.002


def test_sigma_of_a_vehicle_that_stands_is_that_of_theory() -> None:
    run = vehicle("static", 300.0, rate_hz=50.0)
    session, updates = whole(run)
    assert_sound(run, updates)
    assert session.estimate is not None
    limit = heading_limit(run.options.imu_grade, run.options.latitude_deg * DEG)
    assert session.estimate.sigma[2] == pytest.approx(limit, rel=0.1)


def test_the_heading_it_begins_with_is_a_choice_of_axes() -> None:
    options = VehicleOptions(scenario="static", rate_hz=100.0, duration_s=40.0, seed=1)
    curves = [drive(options, {}, Start(w)).phi[5:, 2] for w in (5.0, -65.0, -125.0, 180.0)]
    for curve in curves[1:]:
        np.testing.assert_allclose(curve, curves[0], atol=1e-3 * ARCMIN)
    assert abs(curves[0][-1]) < 60.0 * ARCMIN


def test_wander_ekf() -> None:
    run = vehicle("ring", 180.0, seed=4)
    session, updates = whole(run, method="wander_ekf")
    assert session.estimate is not None
    assert_sound(run, updates)
    assert session.estimate.sigma[2] < 15.0 * ARCMIN


def test_aligned_is_claimed_when_sigma_is_below_the_thresholds_and_not_before() -> None:
    run = vehicle("ring", 130.0)
    limits = {"heading_threshold_arcmin": 30.0, "level_threshold_arcsec": 60.0, "hold_s": 3.0}
    session, updates = whole(run, **limits)
    assert session.status.state is State.ALIGNED
    for update in updates:
        if update.status.state is State.ALIGNED:
            assert update.estimate is not None
            assert update.estimate.sigma[2] < 30.0 * ARCMIN
            assert (update.estimate.sigma[:2] < ARCMIN).all()


# -- the same samples, the same bits


MESSY = {
    "odometer_latency_s": 0.1,
    "odometer_jitter_s": 0.005,
    "stamp_jitter_s": 1e-4,
    "outlier_fraction": 0.01,
    "lost_fraction": 0.01,
    "odometer_report_variance": True,
    "dropouts": ((40.0, 6.0),),
}


# Stamps that jitter are told with gyros as good as that.
GOOD_GYROS = {**MESSY, "grade": "rlg"}


@pytest.mark.parametrize("changes", [{}, MESSY, GOOD_GYROS], ids=["clean", "messy", "good gyros"])
@pytest.mark.parametrize(
    ("imu_ns", "lead_ns"),
    [(10_000_000, 0), (10_000_000, SECOND), (10_000_000, -SECOND), (70_000_000, -300_000_000),
     (SECOND, 0), (5 * SECOND, SECOND), (20_000_000, -1_500_000_000)],
)  # fmt: skip
def test_handing_over_changes_no_bit(changes: dict[str, Any], imu_ns: int, lead_ns: int) -> None:
    """One by one, by the second, the odometer early, or late by less than odom_timeout_s: the
    prefilter looks at some samples more."""
    run = vehicle("urban", 75.0, **changes)
    session, expected = whole(run)
    pieces = Session(config_of(run))
    found = [update for part in hand_over(run, imu_ns, lead_ns, pieces) for update in part]
    assert trace(found) == trace(expected)
    assert bits(pieces.estimate) == bits(session.estimate) != ()
    assert bits(pieces.conclusion) == bits(session.conclusion)
    assert pieces.counts == session.counts
    assert pieces.status == session.status


@settings(max_examples=6, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    st.lists(st.integers(0, 7500), max_size=20),
    st.lists(st.floats(-1.5, 1.0), min_size=22, max_size=22),
    st.lists(st.booleans(), min_size=22, max_size=22),
)
def test_any_pieces_and_asking_change_no_bit(
    cuts: list[int], leads_s: list[float], ask: list[bool]
) -> None:
    run = vehicle("urban", 75.0, **MESSY)
    session, expected = whole(run)
    pieces = Session(config_of(run))
    found: list[Update] = []
    given_ = 0
    stamps = run.odometer.stamp_ns
    edges = sorted({0, len(run.imu), *(c for c in cuts if c < len(run.imu))})
    for (a, b), lead_s, asked in zip(pairwise(edges), leads_s, ask, strict=False):
        # The odometer is no later than that, whatever the pieces of the IMU.
        for c in range(a, b, 50):
            d = min(c + 50, b)
            until = int(run.imu.stamp_ns[d - 1]) + round(lead_s * 1e9)
            known = max(given_, int(np.searchsorted(stamps, until, "right")))
            found += pieces.add_odometer(run.odometer.select(slice(given_, known)))
            found += pieces.add_imu(run.imu.select(slice(c, d)))
            given_ = known
        if asked:
            before = bits(pieces.estimate)
            assert bits(pieces.conclusion) == before == bits(pieces.estimate)
    found += pieces.add_odometer(run.odometer.select(slice(given_, None)))
    assert trace(found) == trace(expected)
    assert bits(pieces.estimate) == bits(session.estimate)


# -- odometers


ODOMETERS: dict[str, dict[str, Any]] = {
    "slips": {"slip_count": 4},
    "outliers": {"outlier_fraction": 0.02},
    "stuck": {"stuck": ((70.0, 20.0),)},
    "dropout": {"dropouts": ((70.0, 20.0),)},
    "scale step": {"scale_step": (90.0, 0.02)},
    "latency, lever arm, mounting": {
        "odometer_latency_s": 0.1,
        "odometer_lever_arm_m": (1.2, -0.3, 0.5),
        "mounting_rpy_deg": (0.0, 0.3, 0.3),
    },
    "1 Hz": {"odometer_rate_hz": 1.0},
    "coarse counts": {"odometer_quantum_m": 0.1},
    "IMU loses samples": {"lost_fraction": 0.01},
    "clock drifts": {"odometer_clock_drift": 1e-4},
}


@pytest.mark.parametrize("name", ODOMETERS)
def test_odometer_that_is_not_what_was_declared(name: str) -> None:
    run = vehicle("ring", 150.0, **ODOMETERS[name])
    session, updates = whole(run)
    assert_sound(run, updates)
    assert session.restarts == 0
    estimate = session.estimate
    assert estimate is not None
    assert estimate.sigma[2] < 60.0 * ARCMIN


def test_scale_step_is_found() -> None:
    run = vehicle("ring", 125.0, scale_step=(100.0, 0.02))
    _, updates = whole(run)
    found = {
        round((u.stamp_ns - run.options.start_stamp_ns) / SECOND): u.estimate.odometer.scale_error
        for u in updates
        if u.estimate is not None and u.estimate.odometer is not None
    }
    before = run.truth.odometer_scale_error
    after = (1.0 + before) * 1.02 - 1.0
    assert found[max(t for t in found if t < 100)] == pytest.approx(before, abs=0.004)
    assert found[max(t for t in found if t <= 115)] == pytest.approx(after, abs=0.004)


@pytest.mark.parametrize("at", [2, 10, 35, 60])
@pytest.mark.parametrize("speed", [-4.7, 3.0, 30.0])
def test_an_outlier_before_the_vehicle_moves(at: int, speed: float) -> None:
    """Where little is known yet of the odometer, and the levels and the velocity come from it."""
    run = vehicle("ring", 110.0, seed=27)
    samples = OdometerSamples(*(x.copy() for x in run.odometer))
    samples.speed[at] = speed
    session = Session(config_of(run))
    updates = session.add_odometer(samples) + session.add_imu(run.imu)
    assert_sound(run, updates)
    assert session.estimate is not None
    assert session.estimate.sigma[2] < 30.0 * ARCMIN


def test_reversing_with_a_signed_odometer() -> None:
    run = vehicle("reverse", 185.0)
    assert run.odometer.speed.min() < -2.0
    session, updates = whole(run)
    assert_sound(run, updates)
    assert session.estimate is not None


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e6])
def test_nonsense_of_the_odometer_is_refused(value: float) -> None:
    run = vehicle("urban", 75.0)
    places = [0, 1, 300, 301, 900]
    extra = OdometerSamples(*(np.insert(x, places, x[places]) for x in run.odometer))
    extra.speed[np.array(places) + np.arange(len(places))] = value
    session = Session(config_of(run))
    updates = session.add_odometer(extra) + session.add_imu(run.imu)
    expected, expected_updates = whole(run)
    assert trace(updates) == trace(expected_updates)
    assert session.counts.odom_rejected == len(places)
    assert session.counts.odom_samples == expected.counts.odom_samples


def test_without_an_odometer_the_status_says_so() -> None:
    run = vehicle("urban", 75.0)
    session = Session(config_of(run))
    half = len(run.imu) // 2
    updates = session.add_imu(run.imu.select(slice(0, half)))
    assert session.estimate is None
    assert all(u.estimate is None for u in updates)
    assert session.status.state is State.WAITING
    assert "no odometer" in session.status.reason
    assert "odom" in session.status.remedy
    # And goes on where there is one at last.
    session.add_odometer(run.odometer.select(run.odometer.stamp_ns > run.imu.stamp_ns[half]))
    updates = session.add_imu(run.imu.select(slice(half, None)))
    assert "no odometer" not in session.status.reason
    assert session.restarts == 0
    assert_sound(run, updates)


# -- standing


def judged(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, float, bool]]:
    """End [ns] and length [s] of the epochs, and whether the vehicle was taken as standing."""
    notes: list[tuple[int, float, bool]] = []
    note = StandingDetector.note

    def noted(self: StandingDetector, epoch: Any, standing: bool) -> None:
        notes.append((epoch.stamp_ns, epoch.duration_s, standing))
        note(self, epoch, standing)

    monkeypatch.setattr(StandingDetector, "note", noted)
    return notes


# Stops of an urban drive, without and with a silent odometer; an odometer that stands still
# while the vehicle does not.
@pytest.mark.parametrize(
    "changes",
    [{}, {"dropouts": tuple((float(t), 6.0) for t in range(20, 200, 12))},
     {"stuck": ((60.0, 20.0),)}, {"odometer_rate_hz": 1.0}],
    ids=["plain", "dropouts", "stuck", "1 Hz"],
)  # fmt: skip
@pytest.mark.parametrize("scenario", ["urban", "straight"])
def test_standing(monkeypatch: pytest.MonkeyPatch, scenario: str, changes: dict[str, Any]) -> None:
    notes = judged(monkeypatch)
    run = vehicle(scenario, 200.0, seed=11, **changes)
    _, updates = whole(run)
    stood = recognised = 0
    for end_ns, duration_s, standing in notes:
        begin_ns = end_ns - round(duration_s * 1e9)
        moved = np.abs(run.truth.speed_at(np.linspace(begin_ns, end_ns, 20).astype(np.int64)))
        way = moved.mean() * duration_s
        assert not (standing and way > 0.05), (end_ns - run.options.start_stamp_ns) * 1e-9
        if moved.max() == 0.0:
            stood += 1
            recognised += standing
    assert stood > (0 if scenario == "straight" else 8)
    if "stuck" not in changes:
        assert recognised >= (0.5 if changes else 0.8) * stood
    assert_sound(run, updates)


def test_standing_needs_no_odometer_that_speaks() -> None:
    """Silent after ten seconds: what it knew goes on."""
    run = vehicle("static", 150.0)
    silent = vehicle("static", 150.0, dropouts=((20.0, 200.0),))
    expected, _ = whole(run)
    session, updates = whole(silent)
    assert_sound(run, updates)
    assert session.estimate is not None and expected.estimate is not None
    assert session.estimate.sigma[2] == pytest.approx(expected.estimate.sigma[2], rel=0.05)


def test_stationary_without_an_odometer() -> None:
    run = vehicle("static", 150.0)
    session = Session(config_of(run, aiding="stationary"))
    updates = session.add_imu(run.imu)
    assert_sound(run, updates)
    assert session.estimate is not None
    assert session.estimate.odometer is None
    assert session.estimate.sigma[2] < 10.0 * ARCMIN
    assert session.counts.odom_samples == 0


# -- places, gaps and clocks


def test_heading_is_unobservable_near_the_pole() -> None:
    run = vehicle("static", 60.0, latitude_deg=89.9)
    session, updates = whole(run)
    assert all(u.estimate is None for u in updates)
    assert session.estimate is None and session.conclusion is None
    assert session.status.state is not State.ALIGNED
    assert session.status.keys == ("unobservable_here",)
    assert "take heading from elsewhere" in session.status.remedy


@pytest.mark.parametrize("latitude_deg", [-60.0, 0.0, 75.0])
def test_latitudes(latitude_deg: float) -> None:
    run = vehicle("ring", 180.0, latitude_deg=latitude_deg)
    session, updates = whole(run)
    assert_sound(run, updates)
    assert session.estimate is not None
    assert session.estimate.sigma[2] < 15.0 * ARCMIN / math.cos(latitude_deg * DEG)


def test_a_gap_of_the_imu_begins_anew_and_aligns_again() -> None:
    run = vehicle("ring", 260.0, rate_hz=50.0)
    elapsed = run.imu.stamp_ns - run.imu.stamp_ns[0]
    broken = run.imu.select((elapsed < 100 * SECOND) | (elapsed > 101 * SECOND))
    session = Session(config_of(run))
    # In step: what is ahead of the gap by more than ten seconds is not kept.
    pieces = hand_over(VehicleRun(broken, run.odometer, run.truth, run.options), SECOND, 0, session)
    updates = [update for piece in pieces for update in piece]
    assert_sound(run, updates)
    assert session.restarts == 1
    assert "without IMU data" in session.begin_reason
    gap = int(run.imu.stamp_ns[0]) + 100 * SECOND
    assert any(u.estimate is not None for u in updates if u.stamp_ns <= gap)
    again = [u for u in updates if u.stamp_ns > gap]
    assert again[0].estimate is None and again[-1].estimate is not None
    assert again[-1].estimate.sigma[2] < 20.0 * ARCMIN


def test_a_clock_set_back_begins_anew_and_aligns_again() -> None:
    """Both are played again, as a bag in a loop."""
    run = vehicle("static", 60.0)
    back = 100 * SECOND
    session = Session(config_of(run))
    session.add_odometer(run.odometer)
    session.add_imu(run.imu)
    assert session.estimate is not None
    imu = ImuSamples(run.imu.stamp_ns - back, run.imu.w_ib_b, run.imu.f_ib_b)
    odometer = OdometerSamples(run.odometer.stamp_ns - back, *run.odometer[1:])
    for _ in hand_over(VehicleRun(imu, odometer, run.truth, run.options), SECOND, 0, session):
        pass
    assert session.restarts == 1
    assert "jumped back" in session.begin_reason
    estimate = session.estimate
    assert estimate is not None
    assert estimate.stamp_ns == imu.stamp_ns[-1]
    phi = misalignment_of(estimate, run.truth.C_nb_at(estimate.stamp_ns + back))
    assert abs(phi[2] / estimate.sigma[2]) < MOST_SIGMA


def test_no_position_yet() -> None:
    run = vehicle("static", 60.0)
    session = Session(config_of(run, latitude_deg=math.nan))
    assert not session.add_odometer(run.odometer) and not session.add_imu(run.imu)
    assert session.estimate is None
    assert session.status.reason == "no latitude"


# -- real data


@needs_data
def test_kingston() -> None:
    """An IMU of 1 deg/h in a town, the speed of the on-board diagnostics: degrees."""
    pytest.importorskip("rosbags")
    recording = read_recording(KINGSTON)
    data = window(recording, 300.0, 600.0)
    session, updates = align_recording(data, kingston_config(recording.position))
    stamps = np.array([m.stamp_ns for m in session.moments])
    errors = wrap(np.array([heading_of(m) for m in session.moments]) - kingston_heading(stamps))
    for moment, error in zip(session.moments, errors, strict=True):
        sigma = math.sqrt(moment.covariance[2, 2])
        assert sigma > 2.0 * DEG or abs(error) < 2.5 * sigma
    assert abs(errors[-1]) < 2.5 * DEG
    assert session.moments[-1].scale[0] == pytest.approx(-0.01, abs=0.005)
    assert State.FAILED not in {u.status.state for u in updates}


@needs_data
def test_lasergyro() -> None:
    """A parked laser gyro, without an odometer, against eight established methods."""
    pytest.importorskip("rosbags")
    recording = read_recording(LASERGYRO)
    data = window(recording, 0.0, 300.0)
    session, updates = align_recording(data, lasergyro_config(recording.position))
    last = session.moments[-1]
    error = float(wrap(heading_of(last) - LASERGYRO_HEADING_DEG * DEG))
    assert abs(error) < 6.0 * ARCMIN
    assert abs(error) < 3.0 * math.sqrt(last.covariance[2, 2])
    assert updates[-1].estimate is not None
    assert updates[-1].estimate.odometer is None


def test_at_the_pole_itself() -> None:
    """Rounding must not carry the Earth's axis out of the sphere; and there is no heading."""
    run = vehicle("ring", 60.0)
    session = Session(dataclasses.replace(config_of(run), position=Position(0.5 * math.pi)))
    updates = session.add_odometer(run.odometer) + session.add_imu(run.imu)
    assert len(updates) > 50
    assert all(u.estimate is None for u in updates)
    assert session.estimate is None
    assert "pole" in session.status.reason or "unobservable" in session.status.reason
