"""The latitude that the data tell of themselves: honest, and a wrong one is found in time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from odo_sessions import align, vehicle

from sins_align.odo.latitude import LengthError, latitude_of_axis
from sins_align.types import LatitudeEstimate, State
from sins_align.units import DEG

SEEDS = 5


def test_sigma_is_that_of_the_length() -> None:
    """sigma_L = sigma_|e_h| / sin L; the error across says nothing."""
    L, alpha, sigma = 40.0 * DEG, 0.7, 1e-3
    along = np.array([math.sin(alpha), math.cos(alpha)])
    P = sigma**2 * np.outer(along, along)
    P += 1e-4 * np.outer([along[1], -along[0]], [along[1], -along[0]])
    found = latitude_of_axis(math.cos(L) * along, P, L)
    assert found is not None
    assert found.latitude == pytest.approx(L)
    assert found.sigma == pytest.approx(sigma / math.sin(L), rel=1e-6)
    south = latitude_of_axis(math.cos(L) * along, P, -L)
    assert south is not None and south.latitude == pytest.approx(-L)


@pytest.mark.parametrize("given_deg", [0.0, 3.0, 6.0, 20.0])
def test_ratio_is_that_of_the_lengths_near_the_equator_too(given_deg: float) -> None:
    L, sigma = 10.0 * DEG, 1e-3
    found = latitude_of_axis(np.array([0.0, math.cos(L)]), sigma**2 * np.eye(2), given_deg * DEG)
    assert found is not None
    ratio = abs(found.latitude - given_deg * DEG) / found.sigma
    assert ratio == pytest.approx(abs(math.cos(L) - math.cos(given_deg * DEG)) / sigma, rel=1e-6)


@pytest.mark.parametrize(
    ("e_h", "sigma", "given_deg"),
    [((0.0, 0.0), 0.5, 40.0), ((0.0, 0.7), 0.2, 40.0), ((0.0, 1.0), 0.001, 0.0),
     ((0.0, 0.7), math.nan, 40.0)],
)  # fmt: skip
def test_no_latitude_where_nothing_is_known(
    e_h: tuple[float, float], sigma: float, given_deg: float
) -> None:
    assert latitude_of_axis(np.array(e_h), sigma**2 * np.eye(2), given_deg * DEG) is None


def test_length_error_is_what_a_filter_with_it_as_a_state_finds() -> None:
    """Friedland: a filter without it, and V, against the filter with it."""
    rng = np.random.default_rng(5)
    n, variance = 4, 0.3
    P_free = np.diag([1.0, 2.0, 0.5, variance])
    x_free, x, P = np.zeros(n), np.zeros(n), np.diag([1.0, 2.0, 0.5, 0.0])
    length = LengthError(np.eye(n)[3], 0.0, variance)
    for _ in range(20):
        A = np.vstack([np.eye(n) + 0.1 * rng.normal(size=(n, n)), np.zeros((3, n))])
        A[n - 1] = np.eye(n)[n - 1]
        H = np.hstack([rng.normal(size=(3, n)), np.zeros((3, 3))])
        z = rng.normal(size=3)
        Q = np.diag([0.1, 0.1, 0.1, 0.0])

        def step(x: Any, P: Any, A: Any = A, H: Any = H, z: Any = z, Q: Any = Q) -> Any:
            F, M = A[:n], H[:, :n]
            x, P = F @ x, F @ P @ F.T + Q
            inverse = np.linalg.inv(M @ P @ M.T + np.eye(3))
            gain, value = P @ M.T @ inverse, z - M @ x
            return x + gain @ value, P - gain @ M @ P, gain, value, inverse

        length.propagate(A)
        x, P, gain, value, inverse = step(x, P)
        length.update(H, gain, value, inverse)
        x_free, P_free, *_ = step(x_free, P_free)
    assert length.r == pytest.approx(x_free[3])
    assert 1.0 / length.information == pytest.approx(P_free[3, 3])
    np.testing.assert_allclose(x + length.V * length.r, x_free)


def found(scenario: str, grade: str, seed: int) -> tuple[LatitudeEstimate, float]:
    """The last one, and the true one [rad]."""
    run = vehicle(scenario, 150.0, rate_hz=50.0, grade=grade, seed=seed)
    _, updates = align(run, method="wander_kf", latitude_check="fail")
    assert not any("latitude_wrong" in u.status.keys for u in updates)
    last = [u.estimate.latitude for u in updates if u.estimate is not None][-1]
    assert last is not None
    return last, run.options.latitude_deg * DEG


@pytest.mark.parametrize("grade", ["fog", "rlg"])
@pytest.mark.parametrize("scenario", ["ring", "static", "urban"])
def test_latitude_is_honest(scenario: str, grade: str) -> None:
    """Two-sided 99.9 % bounds of the mean normalised square, and no false alarm."""
    square = []
    for seed in range(SEEDS):
        own, true = found(scenario, grade, seed)
        assert own.sigma < 0.25 * DEG
        square.append(((own.latitude - true) / own.sigma) ** 2)
    assert 0.02 < np.mean(square) < 4.1


@pytest.mark.parametrize("off_deg", [1.0, -1.0])
@pytest.mark.parametrize("scenario", ["ring", "static"])
def test_a_wrong_latitude_is_found_before_aligned_is_claimed(scenario: str, off_deg: float) -> None:
    for seed in range(SEEDS):
        run = vehicle(scenario, 150.0, rate_hz=50.0, grade="rlg", seed=seed)
        latitude = run.options.latitude_deg + off_deg
        session, updates = align(
            run, latitude_deg=latitude, latitude_check="fail", heading_threshold_arcmin=10.0,
            level_threshold_arcsec=60.0,
        )  # fmt: skip
        assert session.status.state is State.FAILED
        assert "latitude_wrong" in session.status.keys
        assert State.ALIGNED not in {u.status.state for u in updates}


def test_methods_without_a_free_axis_tell_no_latitude() -> None:
    run = vehicle("static", 60.0)
    for parameters in ({"method": "wander_ekf"}, {"coarse": "inertial"}):
        session, _ = align(run, **parameters)
        assert session.estimate is not None and session.estimate.latitude is None


def test_a_latitude_that_is_far_out_is_named_though_there_is_no_heading() -> None:
    run = vehicle("urban", 120.0, rate_hz=50.0)
    session, _ = align(run, latitude_deg=run.options.latitude_deg + 10.0)
    assert session.estimate is None
    assert "latitude_doubted" in session.status.keys
