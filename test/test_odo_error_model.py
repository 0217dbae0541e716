"""Every block of the wander-azimuth error model against a non-linear propagation.

The reference integrates the strapdown equations in the wander frame, in small steps and from
analytic rates; it shares no line with the package. It is itself checked against the same
motion integrated in Earth-fixed axes, where there is no wander frame, no transport rate and
no radius of curvature.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sins_align.odo.epoch import AidedEpoch, integrate_epoch
from sins_align.odo.error_model import ErrorModel, ImuNoise, white_noise
from sins_align.odo.layout import (
    ACCEL_BIAS,
    AZIMUTH,
    GYRO_BIAS,
    GYRO_TURN,
    PHI,
    SIZE,
    VELOCITY,
    path_of,
)
from sins_align.odo.navigation import WanderNavigation
from sins_align.odo.pairing import Paired
from sins_align.types import Array, ImuBlock, ImuSampling, Position

EARTH_RATE = 7.292115e-5
SEMI_MAJOR = 6378137.0
FLATTENING = 1.0 / 298.257223563
E2 = FLATTENING * (2.0 - FLATTENING)

PATH = path_of(SIZE)
EXTENDED = PATH.stop
DURATION = 1.0
RATE_HZ = 200
ALTITUDE = 200.0
# ODO.md: every block to 2e-3 of its size.
BLOCK_TOLERANCE = 2e-3
MICRO_RADIAN = 1e-6

State = tuple[Array, ...]  # C_ab (K, 3, 3), v_a, e_a (K, 3), altitude (K,), path (K, 3)


class Manoeuvre(NamedTuple):
    """A second of driving: the rates grow linearly, the speed too."""

    latitude: float
    azimuth: float
    speed: float
    acceleration: float
    turn: tuple[float, float]  # yaw rate and its derivative

    def w_b(self, t: float) -> Array:
        rate, growth = self.turn
        return np.array([0.01, -0.02 * math.cos(2.0 * t), rate + growth * t])

    def f_b(self, t: float) -> Array:
        speed = self.speed + self.acceleration * t
        return np.array([self.acceleration + 0.3, speed * self.w_b(t)[2], 9.79])

    @property
    def C_ab(self) -> Array:
        """Nose up by 3 deg, and banked."""
        return Rotation.from_euler("ZYX", [1.1, -0.05, 0.02]).as_matrix()

    @property
    def v_a(self) -> Array:
        return self.C_ab @ [self.speed, 0.0, 0.0]

    @property
    def e_a(self) -> Array:
        s, c = math.sin(self.azimuth), math.cos(self.azimuth)
        cos_latitude = math.cos(self.latitude)
        return np.array([cos_latitude * s, cos_latitude * c, math.sin(self.latitude)])


MANOEUVRES = {
    "turning": Manoeuvre(math.radians(40.0), 0.7, 12.0, 1.0, (0.2, 0.03)),
    "braking": Manoeuvre(math.radians(-60.0), -2.0, 20.0, -2.0, (-0.1, 0.02)),
    "slow": Manoeuvre(math.radians(75.0), 2.5, 5.0, 0.3, (-0.25, -0.01)),
}


def cross_matrix(v: Array) -> Array:
    rows = [[0 * v[:, 0], -v[:, 2], v[:, 1]], [v[:, 2], 0 * v[:, 0], -v[:, 0]]]
    rows.append([-v[:, 1], v[:, 0], 0 * v[:, 0]])
    return np.moveaxis(np.array(rows), -1, 0)


def gravity(sine: Array, h: Array) -> Array:
    """WGS-84, closed formula of Somigliana and free air to second order."""
    square, x = sine**2, h / SEMI_MAJOR
    surface = 9.7803253359 * (1.0 + 1.931852652458e-3 * square) / np.sqrt(1.0 - E2 * square)
    air = 1.0 + FLATTENING + 3.449786506841e-3 - 2.0 * FLATTENING * square
    return surface * (1.0 - 2.0 * x * air + 3.0 * x * x)


def rates(state: State, w: Array, f: Array) -> State:
    """Derivatives of the state; rates w and specific forces f (K, 3)."""
    C, v, e, h, _ = state
    root = 1.0 - E2 * e[:, 2] ** 2
    transverse = SEMI_MAJOR / np.sqrt(root)
    meridian = transverse * (1.0 - E2) / root
    north = e[:, :2] / np.linalg.norm(e[:, :2], axis=1, keepdims=True)
    v_north = (north * v[:, :2]).sum(axis=1, keepdims=True) * north
    v_east = v[:, :2] - v_north
    over = v_north / (meridian + h)[:, None] + v_east / (transverse + h)[:, None]
    w_ea = np.stack((-over[:, 1], over[:, 0], 0.0 * h), axis=1)
    w_ie = EARTH_RATE * e
    dC = C @ cross_matrix(w) - cross_matrix(w_ie + w_ea) @ C
    dv = np.einsum("kij,kj->ki", C, f) - np.cross(2.0 * w_ie + w_ea, v)
    dv[:, 2] -= gravity(e[:, 2], h)
    return dC, dv, -np.cross(w_ea, e), v[:, 2], v


def runge_kutta(function, state: State, steps: int) -> State:
    """function(state, t) integrated over the epoch."""
    dt = DURATION / steps

    def beyond(rate: State, factor: float) -> State:
        return tuple(x + factor * dx for x, dx in zip(state, rate, strict=True))

    for k in range(steps):
        t = k * dt
        one = function(state, t)
        two = function(beyond(one, 0.5 * dt), t + 0.5 * dt)
        three = function(beyond(two, 0.5 * dt), t + 0.5 * dt)
        four = function(beyond(three, dt), t + dt)
        state = tuple(
            x + dt / 6.0 * (a + 2.0 * b + 2.0 * c + d)
            for x, a, b, c, d in zip(state, one, two, three, four, strict=True)
        )
    return state


class Errors(NamedTuple):
    """Perturbations (K, 3) of start and sensors; `axis` that of e_a."""

    phi: Array
    velocity: Array
    axis: Array
    gyro: Array
    accel: Array


def propagate(manoeuvre: Manoeuvre, errors: Errors, steps: int = 100) -> State:
    C = Rotation.from_rotvec(-errors.phi).as_matrix() @ manoeuvre.C_ab
    start = (
        C,
        manoeuvre.v_a + errors.velocity,
        manoeuvre.e_a + errors.axis,
        np.full(len(C), ALTITUDE),
        np.zeros((len(C), 3)),
    )
    return runge_kutta(
        lambda state, t: rates(
            state, manoeuvre.w_b(t) + errors.gyro, manoeuvre.f_b(t) + errors.accel
        ),
        start,
        steps,
    )


# Wide enough for the digits, and so small that third powers do not matter.
STEPS = {
    "phi": 1e-4,
    "velocity": 0.1,
    "azimuth": 1e-3,
    "gyro_bias": 1e-6,
    "accel_bias": 1e-3,
    "gyro_turn": 1e-5,
}
COLUMNS = {
    "phi": PHI,
    "velocity": VELOCITY,
    "azimuth": AZIMUTH,
    "gyro_bias": GYRO_BIAS,
    "accel_bias": ACCEL_BIAS,
    "gyro_turn": GYRO_TURN,
}
ROWS = {"phi": PHI, "velocity": VELOCITY, "path": PATH}


def two_states(_: Manoeuvre) -> Array:
    return np.eye(2)


def one_state(manoeuvre: Manoeuvre) -> Array:
    """e_h = cos L (sin alpha, cos alpha) by alpha; the second state is none."""
    ex, ey, _ = manoeuvre.e_a
    return np.array([[ey, 0.0], [-ex, 0.0]])


BASES = {"two": two_states, "one": one_state}


def perturbed(column: str, x: float, basis: Array, rate: float) -> Errors:
    """Three perturbations of size x, one a column; of two for the azimuth."""
    zero, each = np.zeros((3, 3)), x * np.eye(3)
    axis = np.zeros((3, 3))
    axis[:2, :2] = x * basis.T
    return Errors(
        phi=each if column == "phi" else zero,
        velocity=each if column == "velocity" else zero,
        axis=axis if column == "azimuth" else zero,
        gyro=each if column == "gyro_bias" else rate * each if column == "gyro_turn" else zero,
        accel=each if column == "accel_bias" else zero,
    )


def difference(plus: State, minus: State, x: float) -> dict[str, Array]:
    """Central difference: by row, (3, K); and that of e_a."""
    # C_plus C_minus' = I - [2 phi x]
    phi = -Rotation.from_matrix(plus[0] @ minus[0].transpose(0, 2, 1)).as_rotvec()
    pairs = {"phi": (phi, 0.0), "velocity": (plus[1], minus[1]), "path": (plus[4], minus[4])}
    pairs["axis"] = plus[2], minus[2]
    return {row: ((a - b) / (2.0 * x)).T for row, (a, b) in pairs.items()}


@cache
def numeric(name: str, column: str, states: str = "two") -> dict[str, Array]:
    manoeuvre, x = MANOEUVRES[name], STEPS[column]
    basis, rate = BASES[states](manoeuvre), epoch_and_rate(name)[1]
    plus, minus = (
        propagate(manoeuvre, perturbed(column, sign * x, basis, rate)) for sign in (1.0, -1.0)
    )
    return difference(plus, minus, x)


@cache
def epoch_and_rate(name: str) -> tuple[AidedEpoch, float]:
    """The epoch as the filter sees it, and the mean rate about the vertical."""
    manoeuvre = MANOEUVRES[name]
    n = round(DURATION * RATE_HZ)
    t = np.arange(n + 1) / RATE_HZ
    w = np.stack([manoeuvre.w_b(x) for x in t], axis=1)
    f = np.stack([manoeuvre.f_b(x) for x in t], axis=1)
    block = ImuBlock(np.rint(t * 1e9).astype(np.int64), w, f)
    epoch = integrate_epoch(Paired(block, None, None, 0.0), ImuSampling.INSTANTANEOUS)
    return epoch, float(manoeuvre.C_ab[2] @ w.mean(axis=1))


@cache
def model(name: str, states: str = "two") -> Array:
    manoeuvre = MANOEUVRES[name]
    epoch, rate = epoch_and_rate(name)
    navigation = WanderNavigation(
        manoeuvre.C_ab, manoeuvre.v_a, Position(manoeuvre.latitude, 0.0, ALTITUDE)
    )
    navigation.e_a = manoeuvre.e_a
    course = navigation.advance(epoch)
    axis = np.zeros((3, 2))
    axis[:2] = BASES[states](manoeuvre)
    return ErrorModel(ImuNoise(0.0, 0.0, 0.0), SIZE).transition(epoch, course, axis, rate).copy()


def earth_axes(latitude: float, azimuth: float) -> Array:
    """C_ea at longitude 0."""
    s, c = math.sin(latitude), math.cos(latitude)
    C_en = np.array([[0.0, -s, c], [1.0, 0.0, 0.0], [0.0, c, s]])
    return C_en @ Rotation.from_rotvec([0.0, 0.0, azimuth]).as_matrix()


def geodetic(r: Array) -> tuple[float, float, float]:
    horizontal = math.hypot(r[0], r[1])
    latitude = math.atan2(r[2], horizontal * (1.0 - E2))
    for _ in range(6):
        n = SEMI_MAJOR / math.sqrt(1.0 - E2 * math.sin(latitude) ** 2)
        latitude = math.atan2(r[2] + E2 * n * math.sin(latitude), horizontal)
    n = SEMI_MAJOR / math.sqrt(1.0 - E2 * math.sin(latitude) ** 2)
    h = horizontal * math.cos(latitude) + r[2] * math.sin(latitude) - SEMI_MAJOR**2 / n
    return latitude, math.atan2(r[1], r[0]), h


def earth_fixed_rates(state: State, w: Array, f: Array) -> State:
    """C_eb, v_e, r_e."""
    C, v, r = state
    w_ie = np.array([[0.0, 0.0, EARTH_RATE]])
    latitude, longitude, h = geodetic(r[0])
    up = np.array(
        [
            math.cos(latitude) * math.cos(longitude),
            math.cos(latitude) * math.sin(longitude),
            math.sin(latitude),
        ]
    )
    pull = -gravity(np.array([math.sin(latitude)]), np.array([h])) * up
    dC = C @ cross_matrix(w) - cross_matrix(w_ie) @ C
    return dC, (C[0] @ f[0] - 2.0 * np.cross(w_ie[0], v[0]) + pull)[None], v


@pytest.mark.parametrize("name", MANOEUVRES)
def test_reference_agrees_with_earth_fixed_axes(name: str) -> None:
    """Heights, speeds and the angles to the Earth's axis: all that does not need a."""
    manoeuvre = MANOEUVRES[name]
    none = Errors(*np.zeros((5, 1, 3)))
    C, v, e, h, _ = (x[0] for x in propagate(manoeuvre, none))
    C_ea = earth_axes(manoeuvre.latitude, manoeuvre.azimuth)
    np.testing.assert_allclose(C_ea[2], manoeuvre.e_a, atol=1e-15)
    n = SEMI_MAJOR / math.sqrt(1.0 - E2 * math.sin(manoeuvre.latitude) ** 2)
    position = np.array(
        [
            [
                (n + ALTITUDE) * math.cos(manoeuvre.latitude),
                0.0,
                (n * (1.0 - E2) + ALTITUDE) * math.sin(manoeuvre.latitude),
            ]
        ]
    )
    start = ((C_ea @ manoeuvre.C_ab)[None], (C_ea @ manoeuvre.v_a)[None], position)
    C_eb, v_e, r_e = (
        x[0]
        for x in runge_kutta(
            lambda state, t: earth_fixed_rates(
                state, manoeuvre.w_b(t)[None], manoeuvre.f_b(t)[None]
            ),
            start,
            100,
        )
    )
    latitude, longitude, height = geodetic(r_e)
    assert math.asin(e[2]) == pytest.approx(latitude, abs=1e-13)
    assert h == pytest.approx(height, abs=1e-8)
    C_en = Rotation.from_rotvec([0, 0, longitude]).as_matrix() @ earth_axes(latitude, 0.0)
    C_na = Rotation.from_rotvec([0, 0, math.atan2(e[0], e[1])]).as_matrix()
    np.testing.assert_allclose(C_na @ C, C_en.T @ C_eb, atol=1e-11)
    np.testing.assert_allclose(C_na @ v, C_en.T @ v_e, atol=1e-8)


