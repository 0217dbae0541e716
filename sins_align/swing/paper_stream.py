"""Blocks of samples as stretches with what the paper's method needs at every stamp."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sins_align.gaps import fill_gaps
from sins_align.increments import rotation_increments, uniform_step
from sins_align.types import Array, ImuBlock, ImuSampling


class Stretch(NamedTuple):
    """N intervals, N + 1 stamps; a stretch begins at the stamp where the last one ended.

    t : (N+3,) stamps from the first of the stretch [s], with one before and one after it
    w_ib_b : (3, N+3) instantaneous rate at t [rad/s]
    f_ib_b : (3, N+1) instantaneous specific force at t[1:-1] [m/s^2]
    theta : (3, N) rotation vectors of the intervals [rad]
    """

    t: Array
    w_ib_b: Array
    f_ib_b: Array
    theta: Array


class SampleStream:
    """Cuts blocks into stretches that end a little before the block.

    The derivative of the rate needs the next sample: a stretch ends one sample before its
    block. Interval means are turned into instantaneous values at the stamps by averaging two
    neighbours, which takes another sample; their rotation vectors are those of the intervals
    and lag nowhere. `ahead` is the rotation over what is left.
    """

    def __init__(self, sampling: ImuSampling) -> None:
        self._sampling = sampling
        self._lag = 2 if sampling is ImuSampling.MEAN else 1
        self._held: ImuBlock | None = None

    def extend(self, block: ImuBlock) -> Stretch | None:
        """The next stretch; None while there are too few samples for one."""
        samples = self._append(block)
        count = samples.stamp_ns.size
        if count < self._lag + 3:
            self._held = samples
            return None
        end = count - 1 - self._lag  # last stamp of the stretch; its first one is 1
        t = (samples.stamp_ns - samples.stamp_ns[1]) * 1e-9
        w, f = (self._at_stamps(x) for x in (samples.w_ib_b, samples.f_ib_b))
        self._held = ImuBlock(samples.stamp_ns[end - 1 :], *(x[:, end - 1 :] for x in samples[1:]))
        theta = self._increments(samples)[:, 1:end]
        return Stretch(t[: end + 2], w[:, : end + 2], f[:, 1 : end + 1], theta)

    def ahead(self, block: ImuBlock | None = None) -> tuple[float, Array]:
        """From the end of the last stretch to the last sample, or to the end of `block`.

        Returns the time [s] and the rotation vectors (3, n); changes nothing.
        """
        samples = self._held if block is None else self._append(block)
        assert samples is not None
        elapsed = float(samples.stamp_ns[-1] - samples.stamp_ns[1]) * 1e-9
        return elapsed, self._increments(samples)[:, 1:]

    def _append(self, block: ImuBlock) -> ImuBlock:
        block = fill_gaps(block)
        held = self._held
        if held is None:
            return block
        return ImuBlock(
            np.concatenate((held.stamp_ns, block.stamp_ns[1:])),
            np.concatenate((held.w_ib_b, block.w_ib_b[:, 1:]), axis=1),
            np.concatenate((held.f_ib_b, block.f_ib_b[:, 1:]), axis=1),
        )

    def _at_stamps(self, values: Array) -> Array:
        if self._sampling is ImuSampling.INSTANTANEOUS:
            return values
        between: Array = 0.5 * (values[:, :-1] + values[:, 1:])
        return between

    def _increments(self, samples: ImuBlock) -> Array:
        t = (samples.stamp_ns - samples.stamp_ns[0]) * 1e-9
        return rotation_increments(t, samples.w_ib_b, self._sampling, uniform_step(t))
