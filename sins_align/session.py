"""The one code path: live node and replay both feed a `Session`.

It orders samples by header stamp, refuses what cannot be used, cuts the stream into blocks
on a grid of stamps and hands whole blocks to the aligner. Nothing here depends on how many
samples come in one call, so that the same samples give bit-identical results however they
were handed over.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sins_align.aligners import make_aligners, make_completer
from sins_align.config import Completion, OdoConfig, SwingConfig
from sins_align.data_watch import DataWatch
from sins_align.intake import Intake
from sins_align.odo.odometer_intake import OdometerIntake
from sins_align.prediction import predict_completion
from sins_align.protocols import AidedAligner, Aligner
from sins_align.reasons import ESTIMATE_BROKE, STORED_DROPPED, VEHICLE_MOVES, Finding
from sins_align.soundness import check_arrays, check_odometer_arrays, check_position, is_sound
from sins_align.status import waiting_findings
from sins_align.types import (
    Advance,
    Estimate,
    ImuBlock,
    ImuSamples,
    InputCounts,
    OdometerSamples,
    Position,
    State,
    Status,
    Update,
)

HAD_MOVED = "the vehicle had moved"
ANEW = "the alignment began anew: {why}"


class Session:
    """An alignment from the first sample on.

    Parameters
    ----------
    config : the settings; where `config.position` is None, samples are counted but not
        used until `set_position`
    """

    def __init__(self, config: SwingConfig | OdoConfig) -> None:
        self._config = config
        self._position = config.position
        self._counts = InputCounts()
        self._odometer_intake = OdometerIntake(self._counts)
        self._restarts = self._failures = 0
        self._initial = config.initial
        self._forgotten: tuple[Finding, ...] = ()  # what is said of it once it is dropped here
        self._begin("")

    def _begin(self, reason: str, at_ns: int | None = None) -> None:
        """Begin anew, with the IMU at `at_ns`; None: where it is."""
        self._make_aligner(at_ns)
        self._intake = Intake(self._counts)
        self._completer = make_completer(self._config, self._position)
        self._watch = DataWatch(self._config)
        self._begin_reason, self._moves = reason, False
        self._begun_s = 0.0  # when, of the time since the first sample
        self._counted = (self._counts.imu_samples, self._counts.imu_rejected)
        self._status: Status | None = None

    def _make_aligner(self, at_ns: int | None = None) -> None:
        self._aligner: Aligner | None = None
        self._aided: AidedAligner | None = None
        if self._position is None:
            return
        self._aligner, self._aided = make_aligners(self._config, self._position, self._initial)
        if self._aided is not None:
            waiting = self._odometer_intake.useful(at_ns)
            if len(waiting):
                self._aided.aid(waiting)

    @property
    def config(self) -> SwingConfig | OdoConfig:
        """The settings."""
        return self._config

    @property
    def position(self) -> Position | None:
        """Position in use, None before one is known."""
        return self._position

    @property
    def counts(self) -> InputCounts:
        """What came in and what was refused, restarts included."""
        return self._counts

    @property
    def restarts(self) -> int:
        """How often the alignment began anew, by `restart` or after a gap."""
        return self._restarts

    @property
    def beginnings(self) -> int:
        """As `restarts`, with those after a fault of the data or of the estimate."""
        return self._restarts + self._failures

    @property
    def begin_reason(self) -> str:
        """Why the alignment began anew, empty at the first start."""
        return self._begin_reason

    @property
    def status(self) -> Status:
        """As of the last whole block."""
        if self._status is not None:
            return self._status
        accepted = self._counts.imu_samples - self._counted[0]
        rejected = self._counts.imu_rejected - self._counted[1]
        has_position = self._position is not None
        waiting = waiting_findings(has_position, accepted, rejected, self._begin_reason)
        return Status(State.WAITING, (*waiting, *self._forgotten))

    @property
    def imu_rate_hz(self) -> float | None:
        """Nominal rate of the IMU, None before it is known."""
        interval = self._intake.interval_s
        return None if interval is None else 1.0 / interval

    def set_position(self, position: Position) -> None:
        """Take the position of a fix. The first one counts; later ones change nothing.

        Raises
        ------
        ValueError : not a position on the Earth
        """
        check_position(position)
        if self._position is None:
            self._position = position
            self._begin(self._begin_reason)

    def set_completion(self, completion: Completion, latitude_check: str | None = None) -> None:
        """Other thresholds, from the next block on; everything else goes on as it was.

        latitude_check : 'warn', 'fail' or 'off'; None: as before
        """
        check = latitude_check or self._config.latitude_check
        self._config = replace(self._config, completion=completion, latitude_check=check)
        self._completer.set_completion(completion, check)

    def restart(self, reason: str = "restarted on request") -> None:
        """Forget everything but the counts and the position, and start again."""
        self._restart(reason)

    def _restart(self, reason: str, at_ns: int | None = None) -> None:
        self._restarts += 1
        self._forget_stored(reason)
        self._begin(reason, at_ns)

    def _forget_stored(self, why: str) -> None:
        """Nobody has seen whether the base has moved meanwhile; to be said until an estimate is."""
        if self._initial is not None:
            self._initial = None
            self._forgotten = (STORED_DROPPED(why=ANEW.format(why=why)),)

    def add_imu(self, samples: ImuSamples) -> list[Update]:
        """Take in samples in the order of their arrival; one update for every block filled.

        Samples that are refused are counted in `counts` and change nothing else.

        Raises
        ------
        ValueError : arrays of another shape or type than `ImuSamples` says
        """
        check_arrays(samples)
        updates: list[Update] = []
        self._intake.add(samples)
        while True:
            block = self._intake.next_block()
            if block is not None:
                self._odometer_intake.imu_ns = int(block.stamp_ns[-1])
                if self._aligner is not None:
                    updates += self._take_in(block)
                continue
            if not self._intake.break_reason:
                return updates
            # The attitude chain is cut: what the base did meanwhile nobody knows.
            rest = self._intake.take_after_break()
            self._restart(self._intake.break_reason, int(rest.stamp_ns[0]))
            self._intake.add_usable(rest)

    def add_odometer(self, samples: OdometerSamples) -> list[Update]:
        """Take in samples of the odometer, which may be ahead of the IMU or behind it.

        One update for every epoch that waited for them. Samples that are refused are counted
        in `counts.odom_rejected` and change nothing else.

        Raises
        ------
        ValueError : arrays of another shape or type than `OdometerSamples` says
        """
        check_odometer_arrays(samples)
        accepted = self._odometer_intake.add(samples)
        aided = self._aided
        if aided is None or not len(accepted):
            return []
        return self._step(lambda: aided.aid(accepted))

    def _take_in(self, block: ImuBlock) -> list[Update]:
        """What the block led to; nothing while it only waits for what comes later."""
        aligner = self._aligner
        assert aligner is not None
        fault = self._watch.update(block)
        if fault is not None:
            return self._fail(int(block.stamp_ns[-1]), fault)
        return self._step(lambda: aligner.update(block))

    def _step(self, work: Callable[[], list[Advance]]) -> list[Update]:
        assert self._position is not None
        try:
            steps = work()
        except np.linalg.LinAlgError as error:
            # Of the last block, not of the last sample: how many came in one call says nothing.
            stamp_ns = self._odometer_intake.imu_ns
            return self._fail(0 if stamp_ns is None else stamp_ns, ESTIMATE_BROKE(cause=error))
        updates: list[Update] = []
        for step in steps:
            if step.estimate is not None and not is_sound(step.estimate):
                broke = ESTIMATE_BROKE(cause="it is not finite")
                return [*updates, *self._fail(step.stamp_ns, broke)]
            elapsed = self._intake.elapsed_s(step.stamp_ns)
            self._note_motion(step, elapsed)
            if step.estimate is not None:
                self._forgotten = ()
            more = (*self._watch.findings(step.stamp_ns), *self._forgotten)
            step = step._replace(findings=(*step.findings, *more))
            self._status = self._completer.update(step, elapsed, self._begin_reason, self._begun_s)
            updates.append(Update(step.stamp_ns, step.estimate, self._status))
        return updates

    def _note_motion(self, step: Advance, elapsed_s: float) -> None:
        """Count the start after a drive: the aligner has begun anew by itself."""
        moves = any(f.reason is VEHICLE_MOVES for f in step.findings)
        if self._moves and not moves:
            self._restarts += 1
            self._begin_reason = HAD_MOVED
        if moves:
            self._begun_s = elapsed_s
        self._moves = moves

    def _fail(self, stamp_ns: int, fault: Finding) -> list[Update]:
        """The block is of no use; the alignment begins anew with the first one that is."""
        self._begun_s = elapsed = self._intake.elapsed_s(stamp_ns)
        self._failures += 1
        self._forget_stored(fault.text)
        self._make_aligner(stamp_ns)
        self._completer = make_completer(self._config, self._position)
        self._status = Status(State.FAILED, (fault, *self._forgotten), elapsed)
        return [Update(stamp_ns, None, self._status)]

    @property
    def estimate(self) -> Estimate | None:
        """At the last sample taken in, None before the coarse attitude exists.

        Cheap: the last update's, carried on by the gyros. A pure function of the samples so
        far: asking, or not, changes nothing.
        """
        block = self._intake.pending_block()
        if block is None or self._aligner is None:
            return None
        return self._aligner.propagate(block)

    @property
    def eta_s(self) -> float:
        """Predicted time until aligned [s]; see `predict_completion`.

        NaN before the first step of an aligner. A pure function of the samples so far; some
        milliseconds of work.
        """
        if self._aligner is None or self._status is None:
            return math.nan
        held_s = self._completer.held_s(self._status.elapsed_s)
        return predict_completion(self._aligner, self._status, self._config.completion, held_s)

    @property
    def conclusion(self) -> Estimate | None:
        """As `estimate`, but with everything made of every sample: for a result.

        A pure function of the samples so far, too.
        """
        block = self._intake.pending_block()
        if block is None or self._aligner is None:
            return None
        try:
            estimate = self._aligner.conclude(block)
        except np.linalg.LinAlgError:
            return None
        return estimate if estimate is not None and is_sound(estimate) else None
