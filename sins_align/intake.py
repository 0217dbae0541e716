"""From samples as they arrive to blocks on a grid of stamps."""

from __future__ import annotations

from collections import deque

import numpy as np

from sins_align.types import ImuBlock, ImuSamples, InputCounts, IntArray

BLOCK_NS = 1_000_000_000
# Nothing that aligns turns faster or is shaken harder: beyond is a broken driver.
MAX_RATE = 100.0  # [rad/s]
MAX_SPECIFIC_FORCE = 1000.0  # [m/s^2]
# Differences of two stamps must fit into 64 bits.
MAX_STAMP_NS = 2**62 - 1
# Up to here the samples that are missing are bridged by interpolation; beyond, the
# attitude chain is taken as cut.
MAX_GAP_NS = 500_000_000
# Closer than this are only repeats, and stamps in a wrong unit: they must not fill the memory.
MIN_STEP_NS = 10_000
# Samples that are late one after the other for longer than this are not late: the clock has
# been set back.
MAX_LATE_NS = 100_000_000


def usable(samples: ImuSamples) -> tuple[np.ndarray, np.ndarray]:
    """Which samples are finite, and which are inside the range of any IMU: (N,) each."""
    w, f = samples.w_ib_b, samples.f_ib_b
    with np.errstate(invalid="ignore"):
        finite = np.isfinite(w).all(axis=0) & np.isfinite(f).all(axis=0)
        in_range = (np.abs(w) <= MAX_RATE).all(axis=0)
        in_range &= (np.abs(f) <= MAX_SPECIFIC_FORCE).all(axis=0)
        in_range &= (samples.stamp_ns <= MAX_STAMP_NS) & (samples.stamp_ns >= -MAX_STAMP_NS)
    return finite, in_range


def all_usable(samples: ImuSamples) -> bool:
    """Whether `usable` finds nothing wrong, in fewer passes; no empty arrays."""
    stamps, w, f = samples
    return bool(
        # NaN is not <= anything.
        max(w.max(), -w.min()) <= MAX_RATE
        and max(f.max(), -f.min()) <= MAX_SPECIFIC_FORCE
        and stamps.min() >= -MAX_STAMP_NS
        and stamps.max() <= MAX_STAMP_NS
    )


