"""What the declared sensors and the latitude allow."""

from __future__ import annotations

import math

from sins_align.earth import EARTH_RATE, GRAVITY_EQUATOR
from sins_align.grades import ImuGrade


def heading_limit(grade: ImuGrade, latitude: float) -> float:
    """1-sigma heading that no still time improves on [rad]: sigma_bg / (Omega cos L).

    The east gyro's bias cannot be told from a heading error; its instability adds to it.
    NaN at the poles, where heading has no meaning.
    """
    horizontal = EARTH_RATE * math.cos(latitude)
    if horizontal < 1e-9 * EARTH_RATE:
        return math.nan
    return math.hypot(grade.gyro_bias, grade.gyro_bias_instability) / horizontal


def level_limit(grade: ImuGrade) -> float:
    """1-sigma level of a base that stands still [rad]: sigma_ba / g.

    Only turns and tilts of the base tell an accelerometer's bias from a tilt.
    """
    return grade.accel_bias / GRAVITY_EQUATOR
