"""Going on from a stored alignment: what is believed, what is refused, how honest sigma stays.

Every case is a pair of runs: the first one aligns and leaves its result document, the second
one, with other noise, starts from it.
"""

from __future__ import annotations

import functools
import json
import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from odo_sessions import bits, config_of, hand_over, misalignment, trace
from scipy.stats import chi2

from evidence.monte_carlo import make_config, misalignment_of
from sins_align.config import OdoConfig, SwingConfig
from sins_align.earth import GRAVITY_EQUATOR
from sins_align.intake import Intake
from sins_align.reasons import GYRO_NOISY, LATITUDE_DOUBTED, STORED_DROPPED, Finding
from sins_align.resume import AGREEMENT_LIMIT, ResumingAligner
from sins_align.ros.result import Timing, result_document, result_text
from sins_align.rotation import exp_rotation, quaternion_from_dcm
from sins_align.session import Session
from sins_align.simulate import (
    SwingOptions,
    SwingRun,
    ThreeAxisSwing,
    VehicleOptions,
    VehicleRun,
    simulate_swing,
    simulate_vehicle,
    vehicle_route,
)
from sins_align.stored import StoredAlignment, stored_alignment
from sins_align.stored_check import CHECK_S, CHI_SQUARE_LIMIT, DEGREES
from sins_align.types import (
    Advance,
    Array,
    Estimate,
    ImuBlock,
    ImuSamples,
    InputCounts,
    State,
    Update,
)
from sins_align.units import ARCMIN, ARCSEC, DEG, DEG_PER_H

SECOND = 1_000_000_000
# So that every grade gets there in a run that is short.
FIRST = {"heading_threshold_arcmin": 400.0, "level_threshold_arcsec": 400.0, "hold_s": 2.0}
STILL = SwingOptions(scenario="still", rate_hz=50.0, duration_s=150.0, heading_deg=30.0)
PAIRS, VEHICLES = 30, 8


def still(tilt_deg: float = 0.0, swing_deg: float = 0.0) -> ThreeAxisSwing:
    return ThreeAxisSwing("still", (0.0, tilt_deg, 0.0), (swing_deg,) * 3)


def document_of(node: str, session: Session) -> dict[str, Any]:
    """The result file, through its text."""
    text = result_text(result_document(node, session, session.conclusion, Timing()))
    document: dict[str, Any] = json.loads(text)
    return document


def first_run(options: SwingOptions, **parameters: Any) -> tuple[SwingRun, StoredAlignment]:
    run = simulate_swing(options)
    session = Session(make_config(run, {**FIRST, **parameters}))
    session.add_imu(run.imu)
    return run, stored_alignment(document_of("swing_align", session))


def with_biases_of(run: SwingRun, other: SwingRun) -> ImuSamples:
    """The samples of `run` as the sensors of `other` would have given them."""
    gyro = other.truth.gyro_bias_rad_s - run.truth.gyro_bias_rad_s
    accel = other.truth.accel_bias_m_s2 - run.truth.accel_bias_m_s2
    imu = run.imu
    return ImuSamples(imu.stamp_ns, imu.w_ib_b + gyro[:, None], imu.f_ib_b + accel[:, None])


def resume(
    config: SwingConfig | OdoConfig, stored: StoredAlignment, imu: ImuSamples
) -> tuple[Session, list[Update]]:
    session = Session(replace(config, initial=stored))
    return session, session.add_imu(imu)


def estimates_after_check(updates: list[Update], begin_ns: int) -> list[Estimate]:
    return [
        u.estimate
        for u in updates
        if u.estimate is not None and u.stamp_ns >= begin_ns + CHECK_S * SECOND
    ]


@dataclass(frozen=True)
class Pair:
    """The second run's estimate at its end, which the first one's attitude is carried to."""

    phi: Array
    covariance: Array
    stored: StoredAlignment
    consistency: float
    is_resumed: bool


