"""The one code path: live node and replay both feed a `Session`.

It orders samples by header stamp, refuses what cannot be used, cuts the stream into blocks
on a grid of stamps and hands whole blocks to the aligner. Nothing here depends on how many
samples come in one call, so that the same samples give bit-identical results however they
were handed over.
"""

from __future__ import annotations

from typing import NamedTuple

from sins_align.config import SwingConfig
from sins_align.intake import Intake
from sins_align.limits import heading_limit
from sins_align.status import Completer
from sins_align.swing import make_aligner
from sins_align.types import Estimate, ImuSamples, InputCounts, Position, State, Status

NO_POSITION = "no latitude"
NO_POSITION_REMEDY = "set latitude_deg, or publish a NavSatFix on topic fix"


class Update(NamedTuple):
    """What one block of samples led to."""

    stamp_ns: int
    estimate: Estimate | None
    status: Status


class Session:
    """An alignment from the first sample on.

    Parameters
    ----------
    config : the settings; where `config.position` is None, samples are counted but not
        used until `set_position`
    """

    def __init__(self, config: SwingConfig) -> None:
        self._config = config
        self._position = config.position
        self._counts = InputCounts()
        self._restarts = 0
        self._begin("")

    def _begin(self, reason: str) -> None:
        self._aligner = make_aligner(self._config, self._position) if self._position else None
        self._intake = Intake(self._counts)
        self._completer = Completer(self._config.completion)
        self._begin_reason = reason
        self._status = Status(State.WAITING, *self._waiting_reason())

    def _waiting_reason(self) -> tuple[str, str]:
        if self._position is None:
            return NO_POSITION, NO_POSITION_REMEDY
        return self._begin_reason or "no IMU data", ""

    @property
    def config(self) -> SwingConfig:
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
    def begin_reason(self) -> str:
        """Why the alignment began anew, empty at the first start."""
        return self._begin_reason

    @property
    def status(self) -> Status:
        """As of the last whole block."""
        return self._status

    @property
    def imu_rate_hz(self) -> float | None:
        """Nominal rate of the IMU, None before it is known."""
        interval = self._intake.interval_s
        return None if interval is None else 1.0 / interval

    def set_position(self, position: Position) -> None:
        """Take the position of a fix. The first one counts; later ones change nothing."""
        if self._position is None:
            self._position = position
            self._begin(self._begin_reason)

    def restart(self, reason: str = "restarted on request") -> None:
        """Forget everything but the counts and the position, and start again."""
        self._restarts += 1
        self._begin(reason)

    def add_imu(self, samples: ImuSamples) -> list[Update]:
        """Take in samples in the order of their arrival; one update for every block filled.

        Samples that are refused are counted in `counts` and change nothing else.
        """
        updates: list[Update] = []
        self._intake.add(samples)
        while True:
            block = self._intake.next_block()
            if block is not None:
                if self._aligner is not None:
                    self._aligner.update(block)
                    updates += self._conclude(int(block.stamp_ns[-1]))
                continue
            if self._intake.broken_s is None:
                return updates
            # The attitude chain is cut: what the base did meanwhile nobody knows.
            rest = self._intake.take_after_break()
            self.restart(f"{self._intake.broken_s:.1f} s without IMU data")
            self._intake.add(rest, counted=True)

    def _conclude(self, stamp_ns: int) -> list[Update]:
        """The block's update; none while the aligner's estimate is that of a block before."""
        assert self._aligner is not None and self._position is not None
        estimate = self._aligner.estimate
        if estimate is not None and estimate.stamp_ns != stamp_ns:
            return []
        elapsed = self._intake.elapsed_s(stamp_ns)
        limit = heading_limit(self._config.grade, self._position.latitude)
        self._status = self._completer.update(estimate, elapsed, limit, self._begin_reason)
        return [Update(stamp_ns, estimate, self._status)]

    @property
    def estimate(self) -> Estimate | None:
        """At the last sample taken in, None before the coarse attitude exists.

        A pure function of the samples so far: asking, or not, changes nothing.
        """
        block = self._intake.pending_block()
        if block is None or self._aligner is None:
            return None
        return self._aligner.propagate(block)
