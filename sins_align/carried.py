"""An attitude carried on by the IMU alone, with its covariance.

    C_nb(t + dt) = Exp(-w_in dt) C_nb(t) C_turned            w_in = w_ie + w_en
    d phi / dt   = -w_in x phi - C_nb (b + M w_ib_b + white noise)

with M the scale errors and misalignments of the gyros, whose part is kept as the response to each
of the nine: a vehicle that turns on a circle is back where it was with most of them.

A vehicle that drives turns ENU over the Earth by v / R. Its velocity is that of dead
reckoning from rest: wrong by sigma_a t for levels and accelerometers that are wrong by sigma_a,
which tilts the levels by sigma_a t^2 / 2 R, half of what they are wrong by after 13 minutes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sins_align.earth import (
    GRAVITY_EQUATOR,
    SEMI_MAJOR_AXIS,
    earth_rate_n,
    normal_gravity,
    transport_rate_n,
)
from sins_align.grades import ImuGrade
from sins_align.rotation import cross3, exp_rotation, log_rotation, skew3
from sins_align.types import Array, ImuBlock, ImuSampling, Position
from sins_align.windows import integrate_window


@dataclass(frozen=True)
class Carrier:
    """What carrying needs to know beside the samples.

    grade, sampling : of the IMU
    position : of the start
    drives : whether the base may leave its place
    """

    grade: ImuGrade
    sampling: ImuSampling
    position: Position
    drives: bool


@dataclass(frozen=True, eq=False)
class Carried:
    """An attitude at a time.

    C_nb : (3, 3)
    covariance : (6, 6) of phi (n) and of the gyro bias (b) [rad^2], [rad^2/s^2]
    gyro_bias : (3,) taken off the rate [rad/s]
    v_n : (3,) velocity, 0 where the base does not drive [m/s]
    turned : (3, 3, 3) int C_nb[:, i] w_j dt by axis, i, j: minus phi by the elements of M
    driven_s : time since it was at rest [s]
    """

    C_nb: Array
    covariance: Array
    gyro_bias: Array
    v_n: Array
    turned: Array
    driven_s: float = 0.0


def carry(carried: Carried, block: ImuBlock, carrier: Carrier) -> Carried:
    """`carried` at the end of a block that begins where it stands."""
    if block.stamp_ns.shape[0] == 1:
        return carried
    values = np.concatenate((block.w_ib_b - carried.gyro_bias[:, None], block.f_ib_b))
    window = integrate_window(block.stamp_ns, values, carrier.sampling)
    dt = window.duration_s
    w_in, v_n = earth_rate_n(carrier.position.latitude), carried.v_n
    if carrier.drives:
        place = carrier.position
        w_en = transport_rate_n(place.latitude, place.altitude, v_n)
        gravity = np.array([0.0, 0.0, normal_gravity(place.latitude, place.altitude)])
        turning = cross3(2.0 * w_in + w_en, v_n)
        w_in = w_in + w_en
        gained = exp_rotation(-0.5 * dt * w_in) @ carried.C_nb @ window.u
        v_n = v_n + gained - (gravity + turning) * dt
        v_n[2] = 0.0  # a height would only run away
    C_nb = exp_rotation(-w_in * dt) @ carried.C_nb @ window.C_end
    mean = carried.C_nb @ window.B / dt
    return replace(
        carried,
        C_nb=C_nb,
        covariance=spread(carried, w_in, mean * dt, dt, carrier.grade),
        v_n=v_n,
        turned=carried.turned + mean[:, :, None] * log_rotation(window.C_end),
        driven_s=carried.driven_s + dt,
    )


def begin(C_nb: Array, covariance: Array, gyro_bias: Array) -> Carried:
    """A base at rest."""
    return Carried(C_nb, covariance, gyro_bias, np.zeros(3), np.zeros((3, 3, 3)))


def spread(carried: Carried, w_in: Array, lever: Array, dt: float, grade: ImuGrade) -> Array:
    """(6, 6) covariance of `carried` after `dt` [s]; lever : (3, 3) int C_nb dt [s].

    The bias walks as far as one of the declared instability and correlation time does at first.
    """
    F = np.eye(6)
    F[:3, :3] -= skew3(w_in) * dt
    F[:3, 3:] = -lever
    ahead = F @ carried.covariance @ F.T
    walk = 2.0 * grade.gyro_bias_instability**2 / grade.gyro_bias_correlation_s
    ahead[range(6), range(6)] += np.repeat([grade.gyro_arw**2 * dt, walk * dt], 3)
    return 0.5 * (ahead + ahead.T)


def misalignment_covariance(carried: Carried, carrier: Carrier) -> Array:
    """(3, 3) of phi, with what turns and dead reckoning add [rad^2]."""
    grade = carrier.grade
    sigma = np.full((3, 3), grade.misalignment)
    np.fill_diagonal(sigma, grade.gyro_scale)
    response = (carried.turned * sigma).reshape(3, 9)
    P: Array = carried.covariance[:3, :3] + response @ response.T
    if not carrier.drives:
        return P
    triad = math.hypot(grade.accel_scale, grade.misalignment)
    accel = math.hypot(grade.accel_bias, GRAVITY_EQUATOR * triad)
    variance = GRAVITY_EQUATOR**2 * P.diagonal()[:2].max() + accel**2
    way = 0.5 * carried.driven_s**2 / SEMI_MAJOR_AXIS
    tan = math.tan(carrier.position.latitude)
    return P + way * way * variance * np.diag([1.0, 1.0, tan * tan])