def relative(block: Array, reference: Array) -> float:
    return float(np.linalg.norm(block - reference) / np.linalg.norm(reference))


# Of these the model says nothing, or what they are beyond the unit matrix: by their effect.
SMALL = {("phi", "phi"), ("phi", "velocity"), ("phi", "accel_bias")}
BLOCKS = [(row, column) for row in ROWS for column in COLUMNS if (row, column) not in SMALL]


@pytest.mark.parametrize("name", MANOEUVRES)
@pytest.mark.parametrize(("row", "column"), BLOCKS)
def test_block(name: str, row: str, column: str) -> None:
    reference = numeric(name, column)[row]
    if column == "azimuth":
        reference = reference[:, :2]
    assert relative(model(name)[ROWS[row], COLUMNS[column]], reference) < BLOCK_TOLERANCE


@pytest.mark.parametrize("name", MANOEUVRES)
@pytest.mark.parametrize("row", ROWS)
def test_block_of_one_azimuth_state(name: str, row: str) -> None:
    reference = numeric(name, "azimuth", "one")[row][:, :2]
    block = model(name, "one")[ROWS[row], AZIMUTH]
    assert relative(block, reference) < BLOCK_TOLERANCE
    assert not block[:, 1].any()


@pytest.mark.parametrize("name", MANOEUVRES)
def test_frame_turns_below_the_misalignment(name: str) -> None:
    """dphi/dt = -w_ia x phi; the rest is Schuler's, g T / R, and Coriolis' share of it."""
    beyond = numeric(name, "phi")["phi"] - np.eye(3)
    np.testing.assert_allclose(
        model(name)[PHI, PHI] - np.eye(3), beyond, rtol=0.0, atol=2.0 * MICRO_RADIAN
    )
    assert np.abs(beyond).max() > 20.0 * MICRO_RADIAN


