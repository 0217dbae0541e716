"""The map of the large-azimuth filters' state over one epoch, F(U) x + g(U).

The reference is a pair of non-linear mechanisations: what is computed stays as it is, the truth is
turned by a finite azimuth error U and changed by small errors of everything else. It is the
propagation of test_odo_error_model.py, which shares no line with the package.

Left out of the model on purpose, and bounded here: gravity's change with the place, the products
of two small errors, and of U by phi_l what moves the level axes (below the Earth's rate).
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import large_azimuth_blocks as blocks
import numpy as np
import pytest
from large_azimuth_maps import MILLIMETRE, at_angle, every_angle, keep, turn
from scipy.spatial.transform import Rotation
from test_odo_error_model import (
    ALTITUDE,
    BLOCK_TOLERANCE,
    E2,
    EARTH_RATE,
    MANOEUVRES,
    MICRO_RADIAN,
    SEMI_MAJOR,
    Manoeuvre,
    epoch_and_rate,
    rates,
    relative,
    runge_kutta,
)
from test_odo_wander import EXACT, config

from sins_align.odo.large_azimuth_model import PATH
from sins_align.odo.layout import (
    ACCEL_BIAS,
    ENU_SIZE,
    GYRO_BIAS,
    GYRO_TURN,
    ODOMETER,
    PHI,
    PLACE,
    VELOCITY,
    U,
)
from sins_align.odo.moments import ConditionallyLinear
from sins_align.odo.navigation import WanderNavigation
from sins_align.odo.odometer_model import POSITION, OdometerModel
from sins_align.types import Array, Position

LEVELS = slice(0, 2)
every_manoeuvre = pytest.mark.parametrize("name", MANOEUVRES)


# -- reference


class Small(NamedTuple):
    """Small errors (K, 3) of everything but U: the third of phi is not used."""

    phi: Array
    velocity: Array
    place: Array
    gyro: Array
    accel: Array


def place_of(manoeuvre: Manoeuvre) -> tuple[Array, float]:
    """North in a, and the meridian's radius."""
    north = np.array([math.sin(manoeuvre.azimuth), math.cos(manoeuvre.azimuth), 0.0])
    root = 1.0 - E2 * math.sin(manoeuvre.latitude) ** 2
    return north, SEMI_MAJOR * (1.0 - E2) / root**1.5 + ALTITUDE


def end_errors(manoeuvre: Manoeuvre, angle: float, small: Small, steps: int = 60) -> Array:
    """(K, 11) at the end: phi_E, phi_N, U, dv (3), path (3), to the north, up.

    Computed is the manoeuvre; true is what remains when the errors are taken off.
    """
    zero = np.zeros((1, 3))
    north, radius = place_of(manoeuvre)
    # The computed state is one more row, without any error.
    phi = np.concatenate((small.phi, zero))
    count = len(phi)
    C_turned = np.broadcast_to(turn(angle), (count, 3, 3)).copy()
    C_turned[-1] = np.eye(3)
    C_errors = Rotation.from_rotvec(-phi).as_matrix() @ C_turned
    latitude = manoeuvre.latitude - np.concatenate((small.place, zero)) @ north / radius
    level = np.cos(latitude)[:, None] * north
    e = level + np.sin(latitude)[:, None] * np.array([0.0, 0.0, 1.0])
    height = ALTITUDE - np.concatenate((small.place, zero))[:, 2]
    start = (
        C_errors.transpose(0, 2, 1) @ manoeuvre.C_ab,
        manoeuvre.v_a - np.concatenate((small.velocity, zero)),
        e,
        height,
        np.zeros((count, 3)),
    )
    gyro, accel = (np.concatenate((x, zero)) for x in (small.gyro, small.accel))
    C, v, e, h, path = runge_kutta(
        lambda state, t: rates(state, manoeuvre.w_b(t) - gyro, manoeuvre.f_b(t) - accel),
        start,
        steps,
    )
    # The true axes are true ENU turned by the computed wander angle.
    wander = np.arctan2(e[:, 0], e[:, 1])
    about = np.zeros((count, 3))
    about[:, 2] = wander - wander[-1]
    back = Rotation.from_rotvec(about).as_matrix()
    # Of the path half of it: it grew on the way.
    half = Rotation.from_rotvec(0.5 * about).as_matrix()
    C, v = back @ C, (back @ v[:, :, None])[:, :, 0]
    path = (half @ path[:, :, None])[:, :, 0]
    off = C[-1] @ C[:-1].transpose(0, 2, 1)
    found = np.empty((count - 1, 11))
    found[:, 0], found[:, 1] = off[:, 1, 2], -off[:, 0, 2]
    found[:, 2] = np.arctan2(off[:, 0, 1] - off[:, 1, 0], off[:, 0, 0] + off[:, 1, 1])
    found[:, 3:6], found[:, 6:9] = v[-1] - v[:-1], path[-1] - path[:-1]
    latitude = np.arctan2(e[:, 2], np.linalg.norm(e[:, :2], axis=1))
    found[:, 9], found[:, 10] = (latitude[-1] - latitude[:-1]) * radius, h[-1] - h[:-1]
    return found


