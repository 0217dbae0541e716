"""When an output is due: on a grid of the data's own stamps."""

from __future__ import annotations

import numpy as np

from sins_align.types import Array, Estimate, ImuSamples


class PublishGrid:
    """Multiples of the output period on the time axis of the stamps.

    Which samples an output falls on depends on their stamps alone, so that a live run and a
    replay give it for the same ones.
    """

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = max(1, round(1e9 / rate_hz))
        self._next_ns = 0
        # A stamp that is older than this is no late sample: time has jumped back.
        self._reach_ns = max(self._period_ns, 1_000_000_000)

    def reached(self, stamp_ns: int) -> bool:
        """True for the first sample in a new cell of the grid, also where time jumps back."""
        if self._next_ns - self._reach_ns <= stamp_ns < self._next_ns:
            return False
        self._next_ns = stamp_ns - stamp_ns % self._period_ns + self._period_ns
        return True


def find_sample(
    samples: ImuSamples, stamp_ns: int, estimate: Estimate | None
) -> tuple[Array, Array] | None:
    """Rate and specific force (3,) of the sample at `stamp_ns`, for which an output is due.

    None where the estimate is of another time. So it is where that sample was refused or is
    kept back until the next confirms it; after a jump of time the estimate is an old one.
    """
    if estimate is None or estimate.stamp_ns != stamp_ns:
        return None
    found = samples.select(samples.stamp_ns == stamp_ns)
    if not len(found) or not np.isfinite(found.w_ib_b + found.f_ib_b).all():
        return None
    return found.w_ib_b[:, 0], found.f_ib_b[:, 0]
