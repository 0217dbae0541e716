"""Distance over time from an odometer's mean speeds."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from sins_align.odo.hampel import (
    HAMPEL_S,
    HAMPEL_SIDE,
    MEDIAN_STEPS,
    find_outliers,
    is_slow,
    usual_steps,
)
from sins_align.odo.knots import GOOD, MEAN, ROWS, SAME_S, TIME, Stretch, append_knots, read_knots
from sins_align.odo.odometer_intake import MAX_LATE_NS
from sins_align.odo.quantum import QuantumFinder
from sins_align.types import Array, IntArray, OdometerSamples

# Up to so many usual intervals a step is one long interval; beyond, samples are missing.
LONG_STEP = 1.5
# Of a longer step nothing is known but its end.
MAX_STEP_S = 2.0 + SAME_S
# Shorter holes are bridged, with the variance of an unknown acceleration.
MAX_BRIDGE_S = 0.35 + SAME_S
UNKNOWN_ACCELERATION = 2.0  # [m/s^2], 1 sigma

# Judged samples that are kept for the windows of the next ones.
_CONTEXT = MEDIAN_STEPS + 1
# Knots are dropped so long after the first of them could be [s].
_DROP_S = 3.0


class OdometerTrack:
    """Distance over time; a function of the samples in their order, not of the chunks.

    A sample is the mean speed over the time since the one before, or, when that is longer than
    usual, over a usual interval; before that there is a hole. A sample is judged by the Hampel
    filter once all that can be in its window is there: `settle`. One that comes later than
    that is refused.

    Times are seconds since `origin_ns`, the first sample's stamp.

    quantum : distance of one count [m]; None: found from the data
    replaced : number of samples the filter replaced
    too_late : number of samples refused
    """

    def __init__(self, quantum: float | None = None) -> None:
        self._given_quantum = quantum
        self.replaced = 0
        self.too_late = 0
        self._finder = QuantumFinder()
        self._found: list[tuple[float, float]] = []  # from when on which quantum is known
        self._clear()

    def _clear(self) -> None:
        self.origin_ns: int | None = None
        self._newest_ns = 0
        self._parts: list[OdometerSamples] = []  # not in `_raw` yet
        self._raw: Array = np.empty((3, 0))  # time, speed, variance
        self._done = 0  # how many of them are judged
        self._is_settled = True  # nothing has come since
        self._knots: Array = np.empty((ROWS, 0))
        self._found = [(-np.inf, self._cautious_quantum())]

    @property
    def quantum(self) -> float:
        """Distance of one count [m], 0 where there is none or it is not known."""
        return self._finder.quantum if self._given_quantum is None else self._given_quantum

    def quantum_at(self, time_s: float) -> float:
        """Distance of one count as the samples up to a time tell it [m].

        Coarse while they do not; there may be later samples already.
        """
        return next(found for since, found in reversed(self._found) if since <= time_s)

    def _cautious_quantum(self) -> float:
        given = self._given_quantum
        return self._finder.cautious_quantum if given is None else given

    @property
    def knots(self) -> Array:
        """(K,) times of the knots settled so far [s]."""
        return self._knots[TIME]

    def time(self, stamp_ns: int) -> float:
        """A stamp in the track's own time [s]."""
        assert self.origin_ns is not None
        return (stamp_ns - self.origin_ns) * 1e-9

    def times(self, stamp_ns: IntArray) -> Array:
        """(n,) stamps in the track's own time [s]."""
        assert self.origin_ns is not None
        return np.asarray((stamp_ns - self.origin_ns) * 1e-9, dtype=np.float64)

    def begins_at(self, knot: int) -> bool:
        """Whether nothing is known of the time before a knot."""
        return not self._knots[GOOD, knot]

    def add(self, samples: OdometerSamples) -> None:
        """Take in samples as `OdometerIntake` gives them; the arrays are kept."""
        if len(samples) == 0:
            return
        stamps = samples.stamp_ns
        if self.origin_ns is None:
            self.origin_ns = int(stamps[0])
            self._newest_ns = self.origin_ns - 1
        if stamps[0] > self._newest_ns and (len(samples) == 1 or np.diff(stamps).min() > 0):
            self._newest_ns = int(stamps[-1])
            self._parts.append(samples)
            self._is_settled = False
        elif len(samples) > 1:
            for k in range(len(samples)):
                self.add(samples.select(slice(k, k + 1)))
        elif stamps[0] < self._newest_ns - MAX_LATE_NS:
            self._clear()  # the clock has been set back
            self.add(samples)
        else:
            self._add_late(samples)

    def _add_late(self, sample: OdometerSamples) -> None:
        self.settle()  # whether there is still a place for it must not depend on who asked when
        t = self.time(int(sample.stamp_ns[0]))
        place = int(np.searchsorted(self._raw[0], t))
        if place < self._done or self._done == 0 or self._raw[0, place] == t:
            self.too_late += 1
            return
        column = np.array([[t], sample.speed, sample.variance])
        self._raw = np.concatenate((self._raw[:, :place], column, self._raw[:, place:]), axis=1)
        self._is_settled = False

    def settle(self, until_s: float = -np.inf) -> None:
        """Judge the samples whose window is whole, and all up to `until_s` as they are."""
        if self._is_settled and until_s == -np.inf:
            return
        self._gather()
        end = self._find_final(until_s)
        while self._done < end:
            # What the finder found holds for the samples after those it looked at.
            begin = self._done
            if self._given_quantum is None:
                self._done += self._finder.count_until_search(self._raw[1, begin:end])
            else:
                self._done = end
            self._judge(begin, self._done)
        self._is_settled = True
        surplus = self._done - _CONTEXT
        if surplus > 0:
            self._raw = self._raw[:, surplus:]
            self._done = _CONTEXT

    def _gather(self) -> None:
        if not self._parts:
            return
        stamps, speeds, variances = zip(*self._parts, strict=True)
        old = self._raw.shape[1]
        raw = np.empty((3, old + sum(map(len, stamps))))
        raw[:, :old] = self._raw
        raw[0, old:] = self.times(np.concatenate(stamps))
        np.concatenate(speeds, out=raw[1, old:])
        np.concatenate(variances, out=raw[2, old:])
        self._raw, self._parts = raw, []

    def _find_final(self, until_s: float) -> int:
        """Index of the first sample that cannot be judged yet."""
        t = self._raw[0]
        size = t.shape[0]
        end = max(self._done, size - HAMPEL_SIDE)
        while end < size:
            time = float(t[end])
            if time > until_s and t[-1] - time <= HAMPEL_S and not is_slow(t, end):
                break
            end += 1
        return end

    def _judge(self, begin: int, end: int) -> None:
        """Filter samples begin to end, and make knots of them."""
        t, v, variance = self._raw[:, begin:end]
        known = self._raw[0, max(begin - MEDIAN_STEPS, 0) : end]
        steps = known[1:] - known[:-1]
        if begin > 0 and steps.max() <= min(LONG_STEP * steps.min(), MAX_STEP_S):
            # The usual case, without medians: every step is a usual one.
            length = steps[begin - end :]
            speed, variance = self._filter(begin, end, length)
            self._knots = append_knots(self._knots, t, length, speed, variance)
        else:
            steps = np.append(np.inf, steps)[begin - end :]
            usual = usual_steps(self._raw[0], begin, end)
            whole = steps <= np.minimum(LONG_STEP * usual, MAX_STEP_S)
            length = np.where(whole, steps, np.where(usual <= MAX_STEP_S, usual, 0.0))
            speed, variance = self._filter(begin, end, length)
            self._append_with_holes(t, length, speed, variance, steps - length)
        if self._given_quantum is None:
            self._finder.add(v, length)
            if self._cautious_quantum() != self._found[-1][1]:
                self._found.append((float(t[-1]), self._cautious_quantum()))

    def _filter(self, begin: int, end: int, length: Array) -> tuple[Array, Array]:
        """Speeds with outliers replaced, and variances of the intervals' displacements [m^2]."""
        t, v, given = self._raw
        speed, variance = v[begin:end], given[begin:end] * (length * length)
        step = self._finder.noise_quantum if self._given_quantum is None else self.quantum
        found = find_outliers(t, v, begin, end, step)
        if found is None:
            return speed, variance
        outlier, median = found
        self.replaced += int(np.count_nonzero(outlier))
        in_doubt = variance + _unknown_distance(length) ** 2
        return np.where(outlier, median, speed), np.where(outlier, in_doubt, variance)

    def _append_with_holes(
        self, t: Array, length: Array, speed: Array, variance: Array, hole: Array
    ) -> None:
        """Add knots, one more at the end of each hole before an interval.

        hole : (n,) [s], infinite before the first sample
        """
        last = float(self._knots[MEAN, -1]) if self._knots.shape[1] else 0.0
        rows: list[tuple[float, float, float, float]] = []
        columns = (x.tolist() for x in (t, length, speed, variance, hole))
        for end, known, mean, var, missing in zip(*columns, strict=True):
            if known > 0.0 and missing > 0.0:
                bridged = missing if missing <= MAX_BRIDGE_S else -1.0
                doubt = _unknown_distance(missing) ** 2
                rows.append((end - known, bridged, 0.5 * (last + mean), doubt))
            rows.append((end, known if known > 0.0 else -1.0, mean, var))
            last = mean
        self._knots = append_knots(self._knots, *np.array(rows).T)

    def drop_before(self, time_s: float) -> None:
        """Forget what is long before `time_s`."""
        times = self.knots
        if times.shape[0] and times[0] < time_s - 2.0 * _DROP_S:
            self._knots = self._knots[:, int(times.searchsorted(time_s - _DROP_S)) :]

    def read(self, t: Array) -> Stretch | None:
        """The track at times t (n,), which increase; None where it is not known all the way.

        The variance is as far as the samples tell theirs, and that of bridged holes.
        """
        return read_knots(self._knots, t)


_Length = TypeVar("_Length", Array, float)


def _unknown_distance(length: _Length) -> _Length:
    """Sigma of the displacement in a time without a sample of its own [m]."""
    return 0.5 * UNKNOWN_ACCELERATION * length * length
