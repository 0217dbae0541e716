"""Whether the gyros are noisier than declared.

A second filter of the same data takes their noise for `FACTOR` times what is declared: see
`noise_doubt`. Nothing of single epochs shows such a noise: the tilt that it leaves takes half a
minute to come out of the accelerometers' own.
"""

from __future__ import annotations

from dataclasses import replace

from sins_align.noise_doubt import FACTOR, NoiseDoubt
from sins_align.swing.epochs import Epochs
from sins_align.swing.latitude import latitude_column
from sins_align.swing.position_noise import PositionNoise
from sins_align.swing.solution import Solution, Solver
from sins_align.swing.two_stage import GravityModel, Linearisation, NoiseModel, build_steps
from sins_align.swing.two_stage_filter import TwoStageFilter


class Loudness(NoiseDoubt):
    """The second filter, and what the two say."""

    def __init__(self, noise: NoiseModel) -> None:
        super().__init__()
        self._noise = replace(noise, gyro=FACTOR * noise.gyro)
        self._filter = TwoStageFilter(self._noise)
        self._about: Linearisation | None = None

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
        self.note(mine - solver.log_likelihood(declared, solution, column))
