"""The large-azimuth error model of Wu, Tang and Huang, corrected, against non-linear mechanisation.

The reference is a pair of ENU mechanisations, one fed with the samples as they are, one with the
errors taken out of samples and start: what is computed stays, the truth is varied. It shares no
line with the blocks. Derivatives are central differences about small errors of zero, at a finite
azimuth error U. The last tests show that what the paper prints instead does not agree.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import large_azimuth_blocks as blocks
import numpy as np
import pytest
from large_azimuth_blocks import (
    ACCEL_BIAS,
    ATTITUDE,
    EXTENDED,
    GYRO_BIAS,
    PATH,
    POSITION,
    SCALE,
    SIZE,
    VELOCITY,
    Computed,
)
from scipy.spatial.transform import Rotation

from sins_align.types import Array

EARTH_RATE = 7.292115e-5
SEMI_MAJOR = 6378137.0
FLATTENING = 1.0 / 298.257223563
E2 = FLATTENING * (2.0 - FLATTENING)

DEGREE = math.pi / 180.0
DEG_PER_HOUR = DEGREE / 3600.0
MICRO_G = 9.80665e-6
MILLIMETRE = 1e-3

AZIMUTH_ERRORS = (0.0, 0.05, 0.5, -1.2, 2.8)


# The reference.


class Strapdown(NamedTuple):
    """State of a mechanisation; `place` is longitude, latitude, height."""

    C_nb: Array
    v_n: Array
    place: Array


def cross_matrix(v: Array) -> Array:
    return np.cross(np.eye(3), v)


def gravity(latitude: float, h: float) -> float:
    """WGS-84, closed formula of Somigliana and free air to second order."""
    square, x = math.sin(latitude) ** 2, h / SEMI_MAJOR
    surface = 9.7803253359 * (1.0 + 1.931852652458e-3 * square) / math.sqrt(1.0 - E2 * square)
    air = 1.0 + FLATTENING + 3.449786506841e-3 - 2.0 * FLATTENING * square
    return surface * (1.0 - 2.0 * x * air + 3.0 * x * x)


def mechanise(state: Strapdown, w_b: Array, f_b: Array) -> Strapdown:
    """Derivative of the state."""
    (_, latitude, h), (east, north, up) = state.place, state.v_n
    root = 1.0 - E2 * math.sin(latitude) ** 2
    transverse = SEMI_MAJOR / math.sqrt(root) + h
    meridian = SEMI_MAJOR * (1.0 - E2) / root**1.5 + h
    cosine, sine = math.cos(latitude), math.sin(latitude)
    w_ie = EARTH_RATE * np.array([0.0, cosine, sine])
    w_en = np.array([-north / meridian, east / transverse, east * sine / cosine / transverse])
    return Strapdown(
        state.C_nb @ cross_matrix(w_b) - cross_matrix(w_ie + w_en) @ state.C_nb,
        state.C_nb @ f_b
        - np.cross(2.0 * w_ie + w_en, state.v_n)
        - [0.0, 0.0, gravity(latitude, h)],
        np.array([east / cosine / transverse, north / meridian, up]),
    )


def true_misalignment(x: Array) -> Array:
    """C_n^n' of Euler angles: turned by U about up, by phi_E about x, by phi_N about y."""
    U, phi_E, phi_N = x[ATTITUDE]
    return Rotation.from_euler("YXZ", [-phi_N, -phi_E, -U]).as_matrix()


def attitude_errors(C: Array) -> Array:
    """U, phi_E, phi_N of C_n^n'."""
    return np.array(
        [math.atan2(-C[1, 0], C[1, 1]), math.asin(C[1, 2]), math.atan2(-C[0, 2], C[2, 2])]
    )


