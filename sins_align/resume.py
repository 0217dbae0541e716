"""Going on from a stored alignment until a new one is better.

The aligner proper gets every sample from the first one on, as if nothing had been stored. For
the first `CHECK_S` the stored alignment is checked (`stored_check`); if it fits, its attitude,
carried on by the gyros (`carried`), is what is given out until the aligner proper knows heading
better. Where a sway hides the Earth's rate from the check, the aligner proper has to agree first,
once it knows heading to `HEADING_SIGMA`.

The two are never fused: heading error and gyro bias are one error, delta psi = b_E / (Omega cos L),
which both alignments share, and fusing them as independent would claim sigma / sqrt(2) for
nothing. While both are there they have to agree, so that a turn that the check was too short to
see is found as soon as the aligner proper sees it.

What has been dropped is dropped for good.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sins_align.carried import Carried, Carrier, begin, carry, misalignment_covariance, spread
from sins_align.config import OdoConfig, SwingConfig
from sins_align.consistency import MAX_CONSISTENCY
from sins_align.earth import earth_rate_n
from sins_align.protocols import Aligner
from sins_align.reasons import (
    GYRO_NOISY,
    LATITUDE_DOUBTED,
    STORED_CHECK,
    STORED_CONFIRM,
    STORED_DROPPED,
    VEHICLE_MOVES,
    Finding,
)
from sins_align.rotation import dcm_from_quaternion, log_rotation, quaternion_from_dcm
from sins_align.stored import StoredAlignment
from sins_align.stored_check import CHECK_S, CHI_SQUARE_LIMIT, HEADING_SIGMA, Passed, StoredCheck
from sins_align.types import Advance, Array, Estimate, ImuBlock, Position
from sins_align.units import ARCMIN

# A check that is through is settled by the next block [s].
SOON_S = 1.0
# Chi-square of 3 degrees of freedom with one false alarm in 1e5: it is asked again and again.
AGREEMENT_LIMIT = 25.90
# Doubts of the aligner proper on what a stored attitude hangs on too: the gyros, the Earth's rate.
SHARED_DOUBTS = (GYRO_NOISY, LATITUDE_DOUBTED)

CONTRADICTED = "the new one differs by {angle:.2g}' in heading (sigma {sigma:.2g}')"
MOVED = "the vehicle has moved"


class ResumingAligner:
    """An aligner that starts with a stored alignment; fulfils `Aligner`.

    Parameters
    ----------
    aligner : the aligner proper
    config : its settings
    position : latitude and altitude give Earth rate and gravity
    stored : what to go on from
    """

    def __init__(
        self,
        aligner: Aligner,
        config: SwingConfig | OdoConfig,
        position: Position,
        stored: StoredAlignment,
    ) -> None:
        self._aligner = aligner
        drives = isinstance(config, OdoConfig) and not config.stationary
        self._carrier = Carrier(config.grade, config.sampling, position, drives)
        self._check: StoredCheck | None = StoredCheck(
            stored, config.grade, config.sampling, config.completion, position.latitude
        )
        self._begin_ns: int | None = None  # of the check
        self._carried: Carried | None = None  # from the check on, while nothing is better
        self._is_confirmed = False  # and whether it is given out
        self._consistency = 0.0
        self._stamp_ns = 0  # where it stands; before, where the check ends
        self._blocks: list[ImuBlock] = []  # from there on
        self._dropped = ""  # why
        self._new: Estimate | None = None  # of the last step of the aligner proper
        self._findings: tuple[Finding, ...] = ()

    def update(self, block: ImuBlock) -> list[Advance]:
        """Take in the next block; a step for each while the stored attitude is given out."""
        self._keep(block)
        steps = self._aligner.update(block)
        if steps:
            return self._pass_on(steps)
        # It has seen the block all the same.
        stamp_ns = int(block.stamp_ns[-1])
        self._reach(stamp_ns)
        given = self._given
        return [] if given is None else [self._stored_step(given, stamp_ns)]

    @property
    def _given(self) -> Carried | None:
        """The stored attitude, where it is what is given out."""
        return self._carried if self._is_confirmed else None

    def _keep(self, block: ImuBlock) -> None:
        """For the check, or until the aligner proper has come so far."""
        if self._begin_ns is None:
            self._begin_ns = int(block.stamp_ns[0])
        if self._check is not None and self._check.elapsed_s < CHECK_S:
            self._check.add(block)
            self._stamp_ns = int(block.stamp_ns[-1])
        elif self._check is not None or self._carried is not None:
            self._blocks.append(block)

    def _pass_on(self, steps: list[Advance]) -> list[Advance]:
        """What is given out at those steps of the aligner proper.

        All that is decided is decided at their stamps, by what is known there: how far the IMU is
        ahead of what it waits for says nothing.
        """
        return [self._take(step) for step in steps]

    def _take(self, step: Advance) -> Advance:
        self._reach(step.stamp_ns)
        self._new, self._findings = step.estimate, step.findings
        if any(f.reason is VEHICLE_MOVES for f in step.findings):
            self._check, self._carried, self._dropped = None, None, MOVED
        elif self._carried is not None and step.estimate is not None:
            self._carried = self._weigh(self._carried, step.estimate)
        given = self._given
        return self._remark(step) if given is None else self._stored_step(given, step.stamp_ns)

    def _stored_step(self, given: Carried, stamp_ns: int) -> Advance:
        shared = tuple(f for f in self._findings if f.reason in SHARED_DOUBTS)
        return Advance(stamp_ns, self._given_out(given, stamp_ns), shared)

    def _reach(self, stamp_ns: int) -> None:
        """Settle what the check says, and carry the stored attitude, up to this sample."""
        check = self._check
        if check is not None and check.elapsed_s >= CHECK_S and stamp_ns >= self._stamp_ns:
            self._settle(check)
        if self._check is not None:
            return
        while self._carried is not None and self._blocks:
            block = self._blocks.pop(0)
            end = int(block.stamp_ns.searchsorted(stamp_ns, side="right"))
            if end > 1:
                self._carried = carry(self._carried, _cut(block, slice(None, end)), self._carrier)
                self._stamp_ns = int(block.stamp_ns[end - 1])
            if end < block.stamp_ns.shape[0]:
                self._blocks.insert(0, _cut(block, slice(max(end - 1, 0), None)))
                return
        self._blocks.clear()

    def _remark(self, step: Advance) -> Advance:
        """The step, with what is to be said of the stored alignment."""
        if self._check is not None:
            assert self._begin_ns is not None
            done = min((step.stamp_ns - self._begin_ns) * 1e-9, CHECK_S)
            finding = STORED_CHECK(elapsed_s=done, check_s=CHECK_S)
        elif self._carried is not None:
            finding = STORED_CONFIRM(sigma_deg=math.degrees(HEADING_SIGMA))
        elif self._dropped:
            finding = STORED_DROPPED(why=self._dropped)
        else:
            return step
        return step._replace(findings=(*step.findings, finding))

    def _settle(self, check: StoredCheck) -> None:
        """Take the stored alignment over, or drop it."""
        self._check = None
        verdict = self._doubt() or check.judge()
        if isinstance(verdict, str):
            self._dropped = verdict
            return
        self._carried, self._is_confirmed = self._begin(verdict), verdict.sees_heading
        # One number that has passed its test is not to fail another: 1 is where it ends.
        self._consistency = verdict.chi_square / CHI_SQUARE_LIMIT

    def _doubt(self) -> str:
        """Why the check need not be looked at; '' where it is to be. For what aids."""
        return ""

    def _begin(self, passed: Passed) -> Carried:
        """From the middle of the check to its end."""
        start = begin(passed.C_nb, passed.covariance, passed.gyro_bias)
        w_ie_n = earth_rate_n(self._carrier.position.latitude)
        lever = passed.C_nb * passed.half_s
        covariance = spread(start, w_ie_n, lever, passed.half_s, self._carrier.grade)
        return replace(start, covariance=covariance)

    def _weigh(self, carried: Carried, new: Estimate) -> Carried | None:
        """The stored alignment beside a new one; None if that contradicts it, or is better.

        What is itself in doubt says neither.
        """
        if self._is_doubted(new):
            return carried
        P = misalignment_covariance(carried, self._carrier)
        both = P + new.misalignment_covariance
        phi = log_rotation(dcm_from_quaternion(new.q_nb) @ carried.C_nb.T)
        square = float(phi @ np.linalg.solve(both, phi))
        if math.isnan(square):
            return carried
        if square > AGREEMENT_LIMIT:
            angle, sigma = abs(float(phi[2])) / ARCMIN, math.sqrt(both[2, 2]) / ARCMIN
            self._dropped = CONTRADICTED.format(angle=angle, sigma=sigma)
            return None
        variance = _heading_variance(new)
        if variance < P[2, 2]:
            return None
        self._is_confirmed = self._is_confirmed or variance < HEADING_SIGMA**2
        return carried

    def _is_doubted(self, new: Estimate) -> bool:
        """Whether the aligner proper is not to be believed, as of its last step.

        The consistency is NaN until the first innovation, which comes within seconds.
        """
        if any(f.reason.kind.forbids_claim for f in self._findings):
            return True
        return not new.consistency <= MAX_CONSISTENCY

    def _given_out(self, carried: Carried, stamp_ns: int) -> Estimate:
        """As an estimate; the accelerometers' bias is what is declared, nothing more is known.

        What only the aligner proper can know, lever arm or odometer, is its own.
        """
        new = self._new
        return Estimate(
            stamp_ns=stamp_ns,
            q_nb=quaternion_from_dcm(carried.C_nb),
            misalignment_covariance=misalignment_covariance(carried, self._carrier),
            gyro_bias=carried.gyro_bias,
            gyro_bias_sigma=np.sqrt(carried.covariance.diagonal()[3:]),
            accel_bias=np.zeros(3),
            accel_bias_sigma=np.full(3, self._carrier.grade.accel_bias),
            lever_arm=None if new is None else new.lever_arm,
            odometer=None if new is None else new.odometer,
            consistency=self._consistency,
        )

    @property
    def estimate(self) -> Estimate | None:
        """At the last step, where the stored attitude is given out; else see `Aligner`."""
        given = self._given
        return self._aligner.estimate if given is None else self._given_out(given, self._stamp_ns)

    def propagate(self, block: ImuBlock) -> Estimate | None:
        """`estimate` carried to the end of `block` by the gyros; changes nothing."""
        given = self._given
        if given is None:
            return self._aligner.propagate(block)
        ahead = given
        for part in (*self._blocks, block):
            ahead = carry(ahead, part, self._carrier)
        return self._given_out(ahead, int(block.stamp_ns[-1]))

    def foresee(self, heading: float) -> float:
        """See `Aligner`: by what is given out, will be if it fits, or by the aligner proper."""
        estimate = self.estimate
        if estimate is not None and estimate.sigma[2] < heading:
            return 0.0
        ahead_s, check = self._aligner.foresee(heading), self._check
        if check is None or not check.heading_sigma < heading:
            return ahead_s
        return float(np.fmin(ahead_s, max(CHECK_S - check.elapsed_s, SOON_S)))

    def next_step(self, ahead_s: float) -> float:
        """See `Aligner`: every block, or every step of the aligner proper, is one while the stored
        attitude is given out, or will be if it fits.
        """
        is_stored = self._given is not None or (self._check is not None and self._check.is_enough)
        return ahead_s if is_stored else self._aligner.next_step(ahead_s)

    def conclude(self, block: ImuBlock) -> Estimate | None:
        """The better of the stored attitude and all that the aligner proper knows."""
        new = self._aligner.conclude(block)
        old = None if self._given is None else self.propagate(block)
        if old is None:
            return new
        if new is None or self._is_doubted(new):
            return old
        return new if _heading_variance(new) < _heading_variance(old) else old


def _cut(block: ImuBlock, part: slice) -> ImuBlock:
    return ImuBlock(block.stamp_ns[part], block.w_ib_b[:, part], block.f_ib_b[:, part])


def _heading_variance(estimate: Estimate) -> float:
    P: Array = estimate.misalignment_covariance
    return float(P[2, 2])
