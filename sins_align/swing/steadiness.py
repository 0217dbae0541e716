"""Whether heading changes with new data no more than it should.

The solution of more data differs from that of less by what is new in them. Of an optimal filter
with a true model the covariance of that change is the difference of both covariances; gyro noise
above the declared one, or a base that creeps, changes heading by more, slowly and one way, and the
innovations of single epochs do not show it: they are dominated by the position noise. The levels
are left out: where a direction of the accelerometer bias goes over from considered to estimated,
they jump and may.
"""

from __future__ import annotations

import math

from sins_align.rotation import log_rotation
from sins_align.swing.solution import KAPPA, Solution
from sins_align.types import Array

# Solutions of the first seconds are not linear enough.
FIRST_S = 10.0
LEAST_COUNT = 4  # earlier solutions
# Those of before this time may, under heave, be 30 deg off at a sigma of 1 deg. When there are
# enough later ones they are forgotten: they would never let one be steady.
SURE_S = 20.0
# And so are those of a quarter of the time: of what disturbed them little is left.
REMEMBERED = 4.0
# What rounding and what is left of Gauss-Newton may add, of the variance.
FLOOR = 1e-3


class Steadiness:
    """Remembers the solutions, and holds the last one against all of them."""

    def __init__(self) -> None:
        # Time, attitude, variance of heading.
        self._earlier: list[tuple[float, Array, float]] = []
        self._value = math.nan

    def add(self, solution: Solution, time_s: float) -> None:
        """Take in the solution of all data so far."""
        if time_s < FIRST_S:
            return
        up = solution.R[:, 2]
        now = float(up @ solution.covariance[KAPPA, KAPPA] @ up)
        sure_s = max(SURE_S, time_s / REMEMBERED)
        sure = [earlier for earlier in self._earlier if earlier[0] >= sure_s]
        if len(sure) >= LEAST_COUNT:
            self._earlier = sure
        squares = []
        for _, R, before in self._earlier:
            variance = (1.0 + FLOOR) * before - now
            if variance > 0.0:  # else the position noise has grown, say
                squares.append(float(up @ log_rotation(solution.R @ R.T)) ** 2 / variance)
        self._earlier.append((time_s, solution.R, now))
        self._value = max(squares) if len(squares) >= LEAST_COUNT else math.nan

    @property
    def value(self) -> float:
        """Largest square of a change over its variance; NaN before there are enough."""
        return self._value
