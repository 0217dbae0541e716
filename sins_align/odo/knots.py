"""A distance over time that is a cubic between knots.

S at a knot is the sum of mean speed times interval; the slope at a knot is that of the parabola
through it and its neighbours, on one side where the other is not known.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sins_align.types import Array

# Rows of the table of knots. The interval is the one that ends at the knot; where it is not
# GOOD, nothing is known of it. SUM and VARIANCE are summed over the intervals up to the knot.
TIME, LENGTH, MEAN, GOOD, SUM, VARIANCE, SLOPE = range(7)
ROWS = 7

# Times that differ by less are the same.
SAME_S = 1e-6


class Stretch(NamedTuple):
    """The distance over a stretch of time.

    distance : (n,) S [m]
    speed : (n,) its derivative [m/s]
    variance : of the displacement from the first to the last time [m^2]
    """

    distance: Array
    speed: Array
    variance: float


def append_knots(old: Array, t: Array, length: Array, mean: Array, variance: Array) -> Array:
    """The table with knots added, all of their intervals good where `length` is positive.

    Parameters
    ----------
    old : (7, K) the table so far
    t, length, mean, variance : (n,) end and length of intervals [s], mean speed [m/s], variance
        of the displacement [m^2]; a negative length: nothing is known of the interval
    """
    size = old.shape[1]
    table = np.empty((ROWS, size + t.shape[0]))
    table[:, :size] = old
    new = table[:, size:]
    good = length > 0.0
    new[TIME], new[MEAN], new[GOOD] = t, mean, good
    np.abs(length, out=new[LENGTH])
    np.multiply(new[LENGTH] * mean, good, out=new[SUM])
    np.multiply(variance, good, out=new[VARIANCE])
    # As one long sum: the same bits however many come at once.
    sums = table[SUM : VARIANCE + 1, max(size - 1, 0) :]
    np.cumsum(sums, axis=1, out=sums)
    # The slopes of the last two old ones change with the new ones.
    first = max(size - 3, 0)
    _set_slopes(table[:, first:], max(size - 2, 0) - first)
    return table


def _set_slopes(table: Array, begin: int) -> None:
    """Set the slopes of knots from index `begin` on; those before are only neighbours."""
    mean, length, good = table[MEAN], table[LENGTH], table[GOOD]
    # Change of the mean speed from one interval to the next, as half an acceleration.
    rate = np.zeros(mean.shape[0] + 1)
    change, sums = mean[1:] - mean[:-1], length[1:] + length[:-1]
    # At the end of an interval: towards the one that follows where there is one.
    if good.all():
        np.divide(change, sums, out=rate[1:-1])
        rate[-1] = rate[-2]
        table[SLOPE, begin:] = (rate[1:] * length + mean)[begin:]
        return
    both = (good[1:] > 0.0) & (good[:-1] > 0.0)
    np.divide(change, sums, out=rate[1:-1], where=both)
    follows = np.append(both, False)
    slope = np.where(follows, rate[1:], rate[:-1]) * length + mean
    # Where an interval begins a stretch, its begin is a knot of no other interval.
    begins = np.flatnonzero(good[1:] > good[:-1])
    after = begins + 1
    slope[begins] = mean[after] - rate[after + 1] * length[after]
    table[SLOPE, begin:] = slope[begin:]


def read_knots(table: Array, t: Array) -> Stretch | None:
    """S at times t (n,), which increase; None where it is not known all the way."""
    times = table[TIME]
    # Intervals first to last, each counted by the knot at its end.
    first = int(times.searchsorted(t[0] + SAME_S, side="right"))
    last = int(times.searchsorted(t[-1] - SAME_S))
    if first == 0 or last == times.shape[0] or not table[GOOD, first : last + 1].all():
        return None
    left, right = table[:, first - 1 : last], table[:, first : last + 1]
    mean, length, v0, v1 = right[MEAN], right[LENGTH], left[SLOPE], right[SLOPE]
    cubic = np.empty((5, last - first + 1))
    cubic[0], cubic[1], cubic[2] = left[TIME], left[SUM], v0
    bend = (v0 + v1 - 2.0 * mean) / length
    cubic[3] = (mean - v0) / length - bend
    cubic[4] = bend / length
    place = cubic[0, 1:].searchsorted(t, side="right")
    begin, S, v, square, cube = cubic.take(place, axis=1)
    u = t - begin
    squared, cubed = square * u, cube * u * u
    distance = S + u * (v + squared + cubed)
    speed = v + 2.0 * squared + 3.0 * cubed
    low, high = (_variance_until(left, right, int(place[k]), float(u[k])) for k in (0, -1))
    return Stretch(distance, speed, max(high - low, 0.0))


def _variance_until(left: Array, right: Array, k: int, u: float) -> float:
    """Summed up to a time u into interval k."""
    begin = float(left[VARIANCE, k])
    return begin + (float(right[VARIANCE, k]) - begin) * u / float(right[LENGTH, k])
