"""Lever arm by least squares, with the level misalignment or without: section 3."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sins_align.rotation import skew
from sins_align.types import Array, LeverArm

# A specific force below this is lost in what the model leaves out: floor of the noise that
# weighs the prior against the data [m/s^2].
_FORCE_FLOOR = 1e-4
# An axis counts as observable where its excitation is so many times what gyro noise feigns,
# and above what rounding does [1/s^4].
_EXCITATION = 2.0
_EXCITATION_FLOOR = 1e-10
# What holds an unobservable axis at its prior [m].
_FROZEN_SIGMA = 1e-6


def lever_matrix(w_ib_b: Array, dw_ib_b: Array) -> Array:
    """H1 = [w x]^2 + [dw x], eq. (9): (3, N), (3, N) -> (N, 3, 3) [1/s^2]."""
    cross = skew(w_ib_b.T)
    return cross @ cross + skew(dw_ib_b.T)


def level_matrix(C_nb: Array, gravity: float) -> Array:
    """H2 = g [-c_2, c_1], c_i column i of C_bn: (3, 3, N) -> (N, 3, 2) [m/s^2].

    For the level misalignment psi (east, north) of C_nb_estimated = Exp([psi x]) C_nb_true:
    the paper's phi, minus that of the package's page. The paper prints elements of C_nb;
    eq. (13) wants those of C_bn.
    """
    return gravity * np.stack((-C_nb[1], C_nb[0]), axis=-1).transpose(1, 0, 2)


class RegressionNoise(NamedTuple):
    """What one sample is wrong by.

    force : 1 sigma of the specific force [m/s^2]
    bias : 1 sigma of the constant part of the specific force, per axis [m/s^2]
    slope : 1 sigma of the angular acceleration [rad/s^2]
    lag : of the angular acceleration [s]
    """

    force: float
    bias: float
    slope: float
    lag: float


class LeverSolution(NamedTuple):
    """What the least squares say.

    lever_arm : with its covariance
    level : (2,) psi east and north [rad]; zeros without the misalignment columns
    """

    lever_arm: LeverArm
    level: Array


class LeverRegression:
    """Accumulated least squares y = H1 r + H2 psi, eqs. (12) and (14).

    It is the information form of the recursion (11). The prior of the lever arm takes the
    place of the paper's P0 = 1e8 I, which for its accelerometers is one of 2 m.

    Parameters
    ----------
    gravity : [m/s^2]
    misaligned : with the columns H2 ('epls') or without ('ls')
    prior, prior_sigma : (3,) lever arm and its 1 sigma per axis [m]
    noise : of the samples
    """

    def __init__(
        self,
        gravity: float,
        misaligned: bool,
        prior: Array,
        prior_sigma: float,
        noise: RegressionNoise,
    ) -> None:
        self._gravity = gravity
        self._misaligned = misaligned
        self._prior = prior
        self._prior_sigma = prior_sigma
        self._force_noise = max(noise.force, _FORCE_FLOOR)
        # Noise of dw alone makes each diagonal element of [dw x]^T [dw x] twice its square.
        self._feigned = 2.0 * noise.slope**2
        self._lag = noise.lag
        self._bias_variance = noise.bias**2
        self.restart()

    def restart(self) -> None:
        """Forget all data."""
        size = 5 if self._misaligned else 3
        self._matrix = np.zeros((size, size))
        self._vector = np.zeros(size)
        self._lagging = np.zeros((size, 3))
        self._biased = np.zeros((size, 3))
        self._square = 0.0
        self._count = 0

    def add(
        self, C_nb: Array, w_ib_b: Array, dw_ib_b: Array, f_ib_b: Array, ddw_ib_b: Array
    ) -> None:
        """Take in N samples: C_nb (3, 3, N) estimated, the others (3, N).

        The second derivative of the rate only tells what the lag of the first one does.
        """
        H = lever_matrix(w_ib_b, dw_ib_b)
        if self._misaligned:
            H = np.concatenate((H, level_matrix(C_nb, self._gravity)), axis=2)
        # C_bn g_n with g_n = (0, 0, -g). The prior's part is taken off, so that it stands at 0.
        y = (f_ib_b - self._gravity * C_nb[2]).T - H[:, :, :3] @ self._prior
        self._biased += H.sum(axis=0).T
        H = H.reshape(-1, H.shape[2])
        self._lagging += H.T @ (self._lag * skew(ddw_ib_b.T)).reshape(-1, 3)
        self._matrix += H.T @ H
        self._vector += H.T @ y.ravel()
        self._square += float(np.sum(y * y))
        self._count += y.shape[0]

    def _observable(self) -> NDArray[np.bool_]:
        """(3,) which axes the motion tells about, the other unknowns being free."""
        if self._count == 0:
            return np.zeros(3, dtype=np.bool_)
        held = self._matrix + np.diag(np.full(self._vector.size, 1e-12 * self._count))
        excitation = 1.0 / (np.diag(np.linalg.inv(held))[:3] * self._count)
        floor = _EXCITATION * self._feigned + _EXCITATION_FLOOR
        return np.asarray(excitation > floor, dtype=np.bool_)

    def solve(self) -> LeverSolution:
        """Lever arm and level misalignment; without data, the prior and zeros.

        Noise of the derivative adds 2 sigma^2 I a sample to H1^T H1, which would draw the lever
        arm toward zero: it is taken off again. With the paper's gyros that changes nothing.

        The covariance is that of the least squares, scaled by the residuals, and on top of it
        what constant accelerometer biases do, and the square of what the lag does.
        """
        observable = self._observable()
        prior_sigma = max(self._prior_sigma, _FROZEN_SIGMA)
        held = np.where(observable, prior_sigma, _FROZEN_SIGMA)
        feigned = np.where(observable, self._count * self._feigned, 0.0)
        matrix, vector = self._matrix.copy(), self._vector.copy()
        matrix[[0, 1, 2], [0, 1, 2]] += (self._force_noise / held) ** 2 - feigned
        vector[:3] += feigned * self._prior
        if self._misaligned:
            matrix[[3, 4], [3, 4]] += self._force_noise**2  # 1 rad
        inverse = np.linalg.inv(matrix)
        solution = inverse @ vector
        lever_arm = self._prior + solution[:3]
        covariance = self._variance(solution) * inverse[:3, :3]
        by_bias = inverse[:3] @ self._biased
        covariance += self._bias_variance * by_bias @ by_bias.T
        by_lag = inverse[:3] @ self._lagging @ lever_arm
        covariance += np.outer(by_lag, by_lag)
        covariance[~observable, ~observable] = self._prior_sigma**2
        x, y, z = (bool(axis) for axis in observable)
        lever = LeverArm(lever_arm, covariance, (x, y, z))
        return LeverSolution(lever, solution[3:] if self._misaligned else np.zeros(2))

    def _variance(self, solution: Array) -> float:
        """Of one component of y, from the residuals [m^2/s^4]."""
        squares = self._square - solution @ (2.0 * self._vector - self._matrix @ solution)
        freedom = max(3 * self._count - solution.size, 1)
        return max(float(squares) / freedom, self._force_noise**2)
