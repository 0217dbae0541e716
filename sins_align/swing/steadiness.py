"""Whether heading changes from one solution to the next no more than it should.

The solution of more data differs from that of less by what is new in them. Of an optimal filter
with a true model the covariance of that change is the difference of both covariances; gyro noise
above the declared one, or a base that creeps, changes heading by more. Innovations do not show it:
they are dominated by the position noise of an epoch. The levels are left out: where a direction of
the accelerometer bias goes over from considered to estimated, they jump and may.
"""

from __future__ import annotations

import math

from sins_align.rotation import log_rotation
from sins_align.swing.solution import KAPPA, Solution

# Solutions of the first seconds are not linear enough.
FIRST_S = 10.0
MEMORY = 8  # changes
LEAST_COUNT = 5
# What rounding and what is left of Gauss-Newton may add, of the variance.
FLOOR = 1e-3


class Steadiness:
    """Mean normalised square of heading's changes."""

    def __init__(self) -> None:
        self._mean = 0.0
        self._count = 0

    def add(self, before: Solution, after: Solution, time_s: float) -> None:
        """Take in two solutions of one linearisation, the latter of more data."""
        if time_s < FIRST_S:
            return
        up = after.R[:, 2]
        old, new = (float(up @ s.covariance[KAPPA, KAPPA] @ up) for s in (before, after))
        variance = (1.0 + FLOOR) * old - new
        if variance <= 0.0:  # the position noise has grown, say
            return
        change = float(up @ log_rotation(after.R @ before.R.T))
        self._count += 1
        self._mean += (change * change / variance - self._mean) / min(self._count, MEMORY)

    @property
    def value(self) -> float:
        """The mean square over its expectation; NaN before there are enough changes."""
        return self._mean if self._count >= LEAST_COUNT else math.nan
