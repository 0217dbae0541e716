"""Laws of a drive: smooth functions of time or of distance, with exact derivatives.

Values with their derivatives are stacked: row k of a (K, N) array is the k-th derivative.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from sins_align.types import Array

Rows = Array  # (K, N): row k is the k-th derivative


@dataclass(frozen=True, eq=False)
class SmoothLevels:
    """A quantity that stays at levels and passes smoothly from one to the next.

    The passages are polynomials of degree 9, with four derivatives zero at both ends.
    `LevelPlan` builds them.

    begin : (K,) where the passages begin, ascending; a passage ends before the next begins
    length : (K,) how long they are
    level : (K+1,) the levels; before the first passage level[0], after the last level[-1]
    integral : (K,) of the quantity from 0 to `begin`
    """

    begin: Array
    length: Array
    level: Array
    integral: Array

    def __call__(self, x: Array) -> Rows:
        """(5, N) integral from 0, value and three derivatives at x (N,)."""
        index = np.maximum(np.searchsorted(self.begin, x, side="right") - 1, 0)
        length, low = self.length[index], self.level[index]
        rise = self.level[index + 1] - low
        since = x - self.begin[index]
        u = np.clip(since / length, 0.0, 1.0)
        rest, skew = u * (1.0 - u), 1.0 - 2.0 * u
        value = u**5 * (126.0 + u * (-420.0 + u * (540.0 + u * (-315.0 + 70.0 * u))))
        area = u**6 * (21.0 + u * (-60.0 + u * (67.5 + u * (-35.0 + 7.0 * u))))
        area = length * area + np.maximum(since - length, 0.0)
        return np.stack(
            (
                self.integral[index] + low * since + rise * area,
                low + rise * value,
                rise / length * 630.0 * rest**4,
                rise / length**2 * 2520.0 * rest**3 * skew,
                rise / length**3 * 2520.0 * rest**2 * (3.0 * skew**2 - 2.0 * rest),
            )
        )

    def absolute(self) -> SmoothLevels:
        """The magnitude; a law that changes its sign must pass through a level 0 for that."""
        plan = LevelPlan(abs(float(self.level[0])))
        for begin, length, level in zip(
            self.begin[1:], self.length[1:], self.level[2:], strict=True
        ):
            plan.hold(float(begin) - plan.position)
            plan.change(abs(float(level)), float(length))
        return plan.law()


class LevelPlan:
    """Builds `SmoothLevels` piece by piece from 0 on, keeping count of where it is.

    level : at the end of the plan so far
    position : that end; integral : of the quantity up to there
    """

    def __init__(self, level: float) -> None:
        # A passage that changes nothing serves what lies before the first one.
        self.level = level
        self.position, self.integral = -1.0, -level
        self._begin: list[float] = []
        self._length: list[float] = []
        self._level = [level]
        self._integral: list[float] = []
        self.change(level, 1.0)

    def hold(self, length: float) -> None:
        """Stay at the level."""
        self.position += length
        self.integral += self.level * length

    def change(self, level: float, length: float) -> None:
        """Pass to another level."""
        self._begin.append(self.position)
        self._length.append(length)
        self._level.append(level)
        self._integral.append(self.integral)
        self.position += length
        self.integral += 0.5 * (self.level + level) * length
        self.level = level

    def law(self) -> SmoothLevels:
        """The plan as a function; its last level lasts for ever."""
        return SmoothLevels(
            np.array(self._begin),
            np.array(self._length),
            np.array(self._level),
            np.array(self._integral),
        )


@dataclass(frozen=True, eq=False)
class SinusoidSum:
    """Sum of amplitude sin(omega x + phase), all (n,)."""

    amplitude: Array
    omega: Array
    phase: Array

    def __call__(self, x: Array, rows: int = 3) -> Rows:
        """(rows, N) value and derivatives at x (N,)."""
        out = np.zeros((rows, x.size))
        for amplitude, omega, phase in zip(self.amplitude, self.omega, self.phase, strict=True):
            if amplitude == 0.0:
                continue
            argument = omega * x + phase
            sine, cosine = amplitude * np.sin(argument), amplitude * np.cos(argument)
            for k in range(rows):
                factor = omega**k * (-1.0 if k % 4 in (2, 3) else 1.0)
                out[k] += factor * (cosine if k % 2 else sine)
        return out


def random_sinusoids(rms: float, omega: Array, stream: Generator) -> SinusoidSum:
    """Sinusoids of equal amplitude and random phase at omega (n,), of that rms together."""
    amplitude = rms * math.sqrt(2.0 / omega.size)
    phase = stream.uniform(0.0, math.tau, omega.size)
    return SinusoidSum(np.full(omega.size, amplitude), omega, phase)


def band(low_hz: float, high_hz: float, count: int, stream: Generator) -> Array:
    """(count,) random angular frequencies [rad/s], one in each equal part of the band."""
    part = (np.arange(count) + stream.random(count)) / count
    return math.tau * (low_hz + (high_hz - low_hz) * part)


def correlated(correlation_s: float, count: int, stream: Generator) -> Array:
    """(count,) random angular frequencies [rad/s] spread like a Gauss-Markov spectrum.

    Its distribution function is 2/pi atan(omega T); the last twentieth, which has no end, is
    left out.
    """
    part = 0.95 * (np.arange(count) + stream.random(count)) / count
    return np.tan(0.5 * math.pi * part) / correlation_s


def product(a: Rows, b: Rows) -> Rows:
    """(3, N) product of two functions, with two derivatives."""
    return np.stack(
        (a[0] * b[0], a[1] * b[0] + a[0] * b[1], a[2] * b[0] + 2.0 * a[1] * b[1] + a[0] * b[2])
    )


def along(law: Rows, distance: Rows) -> Rows:
    """A function of distance as one of time.

    Parameters
    ----------
    law : (K, N) the function and its derivatives by distance, K of 3 or 4
    distance : (K, N) distance and its derivatives by time

    Returns
    -------
    (K, N) the function and its derivatives by time
    """
    v, dv = distance[1], distance[2]
    rows = [law[0], law[1] * v, law[2] * v**2 + law[1] * dv]
    if len(law) > 3:
        rows.append(law[3] * v**3 + 3.0 * law[2] * v * dv + law[1] * distance[3])
    return np.stack(rows)


def liveliness(speed: Rows, half_speed: float) -> Rows:
    """(3, N) v^2 / (v^2 + half_speed^2) with two derivatives: 0 at rest, 1 when fast."""
    v, dv, ddv = speed[:3]
    square = half_speed**2
    inverse = 1.0 / (v**2 + square)
    dy, ddy = 2.0 * v * dv, 2.0 * (dv**2 + v * ddv)
    return np.stack(
        (
            v**2 * inverse,
            square * dy * inverse**2,
            square * (ddy * inverse**2 - 2.0 * dy**2 * inverse**3),
        )
    )
