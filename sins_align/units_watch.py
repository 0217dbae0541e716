"""Whether gyros and accelerometers belong together: in units, and in axes.

Gravity hardly turns in inertial space (0.25 deg a minute). Carried there by the gyros it must
stay where it is, whatever the base does; by gyros that give degrees a second it turns 57 times as
fast as the Earth, and with every motion of the base.

What is carried is the force, though, and that of a vehicle on a bend leans and turns with it: a
steady circle, read as degrees, is one that stands still. Of a vehicle that may drive only gyros
are doubted that say what they say in degrees where it stands: 57 times the Earth's rate.
"""

from __future__ import annotations

import math

import numpy as np

from sins_align.earth import EARTH_RATE
from sins_align.increments import integrate_rotation
from sins_align.reasons import AXES_DIFFER, GYRO_IN_DEGREES, Finding
from sins_align.rotation import dcm_from_quaternion
from sins_align.types import Array, ImuBlock, ImuSampling
from sins_align.units import DEG

# Looked at when so many blocks of a second have come, and then no more where nothing was found.
VERDICTS = (30, 60)
# Between the first and the last third gravity turns by more than this [rad], and by a quarter of
# it at most where the rates are taken for degrees.
MOST_TURN, SHARE = 1.5 * DEG, 0.25
# A base that tilts by more than this [rad], and gyros that make it worse.
LEAST_TILT, WORSE = 1.0 * DEG, 1.1
# Mean rate of a base that stands, by gyros that give degrees [rad/s]; as parts of it, how far it
# may be off, and how much it may scatter from second to second: wind rocks it.
STANDS_IN_DEGREES, OFF, SCATTER = EARTH_RATE / DEG, 0.3, 1.5


class UnitsWatch:
    """Watches the first minute of an alignment, and every half one while something is wrong.

    fault : why nothing can be made of the data; None where something can
    hint : what may be wrong with the axes, None where nothing is

    Parameters
    ----------
    is_driving : whether the base may drive. The force of a turn tilts the measured one of a base
        that does not: no hint, and no fault but while it stands
    """

    def __init__(self, sampling: ImuSampling, is_driving: bool = False) -> None:
        self._sampling, self._is_driving = sampling, is_driving
        self.fault: Finding | None = None
        self.hint: Finding | None = None
        self._begin()

    def _begin(self) -> None:
        self._turned = [np.eye(3), np.eye(3)]  # b -> b0, by rates as they are, and as degrees
        self._forces: tuple[list[Array], list[Array], list[Array]] = ([], [], [])
        self._rates: list[Array] = []  # means of the blocks, as they are, in b
        self._is_done = False

    def update(self, block: ImuBlock) -> None:
        """Take in a block of samples."""
        if self._is_done:
            return
        f_b = block.f_ib_b[:, 1:].mean(axis=1)
        rates = (block.w_ib_b, block.w_ib_b * DEG)
        for k, w_ib_b in enumerate(rates):
            q = integrate_rotation(block._replace(w_ib_b=w_ib_b), self._sampling)
            before = self._turned[k]
            after = before @ dcm_from_quaternion(q / np.linalg.norm(q))
            self._forces[k].append(0.5 * (before + after) @ f_b)
            self._turned[k] = after
        self._forces[2].append(f_b)
        self._rates.append(block.w_ib_b[:, 1:].mean(axis=1))
        if len(self._forces[2]) in VERDICTS:
            self._judge()

    def _judge(self) -> None:
        raw, scaled, body = (np.array(forces) for forces in self._forces)
        count = raw.shape[0]
        turn, as_degrees = _turn(raw), _turn(scaled)
        tilt, left = _spread(body), _spread(raw)
        found = turn > MOST_TURN and as_degrees < SHARE * turn
        if tilt > LEAST_TILT:  # taken for degrees, they would have to explain it
            found = found and _spread(scaled) < 0.5 * tilt
        if self._is_driving:
            found = found and _stands_in_degrees(np.array(self._rates))
        span = round(2 * count / 3)
        figures = {"angle_deg": turn / DEG, "span_s": span, "scaled_deg": as_degrees / DEG}
        was_faulty = self.fault is not None
        self.fault = GYRO_IN_DEGREES(**figures) if found else None
        differ = tilt > LEAST_TILT and left > WORSE * tilt and not (found or self._is_driving)
        self.hint = AXES_DIFFER(tilt_deg=tilt / DEG, left_deg=left / DEG) if differ else None
        if found or was_faulty:
            self._begin()
            self._is_done = not found
        else:
            self._is_done = count == VERDICTS[-1]


def _stands_in_degrees(rates: Array) -> bool:
    """Whether (N, 3) are, in degrees a second, those of a base that stands."""
    mean = rates.mean(axis=0)
    off = abs(float(np.linalg.norm(mean)) / STANDS_IN_DEGREES - 1.0)
    scatter = math.sqrt(float(((rates - mean) ** 2).sum(axis=1).mean()))
    return off < OFF and scatter < SCATTER * STANDS_IN_DEGREES


def _turn(forces: Array) -> float:
    """Angle between the mean (N, 3) of the first third and that of the last [rad]."""
    third = forces.shape[0] // 3
    a, b = forces[:third].mean(axis=0), forces[-third:].mean(axis=0)
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))


def _spread(forces: Array) -> float:
    """Root mean square angle of (N, 3) from their mean direction [rad]."""
    mean = forces.mean(axis=0)
    across = np.cross(forces, mean / np.linalg.norm(mean))
    return float(np.sqrt((across**2).sum(axis=1).mean()) / np.linalg.norm(mean))
