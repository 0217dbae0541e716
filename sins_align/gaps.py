"""Lost samples: put in by interpolation of their neighbours."""

from __future__ import annotations

import numpy as np

from sins_align.types import Array, ImuBlock, IntArray

# Where so many samples are missing, the noise of the nearest ones must not decide; up to
# there the four nearest are as good as a fit, and quicker.
_LONG_GAP = 4
# Singular values of a fit: one sample before the gap and a stretch after it give 0.02, samples
# in clusters, which do not tell four coefficients, 2e-4.
_TOLD = 0.01
# Bursts of stamps on arrival make a median step that says nothing: no more than 20 kHz.
_LEAST_STEP_NS = 50_000.0

# Steps as even as this are those of a clock.
_EVEN = 0.01


def is_even(stamp_ns: IntArray) -> bool:
    """Whether the steps of the stamps (n+1,) [ns] are alike to a hundredth, as those of a clock."""
    steps = stamp_ns[1:] - stamp_ns[:-1]
    return float(steps.max() - steps.min()) <= _EVEN * float(steps.min())


def has_gap(stamp_ns: IntArray) -> bool:
    """Whether a step of the stamps (n+1,) [ns] is one and a half times the shortest or longer."""
    steps = stamp_ns[1:] - stamp_ns[:-1]
    return steps.shape[0] > 1 and 2 * int(steps.max()) >= 3 * int(steps.min())


def fill_gaps(block: ImuBlock) -> ImuBlock:
    """The block with lost samples put in, by cubic interpolation of their neighbours.

    A step that is k nominal intervals long gets k - 1 samples. For interval means the
    running mean is interpolated, which is what a lost sample would have carried.
    """
    if not has_gap(block.stamp_ns):
        return block
    steps = np.diff(block.stamp_ns)
    nominal = max(float(np.median(steps)), _LEAST_STEP_NS)
    missing = (np.rint(steps / nominal).astype(np.int64) - 1).clip(min=0)
    if missing.max() == 0:
        return block
    after = np.repeat(np.arange(steps.shape[0]), missing)
    place = np.concatenate([np.arange(1, m + 1) for m in missing[missing > 0]])
    share = place / (missing[after] + 1.0)
    stamps = block.stamp_ns[after] + np.rint(share * steps[after]).astype(np.int64)
    values = np.concatenate((block.w_ib_b, block.f_ib_b))
    filled = _interpolate(block.stamp_ns, values, after, stamps)
    for gap in np.flatnonzero(missing >= _LONG_GAP):
        inside = slice(*np.searchsorted(after, (gap, gap + 1)))
        filled[:, inside] = _fit(block.stamp_ns, values, int(gap), stamps[inside])
    values = np.insert(values, after + 1, filled, axis=1)
    return ImuBlock(np.insert(block.stamp_ns, after + 1, stamps), values[:3], values[3:])


def _fit(stamp_ns: IntArray, values: Array, gap: int, wanted: IntArray) -> Array:
    """Cubic by least squares through as long a stretch on either side as the gap is long.

    The cubic through the four nearest samples would multiply their noise, and vibration, by
    the length of the gap in samples.
    """
    length = stamp_ns[gap + 1] - stamp_ns[gap]
    first, end = np.searchsorted(stamp_ns, (stamp_ns[gap] - length, stamp_ns[gap + 1] + length))
    # Two samples on either side, where there are.
    near = slice(max(min(first, gap - 1), 0), max(end, gap + 3))
    middle, scale = stamp_ns[gap] + length // 2, 1.0 / length
    t = (stamp_ns[near] - middle) * scale
    mean = values[:, near].mean(axis=1)
    fit = np.linalg.lstsq(np.vander(t, 4), values[:, near].T - mean, rcond=_TOLD)[0]
    return (np.vander((wanted - middle) * scale, 4) @ fit + mean).T


def _interpolate(stamp_ns: IntArray, values: Array, after: IntArray, wanted: IntArray) -> Array:
    """Local Lagrange interpolation through up to four samples around `wanted`."""
    size = min(4, stamp_ns.shape[0])
    start = np.clip(after - 1, 0, stamp_ns.shape[0] - size)
    index = start[:, None] + np.arange(size)
    t = (stamp_ns[index] - wanted[:, None]) * 1e-9
    weights = np.ones(t.shape)
    for j in range(size):
        for m in range(size):
            if m != j:
                weights[:, j] *= t[:, m] / (t[:, m] - t[:, j])
    return np.einsum("anj,nj->an", values[:, index], weights)