@pytest.mark.parametrize("name", MANOEUVRES)
def test_transport_rate_of_a_velocity_error(name: str) -> None:
    """Of one radius for both directions: half a percent at most."""
    reference = numeric(name, "velocity")["phi"]
    assert relative(model(name)[PHI, VELOCITY], reference) < 7e-3


@pytest.mark.parametrize("name", MANOEUVRES)
def test_coriolis_of_a_velocity_error(name: str) -> None:
    """Of T w_2 itself, and not of the unit matrix with it."""
    beyond = numeric(name, "velocity")["velocity"] - np.eye(3)
    assert relative(model(name)[VELOCITY, VELOCITY] - np.eye(3), beyond) < 2e-2


@pytest.mark.parametrize("name", MANOEUVRES)
def test_velocity_of_an_accelerometer_bias_turns_the_frame(name: str) -> None:
    """Left out: half a second of velocity over the radius."""
    assert np.abs(numeric(name, "accel_bias")["phi"]).max() < 0.1 * MICRO_RADIAN
    assert not model(name)[PHI, ACCEL_BIAS].any()


@pytest.mark.parametrize("name", MANOEUVRES)
@pytest.mark.parametrize("column", COLUMNS)
def test_axis_error_stays(name: str, column: str) -> None:
    """The horizontal part of e_a keeps its error, and no other error gets into it.

    Left out: dw_ea x e, as much as the vehicle is lost by over the Earth's radius.
    """
    reference = numeric(name, column)["axis"][:2]
    if column == "azimuth":
        np.testing.assert_allclose(reference[:, :2], np.eye(2), atol=MICRO_RADIAN)
    else:
        assert np.abs(reference).max() < MICRO_RADIAN
    expected = np.eye(2) if column == "azimuth" else 0.0
    assert np.all(model(name)[AZIMUTH, COLUMNS[column]] == expected)


