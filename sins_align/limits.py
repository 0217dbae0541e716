"""What the declared sensors, the latitude and the time allow."""

from __future__ import annotations

import math

from sins_align.earth import EARTH_RATE, GRAVITY_EQUATOR
from sins_align.grades import ImuGrade
from sins_align.types import LatitudeEstimate
from sins_align.units import DEG_PER_H

# A threshold that is not reached within this time of standing will not be waited for [s].
PATIENCE_S = 3600.0

# What is left at a wider bound than entered: by this.
HYSTERESIS = 1.25

# A latitude is not that of the data beyond so many sigma, and beyond so much [rad].
MAX_LATITUDE_RATIO = 5.0
LEAST_LATITUDE_ERROR = math.radians(0.1)
# One that is off by so many may be, and more data will tell.
DOUBTED_LATITUDE_RATIO = 3.0
NAVIGATION_BIAS = 0.01 * DEG_PER_H  # [rad/s]


def latitude_differs(given: float, own: LatitudeEstimate) -> bool:
    """Whether the latitude that was given [rad] is not that of the data."""
    off = abs(own.latitude - given)
    return off > max(LEAST_LATITUDE_ERROR, MAX_LATITUDE_RATIO * own.sigma)


def is_navigation_grade(grade: ImuGrade) -> bool:
    """Whether the gyros' declared bias, drift included, is that of navigation: 0.01 deg/h."""
    return 0.0 < math.hypot(grade.gyro_bias, grade.gyro_bias_instability) <= NAVIGATION_BIAS


def heading_limit(grade: ImuGrade, latitude: float, time_s: float = math.inf) -> float:
    """1-sigma heading of a base that has not turned, after a time [rad].

    sigma^2 = 12 VRW^2 / (g Omega cos L)^2 / T^3 + ARW^2 / (Omega cos L)^2 / T
              + (sigma_bg / (Omega cos L))^2

    The last one no time improves on: the east gyro's bias cannot be told from a heading error;
    its instability adds to it. VRW [m/s/sqrt(s)], ARW [rad/sqrt(s)]; docs/swing.md. NaN at the
    poles, where heading has no meaning, and at no time at all.

    Parameters
    ----------
    latitude : [rad]; time_s : since the first sample [s]
    """
    horizontal = EARTH_RATE * math.cos(latitude)
    if horizontal < 1e-9 * EARTH_RATE or not time_s > 0.0:
        return math.nan
    rate = math.hypot(
        grade.gyro_bias,
        grade.gyro_bias_instability,
        grade.gyro_arw * time_s**-0.5,
        math.sqrt(12.0) * grade.accel_vrw / GRAVITY_EQUATOR * time_s**-1.5,
    )
    return rate / horizontal


def level_limit(grade: ImuGrade) -> float:
    """1-sigma level of a base that stands still [rad]: sigma_ba / g.

    Only turns and tilts of the base tell an accelerometer's bias from a tilt.
    """
    return grade.accel_bias / GRAVITY_EQUATOR
