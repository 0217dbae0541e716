"""IMU and odometer brought together by stamp, in epochs of a second or two."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sins_align.config import OdometerConfig
from sins_align.odo.knots import SAME_S
from sins_align.odo.track import OdometerTrack
from sins_align.types import Array, ImuBlock, IntArray, OdometerSamples

EPOCH_S = 1.0  # unless another length is asked for
# An epoch ends at an odometer sample where there is one so long after its begin. More than a
# second apart: or else a sample every second could be missed again and again.
SHORTER_S, LONGER_S = 0.55, 0.6
# An epoch has so many intervals of the IMU at least.
LEAST_INTERVALS = 2
# Knots before the epoch that are kept, for a delay that is estimated anew.
MARGIN_S = 5.0


class Paired(NamedTuple):
    """An epoch.

    block : both end samples included; begins at the last stamp of the epoch before
    distance, speed : (n+1,) S(t) and its derivative at the block's stamps, by the vehicle's
        time [m], [m/s]; only differences of S mean something. None where the odometer does
        not tell for the whole epoch
    variance : of the displacement, as far as the samples tell theirs, and of bridged holes
        [m^2]
    before : the three samples before the block, as `ImuBlock`; None where there are none
    """

    block: ImuBlock
    distance: Array | None
    speed: Array | None
    variance: float
    before: ImuBlock | None = None


class Pairing:
    """Cuts the IMU's stream into epochs that end at odometer samples, where there are any.

    An epoch ends at the knot of the track nearest to a second after its begin, and is cut as
    soon as all samples are there that can change it. The IMU waits for `timeout_s` after that
    second, and no less than for the longest epoch. What comes out does not depend on how many
    samples come in one call, nor, within that time less an interval of the odometer, on which
    of the two sensors is ahead.

    config : None: no odometer
    """

    def __init__(self, config: OdometerConfig | None) -> None:
        self._track = OdometerTrack(config.quantum) if config is not None else None
        timeout = 0.0 if config is None else config.timeout_s
        self._patience_s = max(timeout, LONGER_S)
        self._parts: list[ImuBlock] = []
        self._stamp_ns: IntArray = np.empty(0, dtype=np.int64)
        self._values: Array = np.empty((6, 0))  # w, f
        self._before: ImuBlock | None = None  # the last three samples but one of the last epoch
        self._quantum = 0.0

    @property
    def track(self) -> OdometerTrack | None:
        """The odometer's track, with what was found out about it; None without odometer."""
        return self._track

    @property
    def quantum(self) -> float:
        """Distance of one count of the odometer as of the begin of the last epoch [m].

        0 where there is none; coarse while it is not known.
        """
        return self._quantum

    def add_imu(self, block: ImuBlock) -> None:
        """Take in a block; it begins at the last stamp of the one before."""
        self._parts.append(block)

    def add_odometer(self, samples: OdometerSamples) -> None:
        """Take in samples as `OdometerIntake` gives them; they may be ahead or behind."""
        if self._track is not None:
            self._track.add(samples)

    def pending_block(self) -> ImuBlock | None:
        """The IMU samples since the last epoch's end, which is the first of them."""
        self._gather()
        return self._cut(self._stamp_ns.shape[0] - 1) if self._stamp_ns.shape[0] else None

    def next(self, delay_s: float, length_s: float = EPOCH_S) -> Paired | None:
        """The next epoch, of about `length_s`; None until it is there.

        delay_s : by how much the odometer's stamps are late: what it says at stamp t + delay
            is what the vehicle did at t
        """
        self._gather()
        stamps = self._stamp_ns
        if stamps.shape[0] <= LEAST_INTERVALS:
            return None
        here_s = int(stamps[-1] - stamps[0]) * 1e-9
        if here_s < length_s:
            return None
        overdue = here_s >= length_s + self._patience_s
        if self._track is None or self._track.origin_ns is None:
            # A track without a sample makes the IMU wait like one without an end.
            waits = self._track is not None and not overdue
            return None if waits else self._finish(self._nearest_to(length_s), None)
        return self._pair(self._track, delay_s, length_s, overdue)

    def _pair(
        self, track: OdometerTrack, delay_s: float, length_s: float, overdue: bool
    ) -> Paired | None:
        stamps = self._stamp_ns
        begin = track.time(int(stamps[0])) + delay_s
        track.drop_before(begin - MARGIN_S)
        track.settle()
        if overdue:
            track.settle(begin + length_s + LONGER_S)
        knot, known = _find_knot(track, begin, length_s)
        if not known and not overdue:
            return None
        t = track.times(stamps) + delay_s
        at = None if knot is None else float(track.knots[knot])
        if at is not None and t[-1] < at - SAME_S:
            return None
        self._quantum = track.quantum_at(begin)
        if knot is None or at is None:
            return self._finish(self._nearest_to(length_s), None)
        if track.begins_at(knot):
            # From the first stamp on of which the track tells.
            return self._finish(int(t.searchsorted(at - SAME_S)), None)
        return self._finish(int(t.searchsorted(at + SAME_S, side="right")) - 1, t)

    def _finish(self, end: int, t: Array | None) -> Paired:
        """The epoch that ends at the IMU's sample `end`; t: odometer's time of the samples."""
        if end < LEAST_INTERVALS:
            end, t = LEAST_INTERVALS, None
        block, before = self._cut(end), self._before
        self._before = _last_but_one(block) if end > 3 else None
        self._stamp_ns = self._stamp_ns[end:]
        self._values = self._values[:, end:]
        stretch = None
        if t is not None and self._track is not None:
            stretch = self._track.read(t[: end + 1])
        if stretch is None:
            return Paired(block, None, None, 0.0, before)
        return Paired(block, *stretch, before=before)

    def _cut(self, end: int) -> ImuBlock:
        # Copies, laid out alike however the samples came: bits depend on that.
        values = self._values[:, : end + 1].copy()
        return ImuBlock(self._stamp_ns[: end + 1].copy(), values[:3], values[3:])

    def _nearest_to(self, length_s: float) -> int:
        """Index of the IMU sample nearest to `length_s` after the epoch's begin."""
        stamps = self._stamp_ns
        wanted = stamps[0] + round(length_s * 1e9)
        after = int(stamps.searchsorted(wanted))
        return after if stamps[after] - wanted < wanted - stamps[after - 1] else after - 1

    def _gather(self) -> None:
        for block in self._parts:
            old = self._stamp_ns.shape[0]
            skip = 1 if old else 0  # the last sample of the block before
            stamps = block.stamp_ns[skip:]
            values = np.empty((6, old + stamps.shape[0]))
            values[:, :old] = self._values
            values[:3, old:] = block.w_ib_b[:, skip:]
            values[3:, old:] = block.f_ib_b[:, skip:]
            self._stamp_ns = np.concatenate((self._stamp_ns, stamps))
            self._values = values
        self._parts = []


def _last_but_one(block: ImuBlock) -> ImuBlock:
    """The three samples before the last one, which is the first of the next block."""
    kept = slice(-4, -1)
    return ImuBlock(block.stamp_ns[kept], block.w_ib_b[:, kept], block.f_ib_b[:, kept])


def _find_knot(track: OdometerTrack, begin: float, length_s: float) -> tuple[int | None, bool]:
    """Index of the knot at which an epoch ends, and whether later samples cannot change it.

    begin : of the epoch, in the track's time [s]. No index: there is no knot in time.
    """
    knots = track.knots
    wanted = begin + length_s
    after = int(knots.searchsorted(wanted))
    size = knots.shape[0]
    near = [
        (abs(float(knots[k]) - wanted), k)
        for k in (after - 1, after)
        if 0 <= k < size and -SHORTER_S <= knots[k] - wanted <= LONGER_S
    ]
    if not near:
        return None, after < size
    knot = min(near)[1]
    # The slope at a knot needs the interval after it.
    return knot, after < size and knot + 1 < size
