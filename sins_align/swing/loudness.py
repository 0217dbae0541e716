"""Whether the gyros are noisier than declared.

A second filter of the same data takes their noise for `FACTOR` times what is declared. The ratio
of the likelihoods of the two is the most powerful test there is, and whenever one looks at it: on
a centre at rest, and if what is declared is true, it exceeds c at any time of a run by a chance of
1/c at most (Ville's inequality). Nothing of single epochs shows such a noise: the tilt that it
leaves takes half a minute to come out of the accelerometers' own.
"""

from __future__ import annotations

import math
from dataclasses import replace

from sins_align.reasons import GYRO_NOISY, Finding
from sins_align.swing.epochs import Epochs
from sins_align.swing.latitude import latitude_column
from sins_align.swing.position_noise import PositionNoise
from sins_align.swing.solution import Solution, Solver
from sins_align.swing.two_stage import GravityModel, Linearisation, NoiseModel, build_steps
from sins_align.swing.two_stage_filter import TwoStageFilter

FACTOR = 3.0
# The logarithm of the ratio beyond which the declared noise is not believed, which holds up one run
# in thirty for nothing at most; and that below which it is again.
DOUBTED, BELIEVED = math.log(30.0), math.log(10.0)


class Loudness:
    """The second filter, and what the two say.

    log_ratio : of the likelihoods, louder over declared
    """

    def __init__(self, noise: NoiseModel) -> None:
        self._noise = replace(noise, gyro=FACTOR * noise.gyro)
        self._filter = TwoStageFilter(self._noise)
        self._about: Linearisation | None = None
        self.log_ratio = 0.0
        self._is_doubted = False

    def update(
        self, declared: TwoStageFilter, epochs: Epochs, about: Linearisation, gravity: GravityModel
    ) -> None:
        """Follow the filter with the declared noise, which is linearised about `about`."""
        if about is not self._about:
            position = PositionNoise(declared.variances[0])
            self._about, self._filter = about, TwoStageFilter(self._noise, position)
        count = len(self._filter.variances)
        steps = build_steps(epochs, count, about, gravity, self._noise)
        self._filter.follow(steps, declared.variances[count:])

    def compare(
        self, declared: TwoStageFilter, solver: Solver, solution: Solution, latitude: float
    ) -> None:
        """Hold the two against each other at a solution of the declared one.

        latitude : of the model [rad]. That it may be wrong is not to be taken for noise
        """
        column = latitude_column(solution, latitude)
        mine = solver.log_likelihood(self._filter, solution, column)
        self.log_ratio = mine - solver.log_likelihood(declared, solution, column)
        self._is_doubted = self.log_ratio > (BELIEVED if self._is_doubted else DOUBTED)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What there is to doubt."""
        if not self._is_doubted:
            return ()
        return (GYRO_NOISY(factor=FACTOR, log_ratio=self.log_ratio),)
