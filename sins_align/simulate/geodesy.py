"""Earth rate and gravity of the truth, WGS-84.

Written apart from `sins_align.earth` on purpose: what the estimators believe and what the
simulator does must not share a mistake. A test compares the two.
"""

from __future__ import annotations

import math

import numpy as np

from sins_align.types import Array

EARTH_RATE = 7.292115e-5  # [rad/s]
_EQUATORIAL_RADIUS = 6378137.0  # [m]
_FLATTENING = 1.0 / 298.257223563
_GRAVITATIONAL_CONSTANT = 3.986004418e14  # [m^3/s^2]


def earth_rate_n(latitude: float) -> Array:
    """(3,) rate of the Earth against inertial space, in ENU [rad/s]; latitude in [rad]."""
    return EARTH_RATE * np.array([0.0, math.cos(latitude), math.sin(latitude)])


def plumb_gravity(latitude: float, altitude: float) -> float:
    """Gravity, centrifugal acceleration included, along the ellipsoid's normal [m/s^2].

    g(L, h) = g0(L) {1 - 2/R0 [1 + f (1 - 2 sin^2 L) + w^2 R0^2 Rp / mu] h + 3/R0^2 h^2}
    with Somigliana's g0(L): Groves, 2nd edition, (2.134) and (2.139). The small northward
    part of gravity above the ellipsoid, 8e-9 /s^2 h sin 2L, is left out: 0.01 arcsec at 50 m.

    Parameters
    ----------
    latitude : geodetic [rad]
    altitude : above the ellipsoid [m]
    """
    sin2 = math.sin(latitude) ** 2
    polar_radius = _EQUATORIAL_RADIUS * (1.0 - _FLATTENING)
    eccentricity2 = _FLATTENING * (2.0 - _FLATTENING)
    surface = 9.7803253359 * (1.0 + 0.001931853 * sin2) / math.sqrt(1.0 - eccentricity2 * sin2)
    centrifugal = EARTH_RATE**2 * _EQUATORIAL_RADIUS**2 * polar_radius / _GRAVITATIONAL_CONSTANT
    gradient = 2.0 * (1.0 + _FLATTENING * (1.0 - 2.0 * sin2) + centrifugal)
    ratio = altitude / _EQUATORIAL_RADIUS
    return surface * (1.0 - gradient * ratio + 3.0 * ratio**2)
