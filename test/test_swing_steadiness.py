"""Changes of heading with new data: what is to be expected, and what is not."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from sins_align.config import swing_config
from sins_align.consistency import MAX_UNSTEADINESS
from sins_align.grades import load_grade
from sins_align.rotation import exp_rotation
from sins_align.session import Session
from sins_align.simulate import SwingOptions, simulate_swing
from sins_align.swing.solution import KAPPA, Solution
from sins_align.swing.steadiness import FIRST_S, LEAST_COUNT, SURE_S, Steadiness

START = exp_rotation(np.array([0.2, -0.4, 2.0]))


def solution(heading: float, sigma: float) -> Solution:
    """Heading [rad] about up, which is the third column of R."""
    covariance = np.zeros((16, 16))
    covariance[KAPPA, KAPPA] = sigma**2 * np.eye(3)
    return Solution(exp_rotation(heading * START[:, 2]) @ START, np.zeros(16), covariance)


def fed(headings: list[float], sigmas: list[float]) -> Steadiness:
    found = Steadiness()
    for k, (heading, sigma) in enumerate(zip(headings, sigmas, strict=True)):
        found.add(solution(heading, sigma), FIRST_S + k)
    return found


def test_the_largest_change_counts_and_its_variance_is_the_difference() -> None:
    found = fed([3e-3, 0.0, 0.0, 0.0, 5e-4], [1e-3, 9e-4, 8e-4, 7e-4, 6e-4])
    assert found.value == pytest.approx(6.25e-6 / (1.001e-6 - 0.36e-6), rel=1e-6)


def test_a_slow_drift_shows_that_no_single_change_does() -> None:
    sigmas = [1e-3 * 0.9**k for k in range(8)]
    steps = [1.6 * math.sqrt(a * a - b * b) for a, b in pairwise(sigmas)]
    drift = fed([0.0, *np.cumsum(steps).tolist()], sigmas).value
    there_and_back = fed([0.0, *(np.cumsum([s * (-1) ** k for k, s in enumerate(steps)]))], sigmas)
    assert drift > MAX_UNSTEADINESS > 2.0 * there_and_back.value


def test_nothing_is_said_of_a_few_early_or_growing_ones() -> None:
    assert math.isnan(Steadiness().value)
    assert math.isnan(fed([0.0] * LEAST_COUNT, [1e-3] * LEAST_COUNT).value)
    assert fed([0.0] * (LEAST_COUNT + 1), [1e-3] * (LEAST_COUNT + 1)).value == 0.0
    early = Steadiness()
    for _ in range(9):
        early.add(solution(0.0, 1e-3), FIRST_S - 1.0)
    assert math.isnan(early.value)
    assert math.isnan(fed([0.0] * 5, [1e-3, 2e-3, 3e-3, 4e-3, 5e-3]).value)  # sigma has grown


def test_what_was_said_of_heading_too_early_is_forgotten() -> None:
    found = Steadiness()
    found.add(solution(0.5, 0.02), SURE_S - 2.0)
    values = []
    for k in range(LEAST_COUNT + 1):
        found.add(solution(0.0, 0.01 * 0.8**k), SURE_S + k)
        values.append(found.value)
    assert values[LEAST_COUNT - 1] > MAX_UNSTEADINESS
    assert values[LEAST_COUNT] == 0.0


def test_heave_does_not_keep_aligned_away_for_ever() -> None:
    """3 cm, from the start on."""
    run = simulate_swing(
        SwingOptions(
            scenario="pitch", grade="rlg", seed=6, rate_hz=50.0, duration_s=150.0, heave_m=0.03
        )
    )
    session = Session(swing_config({"latitude_deg": 40.0, "imu_grade": "rlg"}))
    session.add_imu(run.imu)
    assert "unsteady" not in session.status.keys


def largest(seed: int, scenario: str, factor: float) -> float:
    """Of a run of fog_noisy with `factor` times its gyro noise, which is not declared."""
    grade = load_grade("fog_noisy")
    grade = replace(grade, gyro_arw=factor * grade.gyro_arw)
    run = simulate_swing(
        SwingOptions(scenario=scenario, grade=grade, seed=seed, rate_hz=50.0, duration_s=240.0)
    )
    session = Session(swing_config({"latitude_deg": 40.0, "imu_grade": "fog_noisy"}))
    found = [u.estimate.steadiness for u in session.add_imu(run.imu) if u.estimate is not None]
    return max(s for s in found if s is not None and not math.isnan(s))


@pytest.mark.parametrize("scenario", ["still", "pitch"])
def test_gyro_noise_beyond_the_grade_is_told_and_that_of_the_grade_is_not(scenario: str) -> None:
    seeds = range(6)
    assert sum(largest(seed, scenario, 1.0) > MAX_UNSTEADINESS for seed in seeds) <= 1
    assert sum(largest(seed, scenario, 8.0) > MAX_UNSTEADINESS for seed in seeds) >= 5
