"""Whether the stamps are those of the samples: jitter of stamps is noise of the attitude.

A stamp that is off by d makes an error w d of the angle before it, and the same with the other
sign after it; what is left is d times the change of w, a random walk of the angle with

    sigma_d  rms(w_k+1 - w_k) / sqrt(dt)        [rad/sqrt(s)]

A base that does not move does not mind. That uneven stamps are wrong, and not those of a sensor
that samples unevenly, shows in the values: they are smoother by their number than by their stamps.
Where a vehicle shakes they are smooth by neither; then uneven stamps are believed as long as the
harm is small.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sins_align.gaps import is_even
from sins_align.reasons import STAMP_JITTER, Finding
from sins_align.types import Array, ImuBlock

# Jitter counts when its random walk is so many times that of the gyros, and
MOST_WALK = 1.0
# when what the stamps leave of the second difference is so many times what numbers leave; or when
# it is so many times that of the gyros, and the stamps do not leave less by as much.
ROUGHER, MOST_UNTOLD_WALK = 1.1, 5.0
MEMORY = 30  # blocks


class StampWatch:
    """Watches blocks of samples.

    Parameters
    ----------
    gyro_noise : declared angle random walk [rad/sqrt(s)]
    """

    def __init__(self, gyro_noise: float) -> None:
        self._gyro_noise = gyro_noise
        self._walk = self._jitter = self._by_number = self._by_stamp = 0.0  # mean squares

    def update(self, block: ImuBlock) -> None:
        """Take in a block."""
        steps = np.diff(block.stamp_ns) * 1e-9
        jitter = walk = by_number = by_stamp = 0.0
        if steps.shape[0] > 3 and not is_even(block.stamp_ns):
            usual = float(np.median(steps))
            w, inner = block.w_ib_b, np.abs(steps / usual - 1.0) < 0.9  # a lost sample is no jitter
            jitter = 0.5 * float(np.mean((steps[inner] - usual) ** 2)) if inner.any() else 0.0
            change = np.diff(w, axis=1)
            walk = jitter * float(np.mean((change**2).sum(axis=0))) / usual
            both = inner[1:] & inner[:-1]
            by_number = _roughness(change, np.ones_like(steps), both)
            by_stamp = _roughness(change, steps / usual, both)
        share = 1.0 / MEMORY
        self._jitter += share * (jitter - self._jitter)
        self._walk += share * (walk - self._walk)
        self._by_number += share * (by_number - self._by_number)
        self._by_stamp += share * (by_stamp - self._by_stamp)

    @property
    def finding(self) -> Finding | None:
        """What is wrong with the stamps, None where nothing is."""
        noise = self._gyro_noise**2
        is_wrong = self._by_stamp > ROUGHER**2 * self._by_number
        is_right = self._by_number > ROUGHER**2 * self._by_stamp
        most = MOST_WALK if is_wrong else MOST_UNTOLD_WALK
        if is_right or not self._walk > most**2 * noise:
            return None
        ratio = math.sqrt(self._walk) / self._gyro_noise if self._gyro_noise > 0.0 else math.inf
        return STAMP_JITTER(jitter_ms=1e3 * math.sqrt(self._jitter), ratio=ratio)


def _roughness(change: Array, steps: Array, used: NDArray[np.bool_]) -> float:
    """Mean square of the change of slope (3, N-1) over steps (N,), at the middles of `used`."""
    slope = change / steps
    bend = (slope[:, 1:] - slope[:, :-1])[:, used]
    return float(np.mean((bend**2).sum(axis=0))) if bend.size else 0.0
