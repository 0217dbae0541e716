"""What a perfect IMU feels on the swinging base."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sins_align.simulate.attitude_motion import (
    AngleLaw,
    Attitude,
    RotationStep,
    Sinusoid,
    compose_attitude,
)
from sins_align.types import Array

# An interval mean is five-point Gauss-Legendre: exact to the rounding for swings that turn
# by less than a radian within one interval.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)
# Times worked on at once: arrays of this length stay in the processor's cache.
_BLOCK = 4096


@dataclass(frozen=True, eq=False)
class CentreMotion:
    """Motion of the swing centre along one fixed direction of n.

    direction_n : (3,) unit vector in ENU
    displacement : over time [m]
    """

    direction_n: Array
    displacement: AngleLaw


@dataclass(frozen=True, eq=False)
class BaseMotion:
    """The base and the IMU on it.

    n is ENU at the mean position of the swing centre, that before a drive, fixed to the Earth.
    Gravitation is uniform over the reach of the base (a lever arm of 5 m makes that wrong by
    1.5 ug) and of a drive: `SwingOptions` says what that leaves out.

    rotations : chain from n to b
    centre : motions of the swing centre, added up
    r_b : (3,) lever arm in b [m]
    w_ie_n : (3,) rate of the Earth in n [rad/s]
    gravity : plumb-line gravity at the origin of n [m/s^2]
    """

    rotations: tuple[RotationStep, ...]
    centre: tuple[CentreMotion, ...]
    r_b: Array
    w_ie_n: Array
    gravity: float

    def attitude(self, t: Array) -> Attitude:
        """Attitude and its derivatives at the times t (N,) [s]."""
        return compose_attitude(self.rotations, t)

    def centre_position(self, t: Array) -> Array:
        """(3, N) the swing centre in n [m] at the times t (N,) [s]."""
        position = np.zeros((3, t.size))
        for motion in self.centre:
            position += np.outer(motion.direction_n, motion.displacement(t)[0])
        return position

    def sense(self, t: Array) -> tuple[Array, Array]:
        """w_ib_b (3, N) [rad/s] and f_ib_b (3, N) [m/s^2] at the times t (N,) [s]."""
        return _in_blocks(self._sense_block, t)

    def sense_mean(self, begin: Array, end: Array) -> tuple[Array, Array]:
        """Means over (begin, end] (N,) [s] of w_ib_b and f_ib_b, both in b as it turns.

        That is an IMU's angle and velocity increment, divided by the interval.
        """

        def mean(edges: Array) -> tuple[Array, Array]:
            middle, half = 0.5 * (edges[1] + edges[0]), 0.5 * (edges[1] - edges[0])
            w, f = self._sense_block((middle + np.multiply.outer(_NODES, half)).ravel())
            return _weigh_nodes(w), _weigh_nodes(f)

        return _in_blocks(mean, np.stack((begin, end)))

    def _sense_block(self, t: Array) -> tuple[Array, Array]:
        C_nb, w_nb_b, dw_nb_b = self.attitude(t)
        w_ie_b = np.einsum("jin,j->in", C_nb, self.w_ie_n)
        w_ib_b = w_nb_b + w_ie_b
        # The second term is the derivative of C_bn w_ie_n: the Earth's rate seen from b.
        dw_ib_b = dw_nb_b - _cross(w_nb_b, w_ie_b)
        f_n = self._centre_specific_force(t)
        r_b = self.r_b[:, np.newaxis]
        # Mu & Fang, eq. (8), with the centre's own acceleration.
        lever = _cross(w_ib_b, _cross(w_ib_b, r_b)) + _cross(dw_ib_b, r_b)
        return w_ib_b, np.einsum("jin,jn->in", C_nb, f_n) + lever

    def _centre_specific_force(self, t: Array) -> Array:
        """(3, N) specific force at the swing centre, in n [m/s^2].

        a + 2 w_ie x v + w_ie x (w_ie x p) - g, p from the origin of n: the centrifugal
        acceleration at the origin is in g already.
        """
        f_n = np.zeros((3, t.size))
        f_n[2] = self.gravity
        w_ie = self.w_ie_n
        for motion in self.centre:
            position, velocity, acceleration = motion.displacement(t)
            direction = motion.direction_n
            f_n += np.outer(direction, acceleration)
            f_n += np.outer(2.0 * np.cross(w_ie, direction), velocity)
            f_n += np.outer(np.cross(w_ie, np.cross(w_ie, direction)), position)
        return f_n


def harmonic(amplitude: float, period: float, phase: float) -> Sinusoid:
    """Displacement amplitude sin(2 pi t / period + phase); [m], [s], [rad]."""
    return Sinusoid(0.0, amplitude, math.tau / period, phase)


def _weigh_nodes(values: Array) -> Array:
    """(3, n) means over n intervals from the values (3, 5 n) at their nodes."""
    means: Array = np.einsum("k,ikn->in", 0.5 * _WEIGHTS, values.reshape(3, _WEIGHTS.size, -1))
    return means


def _in_blocks(function: Callable[[Array], tuple[Array, Array]], t: Array) -> tuple[Array, Array]:
    """`function` over the last axis of t block by block: bounded memory, and quicker."""
    size = t.shape[-1]
    w, f = np.empty((3, size)), np.empty((3, size))
    for first in range(0, size, _BLOCK):
        block = slice(first, first + _BLOCK)
        w[:, block], f[:, block] = function(t[..., block])
    return w, f


def _cross(a: Array, b: Array) -> Array:
    """(3, N) cross product over the columns; np.cross is several times slower."""
    return np.stack(
        (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    )
