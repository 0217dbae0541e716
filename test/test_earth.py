"""The Earth against published values, the simulator's own, and numerical differentiation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sins_align import earth
from sins_align.grades import ImuGrade
from sins_align.limits import heading_limit, level_limit
from sins_align.simulate import geodesy
from sins_align.types import Array
from sins_align.units import ARCMIN, ARCSEC, DEG, DEG_PER_H, MICRO_G

MICRO_GAL = 1e-8  # [m/s^2]
LATITUDES = np.radians([-90.0, -60.0, -33.3, 0.0, 12.0, 45.0, 71.0, 90.0])


@pytest.mark.parametrize(
    ("latitude_deg", "gravity"),
    [
        # WGS-84 (NIMA TR8350.2, table 3.4), 45 deg: Somigliana's formula, GRS-80 gives 9.806199203.
        (0.0, 9.7803253359),
        (90.0, 9.8321849378),
        (45.0, 9.8061977694),
        (-45.0, 9.8061977694),
    ],
)
def test_gravity_on_the_ellipsoid(latitude_deg: float, gravity: float) -> None:
    found = earth.normal_gravity(latitude_deg * DEG)
    assert found == pytest.approx(gravity, abs=MICRO_GAL)


@pytest.mark.parametrize("latitude_deg", [0.0, 45.0, 90.0])
@pytest.mark.parametrize("h", [100.0, 10e3])
def test_gravity_decreases_upwards(latitude_deg: float, h: float) -> None:
    """g(h) - g(0) = -(3.0877e-6 - 4.3e-9 sin^2 L) h + 0.72e-12 h^2 (Moritz, GRS 80)."""
    fall = earth.normal_gravity(latitude_deg * DEG, h) - earth.normal_gravity(latitude_deg * DEG)
    expected = -(3.0877e-6 - 4.3e-9 * math.sin(latitude_deg * DEG) ** 2) * h + 0.72e-12 * h * h
    assert fall == pytest.approx(expected, abs=1e-4 * abs(expected))


def test_radii_of_curvature() -> None:
    a, b = 6378137.0, 6356752.3142
    assert earth.radii_of_curvature(0.0) == pytest.approx((b * b / a, a), abs=1e-3)
    assert earth.radii_of_curvature(90 * DEG) == pytest.approx((a * a / b, a * a / b), abs=1e-3)
    meridian, transverse = earth.radii_of_curvature(45 * DEG)
    assert (meridian, transverse) == pytest.approx((6367381.816, 6388838.290), abs=1e-3)


@pytest.mark.parametrize("latitude", LATITUDES)
@pytest.mark.parametrize("altitude", [-400.0, 0.0, 50.0, 9000.0])
def test_agrees_with_the_simulator(latitude: float, altitude: float) -> None:
    """Written apart; the north component of gravity that both leave out is no part of this."""
    assert earth.normal_gravity(latitude, altitude) == pytest.approx(
        geodesy.plumb_gravity(latitude, altitude), abs=MICRO_GAL
    )
    np.testing.assert_allclose(
        earth.earth_rate_n(latitude), geodesy.earth_rate_n(latitude), atol=1e-20
    )


def test_earth_rate_is_a_turn_in_a_sidereal_day() -> None:
    rate = float(np.linalg.norm(earth.earth_rate_n(0.3)))
    assert 2.0 * math.pi / rate == pytest.approx(86164.1, abs=0.1)
    east, north, up = earth.earth_rate_n(40 * DEG) / DEG_PER_H
    assert (east, north, up) == pytest.approx((0.0, 11.5222, 9.6683), abs=1e-3)
    assert earth.earth_rate_n(-40 * DEG)[2] < 0.0


def C_en(latitude: float, longitude: float) -> Array:
    """Columns east, north, up in Earth-fixed axes."""
    sl, cl, sp, cp = (
        math.sin(longitude), math.cos(longitude), math.sin(latitude), math.cos(latitude),
    )  # fmt: skip
    return np.array([[-sl, -sp * cl, cp * cl], [cl, -sp * sl, cp * sl], [0.0, cp, sp]])


def position_e(latitude: float, longitude: float, altitude: float) -> Array:
    _, transverse = earth.radii_of_curvature(latitude)
    z = (1.0 - earth.ECCENTRICITY_SQUARED) * transverse + altitude
    horizontal = (transverse + altitude) * math.cos(latitude)
    return np.array([
        horizontal * math.cos(longitude), horizontal * math.sin(longitude), z * math.sin(latitude),
    ])  # fmt: skip


@pytest.mark.parametrize("latitude_deg", [-70.0, -20.0, 0.0, 40.0, 80.0])
def test_transport_rate_by_differentiation(latitude_deg: float) -> None:
    """ENU carried along a path over the Earth: velocity and rate from finite differences."""
    rates, h, step = np.array([3e-5, -2e-5]), 500.0, 0.05  # latitude, longitude [rad/s]

    def at(t: float) -> tuple[float, float]:
        return latitude_deg * DEG + rates[0] * t, 1.0 + rates[1] * t

    velocity_e = (position_e(*at(step), h) - position_e(*at(-step), h)) / (2.0 * step)
    C = C_en(*at(0.0))
    turn = C.T @ (C_en(*at(step)) - C_en(*at(-step))) / (2.0 * step)
    expected = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0],
                               turn[1, 0] - turn[0, 1]])  # fmt: skip
    found = earth.transport_rate_n(latitude_deg * DEG, h, C.T @ velocity_e)
    np.testing.assert_allclose(found, expected, atol=1e-11)
    assert np.linalg.norm(found) > 1e-5


def test_heading_limit_is_the_textbook_number() -> None:
    """1 deg/h at 40 deg: 4.97 deg (SWING.md); instability and bias add in squares."""
    tactical = ImuGrade(gyro_bias=1.0 * DEG_PER_H)
    assert heading_limit(tactical, 40 * DEG) == pytest.approx(4.97 * DEG, abs=0.01 * DEG)
    both = ImuGrade(gyro_bias=3 * DEG_PER_H, gyro_bias_instability=4 * DEG_PER_H)
    assert heading_limit(both, 0.2) == pytest.approx(5.0 * heading_limit(tactical, 0.2))
    assert heading_limit(ImuGrade(), 40 * DEG) == 0.0
    assert heading_limit(tactical, -40 * DEG) == heading_limit(tactical, 40 * DEG)


@pytest.mark.parametrize("latitude_deg", [90.0, -90.0])
def test_no_heading_limit_at_the_poles(latitude_deg: float) -> None:
    assert math.isnan(heading_limit(ImuGrade(gyro_bias=1e-8), latitude_deg * DEG))


def test_heading_limit_grows_without_bound_towards_the_pole() -> None:
    limits = [heading_limit(ImuGrade(gyro_bias=1e-9), x * DEG) for x in (0, 45, 80, 89.99)]
    assert limits == sorted(limits)
    assert limits[-1] > 0.1 * DEG > ARCMIN


def test_level_limit() -> None:
    assert level_limit(ImuGrade(accel_bias=100 * MICRO_G)) == pytest.approx(20.6 * ARCSEC, rel=0.01)
    assert level_limit(ImuGrade()) == 0.0
