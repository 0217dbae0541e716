"""Gyros noisier than declared: the likelihood itself, and what it says of true and false noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom
from swing_filtered import LATITUDE_DEG, OPTIONS, Filtered, filter_run

from sins_align.config import swing_config
from sins_align.noise_doubt import DOUBTED, FACTOR
from sins_align.session import Session
from sins_align.simulate import SwingOptions, simulate_swing
from sins_align.swing.epochs import Epochs
from sins_align.swing.latitude import latitude_column
from sins_align.swing.loudness import Loudness
from sins_align.swing.two_stage import DATA, NoiseModel, build_steps
from sins_align.swing.two_stage_filter import TwoStageFilter
from sins_align.types import Array, ImuBlock, ImuSampling
from sins_align.units import DEG
from sins_align.windows import integrate_windows

LOUD = replace(OPTIONS, scenario="pitch", duration_s=300.0)


def dense_likelihood(filtered: Filtered, noise: NoiseModel, column: Array | None = None) -> float:
    """All observations as one Gaussian vector, theta marginalised with its prior: no filter.

    x_k+1 = F x_k + G theta + w, y_k = H x_k + observed theta + n; A is the response of all y to
    theta and the data, V their covariance for given theta.
    """
    steps = build_steps(filtered.epochs, 0, filtered.truth, filtered.gravity, noise)
    begun = TwoStageFilter(noise)
    c, K = begun.columns, steps.F.shape[0]
    n = steps.F.shape[1]
    mean, spread = begun.X.copy(), begun.P.copy()
    A, V = np.empty((K, 3, c)), np.zeros((K, 3, K, 3))
    carried: list[Array] = []  # covariance of x now with each y before
    for k in range(K):
        F, H, added = steps.F[k], steps.H[k], steps.added[k]
        mean = F @ mean + added[:, :c]
        spread = F @ spread @ F.T + added[:, c:]
        carried = [F @ cross for cross in carried]
        A[k] = H @ mean + steps.observed[k][:, :c]
        for j, cross in enumerate(carried):
            V[k, :, j] = H @ cross
            V[j, :, k] = (H @ cross).T
        V[k, :, k] = H @ spread @ H.T + begun.noise.variance * np.eye(3)
        carried.append(spread @ H.T)
    assert spread.shape == (n, n)
    flat, rows = V.reshape(3 * K, 3 * K), A.reshape(3 * K, c)
    J = filtered.solution.jacobian
    mine = rows[:, :DATA] @ (J if column is None else np.column_stack((J, column)))
    left = rows @ np.append(filtered.solution.theta, 1.0)
    weighted = np.linalg.solve(flat, np.column_stack((mine, left)))
    N, gradient = mine.T @ weighted[:, :-1], mine.T @ weighted[:, -1]
    variance = filtered.prior.variance
    known = np.flatnonzero(variance > 0.0)
    N[known, known] += 1.0 / variance[known]
    off = filtered.solution.x - filtered.prior.mean
    gradient[known] += off[known] / variance[known]
    least = left @ weighted[:, -1] + (off[known] ** 2 / variance[known]).sum()
    least -= gradient @ np.linalg.solve(N, gradient)
    # N holds powers of ten from -6 to 18.
    scale = np.sqrt(N.diagonal())
    log_N = np.linalg.slogdet(N / np.outer(scale, scale))[1] + 2.0 * np.log(scale).sum()
    return float(-0.5 * (np.linalg.slogdet(flat)[1] + log_N + least))


def ratio(filtered: Filtered, latitude: float = 0.0) -> float:
    """At latitude 0 the latitude is no unknown."""
    loudness = Loudness(filtered.noise)
    loudness.update(filtered.filter, filtered.epochs, filtered.truth, filtered.gravity)
    loudness.compare(filtered.filter, filtered.solver, filtered.solution, latitude)
    return loudness.log_ratio


@pytest.mark.parametrize("scenario", ["still", "pitch"])
def test_the_ratio_is_that_of_the_whole_vectors_densities(scenario: str) -> None:
    filtered = filter_run(replace(OPTIONS, scenario=scenario, seed=3, duration_s=90.0))
    loud = replace(filtered.noise, gyro=FACTOR * filtered.noise.gyro)
    expected = dense_likelihood(filtered, loud) - dense_likelihood(filtered, filtered.noise)
    assert abs(expected) > 0.05
    # The solver's Jacobian is that of the truth, about which the filter is linearised.
    assert ratio(filtered) == pytest.approx(expected, abs=0.01)
    latitude = LATITUDE_DEG * DEG
    column = latitude_column(filtered.solution, latitude)
    expected = dense_likelihood(filtered, loud, column)
    expected -= dense_likelihood(filtered, filtered.noise, column)
    assert ratio(filtered, latitude) == pytest.approx(expected, abs=0.01)


def test_in_portions_and_linearised_anew_it_is_the_same() -> None:
    filtered = filter_run(replace(OPTIONS, seed=1))
    loudness, part, epochs = Loudness(filtered.noise), TwoStageFilter(filtered.noise), Epochs()
    other = filtered.truth._replace(R=filtered.truth.R.copy())
    stamps, w, f = filtered.run.imu
    for first, last, about in ((0, 30, other), (30, 50, filtered.truth), (50, 120, filtered.truth)):
        some = slice(25 * first, 25 * last + 1)
        block = ImuBlock(stamps[some], w[:, some], f[:, some])
        epochs.append(integrate_windows(block, ImuSampling.INSTANTANEOUS, last - first))
        steps = build_steps(epochs, first, filtered.truth, filtered.gravity, filtered.noise)
        part.run(steps, None)
        loudness.update(part, epochs, about, filtered.gravity)
    loudness.compare(part, filtered.solver, filtered.solution, 0.0)
    # The force of the last epoch of a portion is by a one-sided difference.
    assert loudness.log_ratio == pytest.approx(ratio(filtered), rel=1e-2)


def is_doubted(options: SwingOptions) -> bool:
    """Whether the noise of a session is, at any time."""
    samples = simulate_swing(options).imu
    place = {"latitude_deg": LATITUDE_DEG, "altitude_m": OPTIONS.altitude_m}
    session = Session(swing_config({**place, "imu_grade": "rlg"}))
    return any("gyro_noisy" in u.status.keys for u in session.add_imu(samples))


def test_true_noise_is_seldom_doubted_and_six_times_as_much_mostly_is() -> None:
    """Ville: in one run of thirty at most; in 12 runs 4 and more are then one in 2000."""
    assert binom.sf(3, 12, np.exp(-DOUBTED)) < 1e-3
    noisy = replace(LOUD.imu_grade, gyro_arw=6.0 * LOUD.imu_grade.gyro_arw)
    runs = [replace(LOUD, seed=seed) for seed in range(12)]
    assert sum(map(is_doubted, runs)) <= 3
    assert sum(is_doubted(replace(options, grade=noisy)) for options in runs) >= 10


def test_a_wrong_latitude_is_not_taken_for_noise() -> None:
    filtered = filter_run(replace(LOUD, scenario="still", seed=5), LATITUDE_DEG + 1.0)
    assert ratio(filtered) > DOUBTED
    assert ratio(filtered, (LATITUDE_DEG + 1.0) * DEG) < 1.0