def run_pair(options: SwingOptions, seed: int, *, same_sensors: bool) -> Pair:
    first, stored = first_run(replace(options, seed=seed))
    second = simulate_swing(replace(options, seed=seed + 1000, duration_s=45.0))
    imu = with_biases_of(second, first) if same_sensors else second.imu
    session, _ = resume(make_config(second, FIRST), stored, imu)
    estimate = session.estimate
    assert estimate is not None
    return Pair(
        misalignment_of(estimate, second.truth.C_nb_at(estimate.stamp_ns)),
        estimate.misalignment_covariance,
        stored,
        estimate.consistency,
        estimate.misalignment_covariance[2, 2] < 1.01 * stored.misalignment_covariance[2, 2],
    )


@pytest.mark.parametrize("same_sensors", [True, False])
@pytest.mark.parametrize("grade", ["rlg", "tactical"])
def test_a_base_in_place_is_accepted_and_sigma_honest(grade: str, same_sensors: bool) -> None:
    options = replace(STILL, grade=grade)
    pairs = [run_pair(options, seed, same_sensors=same_sensors) for seed in range(PAIRS)]
    assert all(pair.is_resumed for pair in pairs)
    nees = [p.phi @ np.linalg.solve(p.covariance, p.phi) for p in pairs]
    low, high = chi2.ppf([0.0005, 0.9995], 3 * PAIRS) / PAIRS
    assert low < np.mean(nees) < high
    heading = [p.phi[2] ** 2 / p.covariance[2, 2] for p in pairs]
    low, high = chi2.ppf([0.0005, 0.9995], PAIRS) / PAIRS
    assert low < np.mean(heading) < high
    # The check itself: with other biases as many as declared, with the same ones fewer.
    square = np.array([pair.consistency for pair in pairs]) * CHI_SQUARE_LIMIT
    low, high = chi2.ppf([0.0005, 0.9995], DEGREES * PAIRS) / PAIRS
    assert square.mean() < high
    assert same_sensors or square.mean() > low


def test_limits_are_the_quantiles_that_they_claim() -> None:
    assert chi2.sf(CHI_SQUARE_LIMIT, DEGREES) == pytest.approx(1e-4, rel=0.01)
    assert chi2.sf(AGREEMENT_LIMIT, 3) == pytest.approx(1e-5, rel=0.01)


def test_heading_is_no_better_than_before() -> None:
    """Two alignments with one bias are no better than one: no sigma / sqrt(2)."""
    pair = run_pair(replace(STILL, grade="rlg"), 3, same_sensors=True)
    assert pair.covariance[2, 2] > 0.999 * pair.stored.misalignment_covariance[2, 2]


@pytest.fixture(scope="module")
def rlg() -> tuple[SwingRun, StoredAlignment]:
    return first_run(replace(STILL, grade="rlg", seed=5, duration_s=300.0))


def second_run(**changes: Any) -> SwingRun:
    return simulate_swing(replace(STILL, grade="rlg", seed=1005, duration_s=60.0, **changes))


def test_aligned_in_no_time(rlg: tuple[SwingRun, StoredAlignment]) -> None:
    run = second_run()
    parameters = {"heading_threshold_arcmin": 1.5, "hold_s": 5.0}
    session, updates = resume(make_config(run, parameters), rlg[1], run.imu)
    assert session.status.state is State.ALIGNED
    assert session.status.aligned_at_s == pytest.approx(CHECK_S + 5.0, abs=1.5)
    fresh = Session(make_config(run, parameters))
    fresh.add_imu(run.imu)
    assert fresh.status.state is not State.ALIGNED
    checking = [u.status.reason for u in updates if u.stamp_ns < run.imu.stamp_ns[0] + 25 * SECOND]
    assert all("checking the stored alignment" in reason for reason in checking)
    assert "of 30 s)" in checking[-1]


