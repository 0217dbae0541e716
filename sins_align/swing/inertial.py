"""Alignment on a swinging base in inertial axes: from any attitude, no coarse alignment.

The two-stage filter (`two_stage`) turns the increments into sums, `solution` the sums into
attitude, lever arm and biases, `backtracking` keeps both. This module decides when:

- at the end of every cycle, which grow from 1 s to 15 s, the blocks since the last one are
  integrated, the filter takes them in and the sums are solved, from the last solution on;
- at the refresh times the filter runs over all stored increments again.

Between two ends of cycles the attitude is carried by the gyros.
"""

from __future__ import annotations

import math
from copy import deepcopy

import numpy as np

from sins_align.config import SwingConfig
from sins_align.earth import EARTH_RATE, earth_rate_n, normal_gravity
from sins_align.increments import integrate_rotation, join_blocks
from sins_align.reasons import CENTRE_MOVES, HEADING_COARSE, LEVELLING, SWING_WEAK, Finding
from sins_align.rotation import dcm_from_quaternion, multiply_quaternions
from sins_align.swing.backtracking import COARSE_SIGMA, Backtracking
from sins_align.swing.checks import Checks
from sins_align.swing.foresight import time_to
from sins_align.swing.loudness import Loudness
from sins_align.swing.outcome import KNOWN_LEVER, C_nb0_at, Outcome, heading_variance
from sins_align.swing.two_stage import GravityModel
from sins_align.types import Advance, Array, Estimate, ImuBlock, Position
from sins_align.windows import integrate_windows

EPOCH_S = 0.5
# Times at which the stored increments are run over again [s]; then every three times later.
REFRESH_S = (5.0, 10.0, 20.0, 30.0)
REFRESH_FACTOR = 3.0
CYCLE_SHARE = 0.15  # of the time since the start
MAX_CYCLE_S = 15.0
# Half a block: their ends fall on stamps, not on the grid itself.
GRACE_S = 0.5
# Within the cycle that runs [s].
SOON_S = 0.1
# A centre that moves by so many times what is declared is worth telling.
RESTLESS = 5.0
# And so is a lever arm that is not known after a time in which a strong swing tells it [s].
STRONG_TELLS_S = 30.0


