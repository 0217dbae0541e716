"""Attitude, lever arm and biases from the sums of the two-stage filter.

The weighted sum of squares is a quadratic in theta, whose attitude part (R_e, R_n, R_u) is a
rotation matrix times 1 + delta_g, the unknown share by which gravity's magnitude differs from
the model's. It is minimised over

    x = [kappa, v0, r, b_g, b_a, delta_g, M_g, M_a]        R = Exp(kappa) R^

by Gauss-Newton; the sums are exact, so that no step needs the data again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sins_align.grades import ImuGrade
from sins_align.rotation import exp_rotation, skew
from sins_align.swing.excitation import LeverDirections
from sins_align.swing.information import invert_information
from sins_align.swing.two_stage import ACCEL_BIAS, ATTITUDE, BASE, DATA, GYRO_BIAS, LEVER, V0
from sins_align.swing.two_stage_filter import TwoStageFilter
from sins_align.types import Array

# Elements of x.
KAPPA, X_V0, X_R, X_BG, X_BA, X_G = (
    slice(0, 3),
    slice(3, 6),
    slice(6, 9),
    slice(9, 12),
    slice(12, 15),
    15,
)
MATRICES = slice(16, 34)
_LINEAR = np.arange(3, 15)
# A direction of the accelerometer bias is estimated where the data alone know it better
# than the prior by this ratio of variances; elsewhere it is considered.
ESTIMATE_RATIO = 2.0
# Gauss-Newton has converged when what the step leaves, its square, is so much of sigma.
CONVERGED = 0.01
# As near as this the linearisation of the filter is that of the solution [rad].
NEAR = 0.3


@dataclass(frozen=True)
class Prior:
    """What is known of x before the data.

    mean, variance : (16,) or (34,) in the order of x; variance 0 stands for no prior at
        kappa and v0, and for an exact one elsewhere
    """

    mean: Array
    variance: Array


def make_prior(
    lever_arm: Array,
    lever_sigma: float,
    grade: ImuGrade,
    gravity_sigma: float,
    calibration: bool,
) -> Prior:
    """Prior of x: all means but the lever arm's are zero.

    Parameters
    ----------
    lever_arm, lever_sigma : (3,) and per axis [m]
    gravity_sigma : of delta_g [1]
    calibration : whether M_g and M_a are in x
    """
    size = MATRICES.stop if calibration else MATRICES.start
    mean, sigma = np.zeros(size), np.zeros(size)
    mean[X_R], sigma[X_R] = lever_arm, lever_sigma
    sigma[X_BG], sigma[X_BA], sigma[X_G] = grade.gyro_bias, grade.accel_bias, gravity_sigma
    if calibration:
        for first, scale in ((16, grade.gyro_scale), (25, grade.accel_scale)):
            matrix = np.full((3, 3), grade.misalignment)
            np.fill_diagonal(matrix, scale)
            sigma[first : first + 9] = matrix.reshape(9)
    return Prior(mean, sigma**2)


@dataclass(frozen=True)
class Solution:
    """Minimum of the sum of squares.

    R : (3, 3) columns east, north, up at t = 0 in b0
    x : (m,) with kappa = 0: R holds the attitude
    covariance : (m, m) of x, considered parameters included
    """

    R: Array
    x: Array
    covariance: Array

    @cached_property
    def theta(self) -> Array:
        """(p,) as the filter's columns take it."""
        theta = np.empty(self.x.shape[0] + 5)
        theta[ATTITUDE] = (1.0 + self.x[X_G]) * self.R.T.reshape(9)
        theta[V0], theta[LEVER] = self.x[X_V0], self.x[X_R]
        theta[GYRO_BIAS], theta[ACCEL_BIAS] = self.x[X_BG], self.x[X_BA]
        theta[BASE:] = self.x[MATRICES]
        return theta

    @cached_property
    def jacobian(self) -> Array:
        """d theta / d x: (p, m)."""
        size = self.x.shape[0]
        J = np.zeros((size + 5, size))
        scale = 1.0 + self.x[X_G]
        axes = self.R.T
        J[ATTITUDE, KAPPA] = -scale * skew(axes).reshape(9, 3)
        J[ATTITUDE, X_G] = axes.reshape(9)
        J[_LINEAR + 6, _LINEAR] = 1.0
        J[range(BASE, size + 5), range(MATRICES.start, size)] = 1.0
        return J