def test_nothing_of_it_is_given_out_before_the_check_is_done(
    rlg: tuple[SwingRun, StoredAlignment],
) -> None:
    run = second_run()
    fresh = Session(make_config(run, FIRST))
    begin = run.imu.select(slice(0, 50 * 29))
    _, updates = resume(make_config(run, FIRST), rlg[1], begin)
    for mine, other in zip(updates, fresh.add_imu(begin), strict=True):
        assert (mine.estimate is None) == (other.estimate is None)
        if mine.estimate is not None and other.estimate is not None:
            assert (mine.estimate.q_nb == other.estimate.q_nb).all()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"heading_deg": 31.0}, "the Earth's rate differs"),
        ({"heading_deg": 210.0}, "the Earth's rate differs"),
        ({"scenario": still(tilt_deg=0.1)}, "gravity differs by 6.1'"),
        ({"scenario": still(swing_deg=0.2)}, "the base moves too much"),
        ({"turn_deg": 90.0, "turn_start_s": 5.0}, "the base moves too much"),
        ({"turn_deg": 9.0, "turn_start_s": 0.0, "turn_duration_s": 59.0}, "stored alignment"),
    ],
)
def test_a_base_that_has_moved_is_refused(
    changes: dict[str, Any], words: str, rlg: tuple[SwingRun, StoredAlignment]
) -> None:
    """And the alignment goes on as if nothing had been stored, but says why."""
    run = second_run(**changes)
    config = make_config(run, {"heading_threshold_arcmin": 0.1})
    session, _ = resume(config, rlg[1], run.imu)
    assert words in session.status.reason
    assert "clear initial_result_file" in session.status.remedy
    fresh = Session(config)
    fresh.add_imu(run.imu)
    mine, other = session.conclusion, fresh.conclusion
    assert mine is not None and other is not None
    assert (mine.q_nb == other.q_nb).all()
    assert (mine.misalignment_covariance == other.misalignment_covariance).all()


def test_a_turn_too_small_for_the_check_is_found_when_it_can_be(
    rlg: tuple[SwingRun, StoredAlignment],
) -> None:
    """10' are eight sigma of the stored heading, but four of the Earth's rate in 30 s."""
    run = simulate_swing(
        replace(STILL, grade="rlg", seed=1005, duration_s=300.0, heading_deg=30.0 + 10.0 / 60.0)
    )
    session, updates = resume(make_config(run, {"heading_threshold_arcmin": 0.1}), rlg[1], run.imu)
    given = estimates_after_check(updates, int(run.imu.stamp_ns[0]))
    assert given[0].misalignment_covariance[2, 2] < (2.0 * ARCMIN) ** 2  # believed at first
    assert "the new one differs by" in session.status.reason
    estimate = session.conclusion
    assert estimate is not None
    phi = misalignment_of(estimate, run.truth.C_nb_at(estimate.stamp_ns))
    assert abs(phi[2]) < 4.0 * estimate.sigma[2]


def test_a_gentle_sway_is_taken_for_part_of_sigma(
    rlg: tuple[SwingRun, StoredAlignment],
) -> None:
    sway = 10.0 * ARCSEC
    run = second_run(scenario=still(swing_deg=sway * math.sqrt(2.0) / DEG), lever_arm_m=(0, 0, 0))
    session, _ = resume(make_config(run, {}), rlg[1], run.imu)
    estimate = session.estimate
    assert estimate is not None
    grown = estimate.misalignment_covariance - rlg[1].misalignment_covariance
    assert math.sqrt(grown[2, 2]) == pytest.approx(sway, rel=0.15)
    level = make_config(run, {}).grade.accel_bias / GRAVITY_EQUATOR
    assert estimate.sigma[:2] == pytest.approx(level, rel=0.2)
    phi = misalignment_of(estimate, run.truth.C_nb_at(estimate.stamp_ns))
    assert (np.abs(phi) < 4.0 * estimate.sigma).all()


WIND = {"scenario": still(swing_deg=2.8 / 60.0), "lever_arm_m": (0.0, 0.0, 0.0)}  # 2' rms


def test_in_the_wind_heading_is_the_stored_one_and_the_levels_are_new() -> None:
    squares = []
    for seed in range(VEHICLES):
        options = replace(STILL, grade="rlg", **WIND)
        _, stored = first_run(replace(options, seed=seed))
        run = simulate_swing(replace(options, seed=seed + 1000, duration_s=45.0))
        session, _ = resume(make_config(run, {}), stored, run.imu)
        estimate = session.estimate
        assert estimate is not None
        before = math.sqrt(stored.misalignment_covariance[2, 2])
        assert estimate.sigma[2] < math.hypot(before, 2.2 * ARCMIN)  # and the sway's
        assert estimate.sigma[:2].max() < 6.0 * ARCSEC
        phi = misalignment_of(estimate, run.truth.C_nb_at(estimate.stamp_ns))
        squares.append(phi @ np.linalg.solve(estimate.misalignment_covariance, phi))
    low, high = chi2.ppf([0.0005, 0.9995], 3 * VEHICLES) / VEHICLES
    assert low < np.mean(squares) < high