# Wide enough for the digits, and so small that third powers do not matter.
STEPS = {
    "phi": 1e-4,
    "velocity": 0.1,
    "place": 1e3,
    "gyro_bias": 1e-6,
    "accel_bias": 1e-3,
    "gyro_turn": 1e-5,
}
COLUMNS = {
    "phi": LEVELS,
    "velocity": VELOCITY,
    "place": PLACE,
    "gyro_bias": GYRO_BIAS,
    "accel_bias": ACCEL_BIAS,
    "gyro_turn": GYRO_TURN,
}
ROWS = {
    "levels": slice(0, 2),
    "U": slice(2, 3),
    "velocity": slice(3, 6),
    "path": slice(6, 9),
    "place": slice(9, 11),
}


def carried(manoeuvre: Manoeuvre, angle: float) -> Array:
    """dv of a velocity that the computed attitude has carried: as large as the vehicle's, twice."""
    return manoeuvre.v_a - turn(angle).T @ manoeuvre.v_a


def perturbed(name: str, angle: float, sign: float) -> Small:
    """Every column of every error, one a row, and at the end none."""
    manoeuvre, rate = MANOEUVRES[name], epoch_and_rate(name)[1]
    count = 3 * len(STEPS) + 1
    errors = {key: np.zeros((count, 3)) for key in STEPS}
    for k, (key, step) in enumerate(STEPS.items()):
        errors[key][3 * k : 3 * k + 3] = sign * step * np.eye(3)
    errors["phi"][2] = 0.0  # that is U
    return Small(
        errors["phi"],
        carried(manoeuvre, angle) + errors["velocity"],
        errors["place"],
        errors["gyro_bias"] + rate * errors["gyro_turn"],
        errors["accel_bias"],
    )


@cache
def reference(name: str, angle: float) -> tuple[dict[str, Array], Array]:
    """Columns by name (11, 3), of phi (11, 2); and (11,) the errors at the end of U alone."""
    plus, minus = (
        end_errors(MANOEUVRES[name], angle, perturbed(name, angle, sign)) for sign in (1.0, -1.0)
    )
    columns = {}
    for k, (key, step) in enumerate(STEPS.items()):
        rows = slice(3 * k, 3 * k + (2 if key == "phi" else 3))
        columns[key] = ((plus[rows] - minus[rows]) / (2.0 * step)).T
    return columns, plus[-1]


@cache
def state_map(name: str) -> ConditionallyLinear:
    manoeuvre, (epoch, _) = MANOEUVRES[name], epoch_and_rate(name)
    navigation = WanderNavigation(
        manoeuvre.C_ab, manoeuvre.v_a, Position(manoeuvre.latitude, 0.0, ALTITUDE)
    )
    navigation.e_a = manoeuvre.e_a
    return keep(navigation, OdometerModel(config(**EXACT)), epoch).maps[0]


def rows_of(name: str, x: Array) -> Array:
    """A state at the end, or columns of F, in the rows of `end_errors`."""
    north, _ = place_of(MANOEUVRES[name])
    place = x[PLACE]
    return np.concatenate((x[PHI], x[VELOCITY], x[PATH], north[None] @ place, place[2:]))


