"""From odometer samples as they arrive to samples that can be used."""

from __future__ import annotations

from collections import deque

import numpy as np

from sins_align.intake import MAX_STAMP_NS
from sins_align.types import InputCounts, IntArray, OdometerSamples

# No vehicle goes faster: beyond is a broken driver.
MAX_SPEED = 150.0  # [m/s]
# Closer than this are only repeats.
MIN_STEP_NS = 100_000
# Further ahead than this a single stamp is not believed until the next one confirms it.
MAX_STEP_NS = 2_000_000_000
# So late a sample can still be put in its place. What goes back further begins a new time.
MAX_LATE_NS = 200_000_000
# Samples that are late one after the other for longer than this are not late: the clock has
# been set back.
SET_BACK_NS = 500_000_000
# What `recent` keeps, before the IMU's time, which may be so far behind.
MOST_AHEAD_NS = 3_600_000_000_000
RECENT_NS = 10_000_000_000
# How far back they are of use to an alignment that begins.
USEFUL_NS = 5_000_000_000


class OdometerIntake:
    """Checks and orders the stream of odometer samples.

    What comes of the samples does not depend on how many come in one call. A sample that
    comes late is accepted where one is missing, and refused otherwise. A single stamp far
    ahead is held back, and counted as refused, until the next sample confirms it. When the
    clock has been set back, the samples begin anew: stamps of what `add` returns go back by
    more than `MAX_LATE_NS` there, and only there.

    imu_ns : how far the IMU has come [ns], None where it is not known
    rejected : how many were refused, by reason; their sum is in `counts.odom_rejected`
    """

    def __init__(self, counts: InputCounts) -> None:
        self._counts = counts
        self.rejected = {"not_finite": 0, "out_of_range": 0, "repeated": 0, "backward": 0}
        self.imu_ns: int | None = None
        self._recent: deque[OdometerSamples] = deque()  # in order, one part after the other
        self._last_ns: int | None = None  # newest stamp accepted
        self._suspect: OdometerSamples | None = None
        self._late: tuple[int, int] | None = None  # run of late stamps: from, to

    def add(self, samples: OdometerSamples) -> OdometerSamples:
        """The samples that can be used, in memory of their own.

        In the order of their stamps but for late ones, which stand where they came.
        """
        if len(samples) == 0:
            return _copy(samples)
        if len(samples) == 1 and self._is_plain(samples):
            return self._take(samples)
        samples = self._usable(samples)
        stamps = samples.stamp_ns
        accepted: list[OdometerSamples] = []
        begin = 0
        for end in _runs(stamps):
            while begin < end:
                stamp = int(stamps[begin])
                if self._suspect is None and self._follows(stamp):
                    accepted.append(self._take(samples.select(slice(begin, end))))
                    begin = end
                else:
                    accepted += self._add_odd(samples.select(slice(begin, begin + 1)), stamp)
                    begin += 1
        return accepted[0] if len(accepted) == 1 else _join(accepted)

    def recent(self) -> OdometerSamples:
        """The samples accepted last, some ten seconds of them, by stamp."""
        joined = _join(list(self._recent))
        if self._last_ns is not None:
            first = int(np.searchsorted(joined.stamp_ns, self._last_ns - RECENT_NS))
            joined = joined.select(slice(first, None))
        self._recent = deque([joined] if len(joined) else [])
        return _copy(joined)

    def useful(self, begin_ns: int | None = None) -> OdometerSamples:
        """What is kept that is of use to an alignment that begins then [ns].

        The odometer may be ahead of the IMU. From a fixed time on: what comes of it must not
        depend on what else is still kept.

        begin_ns : None: where the IMU is
        """
        recent = self.recent()
        begin_ns = self.imu_ns if begin_ns is None else begin_ns
        return (
            recent if begin_ns is None else recent.select(recent.stamp_ns >= begin_ns - USEFUL_NS)
        )

    def _refuse(self, reason: str, number: int = 1) -> None:
        self.rejected[reason] += number
        self._counts.odom_rejected += number

    def _is_plain(self, sample: OdometerSamples) -> bool:
        """Whether one sample simply follows: the rest of `add`, in less time."""
        return (
            self._suspect is None
            and self._last_ns is not None
            and self._follows(sample.stamp_ns.item())
            and abs(sample.speed.item()) <= MAX_SPEED
            and 0.0 <= sample.variance.item() < np.inf
            and self._last_ns <= MAX_STAMP_NS - MAX_STEP_NS
        )

    def _usable(self, samples: OdometerSamples) -> OdometerSamples:
        """Without those whose values cannot be; unknown variances made zero."""
        stamps, speed, variance = samples
        if variance.min() >= 0.0 and np.abs(speed).max() <= MAX_SPEED:  # NaN is not <= anything
            in_time = stamps.min() >= -MAX_STAMP_NS and stamps.max() <= MAX_STAMP_NS
            if in_time and variance.max() < np.inf:
                return samples
        finite = np.isfinite(speed) & (variance != np.inf)
        with np.errstate(invalid="ignore"):
            variance = np.where(variance >= 0.0, variance, 0.0)
            in_range = np.abs(speed) <= MAX_SPEED
        in_range &= (stamps >= -MAX_STAMP_NS) & (stamps <= MAX_STAMP_NS)
        self._refuse("not_finite", int((~finite).sum()))
        self._refuse("out_of_range", int((finite & ~in_range).sum()))
        return OdometerSamples(stamps, speed, variance).select(finite & in_range)

    def _follows(self, stamp: int) -> bool:
        return self._last_ns is None or MIN_STEP_NS <= stamp - self._last_ns <= MAX_STEP_NS

    def _take(self, samples: OdometerSamples) -> OdometerSamples:
        """Accept samples that follow."""
        samples = _copy(samples)
        self._recent.append(samples)
        self._late = None
        self._last_ns = int(samples.stamp_ns[-1])
        self._counts.odom_samples += len(samples)
        used = self._last_ns if self.imu_ns is None else min(self._last_ns, self.imu_ns)
        oldest = max(used, self._last_ns - MOST_AHEAD_NS) - RECENT_NS
        while int(self._recent[0].stamp_ns[-1]) < oldest:
            self._recent.popleft()
        return samples

    def _add_odd(self, sample: OdometerSamples, stamp: int) -> list[OdometerSamples]:
        """What comes of a sample that does not simply follow, or comes after a suspect."""
        if self._suspect is not None:
            ahead = stamp - int(self._suspect.stamp_ns[0])
            if abs(ahead) < MIN_STEP_NS:
                self._refuse("repeated")
                return []
            suspect, self._suspect = self._suspect, None
            if 0 < ahead <= MAX_STEP_NS:
                self._refuse("out_of_range", -1)
                return [self._take(suspect), self._take(sample)]
        if self._follows(stamp):
            return [self._take(sample)]
        assert self._last_ns is not None
        if stamp > self._last_ns + MAX_STEP_NS:
            self._refuse("out_of_range")
            self._suspect = _copy(sample)
            return []
        return self._add_late(sample, stamp)

    def _add_late(self, sample: OdometerSamples, stamp: int) -> list[OdometerSamples]:
        assert self._last_ns is not None
        if self._is_set_back(stamp):
            self._recent.clear()
            return [self._take(sample)]
        recent = self.recent()
        stamps = recent.stamp_ns
        place = int(np.searchsorted(stamps, stamp))
        near = stamps[max(place - 1, 0) : place + 1]
        if (np.abs(near - stamp) < MIN_STEP_NS).any():
            self._refuse("repeated")
            return []
        if stamp < self._last_ns - MAX_LATE_NS or place == 0 or not _is_hole(stamps, place):
            self._refuse("backward")
            return []
        before, after = recent.select(slice(None, place)), recent.select(slice(place, None))
        self._recent = deque([_join([before, sample, after])])
        self._counts.odom_samples += 1
        return [_copy(sample)]

    def _is_set_back(self, stamp: int) -> bool:
        """Whether the late samples up to this one are a stream of their own."""
        assert self._last_ns is not None
        if self._late is None or not 0 < stamp - self._late[1] <= MAX_STEP_NS:
            self._late = (stamp, stamp)
        else:
            self._late = (self._late[0], stamp)
        return stamp - self._late[0] > SET_BACK_NS and stamp < self._last_ns - MAX_LATE_NS


def _runs(stamps: IntArray) -> list[int]:
    """Ends of the stretches in which every sample follows the one before."""
    size = int(stamps.shape[0])
    if size < 2:
        return [size]
    steps = np.diff(stamps)
    odd = ((steps < MIN_STEP_NS) | (steps > MAX_STEP_NS)).nonzero()[0] + 1
    return [*odd.tolist(), size]


def _is_hole(stamps: IntArray, place: int) -> bool:
    """Whether a sample is missing before index `place` (1 or more)."""
    steps = np.diff(stamps)
    return bool(steps.shape[0] < 3 or 2 * steps[place - 1] >= 3 * np.median(steps))


def _copy(samples: OdometerSamples) -> OdometerSamples:
    return OdometerSamples(samples.stamp_ns.copy(), samples.speed.copy(), samples.variance.copy())


def _join(parts: list[OdometerSamples]) -> OdometerSamples:
    if not parts:
        return OdometerSamples(np.empty(0, dtype=np.int64), np.empty(0), np.empty(0))
    return OdometerSamples(*(np.concatenate(values) for values in zip(*parts, strict=True)))
