"""Analytic attitude: a chain of rotations about coordinate axes, with exact derivatives.

Euler-angle swing, coning and the turn of the base are all such chains, so one rule of
composition differentiates every motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from sins_align.types import Array


class Attitude(NamedTuple):
    """Attitude of b against n over N times.

    C_nb : (3, 3, N)
    w_nb_b : (3, N) rate of b against n, in b [rad/s]
    dw_nb_b : (3, N) time derivative of the components of w_nb_b [rad/s^2]
    """

    C_nb: Array
    w_nb_b: Array
    dw_nb_b: Array


class AngleLaw(Protocol):
    """An angle over time, differentiated by hand; a displacement likewise, [m] for [rad]."""

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        """(N,) angle [rad], rate [rad/s] and acceleration [rad/s^2] at the times t [s]."""


@dataclass(frozen=True)
class Sinusoid:
    """mean + amplitude sin(omega t + phase); [rad], [rad/s]."""

    mean: float
    amplitude: float
    omega: float
    phase: float

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        """As `AngleLaw`."""
        argument = self.omega * t + self.phase
        swing = self.amplitude * np.sin(argument)
        rate = self.amplitude * self.omega * np.cos(argument)
        return self.mean + swing, rate, -(self.omega**2) * swing


@dataclass(frozen=True)
class Linear:
    """start + rate t; [rad], [rad/s]."""

    start: float
    rate: float = 0.0

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        """As `AngleLaw`."""
        return self.start + self.rate * t, np.full_like(t, self.rate), np.zeros_like(t)


@dataclass(frozen=True)
class SmoothTurn:
    """A turn by `angle` [rad] from `start` on within `duration` [s], at rest around it.

    The polynomial of degree 7 has three derivatives zero at both ends, so that the angular
    acceleration stays differentiable.
    """

    angle: float
    start: float
    duration: float

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        """As `AngleLaw`."""
        x = np.clip((t - self.start) / self.duration, 0.0, 1.0)
        rest = 1.0 - x
        angle = x**4 * (35.0 + x * (-84.0 + x * (70.0 - 20.0 * x)))
        rate = 140.0 * (x * rest) ** 3 / self.duration
        acceleration = 420.0 * (x * rest) ** 2 * (1.0 - 2.0 * x) / self.duration**2
        return self.angle * angle, self.angle * rate, self.angle * acceleration


@dataclass(frozen=True)
class AxisRotation:
    """Rotation of the axes reached so far about their own axis 0, 1 or 2 by `angle`."""

    axis: int
    angle: AngleLaw


@dataclass(frozen=True, eq=False)
class FixedRotation:
    """Change to axes fixed to those reached so far: `C` (3, 3) maps new to old."""

    C: Array


RotationStep = AxisRotation | FixedRotation


def compose_attitude(steps: Sequence[RotationStep], t: Array) -> Attitude:
    """Attitude at the times t (N,) [s] after all rotations, the first one from n.

    With one more rotation R, of rate u in the new axes,
    C' = C R,  w' = R^T w + u,  dw' = R^T dw + du - u x (R^T w).
    """
    C = np.zeros((3, 3, t.size))
    C[[0, 1, 2], [0, 1, 2]] = 1.0
    w = np.zeros((3, t.size))
    dw = np.zeros((3, t.size))
    for step in steps:
        if isinstance(step, FixedRotation):
            C = np.einsum("ijn,jk->ikn", C, step.C)
            w = step.C.T @ w
            dw = step.C.T @ dw
        else:
            _rotate_about_axis(C, w, dw, step.axis, step.angle(t))
    return Attitude(C, w, dw)


def _rotate_about_axis(
    C: Array, w: Array, dw: Array, axis: int, law: tuple[Array, Array, Array]
) -> None:
    """The rule of `compose_attitude` in place, for R about one coordinate axis."""
    angle, rate, acceleration = law
    cosine, sine = np.cos(angle), np.sin(angle)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    # Columns of C and components of vectors change alike: x_j' = c x_j + s x_k, ...
    for x in (*C, w, dw):
        x[j], x[k] = cosine * x[j] + sine * x[k], cosine * x[k] - sine * x[j]
    dw[j] += rate * w[k]
    dw[k] -= rate * w[j]
    dw[axis] += acceleration
    w[axis] += rate
