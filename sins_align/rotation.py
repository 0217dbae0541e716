"""Rotations: direction cosine matrices, quaternions (w, x, y, z), rotation vectors.

`C_ab` maps b to a. A rotation vector phi stands for C = Exp(phi) = I + [phi x] + ...
Functions over samples take and return arrays with the sample as the last axis.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg.blas import ztbsv

from sins_align.types import Array


def skew(v: Array) -> Array:
    """[v x], so that skew(a) @ b = a x b; v (..., 3), result (..., 3, 3)."""
    v = np.asarray(v, dtype=float)
    matrix = np.zeros((*v.shape[:-1], 3, 3))
    matrix[..., 0, 1] = -v[..., 2]
    matrix[..., 0, 2] = v[..., 1]
    matrix[..., 1, 0] = v[..., 2]
    matrix[..., 1, 2] = -v[..., 0]
    matrix[..., 2, 0] = -v[..., 1]
    matrix[..., 2, 1] = v[..., 0]
    return matrix


def unskew(M: Array) -> Array:
    """v of the antisymmetric part [v x] of M; M (..., 3, 3), result (..., 3).

    Of a rotation by a small angle it is the rotation vector, to third order.
    """
    return 0.5 * np.stack(
        (
            M[..., 2, 1] - M[..., 1, 2],
            M[..., 0, 2] - M[..., 2, 0],
            M[..., 1, 0] - M[..., 0, 1],
        ),
        axis=-1,
    )


def cross(a: Array, b: Array) -> Array:
    """a x b column by column, (3, N) each; quicker than numpy.cross."""
    return np.stack(
        (
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        )
    )


def exp_rotation(phi: Array) -> Array:
    """C = Exp([phi x]), Rodrigues; phi (3,) [rad], result (3, 3)."""
    return dcm_from_quaternion(quaternion_from_rotation_vector(np.asarray(phi, dtype=float)))


def log_rotation(C: Array) -> Array:
    """Rotation vector of a direction cosine matrix, |phi| <= pi: (3,) [rad]."""
    q = quaternion_from_dcm(C)
    vector = q[1:]
    norm = float(np.linalg.norm(vector))
    if norm < 1e-12:
        return 2.0 * vector
    return vector * (2.0 * math.atan2(norm, q[0]) / norm)


def quaternion_from_rotation_vector(phi: Array) -> Array:
    """q = (cos |phi|/2, phi/|phi| sin |phi|/2); phi (3, ...) [rad], result (4, ...)."""
    half_squared = 0.25 * (phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2])
    half = np.sqrt(half_squared)
    q = np.empty((4, *phi.shape[1:]))
    q[0] = np.cos(half)
    # 1/2 sin(x)/x, by its series where x is too small to divide by.
    q[1:] = phi * (0.5 * np.sinc(half / np.pi))
    return q


def multiply_quaternions(p: Array, q: Array) -> Array:
    """Hamilton product p q: first q, then p; (4, ...) each."""
    pw, px, py, pz = p
    qw, qx, qy, qz = q
    return np.stack(
        (
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        )
    )


def dcm_from_quaternion(q: Array) -> Array:
    """Direction cosine matrix of unit quaternions; q (4, ...), result (3, 3, ...)."""
    w, x, y, z = q
    C = np.empty((3, 3, *q.shape[1:]))
    xx, yy, zz = x * x, y * y, z * z
    xy, xz, yz = x * y, x * z, y * z
    wx, wy, wz = w * x, w * y, w * z
    C[0, 0] = 1.0 - 2.0 * (yy + zz)
    C[0, 1] = 2.0 * (xy - wz)
    C[0, 2] = 2.0 * (xz + wy)
    C[1, 0] = 2.0 * (xy + wz)
    C[1, 1] = 1.0 - 2.0 * (xx + zz)
    C[1, 2] = 2.0 * (yz - wx)
    C[2, 0] = 2.0 * (xz - wy)
    C[2, 1] = 2.0 * (yz + wx)
    C[2, 2] = 1.0 - 2.0 * (xx + yy)
    return C


def quaternion_from_dcm(C: Array) -> Array:
    """Unit quaternion with w >= 0 of a direction cosine matrix: (4,).

    Shepperd's method: divides by the largest of the four.
    """
    trace = C[0, 0] + C[1, 1] + C[2, 2]
    squares = np.array([trace, C[0, 0], C[1, 1], C[2, 2]])
    largest = int(np.argmax(squares))
    q = np.empty(4)
    if largest == 0:
        q[0] = 1.0 + trace
        q[1:] = C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]
    else:
        i = largest - 1
        j, k = (i + 1) % 3, (i + 2) % 3
        q[0] = C[k, j] - C[j, k]
        q[1 + i] = 1.0 + C[i, i] - C[j, j] - C[k, k]
        q[1 + j] = C[i, j] + C[j, i]
        q[1 + k] = C[i, k] + C[k, i]
    q /= np.linalg.norm(q)
    return q if q[0] >= 0.0 else -q


def cumulative_rotation(increments: Array) -> Array:
    """q_0 = 1, q_k = q_{k-1} d_k for unit quaternions d: (4, N) -> (4, N + 1).

    In SU(2) a quaternion is the pair (a, b) = (w + i x, y + i z), and
    (a, b)(c, d) = (a c - b d*, a d + b c*): linear in (a, b). All N products are therefore
    one unit lower triangular banded system for the interleaved pairs, solved by one BLAS
    call instead of a loop.
    """
    n = increments.shape[1]
    c = increments[0] + 1j * increments[1]
    d = increments[2] + 1j * increments[3]
    # Unknowns (a_0, b_0, a_1, b_1, ...); the rows of step k + 1:
    #   a_{k+1} - c a_k + d* b_k = 0        (band offsets 2 and 1)
    #   b_{k+1} - d a_k - c* b_k = 0        (band offsets 3 and 2)
    band = np.zeros((4, 2 * (n + 1)), dtype=complex, order="F")
    band[0] = 1.0
    band[2, 0 : 2 * n : 2] = -c
    band[3, 0 : 2 * n : 2] = -d
    band[1, 1 : 2 * n : 2] = d.conj()
    band[2, 1 : 2 * n : 2] = -c.conj()
    x = np.zeros(2 * (n + 1), dtype=complex)
    x[0] = 1.0
    x = ztbsv(3, band, x, lower=1, diag=1, overwrite_x=1)
    a, b = x[0::2], x[1::2]
    q = np.empty((4, n + 1))
    q[0], q[1], q[2], q[3] = a.real, a.imag, b.real, b.imag
    return q


def dcm_from_rpy(roll: float, pitch: float, yaw: float) -> Array:
    """C_nb = Rz(yaw) Ry(pitch) Rx(roll), REP-103 [rad]: (3, 3)."""
    cr, sr = math.cos(roll), math.sin(roll)
    cp, sp = math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rpy_from_dcm(C_nb: Array) -> tuple[float, float, float]:
    """Roll, pitch, yaw (REP-103) [rad]; at pitch +-90 deg, roll is 0 by definition."""
    sp = -float(C_nb[2, 0])
    if abs(sp) > 1.0 - 1e-12:
        yaw = math.atan2(-float(C_nb[0, 1]), float(C_nb[1, 1]))
        return 0.0, math.copysign(0.5 * math.pi, sp), yaw
    roll = math.atan2(float(C_nb[2, 1]), float(C_nb[2, 2]))
    return roll, math.asin(sp), math.atan2(float(C_nb[1, 0]), float(C_nb[0, 0]))


def heading_from_yaw(yaw: float) -> float:
    """Heading, clockwise from north, in [0, 2 pi), of a yaw, counter-clockwise from east."""
    heading = math.fmod(0.5 * math.pi - yaw, 2.0 * math.pi)
    if heading < 0.0:
        heading += 2.0 * math.pi
    return heading if heading < 2.0 * math.pi else 0.0
