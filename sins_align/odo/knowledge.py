"""What a filter of `odo_align` gives out: attitude in ENU with its covariance, and the rest."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sins_align.earth import SEMI_MAJOR_AXIS
from sins_align.odo.filter import AidedFilter
from sins_align.odo.layout import ACCEL_BIAS, GYRO_BIAS, ODOMETER, PHI
from sins_align.rotation import exp_rotation, log_rotation, unskew3
from sins_align.types import Array, OdometerEstimate, Witness


class Knowledge(NamedTuple):
    """What the filter knows; of a wander filter, given the length of the Earth's axis.

    C_nb : (3, 3) attitude in ENU; covariance : (3, 3) of phi, axes east, north, up [rad^2]
    gyro_bias, accel_bias : (3,) with their 1 sigma [rad/s], [m/s^2]; the sigma of the
        accelerometers' contains the scale errors that on a vehicle look like biases
    odometer : its estimates, with their 1 sigma
    """

    C_nb: Array
    covariance: Array
    gyro_bias: Array
    gyro_bias_sigma: Array
    accel_bias: Array
    accel_bias_sigma: Array
    odometer: OdometerEstimate


def knowledge_of(filter_: AidedFilter) -> Knowledge:
    """At the end of the last epoch. C_nb = Rz(alpha) C_ab."""
    posterior, sensors = filter_.posterior(), filter_.sensors
    mean, P = posterior.mean, posterior.P
    s, c = math.sin(posterior.alpha), math.cos(posterior.alpha)
    C_na = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    J = C_na @ posterior.phi_by_errors
    variance = P.diagonal()
    # Of biases and scale errors the filter knows the sum: what it does not tell apart.
    accel = variance[ACCEL_BIAS]
    apart = 1.0 - 2.0 * np.minimum(accel / sensors.accel_prior, 1.0)
    return Knowledge(
        C_nb=C_na @ exp_rotation(mean[PHI]) @ filter_.navigation.C_ab,
        covariance=J @ P @ J.T,
        gyro_bias=sensors.gyro_bias + mean[GYRO_BIAS],
        gyro_bias_sigma=np.sqrt(variance[GYRO_BIAS]),
        accel_bias=sensors.accel_bias + mean[ACCEL_BIAS],
        accel_bias_sigma=np.sqrt(np.maximum(accel + apart * sensors.accel_triad, 0.0)),
        odometer=filter_.odometer.estimate(mean[ODOMETER], P[ODOMETER, ODOMETER]),
    )


def carry_attitude(filter_: AidedFilter, C_nb: Array, turned: Array, ahead_s: float) -> Array:
    """C_nb some time after the last epoch.

    The biases, and the turning of ENU with the Earth and over it, are small angles.

    Parameters
    ----------
    C_nb : (3, 3) at the end of the last epoch
    turned : (3, 3) of b then to b there, as the gyros say
    ahead_s : time since [s]
    """
    navigation = filter_.navigation
    C_na = C_nb @ navigation.C_ab.T
    about_up = float(navigation.C_ab[2] @ unskew3(turned))
    drift = filter_.sensors.gyro_bias * ahead_s + filter_.sensors.gyro_turn * about_up
    w_in = C_na @ navigation.rate()
    # ENU wanders against a by v_E tan L / R.
    east = float(C_na[0] @ navigation.v_a)
    w_in[2] += east * float(navigation.e_a[2]) / (filter_.cos_latitude * SEMI_MAJOR_AXIS)
    return exp_rotation(-ahead_s * w_in) @ C_nb @ turned @ exp_rotation(-drift)


def compare_attitudes(own: Knowledge, other: Knowledge) -> Witness:
    """The wander filter's attitude against the one that is given out."""
    phi = -log_rotation(own.C_nb @ other.C_nb.T)
    square = phi @ np.linalg.solve(own.covariance + other.covariance, phi)
    return Witness("wander_kf", phi, float(square) / 3.0)
