"""Kalman filter of the additive quaternion error and the velocity: Mu and Fang, eqs. (4) to (6)."""

from __future__ import annotations

import numpy as np

from sins_align.swing.paper_error_model import tilt_to_quaternion
from sins_align.types import Array


class QuaternionFilter:
    """X = (dQ, dV), measured through Y = dV, the velocity navigated at the swing centre.

    Constants that the filter does not estimate (biases, what the lever arm is wrong by) move
    its estimate; the sensitivity B to them is carried along through the same gains, so that
    P + B S B^T is the covariance with them (Schmidt's consider parameters).

    Parameters
    ----------
    tilt_sigma : (3,) 1 sigma of the misalignment at a reset, east, north, up [rad]
    constants : their number m
    """

    def __init__(self, tilt_sigma: Array, constants: int) -> None:
        self._tilt_variance = tilt_sigma**2
        self.x = np.zeros(6)
        self.P = np.zeros((6, 6))
        self._B = np.zeros((6, constants))
        self._squares = 0.0
        self._updates = 0

    def reset(self, Q: Array, velocity_covariance: Array) -> None:
        """Begin at the attitude Q (4,) with no known error.

        P0 of dQ is 1/4 Xi S Xi^T, of rank 3; that of dV is `velocity_covariance` (2, 2).
        """
        half_xi = tilt_to_quaternion(Q)
        self.x = np.zeros(6)
        self.P = np.zeros((6, 6))
        self.P[:4, :4] = half_xi * self._tilt_variance @ half_xi.T
        self.P[4:, 4:] = velocity_covariance
        self._B = np.zeros_like(self._B)
        self._squares = 0.0
        self._updates = 0

    def predict(self, transition: Array, noise: Array, driven: Array) -> None:
        """Over one filter step: transition and noise covariance (6, 6).

        driven (6, m) : what the constants add to X in the step.
        """
        self.x = transition @ self.x
        self.P = transition @ self.P @ transition.T + noise
        self._B = transition @ self._B - driven

    def correct(self, V: Array, R: Array, seen: Array) -> None:
        """With the navigated velocity V (2,) [m/s], noise covariance R (2, 2).

        seen (2, m) : what the constants add to V without having come through X.
        """
        innovation = V - self.x[4:]
        # C = [0, I]: products with it are the last two rows and columns.
        weight = np.linalg.inv(self.P[4:, 4:] + R)
        gain = self.P[:, 4:] @ weight
        self.x = self.x + gain @ innovation
        joseph = np.eye(6)
        joseph[:, 4:] -= gain
        P = joseph @ self.P @ joseph.T + gain @ R @ gain.T
        self.P = 0.5 * (P + P.T)
        self._B = joseph @ self._B + gain @ seen
        self._squares += float(innovation @ weight @ innovation)
        self._updates += 1

    def move_velocity(self, step: Array) -> None:
        """The navigated velocity has been moved by a known step (2,) [m/s]."""
        self.x[4:] += step

    def tilt_covariance(self, Q: Array, constants: Array) -> Array:
        """(3, 3) of the misalignment, east, north, up [rad^2]: 4 Xi^T (P + B S B^T) Xi.

        P grows with `consistency` where that is above 1.

        Parameters
        ----------
        Q : (4,) navigated attitude
        constants : (m, m) covariance S
        """
        growth = max(1.0, self.consistency) if self._updates else 1.0
        P = growth * self.P + self._B @ constants @ self._B.T
        two_xi = 4.0 * tilt_to_quaternion(Q)
        covariance: Array = two_xi.T @ P[:4, :4] @ two_xi
        return covariance

    @property
    def consistency(self) -> float:
        """Mean normalised innovation squared since the reset over 2, its expected value."""
        return self._squares / (2.0 * self._updates) if self._updates else float("nan")
