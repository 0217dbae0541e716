"""Noise and prior variances of an IMU on a vehicle, from its grade."""

from __future__ import annotations

import math

import numpy as np

from sins_align.earth import GRAVITY_EQUATOR
from sins_align.grades import ImuGrade
from sins_align.odo.epoch import AidedEpoch
from sins_align.odo.error_model import ImuNoise
from sins_align.odo.layout import PHI, VELOCITY
from sins_align.types import Array

# These stand for sensors that claim to have no noise.
LEAST_GYRO_NOISE = 1e-11  # [rad/sqrt(s)]
LEAST_ACCEL_NOISE = 1e-7  # [m/s/sqrt(s)]
# A gap of this length hides the motion of a vehicle on its suspension.
GAP_S = 0.07  # [s]
GAP_MOST = 10.0
LEAST_ACCEL_BIAS = 1e-8  # [m/s^2]


def imu_noise(grade: ImuGrade) -> ImuNoise:
    """White noise of a grade; the drift of the biases as a random walk."""
    walk = grade.gyro_bias_instability * math.sqrt(2.0 / grade.gyro_bias_correlation_s)
    return ImuNoise(
        max(grade.gyro_arw, LEAST_GYRO_NOISE), max(grade.accel_vrw, LEAST_ACCEL_NOISE), walk
    )


def gyro_variances(grade: ImuGrade, up_b: Array) -> tuple[Array, Array]:
    """(3,), (3,) variances of the bias [rad^2/s^2] and of the response to turning about up.

    Vehicles turn about the vertical: of the nine scale errors and misalignments only their
    combination by it matters.
    """
    bias = grade.gyro_bias**2 + grade.gyro_bias_instability**2
    return np.full(3, max(bias, 1e-30)), _triad_variance(grade.gyro_scale, grade.misalignment, up_b)


def accel_variance(grade: ImuGrade, up_b: Array) -> Array:
    """(3,) of bias and, as gravity is nearly all there is, scale errors and misalignments."""
    triad = _triad_variance(grade.accel_scale, grade.misalignment, up_b)
    return np.maximum(grade.accel_bias**2 + GRAVITY_EQUATOR**2 * triad, LEAST_ACCEL_BIAS**2)


def gap_noise(epoch: AidedEpoch) -> Array:
    """(6,) variances of PHI, then VELOCITY, of what happened while samples were missing.

    Interpolation knows all of a motion that is slow against the gap, and nothing of one that
    is quick: the unrest of the epoch stands for it.
    """
    blind = epoch.gap_s * min(GAP_MOST, (epoch.gap_s / GAP_S) ** 2)
    rate, force = epoch.unrest
    variance = np.empty(6)
    variance[PHI] = (blind * rate) ** 2
    variance[VELOCITY] = (blind * force) ** 2
    return variance


def _triad_variance(scale: float, misalignment: float, up_b: Array) -> Array:
    square = up_b * up_b
    return scale**2 * square + misalignment**2 * (1.0 - square)