@pytest.mark.parametrize("heading_deg", [28.0, 31.5, 75.0, 210.0])
def test_in_the_wind_a_turn_is_not_believed(
    heading_deg: float, rlg: tuple[SwingRun, StoredAlignment]
) -> None:
    run = second_run(heading_deg=heading_deg, **WIND)
    _, updates = resume(make_config(run, {}), rlg[1], run.imu)
    for estimate in estimates_after_check(updates, int(run.imu.stamp_ns[0])):
        phi = misalignment_of(estimate, run.truth.C_nb_at(estimate.stamp_ns))
        assert abs(phi[2]) < 5.0 * estimate.sigma[2]


def test_where_the_rate_is_not_seen_the_new_alignment_has_to_agree(
    rlg: tuple[SwingRun, StoredAlignment],
) -> None:
    """Accelerometers that shake: neither they nor the gyros tell the drift in a sway."""
    run = second_run(**WIND)
    shaken = np.random.default_rng(1).normal(0.0, 0.02, run.imu.f_ib_b.shape)
    imu = ImuSamples(run.imu.stamp_ns, run.imu.w_ib_b, run.imu.f_ib_b + shaken)
    session, updates = resume(make_config(run, {}), rlg[1], imu)
    assert "the new heading is not known to 0.5 deg" in session.status.reason
    for estimate in estimates_after_check(updates, int(run.imu.stamp_ns[0])):
        assert estimate.sigma[2] > 10.0 * ARCMIN


def known(run: SwingRun, sigma: float, turned: Array | None = None) -> StoredAlignment:
    """A stored alignment at the attitude of a base without motion, turned by a misalignment."""
    C_nb = run.truth.C_nb_at(int(run.imu.stamp_ns[0]))
    if turned is not None:
        C_nb = exp_rotation(-turned) @ C_nb
    return StoredAlignment(quaternion_from_dcm(C_nb), np.diag([ARCSEC**2, ARCSEC**2, sigma**2]))


def test_a_slow_tilt_is_not_taken_for_a_rate_of_the_gyros() -> None:
    """Up to 4 deg/h about a level axis for all of the check, which the force does not show."""
    slow = ThreeAxisSwing("slow", (0.0, 0.0, 0.0), (0.0, 1.0 / 6.0, 0.0), (0.1, 0.001, 0.1))
    for seed in range(1000, 1006):
        options = replace(STILL, grade="rlg", seed=seed, duration_s=40.0, scenario=slow)
        run = simulate_swing(replace(options, lever_arm_m=(0.0, 0.0, 0.0)))
        session, _ = resume(make_config(run, {}), known(run, ARCMIN), run.imu)
        assert "does not fit" not in session.status.reason


def test_the_stored_attitude_is_the_mean_of_the_sway_and_follows_it() -> None:
    perfect = replace(STILL, grade="perfect", duration_s=60.0, lever_arm_m=(0.0, 0.0, 0.0))
    stored = known(simulate_swing(perfect), ARCMIN)
    run = simulate_swing(replace(perfect, scenario=still(swing_deg=15.0 * ARCSEC / DEG)))
    session = Session(replace(make_config(run, {}), initial=stored))
    worst = np.zeros(3)
    for chunk in run.chunks(0.5):
        session.add_imu(chunk)
        estimate = session.estimate
        if estimate is not None and chunk.stamp_ns[-1] > run.imu.stamp_ns[0] + 32 * SECOND:
            phi = misalignment_of(estimate, run.truth.C_nb_at(estimate.stamp_ns))
            worst = np.maximum(worst, np.abs(phi))
    assert 0.0 < worst.max() < 2.0 * ARCSEC