class Intake:
    """Checks, orders and cuts the stream of samples.

    Block k ends at the first sample at or after t0 + k s, and is cut as soon as that sample
    is there: what comes of the samples does not depend on how many come in one call. A
    sample that comes late is put in its place while its block is open, and refused
    afterwards. A single stamp far ahead is held back, and counted as refused, until the next
    sample confirms it.
    """

    def __init__(self, counts: InputCounts) -> None:
        self._counts = counts
        self._blocks: deque[ImuBlock] = deque()  # whole ones, not fetched yet
        self._parts: list[ImuSamples] = []  # of the open block, by stamp
        self._before: IntArray = np.empty(0, dtype=np.int64)  # stamps of the last block
        self._first_ns: int | None = None
        self._last_ns: int | None = None  # newest stamp taken in
        self._cut = 0  # number of blocks so far
        self._suspect: ImuSamples | None = None
        self._late: tuple[int, int] | None = None  # run of late stamps: from, to
        self._rest: ImuSamples | None = None
        self.interval_s: float | None = None
        self.break_reason = ""

    def elapsed_s(self, stamp_ns: int) -> float:
        """Time from the first sample to `stamp_ns` [s]."""
        return 0.0 if self._first_ns is None else (stamp_ns - self._first_ns) * 1e-9

    def add(self, samples: ImuSamples) -> None:
        """Take in samples."""
        if len(samples) == 0:
            return
        if not all_usable(samples):
            finite, in_range = usable(samples)
            self._counts.rejected["not_finite"] += int((~finite).sum())
            self._counts.rejected["out_of_range"] += int((finite & ~in_range).sum())
            samples = samples.select(finite & in_range)
        self.add_usable(samples)

    def add_usable(self, samples: ImuSamples) -> None:
        """Take in samples whose values have been checked before."""
        size = len(samples)
        stamps = samples.stamp_ns
        steps = stamps[1:] - stamps[:-1]
        odd = ((steps < MIN_STEP_NS) | (steps > MAX_GAP_NS)).nonzero()[0] + 1
        begin = 0
        for end in (*odd.tolist(), size):
            while begin < end:
                if self.break_reason:
                    # Everything from the break on belongs to the next start.
                    self._keep(samples.select(slice(begin, None)))
                    return
                stamp = int(stamps[begin])
                if self._suspect is None and self._follows(stamp):
                    self._append(samples.select(slice(begin, end)))
                    begin = end
                else:
                    self._add_odd(samples.select(slice(begin, begin + 1)), stamp)
                    begin += 1

    def _follows(self, stamp: int) -> bool:
        return self._last_ns is None or MIN_STEP_NS <= stamp - self._last_ns <= MAX_GAP_NS

    def _append(self, samples: ImuSamples) -> None:
        """Add samples in order to the open block, and cut it where it is whole."""
        # Copies: the caller may use its arrays again.
        self._parts.append(_copy(samples))
        self._late = None
        self._last_ns = int(samples.stamp_ns[-1])
        if self._first_ns is None:
            self._first_ns = int(samples.stamp_ns[0])
        self._count(samples)
        while self._last_ns >= self._first_ns + (self._cut + 1) * BLOCK_NS:
            self._cut_block(self._first_ns + (self._cut + 1) * BLOCK_NS)

    def _count(self, samples: ImuSamples) -> None:
        counts = self._counts
        counts.imu_samples += len(samples)
        newest = int(samples.stamp_ns[-1])
        if counts.first_stamp_ns is None or counts.last_stamp_ns is None:
            counts.first_stamp_ns = int(samples.stamp_ns[0])
            counts.last_stamp_ns = newest
        counts.last_stamp_ns = max(counts.last_stamp_ns, newest)

    def _add_odd(self, sample: ImuSamples, stamp: int) -> None:
        """Add one sample that does not simply follow, or that comes after a suspect."""
        rejected = self._counts.rejected
        if self._suspect is not None:
            ahead = stamp - int(self._suspect.stamp_ns[0])
            if abs(ahead) < MIN_STEP_NS:
                rejected["repeated"] += 1
                return
            suspect, self._suspect = self._suspect, None
            if 0 < ahead <= MAX_GAP_NS:
                rejected["out_of_range"] -= 1
                assert self._last_ns is not None
                gap_s = (int(suspect.stamp_ns[0]) - self._last_ns) * 1e-9
                self._counts.imu_gaps += 1
                self._break(f"{gap_s:.1f} s without IMU data", _join([suspect, sample]))
                return
        if self._follows(stamp):
            self._append(sample)
        elif self._last_ns is not None and stamp > self._last_ns + MAX_GAP_NS:
            rejected["out_of_range"] += 1
            self._suspect = _copy(sample)
        else:
            self._add_late(sample, stamp)

    def _add_late(self, sample: ImuSamples, stamp: int) -> None:
        pending = self._consolidate()
        if _holds(pending.stamp_ns, stamp) or _holds(self._before, stamp):
            self._counts.rejected["repeated"] += 1
            return
        if self._is_set_back(stamp):
            assert self._last_ns is not None and self._late is not None
            back_s = (self._last_ns - self._late[0]) * 1e-9
            self._break(f"the IMU's stamps jumped back by {back_s:.1f} s", sample)
            return
        place = int(np.searchsorted(pending.stamp_ns, stamp))
        if place == 0 or not _is_hole(pending.stamp_ns, place):
            self._counts.rejected["backward"] += 1
            return
        before, after = pending.select(slice(None, place)), pending.select(slice(place, None))
        self._parts = [_join([before, sample, after])]
        self._counts.imu_reordered += 1
        self._count(sample)

    def _is_set_back(self, stamp: int) -> bool:
        """Whether the late samples up to this one are a stream of their own."""
        if self._late is None or not 0 < stamp - self._late[1] <= MAX_GAP_NS:
            self._late = (stamp, stamp)
        else:
            self._late = (self._late[0], stamp)
        return stamp - self._late[0] > MAX_LATE_NS

    def _break(self, reason: str, rest: ImuSamples) -> None:
        self.break_reason = reason
        self._keep(rest)

    def _keep(self, samples: ImuSamples) -> None:
        self._rest = samples if self._rest is None else _join([self._rest, samples])

    def _consolidate(self) -> ImuSamples:
        if len(self._parts) != 1:
            self._parts = [_join(self._parts)]
        return self._parts[0]

    def _cut_block(self, boundary: int) -> None:
        pending = self._consolidate()
        end = int(np.searchsorted(pending.stamp_ns, boundary))
        block = ImuBlock(*_copy(pending.select(slice(end + 1))))
        self._parts = [pending.select(slice(end, None))]
        self._before = block.stamp_ns
        self._cut += 1
        self._find_gaps(block.stamp_ns)
        self._blocks.append(block)

    def _find_gaps(self, stamp_ns: IntArray) -> None:
        steps = np.diff(stamp_ns)
        if 2 * int(steps.max()) < 3 * int(steps.min()):
            # The usual case, without a median: nothing is missing.
            self.interval_s = int(stamp_ns[-1] - stamp_ns[0]) * 1e-9 / steps.shape[0]
            return
        interval = float(np.median(steps)) * 1e-9
        if self.interval_s is None or _is_regular(steps):
            self.interval_s = interval
        missing = np.rint(steps * (1e-9 / self.interval_s)).astype(np.int64) - 1
        self._counts.imu_gaps += int((missing > 0).sum())
        self._counts.imu_lost += int(missing.clip(min=0).sum())

    def next_block(self) -> ImuBlock | None:
        """The next whole block, None until it is there."""
        return self._blocks.popleft() if self._blocks else None

    def pending_block(self) -> ImuBlock | None:
        """The last sample of the last block and all since; None before there is a block."""
        return None if self._cut == 0 else ImuBlock(*_copy(self._consolidate()))

    def take_after_break(self) -> ImuSamples:
        """The samples from the break on, to be added to a fresh intake."""
        assert self._rest is not None
        rest, self._rest = self._rest, None
        return rest


