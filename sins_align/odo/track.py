"""Distance over time from an odometer's mean speeds.

Between knots at the samples' stamps the distance S is a cubic with the knots' S and slopes.
S at a knot is the sum of speed times interval, exact for mean speeds; the slope at a knot is
that of the parabola through the knot and its two neighbours.
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np

from sins_align.odo.odometer_intake import MAX_LATE_NS
from sins_align.odo.quantum import QuantumFinder
from sins_align.types import Array, IntArray, OdometerSamples

# The usual interval between samples is the median of so many steps.
MEDIAN_STEPS = 21
# Up to so many usual intervals a step is one long interval; beyond, samples are missing.
LONG_STEP = 1.5
# Of a longer step nothing is known but its end.
MAX_STEP_S = 2.0
# Shorter holes are bridged, with the variance of an unknown acceleration.
MAX_BRIDGE_S = 0.35
UNKNOWN_ACCELERATION = 2.0  # [m/s^2], 1 sigma

# Hampel filter: so many samples on either side, no further away than this, and so many in all.
HAMPEL_SIDE = 4
HAMPEL_S = 0.45
HAMPEL_LEAST = 5
HAMPEL_M_S = 0.9
# A threshold near one step of quantisation biases the scale.
HAMPEL_QUANTA = 3.0
# Slower than this a window holds too few samples, and no sample has to wait for the next ones.
HAMPEL_INTERVAL_S = 2.0 * HAMPEL_S / (HAMPEL_LEAST - 1)

# Judged samples that are kept for the windows of the next ones.
_CONTEXT = MEDIAN_STEPS + 1
# Times that differ by less are the same.
SAME_S = 1e-6
# Knots so much older than needed are dropped.
_DROP_S = 10.0

# Rows of the table of knots. The interval is the one that ends at the knot; not GOOD: nothing
# is known of it. SUM and VARIANCE are summed over the intervals up to the knot.
TIME, SUM, MEAN, LENGTH, GOOD, VARIANCE, SLOPE = range(7)


class Stretch(NamedTuple):
    """The track over a stretch of time.

    distance : (n,) S [m]
    speed : (n,) its derivative [m/s]
    variance : of the displacement from the first to the last time [m^2], as far as the
        samples tell theirs, and of the holes bridged
    """

    distance: Array
    speed: Array
    variance: float


class OdometerTrack:
    """Distance over time; a function of the samples in their order, not of the chunks.

    A sample is judged by the Hampel filter once all that can be in its window is there:
    `settle`. A sample that comes later than that is refused.

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
        self._clear()

    def _clear(self) -> None:
        self.origin_ns: int | None = None
        self._newest_ns = 0
        self._parts: list[OdometerSamples] = []  # not in `_raw` yet
        self._raw: Array = np.empty((3, 0))  # time, speed, variance
        self._done = 0  # how many of them are judged
        self._knots: Array = np.empty((7, 0))

    @property
    def quantum(self) -> float:
        """Distance of one count [m], 0 where there is none or it is not known."""
        return self._finder.quantum if self._given_quantum is None else self._given_quantum

    @property
    def knots(self) -> Array:
        """(K,) times of the knots settled so far [s]."""
        return self._knots[TIME]

    def times(self, stamp_ns: IntArray) -> Array:
        """(n,) stamps in the track's own time [s]."""
        assert self.origin_ns is not None
        return np.asarray((stamp_ns - self.origin_ns) * 1e-9, dtype=np.float64)

    def begins_at(self, knot: int) -> bool:
        """Whether nothing is known of the time before a knot."""
        return not self._knots[GOOD, knot]

    def add(self, samples: OdometerSamples) -> None:
        """Take in samples as `OdometerIntake` gives them."""
        if len(samples) == 0:
            return
        stamps = samples.stamp_ns
        if self.origin_ns is None:
            self.origin_ns = int(stamps[0])
            self._newest_ns = self.origin_ns - 1
        if stamps[0] > self._newest_ns and (len(samples) == 1 or np.diff(stamps).min() > 0):
            self._newest_ns = int(stamps[-1])
            self._parts.append(samples)
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
        t = float(self.times(sample.stamp_ns)[0])
        place = int(np.searchsorted(self._raw[0], t))
        if place < self._done or self._done == 0 or self._raw[0, place] == t:
            self.too_late += 1
            return
        column = np.array([[t], sample.speed, sample.variance])
        self._raw = np.concatenate((self._raw[:, :place], column, self._raw[:, place:]), axis=1)

    def settle(self, until_s: float = -np.inf) -> None:
        """Judge the samples whose window is whole, and all up to `until_s` as they are."""
        self._gather()
        end = self._find_final(until_s)
        while self._done < end:
            # What the finder found holds for the samples after those it looked at.
            begin = self._done
            moving = self._raw[1, begin:end] != 0.0
            stop = begin + self._finder.count_until_search(moving)
            self._judge(begin, stop)
            self._done = stop
        surplus = self._done - _CONTEXT
        if surplus > 0:
            self._raw = self._raw[:, surplus:]
            self._done = _CONTEXT

    def _gather(self) -> None:
        if not self._parts:
            return
        stamps, speeds, variances = zip(*self._parts, strict=True)
        new = np.empty((3, sum(map(len, speeds))))
        new[0] = self.times(np.concatenate(stamps))
        np.concatenate(speeds, out=new[1])
        np.concatenate(variances, out=new[2])
        self._raw = np.concatenate((self._raw, new), axis=1)
        self._parts = []

    def _find_final(self, until_s: float) -> int:
        """Index of the first sample that cannot be judged yet."""
        t = self._raw[0]
        size = t.shape[0]
        if size == self._done:
            return size
        waiting = t[self._done :]
        end = max(
            self._done + int(np.count_nonzero(t[-1] - waiting > HAMPEL_S)),
            self._done + int(np.count_nonzero(waiting <= until_s)),
            size - HAMPEL_SIDE,
        )
        while end < size and _usual_steps(t, end, end + 1)[0] > HAMPEL_INTERVAL_S:
            end += 1
        return end

    def _judge(self, begin: int, end: int) -> None:
        """Filter samples begin to end, and make knots of them."""
        t = self._raw[0]
        usual = _usual_steps(t, begin, end)
        steps = np.full(end - begin, np.inf)
        first = max(begin, 1)
        steps[first - begin :] = t[first:end] - t[first - 1 : end - 1]
        covered = np.minimum(steps, np.where(steps <= MAX_STEP_S, LONG_STEP * usual, 0.0))
        whole = covered == steps
        length = np.where(whole, steps, np.where(usual <= MAX_STEP_S, usual, 0.0))
        self._finder.add(self._raw[1, begin:end], length, usual)
        speed, variance = self._filter(begin, end, usual, length)
        if whole.all():
            rows = np.array([t[begin:end], speed, length, variance])
            self._append(rows, np.ones(end - begin))
        else:
            self._append_with_holes(t[begin:end], speed, steps, whole, length, variance)

    def _filter(self, begin: int, end: int, usual: Array, length: Array) -> tuple[Array, Array]:
        """Speeds with outliers replaced, and variances of the intervals' displacements [m^2]."""
        t, v, given = self._raw
        speed, variance = v[begin:end], given[begin:end] * length * length
        near = v[max(begin - HAMPEL_SIDE, 0) : end + HAMPEL_SIDE]
        if near.shape[0] < HAMPEL_LEAST or near.max() - near.min() <= HAMPEL_M_S:
            return speed, variance
        step = self._finder.assumed_quantum if self._given_quantum is None else self.quantum
        threshold = np.maximum(HAMPEL_M_S, HAMPEL_QUANTA * step / usual)
        threshold[usual > HAMPEL_INTERVAL_S] = np.inf
        median = _window_median(t, v, begin, end)
        outlier = np.abs(speed - median) > threshold  # NaN: too few in the window
        if outlier.any():
            self.replaced += int(np.count_nonzero(outlier))
            speed = np.where(outlier, median, speed)
            variance = np.where(outlier, variance + _hole_variance(length), variance)
        return speed, variance

    def _append_with_holes(
        self, t: Array, speed: Array, steps: Array, whole: Array, length: Array, variance: Array
    ) -> None:
        """Knots where there is one more at the end of each hole."""
        last = self._last_speed()
        rows: list[tuple[float, float, float, float]] = []
        good: list[float] = []
        values = zip(*(x.tolist() for x in (t, speed, steps, whole, length, variance)), strict=True)
        for time, mean, step, is_whole, interval, var in values:
            hole = step - interval
            if not is_whole and interval > 0.0:
                bridge = 0.0 < hole <= MAX_BRIDGE_S
                rows.append((time - interval, 0.5 * (last + mean), hole, _hole_variance(hole)))
                good.append(float(bridge))
            rows.append((time, mean, interval, var))
            good.append(float(interval > 0.0))
            last = mean
        self._append(np.array(rows).T, np.array(good))

    def _last_speed(self) -> float:
        return float(self._knots[MEAN, -1]) if self._knots.shape[1] else 0.0

    def _append(self, rows: Array, good: Array) -> None:
        """Add knots: rows of time, mean, length and variance (4, n)."""
        old = self._knots.shape[1]
        knots = np.zeros((7, old + good.shape[0]))
        knots[:, :old] = self._knots
        knots[[TIME, MEAN, LENGTH, VARIANCE], old:] = rows
        knots[GOOD, old:] = good
        # As long sums, one after the other: the same bits however many come at once.
        knots[SUM, old:] = rows[1] * np.where(good > 0.0, rows[2], 0.0)
        knots[VARIANCE, old:] *= good
        first = max(old - 1, 0)
        for row in (SUM, VARIANCE):
            np.cumsum(knots[row, first:], out=knots[row, first:])
        self._knots = knots
        # With the new ones the slopes of the last two old ones change.
        _set_slopes(knots[:, max(old - 3, 0) :], min(old, 3) - min(old, 2))

    def drop_before(self, time_s: float) -> None:
        """Forget what is long before `time_s`."""
        times = self.knots
        if times.shape[0] and times[0] < time_s - 2.0 * _DROP_S:
            self._knots = self._knots[:, int(np.searchsorted(times, time_s - _DROP_S)) :]

    def read(self, t: Array) -> Stretch | None:
        """The track at times t (n,), which increase; None where it is not known all the way."""
        times = self.knots
        # Intervals first to last, each counted by the knot at its end.
        first = int(times.searchsorted(t[0] + SAME_S, side="right"))
        last = int(times.searchsorted(t[-1] - SAME_S))
        if first == 0 or last == times.shape[0] or not self._knots[GOOD, first : last + 1].all():
            return None
        left, right = self._knots[:, first - 1 : last], self._knots[:, first : last + 1]
        mean, length, v0, v1 = right[MEAN], right[LENGTH], left[SLOPE], right[SLOPE]
        square = (3.0 * mean - 2.0 * v0 - v1) / length
        cube = (v0 + v1 - 2.0 * mean) / (length * length)
        table = np.array([left[TIME], left[SUM], v0, square, cube])
        place = left[TIME, 1:].searchsorted(t, side="right")
        begin, S, v, a, b = table.take(place, axis=1)
        u = t - begin
        au, bu = a * u, b * u
        distance = S + u * (v + u * (a + bu))
        speed = v + (2.0 * au + 3.0 * u * bu)
        share = u[[0, -1]] / length[place[[0, -1]]]
        sums = left[VARIANCE, place[[0, -1]]]
        rise = right[VARIANCE, place[[0, -1]]] - sums
        low, high = sums + share * rise
        return Stretch(distance, speed, float(max(high - low, 0.0)))


