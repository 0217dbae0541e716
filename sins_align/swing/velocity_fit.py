"""A second opinion: the coarse alignment in inertial axes, over the same epochs.

The mean velocity of the swing centre in an epoch is zero. With V_k the sum of the u before epoch
k, and G(t) the integral of gravity's factors (`two_stage`),

    0 = v0 + V_k + s_k / T + [R_e, R_n, R_u] G(t_k + T/2) - (C_k+1 - C_k) / T r

is linear in what is unknown, and summed up unweighted. No filter, no noise model, no prior on the
attitude: what misleads the filter's weights does not mislead this, and it cannot be as good.
"""

from __future__ import annotations

import math

import numpy as np

from sins_align.rotation import log_rotation
from sins_align.swing.epochs import Epochs
from sins_align.swing.solution import Prior, Solution
from sins_align.swing.start import start_attitude
from sins_align.swing.two_stage import (
    BASE,
    DATA,
    LEVER,
    R_EAST,
    R_NORTH,
    R_UP,
    V0,
    GravityModel,
    NoiseModel,
)
from sins_align.types import Array, Witness

NAME = "velocity fit"
FIRST_S = 30.0
# A base that has turned by more than this [rad] has turned its biases with it, of which the fit
# knows nothing: 20 ug are then 10' of its heading, and it is no witness any more. A swing does not
# count: means of so many epochs are compared.
TURNED, MEAN_OF = 0.35, 20
# Least squares of a random walk is so much worse than the best, in variance.
UNWEIGHTED = 1.2


class VelocityFit:
    """The sums, and their solution.

    Parameters
    ----------
    gravity, noise : models of the filter; noise only tells how good the fit can be
    """

    def __init__(self, gravity: GravityModel, noise: NoiseModel) -> None:
        self._gravity, self._noise = gravity, noise
        self._normal = np.zeros((BASE + 1, BASE + 1))
        self._velocity = np.zeros(3)
        self._count = 0

    def update(self, epochs: Epochs) -> None:
        """Take in the epochs that are new."""
        new = slice(self._count, None)
        T, u = epochs.duration_s[new], epochs.u[new]
        K = T.shape[0]
        before = self._velocity + np.cumsum(u, axis=0) - u
        self._velocity = before[-1] + u[-1]
        A = np.zeros((K, 3, BASE + 1))
        eye = np.eye(3)
        G = self._gravity.integral(epochs.time_s[self._count : -1] + 0.5 * T)
        for j, columns in enumerate((R_EAST, R_NORTH, R_UP)):
            A[:, :, columns] = G[:, j, None, None] * eye
        A[:, :, V0] = eye
        C = epochs.C[self._count :]
        A[:, :, LEVER] = (C[:-1] - C[1:]) / T[:, None, None]
        A[:, :, DATA] = before + epochs.s[new] / T[:, None]
        flat = A.reshape(-1, BASE + 1)
        self._normal += flat.T @ flat
        self._count += K

    def compare(
        self, solution: Solution, prior: Prior, epochs: Epochs, variance: float, position: float
    ) -> Witness | None:
        """The fit beside a solution; None while there is none, and once the base has turned.

        Parameters
        ----------
        variance : of the solution's heading [rad^2]
        position : variance of the centre's position at an epoch [m^2]
        """
        time_s = float(epochs.time_s[-1])
        is_polar = abs(math.cos(self._gravity.latitude)) < 1e-3
        if time_s < FIRST_S or is_polar or _has_turned(epochs.C):
            return None
        # In units of what a mean velocity is uncertain by, for the prior of the lever arm.
        normal = self._normal / self._white(time_s, position)
        # R_n is of second order in time: that of the solution is good enough.
        normal[:, DATA] += normal[:, R_NORTH] @ solution.R[:, 1]
        R = start_attitude(normal, prior)
        if R is None:
            return None
        kappa = log_rotation(R @ solution.R.T)
        # R = Exp(kappa) R^ in b0: heading is what turns about up; phi = -R^T kappa.
        heading = float(kappa @ solution.R[:, 2])
        total = variance + self._variance(time_s, position)
        phi = np.array([0.0, 0.0, -heading])
        return Witness(NAME, phi, heading * heading / total)

    def _white(self, time_s: float, position: float) -> float:
        """Variance of an epoch's mean velocity, by the position noise at its ends [m^2/s^2]."""
        epoch = time_s / self._count
        return 2.0 * position / epoch**2

    def _variance(self, time_s: float, position: float) -> float:
        """Of the fit's heading, but for the gyro bias, which is that of the solution [rad^2].

        (1.2 (12 VRW^2 / T^3) + 720 sigma_v^2 / (N T^4)) / (g Omega cos L)^2
            + 1.2 ARW^2 / (Omega cos L)^2 / T,        sigma_v^2 = 2 R / epoch^2
        of a quadratic among N velocities over T
        """
        noise, model = self._noise, self._gravity
        horizontal = model.earth_rate * math.cos(model.latitude)
        white = self._white(time_s, position)
        force = UNWEIGHTED * 12.0 * noise.accel**2 / time_s**3
        force += 720.0 * white / (self._count * time_s**4)
        gyro = UNWEIGHTED * noise.gyro**2 / time_s
        return (force / model.magnitude**2 + gyro) / horizontal**2


def _has_turned(C: Array) -> bool:
    """Whether the base has turned since its start, its swing apart; C (K, 3, 3): b -> b0."""
    count = C.shape[0] // MEAN_OF
    means = C[: count * MEAN_OF].reshape(count, MEAN_OF, 9).mean(axis=1)
    means /= np.linalg.norm(means, axis=1)[:, None]  # a large swing shortens them
    return bool((3.0 * means @ means[0]).min() < 1.0 + 2.0 * math.cos(TURNED))
