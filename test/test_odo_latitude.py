"""The latitude that the data tell of themselves: honest, and a wrong one is found in time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from odo_sessions import align, vehicle

from sins_align.latitudes import combine_latitudes
from sins_align.odo.epoch import integrate_epoch
from sins_align.odo.latitude import LengthError, latitude_of_axis, latitude_of_length
from sins_align.odo.pairing import Paired
from sins_align.odo.standing_latitude import StandingLatitude
from sins_align.types import ImuBlock, LatitudeEstimate, State
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


def test_at_the_equator_a_perfect_length_has_a_sigma() -> None:
    """Found on the equator and given there: the chord has no slope to divide by."""
    found = latitude_of_length(1.0 + 1e-12, 1e-8, 0.0)
    assert found is not None and found.latitude == 0.0 and np.isfinite(found.sigma)


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


def test_methods_without_a_free_axis_tell_no_latitude_on_a_drive() -> None:
    for scenario, parameters in (
        ("straight", {"method": "wander_ekf"}),
        ("straight", {"coarse": "inertial"}),
    ):
        session, _ = align(vehicle(scenario, 150.0, rate_hz=50.0), **parameters)
        assert session.estimate is not None and session.estimate.latitude is None


def test_a_latitude_that_is_far_out_is_named_though_there_is_no_heading() -> None:
    run = vehicle("urban", 120.0, rate_hz=50.0)
    session, _ = align(run, latitude_deg=run.options.latitude_deg + 10.0)
    assert session.estimate is None
    assert "latitude_doubted" in session.status.keys


# -- by the vertical rate, of a vehicle that stands


def standing(latitude_deg: float, **changes: Any) -> StandingLatitude:
    """What a vehicle that stands for 80 s tells, of a latitude that is given 1 deg too high."""
    run = vehicle("static", 80.0, **{"rate_hz": 50.0, "grade": "rlg", "seed": 6,
                                     "latitude_deg": latitude_deg, **changes})  # fmt: skip
    given = (latitude_deg + 1.0) * DEG
    watch = StandingLatitude(run.options.imu_grade, given)
    imu, size = run.imu, 50
    for k in range(0, len(imu) - size, size):
        block = ImuBlock(*(x[..., k : k + size + 1] for x in imu))
        watch.add(integrate_epoch(Paired(block, None, None, 0.0), run.options.imu_sampling), True)
    return watch


@pytest.mark.parametrize("latitude_deg", [-60.0, -30.0, -1.5, 0.3, 45.0])
def test_standing_tells_the_latitude_at_the_equator_too(latitude_deg: float) -> None:
    """The rocking of the vehicle included, which the simulator lets be 5 arcsec."""
    square = []
    for seed in range(SEEDS):
        own = standing(latitude_deg, seed=seed).latitude
        assert own is not None and own.sigma * math.cos(latitude_deg * DEG) < 0.15 * DEG
        square.append(((own.latitude / DEG - latitude_deg) / (own.sigma / DEG)) ** 2)
    assert max(square) < 9.0


def test_the_more_it_rocks_the_less_it_tells() -> None:
    quiet, lively = (standing(10.0, standing_motion_arcsec=x).latitude for x in (0.0, 15.0))
    assert quiet is not None and lively is not None
    assert lively.sigma > 1.3 * quiet.sigma
    assert abs(lively.latitude - 10.0 * DEG) < 3.0 * lively.sigma


def test_who_gets_in_and_out_all_the_time_lets_it_tell_nothing() -> None:
    assert standing(10.0, standing_motion_arcsec=200.0).latitude is None


def test_the_other_hemisphere_is_told() -> None:
    run = vehicle("static", 80.0, rate_hz=50.0, grade="rlg", latitude_deg=35.0)
    session, _ = align(run, latitude_deg=-35.0, latitude_check="warn")
    assert "latitude_differs" in session.status.keys
    own = None if session.estimate is None else session.estimate.latitude
    assert own is not None and abs(own.latitude - 35.0 * DEG) < 5.0 * own.sigma < 1.0 * DEG


def test_two_latitudes_make_one() -> None:
    own, other = LatitudeEstimate(0.5, 0.01), LatitudeEstimate(0.6, 0.02)
    both = combine_latitudes(own, other)
    assert both is not None
    assert both.latitude == pytest.approx(0.52) and both.sigma == pytest.approx(0.01 * 0.8**0.5)
    assert combine_latitudes(own, None) is own and combine_latitudes(None, own) is own
    assert combine_latitudes(None, None) is None
    other = LatitudeEstimate(-0.5, 0.02)
    assert combine_latitudes(own, other) is other
