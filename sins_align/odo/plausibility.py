"""Whether the odometer's speed is that of the vehicle: its sign and its unit.

In axes carried by the gyros, frozen in inertial space, the mean velocity of an epoch is

    C d = s (v_0 + (int int C f - g t^2 / 2 up) / T)

d the displacement by the odometer, s how much of the true speed it tells. Velocity and gravity
at the start are unknown: a constant and a slope in time, of each axis. What is left of both
sides without them is a change of velocity by the odometer and one by the accelerometers, in
a turn too, and a slope of the road is no part of it, as the axes are those of the gyros.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from sins_align.odo.epoch import AidedEpoch
from sins_align.reasons import ODOMETER_OPPOSITE, ODOMETER_SCALE, Finding
from sins_align.types import Array

# The epochs that are looked at, and how many there must be at least. Longer, the Earth's rotation
# turns gravity by more than it should.
WINDOW_S, LEAST_EPOCHS = 30.0, 10
# What is left of the velocity by the accelerometers has to be so large, root mean square [m/s].
LEAST_CHANGE = 1.0
# Of the squared correlation of both. Slips, a second of latency, and an odometer that sticks leave
# less; what does not correlate is no matter of sign or unit.
LEAST_CORRELATION = 0.8
# Scale that is not to be had by tyres; in sigma; and what is right again.
IMPLAUSIBLE, RATIO = 1.4, 5.0
PLAUSIBLE = 1.2
# Residuals hang together for so many epochs.
CORRELATED = 4.0
# Verdicts in a row that make a finding, or end it.
IN_A_ROW = 5


class Slope(NamedTuple):
    """Change of speed by the odometer over that by the accelerometers, with its 1 sigma."""

    value: float
    sigma: float


class OdometerPlausibility:
    """Looks at epochs one after the other, with nothing taken off their samples.

    forward_b : (3,) direction of travel in b, as declared
    """

    def __init__(self, forward_b: Array) -> None:
        self._forward_b = forward_b
        self._finding: Finding | None = None
        self._row = 0  # verdicts against what is said now
        self._begin()

    def _begin(self) -> None:
        self._epochs: deque[tuple[float, Array, Array]] = deque()
        self._C, self._v, self._time_s = np.eye(3), np.zeros(3), 0.0

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What is wrong with the odometer; stays until it is seen to be right."""
        return () if self._finding is None else (self._finding,)

    def add(self, epoch: AidedEpoch) -> bool:
        """Take in an epoch; returns whether an odometer that was wrong has become right.

        One without odometer, or with samples missing, begins the window anew.
        """
        if epoch.travel is None or epoch.gap_s > 0.0:
            self._begin()
            return False
        C, T = self._C, epoch.duration_s
        by_odometer = C @ (epoch.travel.M @ self._forward_b) / T
        by_imu = self._v + C @ epoch.s / T
        self._epochs.append((self._time_s + 0.5 * T, by_odometer, by_imu))
        self._v = self._v + C @ epoch.u
        self._C = C @ epoch.C_end
        self._time_s += T
        while self._time_s - self._epochs[0][0] > WINDOW_S:
            self._epochs.popleft()
        return self._judge(self.slope())

    def slope(self) -> Slope | None:
        """By the window; None where it tells nothing."""
        if len(self._epochs) < LEAST_EPOCHS:
            return None
        times, by_odometer, by_imu = zip(*self._epochs, strict=True)
        t = np.array(times)
        unknown = np.stack((np.ones(t.size), t - t.mean()))
        unknown /= np.linalg.norm(unknown, axis=1, keepdims=True)
        x, y = np.array(by_imu), np.array(by_odometer)
        x, y = (a - unknown.T @ (unknown @ a) for a in (x, y))
        xx, xy, yy = float((x * x).sum()), float((x * y).sum()), float((y * y).sum())
        if xx < LEAST_CHANGE**2 * t.size or xy * xy < LEAST_CORRELATION * xx * yy or yy == 0.0:
            return None
        rest = max(yy - xy * xy / xx, 0.0) / (3.0 * t.size / CORRELATED)
        return Slope(xy / xx, math.sqrt(rest / xx))

    def _judge(self, slope: Slope | None) -> bool:
        """Note a verdict; whether the finding ends."""
        if slope is None:
            return False
        verdict = _verdict(slope)
        if verdict is None and not 1.0 / PLAUSIBLE < slope.value < PLAUSIBLE:
            return False
        if (verdict is None) == (self._finding is None):
            self._row = 0
            self._finding = verdict
            return False
        self._row += 1
        if self._row < IN_A_ROW:
            return False
        self._row, self._finding = 0, verdict
        return verdict is None


def _verdict(slope: Slope) -> Finding | None:
    """What the slope says of the odometer; None: nothing is wrong."""
    value, margin = slope.value, RATIO * slope.sigma
    if value < -margin:
        return ODOMETER_OPPOSITE(slope=value)
    if value - margin > IMPLAUSIBLE or value + margin < 1.0 / IMPLAUSIBLE:
        return ODOMETER_SCALE(slope=value)
    return None