class Case(NamedTuple):
    """What is computed at the start, and the motion: acceleration in n, rate in b."""

    latitude: float
    rpy: tuple[float, float, float]
    v_n: tuple[float, float, float]
    acceleration: tuple[float, float, float]
    turn: tuple[float, float, float]

    @property
    def start(self) -> Strapdown:
        C_nb = Rotation.from_euler("ZYX", self.rpy[::-1]).as_matrix()
        return Strapdown(C_nb, np.array(self.v_n), np.array([0.0, self.latitude, 300.0]))

    def w_b(self, t: float) -> Array:
        return np.array(self.turn) * (1.0 + 0.3 * t)

    def f_b(self, t: float) -> Array:
        f_n = np.add(self.acceleration, [0.0, 0.0, 9.79])
        return self.start.C_nb.T @ f_n + 0.2 * t * np.array([1.0, -1.0, 0.5])

    @property
    def computed(self) -> Computed:
        return Computed(
            self.start.C_nb, self.f_b(0.0), self.start.v_n, self.latitude, self.start.place[2]
        )


MOTIONS = (
    ((0.02, -0.05, 1.1), (12.0, 9.0, 0.5), (1.5, -0.8, 0.3), (0.01, -0.02, 0.2)),
    ((-0.2, 0.3, -2.4), (-19.0, 6.0, -1.0), (-0.5, 2.5, -0.4), (0.05, 0.03, -0.3)),
    ((3.0, 0.1, 0.3), (3.0, -14.0, 0.2), (2.0, 1.0, 0.1), (-0.02, 0.01, 0.25)),
)
CASES = {
    f"{latitude} deg, motion {number}": Case(latitude * DEGREE, *motion)
    for latitude in (-35, 10, 60)
    for number, motion in enumerate(MOTIONS)
}
every_case = pytest.mark.parametrize("case", CASES.values(), ids=CASES)
every_motion = pytest.mark.parametrize("case", list(CASES.values())[::4], ids=list(CASES)[::4])


def truth(case: Case, x: Array) -> Strapdown:
    """What is computed, less its errors."""
    start = case.start
    return Strapdown(
        true_misalignment(x).T @ start.C_nb, start.v_n - x[VELOCITY], start.place - x[POSITION]
    )


def reference_rates(case: Case, x: Array) -> Array:
    """Rates of the nine errors, of the pair of mechanisations."""
    w_b, f_b = case.w_b(0.0), case.f_b(0.0)
    computed, true = case.start, truth(case, x)
    d_computed = mechanise(computed, w_b, f_b)
    d_true = mechanise(true, w_b - x[GYRO_BIAS], f_b - x[ACCEL_BIAS])
    C = computed.C_nb @ true.C_nb.T
    dC = d_computed.C_nb @ true.C_nb.T + computed.C_nb @ d_true.C_nb.T
    ahead, behind = attitude_errors(C + dC), attitude_errors(C - dC)  # 1e-4: squares cancel
    return np.concatenate(
        (0.5 * (ahead - behind), d_computed.v_n - d_true.v_n, d_computed.place - d_true.place)
    )


# Wide enough for the digits, and so small that third powers do not matter.
STEPS = np.ones(SIZE)
STEPS[ATTITUDE] = 1e-4
STEPS[VELOCITY] = 0.1
STEPS[POSITION] = 1e-4, 1e-4, 10.0
STEPS[GYRO_BIAS] = 1e-6
STEPS[ACCEL_BIAS] = 1e-3
STEPS[SCALE] = 1e-3


def with_azimuth(U: float) -> Array:
    x = np.zeros(SIZE)
    x[0] = U
    return x


def by_small_errors(function: Callable[[Array], Array], x: Array) -> Array:
    """Central differences; the column of U is left zero."""
    columns = [np.zeros_like(function(x))]
    for k in range(1, SIZE):
        step = STEPS[k] * np.eye(SIZE)[k]
        columns.append((function(x + step) - function(x - step)) / (2.0 * STEPS[k]))
    return np.stack(columns, axis=1)


def relative(got: Array, expected: Array) -> float:
    return float(np.linalg.norm(got - expected) / np.linalg.norm(expected))


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


# Rows, columns, and what the block agrees to, relative to its norm: the differences' own error.
BLOCKS = {
    "M1'": (ATTITUDE, ATTITUDE, 5e-8),
    "M2'": (ATTITUDE, VELOCITY, 5e-8),
    "M3'": (ATTITUDE, POSITION, 5e-8),
    "eps": (ATTITUDE, GYRO_BIAS, 5e-8),
    "M4'": (VELOCITY, ATTITUDE, 5e-9),
    "M5'": (VELOCITY, VELOCITY, 2e-10),
    "M6'": (VELOCITY, POSITION, 2e-9),
    "nabla": (VELOCITY, ACCEL_BIAS, 2e-12),
    "M7'": (POSITION, VELOCITY, 1e-14),
    "M8'": (POSITION, POSITION, 1e-7),
}
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


