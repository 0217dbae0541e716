"""Integrals over windows: what a block of samples is for a filter.

All of them are in the body axes at the first stamp of the block, frozen in inertial space.
With C(t) the rotation from b(t) to these axes, a window gives

    u = int C f dt        s = int int C f dt dt        B = int C dt        BB = int int C dt dt

by the rules of `increments`; from 200 Hz on they agree with the truth of a swing to the rounding
of the stamps.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sins_align.gaps import fill_gaps, has_gap
from sins_align.increments import (
    mean_increments,
    rotation_increments,
    stencil_weights,
    uniform_step,
)
from sins_align.rotation import (
    cumulative_rotation,
    dcm_from_quaternion,
    quaternion_from_rotation_vector,
)
from sins_align.types import Array, ImuBlock, ImuSampling, IntArray


class Windows(NamedTuple):
    """Integrals over consecutive windows of one block.

    duration_s : (W,) lengths
    u, s : (W, 3) [m/s], [m]
    B, BB : (W, 3, 3) [s], [s^2]
    C_end : (W, 3, 3) rotation of b at the end of the window to the axes of the block
    q_end : (4,) the same at the end of the last window, as a quaternion
    """

    duration_s: Array
    u: Array
    s: Array
    B: Array
    BB: Array
    C_end: Array
    q_end: Array


class _Nodes(NamedTuple):
    """The integrands at the stamps t (n+1,) of a block.

    step : uniform step [s], None where the stamps are irregular
    q : (4, n+1) rotation of b to b at the first stamp
    rows : (12, n+1) C (9), and what sums to u (3): C f at the nodes or, for interval means,
        its integral over the interval that begins there
    """

    t: Array
    step: float | None
    q: Array
    rows: Array

    @property
    def C(self) -> Array:
        """(3, 3, n+1) as q."""
        return self.rows[:9].reshape(3, 3, -1)


def _rotate_nodes(stamp_ns: IntArray, values: Array, sampling: ImuSampling) -> _Nodes:
    t = (stamp_ns - stamp_ns[0]) * 1e-9
    step = uniform_step(t)
    f = values[3:]
    if sampling is ImuSampling.MEAN:
        theta, du = mean_increments(t, values, step)
        f = np.zeros_like(f)
        f[:, :-1] = du
    else:
        theta = rotation_increments(t, values[:3], sampling, step)
    q = cumulative_rotation(quaternion_from_rotation_vector(theta))
    rows = np.empty((12, t.shape[0]))
    C = dcm_from_quaternion(q, out=rows[:9].reshape(3, 3, -1))
    np.einsum("ijn,jn->in", C, f, out=rows[9:])
    return _Nodes(t, step, q, rows)


class Window(NamedTuple):
    """The integrals over one window, as in `Windows`, and over paths travelled in it.

    paths : (k, 3, 3) int C dS, None where there are none
    """

    duration_s: float
    u: Array
    s: Array
    B: Array
    BB: Array
    C_end: Array
    q_end: Array
    paths: Array | None


def integrate_window(
    stamp_ns: IntArray, values: Array, sampling: ImuSampling, travelled: Array | None = None
) -> Window:
    """The integrals over samples as one window.

    Parameters
    ----------
    stamp_ns : (n+1,); values : (6, n+1) rate and specific force, as in `ImuBlock`
    travelled : (k, n+1) functions S of time at the stamps; trapezoidal rule
    """
    if has_gap(stamp_ns):
        filled = fill_gaps(ImuBlock(stamp_ns, values[:3], values[3:]))
        if travelled is not None:
            old, new = (ns - stamp_ns[0] for ns in (stamp_ns, filled.stamp_ns))
            travelled = np.stack([np.interp(new, old, S) for S in travelled])
        stamp_ns, values = filled.stamp_ns, np.concatenate((filled.w_ib_b, filled.f_ib_b))
    t, step, q, rows = _rotate_nodes(stamp_ns, values, sampling)
    n = t.shape[0] - 1
    sums = rows @ (_shifted_weights(_node_weights(t)) if step is None else _step_weights(n, step))
    B, BB = sums[:9, 0].reshape(3, 3), sums[:9, 1].reshape(3, 3)
    first = 2 if sampling is ImuSampling.MEAN else 0
    u, s = sums[9:, first], sums[9:, first + 1]
    paths = None
    if travelled is not None:
        # int C dS = sum of C_k times half the way between its neighbours.
        weights = np.empty(travelled.shape)
        weights[:, 1:-1] = travelled[:, 2:] - travelled[:, :-2]
        weights[:, 0] = travelled[:, 1] - travelled[:, 0]
        weights[:, -1] = travelled[:, -1] - travelled[:, -2]
        paths = (0.5 * (weights @ rows[:9].T)).reshape(-1, 3, 3)
    C_end = rows[:9, -1].reshape(3, 3)
    return Window(float(t[-1]), u, s, B, BB, C_end, q[:, -1], paths)


def _shifted_weights(weights: Array) -> Array:
    """`_node_weights` with those of an interval's increment where the interval begins."""
    shifted = weights.copy()
    shifted[:-1, 2:] = weights[1:, 2:]
    shifted[-1, 2:] = 0.0
    return shifted


