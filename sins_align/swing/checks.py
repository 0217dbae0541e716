"""What speaks for a solution besides its covariance: tests on the same epochs."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sins_align.grades import ImuGrade
from sins_align.limits import is_navigation_grade, latitude_differs
from sins_align.reasons import Finding
from sins_align.swing.epochs import Epochs
from sins_align.swing.latitude import (
    earth_rate_slope,
    is_told,
    latitude_by_both,
    latitude_column,
    latitude_doubts,
    told_after,
)
from sins_align.swing.solution import KAPPA, Solution, Solver
from sins_align.swing.steadiness import Steadiness
from sins_align.swing.turning import latitude_of_turning, turning
from sins_align.swing.two_stage import PHI, GravityModel, NoiseModel
from sins_align.swing.two_stage_filter import TwoStageFilter
from sins_align.swing.velocity_fit import VelocityFit
from sins_align.types import Array, LatitudeEstimate, Witness


class Report(NamedTuple):
    """What the tests say of a solution.

    witness, steadiness, latitude : see `Estimate`
    moved : (3,) what the attitude at the last epoch would turn by with the latitude of the data,
        where that is not the one given, in n [rad]; else None
    doubts : what the latitude has a claim wait for
    untold_s : how much later the latitude will be told [s]
    """

    witness: Witness | None
    steadiness: float
    latitude: LatitudeEstimate | None
    moved: Array | None
    doubts: tuple[Finding, ...] = ()
    untold_s: float = 0.0


class Checks:
    """The tests.

    Parameters
    ----------
    gravity, noise : models of the filter
    grade : as declared
    """

    def __init__(self, gravity: GravityModel, noise: NoiseModel, grade: ImuGrade) -> None:
        self._gravity, self._grade = gravity, grade
        self._bias = math.hypot(grade.gyro_bias, grade.gyro_bias_instability)
        self._has_told_latitude = False
        self._fit = VelocityFit(gravity, noise)
        self._steadiness = Steadiness()

    def update(self, epochs: Epochs) -> None:
        """Take in the epochs that are new."""
        self._fit.update(epochs)

    def note(self, solution: Solution, time_s: float) -> None:
        """Take in the solution of all data so far."""
        self._steadiness.add(solution, time_s)

    def report(
        self,
        solution: Solution,
        solver: Solver,
        filter_: TwoStageFilter,
        epochs: Epochs,
        heading_variance: float,
        C_nb0: Array,
    ) -> Report:
        """What is to be said of a solution.

        heading_variance : [rad^2]; C_nb0 : (3, 3) b0 -> n at the last epoch
        """
        witness = self._fit.compare(
            solution, solver.prior, epochs, heading_variance, filter_.noise.variance
        )
        given, time_s = self._gravity.latitude, float(epochs.time_s[-1])
        by_turning = self._latitude_by_turning(epochs, solution)
        own, by_data = None, np.zeros(3)
        column = latitude_column(solution, given)
        if column is not None:
            off, sigma, response = solver.score(filter_.normal, solution, column)
            # To first order: so far off that it is no latitude, it is far off.
            found = min(max(given + off, -0.5 * math.pi), 0.5 * math.pi)
            own = LatitudeEstimate(found, sigma)
            # (I + [phi x]) C^ and Exp(-w_ie t) R^T both change.
            phi = filter_.X[PHI, :-1] @ (solution.jacobian @ response + column)
            by_data = C_nb0 @ (phi - response[KAPPA])
        latitude = latitude_by_both(own, by_turning)
        moved = None
        if latitude is not None and latitude_differs(given, latitude):
            turned = earth_rate_slope(given) * time_s
            moved = (latitude.latitude - given) * (by_data - turned)
        sways_s = math.inf if by_turning is None else time_s
        doubts = latitude_doubts(self._grade, given, latitude, self._has_told_latitude, sways_s)
        self._has_told_latitude |= latitude is not None and not doubts and is_told(latitude)
        untold_s = 0.0
        if not self._has_told_latitude:
            untold_s = told_after(self._grade, given, own, by_turning, time_s)
        return Report(witness, self._steadiness.value, latitude, moved, doubts, untold_s)

    def _latitude_by_turning(self, epochs: Epochs, solution: Solution) -> LatitudeEstimate | None:
        """With gyros that tell a degree by it: a base that settles slowly would mislead others."""
        if not is_navigation_grade(self._grade):
            return None
        given = self._gravity.latitude
        turn = turning(epochs, solution.R, given, self._grade)
        return latitude_of_turning(turn, given, self._bias)