class Solver:
    """Minimises the sum of squares for one prior.

    Parameters
    ----------
    prior : its zero sigmas fix the parameter
    lever : directions of the lever arm to estimate and to consider; the others stay at the
        prior
    about : (3, 3) attitude R about which the filter is linearised, None before it is
    """

    def __init__(self, prior: Prior, lever: LeverDirections, about: Array | None = None) -> None:
        self.prior = prior
        self._lever = lever
        self._about = about

    def solve(self, normal: Array, start: Solution, iterations: int = 10) -> Solution:
        """Gauss-Newton from `start`, until the attitude stays, or `iterations`."""
        N, gradient = self._reduced(normal, start)
        basis, considered = self._parameters(N)
        current = self._at_prior_outside(start, considered)
        if not np.array_equal(current.x, start.x):
            N, gradient = self._reduced(normal, current)
        for _ in range(iterations):
            covariance = basis @ invert_information(basis.T @ N @ basis) @ basis.T
            step = covariance @ -gradient
            x = current.x + step
            x[KAPPA] = 0.0
            current = Solution(exp_rotation(step[KAPPA]) @ current.R, x, covariance)
            sigma = np.sqrt(covariance.diagonal()[KAPPA])
            if np.abs(step[KAPPA]).max() ** 2 < CONVERGED * sigma.min():
                break
            N, gradient = self._reduced(normal, current)
        # A considered error c moves the estimate by Sigma N c.
        error = considered - covariance @ (N @ considered)
        return Solution(current.R, current.x, covariance + error @ error.T)

    def covariance(self, normal: Array, at: Solution) -> Array:
        """(m, m) of x, had `normal` been solved at `at`: the data themselves do not count."""
        N, _ = self._reduced(normal, at)
        basis, considered = self._parameters(N)
        covariance = basis @ invert_information(basis.T @ N @ basis) @ basis.T
        error = considered - covariance @ (N @ considered)
        return covariance + error @ error.T

    def score(self, normal: Array, at: Solution, column: Array) -> tuple[float, float, Array]:
        """Estimate of one more parameter y, of which the solution took 0 for granted.

        Parameters
        ----------
        column : (p,) d theta / d y

        Returns
        -------
        y, its 1 sigma, and (m,) what x would change by per y

        Raises
        ------
        numpy.linalg.LinAlgError : the data say nothing of y
        """
        J, A = self._jacobian(at), normal[:-1, :-1]
        N, gradient = self._reduced(normal, at)
        basis, considered = self._parameters(N)
        covariance = basis @ invert_information(basis.T @ N @ basis) @ basis.T
        cross = J.T @ (A @ column)
        response = -covariance @ cross
        slope = float(column @ (A @ at.theta + normal[:-1, DATA])) + float(response @ gradient)
        information = float(column @ A @ column) + float(response @ cross)
        if not 0.0 < information < math.inf:
            raise np.linalg.LinAlgError("the data do not determine one more parameter")
        # A considered error c moves the slope by this per c.
        moved = (cross + response @ N) @ considered / information
        sigma = math.sqrt(1.0 / information + float(moved @ moved))
        return -slope / information, sigma, response

    def log_likelihood(
        self, filter_: TwoStageFilter, at: Solution, column: Array | None = None
    ) -> float:
        """Of a filter's noise model, whatever x is (restricted likelihood), but for a constant.

        -(sum log det S + log det N + least sum of squares) / 2, the least one by a Newton step
        from `at`. All of x is estimated here, none of it considered; and so is a parameter y with
        `column` (p,) d theta / d y, about 0.
        """
        N, gradient = self._reduced(filter_.normal, at)
        variance, theta = self.prior.variance, np.append(at.theta, 1.0)
        known = variance > 0.0
        free = known.copy()
        free[:6] = True
        N, gradient = N[np.ix_(free, free)], gradient[free]
        if column is not None:
            response = filter_.normal[:-1, :-1] @ column
            cross = (self._jacobian(at).T @ response)[free]
            N = np.block([[N, cross[:, None]], [cross, column @ response]])
            gradient = np.append(gradient, column @ (filter_.normal[:-1] @ theta))
        off = (at.x - self.prior.mean)[known]
        squares = float(theta @ filter_.normal @ theta) + float(off @ (off / variance[known]))
        squares -= float(gradient @ invert_information(N) @ gradient)
        return -0.5 * (filter_.log_det + float(np.linalg.slogdet(N)[1]) + squares)

    def _reduced(self, normal: Array, at: Solution) -> tuple[Array, Array]:
        """Information (m, m) and gradient (m,) of data and prior."""
        J = self._jacobian(at)
        A = normal[:-1, :-1]
        N = J.T @ A @ J
        gradient = J.T @ (A @ at.theta + normal[:-1, DATA])
        variance, mean = self.prior.variance, self.prior.mean
        known = variance > 0.0
        N[known, known] += 1.0 / variance[known]
        gradient[known] += (at.x[known] - mean[known]) / variance[known]
        return N, gradient

    def _jacobian(self, at: Solution) -> Array:
        """d theta / d x where the filter's own columns were linearised, if that is near.

        With another attitude here than there, heading and the east gyro bias, which the data
        cannot tell apart, seem to differ in second order, and no gyro noise covers that: at
        1 deg/h the sigma of heading would sink below its error within a quarter of an hour
        (first-estimates Jacobian: Huang, Mourikis & Roumeliotis, ISER 2008).
        """
        if self._about is None or np.abs(self._about - at.R).max() > NEAR:
            return at.jacobian
        return Solution(self._about, at.x, at.covariance).jacobian

    def _parameters(self, N: Array) -> tuple[Array, Array]:
        """Directions of x to estimate (m, e), and to consider, times their sigma (m, c)."""
        unit = np.eye(N.shape[0])
        variance = self.prior.variance
        columns = [unit[:, :6]]
        considered = unit[:, :0]
        if variance[X_R].any():
            columns.append(unit[:, X_R] @ self._lever.free)
            considered = unit[:, X_R] @ self._lever.considered * math.sqrt(variance[6])
        others = np.r_[9:12, X_G : N.shape[0]]
        columns.append(unit[:, others[variance[others] > 0.0]])
        basis = np.hstack(columns)
        sigma = np.sqrt(variance[X_BA])
        if not sigma.all():
            return basis, considered
        # Information of data and prior on the accelerometer bias, in units of the prior.
        cross = basis.T @ N[:, X_BA] * sigma
        own = N[X_BA, X_BA] * np.outer(sigma, sigma)
        own -= cross.T @ invert_information(basis.T @ N @ basis) @ cross
        ratio, vectors = np.linalg.eigh(own)
        directions = unit[:, X_BA] @ (sigma[:, None] * vectors)
        excited = ratio > 1.0 + ESTIMATE_RATIO
        considered = np.hstack((considered, directions[:, ~excited]))
        return np.hstack((basis, directions[:, excited])), considered

    def _at_prior_outside(self, start: Solution, considered: Array) -> Solution:
        """`start` with what is not estimated put back to its prior."""
        prior, x = self.prior, start.x.copy()
        mean = prior.mean[X_R]
        free = self._lever.free if prior.variance[X_R].any() else np.zeros((3, 0))
        x[X_R] = mean + free @ (free.T @ (x[X_R] - mean))
        if prior.variance[X_BA].all():
            # The directions are orthonormal in units of the prior's sigma.
            out = considered[X_BA]
            x[X_BA] -= out @ ((out / prior.variance[X_BA, None]).T @ x[X_BA])
        return Solution(start.R, x, start.covariance)
