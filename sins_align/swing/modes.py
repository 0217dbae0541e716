"""Whether another heading, far from the solution's, fits the data as well or better.

In its first seconds the data tell the horizontal Earth rate, of known length, and one part of it
better than the other: the swing hides the rest behind start velocity and lever arm. Heading is
then that on a circle which a narrow ellipse meets, and it meets it twice. The sum of squares has
two minima, Gauss-Newton ends in the one that is near, and the covariance there knows nothing of
the other. The sums do (`squares_at`): they are looked at while heading is coarse.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sins_align.rotation import exp_rotation
from sins_align.swing.information import invert_information
from sins_align.swing.outcome import heading_variance
from sins_align.swing.solution import KAPPA, X_V0, Prior, Solution, Solver
from sins_align.swing.two_stage import R_EAST, R_NORTH
from sins_align.types import Array

# Another heading is one as far off as this; what is nearer is for Gauss-Newton.
TURNS = np.radians(np.arange(45.0, 316.0, 15.0))
# It is gone to where it leaves fewer squares by so many,
FEWER = 1.0
# and excluded where from 90 deg on it leaves more by so many: 4 sigma, one in 16 000. Where both
# parts are known alike to 20 deg, it is 16.4: those wait for nothing.
OPPOSITE = np.radians(np.arange(90.0, 271.0, 15.0))
EXCLUDED = 16.0
# With a heading as good as this there is no other one.
SETTLED = math.radians(2.0)


def least_mode(solver: Solver, normal: Array, solution: Solution) -> Solution:
    """`solution`, or the one that Gauss-Newton finds from a heading that fits better."""
    squares = squares_at(solver.prior, normal, solution, TURNS)
    least = int(squares.argmin())
    if squares[least] > -FEWER:
        return solution
    turned = exp_rotation(TURNS[least] * solution.R[:, 2]) @ solution.R
    return solver.solve(normal, replace(solution, R=turned))


def is_settled(solution: Solution) -> bool:
    """Whether heading is known too well for another one."""
    return heading_variance(solution) < SETTLED**2


def is_alone(solver: Solver, normal: Array, solution: Solution) -> bool:
    """Whether the data exclude the headings far from that of the solution."""
    if is_settled(solution):
        return True
    return bool(squares_at(solver.prior, normal, solution, OPPOSITE).min() > EXCLUDED)


def squares_at(prior: Prior, normal: Array, at: Solution, turns: Array) -> Array:
    """Least sum of squares with heading turned by `turns` (k,) from `at`, less that of `at`.

    R_e and R_n turn about R_u, so that theta is linear in u = (1, cos - 1, sin) of a turn.
    With all else solved for, by a Newton step, u^T H u is left: two harmonics of the turn, the
    second where the data know one horizontal part of the Earth rate better than the other.
    All of x is estimated here, with its prior, none of it considered.

    Parameters
    ----------
    normal : (p + 1, p + 1) sums of the filter; turns : (k,) about up, in b0 [rad]
    """
    theta, variance = at.theta, prior.variance
    T = np.zeros((theta.shape[0] + 1, 3))
    T[:, 0] = np.append(theta, 1.0)
    T[R_EAST, 1], T[R_NORTH, 1] = theta[R_EAST], theta[R_NORTH]
    T[R_EAST, 2], T[R_NORTH, 2] = theta[R_NORTH], -theta[R_EAST]
    weight = np.zeros(variance.shape[0])
    weight[variance > 0.0] = 1.0 / variance[variance > 0.0]
    free = variance > 0.0
    free[X_V0] = True
    # Of kappa, the tilts alone.
    J = np.hstack((at.jacobian[:, KAPPA] @ at.R[:, :2], at.jacobian[:, free]))
    N = J.T @ normal[:-1, :-1] @ J + np.diag(np.append([0.0, 0.0], weight[free]))
    G = J.T @ normal[:-1] @ T
    G[2:, 0] += (weight * (at.x - prior.mean))[free]
    H = T.T @ normal @ T - G.T @ invert_information(N) @ G
    u = np.stack((np.ones_like(turns), np.cos(turns) - 1.0, np.sin(turns)))
    squares: Array = np.einsum("ik,ij,jk->k", u, H, u) - H[0, 0]
    return squares