def test_a_wrong_heading_and_the_bias_found_with_it_cancel_on_a_base_that_stands() -> None:
    """The Earth's rate about a wrong north would tilt the levels by 1.5' in 300 s."""
    run = simulate_swing(replace(STILL, grade="perfect", rate_hz=20.0, duration_s=330.0))
    phi = np.array([0.0, 0.0, 1.0 * DEG])
    config = make_config(run, {"gyro_bias_deg_h": 10.0})
    session, _ = resume(config, known(run, 1.0 * DEG, phi), run.imu)
    estimate = session.estimate
    assert estimate is not None
    found = misalignment_of(estimate, run.truth.C_nb_at(estimate.stamp_ns))
    assert found == pytest.approx(phi, abs=2.0 * ARCSEC)
    assert estimate.sigma[:2] == pytest.approx(ARCSEC, abs=2.0 * ARCSEC)
    assert estimate.gyro_bias_sigma.max() > 0.1 * DEG_PER_H


def test_a_gyro_bias_is_no_tilt() -> None:
    """5 deg/h turn the axes of the gyros by 150" over the check, of levels known to 1"."""
    run = simulate_swing(replace(STILL, grade="perfect", rate_hz=20.0, duration_s=40.0))
    w = run.imu.w_ib_b + np.array([5.0 * DEG_PER_H, 0.0, 0.0])[:, None]
    config = make_config(run, {"gyro_bias_deg_h": 5.0})
    session, _ = resume(config, known(run, ARCMIN), ImuSamples(run.imu.stamp_ns, w, run.imu.f_ib_b))
    assert "stored_dropped" not in session.status.keys
    estimate = session.estimate
    assert estimate is not None
    assert estimate.gyro_bias[0] == pytest.approx(5.0 * DEG_PER_H, rel=0.01)


def test_the_new_alignment_takes_over_for_good_when_it_is_better() -> None:
    """A first run of 60 s of a gyro with more noise than bias: 120 s know better."""
    first, stored = first_run(replace(STILL, grade="rlg", seed=8, duration_s=60.0))
    run = simulate_swing(replace(STILL, grade="rlg", seed=1008, duration_s=200.0))
    session, updates = resume(make_config(run, FIRST), stored, with_biases_of(run, first))
    given = estimates_after_check(updates, int(run.imu.stamp_ns[0]))
    sigma = np.array([estimate.sigma[2] for estimate in given])
    assert sigma[-1] < 0.8 * math.sqrt(stored.misalignment_covariance[2, 2])
    assert (np.diff(sigma) <= 1e-3 * sigma[:-1]).all()  # never back to the stored one
    fresh = Session(make_config(run, FIRST))
    fresh.add_imu(with_biases_of(run, first))
    mine, other = session.conclusion, fresh.conclusion
    assert mine is not None and other is not None
    assert (mine.q_nb == other.q_nb).all()


def test_how_samples_come_changes_nothing(rlg: tuple[SwingRun, StoredAlignment]) -> None:
    run = second_run()
    whole, _ = resume(make_config(run, {}), rlg[1], run.imu)
    pieces = Session(replace(make_config(run, {}), initial=rlg[1]))
    for chunk in run.chunks(0.37):
        pieces.add_imu(chunk)
        assert pieces.estimate is None or np.isfinite(pieces.estimate.q_nb).all()
    a, b = whole.estimate, pieces.estimate
    assert a is not None and b is not None
    assert (a.q_nb == b.q_nb).all()
    assert (a.misalignment_covariance == b.misalignment_covariance).all()
    assert a.stamp_ns == run.imu.stamp_ns[-1]


def said(updates: list[Update]) -> list[str]:
    """What is said of the dropped alignment, by update."""
    return [
        "; ".join(f.text for f in u.status.findings if f.reason is STORED_DROPPED) for u in updates
    ]


def assert_said_until_there_is_an_estimate(updates: list[Update], why: str) -> None:
    first = next(k for k, u in enumerate(updates) if u.estimate is not None)
    assert first > 0
    words = f"the stored alignment is dropped: the alignment began anew: {why}"
    assert said(updates[:first]) == [words] * first
    assert set(said(updates[first:])) == {""}


