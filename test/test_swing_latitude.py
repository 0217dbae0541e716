"""The latitude that the data tell."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from swing_filtered import (
    LATITUDE_DEG,
    OPTIONS,
    Filtered,
    filter_run,
    gravity_model,
    mean_square_bounds,
)

from evidence.monte_carlo import misalignment
from sins_align.config import swing_config
from sins_align.earth import EARTH_RATE
from sins_align.grades import load_grade
from sins_align.rotation import dcm_from_quaternion, exp_rotation
from sins_align.session import Session
from sins_align.simulate import simulate_swing
from sins_align.swing.latitude import latitude_column, latitude_doubts
from sins_align.swing.solution import MATRICES, X_G, Solution
from sins_align.types import LatitudeEstimate
from sins_align.units import DEG

SEEDS = 20


def solution_of(delta_g: float, size: int = MATRICES.start) -> Solution:
    x = np.zeros(size)
    x[X_G] = delta_g
    return Solution(exp_rotation(np.array([0.3, -0.5, 1.2])), x, np.eye(size))


@pytest.mark.parametrize("latitude_deg", [-75.0, -40.0, 2.0, 40.0, 60.0])
@pytest.mark.parametrize("delta_g", [0.0, 0.05])
def test_column_is_the_derivative(latitude_deg: float, delta_g: float) -> None:
    """Gravity of a model at L + dL, minus that at L - dL, in inertial axes."""
    solution, latitude, step = solution_of(delta_g), latitude_deg * DEG, 1e-5
    column = latitude_column(solution, latitude)
    assert column is not None
    t = np.array([1.0, 60.0, 600.0, 3600.0, 20_000.0])
    vectors = (1.0 + delta_g) * solution.R.T
    model = gravity_model(latitude_deg)
    plus, minus = (replace(model, latitude=latitude + k * step).basis(t) for k in (1, -1))
    numeric = (plus - minus) @ vectors / (2.0 * step)
    analytic = model.basis(t) @ column[:9].reshape(3, 3)
    scale = np.abs(numeric).max(axis=1)
    assert (np.abs(analytic - numeric).max(axis=1) < 1e-6 * scale + 1e-10).all()
    assert not column[9:].any()


def test_column_has_the_size_of_theta() -> None:
    column = latitude_column(solution_of(0.0, MATRICES.stop), 0.7)
    assert column is not None and column.shape == (39,)
    assert not column[9:].any()


@pytest.mark.parametrize("latitude_deg", [0.0, 0.5, -0.5, 89.6, 90.0, -90.0])
def test_nothing_at_the_equator_and_at_the_pole(latitude_deg: float) -> None:
    assert latitude_column(solution_of(0.0), latitude_deg * DEG) is None


@pytest.mark.parametrize("latitude_deg", [0.6, -0.6, 89.4])
def test_something_beside_them(latitude_deg: float) -> None:
    assert latitude_column(solution_of(0.0), latitude_deg * DEG) is not None


def found(filtered: Filtered) -> LatitudeEstimate:
    """What the data of a run say."""
    given = filtered.gravity.latitude
    column = latitude_column(filtered.solution, given)
    assert column is not None
    off, sigma, _ = filtered.solver.score(filtered.filter.normal, filtered.solution, column)
    return LatitudeEstimate(given + off, sigma)


@functools.cache
def runs(scenario: str, latitude_deg: float) -> list[Filtered]:
    """Filters that believe in `latitude_deg`."""
    options = replace(OPTIONS, scenario=scenario, duration_s=100.0)
    return [filter_run(replace(options, seed=seed), latitude_deg) for seed in range(SEEDS)]


@pytest.mark.parametrize("scenario", ["still", "pitch"])
def test_sigma_is_honest(scenario: str) -> None:
    own = [found(filtered) for filtered in runs(scenario, LATITUDE_DEG)]
    z = np.array([(e.latitude - LATITUDE_DEG * DEG) / e.sigma for e in own])
    low, high = mean_square_bounds(SEEDS)
    assert low < np.mean(z**2) < high
    assert abs(z.mean()) < 3.5 / math.sqrt(SEEDS)


def test_sigma_is_not_below_what_the_gyros_allow() -> None:
    """The bias along the Earth's rate scales it: sigma_bg / (Omega sin L)."""
    grade = OPTIONS.imu_grade
    bound = grade.gyro_bias / (EARTH_RATE * math.sin(LATITUDE_DEG * DEG))
    sigma = found(runs("still", LATITUDE_DEG)[0]).sigma
    assert bound < sigma < 3.0 * bound


