"""What is known of the shared errors when a filter starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sins_align.grades import ImuGrade
from sins_align.odo.imu_model import accel_variance, gyro_variances
from sins_align.odo.layout import (
    ACCEL_BIAS,
    GYRO_BIAS,
    GYRO_TURN,
    ODOMETER,
    PHI,
    SHARED,
    VELOCITY,
)
from sins_align.odo.odometer_model import OdometerModel
from sins_align.types import Array


@dataclass
class SensorErrors:
    """Estimated errors of the IMU, taken off its samples.

    gyro_bias, accel_bias, gyro_turn : (3,) [rad/s], [m/s^2], [1]
    accel_prior, accel_triad : (3,) prior variance of the accelerometers' biases, and what of it
        are scale errors and misalignments [m^2/s^4]
    """

    gyro_bias: Array
    accel_bias: Array
    gyro_turn: Array
    accel_prior: Array
    accel_triad: Array

    def bias(self, rate: float) -> Array:
        """(6,) of gyros and accelerometers while the vehicle turns about up at `rate` [rad/s]."""
        return np.concatenate((self.gyro_bias + rate * self.gyro_turn, self.accel_bias))

    def correct(self, dx: Array) -> None:
        """Take estimated errors (SHARED or more,) off: of what is left in the samples."""
        # These errors are true minus estimated.
        self.gyro_bias = self.gyro_bias + dx[GYRO_BIAS]
        self.accel_bias = self.accel_bias + dx[ACCEL_BIAS]
        self.gyro_turn = self.gyro_turn + dx[GYRO_TURN]


def shared_prior(
    grade: ImuGrade, up_b: Array, odometer: OdometerModel, level_sigma: float, velocity_sigma: float
) -> tuple[Array, SensorErrors]:
    """(SHARED,) variances at the start, and the sensors' errors: none are known.

    Parameters
    ----------
    up_b : (3,) up in b; level_sigma, velocity_sigma : 1 sigma of the start [rad], [m/s]
    """
    variance = np.zeros(SHARED)
    variance[PHI] = level_sigma**2, level_sigma**2, 0.0
    variance[VELOCITY] = velocity_sigma**2
    variance[GYRO_BIAS], variance[GYRO_TURN] = gyro_variances(grade, up_b)
    variance[ACCEL_BIAS] = prior = accel_variance(grade, up_b)
    variance[ODOMETER] = odometer.prior_variance()
    none = np.zeros(3)
    return variance, SensorErrors(none, none, none, prior, prior - grade.accel_bias**2)
