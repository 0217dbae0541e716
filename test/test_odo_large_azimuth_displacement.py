"""The large-azimuth model's measurement, a second's displacement, against two mechanisations."""

from __future__ import annotations

import math
from collections.abc import Callable

import large_azimuth_blocks as blocks
import numpy as np
import pytest
from large_azimuth_blocks import ACCEL_BIAS, EXTENDED, GYRO_BIAS, PATH, SCALE, SIZE, VELOCITY
from large_azimuth_reference import (
    AZIMUTH_ERRORS,
    CASES,
    DEG_PER_HOUR,
    DEGREE,
    MILLIMETRE,
    Case,
    Second,
    after_coarse,
    by_small_errors,
    every_case,
    every_motion,
    relative,
    travel,
    with_azimuth,
)

from sins_align.types import Array


def exact_z(second: Second) -> Array:
    return blocks.odometer_z(second.x, second.D)


def odometer_z(second: Second) -> Array:
    U = second.x[0]
    return blocks.odometer_h(U, second.D) + blocks.odometer_H(U, second.D) @ second.x


def paper_z(second: Second, v: Array | None = None) -> Array:
    """(25), (26) with dv at the end of the second; v the true mean velocity, if not given."""
    U, x = second.x[0], second.x
    if v is None:
        v = second.path_true
    H = np.pad(blocks.eq25_H_true(U, v), ((0, 0), (0, EXTENDED - SIZE)))
    return blocks.eq26_h_true(U, v) + H @ x


def paper_z_with_path(second: Second, v: Array | None = None) -> Array:
    """The same with d for dv."""
    return paper_z(second, v) - second.x[VELOCITY] + second.x[PATH]


MEASUREMENTS = {"exact": exact_z, "odometer": odometer_z, "of true v, with d": paper_z_with_path}


# Columns, and the agreement reached, relative to the block: phi_l and dv turn within the second by
# the Earth's rate times U. At the largest U; for U of 0.05 4e-5, 2e-6, 4e-6.
MEASURED = {
    "phi_l": (slice(1, 3), 2e-4),
    "dv": (VELOCITY, 1e-4),
    "nabla": (ACCEL_BIAS, 5e-5),
    "dK": (SCALE, 2e-4),
}


@every_motion
@pytest.mark.parametrize("U", AZIMUTH_ERRORS)
def test_displacement(case: Case, U: float) -> None:
    """z by the errors at the start, through those at the end, against z itself."""
    forms = tuple(MEASUREMENTS.values())

    def all_z(x: Array) -> Array:
        second = travel(case, x)
        return np.concatenate([second.z] + [form(second) for form in forms])

    expected, *results = np.split(by_small_errors(all_z, with_azimuth(U)), 1 + len(forms))
    for form, got in zip(MEASUREMENTS, results, strict=True):
        for name, (columns, tolerance) in MEASURED.items():
            assert relative(got[:, columns], expected[:, columns]) < tolerance, (form, name)
        # H has no eps: the attitude is that of the end, half a second of eps turns D before.
        without = got[:, GYRO_BIAS] - expected[:, GYRO_BIAS]
        assert np.abs(without).max() * 0.02 * DEG_PER_HOUR < 1e-3 * MILLIMETRE


@every_case
@pytest.mark.parametrize("U", AZIMUTH_ERRORS)
def test_displacement_by_azimuth_alone(case: Case, U: float) -> None:
    """phi_l grows by up to 2 sin(U/2) Omega, which half a second multiplies by D."""
    second = travel(case, with_azimuth(U))
    distance = float(np.linalg.norm(second.D))
    bound = 2.0 * abs(math.sin(U / 2.0)) * 8e-5 * 0.5 * distance + 1e-4 * MILLIMETRE
    for form in MEASUREMENTS.values():
        assert np.abs(second.z - form(second)).max() < bound


def worst(U: float, residual: Callable[[Second], Array]) -> float:
    """Over the motions, with the errors after a coarse alignment: [m]."""
    return max(
        float(np.abs(residual(travel(case, after_coarse(case, U)))).max())
        for case in CASES.values()
    )


def test_what_each_measurement_leaves() -> None:
    """At 3 deg, 15 to 20 m/s: what is left of a second's displacement."""
    U = 3.0 * DEGREE
    assert worst(U, lambda second: second.z - exact_z(second)) < 0.03 * MILLIMETRE
    # dK phi_l only, as dK enters linearly.
    assert worst(U, lambda second: second.z - paper_z_with_path(second)) < 0.1 * MILLIMETRE
    # dK^2 D: 1 % of 1 % of 19 m.
    assert worst(U, lambda second: second.z - odometer_z(second)) < 2.5 * MILLIMETRE


def test_velocity_at_the_end_is_not_its_mean() -> None:
    """(25) as the paper uses it: (I - Rz(U)) times the acceleration times half a second."""
    assert worst(3.0 * DEGREE, lambda second: second.z - paper_z(second)) > 50.0 * MILLIMETRE


@pytest.mark.parametrize(
    "velocity", [lambda second: second.D, lambda second: second.path_true + second.x[PATH]]
)
def test_true_velocity_is_meant(velocity: Callable[[Second], Array]) -> None:
    """(26), (38) with the odometer's, or the computed, in place of the true velocity."""

    def residual(second: Second) -> Array:
        return second.z - paper_z_with_path(second, velocity(second))

    assert worst(3.0 * DEGREE, residual) > 50.0 * MILLIMETRE
