"""The error model with a large azimuth error of Wu, Tang and Huang, (12) to (39), corrected.

Plain functions in continuous time, each named after its equation; its docstring has the corrected
equation and what is misprinted in the paper. docs/large_azimuth.md has them all in one place, and
large_azimuth_reference.py is the pair of non-linear mechanisations that they are held against.

b any body axes, n ENU, n' the axes of the computed attitude:

    C_n^n' = (I - [phi_l x]) Rz(U),  Rz(U) = [c s 0; -s c 0; 0 0 1],  phi_l = (phi_E, phi_N, 0)

U is finite, all else small; the three are Euler angles (eq13_M1). Errors are computed minus true (U
that of the heading, clockwise); eps and nabla are what is left in the samples; the odometer reads
(1 + dK) times the distance. What a function takes is what is computed (a tilde in the paper),
unless its name ends in `_true`.

State: U, phi_E, phi_N, dv (3), dlambda, dL, dh, eps (3), nabla (3), dK, and at the end, for the
exact measurement, d = integral of dv since the epoch began (3).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from sins_align.earth import (
    EARTH_RATE,
    earth_rate_n,
    normal_gravity,
    radii_of_curvature,
    transport_rate_n,
)
from sins_align.types import Array

ATTITUDE = slice(0, 3)  # U, phi_E, phi_N
VELOCITY = slice(3, 6)
POSITION = slice(6, 9)  # dlambda, dL, dh
GYRO_BIAS = slice(9, 12)
ACCEL_BIAS = slice(12, 15)
SCALE = slice(15, 16)
PATH = slice(16, 19)
SIZE = 16
EXTENDED = 19

U_FIRST = [2, 0, 1]  # rows E, N, U to rows U, E, N


class Computed(NamedTuple):
    """What the filter knows at an instant: attitude C_b^n', specific force f~, velocity, place."""

    C_nb: Array
    f_b: Array
    v_n: Array
    latitude: float
    altitude: float

    @property
    def f_n(self) -> Array:
        """f~^n' = C_b^n' f~."""
        return self.C_nb @ self.f_b

    @property
    def w_in(self) -> Array:
        """w~_in, in ENU."""
        return earth_rate_n(self.latitude) + transport_rate_n(
            self.latitude, self.altitude, self.v_n
        )

    @property
    def radii(self) -> tuple[float, float]:
        """R_M + h and R_N + h."""
        meridian, transverse = radii_of_curvature(self.latitude)
        return meridian + self.altitude, transverse + self.altitude