def test_a_restart_drops_it(rlg: tuple[SwingRun, StoredAlignment]) -> None:
    """Nobody has seen whether the base has moved meanwhile."""
    run = second_run()
    session, _ = resume(make_config(run, {}), rlg[1], run.imu.select(slice(0, 50 * 20)))
    session.restart()
    assert session.status.keys == ("no_imu", "began_anew", "stored_dropped")
    updates = session.add_imu(run.imu.select(slice(50 * 20, None)))
    assert_said_until_there_is_an_estimate(updates, "restarted on request")
    estimate = session.estimate
    assert estimate is not None
    assert estimate.sigma[2] > 2.0 * ARCMIN
    session.restart()  # there is nothing left to drop
    assert "stored_dropped" not in session.status.keys


@pytest.mark.parametrize("at_s", [10, 40])
def test_a_gap_drops_it(at_s: int, rlg: tuple[SwingRun, StoredAlignment]) -> None:
    run = second_run()
    gap = run.imu.select(np.r_[0 : 50 * at_s, 50 * (at_s + 2) : len(run.imu)])
    session, updates = resume(make_config(run, {}), rlg[1], gap)
    assert session.restarts == 1
    later = [u for u in updates if u.stamp_ns > run.imu.stamp_ns[50 * at_s]]
    assert_said_until_there_is_an_estimate(later, "2.0 s without IMU data")


def test_a_fault_drops_it(rlg: tuple[SwingRun, StoredAlignment]) -> None:
    run = second_run()
    f = run.imu.f_ib_b.copy()
    f[:, 50 * 20 : 50 * 21] = 0.0
    imu = ImuSamples(run.imu.stamp_ns, run.imu.w_ib_b, f)
    _, updates = resume(make_config(run, {}), rlg[1], imu)
    failed = next(k for k, u in enumerate(updates) if u.status.state is State.FAILED)
    fault = updates[failed].status.findings[0].text
    assert_said_until_there_is_an_estimate(updates[failed:], fault)


def test_the_method_of_the_paper_resumes_too(rlg: tuple[SwingRun, StoredAlignment]) -> None:
    run = second_run()
    session, _ = resume(make_config(run, {"method": "paper"}), rlg[1], run.imu)
    estimate = session.conclusion
    assert estimate is not None
    assert estimate.sigma[2] < 2.0 * ARCMIN


# ---------------------------------------------------------------- a vehicle


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


def test_gyros_that_become_noisy_are_doubted_while_the_stored_one_is_given_out() -> None:
    """It is the gyros that carry it; what is known of them does not wait for the new one."""
    run = simulate_swing(replace(STILL, grade="rlg", duration_s=240.0))
    attitude = quaternion_from_dcm(run.truth.C_nb_at(int(run.imu.stamp_ns[0])))
    sigma = np.array([20.0 * ARCSEC, 20.0 * ARCSEC, 0.8 * ARCMIN])
    stored = StoredAlignment(attitude, np.diag(sigma**2))
    config = make_config(run, {"imu_grade": "rlg"})
    # Eight times the declared noise, from a minute on.
    white = np.random.default_rng(1).standard_normal(run.imu.w_ib_b.shape)
    white[:, : 60 * 50] = 0.0
    w = run.imu.w_ib_b + 8.0 * config.grade.gyro_arw * math.sqrt(50.0) * white
    imu = ImuSamples(run.imu.stamp_ns, w, run.imu.f_ib_b)
    _, updates = resume(config, stored, imu)
    early = [u for u in updates if 45.0 < u.status.elapsed_s < 60.0]
    assert {u.status.state for u in early} == {State.ALIGNED}
    noisy = [u for u in updates if "gyro_noisy" in u.status.keys]
    assert State.ALIGNED not in {u.status.state for u in noisy}
    assert noisy[0].status.keys == ("gyro_noisy",) and noisy[0].estimate is not None
    assert noisy[0].estimate.sigma[2] < 0.85 * ARCMIN  # the stored one's
    assert updates[-1] is noisy[-1]


