"""The wander-azimuth mechanisation against the truth of simulated drives.

The simulator shares no equation with it; it works with latitude and longitude in ENU, and its
own test integrates its IMU in inertial axes.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sins_align.odo.epoch import integrate_epoch
from sins_align.odo.navigation import WanderNavigation
from sins_align.odo.pairing import Paired
from sins_align.simulate import VehicleOptions, VehicleRun, simulate_vehicle
from sins_align.types import Array, ImuBlock, ImuSampling, Position

ARCSEC = math.radians(1.0 / 3600.0)
MILLIMETRE = 1e-3
SEMI_MAJOR = 6378137.0
FLATTENING = 1.0 / 298.257223563
E2 = FLATTENING * (2.0 - FLATTENING)

RATE_HZ = 200
LATITUDES_DEG = (-60.0, 0.0, 40.0, 75.0, 85.0, 89.9)


@cache
def drive(latitude_deg: float, scenario: str, duration_s: float = 120.0) -> VehicleRun:
    return simulate_vehicle(
        VehicleOptions(
            scenario=scenario,
            grade="perfect",
            seed=11,
            rate_hz=RATE_HZ,
            duration_s=duration_s,
            latitude_deg=latitude_deg,
            altitude_m=300.0,
            sampling="instantaneous",
        )
    )


def about_up(angle: float) -> Array:
    return Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()


def start(run: VehicleRun, alpha: float) -> WanderNavigation:
    """From the truth, in a frame a with C_na = Rz(alpha)."""
    begin = int(run.imu.stamp_ns[0])
    latitude, longitude, altitude = run.truth.position_at(begin)
    C_an = about_up(-alpha)
    navigation = WanderNavigation(
        C_an @ run.truth.C_nb_at(begin),
        C_an @ run.truth.v_n_at(begin),
        Position(latitude, longitude, altitude),
    )
    navigation.e_a = C_an @ [0.0, math.cos(latitude), math.sin(latitude)]
    return navigation


class Errors(NamedTuple):
    attitude: float  # [rad]
    velocity: float  # [m/s]
    latitude: float  # [rad]
    height: float  # [m]
    path: float  # worst of an epoch [m]


def navigate(run: VehicleRun, alpha: float) -> tuple[WanderNavigation, Errors]:
    """The largest errors over the drive, in epochs of a second."""
    navigation, imu, truth = start(run, alpha), run.imu, run.truth
    largest = np.zeros(5)
    for k in range(0, len(imu) - RATE_HZ, RATE_HZ):
        part = imu.select(slice(k, k + RATE_HZ + 1))
        epoch = integrate_epoch(Paired(ImuBlock(*part), None, None, 0.0), ImuSampling.INSTANTANEOUS)
        course = navigation.advance(epoch)
        end = int(part.stamp_ns[-1])
        e = navigation.e_a
        C_na = about_up(math.atan2(e[0], e[1]))
        latitude, _, altitude = truth.position_at(end)
        before = truth.position_at(int(part.stamp_ns[0]))[2]
        off = C_na @ navigation.C_ab @ truth.C_nb_at(end).T
        errors = (
            np.abs(off - np.eye(3)).max(),
            np.abs(C_na @ navigation.v_a - truth.v_n_at(end)).max(),
            abs(navigation.latitude - latitude),
            abs(navigation.altitude - altitude),
            abs(course.path[2] - (altitude - before)),
        )
        largest = np.maximum(largest, errors)
    return navigation, Errors(*largest.tolist())


# Two minutes of town driving without any aiding. What is left out of an epoch (the change of
# the transport rate within it) does not add up, as the vehicle's speed does not.
ATTITUDE_TOLERANCE = 0.02 * ARCSEC
VELOCITY_TOLERANCE = 0.1 * MILLIMETRE
HEIGHT_TOLERANCE = 5.0 * MILLIMETRE
LATITUDE_TOLERANCE = 2e-9  # [rad]: 13 mm
PATH_TOLERANCE = 0.1 * MILLIMETRE


def assert_arrives(errors: Errors, latitude_deg: float = 40.0) -> None:
    # Azimuth and latitude are read off a vector of length cos L.
    length = math.cos(math.radians(latitude_deg))
    assert errors.attitude < ATTITUDE_TOLERANCE / length
    assert errors.velocity < VELOCITY_TOLERANCE
    assert errors.height < HEIGHT_TOLERANCE
    assert errors.latitude < LATITUDE_TOLERANCE / length
    assert errors.path < PATH_TOLERANCE


@pytest.mark.parametrize("latitude_deg", LATITUDES_DEG)
def test_town_drive_everywhere(latitude_deg: float) -> None:
    """Azimuth included: C_na = Rz(alpha) of the e_a carried along."""
    assert_arrives(navigate(drive(latitude_deg, "urban"), 0.7)[1], latitude_deg)


@pytest.mark.parametrize("scenario", ["ring", "figure8", "reverse"])
def test_other_drives(scenario: str) -> None:
    assert_arrives(navigate(drive(40.0, scenario), -2.0)[1])


@pytest.mark.parametrize("alpha", [0.0, 2.0, -3.0])
def test_start_azimuth_does_not_matter(alpha: float) -> None:
    """The same drive in two frames: v and C turn with the frame."""
    run = drive(40.0, "urban")
    one, _ = navigate(run, 0.7)
    other, _ = navigate(run, alpha)
    turn = about_up(0.7 - alpha)
    np.testing.assert_allclose(turn @ one.C_ab, other.C_ab, atol=1e-12)
    np.testing.assert_allclose(turn @ one.v_a, other.v_a, atol=1e-9)
    np.testing.assert_allclose(turn @ one.e_a, other.e_a, atol=1e-15)


def test_azimuth_turns_with_the_meridian() -> None:
    """d alpha/dt = - v_E tan L / (R_N + h); at 85 deg it is seen."""
    run = drive(85.0, "urban")
    stamps = run.imu.stamp_ns
    v_east = run.truth.v_n_at(stamps)[0]
    latitude, _, altitude = run.truth.position_at(stamps)
    transverse = SEMI_MAJOR / np.sqrt(1.0 - E2 * np.sin(latitude) ** 2)
    rate = -v_east * np.tan(latitude) / (transverse + altitude)
    turned = float(np.sum(0.5 * (rate[1:] + rate[:-1]))) / RATE_HZ
    navigation, _ = navigate(run, 0.7)
    alpha = math.atan2(navigation.e_a[0], navigation.e_a[1])
    assert abs(turned) > 10.0 * ARCSEC
    assert alpha - 0.7 == pytest.approx(turned, abs=0.01 * ARCSEC)


def test_stays_orthogonal() -> None:
    navigation, _ = navigate(drive(40.0, "urban"), 0.7)
    C = navigation.C_ab
    np.testing.assert_allclose(C @ C.T, np.eye(3), atol=1e-12)
    # The axis is a unit vector, but for the square of its turning in an epoch.
    assert np.linalg.norm(navigation.e_a) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("latitude_deg", [-80.0, 0.0, 45.0, 89.99])
@pytest.mark.parametrize("alpha", [0.0, 1.0, -2.5])
def test_transport_rate_is_that_of_both_radii(latitude_deg: float, alpha: float) -> None:
    latitude, altitude = math.radians(latitude_deg), 500.0
    root = math.sqrt(1.0 - E2 * math.sin(latitude) ** 2)
    transverse = SEMI_MAJOR / root
    meridian = transverse * (1.0 - E2) / root**2
    v_n = np.array([17.0, -9.0, 2.0])
    # ENU without its turning about up: that is what makes it a wander frame.
    w_n = np.array([-v_n[1] / (meridian + altitude), v_n[0] / (transverse + altitude), 0.0])
    navigation = WanderNavigation(np.eye(3), np.zeros(3), Position(latitude, 0.0, altitude))
    C_an = about_up(-alpha)
    navigation.e_a = C_an @ [0.0, math.cos(latitude), math.sin(latitude)]
    w_a = navigation.transport_rate(C_an @ v_n, transverse)
    # The height's share of 1/R_M - 1/R_N: e'^2 h / R of the rate.
    np.testing.assert_allclose(w_a, C_an @ w_n, atol=2e-6 * np.abs(w_n).max())


def test_standing_still() -> None:
    """For ten minutes, at rest on a turning Earth."""
    run = drive(40.0, "static", 600.0)
    assert_arrives(navigate(run, 1.0)[1])