@pytest.mark.parametrize("scenario", ["still", "pitch"])
@pytest.mark.parametrize("off_deg", [-1.0, 1.0])
def test_a_degree_is_found(scenario: str, off_deg: float) -> None:
    """To what it says of itself, and far beyond it from what was given."""
    own = [found(filtered) for filtered in runs(scenario, LATITUDE_DEG + off_deg)[:6]]
    for e in own:
        assert abs(e.latitude - LATITUDE_DEG * DEG) < 5.0 * e.sigma
        assert abs(e.latitude - (LATITUDE_DEG + off_deg) * DEG) > 8.0 * e.sigma


def run_session(true_deg: float, **parameters: object) -> Session:
    options = replace(OPTIONS, scenario="still", duration_s=120.0, latitude_deg=true_deg, seed=4)
    session = Session(
        swing_config(
            {"latitude_deg": true_deg, "altitude_m": 50.0, "imu_grade": "rlg", **parameters}
        )
    )
    session.add_imu(simulate_swing(options).imu)
    return session


def test_the_method_gives_it() -> None:
    estimate = run_session(40.0).estimate
    assert estimate is not None and estimate.latitude is not None
    off = estimate.latitude.latitude - 40.0 * DEG
    assert abs(off) < 4.0 * estimate.latitude.sigma < 0.2 * DEG


def test_at_the_equator_the_method_gives_it_too() -> None:
    """By the rate about up."""
    estimate = run_session(0.0).estimate
    assert estimate is not None and estimate.latitude is not None
    assert abs(estimate.latitude.latitude) < 4.0 * estimate.latitude.sigma < 0.2 * DEG


def test_a_wrong_latitude_is_in_the_covariance() -> None:
    """What the attitude would change by: sigma must cover it."""
    right, wrong = run_session(40.0), run_session(40.0, latitude_deg=41.0)
    unseen = run_session(40.0, latitude_deg=41.0, latitude_check="off")
    assert right.estimate is not None and wrong.estimate is not None
    assert unseen.estimate is not None
    # The attitude itself stays that of the latitude given, whether that is looked at or not ...
    assert np.array_equal(wrong.estimate.q_nb, unseen.estimate.q_nb)
    # ... and sigma has grown by about what it is off by for that reason.
    added = wrong.estimate.misalignment_covariance - right.estimate.misalignment_covariance
    attitudes = (dcm_from_quaternion(e.q_nb) for e in (wrong.estimate, right.estimate))
    off = np.abs(misalignment(*attitudes))
    assert off[1] > right.estimate.sigma[1]
    assert np.sqrt(added[1, 1]) == pytest.approx(off[1], rel=0.25)
    assert (off < 1.5 * wrong.estimate.sigma).all()


@pytest.mark.parametrize(
    ("grade", "given_deg", "sigma_deg", "key"),
    [
        ("rlg", 40.0, 0.2, "latitude_unproven"),
        ("rlg", 40.0, 0.16, ""),
        ("rlg", -40.0, 0.1, "latitude_doubted"),
        ("rlg", 5.0, 0.5, ""),  # its bias hides a degree
        ("fog", 40.0, 0.5, ""),
    ],
)
def test_what_an_alignment_waits_for(
    grade: str, given_deg: float, sigma_deg: float, key: str
) -> None:
    """Off by 0.35 deg, of which 3 sigma doubt and one of 6 are to be told."""
    own = LatitudeEstimate((given_deg + 0.35) * DEG, sigma_deg * DEG)
    found = latitude_doubts(load_grade(grade), given_deg * DEG, own)
    assert [f.reason.key for f in found] == ([key] if key else [])
    assert latitude_doubts(load_grade(grade), given_deg * DEG, None) == ()


def test_what_was_told_is_not_asked_again() -> None:
    """A lever arm that is considered again, say, makes sigma larger, and nothing untold."""
    own = LatitudeEstimate(40.0 * DEG, 1.0 * DEG)
    assert latitude_doubts(load_grade("rlg"), 40.0 * DEG, own)
    assert latitude_doubts(load_grade("rlg"), 40.0 * DEG, own, was_told=True) == ()


def test_a_latitude_is_one() -> None:
    """A centre that heaves misleads the first seconds: to first order L was beyond the pole."""
    options = replace(OPTIONS, scenario="level", grade="rlg", heave_m=0.05, sway_m=0.05)
    found = []
    for seed in range(1, 9):
        imu = simulate_swing(replace(options, seed=seed, rate_hz=20.0, duration_s=30.0)).imu
        session = Session(swing_config({"latitude_deg": LATITUDE_DEG, "imu_grade": "rlg"}))
        for update in session.add_imu(imu):
            if update.estimate is not None and update.estimate.latitude is not None:
                found.append(update.estimate.latitude.latitude)
    assert 0.5 * math.pi in map(abs, found)
    assert max(map(abs, found)) <= 0.5 * math.pi
