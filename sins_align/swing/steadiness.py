"""Whether the attitude changes from one solution to the next no more than it should.

The solution of more data differs from that of less by what is new in them. Of an optimal filter
with a true model the covariance of that change is the difference of both covariances; gyro noise
above the declared one, or a base that creeps, changes the attitude by more. Innovations do not
show it: they are dominated by the position noise of an epoch.
"""

from __future__ import annotations

import math

import numpy as np

from sins_align.rotation import log_rotation
from sins_align.swing.solution import KAPPA, Solution
from sins_align.types import Array

# Solutions of the first seconds are not linear enough.
FIRST_S = 20.0
MEMORY = 8  # changes
LEAST_COUNT = 4
# What rounding and what is left of Gauss-Newton may add, of the variance.
FLOOR = 1e-3


class Steadiness:
    """Mean normalised squares of the attitude's changes: of all of it, and of heading alone.

    Gyro noise shows in heading long before it does in the levels.
    """

    def __init__(self) -> None:
        self._means = np.zeros(2)
        self._count = 0

    def add(self, before: Solution, after: Solution, time_s: float) -> None:
        """Take in two solutions of one linearisation, the latter of more data."""
        if time_s < FIRST_S:
            return
        P = before.covariance[KAPPA, KAPPA]
        S: Array = P - after.covariance[KAPPA, KAPPA] + FLOOR * P
        if np.linalg.eigvalsh(S)[0] <= 0.0:  # something else was estimated before
            return
        change = log_rotation(after.R @ before.R.T)
        up = after.R[:, 2]
        squares = (change @ np.linalg.solve(S, change) / 3.0, (up @ change) ** 2 / (up @ S @ up))
        self._count += 1
        self._means += (squares - self._means) / min(self._count, MEMORY)

    @property
    def value(self) -> float:
        """The larger mean square over its expectation; NaN before there are enough changes."""
        return float(self._means.max()) if self._count >= LEAST_COUNT else math.nan
