"""The swing filter over all epochs so far, and run over them again where that pays.

What is linearised about a solution that was wrong is run again about the one it led to
(backtracking), until the attitude stays within 1 % of its sigma, but `passes` times at most.
"""

from __future__ import annotations

import math

import numpy as np

from sins_align.config import SwingConfig
from sins_align.rotation import level_axes, log_rotation
from sins_align.swing.epochs import Epochs
from sins_align.swing.excitation import LeverExcitation
from sins_align.swing.modes import is_alone, is_settled, least_mode
from sins_align.swing.outcome import heading_variance, phi_covariance
from sins_align.swing.solution import KAPPA, X_R, Solution, Solver, make_prior
from sins_align.swing.start import start_attitude
from sins_align.swing.two_stage import GravityModel, Linearisation, NoiseModel, build_steps
from sins_align.swing.two_stage_filter import TwoStageFilter
from sins_align.windows import Windows

# The noise model needs no new linearisation where the attitude has moved by less, and the
# lever arm too.
SAME_ATTITUDE = 0.01  # [rad]
SAME_LEVER_ARM = 0.01  # [m]
# A coarse attitude is one whose heading deserves the name.
COARSE_SIGMA = math.radians(20.0)
# These stand for sensors that claim to have no noise.
LEAST_GYRO_NOISE = 1e-11  # [rad/sqrt(s)]
LEAST_ACCEL_NOISE = 1e-7  # [m/s/sqrt(s)]
LEAST_POSITION_NOISE = 1e-6  # [m]
# Gravity against the model's, 1 sigma of the ratio: three kilometres of height that nobody
# gave, or the scale of three accelerometers. The data find it in seconds; heading and level
# lose nothing.
GRAVITY_SIGMA = 1e-3


