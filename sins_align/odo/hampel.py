"""Hampel filter of an odometer's speeds: what stands out among its neighbours is replaced.

A sample's window are up to four samples on either side, none further away in time than
`HAMPEL_S`. Where it holds five at least, and the sample differs from their median by more than
the threshold, the median takes its place.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sins_align.types import Array

HAMPEL_SIDE = 4
HAMPEL_S = 0.45
HAMPEL_LEAST = 5
HAMPEL_M_S = 0.9
# A threshold near one step of quantisation biases the scale: three of them, and some rounding.
HAMPEL_QUANTA = 3.1
# Slower than this a window holds too few samples, and no sample has to wait for the next ones.
HAMPEL_INTERVAL_S = 2.0 * HAMPEL_S / (HAMPEL_LEAST - 1)

# The usual interval between samples is the median of so many steps.
MEDIAN_STEPS = 21


def usual_steps(t: Array, begin: int, end: int) -> Array:
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


def is_slow(t: Array, index: int) -> bool:
    """Whether samples come too slowly at one of t (n,) for a filter."""
    if index >= MEDIAN_STEPS:  # quick answers
        known = t[index - MEDIAN_STEPS : index + 1]
        if known[-1] - known[0] < (MEDIAN_STEPS + 1) // 2 * HAMPEL_INTERVAL_S:
            return False
        if (known[1:] - known[:-1]).min() > HAMPEL_INTERVAL_S:
            return True
    return bool(usual_steps(t, index, index + 1)[0] > HAMPEL_INTERVAL_S)


def find_outliers(
    t: Array, v: Array, begin: int, end: int, quantum: float
) -> tuple[NDArray[np.bool_], Array] | None:
    """Which of the samples begin to end stand out, and the medians: (end - begin,) each.

    None: none does.

    Parameters
    ----------
    t, v : (n,) times [s] and speeds [m/s]
    quantum : distance of one count [m]
    """
    first, last = max(begin - HAMPEL_SIDE, 0), end + HAMPEL_SIDE
    near = v[first:last]
    if near.shape[0] < HAMPEL_LEAST:
        return None
    # Quick answers for nearly all. Half of a window can only be apart from a sample when one of
    # the two next ones on either side is.
    one, two = np.abs(near[1:] - near[:-1]), np.abs(near[2:] - near[:-2])
    if one.max() <= HAMPEL_M_S and two.max() <= HAMPEL_M_S:
        return None
    # No window can hold enough.
    spans = t[first + HAMPEL_LEAST - 1 : last] - t[first : first + near.shape[0] - HAMPEL_LEAST + 1]
    if spans.min() > 2.0 * HAMPEL_S:
        return None
    usual = usual_steps(t, begin, end)
    threshold = np.maximum(HAMPEL_M_S, HAMPEL_QUANTA * quantum / usual)
    threshold[usual > HAMPEL_INTERVAL_S] = np.inf
    median = _window_median(t, v, begin, end)
    outlier = np.abs(v[begin:end] - median) > threshold  # NaN: too few in the window
    return (outlier, median) if outlier.any() else None


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
