"""Whether the vehicle stands: by IMU and odometer without a filter, and by the navigation."""

from __future__ import annotations

import enum
import math

import numpy as np

from sins_align.grades import ImuGrade
from sins_align.odo.epoch import AidedEpoch
from sins_align.types import Array

# Unrest of IMU samples in an epoch, beyond their white noise, of a vehicle that stands with
# its engine running and its passengers moving.
QUIET_RATE = 0.008  # [rad/s]
QUIET_FORCE = 0.1  # [m/s^2]
NOISE_FACTOR = 2.0
# Without an odometer it goes on standing while it is no less quiet than it was, by this.
UNREST_RATIO = 2.0
LEAST_RATE = 5e-4  # [rad/s]
LEAST_FORCE = 0.01  # [m/s^2]
# The navigation's path in an epoch of standing: how far it may be from nothing.
STANDING_TOLERANCE = 0.01  # [m]
STANDING_LIMIT = 25.0  # of its normalised square


class Standing(enum.Enum):
    """What is to be made of an epoch."""

    NO = "no"
    POSSIBLE = "possible"  # unless the navigation says otherwise
    ASSUMED = "assumed"  # the user says so


class StandingDetector:
    """Judges epochs one after the other.

    An odometer that says zero is believed if the IMU is quiet. A silent one leaves a vehicle
    that stood standing as long as the IMU stays as quiet as it was: nothing in an IMU tells
    standing from steady driving. The navigation has the last word: it knows of any change of
    velocity since the vehicle stood for sure.

    Parameters
    ----------
    always : the user says that the vehicle stands
    """

    def __init__(self, grade: ImuGrade, always: bool) -> None:
        self._grade = grade
        self._always = always
        self._standing = False
        self._unrest = (0.0, 0.0)  # usual when standing

    def judge(self, epoch: AidedEpoch) -> Standing:
        """What `epoch` looks like."""
        if self._always:
            return Standing.ASSUMED
        travel, (rate, force) = epoch.travel, epoch.unrest
        if travel is not None:
            still = travel.distance == 0.0 and travel.speed_start == travel.speed_end == 0.0
            return Standing.POSSIBLE if still and self._is_quiet(epoch) else Standing.NO
        if not self._standing:
            return Standing.NO
        usual_rate, usual_force = self._unrest
        calm = rate < UNREST_RATIO * usual_rate + LEAST_RATE
        calm = calm and force < UNREST_RATIO * usual_force + LEAST_FORCE
        return Standing.POSSIBLE if calm else Standing.NO

    def _is_quiet(self, epoch: AidedEpoch) -> bool:
        rate, force = epoch.unrest
        # Three axes of white noise, at the rate of the samples.
        white = NOISE_FACTOR * math.sqrt(3.0 / epoch.interval_s)
        grade = self._grade
        return (
            rate < QUIET_RATE + white * grade.gyro_arw
            and force < QUIET_FORCE + white * grade.accel_vrw
        )

    def note(self, epoch: AidedEpoch, standing: bool) -> None:
        """What became of the epoch."""
        if standing and epoch.travel is not None:
            if self._standing:
                rate, force = self._unrest
                self._unrest = (max(rate, epoch.unrest[0]), max(force, epoch.unrest[1]))
            else:
                self._unrest = epoch.unrest
        self._standing = standing


def may_stand(path: Array, covariance: Array) -> bool:
    """Whether the navigation's path (3,), of covariance (3, 3), may be none at all [m], [m^2]."""
    S = covariance + STANDING_TOLERANCE**2 * np.eye(3)
    return bool(path @ np.linalg.solve(S, path) < STANDING_LIMIT)
