"""The latitude from the data: how fast gravity turns, and about which axis.

With the true latitude L + dL in place of the model's, gravity in inertial axes (`two_stage`) is,
to first order, that of the model with

    R_e (1 - tan L dL)      R_n (1 + (c^2 - s^2) / (s c) dL) + 2 R_u dL      R_u

in place of R_e, R_n, R_u; s, c = sin L, cos L. So one more column of theta's Jacobian tells it,
from the sums that are there already. sigma_L is about sigma_bg / (Omega sin L) at least: at the
equator the latitude is unobservable.
"""

from __future__ import annotations

import math

import numpy as np

from sins_align.earth import EARTH_RATE
from sins_align.grades import ImuGrade
from sins_align.limits import HYSTERESIS
from sins_align.reasons import LATITUDE_DOUBTED, LATITUDE_UNPROVEN, Finding
from sins_align.swing.solution import X_G, Solution
from sins_align.swing.two_stage import R_EAST, R_NORTH
from sins_align.types import Array, LatitudeEstimate
from sins_align.units import DEG, DEG_PER_H

# Nearer to the equator (and to a pole) there is nothing to be told.
LEAST_SIN_COS = 0.01
# With a gyro of navigation grade [rad/s] an error of so much [rad] is to be told before aligned is
# claimed. Sigma has to be so many times smaller, and will be soon [s] where bias and noise allow it
# to be smaller yet.
NAVIGATION_BIAS, TOLD_ERROR = 0.01 * DEG_PER_H, 1.0 * DEG
TOLD_RATIO, SOON_RATIO, SOON_S = 6.0, 9.0, 120.0
# What is off by so many sigma is wrong or not, when more data have come.
DOUBTED_RATIO = 3.0


def earth_rate_slope(latitude: float) -> Array:
    """(3,) d w_ie_n / d L, ENU [1/s]."""
    return EARTH_RATE * np.array([0.0, -math.sin(latitude), math.cos(latitude)])


def latitude_column(solution: Solution, latitude: float) -> Array | None:
    """(p,) d theta / d L at the model's latitude [rad]; None where it does not show."""
    s, c = math.sin(latitude), math.cos(latitude)
    if abs(s * c) < LEAST_SIN_COS:
        return None
    R = (1.0 + solution.x[X_G]) * solution.R
    column = np.zeros(solution.theta.shape[0])
    column[R_EAST] = -s / c * R[:, 0]
    column[R_NORTH] = (c * c - s * s) / (s * c) * R[:, 1] + 2.0 * R[:, 2]
    return column


def latitude_doubts(
    grade: ImuGrade, given: float, own: LatitudeEstimate | None, was_told: bool = False
) -> tuple[Finding, ...]:
    """What an alignment has to wait for.

    Parameters
    ----------
    given, own : the latitude [rad], and that of the data
    was_told : whether it had nothing to wait for before: sigma may have grown a little since, with
        the position noise
    """
    bias = math.hypot(grade.gyro_bias, grade.gyro_bias_instability)
    least = math.hypot(bias, grade.gyro_arw / math.sqrt(SOON_S))
    most = TOLD_ERROR / SOON_RATIO * EARTH_RATE * abs(math.sin(given))
    if own is None or bias > NAVIGATION_BIAS or least > most:
        return ()
    if TOLD_RATIO * own.sigma > TOLD_ERROR * (HYSTERESIS if was_told else 1.0):
        most = TOLD_ERROR / TOLD_RATIO / DEG
        return (LATITUDE_UNPROVEN(sigma_deg=own.sigma / DEG, most_deg=most),)
    ratio = abs(own.latitude - given) / own.sigma
    if ratio > DOUBTED_RATIO:
        return (LATITUDE_DOUBTED(ratio=ratio, sigma_deg=own.sigma / DEG),)
    return ()
