"""What Wu, Tang and Huang print of the large-azimuth model, where it does not agree."""

from __future__ import annotations

import math

import large_azimuth_blocks as blocks
import numpy as np
import pytest
from large_azimuth_blocks import POSITION, SCALE
from large_azimuth_reference import (
    BLOCKS,
    SEMI_MAJOR,
    Case,
    by_small_errors,
    cross_matrix,
    every_case,
    every_motion,
    reference_rates,
    relative,
    travel,
    with_azimuth,
)

from sins_align.types import Array


def cross_matrix_times(case: Case, matrix: list[list[float]]) -> Array:
    return cross_matrix(case.start.v_n) @ np.array(matrix)


def coriolis(case: Case) -> Array:
    at = case.computed
    return cross_matrix(at.w_in + blocks.earth_rate_n(at.latitude))


def eq12_printed(case: Case, U: float) -> Array:
    """w_in for w~_in: M2' less (I - Rz(U)) dw_en."""
    D = blocks.transport_by_velocity(case.computed)
    return (blocks.turn(U) @ D - (np.eye(3) - blocks.turn(U)) @ D)[blocks.U_FIRST]


def eq14_printed(case: Case, U: float) -> Array:
    """One radius; 6378 km."""
    D = np.array([[0, -1, 0], [1, 0, 0], [math.tan(case.latitude), 0, 0]])
    return (blocks.turn(U) @ D)[blocks.U_FIRST] / (SEMI_MAJOR + case.start.place[2])


def eq16_printed_M5(case: Case, U: float) -> Array:
    D = blocks.transport_by_velocity(case.computed)
    return -coriolis(case) - cross_matrix(case.start.v_n) @ D


def eq32_printed(case: Case, U: float) -> Array:
    meridian, transverse = case.computed.radii
    tangent = math.tan(case.latitude)
    return -coriolis(case) - cross_matrix_times(
        case,
        [[0.0, -1 / meridian, 0.0], [-1 / transverse, 0.0, 0.0], [tangent / transverse, 0.0, 0.0]],
    )


def eq16_printed_M6(case: Case, U: float) -> Array:
    return -blocks.eq33_M6(case.computed)


def eq33_printed(case: Case, U: float) -> Array:
    at = case.computed
    twice = 2.0 * blocks.earth_by_position(at) + blocks.transport_by_position(at)
    return -cross_matrix_times(
        case, [[0.0, 0.0, 0.0], [0.0, -twice[1, 1], 0.0], [0.0, twice[2, 1], 0.0]]
    )


def eq33_outer_sign_alone(case: Case, U: float) -> Array:
    """What is printed with the outer sign put right, and nothing else."""
    return -eq33_printed(case, U)


def eq27_printed_eps(case: Case, U: float) -> Array:
    return case.start.C_nb[blocks.U_FIRST]


def eq27_printed_nabla(case: Case, U: float) -> Array:
    return case.start.C_nb


def not_euler(case: Case, U: float) -> Array:
    """(28) of I - C_n^n' alone, its first row the rate about up and not that of U."""
    M1 = blocks.eq28_M1(U, case.computed)
    w_E, w_N, _ = case.computed.w_in
    M1[0, 2] = -math.cos(U) * w_E - math.sin(U) * w_N
    return M1


# By how much of its block what is printed is off, at the least over all motions, for U of 0.5.
MISPRINTS = {
    "(12) w": (eq12_printed, "M2'", 0.3),
    "(14) R": (eq14_printed, "M2'", 2e-3),
    "(16) dv": (eq16_printed_M5, "M5'", 0.02),
    "(16) dP": (eq16_printed_M6, "M6'", 1.99),
    "(32)": (eq32_printed, "M5'", 0.01),
    "(33)": (eq33_printed, "M6'", 0.9),
    "(33) outer sign": (eq33_outer_sign_alone, "M6'", 0.07),
    "(27) eps": (eq27_printed_eps, "eps", 1.99),
    "(27) nabla": (eq27_printed_nabla, "nabla", 0.4),
    "(28) not Euler": (not_euler, "M1'", 0.15),
}


@every_case
@pytest.mark.parametrize("name", MISPRINTS)
def test_misprint_does_not_agree(case: Case, name: str) -> None:
    function, block, least = MISPRINTS[name]
    rows, columns, tolerance = BLOCKS[block]
    U = 0.5
    expected = by_small_errors(lambda y: reference_rates(case, y), with_azimuth(U))
    if columns == POSITION:
        expected[:, POSITION] -= blocks.left_out_by_position(U, case.computed)
    off = relative(function(case, U), expected[rows, columns])
    assert off > least > tolerance


@every_motion
def test_scale_is_not_positive(case: Case) -> None:
    """(39) as printed has twice the displacement's size amiss."""
    U = 0.5
    by_K = by_small_errors(lambda y: travel(case, y).z, with_azimuth(U))[:, SCALE]
    v = travel(case, with_azimuth(U)).path_true
    assert relative(blocks.eq39_H2_true(U, v)[:, None], by_K) < 1e-4
    assert relative(-blocks.eq39_H2_true(U, v)[:, None], by_K) > 1.99
