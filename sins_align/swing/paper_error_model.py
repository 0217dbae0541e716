"""Error model of attitude and velocity at the swing centre: Mu and Fang, eqs. (1) and (2).

The error of the quaternion is additive, dQ = Q_estimated - Q, that of the velocity is dV
(east, north). With Q the attitude of b in n, C_nb = C(Q),

dQ' = A_QQ dQ + A_QV dV + T w_noise,      dV' = A_VQ dQ + A_VV dV + C_2x3 f_noise,

where the paper leaves the blocks to its reference [8]; they are derived here from

Q' = 1/2 (Q w_ib_b - w_in_n Q),      V' = C(Q) f_b - (2 w_ie_n + w_en_n(V)) x V + g.

Arrays over N times have the time first, so that matrices stack.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sins_align.earth import earth_rate_n, radii_of_curvature
from sins_align.rotation import skew
from sins_align.types import Array, Position


def left_matrix(p: Array) -> Array:
    """M_L with M_L(p) q = p q; p (..., 4), result (..., 4, 4)."""
    return _product_matrix(p, 1.0)


def right_matrix(p: Array) -> Array:
    """M_R with M_R(p) q = q p; p (..., 4), result (..., 4, 4)."""
    return _product_matrix(p, -1.0)


def _product_matrix(p: Array, sign: float) -> Array:
    matrix = np.empty((*p.shape[:-1], 4, 4))
    matrix[..., 0, 0] = p[..., 0]
    matrix[..., 0, 1:] = -p[..., 1:]
    matrix[..., 1:, 0] = p[..., 1:]
    matrix[..., 1:, 1:] = sign * skew(p[..., 1:]) + p[..., :1, np.newaxis] * np.eye(3)
    return matrix


def pure(v: Array) -> Array:
    """The quaternion (0, v); v (..., 3), result (..., 4)."""
    return np.concatenate((np.zeros((*v.shape[:-1], 1)), v), axis=-1)


class Earth(NamedTuple):
    """What the error model knows of the place.

    w_ie_n : (3,) [rad/s]
    transport : (3, 2) w_en_n = transport @ V, V east and north [1/m]
    """

    w_ie_n: Array
    transport: Array

    @classmethod
    def at(cls, position: Position) -> Earth:
        """At a place; within 0.01 deg of a pole, where ENU turns without limit, beside it."""
        latitude = max(-1.57, min(1.57, position.latitude))
        meridian, transverse = (r + position.altitude for r in radii_of_curvature(latitude))
        east = [0.0, 1.0 / transverse, math.tan(latitude) / transverse]
        north = [-1.0 / meridian, 0.0, 0.0]
        return cls(earth_rate_n(latitude), np.array([east, north]).T)

    def rate_n(self, V: Array) -> Array:
        """w_in_n (3,) [rad/s] at the velocity V (2,) east and north [m/s]."""
        return self.w_ie_n + self.transport @ V

    def coriolis(self, V: Array) -> Array:
        """East and north of -(2 w_ie_n + w_en_n) x V: (2,) [m/s^2]."""
        up = 2.0 * self.w_ie_n[2] + self.transport[2] @ V
        return up * np.array([V[1], -V[0]])


def A_QQ(w_ib_b: Array, w_in_n: Array) -> Array:
    """1/2 [M_R(w_ib_b) - M_L(w_in_n)]: (N, 3), (3,) -> (N, 4, 4) [1/s]."""
    return 0.5 * (right_matrix(pure(w_ib_b)) - left_matrix(pure(w_in_n)))


def A_QV(Q: Array, earth: Earth) -> Array:
    """Columns -1/2 dw_en_n/dV_j Q: (N, 4) -> (N, 4, 2) [1/m]."""
    return -0.5 * right_matrix(Q)[..., 1:] @ earth.transport


def A_VQ(Q: Array, f_b: Array) -> Array:
    """East and north of d(C(Q) f)/dQ, f at the swing centre: (N, 4), (N, 3) -> (N, 2, 4).

    2 (q0 f + q x f)  |  2 (q . f I + q f^T - f q^T - q0 [f x])
    """
    q0, q = Q[..., :1], Q[..., 1:]
    block = np.empty((*Q.shape[:-1], 3, 4))
    block[..., 0] = q0 * f_b + np.cross(q, f_b)
    outer = q[..., :, np.newaxis] * f_b[..., np.newaxis, :]
    block[..., 1:] = outer - np.swapaxes(outer, -1, -2) - q0[..., np.newaxis] * skew(f_b)
    block[..., 1:] += np.sum(q * f_b, axis=-1)[..., np.newaxis, np.newaxis] * np.eye(3)
    return 2.0 * block[..., :2, :]


def A_VV(V: Array, earth: Earth) -> Array:
    """Derivative of `Earth.coriolis`: (2,) -> (2, 2) [1/s]."""
    up = 2.0 * earth.w_ie_n[2] + earth.transport[2] @ V
    turned = np.array([V[1], -V[0]])
    return up * np.array([[0.0, 1.0], [-1.0, 0.0]]) + np.outer(turned, earth.transport[2])


def A(Q: Array, V: Array, w_ib_b: Array, f_b: Array, earth: Earth) -> Array:
    """The whole matrix of eq. (2): Q (N, 4), V (2,), w_ib_b and f_b (N, 3) -> (N, 6, 6)."""
    matrix = np.empty((Q.shape[0], 6, 6))
    matrix[:, :4, :4] = A_QQ(w_ib_b, earth.rate_n(V))
    matrix[:, :4, 4:] = A_QV(Q, earth)
    matrix[:, 4:, :4] = A_VQ(Q, f_b)
    matrix[:, 4:, 4:] = A_VV(V, earth)
    return matrix


def T(Q: Array) -> Array:
    """1/2 Q e_i: how gyro noise enters dQ'; (4,) -> (4, 3)."""
    return 0.5 * left_matrix(Q)[:, 1:]


def G(Q: Array, C_nb: Array) -> Array:
    """Noise input for (gyro, accelerometer) noise: (4,), (3, 3) -> (6, 6)."""
    matrix = np.zeros((6, 6))
    matrix[:4, :3] = T(Q)
    matrix[4:, 3:] = C_nb[:2]
    return matrix


def tilt_to_quaternion(Q: Array) -> Array:
    """1/2 Xi: dQ = 1/2 Xi psi for a small rotation psi in n, Q_estimated = exp(psi/2) Q.

    (4,) -> (4, 3). Its columns have length 1/2 and are at right angles to Q and each other:
    psi = 2 Xi^T dQ, and a covariance 1/4 Xi S Xi^T has rank 3, as a unit quaternion demands.
    """
    return 0.5 * right_matrix(Q)[:, 1:]