class InertialAligner:
    """The default method; fulfils `Aligner`.

    Parameters
    ----------
    config : the settings
    position : latitude and altitude give Earth rate and gravity
    """

    def __init__(self, config: SwingConfig, position: Position) -> None:
        self._config = config
        self._gravity = GravityModel(
            normal_gravity(position.latitude, position.altitude), position.latitude, EARTH_RATE
        )
        self._earth_rate_n = earth_rate_n(position.latitude)
        self._found = found = Backtracking(config, self._gravity)
        self._checks = Checks(self._gravity, found.noise, config.grade)
        self._loudness = Loudness(found.noise)
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
        found = self._found
        if found.solution is None:
            return (LEVELLING(elapsed_s=now),)
        findings: list[Finding] = []
        if self._estimate is None:
            sigma = math.degrees(min(math.sqrt(heading_variance(found.solution)), math.pi))
            bound = math.degrees(COARSE_SIGMA)
            why = f"sigma {sigma:.0f} deg, not below {bound:.0f}"
            if found.is_coarse:
                why = "another one, far off, fits the data too"
            findings.append(HEADING_COARSE(sigma=why))
        noise = found.filter.noise
        moved, declared = math.sqrt(noise.variance), math.sqrt(noise.floor)
        if moved > RESTLESS * declared:
            findings.append(CENTRE_MOVES(moved_mm=1e3 * moved, declared_mm=1e3 * declared))
        is_weak = now > STRONG_TELLS_S or found.lever.considered.shape[1] > 0
        if is_weak and found.lever_sigma > KNOWN_LEVER:
            findings.append(SWING_WEAK(sigma_m=found.lever_sigma))
        findings += self._loudness.findings
        if self._outcome is not None:
            findings += self._outcome.report.doubts
        return tuple(findings)

    def conclude(self, block: ImuBlock) -> Estimate | None:
        """The estimate from all samples to the end of `block`; changes nothing.

        What `estimate` will be at the end of a cycle, had it ended there.
        """
        other = deepcopy(self)
        if block.stamp_ns.shape[0] > 1:
            other._blocks.append(block)
        if not other._blocks or len(other._found.epochs) == 0:
            return self._estimate
        other._end_cycle(int(block.stamp_ns[-1] - (self._first_ns or 0)) * 1e-9)
        return other._estimate

    def _end_cycle(self, now: float) -> None:
        whole = join_blocks(self._blocks)
        self._blocks, self._turned = [], []
        self._stamp_ns = int(whole.stamp_ns[-1])
        duration = int(whole.stamp_ns[-1] - whole.stamp_ns[0]) * 1e-9
        count = max(1, round(duration / EPOCH_S))
        found = self._found
        found.append(integrate_windows(whole, self._config.sampling, count))
        self._checks.update(found.epochs)
        if now > self._next_refresh_s - GRACE_S:
            later = [t for t in REFRESH_S if t > now + GRACE_S]
            self._next_refresh_s = later[0] if later else now * REFRESH_FACTOR
            found.refresh()
        else:
            found.advance()
        if found.solution is not None and found.about is not None:
            self._checks.note(found.solution, now)
            self._loudness.update(found.filter, found.epochs, found.about, self._gravity)
            self._loudness.compare(
                found.filter, found.solver, found.solution, self._gravity.latitude
            )
        self._outcome = self._outcome_now()
        self._estimate = None
        if self._outcome is not None:
            self._estimate = self._outcome.estimate(self._stamp_ns, self._found.epochs.C[-1], 0.0)

    @property
    def estimate(self) -> Estimate | None:
        """At the end of the last cycle; None before the coarse attitude exists."""
        return self._estimate

    def foresee(self, heading: float) -> float:
        """See `Aligner`."""
        untold_s = 0.0
        if self._outcome is not None and self._config.latitude_check != "off":
            untold_s = self._outcome.report.untold_s
        ahead_s = max(self._heading_ahead_s(heading), untold_s) - self._since_cycle_s
        # What is not told yet will not be before the end of this cycle.
        return max(ahead_s, SOON_S if untold_s > 0.0 else 0.0)

    def _heading_ahead_s(self, heading: float) -> float:
        """From the end of the last cycle."""
        if self._estimate is not None and self._estimate.sigma[2] < heading:
            return 0.0
        found = self._found
        if found.solution is None or found.about is None:
            return math.nan
        return time_to(
            heading, found.filter, found.epochs, found.about, self._gravity, found.noise,
            found.heading_sigma,
        )  # fmt: skip

    def next_step(self, ahead_s: float) -> float:
        """See `Aligner`: an estimate is made at the end of a cycle."""
        now_s = float(self._found.epochs.time_s[-1]) + self._since_cycle_s
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
        q = self._found.epochs.q
        for turned in (*self._turned, integrate_rotation(block, sampling)):
            q = multiply_quaternions(q, turned)
        stamp_ns = int(block.stamp_ns[-1])
        C_b0b = dcm_from_quaternion(q / np.linalg.norm(q))
        return self._outcome.estimate(stamp_ns, C_b0b, (stamp_ns - self._stamp_ns) * 1e-9)

    def _outcome_now(self) -> Outcome | None:
        found = self._found
        solution = found.solution
        if solution is None or not (found.is_coarse and found.is_alone):
            return None
        time_s = float(found.epochs.time_s[-1])
        report = self._checks.report(
            solution, found.solver, found.filter, found.epochs,
            found.heading_sigma(found.filter) ** 2,
            C_nb0_at(time_s, self._earth_rate_n, solution),
        )  # fmt: skip
        return Outcome(
            solution, found.filter, found.noise, report, found.lever,
            self._config.lever_arm_prior_sigma, self._earth_rate_n, time_s,
        )  # fmt: skip


def _cycle_s(now: float) -> float:
    """Length of the cycle that begins so long after the start [s]."""
    return min(max(1.0, CYCLE_SHARE * now), MAX_CYCLE_S)


def _cycle_end(due_s: float) -> float:
    """When a cycle ends that is due then: with a block, which is a second [s]."""
    return math.floor(due_s - GRACE_S) + 1.0
