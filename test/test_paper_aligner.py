"""The aligner of method `paper` on simulated swings."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator
from functools import lru_cache

import numpy as np
import pytest

from sins_align.config import PaperConfig, SwingConfig, swing_config
from sins_align.rotation import dcm_from_quaternion, exp_rotation, log_rotation, rpy_from_dcm
from sins_align.simulate import SwingOptions, SwingRun, simulate_swing
from sins_align.swing.paper import PaperAligner
from sins_align.swing.paper_error_model import tilt_to_quaternion
from sins_align.swing.paper_filter import QuaternionFilter
from sins_align.swing.paper_schedule import Event, events
from sins_align.types import Array, Estimate, ImuBlock
from sins_align.units import ARCMIN, ARCSEC, DEG

MM = 1e-3


@lru_cache(maxsize=8)
def simulated(**options: object) -> SwingRun:
    return simulate_swing(SwingOptions(**options))  # type: ignore[arg-type]


def blocks(run: SwingRun) -> Iterator[ImuBlock]:
    stamps = run.imu.stamp_ns
    edges = np.searchsorted(stamps, np.arange(stamps[0], stamps[-1] + 1, 1_000_000_000))
    for first, last in itertools.pairwise(edges):
        yield ImuBlock(*run.imu.select(slice(int(first), int(last) + 1)))


def true_attitude(run: SwingRun, stamp_ns: int) -> Array:
    elapsed = np.array([(stamp_ns - run.options.start_stamp_ns) * 1e-9])
    return run.truth.base.attitude(elapsed).C_nb[:, :, 0]


def configured(run: SwingRun, error_deg: tuple[float, ...] = (10.0, 10.0, 10.0), **parameters):
    C_nb = exp_rotation(np.array(error_deg) * DEG) @ true_attitude(run, int(run.imu.stamp_ns[0]))
    erect = run.options.motion.name == "erect"
    return swing_config(
        {
            "method": "paper",
            "latitude_deg": run.options.latitude_deg,
            "altitude_m": run.options.altitude_m,
            "imu_grade": run.options.grade,
            "imu_sampling": run.options.imu_sampling.value,
            "initial_rpy_deg": [float(angle / DEG) for angle in rpy_from_dcm(C_nb)],
            "switch_times_s": [15.0, 30.0] if erect else [15.0, 30.0, 70.0],
            **parameters,
        }
    )


def align(run: SwingRun, config: SwingConfig) -> PaperAligner:
    assert config.position is not None
    aligner = PaperAligner(config, config.position)
    for block in blocks(run):
        aligner.update(block)
    return aligner


def misalignment(run: SwingRun, estimate: Estimate) -> Array:
    C_true = true_attitude(run, estimate.stamp_ns)
    return -log_rotation(dcm_from_quaternion(estimate.q_nb) @ C_true.T)


def last_estimate(run: SwingRun, **parameters: object) -> Estimate:
    estimate = align(run, configured(run, **parameters)).estimate
    assert estimate is not None and estimate.lever_arm is not None
    return estimate


@lru_cache(maxsize=4)
def aligned(scenario: str, differentiator: str) -> tuple[SwingRun, Estimate]:
    run = simulated(scenario=scenario, rate_hz=200.0, seed=3)
    return run, last_estimate(run, differentiator=differentiator)


@pytest.mark.parametrize("differentiator", ["eso", "central"])
@pytest.mark.parametrize("scenario", ["pitch", "erect"])
def test_aligns_from_ten_degrees(scenario: str, differentiator: str) -> None:
    run, estimate = aligned(scenario, differentiator)
    phi = misalignment(run, estimate)
    late = differentiator == "eso"  # by 2.5 ms at this rate
    assert np.abs(phi[:2]).max() < (2.0 if late else 0.1) * ARCSEC
    assert abs(phi[2]) < (0.5 if late else 0.2) * ARCMIN
    error = estimate.lever_arm.r_b - run.truth.lever_arm_m
    assert np.abs(error).max() < (10.0 if late else 0.3) * MM
    # Six standard deviations in three degrees of freedom: the claim holds.
    assert phi @ np.linalg.solve(estimate.misalignment_covariance, phi) < 36.0
    assert error @ np.linalg.solve(estimate.lever_arm.covariance, error) < 36.0
    assert np.linalg.norm(estimate.q_nb) == pytest.approx(1.0, abs=1e-12)


def test_lever_arm_of_the_observer_is_turned_about_the_cone_axis() -> None:
    """Table 2: half a sample of lag turns the lever arm by omega h / 2 (here h = 5 ms)."""
    run, estimate = aligned("erect", "eso")
    error = run.truth.C_paper_b @ (estimate.lever_arm.r_b - run.truth.lever_arm_m)
    turn = 2.0 * np.pi / 8.0 * 2.5e-3
    np.testing.assert_allclose(error, turn * np.array([-3.0, 0.0, 4.0]), rtol=0, atol=0.6 * MM)


@pytest.mark.parametrize("rate", [50.0, 333.0])
def test_interval_means_and_lost_samples(rate: float) -> None:
    run = simulated(
        scenario="erect",
        rate_hz=rate,
        seed=1,
        duration_s=240.0,
        sampling="mean",
        lost_fraction=0.005,
    )
    phi = misalignment(run, last_estimate(run, differentiator="central"))
    assert np.abs(phi[:2]).max() < 1.0 * ARCSEC
    assert abs(phi[2]) < 2.0 * ARCMIN


def test_biases_are_covered_by_sigma() -> None:
    run = simulated(scenario="pitch", rate_hz=100.0, seed=2, grade="fog")
    estimate = last_estimate(run, differentiator="central")
    assert np.all(np.abs(misalignment(run, estimate)) < 4.0 * estimate.sigma)
    earth_rate = 7.292115e-5 * np.cos(40.0 * DEG)
    assert estimate.sigma[2] == pytest.approx(estimate.gyro_bias_sigma[0] / earth_rate, rel=0.3)
    assert estimate.sigma[0] == pytest.approx(estimate.accel_bias_sigma[0] / 9.8, rel=0.3)


def test_misalignment_columns_do_better_in_the_level_phase() -> None:
    """Fig. 3: the lever arm at the end of the level phase, with and without."""
    run = simulated(scenario="pitch", rate_hz=200.0, seed=5, duration_s=121.0)
    errors = {
        regression: np.linalg.norm(
            last_estimate(run, regression=regression, differentiator="central").lever_arm.r_b
            - run.truth.lever_arm_m
        )
        for regression in ("epls", "ls")
    }
    assert errors["epls"] < 10.0 * MM
    assert errors["ls"] > 10.0 * errors["epls"]


def test_no_estimate_before_the_end_of_the_level_phase() -> None:
    run = simulated(scenario="pitch", rate_hz=100.0, seed=0, duration_s=32.0)
    config = configured(run, level_phase_s=30.0)
    aligner = PaperAligner(config, config.position)
    found = []
    for block in blocks(run):
        aligner.update(block)
        found.append(aligner.estimate)
    assert found[28] is None and found[29] is not None
    assert found[29].sigma[2] == pytest.approx(30.0 * DEG, rel=1e-6)
    assert np.isnan(found[29].consistency) and np.isfinite(found[30].consistency)


@pytest.mark.parametrize("sampling", ["instantaneous", "mean"])
def test_propagate_carries_the_attitude_and_changes_nothing(sampling: str) -> None:
    run = simulated(scenario="pitch", rate_hz=100.0, seed=0, duration_s=60.0, sampling=sampling)
    config = configured(run, error_deg=(0.0, 0.0, 0.0), level_phase_s=15.0, switch_times_s=[5.0])
    kept, asked = (PaperAligner(config, config.position) for _ in range(2))
    for block in blocks(run):
        before = asked.estimate
        for length in (2, 37, 100):
            part = ImuBlock(block.stamp_ns[:length], *(x[:, :length] for x in block[1:]))
            carried = asked.propagate(part)
            # While the heading is wrong, Earth rate is misresolved: 1 deg is 0.3 arcsec/s.
            if before is not None and before.sigma[2] < 1.0 * DEG:
                assert carried.stamp_ns == part.stamp_ns[-1]
                turned = misalignment(run, carried) - misalignment(run, before)
                assert np.abs(turned).max() < 1.0 * ARCSEC
                np.testing.assert_array_equal(carried.lever_arm.r_b, before.lever_arm.r_b)
        for aligner in (kept, asked):
            aligner.update(block)
    assert kept.estimate.sigma[2] < 1.0 * DEG
    for field in dataclasses.fields(Estimate)[:3]:
        one, other = (getattr(aligner.estimate, field.name) for aligner in (kept, asked))
        np.testing.assert_array_equal(one, other)


def test_a_start_that_faces_backward_claims_nothing() -> None:
    run = simulated(scenario="pitch", rate_hz=100.0, seed=4, duration_s=240.0)
    config = configured(run, error_deg=(0.0, 0.0, 179.0), differentiator="central")
    estimate = align(run, config).estimate
    phi = misalignment(run, estimate)
    assert np.isfinite(estimate.misalignment_covariance).all()
    assert abs(phi[2]) < 5.0 * estimate.sigma[2] or estimate.consistency > 10.0


def test_still_base_keeps_the_prior_lever_arm() -> None:
    run = simulated(scenario="still", rate_hz=100.0, seed=4, grade="rlg", duration_s=300.0)
    config = configured(run, error_deg=(2.0, -2.0, 5.0), lever_arm_prior_m=[1.0, 2.0, 3.0])
    estimate = align(run, config).estimate
    assert estimate.lever_arm.observable == (False, False, False)
    np.testing.assert_allclose(estimate.lever_arm.r_b, [1.0, 2.0, 3.0], atol=1e-3)
    assert np.all(np.abs(misalignment(run, estimate)) < 4.0 * estimate.sigma)


def test_few_samples_and_odd_blocks_are_taken() -> None:
    run = simulated(scenario="pitch", rate_hz=50.0, seed=0, duration_s=20.0)
    config = configured(run, level_phase_s=5.0, switch_times_s=[2.0])
    aligner = PaperAligner(config, config.position)
    edges = [0, 1, 3, 4, 10, 60, 260, 400, 900]
    for first, last in itertools.pairwise(edges):
        aligner.update(ImuBlock(*run.imu.select(slice(first, last + 1))))
    estimate = aligner.estimate
    assert estimate.stamp_ns == run.imu.stamp_ns[900]
    assert np.isfinite(estimate.q_nb).all() and np.isfinite(estimate.sigma).all()


def test_initial_covariance_has_rank_three() -> None:
    Q = np.array([0.5, -0.5, 0.1, 0.7])
    Q /= np.linalg.norm(Q)
    sigma = np.radians([1.0, 2.0, 30.0])
    kalman = QuaternionFilter(sigma, 0)
    kalman.reset(Q, np.eye(2))
    P0 = kalman.P[:4, :4]
    assert np.linalg.matrix_rank(P0, tol=1e-12) == 3
    np.testing.assert_allclose(P0 @ Q, 0.0, atol=1e-16)
    # 1/4 Xi S Xi^T is what small rotations of that covariance do to Q.
    psi = sigma[:, np.newaxis] * np.random.default_rng(0).normal(size=(3, 100_000))
    np.testing.assert_allclose(P0, np.cov(tilt_to_quaternion(Q) @ psi), atol=2e-3)
    covariance = kalman.tilt_covariance(Q, np.zeros((0, 0)))
    np.testing.assert_allclose(covariance, np.diag(sigma**2), atol=1e-15)


def test_consider_parameters_are_what_the_constants_do() -> None:
    """B is how the estimate's error answers to a constant: run the filter with it and without."""
    rng = np.random.default_rng(2)
    Q = np.array([1.0, 0.0, 0.0, 0.0])
    plain, disturbed = (QuaternionFilter(np.full(3, 0.1), 1) for _ in range(2))
    for kalman in (plain, disturbed):
        kalman.reset(Q, np.eye(2))
    error, V_truth = np.zeros(6), np.zeros(6)
    for _ in range(5):
        transition = np.eye(6) + 0.1 * rng.normal(size=(6, 6))
        driven, seen = rng.normal(size=(6, 1)), rng.normal(size=(2, 1))
        for kalman in (plain, disturbed):
            kalman.predict(transition, 0.01 * np.eye(6), driven)
        V_truth = transition @ V_truth + driven[:, 0]
        plain.correct(np.zeros(2), 0.01 * np.eye(2), seen)
        disturbed.correct(V_truth[4:] + seen[:, 0], 0.01 * np.eye(2), seen)
    error = disturbed.x - plain.x - V_truth
    xi = 2.0 * tilt_to_quaternion(Q)
    expected = 4.0 * xi.T @ np.outer(error[:4], error[:4]) @ xi
    by_constant = plain.tilt_covariance(Q, np.eye(1)) - plain.tilt_covariance(Q, np.zeros((1, 1)))
    np.testing.assert_allclose(by_constant, expected, rtol=1e-9, atol=1e-14)


def test_schedule() -> None:
    config = PaperConfig("eso", "epls", None, (15.0, 30.0, 70.0), 120.0, (0.0, 0.0, 0.0))
    due = {s: found for s in range(1, 300) if (found := events(config, s - 1.0, float(s)))}
    assert due == {
        10: [Event.LEVEL],
        20: [Event.LEVEL],
        40: [Event.LEVEL],
        80: [Event.LEVEL],
        120: [Event.LEVEL, Event.FINE],
        135: [Event.SWITCH],
        150: [Event.LEVER, Event.SWITCH],
        180: [Event.LEVER],
        190: [Event.SWITCH],
        210: [Event.LEVER],
        240: [Event.LEVER],
        270: [Event.LEVER],
    }