class Backtracking:
    """Filter and solution.

    epochs : all so far
    filter : with its sums; noise : its densities
    about : what it is linearised about, and
    solution : of the sums; both None before there is an attitude
    lever : directions of the lever arm that the motion tells

    Parameters
    ----------
    config : the settings
    gravity : the model's
    """

    def __init__(self, config: SwingConfig, gravity: GravityModel) -> None:
        grade = config.grade
        self._passes = config.passes
        self._gravity = gravity
        self.noise = NoiseModel(
            gyro=max(grade.gyro_arw, LEAST_GYRO_NOISE),
            accel=max(grade.accel_vrw, LEAST_ACCEL_NOISE),
            drift=grade.gyro_bias_instability,
            drift_time_s=grade.gyro_bias_correlation_s,
            position=max(config.position_noise, LEAST_POSITION_NOISE),
            walk=config.position_walk,
            calibration=max(grade.gyro_scale, grade.accel_scale, grade.misalignment) > 0.0,
        )
        self._prior = make_prior(
            config.lever_arm_prior,
            config.lever_arm_prior_sigma,
            grade,
            GRAVITY_SIGMA,
            self.noise.calibration,
        )
        self._excitation = LeverExcitation(self.noise.gyro)
        self.lever = self._excitation.directions()
        self.epochs = Epochs()
        self.filter = TwoStageFilter(self.noise)
        self.about: Linearisation | None = None
        self.solution: Solution | None = None

    def append(self, windows: Windows) -> None:
        """Take in new epochs, for the next `advance` or `refresh`."""
        self.epochs.append(windows)
        self._excitation.update(self.epochs)
        self.lever = self._excitation.directions()

    def advance(self) -> None:
        """Filter the epochs that are new and solve, from the last solution on."""
        if self.solution is not None:
            self._filter_new()
            self.solution = self._solve(self.solution)

    def refresh(self) -> None:
        """Run over the stored increments again until the attitude stays."""
        if self.solution is None or not self.is_coarse:
            self._start()
        elif self._is_linearised_about(self.solution):
            self.advance()
            return
        for _ in range(self._passes):
            before = self.solution
            if before is None:
                return
            self.about = Linearisation(before.R, before.x[X_R])
            self.filter = TwoStageFilter(self.noise, self.filter.noise.again())
            self._filter_new()
            self.solution = self._solve(before)
            moved = log_rotation(self.solution.R @ before.R.T)
            sigma = np.sqrt(self.solution.covariance.diagonal()[KAPPA])
            if (np.abs(moved) < 0.01 * sigma).all() and not self.filter.noise.has_grown:
                return

    def _is_linearised_about(self, solution: Solution) -> bool:
        """Whether another run over the increments would change nothing worth it.

        Position noise that grew, grew with the solution of its time: a run with today's may
        find that it need not have.
        """
        if self.about is None or self.filter.noise.has_grown:
            return False
        moved = log_rotation(solution.R @ self.about.R.T)
        lever = solution.x[X_R] - self.about.r_b
        return bool(np.abs(moved).max() < SAME_ATTITUDE and np.abs(lever).max() < SAME_LEVER_ARM)

    def _start(self) -> None:
        """Attitude from nothing: the model's force is minus the mean measured one."""
        up = self.epochs.u.sum(axis=0)
        up /= np.linalg.norm(up)
        level = level_axes(up)
        self.about = Linearisation(level, np.zeros(3))
        self.filter = TwoStageFilter(self.noise)
        self.solution = None
        self._filter_new()
        R = start_attitude(self.filter.normal, self._prior)
        if R is not None:
            nothing = np.zeros((self._prior.mean.shape[0],) * 2)
            first = Solution(R, self._prior.mean, nothing)
            solver, normal = self.solver, self.filter.normal
            self.solution = least_mode(solver, normal, solver.solve(normal, first))

    def _solve(self, start: Solution) -> Solution:
        """Of the sums, from `start` on."""
        solver, normal = self.solver, self.filter.normal
        solution = solver.solve(normal, start)
        return solution if is_settled(solution) else least_mode(solver, normal, solution)

    def _filter_new(self) -> None:
        """Let the filter take in the epochs that it has not."""
        assert self.about is not None
        first, solution = len(self.filter.variances), self.solution
        steps = build_steps(self.epochs, first, self.about, self._gravity, self.noise)
        if solution is None:
            self.filter.run(steps, None)
        elif first == 0:  # again: the solution knows these epochs
            self.filter.run(steps, solution.theta)
        else:
            J = solution.jacobian
            self.filter.run(steps, solution.theta, J @ solution.covariance @ J.T)

    @property
    def solver(self) -> Solver:
        """For the sums as they are now."""
        return Solver(self._prior, self.lever, self.about.R if self.about else None)

    @property
    def is_coarse(self) -> bool:
        """Whether heading is known well enough to be spoken of."""
        return self.solution is not None and heading_variance(self.solution) < COARSE_SIGMA**2

    @property
    def is_alone(self) -> bool:
        """Whether no heading far from the solution's fits the data too."""
        if self.solution is None:
            return False
        return is_alone(self.solver, self.filter.normal, self.solution)

    @property
    def lever_sigma(self) -> float:
        """1 sigma of the lever arm where it is known worst of all directions with motion [m]."""
        assert self.solution is not None
        if self.lever.considered.shape[1]:
            return math.sqrt(float(self._prior.variance[X_R].max()))
        P = self.lever.free.T @ self.solution.covariance[X_R, X_R] @ self.lever.free
        return math.sqrt(float(np.linalg.eigvalsh(P).max(initial=0.0)))

    def heading_sigma(self, filter_: TwoStageFilter) -> float:
        """1 sigma of heading with the information of `filter_` [rad]."""
        solution = self.solution
        assert solution is not None
        covariance = self.solver.covariance(filter_.normal, solution)
        up = solution.R[:, 2]
        P = phi_covariance(filter_, solution.jacobian, covariance)
        return math.sqrt(float(up @ P @ up))
