"""The Earth under a moving vehicle, WGS-84: radii, rates, gravity along the way.

Written apart from `sins_align.earth` on purpose, as `geodesy` is.
"""

from __future__ import annotations

import numpy as np

from sins_align.simulate.geodesy import EARTH_RATE
from sins_align.types import Array

_A = 6378137.0  # [m]
_E2 = (2.0 - 1.0 / 298.257223563) / 298.257223563


def meridian_radius(latitude: Array) -> Array:
    """(N,) radius of curvature north-south [m]; latitude in [rad]."""
    return _A * (1.0 - _E2) / (1.0 - _E2 * np.sin(latitude) ** 2) ** 1.5


def normal_radius(latitude: Array) -> Array:
    """(N,) radius of curvature east-west [m]; latitude in [rad]."""
    return _A / np.sqrt(1.0 - _E2 * np.sin(latitude) ** 2)


def earth_rates_n(latitude: Array) -> Array:
    """(3, N) rate of the Earth against inertial space, in ENU [rad/s]."""
    return EARTH_RATE * np.stack((np.zeros_like(latitude), np.cos(latitude), np.sin(latitude)))


def transport_rate_n(v_n: Array, latitude: Array, altitude: Array) -> Array:
    """(3, N) rate of n against the Earth, in ENU [rad/s], at the velocity v_n (3, N)."""
    east = v_n[0] / (normal_radius(latitude) + altitude)
    north = v_n[1] / (meridian_radius(latitude) + altitude)
    return np.stack((-north, east, east * np.tan(latitude)))


def transport_acceleration_n(v_n: Array, a_n: Array, latitude: Array, altitude: Array) -> Array:
    """(3, N) time derivative of the components of `transport_rate_n` [rad/s^2].

    The radii are taken as constant: they change by a hundredth of the latitude's change.
    """
    rate = transport_rate_n(a_n, latitude, altitude)
    east = v_n[0] / (normal_radius(latitude) + altitude)
    north = v_n[1] / (meridian_radius(latitude) + altitude)
    rate[2] += east * north / np.cos(latitude) ** 2
    return rate
