"""Error model of the wander-azimuth mechanisation over one epoch.

With C_ab computed = (I - [phi x]) C_ab true, all other errors estimate minus truth, those of
the sensors what is left in the corrected samples:

    dphi/dt = -w_ia x phi + dw_ie + dw_ea - C_ab (eps + kappa r)
    ddv/dt  = f x phi + C_ab nabla - w_2 x dv + v x (2 dw_ie + dw_ea)
    dd/dt   = dv                               (d: the path's error since the epoch began)

eps, nabla: biases of gyros and accelerometers; kappa: the gyros' response to the rate r of
turning about the vertical; dw_ie = Omega (de_x, de_y, 0): the Earth's axis; dw_ea = up x
dv / R. The integrals of f and of C over the epoch are known, so that the transition has a
closed form. Left out are phi by nabla, the difference of the two radii in dw_ea (0.7 %), v x
dw_ea, and 2e-3 or less of the other blocks. docs/odo.md derives it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sins_align.earth import EARTH_RATE, GRAVITY_EQUATOR
from sins_align.odo.epoch import AidedEpoch
from sins_align.odo.layout import (
    ACCEL_BIAS,
    GYRO_BIAS,
    GYRO_TURN,
    PHI,
    SHARED,
    VELOCITY,
    path_of,
)
from sins_align.odo.navigation import Course
from sins_align.rotation import skew3
from sins_align.types import Array

# Epochs come in few lengths; irregular stamps must not fill the memory.
KEPT_DURATIONS = 32

_EYE = np.eye(3)
_BIAS_INDEX, _VELOCITY_INDEX = np.r_[GYRO_BIAS], np.r_[VELOCITY]


@dataclass(frozen=True)
class ImuNoise:
    """White noise and random walks of the IMU.

    gyro [rad/sqrt(s)], accel [m/s/sqrt(s)], gyro_walk [rad/s/sqrt(s)]
    """

    gyro: float
    accel: float
    gyro_walk: float


class ErrorModel:
    """Transition and noise of the navigation errors.

    size : number of states n without the path d; the ones of the Earth's axis come after the
        shared ones
    """

    def __init__(self, noise: ImuNoise, size: int) -> None:
        self._noise = noise
        self._size = size
        self._axis, self._path = slice(SHARED, size), path_of(size)
        self._path_index = np.r_[self._path]
        self._gyro_rows = np.r_[PHI, VELOCITY, self._path]
        self._transition = np.zeros((size + 3, size))
        self._transition[:size, :size] = np.eye(size)
        self._Q: dict[float, Array] = {}

    def transition(self, epoch: AidedEpoch, course: Course, axis: Array, rate: float) -> Array:
        """(n + 3, n): the state at the end of the epoch, with d, from that at its start.

        Only the blocks of the navigation errors are filled in; the array is used again for
        the next epoch.

        Parameters
        ----------
        axis : (3, n - SHARED) error of e_a by the states of the Earth's axis
        rate : r, mean over the epoch [rad/s]
        """
        A, T, C = self._transition, epoch.duration_s, course.C_start
        AXIS, PATH = self._axis, self._path
        U, S = course.U, course.S
        force = skew3(U / T)
        CB, CBB = C @ epoch.B, C @ epoch.BB
        w_axis = EARTH_RATE * axis
        A[PHI, PHI] = _EYE - skew3(T * course.w_ia)
        A[0, 4], A[1, 3] = -T / course.radius, T / course.radius
        A[PHI, AXIS] = T * w_axis
        A[VELOCITY, PHI] = skew3(U)
        A[VELOCITY, VELOCITY] = _EYE - skew3(T * course.w_2)
        A[VELOCITY, AXIS] = skew3(T * U - S + 2.0 * course.path) @ w_axis
        A[VELOCITY, ACCEL_BIAS] = CB
        A[PATH, PHI] = skew3(S)
        A[self._path_index, _VELOCITY_INDEX] = T
        bent = (T * T * T / 6.0) * force + skew3(2.0 * course.area)
        A[PATH, AXIS] = bent @ w_axis
        A[PATH, ACCEL_BIAS] = CBB
        late = skew3((0.5 * T) * U - S) @ CB
        bias = np.concatenate(
            (CB, force @ CBB + late / T, force @ ((0.5 * T) * CBB - (T * T / 12.0) * CB))
        )
        A[self._gyro_rows, GYRO_BIAS] = -bias
        A[self._gyro_rows, GYRO_TURN] = -rate * bias
        return A

    def within(
        self, epoch: AidedEpoch, course: Course, axis: Array, rate: float, l_b: Array
    ) -> Array:
        """(3, n + 3) what phi's growth within the epoch does to a displacement.

        A displacement is turned by the phi of its time and not by that of the end, which H
        takes: int (phi(T) - phi(t)) x dD, of a displacement D that is the path; and the lever
        arm l_b (3,) [m] by phi(T) at the end and phi(0) at the start.
        """
        T, C = epoch.duration_s, course.C_start
        CB, CBB = C @ epoch.B, C @ epoch.BB
        H = np.zeros((3, self._size + 3))
        H[:, self._axis] = skew3(course.area + CB @ l_b) @ (EARTH_RATE * axis)
        bias = skew3(course.area / T) @ CB + CB @ skew3(l_b)
        bias += skew3(course.path) @ (0.5 * CB - CBB / T)
        H[:, GYRO_BIAS] = -bias
        H[:, GYRO_TURN] = -rate * bias
        return H

    def noise(self, duration: float) -> Array:
        """(n + 3, n + 3) covariance that the IMU's noise adds over a time [s]."""
        Q = self._Q.get(duration)
        if Q is None:
            Q = np.zeros((self._size + 3, self._size + 3))
            Q[np.ix_(self._gyro_rows, self._gyro_rows)] = white_noise(self._noise, duration)
            Q[_BIAS_INDEX, _BIAS_INDEX] = self._noise.gyro_walk**2 * duration
            if len(self._Q) >= KEPT_DURATIONS:
                self._Q.clear()
            self._Q[duration] = Q
        return Q


def white_noise(noise: ImuNoise, duration: float) -> Array:
    """(9, 9) covariance of phi, dv and d from the IMU's white noise over a time [s].

    The force is that of gravity: vehicles do not accelerate enough to matter here.
    """
    T = duration
    F = skew3(np.array([0.0, 0.0, GRAVITY_EQUATOR]))
    eye, FF = np.eye(3), F @ F.T
    q, a = noise.gyro**2, noise.accel**2
    Q = np.empty((9, 9))
    Q[:3, :3] = q * T * eye
    Q[3:6, :3] = q * T**2 / 2.0 * F
    Q[6:, :3] = q * T**3 / 6.0 * F
    Q[3:6, 3:6] = q * T**3 / 3.0 * FF + a * T * eye
    Q[6:, 3:6] = q * T**4 / 8.0 * FF + a * T**2 / 2.0 * eye
    Q[6:, 6:] = q * T**5 / 20.0 * FF + a * T**3 / 3.0 * eye
    upper = np.triu_indices(9, 1)
    Q[upper] = Q.T[upper]
    return Q
