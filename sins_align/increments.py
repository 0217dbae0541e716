"""From samples to integrals over windows: attitude, velocity, position and their partials.

All integrals are in the body axes at the first stamp of the block, frozen in inertial
space. With C(t) the rotation from b(t) to these axes, a window gives

    u = int C f dt        s = int int C f dt dt        B = int C dt        BB = int int C dt dt

Rules are of fourth order in the sampling interval for both kinds of sampling and for
irregular stamps (u, s of interval means: third); from 200 Hz on they agree with the truth of
a swing to the rounding of the stamps.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sins_align.gaps import fill_gaps, has_gap
from sins_align.rotation import (
    cross,
    cumulative_rotation,
    dcm_from_quaternion,
    quaternion_from_rotation_vector,
)
from sins_align.types import Array, ImuBlock, ImuSampling, IntArray

# Stamps closer to a uniform grid than this are treated as uniform.
_UNIFORM_REL = 1e-6
_UNIFORM_ABS_S = 2e-9
# A cubic through nodes of such unequal steps would multiply noise: the straight line does not.
_UNEVEN = 5.0
# Gauss-Legendre nodes and weights on [0, 1]: exact to degree 5, and (T - t) times a cubic
# has degree 4.
_GAUSS_X = np.array([0.5 - np.sqrt(0.15), 0.5, 0.5 + np.sqrt(0.15)])
_GAUSS_W = np.array([5.0, 8.0, 5.0]) / 18.0


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


def _stencil_weights(t: Array) -> tuple[IntArray, Array, Array]:
    """Weights of the local cubic through four nodes, for each interval of t (n+1,).

    Returns start (n,) of the stencil, and the weights (n, 4) of int g dt and of
    int (t_n - t) g dt over the interval.
    """
    n = t.shape[0] - 1
    start = np.clip(np.arange(n) - 1, 0, max(n - 3, 0))
    size = min(4, n + 1)
    nodes = t[start[:, None] + np.arange(size)]
    dt = np.diff(t)
    x = t[:-1, None] + dt[:, None] * _GAUSS_X
    basis = np.ones((n, 3, size))
    for j in range(size):
        for m in range(size):
            if m != j:
                basis[:, :, j] *= (x - nodes[:, m, None]) / (nodes[:, j] - nodes[:, m])[:, None]
    if dt.max() > _UNEVEN * dt.min():
        of_nodes = np.diff(nodes, axis=1)
        uneven = np.flatnonzero(of_nodes.max(axis=1) > _UNEVEN * of_nodes.min(axis=1))
        left = uneven - start[uneven]
        basis[uneven] = 0.0
        basis[uneven, :, left] = 1.0 - _GAUSS_X
        basis[uneven, :, left + 1] = _GAUSS_X
    weights = dt[:, None] * _GAUSS_W
    single = np.einsum("ng,ngj->nj", weights, basis)
    double = np.einsum("ng,ngj->nj", weights * (t[-1] - x), basis)
    return start, single, double


@lru_cache(maxsize=64)
def _uniform_stencils(n: int) -> Array:
    return _stencil_weights(np.arange(n + 1.0))[1]


def uniform_step(t: Array) -> float | None:
    """The common step of t (n+1,) [s], None where the stamps are irregular."""
    n = t.shape[0] - 1
    step = float(t[-1] - t[0]) / n
    deviation = np.abs(np.diff(t) - step).max()
    return step if deviation <= _UNIFORM_REL * step + _UNIFORM_ABS_S else None


def rotation_increments(t: Array, w: Array, sampling: ImuSampling, step: float | None) -> Array:
    """Rotation vectors of the intervals of t: (3, n) [rad], with coning correction.

    phi = int w dt + dt^3/12 w x dw/dt + O(dt^5)         (Bortz, to second order)

    Parameters
    ----------
    t : (n+1,) [s]
    w : (3, n+1) angular rate [rad/s]; for interval means column 0 is not used
    step : uniform step [s], None where the stamps are irregular
    """
    dt = np.diff(t) if step is None else step
    if sampling is ImuSampling.MEAN:
        mean = w[:, 1:]
        return mean * dt + cross(mean, _slope(t, mean, step)) * (dt * dt * dt / 12.0)
    theta = _integrate_intervals(t, w, step)
    theta += cross(w[:, :-1], w[:, 1:]) * (dt * dt / 12.0)
    return theta


def _integrate_intervals(t: Array, w: Array, step: float | None) -> Array:
    n = w.shape[1] - 1
    weights = _stencil_weights(t)[1] if step is None else _uniform_stencils(n) * step
    if n < 3:
        return np.einsum("an,in->ai", w, weights)
    theta = np.empty((3, n))
    if step is None:
        inner = weights[1:-1]
        theta[:, 1:-1] = sum(w[:, j : n - 2 + j] * inner[:, j] for j in range(4))
    else:
        # h/24 (-1, 13, 13, -1), by way of the sums of neighbours.
        pair = (step / 24.0) * (w[:, :-1] + w[:, 1:])
        np.multiply(14.0, pair, out=theta)
        theta[:, 1:-1] -= pair[:, :-2]
        theta[:, 1:-1] -= pair[:, 2:]
    theta[:, 0] = w[:, :4] @ weights[0]
    theta[:, -1] = w[:, -4:] @ weights[-1]
    return theta


def _slope(t: Array, mean: Array, step: float | None) -> Array:
    """Time derivative at the middle of the intervals from interval means: (3, n)."""
    if mean.shape[1] < 2:
        return np.zeros_like(mean)
    slope = np.empty_like(mean)
    if step is None:
        middle = 0.5 * (t[1:] + t[:-1])
        slope[:, 1:-1] = (mean[:, 2:] - mean[:, :-2]) / (middle[2:] - middle[:-2])
        first, last = middle[1] - middle[0], middle[-1] - middle[-2]
    else:
        slope[:, 1:-1] = (mean[:, 2:] - mean[:, :-2]) * (0.5 / step)
        first = last = step
    slope[:, 0] = (mean[:, 1] - mean[:, 0]) / first
    slope[:, -1] = (mean[:, -1] - mean[:, -2]) / last
    return slope


def velocity_increments(t: Array, w: Array, f: Array, theta: Array, step: float | None) -> Array:
    """int C f dt of the intervals from interval means, in b at their start: (3, n) [m/s].

    dv + 1/2 th x dv + 1/6 th x (th x dv) + dt^3/12 (w x df/dt + f x dw/dt)
                                         (Savage, rotation and sculling compensation)
    """
    dt = np.diff(t) if step is None else step
    mean_w, mean_f = w[:, 1:], f[:, 1:]
    dv = mean_f * dt
    turned = cross(theta, dv)
    sculling = cross(mean_w, _slope(t, mean_f, step)) + cross(mean_f, _slope(t, mean_w, step))
    return dv + 0.5 * turned + cross(theta, turned) / 6.0 + sculling * (dt * dt * dt / 12.0)


def mean_increments(t: Array, values: Array, step: float | None) -> tuple[Array, Array]:
    """`rotation_increments` and `velocity_increments` from interval means, quicker together.

    values : (6, n+1) rate and specific force
    """
    dt = np.diff(t) if step is None else step
    cubic = dt * dt * dt / 12.0
    mean = values[:, 1:].copy()
    slope = _slope(t, mean, step)
    n = mean.shape[1]
    # w x dw/dt, w x df/dt, f x dw/dt: axis, product, interval.
    left = mean.reshape(2, 3, n)[[0, 0, 1]].swapaxes(0, 1)
    right = slope.reshape(2, 3, n)[[0, 1, 0]].swapaxes(0, 1)
    coning, sculling, rowing = cross(left, right).swapaxes(0, 1)
    mean *= dt
    theta = mean[:3] + cubic * coning
    dv = mean[3:]
    turned = cross(theta, dv)
    du = dv + 0.5 * turned
    du += cross(theta, turned) * (1.0 / 6.0)
    sculling += rowing
    du += cubic * sculling
    return theta, du


def join_blocks(blocks: Sequence[ImuBlock]) -> ImuBlock:
    """Consecutive blocks as one; each begins with the last sample of the one before."""
    if len(blocks) == 1:
        return blocks[0]
    rest = blocks[1:]
    return ImuBlock(
        np.concatenate([blocks[0].stamp_ns, *(b.stamp_ns[1:] for b in rest)]),
        np.concatenate([blocks[0].w_ib_b, *(b.w_ib_b[:, 1:] for b in rest)], axis=1),
        np.concatenate([blocks[0].f_ib_b, *(b.f_ib_b[:, 1:] for b in rest)], axis=1),
    )


def integrate_rotation(block: ImuBlock, sampling: ImuSampling) -> Array:
    """Rotation of b at the last stamp to b at the first: (4,) quaternion."""
    if block.stamp_ns.shape[0] == 1:
        return np.array([1.0, 0.0, 0.0, 0.0])
    block = fill_gaps(block)
    t = (block.stamp_ns - block.stamp_ns[0]) * 1e-9
    theta = rotation_increments(t, block.w_ib_b, sampling, uniform_step(t))
    return cumulative_rotation(quaternion_from_rotation_vector(theta))[:, -1]


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
    start, single, double = _stencil_weights(t)
    columns = start[:, None] + np.arange(single.shape[1])
    weights = np.zeros((t.shape[0], 4))
    np.add.at(weights[:, 0], columns, single)
    np.add.at(weights[:, 1], columns, double)
    weights[1:, 2] = 1.0
    # With I_k the sum of the increments up to node k, int I dt = sum_k w_k I_k.
    weights[1:, 3] = np.cumsum(weights[::-1, 0])[::-1][1:]
    return weights
