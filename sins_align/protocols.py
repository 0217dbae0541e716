"""What the session asks of an estimator."""

from __future__ import annotations

from typing import Protocol

from sins_align.types import Advance, Estimate, ImuBlock, OdometerSamples


class Aligner(Protocol):
    """An estimator: no clock, no log, no topic. The session feeds it whole blocks."""

    def update(self, block: ImuBlock) -> list[Advance]:
        """Take in the next block of samples.

        An element for every step forward; none while samples are only kept.
        """

    @property
    def estimate(self) -> Estimate | None:
        """At the last stamp of the last block; None before the coarse attitude exists."""

    def propagate(self, block: ImuBlock) -> Estimate | None:
        """`estimate` carried to the end of `block` by the gyros; changes nothing.

        `block` begins at the last stamp of the last update and may be shorter than a
        whole one.
        """

    def conclude(self, block: ImuBlock) -> Estimate | None:
        """The best estimate from all samples to the end of `block`; changes nothing.

        Where `update` leaves something for later, this does not: for the end of a run.
        """

    def foresee(self, heading: float) -> float:
        """When 1 sigma of heading will be below `heading` [rad], in time from now [s].

        By the covariance propagated ahead under the motion seen so far; changes nothing. inf:
        not within an hour; NaN: it cannot be said.
        """

    def next_step(self, ahead_s: float) -> float:
        """Time from now to the first step that is at least so far ahead [s]."""


class AidedAligner(Aligner, Protocol):
    """An estimator that needs an odometer."""

    def aid(self, samples: OdometerSamples) -> list[Advance]:
        """Take in samples of the odometer, which may be ahead of the IMU or behind it."""