def cross_matrix(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def turn(U: float) -> Array:
    """Rz(U) = [c s 0; -s c 0; 0 0 1]."""
    c, s = math.cos(U), math.sin(U)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def misalignment(U: float, phi_E: float, phi_N: float) -> Array:
    """C_n^n' = [c s -phi_N; -s c phi_E; phi_N c + phi_E s, phi_N s - phi_E c, 1]."""
    return (np.eye(3) - cross_matrix(np.array([phi_E, phi_N, 0.0]))) @ turn(U)


# The model with phi_l and U in its coefficients: (12) to (17).


def eq13_M1(U: float, phi_E: float, phi_N: float) -> Array:
    """M1: (phi_E, phi_N, U) by w~_in.

    (13): [1-c, -s, phi_N; s, 1-c, -phi_E; -phi_E s - phi_N, phi_E c, 0]; as printed. It is
    I - C_n^n' with -phi_N times its first row added to the third: w_nn' is the rate of a rotation,
    those of Euler angles (U about up, then phi_E, then phi_N) are asked for. In M1 w~ this is of
    first order, as phi_l moves with the Earth's rate when U is finite.
    """
    M1 = np.eye(3) - misalignment(U, phi_E, phi_N)
    M1[2] -= phi_N * (np.eye(3) - turn(U))[0]
    return M1


def eq14_M2(U: float, at: Computed) -> Array:
    """M2 = Rz(U) d(w_en)/d(v), rows E, N, U.

    (14): [s/(R_N+h), -c/(R_M+h), 0; c/(R_N+h), s/(R_M+h), 0; tan L/(R_N+h), 0, 0]
    Printed: one radius R_e for both.
    """
    return turn(U) @ transport_by_velocity(at)


def eq15_M3(U: float, at: Computed) -> Array:
    """M3 = Rz(U) d(w_ie + w_en)/d(position), rows E, N, U, columns dlambda, dL, dh.

    (15): [0, -Omega_U s, 0; 0, -Omega_U c, 0; 0, Omega_N + v_E sec^2 L/(R_N+h), 0]
    As printed, with the columns in the order of (17), not that of (11). dh, and the radii's change
    with dL, are left out: `left_out_by_position`.
    """
    return turn(U) @ (earth_by_position(at) + transport_by_position(at))


def eq12_attitude_rate(x: Array, at: Computed) -> Array:
    """Rates of phi_E, phi_N, U.

    (12): M1 w~_in + M2 dv + M3 dP - C_b^n' eps
    Printed: w_in for w~_in, which leaves out (I - Rz(U)) dw_in.
    """
    U, phi_E, phi_N = x[ATTITUDE]
    return (
        eq13_M1(U, phi_E, phi_N) @ at.w_in
        + eq14_M2(U, at) @ x[VELOCITY]
        + eq15_M3(U, at) @ x[POSITION]
        - at.C_nb @ x[GYRO_BIAS]
    )


def eq16_nabla(U: float, phi_E: float, phi_N: float) -> Array:
    """C_n'^n, which nabla^n' = C_b^n' nabla is multiplied by.

    (16): [c, -s, phi_N c + phi_E s; s, c, phi_N s - phi_E c; -phi_N, phi_E, 1]
    Printed: (1,3) phi_E s, (2,3) phi_E s, (3,1) and (3,2) 0, nabla^n.
    """
    return misalignment(U, phi_E, phi_N).T


def eq16_velocity_rate(x: Array, at: Computed) -> Array:
    """Rate of dv.

    (16): (I - C_n'^n) f~^n' + C_n'^n C_b^n' nabla - (2 w~_ie + w~_en) x dv
          - (2 dw_ie + dw_en) x v~
    Printed: + (2 dw_ie + dw_en) x v~. Left out: + dw x dv, and gravity's change with position.
    """
    turned_back = eq16_nabla(*x[ATTITUDE])
    dw_ie = earth_by_position(at) @ x[POSITION]
    dw_en = transport_by_velocity(at) @ x[VELOCITY] + transport_by_position(at) @ x[POSITION]
    return (
        (np.eye(3) - turned_back) @ at.f_n
        + turned_back @ at.C_nb @ x[ACCEL_BIAS]
        - np.cross(at.w_in + earth_rate_n(at.latitude), x[VELOCITY])
        - np.cross(2.0 * dw_ie + dw_en, at.v_n)
    )


def eq17_position_rate(x: Array, at: Computed) -> Array:
    """Rates of dlambda, dL, dh.

    (17): [sec L/(R_N+h), 0, 0; 0, 1/(R_M+h), 0; 0 0 1] dv
          + [0, v_E sec L tan L/(R_N+h), 0; 0; 0] dP
    As printed. Left out: dh and the radii's change with dL.
    """
    return eq34_M7(at) @ x[VELOCITY] + eq35_M8(at) @ x[POSITION]


# Rates of ENU by velocity and position.


def transport_by_velocity(at: Computed) -> Array:
    """d(w_en)/d(v) = [0, -1/(R_M+h), 0; 1/(R_N+h), 0, 0; tan L/(R_N+h), 0, 0]."""
    meridian, transverse = at.radii
    D = np.zeros((3, 3))
    D[0, 1] = -1.0 / meridian
    D[1, 0] = 1.0 / transverse
    D[2, 0] = math.tan(at.latitude) / transverse
    return D


def transport_by_position(at: Computed) -> Array:
    """d(w_en)/d(position), as the paper has it: v_E sec^2 L/(R_N+h) in (3,2)."""
    D = np.zeros((3, 3))
    D[2, 1] = at.v_n[0] / math.cos(at.latitude) ** 2 / at.radii[1]
    return D


def earth_by_position(at: Computed) -> Array:
    """d(w_ie)/d(position) = [0; 0, -Omega_U, 0; 0, Omega_N, 0]."""
    D = np.zeros((3, 3))
    D[1, 1] = -EARTH_RATE * math.sin(at.latitude)
    D[2, 1] = EARTH_RATE * math.cos(at.latitude)
    return D


def left_out_by_position(U: float, at: Computed) -> Array:
    """What (15), (16), (17) leave out of the columns dL and dh: (9, 3), to be added to F.

    With M = R_M + h, N = R_N + h, primes d/dL:
    dw_en = (v_N M'/M^2, -v_E N'/N^2, -v_E tan L N'/N^2) dL
            + (v_N/M^2, -v_E/N^2, -v_E tan L/N^2) dh
    dg = g' dL + (dg/dh) dh, downwards
    """
    latitude, altitude, (v_E, v_N, _) = at.latitude, at.altitude, at.v_n
    M, N = at.radii
    step = 1e-4
    (M2, N2), (M1, N1) = radii_of_curvature(latitude + step), radii_of_curvature(latitude - step)
    secant, tangent = 1.0 / math.cos(latitude), math.tan(latitude)
    g = normal_gravity
    dg_dL = (g(latitude + step, altitude) - g(latitude - step, altitude)) / (2.0 * step)
    dg_dh = (g(latitude, altitude + 1.0) - g(latitude, altitude - 1.0)) / 2.0
    by_latitude = (M2 - M1) / (2.0 * step), (N2 - N1) / (2.0 * step), dg_dL
    by_height = 1.0, 1.0, dg_dh
    out = np.zeros((9, 3))
    for column, (dM, dN, dg) in enumerate((by_latitude, by_height), start=1):
        dw = np.array([v_N * dM / M**2, -v_E * dN / N**2, -v_E * tangent * dN / N**2])
        out[ATTITUDE, column] = (turn(U) @ dw)[U_FIRST]
        out[VELOCITY, column] = np.cross(at.v_n, dw) - [0.0, 0.0, dg]
        out[POSITION, column] = [-v_E * secant * dN / N**2, -v_N * dM / M**2, 0.0]
    return out


# The same, linear but for U: (23), (24), (27) to (37). Rows and columns of attitude U, E, N.


def eq28_M1(U: float, at: Computed) -> Array:
    """M1': U, phi_E, phi_N by U, phi_E, phi_N, with (w_E, w_N, w_U) = w~_in.

    (28): [0, c w_N - s w_E, -w_E; 0, 0, w_U; 0, -w_U, 0]
          w_E = -v_N/(R_M+h), w_N = v_E/(R_N+h) + Omega_N, w_U = v_E tan L/(R_N+h) + Omega_U
    As printed; see eq13_M1 for (1,3).
    """
    c, s = math.cos(U), math.sin(U)
    w_E, w_N, w_U = at.w_in
    return np.array([[0.0, c * w_N - s * w_E, -w_E], [0.0, 0.0, w_U], [0.0, -w_U, 0.0]])


def eq29_M2(U: float, at: Computed) -> Array:
    """M2' = M2 in rows U, E, N.

    (29): as printed but for the radii: 1/(R_N+h) in the first column, 1/(R_M+h) in the second.
    """
    return eq14_M2(U, at)[U_FIRST]


def eq30_M3(U: float, at: Computed) -> Array:
    """M3' = M3 in rows U, E, N. (30): as printed."""
    return eq15_M3(U, at)[U_FIRST]


def eq31_M4(U: float, at: Computed) -> Array:
    """M4': dv by U, phi_E, phi_N, with f~^n'.

    (31): [0, -f_U s, -f_U c; 0, f_U c, -f_U s; 0, -f_N, f_E]; as printed.
    """
    c, s = math.cos(U), math.sin(U)
    f_E, f_N, f_U = at.f_n
    return np.array([[0.0, -f_U * s, -f_U * c], [0.0, f_U * c, -f_U * s], [0.0, -f_N, f_E]])


def eq32_M5(at: Computed) -> Array:
    """M5': dv by dv.

    (32): -(2 w~_ie + w~_en) x + (v~ x) [0, -1/(R_M+h), 0; 1/(R_N+h), 0, 0; tan L/(R_N+h), 0, 0]
    Printed: - (v x), and -1/(R_N+h) in (2,1).
    """
    coriolis = cross_matrix(at.w_in + earth_rate_n(at.latitude))
    return -coriolis + cross_matrix(at.v_n) @ transport_by_velocity(at)


def eq33_M6(at: Computed) -> Array:
    """M6': dv by dlambda, dL, dh.

    (33): (v~ x) [0, 0, 0; 0, -2 Omega_U, 0; 0, 2 Omega_N + v_E sec^2 L/(R_N+h), 0]
    Printed: - (v x), with + 2 Omega_U in (2,2); dh left out.
    """
    return cross_matrix(at.v_n) @ (2.0 * earth_by_position(at) + transport_by_position(at))


def eq34_M7(at: Computed) -> Array:
    """M7': position by dv. (34): diag(sec L/(R_N+h), 1/(R_M+h), 1); as printed."""
    meridian, transverse = at.radii
    return np.diag([1.0 / math.cos(at.latitude) / transverse, 1.0 / meridian, 1.0])


def eq35_M8(at: Computed) -> Array:
    """M8': position by position. (35): v_E sec L tan L/(R_N+h) in (1,2); as printed."""
    D = np.zeros((3, 3))
    D[0, 1] = at.v_n[0] * math.tan(at.latitude) / math.cos(at.latitude) / at.radii[1]
    return D


def eq36_g(U: float, at: Computed) -> Array:
    """g: U, phi_E, phi_N by U alone.

    (36): (0, (1-c) w_E - s w_N, s w_E + (1-c) w_N); as printed.
    """
    c, s = math.cos(U), math.sin(U)
    w_E, w_N, _ = at.w_in
    return np.array([0.0, (1.0 - c) * w_E - s * w_N, s * w_E + (1.0 - c) * w_N])


def eq37_gv(U: float, at: Computed) -> Array:
    """g_v: dv by U alone. (37): ((1-c) f_E + s f_N, (1-c) f_N - s f_E, 0); as printed."""
    c, s = math.cos(U), math.sin(U)
    f_E, f_N, _ = at.f_n
    return np.array([(1.0 - c) * f_E + s * f_N, (1.0 - c) * f_N - s * f_E, 0.0])


def eq27_F(U: float, at: Computed) -> Array:
    """F: rates of the first nine states by the first fifteen.

    (27): [M1' M2' M3' -C_b^n' 0; M4' M5' M6' 0 Rz(U)^T C_b^n'; 0 M7' M8' 0 0]
    Printed: eps and nabla share a column, in which both blocks are + C_b^n': of twelve columns.
    """
    F = np.zeros((9, 15))
    F[ATTITUDE, ATTITUDE] = eq28_M1(U, at)
    F[ATTITUDE, VELOCITY] = eq29_M2(U, at)
    F[ATTITUDE, POSITION] = eq30_M3(U, at)
    F[ATTITUDE, GYRO_BIAS] = -at.C_nb[U_FIRST]
    F[VELOCITY, ATTITUDE] = eq31_M4(U, at)
    F[VELOCITY, VELOCITY] = eq32_M5(at)
    F[VELOCITY, POSITION] = eq33_M6(at)
    F[VELOCITY, ACCEL_BIAS] = turn(U).T @ at.C_nb
    F[POSITION, VELOCITY] = eq34_M7(at)
    F[POSITION, POSITION] = eq35_M8(at)
    return F


def eq23_F(U: float, at: Computed, extended: bool = False) -> Array:
    """F of all states, continuous: d/dt x = F x + g; and d/dt d = dv when extended.

    (23): [F(U) 0_9x1; 0_7x16], x_k = (I + T F) x_k-1 + T g to first order.
    Printed: 0_9x7, and (21) has F itself for the transition.
    """
    F = np.zeros((EXTENDED, EXTENDED) if extended else (SIZE, SIZE))
    F[:9, :15] = eq27_F(U, at)
    if extended:
        F[PATH, VELOCITY] = np.eye(3)
    return F


def eq24_g(U: float, at: Computed, extended: bool = False) -> Array:
    """(24): (g, g_v, 0_10x1); as printed."""
    g = np.zeros(EXTENDED if extended else SIZE)
    g[ATTITUDE] = eq36_g(U, at)
    g[VELOCITY] = eq37_gv(U, at)
    return g


# The measurement: computed displacement minus the odometer's, z = sum v~ T - D, D = sum C_b^n' dS~.


def eq26_h_true(U: float, v_true: Array) -> Array:
    """(26): (I - Rz(U)) v = ((1-c) v_E - s v_N, s v_E + (1-c) v_N, 0) per second; as printed.

    v is the true velocity, which a filter does not have. With D/T for it 2 (1 - c) D is amiss, with
    v~ it is (I - Rz(U)) dv.
    """
    return v_true - turn(U) @ v_true


def eq38_H1_true(U: float, v_true: Array) -> Array:
    """H1': z per second by U, phi_E, phi_N.

    (38): [0, 0, v_U; 0, -v_U, 0; 0, -s v_E + c v_N, -c v_E - s v_N]; as printed, v true.
    """
    c, s = math.cos(U), math.sin(U)
    v_E, v_N, v_U = v_true
    return np.array([[0, 0, v_U], [0, -v_U, 0], [0, c * v_N - s * v_E, -c * v_E - s * v_N]])


def eq39_H2_true(U: float, v_true: Array) -> Array:
    """H2': z per second by dK.

    (39): -Rz(U) v
    Printed: positive; and with phi_N, phi_E in the third column (not in the third row), which are
    products with dK and make H depend on more than U.
    """
    return -(turn(U) @ v_true)


def eq25_H_true(U: float, v_true: Array) -> Array:
    """H of z per second, dv at the end of the second for its mean.

    (25): [H1' I 0_3x9 H2']; as printed. It depends on U: H_k(U), in (22), (44), (51) and (52) too.
    """
    H = np.zeros((3, SIZE))
    H[:, ATTITUDE] = eq38_H1_true(U, v_true)
    H[:, VELOCITY] = np.eye(3)
    H[:, SCALE] = eq39_H2_true(U, v_true)[:, None]
    return H


def odometer_h(U: float, D: Array) -> Array:
    """In place of (26), of the odometer's own D: (Rz(U)^T - I) D."""
    return turn(U).T @ D - D


def odometer_H(U: float, D: Array) -> Array:
    """In place of (25), of D, with d = integral of dv: [H1 0 0 0 0 -Rz(U)^T D, I].

    H1 = [0, s D_U, c D_U; 0, -c D_U, s D_U; 0, D_N, -D_E]: Rz(U)^T (phi_l x D)
    """
    H = np.zeros((3, EXTENDED))
    for column, axis in enumerate(np.eye(3)[:2], start=1):
        H[:, column] = turn(U).T @ np.cross(axis, D)
    H[:, SCALE] = -(turn(U).T @ D)[:, None]
    H[:, PATH] = np.eye(3)
    return H


def odometer_z(x: Array, D: Array) -> Array:
    """z = d + (C_n'^n/(1 + dK) - I) D: nothing left out where attitude errors are constant."""
    U, phi_E, phi_N = x[ATTITUDE]
    return x[PATH] + misalignment(U, phi_E, phi_N).T @ D / (1.0 + x[SCALE][0]) - D


# The filter's moments: (2), (40) to (57). `model` gives F (or H) and g (or h) for a value of U.


def eq2_rule(count: int) -> tuple[Array, Array]:
    """Nodes and weights for a standard normal variable."""
    off = np.sqrt(np.arange(1, count) / 2.0)
    values, vectors = np.linalg.eigh(np.diag(off, 1) + np.diag(off, -1))
    return math.sqrt(2.0) * values, vectors[0] ** 2


def eq40_57_moments(
    model: Callable[[float], tuple[Array, Array]], mean: Array, P: Array, rule: tuple[Array, Array]
) -> tuple[Array, Array, Array]:
    """Mean of y = F(U) x + g(U), its covariance, that of x with y. U is the first state.

    theta = mean + S (u, 0), y = F theta + g, gamma = y y' + F N F', Omega = theta theta' + N
    (40), (42): sum W y
    (41), (43): sum W gamma - y_mean y_mean'        (+ Q or R)
    (44): sum W (Omega F' + theta g') - mean y_mean'
    Printed: W missing; x_k-1 x_k-1' and x x' taken off in (41), (43); transposes missing in (44),
    (51).
    """
    S = np.linalg.cholesky(P)
    N = S[:, 1:] @ S[:, 1:].T
    size = len(model(mean[0])[1])
    first, second = np.zeros(size), np.zeros((size, size))
    cross = np.zeros((len(mean), size))
    for u, W in zip(*rule, strict=True):
        theta = mean + S[:, 0] * u
        F, g = model(theta[0])
        y = F @ theta + g
        first += W * y
        second += W * (np.outer(y, y) + F @ N @ F.T)
        cross += W * ((np.outer(theta, theta) + N) @ F.T + np.outer(theta, g))
    return first, second - np.outer(first, first), cross - np.outer(mean, first)
