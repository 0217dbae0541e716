"""Strong tracking: how a filter believes that something has changed.

A filter that has converged is slow to follow what its model does not know. A fading makes the
forecast's covariance larger where innovations are too large: `ScaleJumpFading` only where the
mismatch is, `PublishedFading` everywhere, by (58) of Wu, Tang and Huang with the factor of their
reference.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from sins_align.odo.guards import ScaleJump
from sins_align.odo.layout import ODOMETER_SCALE as SCALE
from sins_align.types import Array

# Of Zhou and Frank's strong tracking filter; the paper names neither.
FORGETTING = 0.95  # rho
SOFTENING = 1.0  # beta


class Innovation(NamedTuple):
    """A measurement against what was expected of it.

    value : (3,) [m]; S, R : (3, 3) its covariance by the errors, and by noise [m^2]
    inverse : (3, 3) of S + R; H : (3, n + 3) it by the errors at U = 0; the columns of a place are
        those of the Earth's axis: no fading looks at them, and the place has no noise Q
    """

    value: Array
    S: Array
    R: Array
    inverse: Array
    H: Array


class Fading(Protocol):
    """Where, and by how much, a forecast is believed less."""

    def inflate(self, P: Array, Q: Array, innovation: Innovation, distance: float) -> Array | None:
        """A larger covariance of the forecast; None: it is right.

        Parameters
        ----------
        P, Q : (n + 3, n + 3) covariance of the forecast, and what of it is new noise
        distance : travelled in the epoch [m]
        """


class NoFading:
    """The forecast is always believed."""

    def inflate(self, P: Array, Q: Array, innovation: Innovation, distance: float) -> Array | None:
        """See `Fading`."""
        return None


class ScaleJumpFading:
    """The inflation goes where the mismatch is: to a scale that has jumped."""

    def __init__(self) -> None:
        self._jump = ScaleJump()

    def inflate(self, P: Array, Q: Array, innovation: Innovation, distance: float) -> Array | None:
        """See `Fading`."""
        h = innovation.H[:, SCALE]
        jump = self._jump.test(h, innovation.inverse, innovation.value, distance)
        if jump is None:
            return None
        inflated = P.copy()
        inflated[SCALE, :] = inflated[:, SCALE] = 0.0
        inflated[SCALE, SCALE] = jump * jump
        return inflated


class PublishedFading:
    """P = lambda (P - Q) + Q                                   Wu, Tang and Huang (58)

    The paper takes lambda from its reference [8] and does not print it; that of the strong
    tracking filter is

        V_1 = nu nu',  V_k = (rho V_k-1 + nu nu') / (1 + rho)
        N = V - H Q H' - beta R,  M = H (P - Q) H',  lambda = max(1, tr N / tr M)

    What is not observable is inflated with the rest, and nothing ever takes that back.
    """

    def __init__(self) -> None:
        self._V: Array | None = None

    def inflate(self, P: Array, Q: Array, innovation: Innovation, distance: float) -> Array | None:
        """See `Fading`."""
        square = np.outer(innovation.value, innovation.value)
        if self._V is None:
            self._V = square
        else:
            self._V = (FORGETTING * self._V + square) / (1.0 + FORGETTING)
        H = innovation.H
        of_noise = float(np.trace(H @ Q @ H.T))
        N = float(np.trace(self._V - SOFTENING * innovation.R)) - of_noise
        M = float(innovation.S.trace()) - of_noise
        factor = N / M if M > 0.0 else 1.0
        return None if factor <= 1.0 else factor * (P - Q) + Q
