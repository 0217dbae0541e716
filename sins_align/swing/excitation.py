"""Which directions of the lever arm the motion tells anything about."""

from __future__ import annotations

import numpy as np

from sins_align.swing.epochs import Epochs
from sins_align.types import Array

# Gyro noise alone gives a second difference of 2 ARW T^-1.5; a direction counts as excited
# from so many times that on.
EXCITED_RATIO = 10.0


class LeverExcitation:
    """Mean square of D = second difference of C over T^2, against the gyro's noise.

    The lever arm acts through C r. What of C r is constant or linear in time cannot be told
    from the start position and velocity, and what is gyro noise is no motion.

    Parameters
    ----------
    gyro_noise : angle random walk [rad/sqrt(s)]
    """

    def __init__(self, gyro_noise: float) -> None:
        self._gyro_noise = gyro_noise
        self._sum = np.zeros((3, 3))
        self._floor = 0.0
        self._count = 0

    def update(self, epochs: Epochs) -> None:
        """Take in the nodes that are new."""
        first = self._count + 1
        T = 0.5 * (epochs.duration_s[first - 1 : -1] + epochs.duration_s[first:])
        C = epochs.C[first - 1 :]
        D = (C[2:] - 2.0 * C[1:-1] + C[:-2]) / (T * T)[:, None, None]
        flat = D.reshape(-1, 3)
        self._sum += flat.T @ flat
        self._floor += float((4.0 * self._gyro_noise**2 * T**-3).sum())
        self._count += T.shape[0]

    def free_directions(self) -> Array:
        """(3, m) orthonormal directions in b that are excited."""
        if self._count == 0:
            return np.zeros((3, 0))
        values, vectors = np.linalg.eigh(self._sum)
        return vectors[:, values > EXCITED_RATIO**2 * self._floor]