def test_sign_of_phi() -> None:
    """C_estimated = (I - [phi x]) C_true: a tilt about x to the east gives f x phi."""
    A = model("slow")
    # phi = (1, 0, 0) with f = (0, 0, g): f x phi = (0, g, 0).
    assert A[VELOCITY, PHI][1, 0] == pytest.approx(9.8 * DURATION, rel=0.02)


def test_rest_of_the_transition() -> None:
    """Sensor errors stay, and nothing else touches them."""
    A = model("turning")
    assert A.shape == (EXTENDED, SIZE)
    sensors = slice(GYRO_BIAS.start, GYRO_TURN.stop)
    np.testing.assert_array_equal(A[sensors, sensors], np.eye(9))
    A_of_sensors = A[sensors].copy()
    A_of_sensors[:, sensors] = 0.0
    assert not A_of_sensors.any()


NOISE = ImuNoise(gyro=3e-6, accel=5e-4, gyro_walk=2e-8)


def test_white_noise_against_its_integral() -> None:
    """Q = int Phi G G' Phi' dt with Phi of phi, dv, d under gravity, by small steps."""
    T, g = 1.3, 9.7803253359
    F = np.zeros((9, 9))
    F[3:6, :3] = [[0.0, -g, 0.0], [g, 0.0, 0.0], [0.0, 0.0, 0.0]]
    F[6:, 3:6] = np.eye(3)
    # F^3 = 0: the exponential ends after three terms.
    x, weight = np.polynomial.legendre.leggauss(5)
    spectrum = np.diag([NOISE.gyro**2] * 3 + [NOISE.accel**2] * 3 + [0.0] * 3)
    Q = np.zeros((9, 9))
    for tau, part in zip(0.5 * T * (x + 1.0), 0.5 * T * weight, strict=True):
        step = np.eye(9) + F * tau + 0.5 * F @ F * tau**2
        Q += part * step @ spectrum @ step.T
    np.testing.assert_allclose(white_noise(NOISE, T), Q, rtol=1e-12, atol=1e-12 * Q.max())


