"""A stored alignment on a base that sways: what of it is a tilt, and what a turn."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from resumed_runs import (
    SECOND,
    STILL,
    VEHICLES,
    WIND,
    estimates_after_check,
    first_run,
    known,
    resume,
    rlg_run,
    second_run,
    still,
)
from scipy.stats import chi2

from evidence.monte_carlo import make_config, misalignment_of
from sins_align.earth import GRAVITY_EQUATOR
from sins_align.session import Session
from sins_align.simulate import SwingRun, ThreeAxisSwing, simulate_swing
from sins_align.stored import StoredAlignment
from sins_align.types import ImuSamples
from sins_align.units import ARCMIN, ARCSEC, DEG, DEG_PER_H


@pytest.fixture(scope="module")
def rlg() -> tuple[SwingRun, StoredAlignment]:
    return rlg_run()


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
