"""Mechanisation in the wander-azimuth frame.

a is level, like ENU, but turned by a wander angle that nobody needs to know: a stands for
ENU turned about up such that

    e_a = C_ae z_e = (cos L sin alpha, cos L cos alpha, sin L)        C_na = Rz(alpha)

is the Earth's axis. That column of the position matrix is all of it that attitude and
velocity need: w_ie = Omega e_a. It obeys de/dt = -w_ea x e, with w_ea horizontal, and has no
singularity anywhere. Its horizontal part is unknown at first: zero, with the variance of a
vector of length cos L and any direction.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sins_align.earth import (
    EARTH_RATE,
    ECCENTRICITY_SQUARED,
    normal_gravity,
    radii_of_curvature,
)
from sins_align.odo.epoch import AidedEpoch
from sins_align.rotation import cross3, exp_rotation
from sins_align.types import Array, Position

SECOND_ECCENTRICITY_SQUARED = ECCENTRICITY_SQUARED / (1.0 - ECCENTRICITY_SQUARED)

_ONE_AND_A_HALF = 1.5 * np.eye(3)


class Course(NamedTuple):
    """What a navigation step went through; vectors in a at the start of the epoch.

    C_start, v_start : (3, 3) C_ab, (3,) v_a at the start
    U, S : (3,) C_start u, C_start s [m/s], [m]
    path, area : (3,) int v dt, int int v dt dt, in a as it turns [m], [m s]
    w_ia, w_2 : (3,) rate of a against i, and that plus the Earth's rate [rad/s]
    radius : of the transport rate [m]
    """

    C_start: Array
    v_start: Array
    U: Array
    S: Array
    path: Array
    area: Array
    w_ia: Array
    w_2: Array
    radius: float


class WanderNavigation:
    """Attitude, velocity and the Earth's axis in a.

    C_ab : (3, 3); v_a : (3,) of the IMU over ground [m/s]; e_a : (3,) the Earth's axis, its
    horizontal part as far as known; altitude [m]
    """

    def __init__(self, C_ab: Array, v_a: Array, position: Position) -> None:
        self.C_ab = C_ab
        self.v_a = v_a
        self.e_a = np.array([0.0, 0.0, math.sin(position.latitude)])
        self.altitude = position.altitude

    @property
    def latitude(self) -> float:
        """Of the vertical part of the Earth's axis [rad]."""
        return math.asin(min(1.0, max(-1.0, float(self.e_a[2]))))

    @property
    def wander_angle(self) -> float:
        """alpha of the horizontal part of the Earth's axis [rad]."""
        return math.atan2(self.e_a[0], self.e_a[1])

    def transport_rate(self, v_a: Array, transverse: float) -> Array:
        """w_ea = up x (shape operator) v [rad/s].

        1/R_M - 1/R_N = (e'^2 cos^2 L) / R_N: the curvature along north is larger by it, and
        north is the direction of the horizontal part of e_a, of length cos L.
        """
        x, y, _ = v_a.tolist()
        ex, ey, _ = self.e_a.tolist()
        north = SECOND_ECCENTRICITY_SQUARED * (ex * x + ey * y)
        return np.array([-(y + north * ey), x + north * ex, 0.0]) / (transverse + self.altitude)

    def rate(self) -> Array:
        """(3,) w_ia now, in a [rad/s]."""
        transverse = radii_of_curvature(self.latitude)[1]
        return EARTH_RATE * self.e_a + self.transport_rate(self.v_a, transverse)

    def advance(self, epoch: AidedEpoch) -> Course:
        """Carry attitude and velocity to the end of the epoch.

        dC_ab/dt = C_ab [w_ib x] - [w_ia x] C_ab
        dv/dt = C_ab f - (2 w_ie + w_ea) x v + g                        Groves (5.28), (5.29)

        with the frame's own rate to first order over the epoch, and constant: what is left out is
        0.1 ug in a manoeuvre, and averages out.
        """
        T = epoch.duration_s
        C = self.C_ab
        U, S = C @ epoch.u, C @ epoch.s
        transverse = radii_of_curvature(self.latitude)[1]
        g = normal_gravity(self.latitude, self.altitude)
        path = self.v_a * T + S
        path[2] -= 0.5 * g * T * T
        w_ie = EARTH_RATE * self.e_a
        w_ea = self.transport_rate(path / T, transverse)
        w_ia = w_ie + w_ea
        w_2 = w_ie + w_ia
        turned = cross3(w_ia, T * U - S)
        v_start = self.v_a
        v_a = v_start + U - turned - cross3(w_2, path)
        v_a[2] -= g * T
        path = path - (T * T / 6.0) * cross3(w_ia, U) - (0.5 * T) * cross3(w_2, path)
        # Of a parabola through path and change of velocity.
        area = (0.5 * T) * path - (T * T / 12.0) * (v_a - v_start)
        self.C_ab = exp_rotation(-w_ia * T) @ C @ epoch.C_end
        self.v_a = v_a
        self.e_a = self.e_a - T * cross3(w_ea, self.e_a)
        self.altitude += float(path[2])
        return Course(C, v_start, U, S, path, area, w_ia, w_2, transverse + self.altitude)

    def correct(self, phi: Array, dv_a: Array) -> None:
        """Take estimated errors off: misalignment (3,) [rad], velocity error (3,) [m/s]."""
        C = exp_rotation(phi) @ self.C_ab
        self.C_ab = C @ (_ONE_AND_A_HALF - 0.5 * (C.T @ C))  # stays orthogonal
        self.v_a = self.v_a - dv_a