def test_white_noise_of_the_propagation_itself() -> None:
    """Monte Carlo: noise on the samples of a standing IMU, through the non-linear equations."""
    runs, steps = 2000, 40
    rng = np.random.default_rng(7)
    scale = 1.0 / math.sqrt(DURATION / steps)
    gyro = rng.normal(scale=NOISE.gyro * scale, size=(steps, runs, 3))
    accel = rng.normal(scale=NOISE.accel * scale, size=(steps, runs, 3))
    still = MANOEUVRES["turning"]
    C0 = Rotation.from_euler("Z", 1.1).as_matrix()

    def at(state: State, t: float) -> State:
        # The stages of a step share its noise: a step's end belongs to it.
        k = step_of[0]
        w, f = np.zeros(3) + gyro[k], np.array([0.0, 0.0, 9.8]) + accel[k]
        return rates(state, w, f)

    state: State = (
        np.broadcast_to(C0, (runs, 3, 3)),
        np.zeros((runs, 3)),
        np.broadcast_to(still.e_a, (runs, 3)),
        np.full(runs, ALTITUDE),
        np.zeros((runs, 3)),
    )
    step_of = [0]
    dt = DURATION / steps
    for k in range(steps):
        step_of[0] = k
        first = at(state, 0.0)
        middle = tuple(x + 0.5 * dt * dx for x, dx in zip(state, first, strict=True))
        state = tuple(x + dt * dx for x, dx in zip(state, at(middle, 0.0), strict=True))
    C_mean = Rotation.from_matrix(state[0]).mean()
    phi = -(Rotation.from_matrix(state[0]) * C_mean.inv()).as_rotvec()
    errors = np.concatenate((phi, state[1], state[4]), axis=1)
    sample = np.cov(errors.T)
    sigma = np.sqrt(np.diag(white_noise(NOISE, DURATION)))
    expected = white_noise(NOISE, DURATION) / np.outer(sigma, sigma)
    # A correlation from 2000 runs is known to 0.022; 4.5 sigma of 81 of them.
    np.testing.assert_allclose(sample / np.outer(sigma, sigma), expected, atol=0.14)


def test_noise_goes_where_it_belongs() -> None:
    P = ErrorModel(NOISE, SIZE).noise(0.9).copy()
    order = np.r_[PHI, VELOCITY, PATH]
    np.testing.assert_array_equal(P[np.ix_(order, order)], white_noise(NOISE, 0.9))
    walk = NOISE.gyro_walk**2 * 0.9 * np.eye(3)
    np.testing.assert_allclose(P[GYRO_BIAS, GYRO_BIAS], walk, rtol=1e-12)
    P[np.ix_(order, order)] = 0.0
    P[GYRO_BIAS, GYRO_BIAS] = 0.0
    assert P.shape == (EXTENDED, EXTENDED) and not P.any()