def model(name: str, angle: float) -> tuple[dict[str, Array], Array]:
    """As `reference`, of the maps."""
    F, g = at_angle(state_map(name), angle)
    x = np.zeros(ENU_SIZE)
    x[U] = angle
    x[VELOCITY] = carried(MANOEUVRES[name], angle)
    columns = {key: rows_of(name, F[:, index]) for key, index in COLUMNS.items()}
    return columns, rows_of(name, (F @ x + g)[:, None])[:, 0]


# -- tests


def below_earth_rate(angle: float) -> float:
    """A product that the model leaves out: the level axes move by so much over the epoch [rad]."""
    return 2.0 * abs(math.sin(0.5 * angle)) * EARTH_RATE


# Of these the model says nothing, what they are beyond the unit matrix, or what is left out.
ELSEWHERE = {("levels", "phi"), ("levels", "velocity"), ("levels", "accel_bias"), ("U", "phi")}
BLOCKS = [
    (row, column)
    for row in ROWS
    for column in COLUMNS
    if (row, column) not in ELSEWHERE and column != "place"
]


# The filter's rate of turning is the sine of the angle, up to 0.25 rad in these epochs; a gyro
# bias gets into the place by a path of half a metre, of which 1.6 mm are amiss: `late`.
TOLERANCES = {"gyro_turn": 1.5e-2, ("path", "gyro_bias"): 3e-3, ("place", "gyro_bias"): 3e-3}


@every_angle
@every_manoeuvre
@pytest.mark.parametrize(("row", "column"), BLOCKS)
def test_block(name: str, angle: float, row: str, column: str) -> None:
    default = TOLERANCES.get(column, BLOCK_TOLERANCE)
    found, expected = (f(name, angle)[0][column][ROWS[row]] for f in (model, reference))
    assert relative(found, expected) < TOLERANCES.get((row, column), default)


@every_angle
@every_manoeuvre
def test_levels(name: str, angle: float) -> None:
    """phi_l by phi_l beyond the unit matrix, by dv (one radius for all), by nabla (left out)."""
    found, expected = model(name, angle)[0], reference(name, angle)[0]
    beyond = expected["phi"][LEVELS] - np.eye(2)
    np.testing.assert_allclose(found["phi"][LEVELS] - np.eye(2), beyond, atol=2.0 * MICRO_RADIAN)
    assert np.abs(beyond).max() > 10.0 * MICRO_RADIAN
    assert relative(found["velocity"][LEVELS], expected["velocity"][LEVELS]) < 7e-3
    assert np.abs(expected["accel_bias"][LEVELS]).max() < 0.1 * MICRO_RADIAN
    assert not found["accel_bias"][LEVELS].any()


@every_angle
@every_manoeuvre
def test_azimuth_by_levels(name: str, angle: float) -> None:
    """Left out: phi_l moves with the Earth's rate when U is finite; 1e-4 of phi_l in a second."""
    found, expected = (f(name, angle)[0]["phi"][ROWS["U"]] for f in (model, reference))
    assert np.abs(found - expected).max() < below_earth_rate(angle) + 0.01 * MICRO_RADIAN


@every_angle
@every_manoeuvre
def test_coriolis_of_a_velocity_error(name: str, angle: float) -> None:
    """Of the level axes, beyond the unit matrix. Left out: (2 dw_ie) x dv, upright."""
    found, expected = (f(name, angle)[0]["velocity"][ROWS["velocity"]] for f in (model, reference))
    beyond = expected[:2, :2] - np.eye(2)
    # 10 %: the shorter of two radii, twice, at 20 m/s.
    assert relative(found[:2, :2] - np.eye(2), beyond) < 0.1
    assert np.abs(found - expected).max() < 2.0 * below_earth_rate(angle) + 5.0 * MICRO_RADIAN


