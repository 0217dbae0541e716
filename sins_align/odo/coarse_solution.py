"""The attitude from the sums of the coarse alignment, whatever the heading.

z^T (sums) z with z = [r, x, 1], where r = (R_e, R_n, R_u) are the columns of the rotation R and
x the rest in units of its prior sigma, so that |x|^2 comes on top. With x at its best

    r^T N r + 2 n^T r = min,    R in SO(3)

is left. Davenport's problem is the case without N, and has a closed form; here N is what it is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sins_align.rotation import exp_rotation, skew
from sins_align.types import Array

# Columns of z.
ATTITUDE, REST = slice(0, 9), slice(9, 24)
GYRO_BIAS, ACCEL_BIAS, TRAVEL, LEVER = slice(9, 12), slice(12, 15), slice(15, 18), slice(18, 21)
LATENCY, SIDESLIP, SUSPENSION, DATA = 21, 22, 23, 24
SIZE, RESTS = 25, 15

# An unknown heading: standard deviation of a uniform angle.
NO_HEADING = math.pi / math.sqrt(3.0)
# Of the grid on which the heading is looked for; its first value is 0.
HEADINGS = np.arange(0.0, 360.0, 5.0) * (math.pi / 180.0)
ITERATIONS = 10
MOST_STEP, LEAST_STEP = 0.5, 1e-9  # [rad]
# Information about the heading where there is none, to keep the equations solvable [1/rad^2].
NO_INFORMATION = 1e-9


class Solution(NamedTuple):
    """What the sums say.

    R : (3, 3) columns east, north, up
    z : (SIZE,) all unknowns
    tangent : (DATA, 18) derivative of z by delta of (I + [delta x]) R and by x
    covariance : (18, 18) of these, of the error estimate minus truth
    heading_variance : second moment over all headings [rad^2], 0 where only one is likely
    """

    R: Array
    z: Array
    tangent: Array
    covariance: Array
    heading_variance: float


def solve_sums(sums: Array) -> Solution:
    """The most likely z; sums (SIZE, SIZE) of E^T S^-1 E."""
    rest = sums[REST, REST] + np.eye(RESTS)
    cross = np.column_stack((sums[REST, ATTITUDE], sums[REST, DATA]))
    best = np.linalg.solve(rest, cross)
    explained = cross.T @ best
    N = sums[ATTITUDE, ATTITUDE] - explained[:9, :9]
    n = sums[ATTITUDE, DATA] - explained[:9, 9]
    R = find_rotation(N, n)
    r = R.T.ravel()
    J = np.zeros((DATA, 3 + RESTS))
    J[ATTITUDE, :3] = tangent(R)
    J[REST, 3:] = np.eye(RESTS)
    information = J.T @ sums[:DATA, :DATA] @ J
    information[3:, 3:] += np.eye(RESTS)
    information[:3, :3] += np.outer(R[:, 2], R[:, 2]) / NO_HEADING**2
    return Solution(
        R=R,
        z=np.concatenate((r, -(best[:, :9] @ r + best[:, 9]), [1.0])),
        tangent=J,
        covariance=np.linalg.inv(information),
        heading_variance=heading_variance(R, N, n),
    )


def tangent(R: Array) -> Array:
    """Derivative of r by delta in (I + [delta x]) R; R (..., 3, 3), result (..., 9, 3)."""
    return -skew(np.swapaxes(R, -1, -2)).reshape(*R.shape[:-2], 9, 3)


def find_rotation(N: Array, n: Array) -> Array:
    """R with the least r^T N r + 2 n^T r: best of all headings, then Gauss-Newton."""
    costs, turned = scan_headings(_level(N, n), N, n)
    R = turned[int(np.argmin(costs))]
    for _ in range(ITERATIONS):
        J = tangent(R)
        H = J.T @ N @ J + NO_INFORMATION * np.outer(R[:, 2], R[:, 2])
        step = -np.linalg.solve(H, J.T @ (N @ R.T.ravel() + n))
        size = float(np.linalg.norm(step))
        R = exp_rotation(step * min(1.0, MOST_STEP / max(size, MOST_STEP))) @ R
        if size < LEAST_STEP:
            break
    return R


def _level(N: Array, n: Array) -> Array:
    """A rotation with up about right: by least squares, elements of variance 1/3 before."""
    up = -np.linalg.solve(N + 3.0 * np.eye(9), n)[6:]
    up /= np.linalg.norm(up)
    east = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    east /= np.linalg.norm(east)
    return np.column_stack((east, np.cross(up, east), up))


def scan_headings(R: Array, N: Array, n: Array) -> tuple[Array, Array]:
    """The form for R turned about up by HEADINGS, with the level at its best for each.

    Returns
    -------
    (K,) values, and the turned rotations themselves, (K, 3, 3)
    """
    c, s = np.cos(HEADINGS)[:, np.newaxis], np.sin(HEADINGS)[:, np.newaxis]
    turned = np.empty((HEADINGS.shape[0], 3, 3))
    turned[:, :, 0] = c * R[:, 0] + s * R[:, 1]
    turned[:, :, 1] = c * R[:, 1] - s * R[:, 0]
    turned[:, :, 2] = R[:, 2]
    r = turned.transpose(0, 2, 1).reshape(-1, 9)
    J = tangent(turned) @ R[:, :2]
    half_slope = r @ N + n
    gradient = np.einsum("ki,kij->kj", half_slope, J)
    step = np.linalg.solve(J.transpose(0, 2, 1) @ N @ J, gradient[..., np.newaxis])[..., 0]
    costs = np.einsum("ki,ki->k", r, half_slope + n) - np.einsum("ki,ki->k", gradient, step)
    return costs, turned


def heading_variance(R: Array, N: Array, n: Array) -> float:
    """Second moment of the heading about R, over all headings on the grid [rad^2].

    0 where the heading is known better than the grid is fine, and much where other headings
    are as likely: what the curvature at the best one does not tell.
    """
    costs, _ = scan_headings(R, N, n)
    likelihood = np.exp(-0.5 * (costs - costs.min()))
    angle = np.minimum(HEADINGS, 2.0 * math.pi - HEADINGS)
    return float(likelihood @ (angle * angle) / likelihood.sum())
