"""Along which directions the motion tells anything about the lever arm."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sins_align.swing.epochs import Epochs
from sins_align.types import Array

# Gyro noise alone gives a second difference of 2 ARW T^-1.5; what is less than so many times
# that is no motion.
GYRO_NOISE_RATIO = 10.0
# A swing of 1 deg at 1/8 Hz, say: it tells the lever arm at once, ...
STRONG_SWING = 5e-3  # [rad/s^2]
# ... and a weaker one from this epoch on. Before, a centre that moves would be taken for metres of
# lever arm, and sigma for true.
SETTLED_EPOCHS = 60


class LeverDirections(NamedTuple):
    """Orthonormal directions in b, (3, m) each. Of the others the data know nothing at all.

    free : estimated
    considered : the motion is too weak to tell the lever arm yet, but not too weak for a lever
        arm to disturb: it stays at its prior, and its share of the error is in the covariance
    """

    free: Array
    considered: Array


class LeverExcitation:
    """Mean square of D = second divided difference of C, in each direction of b.

    The lever arm acts through C r. What of C r is constant or linear in time cannot be told
    from the start position and velocity; the second difference is free of both.

    Parameters
    ----------
    gyro_noise : angle random walk [rad/sqrt(s)]
    """

    def __init__(self, gyro_noise: float) -> None:
        self._gyro_noise = gyro_noise
        self._sum = np.zeros((3, 3))
        self._gyro_sum = 0.0
        self._count = 0

    def update(self, epochs: Epochs) -> None:
        """Take in the nodes that are new."""
        first = self._count + 1
        each = epochs.duration_s[first - 1 :]
        T = 0.5 * (each[:-1] + each[1:])
        # Epochs differ in length by a sample: the Earth alone would else look like a swing.
        slope = np.diff(epochs.C[first - 1 :], axis=0) / each[:, None, None]
        D = np.diff(slope, axis=0) / T[:, None, None]
        flat = D.reshape(-1, 3)
        self._sum += flat.T @ flat
        self._gyro_sum += float((4.0 * self._gyro_noise**2 * T**-3).sum())
        self._count += T.shape[0]

    def directions(self) -> LeverDirections:
        """Which directions in b are estimated, and which have to be considered."""
        if self._count == 0:
            return LeverDirections(np.zeros((3, 0)), np.zeros((3, 0)))
        squares, vectors = np.linalg.eigh(self._sum)
        motion = squares > GYRO_NOISE_RATIO**2 * self._gyro_sum
        strong = squares > STRONG_SWING**2 * self._count
        estimated = motion & (strong | (self._count > SETTLED_EPOCHS))
        return LeverDirections(vectors[:, estimated], vectors[:, motion & ~estimated])