@every_angle
@every_manoeuvre
def test_place_moves_the_axis(name: str, angle: float) -> None:
    """Of one radius, and without what the transport rate makes of it. Gravity is left out."""
    found, expected = model(name, angle)[0]["place"], reference(name, angle)[0]["place"]
    assert relative(found[LEVELS, :2], expected[LEVELS, :2]) < 6e-2
    # tan L by the latitude, at 75 deg and 5 m/s: 2e-12 rad/s for every metre.
    np.testing.assert_allclose(found[U], expected[U], atol=2.5e-12)
    if name != "slow":  # where that is as large as what is left in
        assert relative(found[U : U + 1, :2], expected[U : U + 1, :2]) < 0.5
    assert relative(found[3:5, :2], expected[3:5, :2]) < 0.25
    assert relative(found[6:8, :2], expected[6:8, :2]) < 0.25
    # What is left out is gravity's: upward.
    np.testing.assert_allclose(found[[5, 8]], expected[[5, 8]], atol=3.2e-6)
    # Place by place: to the north, up.
    np.testing.assert_allclose(found[9:], expected[9:], atol=4e-6)


RADIAN_TOLERANCE = 1e-8
METRE_TOLERANCE = 0.1 * MILLIMETRE
SPEED_TOLERANCE = 0.2 * MILLIMETRE  # [m/s]


@every_angle
@every_manoeuvre
def test_azimuth_error_alone(name: str, angle: float) -> None:
    """F x + g with nothing amiss but U, and the velocity that goes with it."""
    found, expected = model(name, angle)[1], reference(name, angle)[1]
    np.testing.assert_allclose(found[:3], expected[:3], rtol=0.0, atol=RADIAN_TOLERANCE)
    np.testing.assert_allclose(found[3:6], expected[3:6], rtol=0.0, atol=SPEED_TOLERANCE)
    np.testing.assert_allclose(found[6:], expected[6:], rtol=0.0, atol=METRE_TOLERANCE)
    if angle:
        # The Earth's rate tips the levels: what is found is not within the tolerance of nothing.
        assert np.abs(expected[LEVELS]).max() > 50.0 * RADIAN_TOLERANCE
        assert np.abs(expected[3:9]).max() > 0.1


def products(manoeuvre: Manoeuvre, angle: float) -> tuple[float, float]:
    """Left out where dv, turned by U, is as large as the velocity: bounds over the epoch.

    (2 dw_ie) x dv, upright, of the velocity [m/s]; and in the path of what turns dv [m].
    """
    velocity = 2.0 * abs(math.sin(0.5 * angle)) * manoeuvre.speed
    return 2.0 * below_earth_rate(angle) * velocity, 1.1 * EARTH_RATE * velocity


@every_angle
@every_manoeuvre
def test_azimuth_error_of_a_velocity_that_is_right(name: str, angle: float) -> None:
    """g itself: components of the velocity as the true ones."""
    none = np.zeros((1, 3))
    expected = end_errors(MANOEUVRES[name], angle, Small(none, none, none, none, none))[0]
    F, g = at_angle(state_map(name), angle)
    found = rows_of(name, (g + F[:, U] * angle)[:, None])[:, 0]
    upright, turned = products(MANOEUVRES[name], angle)
    tolerance = np.full(11, METRE_TOLERANCE + turned)
    tolerance[:3], tolerance[3:5] = 1.5 * RADIAN_TOLERANCE, SPEED_TOLERANCE
    tolerance[5] = SPEED_TOLERANCE + upright
    assert (np.abs(found - expected) < tolerance).all()


@every_angle
def test_what_stays(angle: float) -> None:
    """Sensor errors stay; the place grows by the path, as it is without the odometer's noise."""
    F, g = at_angle(state_map("turning"), angle)
    sensors = slice(GYRO_BIAS.start, GYRO_TURN.stop)
    np.testing.assert_array_equal(F[sensors, sensors], np.eye(9))
    np.testing.assert_array_equal(g[GYRO_BIAS.start : PLACE.start], 0.0)
    noise = slice(ODOMETER.start + POSITION.start, ODOMETER.start + POSITION.stop)
    expected = F[PATH].copy()
    assert np.abs(expected[:, noise]).max() > 0.5
    expected[:, noise] = 0.0
    expected[:, PLACE] += np.eye(3)
    np.testing.assert_array_equal(F[PLACE], expected)
    np.testing.assert_array_equal(g[PLACE], g[PATH])


# -- the paper's equations


