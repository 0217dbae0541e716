"""What the large-azimuth error model is held against: a pair of non-linear mechanisations.

Of two ENU mechanisations one is fed with the samples as they are, one with the errors taken out of
samples and start: what is computed stays, the truth is varied. It shares no line with the blocks.
Derivatives are central differences about small errors of zero, at a finite azimuth error U.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from large_azimuth_blocks import (
    ACCEL_BIAS,
    ATTITUDE,
    GYRO_BIAS,
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
