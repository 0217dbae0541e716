"""What a NavSatFix says, the same for the live node and for a bag."""

from __future__ import annotations

import math
from typing import Any

from sins_align.types import Position
from sins_align.units import DEG


def position_from_fix(fix: Any) -> Position | None:
    """Position of a sensor_msgs/NavSatFix, of ROS or of rosbags; None where it has none.

    It has one with a status of at least 0 and a place on the Earth; an altitude that is not
    finite is 0.
    """
    known = fix.status.status >= 0 and math.isfinite(fix.longitude)
    if not known or not abs(fix.latitude) <= 90.0 or not abs(fix.longitude) <= 180.0:
        return None
    altitude = float(fix.altitude) if math.isfinite(fix.altitude) else 0.0
    return Position(float(fix.latitude) * DEG, float(fix.longitude) * DEG, altitude)