ENU = {name: manoeuvre._replace(azimuth=0.0) for name, manoeuvre in MANOEUVRES.items()}


@cache
def integrated(name: str, angle: float) -> tuple[Array, Array]:
    """Transition (19, 19) and known part (19,) of (27) and (24) over the epoch.

    F and g are those of U at the start; what it moves by (a gyro's bias) changes g.
    """
    manoeuvre = ENU[name]

    def both(state: tuple[Array, ...], t: float) -> tuple[Array, ...]:
        *navigation, A, b = state
        C, v, e, h, _ = (x[0] for x in navigation)
        wander = math.atan2(e[0], e[1])
        latitude = math.atan2(e[2], math.hypot(e[0], e[1]))
        C_na = turn(-wander)
        at = blocks.Computed(C_na @ C, manoeuvre.f_b(t), C_na @ v, latitude, float(h))
        F, g = blocks.eq23_F(angle, at, True), blocks.eq24_g(angle, at, True)
        ahead, behind = (blocks.eq24_g(angle + d, at, True) for d in (1e-4, -1e-4))
        F[:, 0] += (ahead - behind) / 2e-4
        moved = rates(navigation, manoeuvre.w_b(t)[None], manoeuvre.f_b(t)[None])
        return *moved, F @ A, F @ b + g

    start = manoeuvre.C_ab[None], manoeuvre.v_a[None], manoeuvre.e_a[None], np.array([ALTITUDE])
    A, b = np.eye(blocks.EXTENDED), np.zeros(blocks.EXTENDED)
    *_, A, b = runge_kutta(both, (*start, np.zeros((1, 3)), A, b), 25)
    return A, b


# Columns and rows of the paper's state, and of the package's.
PAPER = {
    "phi": ([1, 2], LEVELS),
    "U": ([0], slice(2, 3)),
    "velocity": (blocks.VELOCITY, VELOCITY),
    "gyro_bias": (blocks.GYRO_BIAS, GYRO_BIAS),
    "accel_bias": (blocks.ACCEL_BIAS, ACCEL_BIAS),
    "path": (blocks.PATH, PATH),
}
PAPER_BLOCKS = [
    (row, column)
    for row in ("phi", "U", "velocity", "path")
    for column in ("phi", "velocity", "gyro_bias", "accel_bias")
    if (row, column) not in (("U", "phi"), ("phi", "accel_bias"), ("phi", "velocity"))
]
PAPER_TOLERANCE = 1e-3


# Of third order in time.
PAPER_TOLERANCES = {("path", "gyro_bias"): 2e-3}


@cache
def enu_map(name: str) -> ConditionallyLinear:
    """In ENU at the start: a wanders from it by 1e-5 in the epoch."""
    manoeuvre = ENU[name]
    place = Position(manoeuvre.latitude, 0.0, ALTITUDE)
    navigation = WanderNavigation(manoeuvre.C_ab, manoeuvre.v_a, place)
    navigation.e_a = manoeuvre.e_a
    epoch, _ = epoch_and_rate(name)
    return keep(navigation, OdometerModel(config(**EXACT)), epoch).maps[0]


@every_angle
@every_manoeuvre
def test_map_is_the_paper_s_integral(name: str, angle: float) -> None:
    (F, g), (A, b) = at_angle(enu_map(name), angle), integrated(name, angle)
    for row, column in PAPER_BLOCKS:
        (paper_rows, rows), (paper_columns, columns) = PAPER[row], PAPER[column]
        expected = A[paper_rows][:, paper_columns]
        tolerance = PAPER_TOLERANCES.get((row, column), PAPER_TOLERANCE)
        assert relative(F[rows, columns], expected) < tolerance, (row, column)
    upright, turned = products(ENU[name], angle)
    known = {
        "phi": 1.5 * RADIAN_TOLERANCE,
        "velocity": np.array([SPEED_TOLERANCE, SPEED_TOLERANCE, SPEED_TOLERANCE + upright]),
        "path": METRE_TOLERANCE + turned,
    }
    for row, tolerance in known.items():
        paper_rows, rows = PAPER[row]
        assert (np.abs(g[rows] - b[paper_rows]) < tolerance).all(), row
