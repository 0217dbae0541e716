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
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(a[j], b[k], out=product[i])
        product[i] -= a[k] * b[j]
    return product


def cross3(a: Array, b: Array) -> Array:
    """a x b of two vectors (3,): for these, plain numbers are quicker than any array."""
    ax, ay, az = a.tolist()
    bx, by, bz = b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def skew3(v: Array) -> Array:
    """`skew` of one vector (3,), quicker."""
    x, y, z = v.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def unskew3(M: Array) -> Array:
    """`unskew` of one matrix (3, 3), quicker."""
    (_, xy, xz), (yx, _, yz), (zx, zy, _) = M.tolist()
    return np.array([0.5 * (zy - yz), 0.5 * (xz - zx), 0.5 * (yx - xy)])


def exp_rotation(phi: Array) -> Array:
    """C = Exp([phi x]), Rodrigues; phi (3,) [rad], result (3, 3)."""
    x, y, z = phi.tolist()
    square = x * x + y * y + z * z
    if square < 1e-8:
        # sin(a)/a and (1 - cos(a))/a^2 by their series: the next terms are below 1e-18.
        s, c = 1.0 - square / 6.0, 0.5 - square / 24.0
    else:
        angle = math.sqrt(square)
        s, c = math.sin(angle) / angle, (1.0 - math.cos(angle)) / square
    return np.array(
        [
            [1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y],
            [c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x],
            [c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)],
        ]
    )


def rotations_about(rate: Array, time_s: Array) -> Array:
    """Rotations about one axis within several times: (N, 3, 3).

    I + sin a [k x] + (1 - cos a) [k x]^2 with a = |rate| t, k = rate / |rate| (Rodrigues)

    Parameters
    ----------
    rate : (3,) [rad/s], not zero; time_s : (N,)
    """
    size = float(np.linalg.norm(rate))
    K = skew(rate / size)
    angle = (size * time_s)[:, None, None]
    turned: Array = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)
    return turned


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
    x = 0.25 * (phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2])
    q = np.empty((4, *phi.shape[1:]))
    if x.max(initial=0.0) < 1e-3:
        # Both series to x^3: the next term is below 1e-16, and no division by zero.
        q[0] = 1.0 - x * (1.0 / 2.0 - x * (1.0 / 24.0 - x * (1.0 / 720.0)))
        q[1:] = phi * (0.5 - x * (1.0 / 12.0 - x * (1.0 / 240.0 - x * (1.0 / 10080.0))))
        return q
    half = np.sqrt(x)
    q[0] = np.cos(half)
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


def dcm_from_quaternion(q: Array, out: Array | None = None) -> Array:
    """Direction cosine matrix of unit quaternions; q (4, ...), result (3, 3, ...)."""
    C = np.empty((3, 3, *q.shape[1:])) if out is None else out
    w, x, y, z = math.sqrt(2.0) * q
    xx, yy, zz = x * x, y * y, z * z
    for i, squares in enumerate((yy + zz, xx + zz, xx + yy)):
        np.subtract(1.0, squares, out=C[i, i, ...])
    for i, j, product, turn in ((0, 1, x * y, w * z), (2, 0, x * z, w * y), (1, 2, y * z, w * x)):
        np.subtract(product, turn, out=C[i, j, ...])
        np.add(product, turn, out=C[j, i, ...])
    return C


def quaternion_from_dcm(C: Array) -> Array:
    """Unit quaternion with w >= 0 of a direction cosine matrix: (4,).

    Shepperd's method: divides by the largest of the four.
    """
    c: list[list[float]] = C.tolist()
    trace = c[0][0] + c[1][1] + c[2][2]
    i = max(range(3), key=lambda axis: c[axis][axis])
    q = [0.0, 0.0, 0.0, 0.0]
    if trace >= c[i][i]:
        q[0] = 1.0 + trace
        q[1:] = c[2][1] - c[1][2], c[0][2] - c[2][0], c[1][0] - c[0][1]
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        q[0] = c[k][j] - c[j][k]
        q[1 + i] = 1.0 + c[i][i] - c[j][j] - c[k][k]
        q[1 + j] = c[i][j] + c[j][i]
        q[1 + k] = c[i][k] + c[k][i]
    norm = math.copysign(math.hypot(*q), q[0])
    return np.array(q) / norm


def _band_of_increment() -> Array:
    """(4, 16) linear map of an increment (w, x, y, z) to its two columns of the band matrix.

    With (c, d) = (w + i x, y + i z) and unknowns (a_0, b_0, a_1, b_1, ...), step k + 1 is

        a_{k+1} - c a_k + d* b_k = 0        (band offsets 2 and 1)
        b_{k+1} - d a_k - c* b_k = 0        (band offsets 3 and 2)

    Axes of the map before it is flattened: component, column (a_k, b_k), offset, real and
    imaginary part. The diagonal, offset 0, is 1 and not stored.
    """
    w, x, y, z = range(4)
    a, b, re, im = 0, 1, 0, 1
    band = np.zeros((4, 2, 4, 2))
    band[w, a, 2, re] = band[x, a, 2, im] = -1.0
    band[y, a, 3, re] = band[z, a, 3, im] = -1.0
    band[y, b, 1, re], band[z, b, 1, im] = 1.0, -1.0
    band[w, b, 2, re], band[x, b, 2, im] = -1.0, 1.0
    return band.reshape(4, 16)


_BAND_OF_INCREMENT = _band_of_increment()


def cumulative_rotation(increments: Array) -> Array:
    """q_0 = 1, q_k = q_{k-1} d_k for unit quaternions d: (4, N) -> (4, N + 1).

    In SU(2) a quaternion is the pair (a, b) = (w + i x, y + i z), and
    (a, b)(c, d) = (a c - b d*, a d + b c*): linear in (a, b). All N products are therefore
    one unit lower triangular banded system for the interleaved pairs, solved by one BLAS
    call instead of a loop.
    """
    n = increments.shape[1]
    band = np.empty((n + 1, 16))
    np.matmul(increments.T, _BAND_OF_INCREMENT, out=band[:n])
    band[n] = 0.0
    matrix = band.view(complex).reshape(2 * (n + 1), 4).T
    unknowns = np.zeros(2 * (n + 1), dtype=complex)
    unknowns[0] = 1.0
    unknowns = ztbsv(3, matrix, unknowns, lower=1, diag=1, overwrite_x=1)
    return np.ascontiguousarray(unknowns.view(float).reshape(n + 1, 4).T)


def level_axes(up: Array) -> Array:
    """Columns of a level frame with the given up (3,) and horizontal axes of no meaning: (3, 3)."""
    east = np.cross(np.eye(3)[int(np.argmin(np.abs(up)))], up)
    east /= np.linalg.norm(east)
    return np.column_stack((east, cross3(up, east), up))


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
