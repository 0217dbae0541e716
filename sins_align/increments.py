"""From samples to increments over the intervals between them: of attitude and of velocity.

Rules are of fourth order in the sampling interval for both kinds of sampling and for
irregular stamps (velocity of interval means: third).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from sins_align.gaps import fill_gaps
from sins_align.rotation import (
    cross,
    cumulative_rotation,
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


def stencil_weights(t: Array) -> tuple[IntArray, Array, Array]:
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
    return stencil_weights(np.arange(n + 1.0))[1]


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
    weights = stencil_weights(t)[1] if step is None else _uniform_stencils(n) * step
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
