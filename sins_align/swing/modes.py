"""Whether another heading, far from the solution's, fits the data as well or better.

In its first seconds the data tell the horizontal Earth rate, of known length, and one part of it
better than the other: the swing hides the rest behind start velocity and lever arm. Heading is
then that on a circle which a narrow ellipse meets, and it meets it twice. The sum of squares has
two minima, Gauss-Newton ends in the one that is near, and the covariance there knows nothing of
the other. The sums do (`Solver.squares_at`): they are looked at while heading is coarse.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sins_align.rotation import exp_rotation
from sins_align.swing.outcome import heading_variance
from sins_align.swing.solution import Solution, Solver
from sins_align.types import Array

# Another heading is one as far off as this; what is nearer is for Gauss-Newton.
TURNS = np.radians(np.arange(45.0, 316.0, 15.0))
# It is gone to where it leaves fewer squares by so many,
FEWER = 1.0
# and excluded where from 90 deg on it leaves more by so many: 4 sigma, one in 16 000. Where both
# parts are known alike to 20 deg, it is 16.4: those wait for nothing.
OPPOSITE = np.radians(np.arange(90.0, 271.0, 15.0))
EXCLUDED = 16.0
# With a heading as good as this there is no other one.
SETTLED = math.radians(2.0)


def least_mode(solver: Solver, normal: Array, solution: Solution) -> Solution:
    """`solution`, or the one that Gauss-Newton finds from a heading that fits better."""
    squares = solver.squares_at(normal, solution, TURNS)
    least = int(squares.argmin())
    if squares[least] > -FEWER:
        return solution
    turned = exp_rotation(TURNS[least] * solution.R[:, 2]) @ solution.R
    return solver.solve(normal, replace(solution, R=turned))


def is_settled(solution: Solution) -> bool:
    """Whether heading is known too well for another one."""
    return heading_variance(solution) < SETTLED**2


def is_alone(solver: Solver, normal: Array, solution: Solution) -> bool:
    """Whether the data exclude the headings far from that of the solution."""
    if is_settled(solution):
        return True
    return bool(solver.squares_at(normal, solution, OPPOSITE).min() > EXCLUDED)
