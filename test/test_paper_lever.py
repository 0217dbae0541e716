"""Lever arm by least squares: regressors, the claim of section 3.4, honesty of sigma."""

from __future__ import annotations

import numpy as np
import pytest

from sins_align.rotation import dcm_from_quaternion, exp_rotation, skew
from sins_align.simulate import SwingOptions
from sins_align.simulate.random_streams import random_streams
from sins_align.simulate.swing import swing_base
from sins_align.swing.paper_lever import (
    LeverRegression,
    RegressionNoise,
    level_matrix,
    lever_matrix,
)
from sins_align.types import Array

G = 9.80
LEVER = np.array([2.0, -4.0, 3.0])
QUIET = RegressionNoise(force=2e-4, bias=0.0, slope=0.0, lag=0.0)
MM = 1e-3


def swing(seed: int, scenario: str = "pitch", duration: float = 40.0) -> tuple[Array, ...]:
    """C_nb, w, dw, f every 0.1 s, perfect but for 20 ug of accelerometer noise."""
    options = SwingOptions(scenario=scenario, seed=seed)
    t = np.arange(0.0, duration, 0.1)
    C_nb, w, dw = swing_base(options, random_streams(seed)).attitude(t)
    H1 = skew(w.T) @ skew(w.T) + skew(dw.T)
    f = (H1 @ LEVER).T + G * C_nb[2]
    noise = 2e-4 * np.random.default_rng(seed).normal(size=f.shape)
    return C_nb, w, dw, f + noise


def regression(name: str, noise: RegressionNoise = QUIET, **prior: object) -> LeverRegression:
    settings = {"prior": np.zeros(3), "prior_sigma": 10.0, **prior}
    return LeverRegression(G, name == "epls", noise=noise, **settings)  # type: ignore[arg-type]


def misaligned(C_nb: Array, psi: Array) -> Array:
    return np.einsum("ij,jkn->ikn", exp_rotation(psi), C_nb)


def solve(name: str, seed: int, psi: Array):
    C_nb, w, dw, f = swing(seed)
    fit = regression(name)
    fit.add(misaligned(C_nb, psi), w, dw, f, 0.0 * dw)
    return fit.solve()


def test_regressors_are_derivatives_of_the_measurement() -> None:
    rng = np.random.default_rng(0)
    w, dw = rng.normal(size=(2, 3))
    Q = rng.normal(size=4)
    C_true = dcm_from_quaternion(Q / np.linalg.norm(Q))

    def y(r: Array, psi: Array) -> Array:
        """f + C_bn_estimated g_n of a body that swings with the lever arm r."""
        swing_force = np.cross(w, np.cross(w, r)) + np.cross(dw, r)
        f = swing_force + G * C_true[2]
        return f - G * (exp_rotation(psi) @ C_true)[2]

    step, zero = 1e-3, np.zeros(3)
    for i in range(3):
        e = np.eye(3)[i]
        by_lever = (y(step * e, zero) - y(-step * e, zero)) / (2.0 * step)
        column = lever_matrix(w[:, np.newaxis], dw[:, np.newaxis])[0, :, i]
        np.testing.assert_allclose(column, by_lever, atol=1e-11)
    for i in range(2):
        e = np.eye(3)[i]
        by_tilt = (
            8.0 * (y(zero, step * e) - y(zero, -step * e))
            - (y(zero, 2.0 * step * e) - y(zero, -2.0 * step * e))
        ) / (12.0 * step)
        column = level_matrix(C_true[:, :, np.newaxis], G)[0, :, i]
        np.testing.assert_allclose(column, by_tilt, atol=1e-10)


def test_misalignment_columns_unbias_the_lever_arm() -> None:
    """Theorem 3: with a level misalignment of 1 deg the plain least squares are biased."""
    psi = np.radians([1.0, -1.0, 0.0])
    errors = {
        name: np.array([solve(name, s, psi).lever_arm.r_b - LEVER for s in range(20)])
        for name in ("ls", "epls")
    }
    plain, extended = (np.abs(errors[name].mean(axis=0)).max() for name in ("ls", "epls"))
    assert plain > 10 * MM
    assert extended < 1 * MM


def test_level_misalignment_is_found_with_its_sign() -> None:
    psi = np.radians([0.1, -0.2, 0.0])
    np.testing.assert_allclose(solve("epls", 1, psi).level, psi[:2], rtol=0, atol=2e-5)
    np.testing.assert_array_equal(solve("ls", 1, psi).level, 0.0)


def test_covariance_is_honest_without_misalignment() -> None:
    squares = []
    for seed in range(100):
        lever = solve("epls", seed, np.zeros(3)).lever_arm
        error = lever.r_b - LEVER
        squares.append(error @ np.linalg.solve(lever.covariance, error))
    # Chi-square of 300 degrees of freedom over 300, 1 % to 99 % is 0.81 to 1.20.
    assert 0.75 < np.mean(squares) / 3.0 < 1.25


def test_covariance_covers_the_lag() -> None:
    C_nb, w, dw, f = swing(0, "erect")
    lag = 1e-3
    ddw = np.gradient(dw, 0.1, axis=1)
    fit = regression("epls", QUIET._replace(lag=lag))
    fit.add(C_nb, w, dw - lag * ddw, f, ddw)
    lever = fit.solve().lever_arm
    error = lever.r_b - LEVER
    assert np.linalg.norm(error) > 1 * MM
    assert 0.3 < error @ np.linalg.solve(lever.covariance, error) < 5.0


def test_restart_forgets() -> None:
    data = swing(0)
    fit, fresh = regression("epls"), regression("epls")
    fit.add(*swing(1), 0.0 * data[1][:, :400])
    fit.restart()
    for one in (fit, fresh):
        one.add(*data, 0.0 * data[1])
    np.testing.assert_array_equal(fit.solve().lever_arm.r_b, fresh.solve().lever_arm.r_b)


def test_without_data_the_prior() -> None:
    lever = regression("epls", prior=np.array([1.0, 2.0, 3.0]), prior_sigma=0.5).solve().lever_arm
    np.testing.assert_allclose(lever.r_b, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(lever.covariance, 0.25 * np.eye(3))
    assert lever.observable == (False, False, False)


@pytest.mark.parametrize("seed", range(3))
def test_a_swing_about_one_axis_leaves_the_lever_arm_along_it_at_the_prior(seed: int) -> None:
    C_nb, w, dw, f = swing(seed, "single_axis")
    fit = regression("epls", QUIET._replace(slope=1e-6), prior=np.array([7.0, 0.0, 0.0]))
    fit.add(C_nb, w, dw, f, 0.0 * dw)
    lever = fit.solve().lever_arm
    assert lever.observable == (False, True, True)
    assert lever.r_b[0] == pytest.approx(7.0, abs=1e-3)
    assert np.sqrt(lever.covariance[0, 0]) == pytest.approx(10.0)
    np.testing.assert_allclose(lever.r_b[1:], LEVER[1:], atol=20 * MM)


def test_an_exact_prior_is_kept() -> None:
    C_nb, w, dw, f = swing(0)
    fit = regression("epls", prior=np.array([1.0, 1.0, 1.0]), prior_sigma=0.0)
    fit.add(C_nb, w, dw, f, 0.0 * dw)
    np.testing.assert_allclose(fit.solve().lever_arm.r_b, 1.0, atol=1e-3)
