"""Alignment on a swinging base in inertial axes: from any attitude, no coarse alignment.

The two-stage filter (`two_stage`) turns the increments into sums, `solution` the sums into
attitude, lever arm and biases. This module decides when which of them runs:

- at the end of every cycle, which grow from 1 s to 15 s, the blocks since the last one are
  integrated, the filter takes them in and the sums are solved, from the last solution on;
- at the refresh times the filter runs over all stored increments again (backtracking),
  linearised about the solution found so far, until the attitude stays within 1 % of its
  sigma, but `passes` times at most.

Between two ends of cycles the attitude is carried by the gyros.
"""

from __future__ import annotations

import math
from copy import deepcopy

import numpy as np

from sins_align.config import SwingConfig
from sins_align.earth import EARTH_RATE, earth_rate_n, normal_gravity
from sins_align.increments import integrate_rotation, integrate_windows, join_blocks
from sins_align.reasons import CENTRE_MOVES, HEADING_COARSE, LEVELLING, SWING_WEAK, Finding
from sins_align.rotation import (
    dcm_from_quaternion,
    level_axes,
    log_rotation,
    multiply_quaternions,
)
from sins_align.swing.checks import Checks
from sins_align.swing.epochs import Epochs
from sins_align.swing.excitation import LeverExcitation
from sins_align.swing.foresight import time_to
from sins_align.swing.loudness import Loudness
from sins_align.swing.outcome import C_nb0_at, Outcome, heading_variance, phi_covariance
from sins_align.swing.solution import (
    KAPPA,
    X_R,
    Solution,
    Solver,
    make_prior,
    start_attitude,
)
from sins_align.swing.two_stage import (
    GravityModel,
    Linearisation,
    NoiseModel,
    TwoStageFilter,
    build_steps,
)
from sins_align.types import Advance, Array, Estimate, ImuBlock, Position

EPOCH_S = 0.5
# Times at which the stored increments are run over again [s]; then every three times later.
REFRESH_S = (5.0, 10.0, 20.0, 30.0)
REFRESH_FACTOR = 3.0
CYCLE_SHARE = 0.15  # of the time since the start
MAX_CYCLE_S = 15.0
# Half a block: their ends fall on stamps, not on the grid itself.
GRACE_S = 0.5
# The noise model needs no new linearisation where the attitude has moved by less, and the
# lever arm too.
SAME_ATTITUDE = 0.01  # [rad]
SAME_LEVER_ARM = 0.01  # [m]
# A coarse attitude is one whose heading deserves the name.
COARSE_SIGMA = math.radians(20.0)
# A centre that moves by so many times what is declared is worth telling.
RESTLESS = 5.0
# These stand for sensors that claim to have no noise.
LEAST_GYRO_NOISE = 1e-11  # [rad/sqrt(s)]
LEAST_ACCEL_NOISE = 1e-7  # [m/s/sqrt(s)]
LEAST_POSITION_NOISE = 1e-6  # [m]
# Gravity against the model's, 1 sigma of the ratio: three kilometres of height that nobody
# gave, or the scale of three accelerometers. The data find it in seconds; heading and level
# lose nothing.
GRAVITY_SIGMA = 1e-3


