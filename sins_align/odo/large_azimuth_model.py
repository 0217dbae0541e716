"""The large-azimuth error model over one epoch, given U: Wu, Tang and Huang (21), (22).

In axes turned by U from the true ones, which are those of the computed navigation but for phi,
the error model of the wander frame holds: with y the errors there,

    y  = T(U) x + t(U):     dv_y = Rz(U) dv + (I - Rz(U)) v~,      de = (I - Rz(U)) e~ + ...
    y+ = A y                                                        (`error_model`)
    x+ = T(U)' y+ + t+(U):  dv = Rz(U)' dv_y + (I - Rz(U)') v~,     U+ = U + phi_z + tan L/R d_E

dv: velocity error in ENU; e: the Earth's axis, whose error stands for that of the Earth's rate;
tilde: computed. Everything is linear in x once U is given. docs/large_azimuth.md has the
paper's equations, corrected, which a test compares with these.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sins_align.odo.layout import (
    AXIS,
    ENU_SIZE,
    ODOMETER_POSITION,
    PLACE,
    VELOCITY,
    U,
    path_of,
)
from sins_align.types import Array

PATH = path_of(ENU_SIZE)
_PLACE_INDEX = np.r_[PLACE]
_EYE = np.eye(3)


def about_up(angle: Array) -> Array:
    """Rz(U) of (m,) angles [rad]: (m, 3, 3), [c s 0; -s c 0; 0 0 1]."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.zeros((angle.shape[0], 3, 3))
    R[:, 0, 0] = R[:, 1, 1] = c
    R[:, 0, 1], R[:, 1, 0] = s, -s
    R[:, 2, 2] = 1.0
    return R


@dataclass(frozen=True)
class StateGivenU:
    """x+ = F(U) x + g(U) over an epoch, the path included; fulfils `ConditionallyLinear`.

    A : (n + 3, n) of the wander frame, with the Earth's axis where x has the place
    v_start, v_end, path : (3,) computed velocity at the ends, its integral [m/s], [m]
    e_a : (3,) computed Earth's axis; axis_by_place : (3, 3) its error by the place's [1/m]
    turn_by_path : (3,) turn of ENU by the way: tan L / R to the east [rad/m]
    """

    A: Array
    v_start: Array
    v_end: Array
    path: Array
    e_a: Array
    axis_by_place: Array
    turn_by_path: Array

    def at(self, angle: Array) -> tuple[Array, Array]:
        """F (m, n + 3, n) and g (m, n + 3) for (m,) values of U [rad]."""
        A, R = self.A, about_up(angle)
        away = _EYE - R
        F = np.empty((angle.shape[0], *A.shape))
        F[:] = A
        F[:, :, U] = 0.0  # U is in T(U): y has no phi_z at the start
        F[:, :, VELOCITY] = A[:, VELOCITY] @ R
        F[:, :, PLACE] = A[:, AXIS] @ (R @ self.axis_by_place)
        g = away @ self.v_start @ A[:, VELOCITY].T + away @ self.e_a @ A[:, AXIS].T
        back = R.transpose(0, 2, 1)
        for rows, known in ((VELOCITY, self.v_end), (PATH, self.path)):
            F[:, rows] = back @ F[:, rows]
            g[:, rows] = known + (back @ (g[:, rows] - known)[:, :, None])[:, :, 0]
        F[:, U, U] = 1.0
        # The place is the sum of the paths, without what the odometer adds to them.
        F[:, PLACE], g[:, PLACE] = F[:, PATH], g[:, PATH]
        F[:, PLACE, ODOMETER_POSITION] = 0.0
        F[:, U] += self.turn_by_path @ F[:, PLACE]
        g[:, U] += g[:, PLACE] @ self.turn_by_path
        F[:, _PLACE_INDEX, _PLACE_INDEX] += 1.0
        return F, g


@dataclass(frozen=True)
class MeasurementGivenU:
    """z = H(U) x + h(U), the navigation's displacement minus the odometer's.

    z = Rz(U) int dv dt + (I - Rz(U)) int v~ dt + a x phi_l + ..., with a what turns with phi,
    which is minus the odometer's displacement but for the lever arm: the exact form of (26), (38),
    (39), in the axes of the computed navigation. There the odometer's noise is along and across
    the vehicle; in true axes it would be turned by U as well, and a large one would seem to
    measure U. Fulfils `ConditionallyLinear`.

    H : (3, n + 3) by the errors in the axes of the computed navigation; path : (3,) int v~ dt [m]
    e_a, axis_by_place : see `StateGivenU`
    """

    H: Array
    path: Array
    e_a: Array
    axis_by_place: Array

    def at(self, angle: Array) -> tuple[Array, Array]:
        """H (m, 3, n + 3) and h (m, 3) for (m,) values of U [rad]."""
        R = about_up(angle)
        away = _EYE - R
        by_axis = self.H[:, AXIS]
        H = np.empty((angle.shape[0], *self.H.shape))
        H[:] = self.H
        H[:, :, U] = 0.0
        H[:, :, PLACE] = by_axis @ (R @ self.axis_by_place)
        H[:, :, PATH] = R
        return H, away @ self.path + away @ self.e_a @ by_axis.T
