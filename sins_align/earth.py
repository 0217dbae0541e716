"""The Earth: WGS-84 ellipsoid, normal gravity, Earth rate and transport rate."""

from __future__ import annotations

import math

import numpy as np

from sins_align.types import Array

EARTH_RATE = 7.292115e-5  # Omega [rad/s]
SEMI_MAJOR_AXIS = 6378137.0  # [m]
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)
GRAVITY_EQUATOR = 9.7803253359  # [m/s^2]
SOMIGLIANA = 1.931852652458e-3
GRAVITY_RATIO = 3.449786506841e-3  # Omega^2 a^2 b / GM


def normal_gravity(latitude: float, altitude: float = 0.0) -> float:
    """Normal gravity at a height [m/s^2].

    Somigliana's formula on the ellipsoid, second-order free-air reduction
    (WGS-84, NIMA TR8350.2, eqs 4-1 and 4-3).

    Parameters
    ----------
    latitude : geodetic [rad]
    altitude : above the ellipsoid [m]
    """
    s2 = math.sin(latitude) ** 2
    surface = GRAVITY_EQUATOR * (1.0 + SOMIGLIANA * s2) / math.sqrt(1.0 - ECCENTRICITY_SQUARED * s2)
    h = altitude / SEMI_MAJOR_AXIS
    return surface * (
        1.0 - 2.0 * h * (1.0 + FLATTENING + GRAVITY_RATIO - 2.0 * FLATTENING * s2) + 3.0 * h * h
    )


def radii_of_curvature(latitude: float) -> tuple[float, float]:
    """Meridian and transverse radius of curvature (R_M, R_N) [m], Groves (2.105), (2.106)."""
    root = math.sqrt(1.0 - ECCENTRICITY_SQUARED * math.sin(latitude) ** 2)
    transverse = SEMI_MAJOR_AXIS / root
    return transverse * (1.0 - ECCENTRICITY_SQUARED) / root**2, transverse


def earth_rate_n(latitude: float) -> Array:
    """Rate of the Earth against inertial space, in ENU: (3,) [rad/s]."""
    return EARTH_RATE * np.array([0.0, math.cos(latitude), math.sin(latitude)])


def transport_rate_n(latitude: float, altitude: float, v_n: Array) -> Array:
    """Rate of ENU against the Earth caused by the motion over it: (3,) [rad/s].

    w_en_n = (-v_N / (R_M + h), v_E / (R_N + h), v_E tan L / (R_N + h))

    Parameters
    ----------
    v_n : (3,) velocity east, north, up [m/s]
    """
    meridian, transverse = radii_of_curvature(latitude)
    east, north = v_n[0] / (transverse + altitude), v_n[1] / (meridian + altitude)
    return np.array([-north, east, east * math.tan(latitude)])
