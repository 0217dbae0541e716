"""The latitude from the data: how fast gravity turns, and about which axis.

With the true latitude L + dL in place of the model's, gravity in inertial axes (`two_stage`) is,
to first order, that of the model with

    R_e (1 - tan L dL)      R_n (1 + (c^2 - s^2) / (s c) dL) + 2 R_u dL      R_u

in place of R_e, R_n, R_u; s, c = sin L, cos L. So one more column of theta's Jacobian tells it,
from the sums that are there already. sigma_L is about sigma_bg / (Omega sin L) at least: at the
equator it is the rate about up that tells the latitude, of a base that does not turn (`turning`).
"""

from __future__ import annotations

import math

import numpy as np

from sins_align.earth import EARTH_RATE
from sins_align.grades import ImuGrade
from sins_align.latitudes import are_of_one_place, mean_latitude
from sins_align.limits import DOUBTED_LATITUDE_RATIO, is_navigation_grade
from sins_align.reasons import LATITUDE_DOUBTED, LATITUDE_UNPROVEN, Finding
from sins_align.swing.solution import X_G, Solution
from sins_align.swing.two_stage import R_EAST, R_NORTH
from sins_align.types import Array, LatitudeEstimate
from sins_align.units import DEG

# Nearer to the equator (and to a pole) there is nothing to be told.
LEAST_SIN_COS = 0.01
# With gyros of navigation grade an error of so much [rad] is to be told before aligned is
# claimed. Sigma has to be so many times smaller, and will be soon [s] where bias and
# noise allow it to be smaller yet.
TOLD_ERROR = 1.0 * DEG
TOLD_RATIO, SOON_RATIO, SOON_S = 6.0, 9.0, 120.0
# A base whose swing still hides that from the rate about up is not waited for any longer [s].
SWAYING_S = 200.0
# What it hides falls like the time to the power of -7 in the long run, and faster before; sigma by
# gravity, which is of noise first and of the bias later, like the second of these powers.
TURNING_FALL, GRAVITY_FALL = 8.5, 1.5


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


def latitude_by_both(
    own: LatitudeEstimate | None, turn: LatitudeEstimate | None
) -> LatitudeEstimate | None:
    """By gravity, and by the rate about up, which counts for what gravity does not tell.

    That is a latitude near the equator, and the hemisphere. Where they contradict each other in
    either one, the base turns about up.
    """
    if own is None or turn is None:
        return own if turn is None else turn
    if are_of_one_place(own, turn):
        return own if is_told(own) else mean_latitude(own, turn)
    other = own._replace(latitude=-own.latitude)
    return mean_latitude(other, turn) if are_of_one_place(other, turn) else own


def is_told(own: LatitudeEstimate) -> bool:
    """Whether an error of a degree would show."""
    return TOLD_RATIO * own.sigma <= TOLD_ERROR


def told_after(
    grade: ImuGrade,
    given: float,
    own: LatitudeEstimate | None,
    turn: LatitudeEstimate | None,
    time_s: float,
) -> float:
    """How much later an error of a degree will show, by gravity or by the rate about up [s].

    Either sigma falls like a power of the time. own, turn : by the one and by the other, so far;
    time_s : since the start
    """
    told_s = []  # when, since the start
    if own is not None and _is_due(grade, abs(math.sin(given))):
        told_s.append((TOLD_RATIO * own.sigma / TOLD_ERROR) ** (1.0 / GRAVITY_FALL) * time_s)
    if turn is not None and _is_waited_for(grade, time_s):
        by_turning_s = (TOLD_RATIO * turn.sigma / TOLD_ERROR) ** (1.0 / TURNING_FALL) * time_s
        told_s.append(min(by_turning_s, SWAYING_S))
    return max(min(told_s, default=0.0) - time_s, 0.0)


def _is_due(grade: ImuGrade, slope: float) -> bool:
    """Whether bias and noise of the gyros will soon allow a degree to show.

    slope : of the rate that tells it, over the Earth's: sin L of gravity's turn, cos L of that
        about up
    """
    bias = math.hypot(grade.gyro_bias, grade.gyro_bias_instability, grade.gyro_arw * SOON_S**-0.5)
    return is_navigation_grade(grade) and bias < TOLD_ERROR / SOON_RATIO * EARTH_RATE * slope


def _is_waited_for(grade: ImuGrade, sways_s: float) -> bool:
    """Whether the rate about up, of a base that does not turn, may tell where gravity does not."""
    return sways_s < SWAYING_S and _is_due(grade, 1.0)


def latitude_doubts(
    grade: ImuGrade,
    given: float,
    own: LatitudeEstimate | None,
    was_told: bool = False,
    sways_s: float = math.inf,
) -> tuple[Finding, ...]:
    """What an alignment with the latitude `given` [rad] has to wait for.

    own : the latitude of the data; was_told : whether they have told it before
    sways_s : for how long the base has not turned about up [s]; inf: it does
    """
    if own is None:
        return ()
    is_due = _is_due(grade, abs(math.sin(given))) or _is_waited_for(grade, sways_s)
    if is_due and not was_told and not is_told(own):
        needed = TOLD_ERROR / TOLD_RATIO / DEG
        return (LATITUDE_UNPROVEN(sigma_deg=own.sigma / DEG, most_deg=needed),)
    ratio = abs(own.latitude - given) / own.sigma
    if ratio > DOUBTED_LATITUDE_RATIO:
        return (LATITUDE_DOUBTED(ratio=ratio, sigma_deg=own.sigma / DEG),)
    return ()
