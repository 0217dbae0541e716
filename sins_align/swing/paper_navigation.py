"""Strapdown navigation at the swing centre, over a whole stretch at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sins_align.rotation import (
    cross,
    cumulative_rotation,
    multiply_quaternions,
    quaternion_from_rotation_vector,
)
from sins_align.types import Array, IntArray

FILTER_STEP_S = 0.1
NAVIGATION_STEP_S = 0.004


class Motion(NamedTuple):
    """A navigated stretch of N + 1 stamps.

    t : (N+1,) from its first stamp [s]
    Q : (4, N+1) attitude, C_nb : (3, 3, N+1) the same
    w_ib_b, dw_ib_b : (3, N+1) rate and its derivative [rad/s], [rad/s^2]
    f_ib_b : (3, N+1) specific force [m/s^2]
    """

    t: Array
    Q: Array
    C_nb: Array
    w_ib_b: Array
    dw_ib_b: Array
    f_ib_b: Array


class Grid(NamedTuple):
    """Indices into the stamps of a stretch.

    navigation : (M+1,) ends of the navigation steps: 4 ms, or one sample where that is longer
    filter : (K+1,) ends of the filter steps of about 0.1 s, as indices into `navigation`
    """

    navigation: IntArray
    filter: IntArray


def make_grid(t: Array) -> Grid:
    """Navigation and filter steps for the stamps t (N+1,) [s]; a filter step is made of whole
    navigation steps, the last of which may be short.
    """
    count = t.size - 1
    duration = float(t[-1] - t[0])
    steps = max(1, min(count, round(duration / FILTER_STEP_S)))
    samples = max(1, round(NAVIGATION_STEP_S * count / duration))
    ends = np.rint(np.linspace(0, count, steps + 1)).astype(np.int64)
    navigation = np.union1d(np.arange(0, count, samples), ends)
    return Grid(navigation, np.searchsorted(navigation, ends))


def navigate_attitude(Q: Array, t: Array, theta: Array, w_in_n: Array) -> Array:
    """Q_k = exp(-w_in_n t_k) Q_0 exp(theta_1) ... exp(theta_k): (4, N+1).

    Parameters
    ----------
    Q : (4,) attitude at t[0]
    t : (N+1,) [s]
    theta : (3, N) rotation vectors of b [rad]
    w_in_n : (3,) rate of n, constant over the stretch [rad/s]
    """
    turned = cumulative_rotation(quaternion_from_rotation_vector(theta))
    earth = quaternion_from_rotation_vector(np.outer(-w_in_n, t - t[0]))
    attitude = multiply_quaternions(earth, multiply_quaternions(Q[:, np.newaxis], turned))
    normalised: Array = attitude / np.linalg.norm(attitude, axis=0)
    return normalised


def centre_specific_force(w_ib_b: Array, dw_ib_b: Array, f_ib_b: Array, r_b: Array) -> Array:
    """Specific force at the swing centre, f - w x (w x r) - dw x r, eq. (8): (3, N) [m/s^2]."""
    r = r_b[:, np.newaxis]
    return f_ib_b - cross(w_ib_b, cross(w_ib_b, r)) - cross(dw_ib_b, r)


def integrate(t: Array, values: Array, ends: IntArray) -> Array:
    """Trapezoidal integral of values (m, N+1) over t between the indices `ends`: (m, K).

    The trapezoid will do: in n, the specific force at the centre hardly changes.
    """
    steps = 0.5 * (values[:, 1:] + values[:, :-1]) * np.diff(t)
    return np.asarray(np.add.reduceat(steps, ends[:-1], axis=1))