def _usual_steps(t: Array, begin: int, end: int) -> Array:
    """(end - begin,) median of the last steps up to each sample, infinite before there is one.

    The lower one of two: a long step at the start must not pass for usual.
    """
    steps = np.full(MEDIAN_STEPS + end - begin - 1, np.inf)
    known = t[max(begin - MEDIAN_STEPS, 0) : end]
    steps[steps.shape[0] - known.shape[0] + 1 :] = known[1:] - known[:-1]
    windows = steps[np.arange(end - begin)[:, None] + np.arange(MEDIAN_STEPS)]
    windows.sort(axis=1)
    count = np.arange(begin, end).clip(1, MEDIAN_STEPS)
    return windows[np.arange(end - begin), (count - 1) // 2]


def _window_median(t: Array, v: Array, begin: int, end: int) -> Array:
    """(end - begin,) median of the speeds around each sample, NaN where there are too few."""
    index = np.arange(begin, end)[:, None] + np.arange(-HAMPEL_SIDE, HAMPEL_SIDE + 1)
    inside = index.clip(0, t.shape[0] - 1)
    near = (inside == index) & (np.abs(t[inside] - t[begin:end, None]) <= HAMPEL_S)
    window = np.where(near, v[inside], np.inf)
    window.sort(axis=1)
    count = near.sum(axis=1)
    row = np.arange(end - begin)
    median = 0.5 * (window[row, (count - 1) // 2] + window[row, count // 2])
    median[count < HAMPEL_LEAST] = np.nan
    return median


_Length = TypeVar("_Length", Array, float)


def _hole_variance(length: _Length) -> _Length:
    """Of the displacement in a time without a sample of its own [m^2]."""
    distance = 0.5 * UNKNOWN_ACCELERATION * length * length
    return distance * distance


def _set_slopes(knots: Array, begin: int) -> None:
    """Set the slopes of knots from index `begin` on; those before are only neighbours."""
    mean, length, good = knots[MEAN], knots[LENGTH], knots[GOOD] > 0.0
    size = mean.shape[0]
    # Each interval's neighbours: the change of mean speed over half the sum of the lengths.
    before = np.zeros(size)  # half a length of the interval times its acceleration, at its end
    after = np.zeros(size)  # the same at its begin, from the interval that follows
    both = good[1:] & good[:-1]
    rise = np.where(both, mean[1:] - mean[:-1], 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.where(both, rise / (length[1:] + length[:-1]), 0.0)
    before[1:] = slope * length[1:]
    after[:-1] = slope * length[:-1]
    # At the end of an interval: towards the one that follows where there is one.
    has_next = np.zeros(size, dtype=bool)
    has_next[:-1] = both
    end = mean + np.where(has_next, after, before)
    # Where an interval begins a stretch, its begin is a knot of no other interval.
    begins = np.zeros(size, dtype=bool)
    begins[:-1] = good[1:] & ~good[:-1]
    start = np.zeros(size)
    start[:-1] = mean[1:] - after[1:]
    knots[SLOPE, begin:] = np.where(begins, start, end)[begin:]
