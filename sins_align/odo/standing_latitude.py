"""The latitude by the vertical part of the Earth's rate, of a vehicle that stands.

Its gyros turn about up by Omega sin L. Near the equator, where the length of the horizontal part
hardly changes with the latitude, that changes by the most; and it tells the hemisphere.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from sins_align.earth import EARTH_RATE, GRAVITY_EQUATOR
from sins_align.grades import ImuGrade
from sins_align.latitudes import latitude_of_rate
from sins_align.odo.epoch import AidedEpoch
from sins_align.rotation import unskew3
from sins_align.types import LatitudeEstimate

# The time that is looked at, and the least that tells [s].
WINDOW_S, LEAST_S = 120.0, 20.0
# Wind and people rock a vehicle that stands with periods up to this [s], by as much as is seen; and
# it creeps on its tyres by this, unseen [rad].
ROCKING_S, CREEP = 20.0, 2e-6
# Who gets in or out tilts it by more than this [rad], and may turn it for good; in sigma of the
# accelerometers' noise likewise.
LEAST_TILT, TILT_RATIO = 3e-4, 6.0


class StandingLatitude:
    """The mean rate about up, weighted by Hann's window, since the vehicle has come to stand.

    latitude : the best so far; None before there is one

    Parameters
    ----------
    given : the latitude to compare it with [rad]
    """

    def __init__(self, grade: ImuGrade, given: float) -> None:
        self.latitude: LatitudeEstimate | None = None
        self._given = given
        self._bias = math.hypot(grade.gyro_bias, grade.gyro_bias_instability)
        self._arw, self._vrw = grade.gyro_arw, grade.accel_vrw
        # Length of an epoch, angle at its end and mean angle from its start, beyond the Earth's.
        self._epochs: deque[tuple[float, float, float]] = deque()
        self._time_s = 0.0
        self._up_b = np.zeros(3)  # when it began

    def add(self, epoch: AidedEpoch, stands: bool) -> None:
        """Take in an epoch, with nothing taken off its samples."""
        T, up_b = epoch.duration_s, epoch.u / np.linalg.norm(epoch.u)
        noise = math.sqrt(2.0 / T) * self._vrw / GRAVITY_EQUATOR
        is_tilted = np.linalg.norm(up_b - self._up_b) > LEAST_TILT + TILT_RATIO * noise
        if not stands or epoch.gap_s > 0.0 or is_tilted:
            self._epochs.clear()
            self._time_s, self._up_b = 0.0, up_b
            return
        earth = EARTH_RATE * math.sin(self._given) * T
        whole = float(up_b @ unskew3(epoch.C_end)) - earth
        # An engine's shaking, seen once an epoch, would be a slow one.
        mean = float(up_b @ unskew3(epoch.B)) / T - 0.5 * earth
        self._epochs.append((T, whole, mean))
        self._time_s += T
        while self._time_s > WINDOW_S:
            self._time_s -= self._epochs.popleft()[0]
        if self._time_s >= LEAST_S:
            found = self._estimate()
            if self.latitude is None or found.sigma < self.latitude.sigma:
                self.latitude = found

    def _estimate(self) -> LatitudeEstimate:
        """By the time looked at.

        Rocking by r rad, at periods from P down, leaves no more than 2 sqrt(2) r P^2 / T^3 of the
        rate; white noise has 3/2 the variance it has in a plain mean.
        """
        T = self._time_s
        lengths, whole, mean = np.array(self._epochs).T
        t, angle = np.cumsum(lengths) - 0.5 * lengths, np.cumsum(whole) - whole + mean
        weights = np.sin((math.pi / T) * 0.5 * (t[1:] + t[:-1])) ** 2
        excess = float(weights @ np.diff(angle)) / float(weights @ np.diff(t))
        t, angle = t - t.mean(), angle - angle.mean()
        rocking = float(np.std(angle - (float(t @ angle) / float(t @ t)) * t))
        sigma = math.hypot(
            self._bias,
            self._arw * math.sqrt(1.5 / T),
            2.0 * math.sqrt(2.0) * rocking * ROCKING_S**2 / T**3,
            2.0 * CREEP / T,
        )
        return latitude_of_rate(excess, sigma, self._given)