def _copy(samples: ImuSamples) -> ImuSamples:
    """In memory of its own, laid out alike however the samples came: bits depend on that."""
    return ImuSamples(
        samples.stamp_ns.copy(), samples.w_ib_b.copy(order="C"), samples.f_ib_b.copy(order="C")
    )


def _holds(stamps: IntArray, stamp: int) -> bool:
    """Whether `stamp` is one of the sorted stamps, or too close to one."""
    place = int(np.searchsorted(stamps, stamp))
    near = stamps[max(place - 1, 0) : place + 1]
    return bool((np.abs(near - stamp) < MIN_STEP_NS).any())


def _is_hole(stamps: IntArray, place: int) -> bool:
    """Whether a sample is missing before index `place` (1 or more)."""
    steps = np.diff(stamps)
    return bool(steps.shape[0] < 3 or 2 * steps[place - 1] >= 3 * np.median(steps))


def _is_regular(steps: IntArray) -> bool:
    """Whether nine out of ten steps are as long as the others."""
    usual = np.median(steps)
    return bool((np.abs(steps - usual) < 0.25 * usual).mean() >= 0.9)


def _join(parts: list[ImuSamples]) -> ImuSamples:
    return ImuSamples(
        np.concatenate([p.stamp_ns for p in parts]),
        np.concatenate([p.w_ib_b for p in parts], axis=1),
        np.concatenate([p.f_ib_b for p in parts], axis=1),
    )
