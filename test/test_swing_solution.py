"""One more parameter beside a solution, and the covariance of sums that were never solved."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from swing_filtered import OPTIONS, Filtered, filter_run

from sins_align.swing.excitation import LeverDirections
from sins_align.swing.latitude import latitude_column
from sins_align.swing.solution import KAPPA, X_BG, X_G, X_R, Prior, Solver
from sins_align.swing.two_stage import DATA
from sins_align.types import Array

# Of kappa, v0, b_g and delta_g alone.
PLAIN = np.r_[0:6, X_BG, X_G]


@functools.cache
def swing() -> Filtered:
    return filter_run(replace(OPTIONS, scenario="pitch", seed=2))


@functools.cache
def weak() -> Filtered:
    """On a still base the accelerometer bias is considered, not estimated."""
    return filter_run(replace(OPTIONS, scenario="still", seed=2))


def latitude(filtered: Filtered) -> Array:
    column = latitude_column(filtered.solution, filtered.gravity.latitude)
    assert column is not None
    return column


def plain(filtered: Filtered) -> Filtered:
    """The same with lever arm and accelerometer bias known exactly: nothing is considered."""
    variance = filtered.prior.variance.copy()
    variance[6:9] = variance[12:15] = 0.0
    mean = filtered.prior.mean.copy()
    mean[X_R] = filtered.truth.r_b
    prior = Prior(mean, variance)
    lever = LeverDirections(np.zeros((3, 0)), np.zeros((3, 0)))
    solver = Solver(prior, lever, filtered.truth.R)
    start = replace(filtered.solution, x=mean)
    solution = solver.solve(filtered.filter.normal, start)
    return replace(filtered, prior=prior, lever=lever, solver=solver, solution=solution)


def information(filtered: Filtered) -> Array:
    """Of `PLAIN`, with its prior, at the solution."""
    solution = replace(filtered.solution, R=filtered.truth.R)
    J = solution.jacobian[:, PLAIN]
    A = filtered.filter.normal[:-1, :-1]
    N = J.T @ A @ J
    variance = filtered.prior.variance[PLAIN]
    N[variance > 0.0, variance > 0.0] += 1.0 / variance[variance > 0.0]
    return N


def moved_data(normal: Array, column: Array, by: float) -> Array:
    """The sums, had theta been theta + column * by beyond what the model knows."""
    other = normal.copy()
    other[:-1, DATA] += normal[:-1, :-1] @ column * by
    other[DATA, :-1] = other[:-1, DATA]
    return other


@pytest.mark.parametrize("base", [swing, weak])
def test_score_is_the_joint_least_squares(base: object) -> None:
    filtered = plain(base())  # type: ignore[operator]
    column, normal = latitude(filtered), filtered.filter.normal
    y, sigma, response = filtered.solver.score(normal, filtered.solution, column)
    solution = replace(filtered.solution, R=filtered.truth.R)
    A, J = normal[:-1, :-1], solution.jacobian[:, PLAIN]
    cross = J.T @ A @ column
    joint = np.block([[information(filtered), cross[:, None]], [cross[None], column @ A @ column]])
    residual = A @ filtered.solution.theta + normal[:-1, DATA]
    variance, x = filtered.prior.variance, filtered.solution.x - filtered.prior.mean
    known = variance > 0.0
    pull = np.zeros_like(x)
    pull[known] = x[known] / variance[known]
    gradient = np.append(J.T @ residual + pull[PLAIN], column @ residual)
    scale = 1.0 / np.sqrt(joint.diagonal())
    scaled = np.linalg.inv(joint * np.outer(scale, scale)) * np.outer(scale, scale)
    assert y == pytest.approx(-(scaled @ gradient)[-1], rel=1e-6, abs=1e-6 * sigma)
    assert sigma == pytest.approx(np.sqrt(scaled[-1, -1]), rel=1e-6)
    assert np.abs(response[PLAIN] - scaled[:-1, -1] / scaled[-1, -1]).max() < (
        1e-6 * np.abs(response).max()
    )
    assert not response[X_R].any() and not response[12:15].any()


@pytest.mark.parametrize("base", [swing, weak])
def test_score_finds_what_was_put_in(base: object) -> None:
    """Moved data give another solution, by the response, and a score less by what moved."""
    filtered = base()  # type: ignore[operator]
    column, normal = latitude(filtered), filtered.filter.normal
    y, sigma, response = filtered.solver.score(normal, filtered.solution, column)
    step = 3.0 * sigma
    other = moved_data(normal, column, step)
    solution = filtered.solver.solve(other, filtered.solution, iterations=20)
    moved_y, moved_sigma, _ = filtered.solver.score(other, solution, column)
    assert moved_y == pytest.approx(y - step, abs=0.03 * sigma)
    assert moved_sigma == pytest.approx(sigma, rel=0.01)
    kappa = solution.R @ filtered.solution.R.T
    turned = 0.5 * np.array(
        [kappa[2, 1] - kappa[1, 2], kappa[0, 2] - kappa[2, 0], kappa[1, 0] - kappa[0, 1]]
    )
    assert np.abs(turned - step * response[KAPPA]).max() < 0.02 * np.abs(turned).max()
    assert np.abs(turned).max() > 1e-7


def test_what_is_considered_counts_in_sigma() -> None:
    """An accelerometer bias of one sigma moves the score by its share of sigma."""
    filtered, exact = weak(), plain(weak())
    column, normal = latitude(filtered), filtered.filter.normal
    y, sigma, _ = filtered.solver.score(normal, filtered.solution, column)
    _, without, _ = exact.solver.score(normal, exact.solution, column)
    share = 0.0
    for axis in range(3):
        bias = np.zeros(normal.shape[0] - 1)
        bias[18 + axis] = np.sqrt(filtered.prior.variance[12 + axis])
        other = moved_data(normal, bias, 1.0)
        solution = filtered.solver.solve(other, filtered.solution, iterations=20)
        share += (filtered.solver.score(other, solution, column)[0] - y) ** 2
    assert sigma**2 == pytest.approx(without**2 + share, rel=0.02)


@pytest.mark.parametrize("base", [swing, weak])
def test_covariance_is_that_of_the_solution(base: object) -> None:
    filtered = base()  # type: ignore[operator]
    found = filtered.solver.covariance(filtered.filter.normal, filtered.solution)
    expected = filtered.solution.covariance
    scale = np.sqrt(np.outer(expected.diagonal(), expected.diagonal())) + 1e-30
    # The solution's is that of the step before its last, which is small.
    assert np.abs((found - expected) / scale).max() < 1e-4


def test_covariance_does_not_depend_on_the_data() -> None:
    filtered = weak()
    normal = filtered.filter.normal.copy()
    normal[DATA], normal[:, DATA] = 7.0, -3.0
    found = filtered.solver.covariance(normal, filtered.solution)
    assert np.array_equal(
        found, filtered.solver.covariance(filtered.filter.normal, filtered.solution)
    )


def test_covariance_is_the_inverse_of_the_information() -> None:
    filtered = plain(swing())
    found = filtered.solver.covariance(filtered.filter.normal, filtered.solution)
    N = information(filtered)
    scale = 1.0 / np.sqrt(N.diagonal())
    expected = np.linalg.inv(N * np.outer(scale, scale)) * np.outer(scale, scale)
    ratio = found[np.ix_(PLAIN, PLAIN)].diagonal() / expected.diagonal()
    assert np.abs(ratio - 1.0).max() < 1e-6


def test_more_data_are_more_information() -> None:
    """Twice the sums and no prior worth it: half the covariance."""
    filtered = plain(swing())
    open_prior = Prior(filtered.prior.mean, 1e12 * filtered.prior.variance)
    solver = Solver(open_prior, filtered.lever, filtered.truth.R)
    one = solver.covariance(1e9 * filtered.filter.normal, filtered.solution)
    two = solver.covariance(2e9 * filtered.filter.normal, filtered.solution)
    assert one[KAPPA, KAPPA] == pytest.approx(2.0 * two[KAPPA, KAPPA], rel=1e-3)


@pytest.mark.parametrize("factor", [0.0, np.nan, np.inf])
def test_a_parameter_that_the_data_do_not_tell_has_no_score(factor: float) -> None:
    filtered = swing()
    with np.errstate(invalid="ignore"):
        column = factor * np.where(latitude(filtered) == 0.0, 0.0, 1.0)
        with pytest.raises(np.linalg.LinAlgError):
            filtered.solver.score(filtered.filter.normal, filtered.solution, column)


def test_sums_that_are_no_squares_have_no_score() -> None:
    filtered = plain(swing())
    column, normal = latitude(filtered), filtered.filter.normal.copy()
    normal[:-1, :-1] -= 2.0 * np.outer(column, column) * (column @ normal[:-1, :-1] @ column)
    with pytest.raises(np.linalg.LinAlgError):
        filtered.solver.score(normal, filtered.solution, column)
