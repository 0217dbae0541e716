"""The large-azimuth error model of Wu, Tang and Huang, corrected, against non-linear mechanisation.

Rates of the errors, block by block; the moments at the end.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import large_azimuth_blocks as blocks
import numpy as np
import pytest
from large_azimuth_blocks import ACCEL_BIAS, ATTITUDE, POSITION, VELOCITY
from large_azimuth_reference import (
    AZIMUTH_ERRORS,
    BLOCKS,
    CASES,
    DEG_PER_HOUR,
    DEGREE,
    MICRO_G,
    Case,
    after_coarse,
    by_small_errors,
    every_case,
    reference_rates,
    relative,
    truth,
    with_azimuth,
)

from sins_align.types import Array


def full_rates(case: Case, x: Array) -> Array:
    """(12), (16), (17)."""
    at = case.computed
    phi_EN_U = blocks.eq12_attitude_rate(x, at)
    return np.concatenate(
        (
            phi_EN_U[blocks.U_FIRST],
            blocks.eq16_velocity_rate(x, at),
            blocks.eq17_position_rate(x, at),
        )
    )


def linear_rates(case: Case, x: Array) -> Array:
    """(23), (24)."""
    at = case.computed
    return (blocks.eq23_F(x[0], at) @ x + blocks.eq24_g(x[0], at))[:9]


G_ATTITUDE, G_VELOCITY = 5e-8, 1e-13
NOTHING = 1e-12  # blocks that are zero


@every_case
@pytest.mark.parametrize("form", [full_rates, linear_rates])
@pytest.mark.parametrize("U", AZIMUTH_ERRORS)
def test_blocks(case: Case, form: Callable[[Case, Array], Array], U: float) -> None:
    x = with_azimuth(U)
    expected = by_small_errors(lambda y: reference_rates(case, y), x)
    got = by_small_errors(lambda y: form(case, y), x)
    got[:, POSITION] += blocks.left_out_by_position(U, case.computed)
    elsewhere = np.ones_like(expected, dtype=bool)
    for name, (rows, columns, tolerance) in BLOCKS.items():
        assert relative(got[rows, columns], expected[rows, columns]) < tolerance, name
        elsewhere[rows, columns] = False
    assert np.abs(expected[elsewhere]).max() < NOTHING
    assert not got[elsewhere].any()


@every_case
@pytest.mark.parametrize("form", [full_rates, linear_rates])
@pytest.mark.parametrize("U", AZIMUTH_ERRORS)
def test_rates_by_azimuth_alone(case: Case, form: Callable[[Case, Array], Array], U: float) -> None:
    x = with_azimuth(U)
    expected, got = reference_rates(case, x), form(case, x)
    if U == 0.0:
        assert np.abs(expected).max() < NOTHING
        assert not got.any()
        return
    assert relative(got[ATTITUDE], expected[ATTITUDE]) < G_ATTITUDE
    assert relative(got[VELOCITY], expected[VELOCITY]) < G_VELOCITY
    assert not got[POSITION].any()


def test_left_out_by_position_is_small() -> None:
    """After 64 m, or at 10 m of height error; in the vertical gravity's change is the largest."""
    for column, error, gyro, level, vertical in (
        (1, 1e-5, 5e-8 * DEG_PER_HOUR, 3e-7 * MICRO_G, 0.06 * MICRO_G),
        (2, 10.0, 2e-6 * DEG_PER_HOUR, 2e-5 * MICRO_G, 3.5 * MICRO_G),
    ):
        for case in CASES.values():
            for U in AZIMUTH_ERRORS:
                left = np.abs(blocks.left_out_by_position(U, case.computed)[:, column] * error)
                assert left[ATTITUDE].max() < gyro
                assert left[3:5].max() < level
                assert left[5] < vertical


# Second order: the matrix of nabla at finite phi_l, and all errors together.


@every_case
@pytest.mark.parametrize("U", AZIMUTH_ERRORS)
def test_accelerometer_bias_at_finite_tilt(case: Case, U: float) -> None:
    """(16): C_n'^n to phi_l^2; the printed third column and row are off by phi_l."""
    x = with_azimuth(U)
    x[ATTITUDE] = U, 0.010, -0.015

    def printed(y: Array) -> Array:
        matrix = blocks.turn(y[0]).T
        matrix[0, 2] = matrix[1, 2] = y[1] * math.sin(y[0])
        return matrix @ case.start.C_nb

    expected = by_small_errors(lambda y: reference_rates(case, y), x)[VELOCITY, ACCEL_BIAS]
    got = blocks.eq16_nabla(*x[ATTITUDE]) @ case.start.C_nb
    assert relative(got, expected) < 2e-4
    assert relative(printed(x), expected) > 1e-2


@every_case
@pytest.mark.parametrize("form", [full_rates, linear_rates])
def test_all_errors_together(case: Case, form: Callable[[Case, Array], Array]) -> None:
    """U of 3 deg: what products of small errors leave, gravity's change with height apart."""
    x = after_coarse(case, 3.0 * DEGREE)
    amiss = form(case, x) - reference_rates(case, x)
    amiss[5] += blocks.left_out_by_position(x[0], case.computed)[5] @ x[POSITION]
    assert np.abs(amiss[ATTITUDE]).max() < 1.5e-5 * DEG_PER_HOUR
    assert np.abs(amiss[VELOCITY]).max() < 0.12 * MICRO_G


@pytest.mark.parametrize("sigma", [0.05, 0.5])
def test_reduced_moments_are_those_of_all_dimensions(sigma: float) -> None:
    """(40) to (57) of seven nodes in U against a product of seven nodes in each of four states."""
    nodes, weights = rule = blocks.eq2_rule(7)
    rng = np.random.default_rng(1)
    mean = np.array([0.3, -0.1, 0.2, 0.4])
    root = np.tril(rng.normal(size=(4, 4)))
    root[0] = [sigma, 0.0, 0.0, 0.0]
    F0, F1, F2 = rng.normal(size=(3, 3, 4))

    def model(U: float) -> tuple[Array, Array]:
        g = np.array([1.0 - math.cos(U), math.sin(U), U])
        return F0 + math.cos(U) * F1 + math.sin(U) * F2, g

    P = root @ root.T
    S = np.linalg.cholesky(P)
    x = np.stack([mean + S @ nodes[list(k)] for k in np.ndindex(7, 7, 7, 7)])
    W = np.array([weights[list(k)].prod() for k in np.ndindex(7, 7, 7, 7)])
    y = np.stack([F @ point + g for point in x for F, g in [model(point[0])]])
    y_mean = W @ y
    got = blocks.eq40_57_moments(model, mean, P, rule)
    expected = y_mean, (y - y_mean).T * W @ (y - y_mean), (x - mean).T * W @ (y - y_mean)
    assert weights.sum() == pytest.approx(1.0)
    for one, other in zip(got, expected, strict=True):
        assert np.abs(one - other).max() < 1e-11


def test_azimuth_error_is_that_of_the_heading() -> None:
    """U > 0: the computed heading, clockwise from north, is too large."""
    case = next(iter(CASES.values()))
    forward = np.array([1.0, 0.0, 0.0])
    x = with_azimuth(0.1)
    east, north, _ = case.start.C_nb @ forward
    east_true, north_true, _ = truth(case, x).C_nb @ forward
    assert math.atan2(east, north) - math.atan2(east_true, north_true) == pytest.approx(0.1)
