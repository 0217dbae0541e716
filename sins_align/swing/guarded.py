"""An aligner on a base that may drive off: stops it then, and begins anew at the next rest."""

from __future__ import annotations

import math
from collections.abc import Callable

from sins_align.earth import earth_rate_n
from sins_align.protocols import Aligner
from sins_align.reasons import AT_POLE, VEHICLE_MOVES
from sins_align.swing.motion import STILL, MotionWatch
from sins_align.types import Advance, Estimate, ImuBlock, ImuSampling, Position

# A heading so old and so good is right enough for the Earth's axis [s], [rad].
BELIEVED_S, BELIEVED_SIGMA = 45.0, 0.35
# Nearer to a pole nothing is tried.
LEAST_COS_LATITUDE = 1e-6


class GuardedAligner:
    """Fulfils `Aligner`: another one, and a watch on the swing centre.

    While the centre is on its way nothing is given out, and the data are not used: what would be
    carried on by the gyros is tilted by 0.5' for every kilometre driven. When it is still again, a
    new aligner begins.

    Parameters
    ----------
    make : a new aligner
    position : of the base
    """

    def __init__(
        self, make: Callable[[], Aligner], position: Position, sampling: ImuSampling
    ) -> None:
        self._make = make
        self._earth_rate_n = earth_rate_n(position.latitude)
        self._is_polar = abs(math.cos(position.latitude)) < LEAST_COS_LATITUDE
        self._sampling = sampling
        self._begin()

    def _begin(self) -> None:
        self._aligner: Aligner | None = self._make()
        self._watch = MotionWatch(self._sampling)
        self._looked_ns: int | None = None
        self._first_ns: int | None = None

    def update(self, block: ImuBlock) -> list[Advance]:
        """See `Aligner`."""
        stamp_ns = int(block.stamp_ns[-1])
        if self._is_polar:
            return [Advance(stamp_ns, None, (AT_POLE(),))]
        self._watch.update(block)
        if self._first_ns is None:
            self._first_ns = int(block.stamp_ns[0])
        if self._aligner is None:
            return self._wait(stamp_ns, self._watch.has_stopped())
        self._look()
        if self._watch.has_left():
            self._aligner = None  # the block is not taken in
            return self._wait(stamp_ns, is_still=False)
        return self._aligner.update(block)

    def _wait(self, stamp_ns: int, is_still: bool) -> list[Advance]:
        moved = VEHICLE_MOVES(moved_m=self._watch.moved_m, still_s=STILL)
        if is_still:
            self._begin()
        return [Advance(stamp_ns, None, (moved,))]

    def _look(self) -> None:
        """Take what an estimate tells that is to be believed: early sigma may lie."""
        estimate = self.estimate
        if estimate is None or estimate.stamp_ns == self._looked_ns or self._first_ns is None:
            return
        self._looked_ns = estimate.stamp_ns
        age_s = (estimate.stamp_ns - self._first_ns) * 1e-9
        if age_s > BELIEVED_S and estimate.sigma[2] < BELIEVED_SIGMA:
            self._watch.take_axes(estimate, self._earth_rate_n)

    @property
    def estimate(self) -> Estimate | None:
        """See `Aligner`; None while the vehicle moves."""
        return None if self._aligner is None else self._aligner.estimate

    def propagate(self, block: ImuBlock) -> Estimate | None:
        """See `Aligner`."""
        return None if self._aligner is None else self._aligner.propagate(block)

    def conclude(self, block: ImuBlock) -> Estimate | None:
        """See `Aligner`."""
        return None if self._aligner is None else self._aligner.conclude(block)

    def foresee(self, heading: float) -> float:
        """See `Aligner`."""
        return math.nan if self._aligner is None else self._aligner.foresee(heading)

    def next_step(self, ahead_s: float) -> float:
        """See `Aligner`."""
        return ahead_s if self._aligner is None else self._aligner.next_step(ahead_s)