def after_coarse(case: Case, U: float) -> Array:
    """Errors of a start with odometer velocity and the attitude's error U, fog grade."""
    x = with_azimuth(U)
    x[1:3] = 3e-4, -2e-4
    x[VELOCITY] = case.start.v_n - true_misalignment(x).T @ case.start.v_n
    x[POSITION] = 2e-6, -1e-6, 5.0
    x[GYRO_BIAS] = np.array([0.02, -0.02, 0.02]) * DEG_PER_HOUR
    x[ACCEL_BIAS] = np.array([100.0, -100.0, 100.0]) * MICRO_G
    x[SCALE] = 0.01
    return x


@every_case
@pytest.mark.parametrize("form", [full_rates, linear_rates])
def test_all_errors_together(case: Case, form: Callable[[Case, Array], Array]) -> None:
    """U of 3 deg: what products of small errors leave, gravity's change with height apart."""
    x = after_coarse(case, 3.0 * DEGREE)
    amiss = form(case, x) - reference_rates(case, x)
    amiss[5] += blocks.left_out_by_position(x[0], case.computed)[5] @ x[POSITION]
    assert np.abs(amiss[ATTITUDE]).max() < 1.5e-5 * DEG_PER_HOUR
    assert np.abs(amiss[VELOCITY]).max() < 0.12 * MICRO_G


# The measurement: a second of both mechanisations.


class Second(NamedTuple):
    """The pair after a second: the model's errors at its end, and what was travelled meanwhile."""

    x: Array  # (19,), with d
    z: Array  # computed displacement less the odometer's
    D: Array  # the odometer's, in n'
    path_true: Array


def travel(case: Case, x: Array, steps: int = 10) -> Second:
    """Runge and Kutta. dS~ = (1 + dK) C_n^b v dt goes into D = integral of C_b^n' dS~."""

    def pack(computed: Strapdown, true: Strapdown, *paths: Array) -> Array:
        return np.concatenate([np.ravel(part) for part in (*computed, *true, *paths)])

    def split(y: Array) -> tuple[Strapdown, Strapdown, Array]:
        one, two = y[:15], y[15:30]
        return (
            Strapdown(one[:9].reshape(3, 3), one[9:12], one[12:]),
            Strapdown(two[:9].reshape(3, 3), two[9:12], two[12:]),
            y[30:],
        )

    def rates(y: Array, t: float) -> Array:
        computed, true, _ = split(y)
        w_b, f_b = case.w_b(t), case.f_b(t)
        counted = (1.0 + x[SCALE]) * (computed.C_nb @ true.C_nb.T @ true.v_n)
        return pack(
            mechanise(computed, w_b, f_b),
            mechanise(true, w_b - x[GYRO_BIAS], f_b - x[ACCEL_BIAS]),
            computed.v_n,
            true.v_n,
            counted,
        )

    y = pack(case.start, truth(case, x), np.zeros(9))
    dt = 1.0 / steps
    for k in range(steps):
        t = k * dt
        one = rates(y, t)
        two = rates(y + 0.5 * dt * one, t + 0.5 * dt)
        three = rates(y + 0.5 * dt * two, t + 0.5 * dt)
        four = rates(y + dt * three, t + dt)
        y = y + dt / 6.0 * (one + 2.0 * two + 2.0 * three + four)
    computed, true, (*paths,) = split(y)
    path, path_true, D = np.reshape(paths, (3, 3))
    end = np.concatenate(
        (
            attitude_errors(computed.C_nb @ true.C_nb.T),
            computed.v_n - true.v_n,
            computed.place - true.place,
            x[GYRO_BIAS],
            x[ACCEL_BIAS],
            x[SCALE],
            path - path_true,
        )
    )
    return Second(end, path - D, D, path_true)


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


# What is printed, where it does not agree.


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