@lru_cache(maxsize=64)
def _step_weights(n: int, step: float) -> Array:
    """`_shifted_weights` of n intervals of length `step`."""
    return _shifted_weights(_unit_weights(n)) * np.array([step, step * step, 1.0, step])


def integrate_windows(block: ImuBlock, sampling: ImuSampling, count: int) -> Windows:
    """The integrals over `count` windows of about equal length.

    Parameters
    ----------
    block : samples of which the first and the last stamp are the ends of the windows
    count : number of windows; fewer where there are not three intervals for each
    """
    block = fill_gaps(block)
    values = np.concatenate((block.w_ib_b, block.f_ib_b))
    nodes = _rotate_nodes(block.stamp_ns, values, sampling)
    t = nodes.t
    n = t.shape[0] - 1
    count = max(1, min(count, n // 3))
    edges = np.searchsorted(t, np.arange(1, count) * (t[-1] / count) - 0.25 * t[-1] / n)
    return _sum_windows(nodes, sampling, [0, *edges.tolist(), n])


def _sum_windows(nodes: _Nodes, sampling: ImuSampling, edges: list[int]) -> Windows:
    t, step, q, rows = nodes
    count = len(edges) - 1
    sums = np.empty((count, 12, 2))
    for k, (a, b) in enumerate(pairwise(edges)):
        weights = _node_weights(t[a : b + 1]) if step is None else _unit_weights(b - a)
        if sampling is ImuSampling.MEAN:
            np.matmul(rows[:9, a : b + 1], weights[:, :2], out=sums[k, :9])
            np.matmul(rows[9:, a:b], weights[1:, 2:], out=sums[k, 9:])
        else:
            np.matmul(rows[:, a : b + 1], weights[:, :2], out=sums[k])
    if step is not None:
        powers = np.array([step, step * step])
        sums[:, :9] *= powers
        sums[:, 9:] *= powers / step if sampling is ImuSampling.MEAN else powers
    B, BB = sums[:, :9].reshape(count, 3, 3, 2).transpose(3, 0, 1, 2)
    u, s = sums[:, 9:].transpose(2, 0, 1)
    C_end = nodes.C[:, :, edges[1:]].transpose(2, 0, 1)
    return Windows(np.diff(t[edges]), u, s, B, BB, C_end, q[:, -1])


@lru_cache(maxsize=64)
def _unit_weights(n: int) -> Array:
    """Those of n intervals of length 1."""
    return _node_weights(np.arange(n + 1.0))


def _node_weights(t: Array) -> Array:
    """Weights of one window with nodes t (n+1,), by column (n+1, 4).

    0, 1 : on nodes, of int g dt and of int int g dt dt = int (T - t) g dt
    2, 3 : on the increments int g dt of the intervals, from row 1 on, of the same two
    """
    start, single, double = stencil_weights(t)
    columns = start[:, None] + np.arange(single.shape[1])
    weights = np.zeros((t.shape[0], 4))
    np.add.at(weights[:, 0], columns, single)
    np.add.at(weights[:, 1], columns, double)
    weights[1:, 2] = 1.0
    # With I_k the sum of the increments up to node k, int I dt = sum_k w_k I_k.
    weights[1:, 3] = np.cumsum(weights[::-1, 0])[::-1][1:]
    return weights
