"""From samples as they arrive to blocks on a grid of stamps."""

from __future__ import annotations

import numpy as np

from sins_align.types import Array, ImuBlock, ImuSamples, InputCounts, IntArray

BLOCK_NS = 1_000_000_000
# Nothing that aligns turns faster or is shaken harder: beyond is a broken driver.
MAX_RATE = 100.0  # [rad/s]
MAX_SPECIFIC_FORCE = 1000.0  # [m/s^2]
# Up to here the samples that are missing are bridged by interpolation; beyond, the
# attitude chain is taken as cut.
MAX_GAP_NS = 500_000_000


def usable(w_ib_b: Array, f_ib_b: Array) -> tuple[np.ndarray, np.ndarray]:
    """Which columns are finite, and which are inside the range of any IMU: (N,) each."""
    with np.errstate(invalid="ignore"):
        finite = np.isfinite(w_ib_b).all(axis=0) & np.isfinite(f_ib_b).all(axis=0)
        in_range = (np.abs(w_ib_b) <= MAX_RATE).all(axis=0) & (
            np.abs(f_ib_b) <= MAX_SPECIFIC_FORCE
        ).all(axis=0)
    return finite, in_range


class Intake:
    """Checks, orders and cuts the stream of samples.

    Block k ends at the first sample at or after t0 + k s. A sample that comes late is put
    in its place while its block is open, and refused afterwards. A single stamp far ahead
    is held back until the next sample confirms it.
    """

    def __init__(self, counts: InputCounts) -> None:
        self._counts = counts
        self._chunks: list[ImuSamples] = []  # open block and beyond, by stamp
        self._first_ns: int | None = None
        self._open_ns: int | None = None  # last stamp of the last block: first one of the open
        self._last_ns: int | None = None  # newest stamp taken in
        self._blocks = 0
        self._suspect: ImuSamples | None = None
        self._after_break: ImuSamples | None = None
        self.interval_s: float | None = None
        self.broken_s: float | None = None

    def elapsed_s(self, stamp_ns: int) -> float:
        """Time from the first sample to `stamp_ns` [s]."""
        return 0.0 if self._first_ns is None else (stamp_ns - self._first_ns) * 1e-9

    def add(self, samples: ImuSamples, counted: bool = False) -> None:
        """Take in samples; `counted`: they have been checked and counted before."""
        if not counted:
            samples = self._refuse_unusable(samples)
        if len(samples) == 0:
            return
        stamps = samples.stamp_ns
        previous = stamps[0] - 1 if self._last_ns is None else self._last_ns
        steps = np.diff(stamps, prepend=previous)
        if self._suspect is None and steps.min() > 0 and steps.max() <= MAX_GAP_NS:
            self._append(samples, counted)
            return
        for k in range(len(samples)):
            if self._after_break is not None:
                # Everything from the break on belongs to the next start.
                self._after_break = _join([self._after_break, samples.select(slice(k, None))])
                return
            self._add_one(samples.select(slice(k, k + 1)), counted)

    def _refuse_unusable(self, samples: ImuSamples) -> ImuSamples:
        finite, in_range = usable(samples.w_ib_b, samples.f_ib_b)
        good = finite & in_range
        if good.all():
            return samples
        self._counts.rejected["not_finite"] += int((~finite).sum())
        self._counts.rejected["out_of_range"] += int((finite & ~in_range).sum())
        return samples.select(good)

    def _append(self, samples: ImuSamples, counted: bool) -> None:
        self._chunks.append(samples)
        first, last = int(samples.stamp_ns[0]), int(samples.stamp_ns[-1])
        if self._first_ns is None:
            self._first_ns = first
        self._last_ns = last
        if not counted:
            self._count(samples)

    def _count(self, samples: ImuSamples) -> None:
        counts = self._counts
        counts.imu_samples += len(samples)
        if counts.first_stamp_ns is None:
            counts.first_stamp_ns = int(samples.stamp_ns[0])
        newest = int(samples.stamp_ns[-1])
        counts.last_stamp_ns = max(newest, counts.last_stamp_ns or newest)

    def _add_one(self, sample: ImuSamples, counted: bool) -> None:
        stamp = int(sample.stamp_ns[0])
        if self._suspect is not None:
            suspect, self._suspect = self._suspect, None
            if 0 < stamp - int(suspect.stamp_ns[0]) <= MAX_GAP_NS:
                assert self._last_ns is not None
                self.broken_s = (int(suspect.stamp_ns[0]) - self._last_ns) * 1e-9
                self._after_break = _join([suspect, sample])
                return
            self._counts.rejected["out_of_range"] += 1
        if self._last_ns is None or 0 < stamp - self._last_ns <= MAX_GAP_NS:
            self._append(sample, counted)
        elif stamp > self._last_ns:
            self._suspect = sample
        else:
            self._add_late(sample, stamp, counted)

    def _add_late(self, sample: ImuSamples, stamp: int, counted: bool) -> None:
        pending = self._consolidate()
        if pending is None or stamp < int(pending.stamp_ns[0]):
            self._counts.rejected["backward"] += 1
            return
        place = int(np.searchsorted(pending.stamp_ns, stamp))
        if int(pending.stamp_ns[place]) == stamp:
            self._counts.rejected["repeated"] += 1
            return
        if place == 0:
            self._counts.rejected["backward"] += 1
            return
        before, after = pending.select(slice(None, place)), pending.select(slice(place, None))
        self._chunks = [_join([before, sample, after])]
        self._counts.imu_reordered += 1
        if not counted:
            self._count(sample)

    def _consolidate(self) -> ImuSamples | None:
        if len(self._chunks) > 1:
            self._chunks = [_join(self._chunks)]
        return self._chunks[0] if self._chunks else None

    def next_block(self) -> ImuBlock | None:
        """The next whole block, None until it is there."""
        if self._first_ns is None or self._last_ns is None:
            return None
        boundary = self._first_ns + (self._blocks + 1) * BLOCK_NS
        if self._last_ns < boundary:
            return None
        pending = self._consolidate()
        assert pending is not None
        end = int(np.searchsorted(pending.stamp_ns, boundary))
        block = ImuBlock(*pending.select(slice(None, end + 1)))
        self._chunks = [pending.select(slice(end, None))]
        self._open_ns = int(block.stamp_ns[-1])
        self._blocks += 1
        self._find_gaps(block.stamp_ns)
        return block

    def _find_gaps(self, stamp_ns: IntArray) -> None:
        steps = np.diff(stamp_ns)
        if self.interval_s is None:
            self.interval_s = float(np.median(steps)) * 1e-9
        missing = np.rint(steps * (1e-9 / self.interval_s)).astype(np.int64) - 1
        lost = int(missing.clip(min=0).sum())
        if lost:
            self._counts.imu_gaps += int((missing > 0).sum())
            self._counts.imu_lost += lost

    def pending_block(self) -> ImuBlock | None:
        """The last sample of the last block and all since; None before there is a block."""
        pending = self._consolidate()
        if pending is None or self._blocks == 0:
            return None
        return ImuBlock(*pending)

    def take_after_break(self) -> ImuSamples:
        """The samples that came after the break, to be added to a fresh intake."""
        assert self._after_break is not None
        rest, self._after_break = self._after_break, None
        self._count(rest)
        return rest


def _join(parts: list[ImuSamples]) -> ImuSamples:
    return ImuSamples(
        np.concatenate([p.stamp_ns for p in parts]),
        np.concatenate([p.w_ib_b for p in parts], axis=1),
        np.concatenate([p.f_ib_b for p in parts], axis=1),
    )