@pytest.mark.parametrize("seed", [2, 5, 7])
def test_a_new_one_in_doubt_does_not_drop_it(seed: int) -> None:
    """Gyros at ten times the declared noise from a minute on: the new one is off by six sigma."""
    run = simulate_swing(replace(STILL, grade="rlg", duration_s=210.0, seed=seed))
    config = make_config(run, {"imu_grade": "rlg"})
    white = np.random.default_rng(seed).standard_normal(run.imu.w_ib_b.shape)
    white[:, : 60 * 50] = 0.0
    w = run.imu.w_ib_b + 10.0 * config.grade.gyro_arw * math.sqrt(50.0) * white
    imu = ImuSamples(run.imu.stamp_ns, w, run.imu.f_ib_b)
    session, updates = resume(config, known(run, 0.8 * ARCMIN), imu)
    assert set(said(updates)) == {""}
    estimate = session.conclusion
    assert estimate is not None and estimate.sigma[2] < 0.85 * ARCMIN
    phi = misalignment_of(estimate, run.truth.C_nb_at(estimate.stamp_ns))
    assert abs(phi[2]) < 3.0 * estimate.sigma[2]  # the levels drift off, by gyros that are worse
    assert session.status.state is not State.ALIGNED


class Told:
    """An aligner that says the same at every block."""

    def __init__(self, run: SwingRun, phi: Array, sigma: float, *said: Finding, **changes: Any):
        C_nb = exp_rotation(-phi) @ run.truth.C_nb_at(int(run.imu.stamp_ns[0]))
        P, zero = np.diag([ARCMIN**2 * 100.0, ARCMIN**2 * 100.0, sigma**2]), np.zeros(3)
        rest = {"consistency": 1.0, **changes}
        self.estimate = Estimate(0, quaternion_from_dcm(C_nb), P, zero, zero, zero, zero, **rest)
        self.said = said

    def update(self, block: ImuBlock) -> list[Advance]:
        return [Advance(int(block.stamp_ns[-1]), self.estimate, self.said)]


DOUBTED: dict[str, tuple[tuple[Finding, ...], dict[str, Any]]] = {
    "a doubt": ((GYRO_NOISY(factor=4.0, log_ratio=9.0),), {}),
    "the latitude": ((LATITUDE_DOUBTED(ratio=4.0, sigma_deg=0.1),), {}),
    "inconsistent": ((), {"consistency": 3.0}),
    "no innovation yet": ((), {"consistency": math.nan}),
    "not finite": ((), {"q_nb": np.full(4, math.nan)}),
}


@pytest.mark.parametrize("case", ["", *DOUBTED])
def test_what_is_in_doubt_says_nothing(case: str) -> None:
    """Of a heading that waits to be confirmed: unless it is in doubt, one confirms, one drops."""
    run = second_run(**WIND)
    shaken = np.random.default_rng(1).normal(0.0, 0.02, run.imu.f_ib_b.shape)
    config, stored = make_config(run, {}), known(run, 2.0 * ARCMIN)
    assert config.position is not None
    findings, changes = DOUBTED.get(case, ((), {}))
    for turned, sigma in ((0.0, 0.2 * DEG), (10.0 * DEG, 0.2 * DEG), (0.0, 0.1 * ARCMIN)):
        told = Told(run, np.array([0.0, 0.0, turned]), sigma, *findings)
        told.estimate = replace(told.estimate, **changes)
        aligner = ResumingAligner(told, config, config.position, stored)  # type: ignore[arg-type]
        intake = Intake(InputCounts())
        intake.add(ImuSamples(run.imu.stamp_ns, run.imu.w_ib_b, run.imu.f_ib_b + shaken))
        steps: list[Advance] = []
        while (block := intake.next_block()) is not None:
            steps += aligner.update(block)
        keys = [f.reason.key for f in steps[-1].findings if f not in findings]
        if case:
            assert keys == ["stored_confirm"]
            continue
        assert keys == (["stored_dropped"] if turned else [])
        is_stored = steps[-1].estimate is not told.estimate
        assert is_stored == (turned == 0.0 and sigma > ARCMIN)
