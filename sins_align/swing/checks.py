"""What speaks for a solution besides its covariance: three tests on the same epochs."""

from __future__ import annotations

from typing import NamedTuple

from sins_align.grades import ImuGrade
from sins_align.limits import latitude_differs
from sins_align.reasons import Finding
from sins_align.swing.epochs import Epochs
from sins_align.swing.latitude import earth_rate_slope, latitude_column, latitude_doubts
from sins_align.swing.solution import KAPPA, Solution, Solver
from sins_align.swing.steadiness import Steadiness
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
    """

    witness: Witness | None
    steadiness: float
    latitude: LatitudeEstimate | None
    moved: Array | None
    doubts: tuple[Finding, ...] = ()


class Checks:
    """The tests.

    Parameters
    ----------
    gravity, noise : models of the filter
    grade : as declared
    """

    def __init__(self, gravity: GravityModel, noise: NoiseModel, grade: ImuGrade) -> None:
        self._gravity, self._grade = gravity, grade
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
        latitude, moved = None, None
        given = self._gravity.latitude
        column = latitude_column(solution, given)
        if column is not None:
            off, sigma, response = solver.score(filter_.normal, solution, column)
            latitude = LatitudeEstimate(given + off, sigma)
            if latitude_differs(given, latitude):
                # (I + [phi x]) C^ and Exp(-w_ie t) R^T both change.
                phi = filter_.X[PHI, :-1] @ (solution.jacobian @ response + column)
                turned = earth_rate_slope(given) * float(epochs.time_s[-1])
                moved = off * (C_nb0 @ (phi - response[KAPPA]) - turned)
        doubts = latitude_doubts(self._grade, given, latitude, self._has_told_latitude)
        self._has_told_latitude |= not doubts
        return Report(witness, self._steadiness.value, latitude, moved, doubts)
