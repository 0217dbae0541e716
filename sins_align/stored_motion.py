"""How a base seems to move against a stored attitude: for the check of that.

The gyros turn everything into b0. With the stored attitude C as the mean one,

    theta(t) = log(Exp(-w_ie t) C C_b0b(t) C^T)

is the base against ENU, by the gyros alone: its sway, and a drift of constant rate where the
stored heading or the gyros are wrong. Two things tell the drift:

- on a base that does not turn, the slope of theta. What sway is left in a slope by least squares
  over T is 12 q / (w T^2) of an rms of q at a rate of w;
- on one that does, the direction of the force in the axes Exp(-w_ie t) C C_b0b, which turns
  with the drift and not with the base: about east and north only, and with the noise of the
  accelerometers.

The one with less noise is taken, but the second one where the two tell that the base turns.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sins_align.rotation import exp_rotation, log_rotation
from sins_align.types import Array, ImuBlock, ImuSampling
from sins_align.windows import integrate_windows

WINDOWS = 10  # a block of about a second: sway of up to 5 Hz is seen
# Sway is taken to be as slow as this; of a faster one less is left in a slope and a mean.
SWAY_RATE = 2.0 * math.pi / 10.0  # [rad/s]
# Chi-square of 2 degrees of freedom, beyond which the base is taken to turn: 1 %.
TURNS = 9.21
# Rounding, so that without any noise there is something to divide by [rad/s].
LEAST_NOISE = 1e-10
UNSEEN = 1e-3  # sigma of a rate that is not seen, far above any [rad/s]
# Linear maps (2, 3) from a rotation to the tilt (east, north) that up gets by it, and back.
TILT_BY_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])


class Motion(NamedTuple):
    """What the sensors saw, against the stored attitude; axes east, north, up.

    duration_s : of the check
    drift : (3,) rate of theta that is not the base's [rad/s], with drift_noise (3, 3), what the
        motion of the base and the accelerometers leave in it
    sway : (3, 3) mean square of theta without the drift, about its mean [rad^2]
    tilt : (2,) direction of the mean force, east, north [rad], with tilt_noise (2, 2), what the
        motion leaves in it
    end : (3,) theta at the end, against its mean [rad]
    """

    duration_s: float
    drift: Array
    drift_noise: Array
    sway: Array
    tilt: Array
    tilt_noise: Array
    end: Array


class MotionRecord:
    """Attitude and force over the blocks since the first one, in the body axes there."""

    def __init__(self, sampling: ImuSampling) -> None:
        self._sampling = sampling
        self._C_b0b = [np.eye(3)]  # at the ends of the windows
        self._u: list[Array] = []  # int f dt of the windows, in b0
        self._ends_s = [0.0]
        self._blocks = [0]  # number of windows at the end of each block

    @property
    def elapsed_s(self) -> float:
        """How much has been seen."""
        return self._ends_s[-1]

    def add(self, block: ImuBlock) -> None:
        """Take in the next block."""
        windows = integrate_windows(block, self._sampling, WINDOWS)
        begin = self._C_b0b[-1]
        for duration, u, C in zip(windows.duration_s, windows.u, windows.C_end, strict=True):
            self._ends_s.append(self._ends_s[-1] + float(duration))
            self._C_b0b.append(begin @ C)
            self._u.append(begin @ u)
        self._blocks.append(len(self._u))

    def motion(self, C_nb: Array, w_ie_n: Array) -> Motion:
        """Against the attitude C_nb (3, 3) on an Earth of rate w_ie_n (3,) [rad/s]."""
        t = np.array(self._ends_s)
        middles = t - t.mean()
        theta = np.array(
            [
                log_rotation(exp_rotation(-w_ie_n * s) @ C_nb @ turned @ C_nb.T)
                for s, turned in zip(t, self._C_b0b, strict=True)
            ]
        )
        mean = theta.mean(axis=0)
        drift, drift_noise = self._by_gyros(t, theta)
        by_force, force_noise = self._by_force(C_nb, w_ie_n)
        apart = (drift - by_force)[:2]
        noise, other = drift_noise[:2, :2], force_noise[:2, :2]
        both = noise + other + LEAST_NOISE**2 * np.eye(2)
        turns = apart @ np.linalg.solve(both, apart) > TURNS
        if turns or noise.trace() > other.trace():
            drift, drift_noise = by_force, force_noise
        sway = theta - mean - np.outer(middles, drift)
        offset = mean - drift * t.mean()
        tilts = self._tilts(C_nb, w_ie_n, offset, drift)
        return Motion(
            duration_s=float(t[-1]),
            drift=drift,
            drift_noise=drift_noise,
            sway=sway.T @ sway / len(sway),
            tilt=tilts.mean(axis=0),
            # What is left in the mean of a sway of rms q over T: 2 q / (w T).
            tilt_noise=np.cov(tilts.T) * (2.0 / (SWAY_RATE * t[-1])) ** 2,
            end=theta[-1] - mean,
        )

    def _by_gyros(self, t: Array, theta: Array) -> tuple[Array, Array]:
        """Slope of theta; fast sway, which leaves next to nothing, is averaged away first."""
        slope, left = _line(t, theta)
        slow = np.array([left[a + 1 : b + 1].mean(axis=0) for a, b in pairwise(self._blocks)])
        noise: Array = slow.T @ slow / len(slow) * (12.0 / (SWAY_RATE * t[-1] ** 2)) ** 2
        return slope, noise

    def _by_force(self, C_nb: Array, w_ie_n: Array) -> tuple[Array, Array]:
        """Slope of the tilt; of its scatter, white or slow, what is left in a slope."""
        tilts = self._tilts(C_nb, w_ie_n, np.zeros(3), np.zeros(3))
        t = self._block_middles()
        slope, left = _line(t, tilts)
        whole = self._ends_s[-1]
        share = 12.0 / (whole**2 * len(t)) + (12.0 / (SWAY_RATE * whole**2)) ** 2
        noise: Array = TILT_BY_TURN.T @ np.cov(left.T) @ TILT_BY_TURN * share
        noise[2, 2] = UNSEEN**2
        return -(TILT_BY_TURN.T @ slope), noise

    def _block_middles(self) -> Array:
        ends = np.array(self._ends_s)[self._blocks]
        middles: Array = 0.5 * (ends[1:] + ends[:-1])
        return middles

    def _tilts(self, C_nb: Array, w_ie_n: Array, offset: Array, drift: Array) -> Array:
        """(blocks, 2) direction of the force, east and north, theta's line taken off [rad].

        The sway turns C_b0b as it turns the base, and drops out.
        """
        tilts = []
        for a, b in pairwise(self._blocks):
            u_n = np.zeros(3)
            for k in range(a, b):
                middle = 0.5 * (self._ends_s[k] + self._ends_s[k + 1])
                line = exp_rotation(-(offset + drift * middle)) @ exp_rotation(-w_ie_n * middle)
                u_n += line @ C_nb @ self._u[k]
            tilts.append(u_n[:2] / np.linalg.norm(u_n))
        return np.array(tilts)


def _line(t: Array, values: Array) -> tuple[Array, Array]:
    """Slope by least squares of values (n, k) over t (n,), and what is left (n, k)."""
    middles = t - t.mean()
    slope = middles @ values / (middles @ middles)
    return slope, values - values.mean(axis=0) - np.outer(middles, slope)
