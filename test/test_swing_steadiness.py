"""Changes of the attitude from solution to solution: what is to be expected, and what is not."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from sins_align.config import swing_config
from sins_align.grades import load_grade
from sins_align.rotation import exp_rotation
from sins_align.session import Session
from sins_align.simulate import SwingOptions, simulate_swing
from sins_align.status import MAX_UNSTEADINESS
from sins_align.swing.solution import KAPPA, Solution
from sins_align.swing.steadiness import FIRST_S, LEAST_COUNT, MEMORY, Steadiness
from sins_align.types import Array

SIGMA = np.array([1e-4, 2e-5, 1e-3])


def solution(kappa: Array, sigma: Array) -> Solution:
    covariance = np.zeros((16, 16))
    covariance[KAPPA, KAPPA] = np.diag(sigma**2)
    start = exp_rotation(np.array([0.2, -0.4, 2.0]))
    return Solution(exp_rotation(kappa) @ start, np.zeros(16), covariance)


def steadiness_of(changes: Array, shrink: float = 0.8, time_s: float = 60.0) -> Steadiness:
    """Fed with changes (N, 3) in units of what the covariance allows."""
    found, allowed = Steadiness(), SIGMA * math.sqrt(1.0 - shrink**2)
    for change in changes:
        found.add(solution(np.zeros(3), SIGMA), solution(change * allowed, shrink * SIGMA), time_s)
    return found


def test_expected_changes_are_one() -> None:
    """Means of the last eight, over many: 3 degrees of freedom each."""
    rng = np.random.default_rng(4)
    count = 150
    values = [steadiness_of(rng.standard_normal((MEMORY, 3))).value for _ in range(count)]
    low, high = chi2.ppf([0.0005, 0.9995], 3 * MEMORY * count) / (3 * MEMORY * count)
    assert low < np.mean(values) * (1.0 + 1e-3 / 0.36) < high


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_every_axis_counts(axis: int) -> None:
    """Six sigma of a change in one of three: 12 times what it should be."""
    found = steadiness_of(np.tile(6.0 * np.eye(3)[axis], (MEMORY, 1)))
    assert found.value == pytest.approx(12.0, rel=0.01)


def test_nothing_is_said_of_a_few() -> None:
    changes = np.ones((LEAST_COUNT, 3))
    assert math.isnan(Steadiness().value)
    assert math.isnan(steadiness_of(changes[1:]).value)
    assert steadiness_of(changes).value == pytest.approx(1.0, rel=0.01)


def test_nothing_is_said_of_the_first_seconds() -> None:
    changes = np.full((20, 3), 100.0)
    assert math.isnan(steadiness_of(changes, time_s=FIRST_S - 0.1).value)
    assert steadiness_of(changes, time_s=FIRST_S).value > 1000.0


def test_where_sigma_has_grown_nothing_is_learnt() -> None:
    """Something else was estimated before: the difference of covariances is none."""
    found = Steadiness()
    for _ in range(20):
        found.add(solution(np.zeros(3), SIGMA), solution(SIGMA, 1.1 * SIGMA), 60.0)
    assert math.isnan(found.value)


def test_what_is_long_past_is_forgotten() -> None:
    rough, smooth = np.full((MEMORY, 3), 10.0), np.full((5 * MEMORY, 3), 0.1)
    assert steadiness_of(rough).value > MAX_UNSTEADINESS
    assert steadiness_of(np.vstack((rough, smooth))).value < MAX_UNSTEADINESS


# -- through the session


def run(scenario: str, grade: str, seed: int, noisier: float = 1.0) -> Session:
    """A minute and three, gyros noisier than declared."""
    made = load_grade(grade)
    options = SwingOptions(
        scenario=scenario,
        grade=replace(made, gyro_arw=noisier * made.gyro_arw),
        rate_hz=50.0,
        duration_s=200.0,
        seed=seed,
        latitude_deg=40.0,
        altitude_m=50.0,
    )
    session = Session(swing_config({"latitude_deg": 40.0, "altitude_m": 50.0, "imu_grade": grade}))
    session.add_imu(simulate_swing(options).imu)
    return session


@pytest.mark.parametrize("scenario", ["still", "level", "erect"])
@pytest.mark.parametrize("grade", ["rlg", "fog_noisy", "tactical"])
def test_sensors_as_declared_are_steady(scenario: str, grade: str) -> None:
    for seed in range(5):
        session = run(scenario, grade, seed)
        estimate = session.estimate
        assert estimate is not None
        assert 0.01 < estimate.steadiness < 0.5 * MAX_UNSTEADINESS
        assert "unsteady" not in session.status.keys


@pytest.mark.parametrize("scenario", ["still", "level", "erect"])
def test_gyros_eight_times_as_noisy_are_not(scenario: str) -> None:
    for seed in range(4):
        session = run(scenario, "tactical", seed, noisier=8.0)
        estimate = session.estimate
        assert estimate is not None and estimate.steadiness > MAX_UNSTEADINESS
        assert "unsteady" in session.status.keys
        assert "gyro noise" in session.status.reason
