"""Sensor errors: their statistics, with two-sided bounds."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.stats import chi2

from sins_align.earth import earth_rate_n as believed_earth_rate_n
from sins_align.earth import normal_gravity
from sins_align.grades import ImuGrade, load_grade
from sins_align.simulate import SwingOptions, simulate_swing
from sins_align.simulate.geodesy import earth_rate_n, plumb_gravity
from sins_align.simulate.random_streams import random_streams
from sins_align.simulate.sensors import draw_sensor_errors, gauss_markov
from sins_align.types import Array
from sins_align.units import ARCSEC, DEG, DEG_PER_H, DEG_PER_SQRT_H, MICRO_G, PPM

GRADE = ImuGrade(
    gyro_bias=0.1 * DEG_PER_H,
    gyro_arw=0.01 * DEG_PER_SQRT_H,
    gyro_bias_instability=0.05 * DEG_PER_H,
    accel_bias=100.0 * MICRO_G,
    accel_vrw=20.0 * MICRO_G,
    gyro_scale=10.0 * PPM,
    accel_scale=50.0 * PPM,
    misalignment=5.0 * ARCSEC,
)
FALSE_ALARM = 1e-4  # of each two-sided bound; the seeds are fixed


def assert_variance(sample: Array, sigma: float) -> None:
    """The sample of known mean zero has that sigma, as far as its size can tell."""
    low, high = chi2.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], sample.size)
    assert low < np.sum(np.square(sample)) / sigma**2 < high


def errors_of(grade: ImuGrade, rate_hz: float, sampling: str) -> tuple[Array, Array]:
    """What the sensors add to the truth: (3, N) each."""
    options = SwingOptions(
        grade=grade, rate_hz=rate_hz, duration_s=100.0, sampling=sampling, seed=11
    )
    real = simulate_swing(options).imu
    perfect = simulate_swing(dataclasses.replace(options, grade="perfect")).imu
    return real.w_ib_b - perfect.w_ib_b, real.f_ib_b - perfect.f_ib_b


@pytest.mark.parametrize("sampling", ["instantaneous", "mean"])
@pytest.mark.parametrize("rate_hz", [100.0, 1000.0])
def test_white_noise_keeps_its_density(rate_hz: float, sampling: str) -> None:
    grade = ImuGrade(gyro_arw=GRADE.gyro_arw, accel_vrw=GRADE.accel_vrw)
    for noise, density in zip(
        errors_of(grade, rate_hz, sampling), (grade.gyro_arw, grade.accel_vrw), strict=True
    ):
        for axis in noise:
            assert_variance(axis, density * math.sqrt(rate_hz))
        # White: sums over whole seconds have the density itself as sigma.
        seconds = noise[:, 1:].reshape(3, 100, -1).sum(axis=2) / rate_hz
        assert_variance(seconds, density)
        correlation = np.corrcoef(noise)[np.triu_indices(3, 1)]
        assert np.abs(correlation).max() < 4.0 / math.sqrt(noise.shape[1])


def test_paper_noise_is_per_sample_of_1_ms() -> None:
    w, f = errors_of(load_grade("paper_swing"), 1000.0, "instantaneous")
    # The two printed figures are rounded to three digits in the grade.
    assert w.std() == pytest.approx(1e-3 * DEG_PER_H, rel=0.01)
    assert f.std() == pytest.approx(2e-5 * 9.80665, rel=0.01)


def test_drift_is_gauss_markov() -> None:
    runs = np.concatenate(
        [gauss_markov(0.5, 2, random_streams(seed)["gyro_drift"]) for seed in range(2000)]
    )
    start, later = runs.T
    assert_variance(start, 1.0)  # stationary from the first sample on
    assert_variance(later, 1.0)
    decay = math.exp(-0.5)
    assert_variance(later - decay * start, math.sqrt(1.0 - decay**2))
    assert np.mean(start * later) == pytest.approx(decay, abs=4.0 / math.sqrt(start.size))


def test_drift_does_not_depend_on_the_rate() -> None:
    for rate_hz in (1.0, 100.0):
        size = round(600.0 * rate_hz)
        ends = np.concatenate(
            [
                gauss_markov(1.0 / (300.0 * rate_hz), size, random_streams(seed)["gyro_drift"])[
                    :, -1
                ]
                for seed in range(40)
            ]
        )
        assert_variance(ends, 1.0)


def test_constant_errors_have_the_sigma_of_the_grade() -> None:
    draws = [draw_sensor_errors(GRADE, random_streams(seed)) for seed in range(500)]
    assert_variance(np.array([d.gyro_bias for d in draws]), GRADE.gyro_bias)
    assert_variance(np.array([d.accel_bias for d in draws]), GRADE.accel_bias)
    gyro = np.array([d.gyro_matrix for d in draws]) - np.eye(3)
    accel = np.array([d.accel_matrix for d in draws]) - np.eye(3)
    diagonal = np.eye(3, dtype=bool)
    assert_variance(gyro[:, diagonal], GRADE.gyro_scale)
    assert_variance(accel[:, diagonal], GRADE.accel_scale)
    assert_variance(gyro[:, ~diagonal], GRADE.misalignment)
    assert_variance(accel[:, ~diagonal], GRADE.misalignment)


def test_samples_carry_the_biases_of_the_truth() -> None:
    grade = ImuGrade(gyro_bias=GRADE.gyro_bias, accel_bias=GRADE.accel_bias)
    truth = simulate_swing(SwingOptions(grade=grade, duration_s=1.0, seed=11)).truth
    w, f = errors_of(grade, 100.0, "instantaneous")
    np.testing.assert_allclose(w, np.tile(truth.gyro_bias_rad_s[:, None], w.shape[1]), atol=1e-15)
    np.testing.assert_allclose(f, np.tile(truth.accel_bias_m_s2[:, None], f.shape[1]), atol=1e-14)


def test_samples_carry_scale_errors_and_misalignment() -> None:
    grade = dataclasses.replace(
        ImuGrade(), gyro_scale=1e-3, accel_scale=2e-3, misalignment=GRADE.misalignment
    )
    options = SwingOptions(grade=grade, duration_s=2.0, seed=4)
    errors = draw_sensor_errors(grade, random_streams(4))
    real = simulate_swing(options).imu
    perfect = simulate_swing(dataclasses.replace(options, grade="perfect")).imu
    np.testing.assert_allclose(real.w_ib_b, errors.gyro_matrix @ perfect.w_ib_b, atol=1e-15)
    np.testing.assert_allclose(real.f_ib_b, errors.accel_matrix @ perfect.f_ib_b, atol=1e-13)


@pytest.mark.parametrize("latitude_deg", [-80.0, 0.0, 40.0, 90.0])
def test_estimators_believe_in_the_same_earth(latitude_deg: float) -> None:
    latitude = latitude_deg * DEG
    np.testing.assert_allclose(earth_rate_n(latitude), believed_earth_rate_n(latitude), rtol=1e-12)
    for altitude in (0.0, 50.0, 4000.0):
        # Groves rounds Somigliana's constant: 3.5e-10 of gravity at the poles.
        assert plumb_gravity(latitude, altitude) == pytest.approx(
            normal_gravity(latitude, altitude), rel=4e-10
        )
