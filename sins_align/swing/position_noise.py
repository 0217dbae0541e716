"""How still the swing centre is: a noise that grows with the innovations."""

from __future__ import annotations

import math
from copy import copy

import numpy as np

from sins_align.types import Array


class PositionNoise:
    """Variance of the swing centre's position at an epoch [m^2], grown by the innovations.

    Never below its floor. It grows where the innovations of the last epochs say that the
    centre is not at rest, by what they exceed their expectation.
    """

    MEMORY = 20  # epochs
    SIGNIFICANT = 1.5  # ratio of variances from which on it grows

    def __init__(self, floor: float) -> None:
        self.floor = floor
        self.variance = floor
        self.has_grown = False
        self._seen = self._expected = self._consistency = 0.0
        self._weight = 0.0

    def updated(self, seen: float, expected: float, normalised: float, count: int) -> PositionNoise:
        """With the innovations of `count` epochs, which this noise has been used for.

        Parameters
        ----------
        seen, expected : mean square of an innovation, and what it should be [m^2]
        normalised : mean normalised square, per axis
        """
        other = copy(self)
        keep = (1.0 - 1.0 / self.MEMORY) ** count
        expected -= self.variance - self.floor
        other._weight = 1.0 - keep * (1.0 - self._weight)
        other._seen = keep * self._seen + (1.0 - keep) * seen
        other._expected = keep * self._expected + (1.0 - keep) * expected
        other._consistency = keep * self._consistency + (1.0 - keep) * normalised
        grown = other._seen > self.SIGNIFICANT * other._expected
        excess = (other._seen - other._expected) / other._weight if grown else 0.0
        # A step of the centre shows at once: six sigma of the mean of 3 count squares.
        if seen > (1.0 + 6.0 * math.sqrt(2.0 / (3.0 * count))) * expected:
            excess = max(excess, seen - expected)
        other.variance = self.floor + excess
        other.has_grown = self.has_grown or excess > 0.0
        return other

    def again(self) -> PositionNoise:
        """For another run over the same epochs: begins with what this one found."""
        other = copy(self)
        other.has_grown = other.variance > other.floor
        return other

    @property
    def consistency(self) -> float:
        """Mean normalised innovation squared over its expectation, of the last epochs."""
        return self._consistency / self._weight if self._weight else float("nan")


def judge(
    noise: PositionNoise, E: Array, S: Array, theta: Array, theta_covariance: Array | None
) -> PositionNoise:
    """`noise` after a look at the innovations of a portion.

    Parameters
    ----------
    E : (K, 3, p + 1) innovations are E [theta, 1] [m]; S : (K, 3, 3) their covariance [m^2]
    theta : (p,); theta_covariance : (p, p), where theta does not know these epochs yet
    """
    K = E.shape[0]
    innovations = E @ np.append(theta, 1.0)
    if theta_covariance is not None:
        S = S + E[:, :, :-1] @ theta_covariance @ E[:, :, :-1].transpose(0, 2, 1)
    normalised = innovations * np.linalg.solve(S, innovations[:, :, None])[:, :, 0]
    return noise.updated(
        float((innovations * innovations).mean()),
        float(np.trace(S, axis1=1, axis2=2).mean()) / 3.0,
        float(normalised.mean()),
        K,
    )
