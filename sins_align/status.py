"""The state machine of both nodes: when the alignment is complete, and why it is not yet.

    waiting   something is missing: IMU, position, odometer, levels, or the base at rest
    coarse    the levels are known; heading is not, or no better than 2 deg
    fine      heading is known to 2 deg: from here on errors are small angles
    aligned   sigma below the thresholds, no doubts, and both for hold_s
    failed    nothing can be made of the data; or the latitude is wrong, with latitude_check: fail

Every state is entered and left for reasons of the table in `sins_align.reasons`. A state that has
been reached is left at a bound by `HYSTERESIS` wider than that at which it was entered.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from sins_align.config import Completion
from sins_align.consistency import Declared, find_doubts
from sins_align.grades import ImuGrade
from sins_align.limits import (
    HYSTERESIS,
    PATIENCE_S,
    heading_limit,
    is_navigation_grade,
    latitude_differs,
    level_limit,
)
from sins_align.reasons import (
    AT_POLE,
    BEGAN_ANEW,
    HEADING_COARSE,
    HEADING_LIMIT,
    HEADING_SIGMA,
    HOLDING,
    IMU_REFUSED,
    LATITUDE_DIFFERS,
    LATITUDE_DOUBTED,
    LATITUDE_UNPROVEN,
    LATITUDE_WRONG,
    LEVEL_LIMIT,
    LEVEL_SIGMA,
    LEVELLING,
    NO_IMU,
    NO_POSITION,
    UNOBSERVABLE_HERE,
    Finding,
    Kind,
)
from sins_align.types import Advance, Estimate, Position, State, Status
from sins_align.units import ARCMIN, ARCSEC, DEG, DEG_PER_H

# From here on the levels and heading are small-angle quantities.
FINE_HEADING_SIGMA = 0.035  # [rad], 2 deg


class Expectation(NamedTuple):
    """What an alignment is held against.

    grade, position : as declared; position None before it is known
    declared : estimates far beyond it are not believed
    latitude_check : 'warn', 'fail' or 'off'
    motion : what the operator can do for the heading to become observable
    """

    grade: ImuGrade
    position: Position | None = None
    declared: Declared = Declared()
    latitude_check: str = "off"
    motion: str = "turn the base by 90 deg or more"

    def heading_limit(self, time_s: float = math.inf) -> float:
        """See `limits.heading_limit`; NaN before the position is known."""
        if self.position is None:
            return math.nan
        return heading_limit(self.grade, self.position.latitude, time_s)


class Completer:
    """Watches an alignment step by step.

    Parameters
    ----------
    completion : thresholds and time to hold
    expectation : what the alignment is held against
    """

    def __init__(self, completion: Completion, expectation: Expectation) -> None:
        self.completion = completion
        self._expectation = expectation
        self._state = State.WAITING
        self._below_since_s: float | None = None
        self._aligned_at_s: float | None = None

    def set_completion(self, completion: Completion, latitude_check: str) -> None:
        """Other thresholds, from the next step on; for how long all was well stays known."""
        self.completion = completion
        self._expectation = self._expectation._replace(latitude_check=latitude_check)

    def update(
        self, step: Advance, elapsed_s: float, begin_reason: str = "", begun_s: float = 0.0
    ) -> Status:
        """Status after a step of the aligner.

        Parameters
        ----------
        step : what the aligner says
        elapsed_s : time from the first sample [s]
        begin_reason : why the alignment began anew, empty at the first start
        begun_s : and when [s]
        """
        estimate = step.estimate
        limit = self._expectation.heading_limit(elapsed_s - begun_s)
        if estimate is None:
            findings = self._without_estimate(step, elapsed_s)
            if begin_reason:
                findings = (*findings, BEGAN_ANEW(cause=begin_reason))
            return Status(self._state, findings, elapsed_s, None, limit)
        faults, objections, notes = self._judge(step, estimate)
        findings = (*faults, *objections, *notes)
        if faults or objections:
            self._forget()
            self._state = State.FAILED if faults else self._degree(estimate)
            return Status(self._state, findings, elapsed_s, None, limit)
        if self._below_since_s is None:
            self._below_since_s = elapsed_s
        held = elapsed_s - self._below_since_s
        if held < self.completion.hold_s:
            self._state, self._aligned_at_s = self._degree(estimate), None
            holding = HOLDING(held_s=held, hold_s=self.completion.hold_s)
            return Status(self._state, (holding, *findings), elapsed_s, None, limit)
        self._state = State.ALIGNED
        if self._aligned_at_s is None:
            self._aligned_at_s = elapsed_s
        return Status(self._state, findings, elapsed_s, self._aligned_at_s, limit)

    def _without_estimate(self, step: Advance, elapsed_s: float) -> tuple[Finding, ...]:
        """Take the state of a step without an estimate; what there is to be said of it."""
        self._forget()
        findings = tuple(f for f in step.findings if self._is_asked(f, False))
        self._state = _state_without_estimate(findings)
        if not findings:
            findings = (HEADING_COARSE(sigma=f"collecting data ({elapsed_s:.0f} s)"),)
        # Where heading is not looked for, no threshold and no turn would help.
        sought = not any(f.reason is UNOBSERVABLE_HERE for f in findings)
        if self._state is State.COARSE and sought:
            findings = (*findings, *(f for f in self._heading_limit() if f not in findings))
        return findings

    def _judge(
        self, step: Advance, estimate: Estimate
    ) -> tuple[list[Finding], list[Finding], list[Finding]]:
        """Faults, what else forbids the claim of being aligned, and what does not."""
        missing = self._missing(estimate)
        said = [f for f in step.findings if self._is_asked(f, True)]
        doubts = [
            f for f in said if f.reason.kind.forbids_claim or f.reason is LATITUDE_UNPROVEN
        ]  # fmt: skip
        notes = [f for f in said if f not in doubts]
        doubts += find_doubts(estimate, self._expectation.declared, self._widening)
        if not missing:
            notes = [f for f in notes if f.reason.kind is not Kind.HINT]
        notes += self._latitude(estimate)
        faults = [f for f in notes if f.reason.kind is Kind.FAULT]
        return faults, missing + doubts, [f for f in notes if f not in faults]

    def _forget(self) -> None:
        self._below_since_s = self._aligned_at_s = None

    def held_s(self, elapsed_s: float) -> float:
        """For how long everything has been as it should be [s]."""
        return 0.0 if self._below_since_s is None else elapsed_s - self._below_since_s

    @property
    def _widening(self) -> float:
        """Of the bounds, once they have been kept for hold_s."""
        return HYSTERESIS if self._state is State.ALIGNED else 1.0

    def _degree(self, estimate: Estimate) -> State:
        """Coarse or fine."""
        was_fine = self._state in (State.FINE, State.ALIGNED)
        bound = FINE_HEADING_SIGMA * (HYSTERESIS if was_fine else 1.0)
        fine = estimate.misalignment_covariance[2, 2] < bound**2
        return State.FINE if fine else State.COARSE

    def _missing(self, estimate: Estimate) -> list[Finding]:
        """What is not below its threshold; written so that NaN is not."""
        east, north, heading = estimate.sigma.tolist()
        completion, missing = self.completion, []
        if not heading < completion.heading_threshold * self._widening:
            missing.append(
                HEADING_SIGMA(
                    sigma=heading / ARCMIN, threshold=completion.heading_threshold / ARCMIN
                )
            )
            missing += self._heading_limit()
        level_threshold = completion.level_threshold * self._widening
        if not (east < level_threshold and north < level_threshold):
            level, threshold = max(east, north) / ARCSEC, completion.level_threshold / ARCSEC
            missing.append(LEVEL_SIGMA(sigma=level, threshold=threshold))
            limit = level_limit(self._expectation.grade)
            if not limit < completion.level_threshold:
                missing.append(LEVEL_LIMIT(threshold=threshold, limit=limit / ARCSEC))
        return missing

    def _heading_limit(self) -> list[Finding]:
        """Whether standing will ever do."""
        expectation, threshold = self._expectation, self.completion.heading_threshold
        limit = expectation.heading_limit(PATIENCE_S)
        if expectation.position is None or limit < threshold:
            return []
        if math.isnan(limit):
            return [AT_POLE()]
        grade = expectation.grade
        bias = math.hypot(grade.gyro_bias, grade.gyro_bias_instability) / DEG_PER_H
        return [
            HEADING_LIMIT(
                threshold=threshold / ARCMIN,
                bias_deg_h=round(bias, 4),
                limit=limit / ARCMIN,
                motion=expectation.motion,
            )
        ]

    def _is_asked(self, finding: Finding, has_estimate: bool) -> bool:
        """Whether latitude_check has it said."""
        if finding.reason not in (LATITUDE_UNPROVEN, LATITUDE_DOUBTED):
            return True
        check = self._expectation.latitude_check
        if check == "off" or not has_estimate or finding.reason is LATITUDE_UNPROVEN:
            return check != "off"
        return check == "fail" or is_navigation_grade(self._expectation.grade)

    def _latitude(self, estimate: Estimate) -> list[Finding]:
        """Whether the latitude given is that of the data."""
        expectation, own = self._expectation, estimate.latitude
        if own is None or expectation.position is None or expectation.latitude_check == "off":
            return []
        given = expectation.position.latitude
        if not latitude_differs(given, own):
            return []
        reason = LATITUDE_WRONG if expectation.latitude_check == "fail" else LATITUDE_DIFFERS
        found, sigma = own.latitude / DEG, own.sigma / DEG
        return [reason(given_deg=given / DEG, found_deg=found, sigma_deg=sigma)]


def _state_without_estimate(findings: tuple[Finding, ...]) -> State:
    kinds = {finding.reason.kind for finding in findings}
    if Kind.FAULT in kinds:
        return State.FAILED
    return State.WAITING if Kind.WAIT in kinds else State.COARSE


def waiting_findings(
    has_position: bool, accepted: int, rejected: int, begin_reason: str
) -> Iterator[Finding]:
    """What is to be said before the first step of an aligner.

    accepted, rejected : samples of the IMU since the alignment began
    begin_reason : why it began anew, empty at the first start
    """
    if not has_position:
        yield NO_POSITION()
    if rejected > accepted:
        yield IMU_REFUSED(refused=rejected, total=accepted + rejected)
    elif accepted == 0:
        yield NO_IMU()
    elif has_position:
        yield LEVELLING(elapsed_s=0.0)
    if begin_reason:
        yield BEGAN_ANEW(cause=begin_reason)