class InertialAligner:
    """The default method; fulfils `Aligner`.

    Parameters
    ----------
    config : the settings
    position : latitude and altitude give Earth rate and gravity
    """

    def __init__(self, config: SwingConfig, position: Position) -> None:
        grade = config.grade
        self._config = config
        self._gravity = GravityModel(
            normal_gravity(position.latitude, position.altitude), position.latitude, EARTH_RATE
        )
        self._earth_rate_n = earth_rate_n(position.latitude)
        self._noise = NoiseModel(
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
            self._noise.calibration,
        )
        self._excitation = LeverExcitation(self._noise.gyro, self._noise.position)
        self._lever = self._excitation.directions()
        self._epochs = Epochs()
        self._checks = Checks(self._gravity, self._noise)
        self._loudness = Loudness(self._noise)
        self._filter = TwoStageFilter(self._noise)
        self._filtered = 0  # epochs that the filter has taken in
        self._about: Linearisation | None = None
        self._solution: Solution | None = None
        self._outcome: Outcome | None = None
        self._estimate: Estimate | None = None
        self._blocks: list[ImuBlock] = []  # since the last cycle
        self._turned: list[Array] = []  # and the rotation over each, where asked for
        self._first_ns: int | None = None
        self._stamp_ns = 0  # end of the last cycle
        self._next_refresh_s = REFRESH_S[0]
        self._next_cycle_s = 0.0

    def update(self, block: ImuBlock) -> list[Advance]:
        """Take in the next block of samples; one step at the end of a cycle."""
        self._blocks.append(block)
        if self._first_ns is None:
            self._first_ns = int(block.stamp_ns[0])
        now = int(block.stamp_ns[-1] - self._first_ns) * 1e-9
        if now > self._next_cycle_s - GRACE_S:
            self._next_cycle_s = now + _cycle_s(now)
            self._end_cycle(now)
        elif self._estimate is not None:
            return []
        return [Advance(int(block.stamp_ns[-1]), self._estimate, self._findings(now))]

    def _findings(self, now: float) -> tuple[Finding, ...]:
        """Why there is no estimate yet, or why its sigma is as large as it is."""
        if self._solution is None:
            return (LEVELLING(elapsed_s=now),)
        findings = []
        if self._estimate is None:
            sigma = math.degrees(min(math.sqrt(heading_variance(self._solution)), math.pi))
            bound = math.degrees(COARSE_SIGMA)
            findings.append(HEADING_COARSE(sigma=f"sigma {sigma:.0f} deg, not below {bound:.0f}"))
        noise = self._filter.noise
        moved, declared = math.sqrt(noise.variance), math.sqrt(noise.floor)
        if moved > RESTLESS * declared:
            findings.append(CENTRE_MOVES(moved_mm=1e3 * moved, declared_mm=1e3 * declared))
        if self._lever.considered.shape[1] and self._config.lever_arm_prior_sigma > 0.0:
            findings.append(SWING_WEAK())
        return (*findings, *self._loudness.findings)

    def conclude(self, block: ImuBlock) -> Estimate | None:
        """The estimate from all samples to the end of `block`; changes nothing.

        What `estimate` will be at the end of a cycle, had it ended there.
        """
        other = deepcopy(self)
        if block.stamp_ns.shape[0] > 1:
            other._blocks.append(block)
        if not other._blocks or len(other._epochs) == 0:
            return self._estimate
        other._end_cycle(int(block.stamp_ns[-1] - (self._first_ns or 0)) * 1e-9)
        return other._estimate

    def _end_cycle(self, now: float) -> None:
        whole = join_blocks(self._blocks)
        self._blocks, self._turned = [], []
        self._stamp_ns = int(whole.stamp_ns[-1])
        duration = int(whole.stamp_ns[-1] - whole.stamp_ns[0]) * 1e-9
        count = max(1, round(duration / EPOCH_S))
        self._epochs.append(integrate_windows(whole, self._config.sampling, count))
        self._checks.update(self._epochs)
        self._excitation.update(self._epochs)
        self._lever = self._excitation.directions()
        if now > self._next_refresh_s - GRACE_S:
            later = [t for t in REFRESH_S if t > now + GRACE_S]
            self._next_refresh_s = later[0] if later else now * REFRESH_FACTOR
            self._refresh()
        elif self._solution is not None:
            self._advance()
            self._solution = self._solver().solve(self._filter.normal, self._solution)
        if self._solution is not None and self._about is not None:
            self._checks.note(self._solution, now)
            self._loudness.update(self._filter, self._epochs, self._about, self._gravity)
            self._loudness.compare(self._filter, self._solver(), self._solution)
        self._outcome = self._outcome_now()
        self._estimate = None
        if self._outcome is not None:
            self._estimate = self._outcome.estimate(self._stamp_ns, self._epochs.C[-1], 0.0)

    @property
    def estimate(self) -> Estimate | None:
        """At the end of the last cycle; None before the coarse attitude exists."""
        return self._estimate

    def foresee(self, heading: float) -> float:
        """See `Aligner`."""
        if self._estimate is not None and self._estimate.sigma[2] < heading:
            return 0.0
        if self._solution is None or self._about is None:
            return math.nan
        ahead_s = time_to(
            heading, self._filter, self._epochs, self._about, self._gravity, self._noise,
            self._heading_sigma,
        )  # fmt: skip
        return max(ahead_s - self._since_cycle_s, 0.0)

    def next_step(self, ahead_s: float) -> float:
        """See `Aligner`: an estimate is made at the end of a cycle."""
        now_s = float(self._epochs.time_s[-1]) + self._since_cycle_s
        end_s = _cycle_end(self._next_cycle_s)
        while end_s < now_s + ahead_s - 1e-6 < math.inf:
            end_s = _cycle_end(end_s + _cycle_s(end_s))
        return max(ahead_s, end_s - now_s)

    @property
    def _since_cycle_s(self) -> float:
        """Time of the blocks that wait for the end of the cycle [s]."""
        return sum(int(b.stamp_ns[-1] - b.stamp_ns[0]) for b in self._blocks) * 1e-9

    def propagate(self, block: ImuBlock) -> Estimate | None:
        """`estimate` carried to the end of `block` by the gyros; changes nothing seen outside.

        The rotation over whole blocks is kept, but it does not depend on who asks when.
        """
        if self._outcome is None:
            return None
        sampling = self._config.sampling
        for passed in self._blocks[len(self._turned) :]:
            self._turned.append(integrate_rotation(passed, sampling))
        q = self._epochs.q
        for turned in (*self._turned, integrate_rotation(block, sampling)):
            q = multiply_quaternions(q, turned)
        stamp_ns = int(block.stamp_ns[-1])
        C_b0b = dcm_from_quaternion(q / np.linalg.norm(q))
        return self._outcome.estimate(stamp_ns, C_b0b, (stamp_ns - self._stamp_ns) * 1e-9)

    def _refresh(self) -> None:
        """Run over the stored increments again until the attitude stays."""
        if self._solution is None or not self._is_coarse(self._solution):
            self._start()
        elif self._is_linearised_about(self._solution):
            self._advance()
            self._solution = self._solver().solve(self._filter.normal, self._solution)
            return
        for _ in range(self._config.passes):
            before = self._solution
            if before is None:
                return
            self._about = Linearisation(before.R, before.x[X_R])
            self._filter = TwoStageFilter(self._noise, self._filter.noise.again())
            self._filtered = 0
            self._advance()
            self._solution = self._solver().solve(self._filter.normal, before)
            moved = log_rotation(self._solution.R @ before.R.T)
            sigma = np.sqrt(self._solution.covariance.diagonal()[KAPPA])
            if (np.abs(moved) < 0.01 * sigma).all() and not self._filter.noise.has_grown:
                return

    def _is_linearised_about(self, solution: Solution) -> bool:
        """Whether another run over the increments would change nothing worth it.

        Position noise that grew, grew with the solution of its time: a run with today's may
        find that it need not have.
        """
        if self._about is None or self._filter.noise.has_grown:
            return False
        moved = log_rotation(solution.R @ self._about.R.T)
        lever = solution.x[X_R] - self._about.r_b
        return bool(np.abs(moved).max() < SAME_ATTITUDE and np.abs(lever).max() < SAME_LEVER_ARM)

    def _start(self) -> None:
        """Attitude from nothing: the model's force is minus the mean measured one."""
        up = self._epochs.u.sum(axis=0)
        up /= np.linalg.norm(up)
        level = level_axes(up)
        self._about = Linearisation(level, np.zeros(3))
        self._filter, self._filtered = TwoStageFilter(self._noise), 0
        self._solution = None
        self._advance()
        R = start_attitude(self._filter.normal, self._prior)
        if R is not None:
            nothing = np.zeros((self._prior.mean.shape[0],) * 2)
            first = Solution(R, self._prior.mean, nothing)
            self._solution = self._solver().solve(self._filter.normal, first)

    def _advance(self) -> None:
        """Let the filter take in the epochs that it has not."""
        assert self._about is not None
        steps = build_steps(self._epochs, self._filtered, self._about, self._gravity, self._noise)
        solution = self._solution
        if solution is None:
            self._filter.run(steps, None)
        elif self._filtered == 0:  # again: the solution knows these epochs
            self._filter.run(steps, solution.theta)
        else:
            J = solution.jacobian
            self._filter.run(steps, solution.theta, J @ solution.covariance @ J.T)
        self._filtered = len(self._epochs)

    def _solver(self) -> Solver:
        return Solver(self._prior, self._lever, self._about.R if self._about else None)

    def _is_coarse(self, solution: Solution) -> bool:
        """Whether heading is known well enough to be spoken of."""
        return heading_variance(solution) < COARSE_SIGMA**2

    def _heading_sigma(self, filter_: TwoStageFilter) -> float:
        """1 sigma of heading with the information of `filter_` [rad]."""
        solution = self._solution
        assert solution is not None
        covariance = self._solver().covariance(filter_.normal, solution)
        up = solution.R[:, 2]
        P = phi_covariance(filter_, solution.jacobian, covariance)
        return math.sqrt(float(up @ P @ up))

    def _outcome_now(self) -> Outcome | None:
        solution = self._solution
        if solution is None or not self._is_coarse(solution):
            return None
        time_s = float(self._epochs.time_s[-1])
        report = self._checks.report(
            solution, self._solver(), self._filter, self._epochs,
            self._heading_sigma(self._filter) ** 2,
            C_nb0_at(time_s, self._earth_rate_n, solution),
        )  # fmt: skip
        return Outcome(
            solution, self._filter, self._noise, report, self._lever,
            self._config.lever_arm_prior_sigma, self._earth_rate_n, time_s,
        )  # fmt: skip


def _cycle_s(now: float) -> float:
    """Length of the cycle that begins so long after the start [s]."""
    return min(max(1.0, CYCLE_SHARE * now), MAX_CYCLE_S)


def _cycle_end(due_s: float) -> float:
    """When a cycle ends that is due then: with a block, which is a second [s]."""
    return math.floor(due_s - GRACE_S) + 1.0
