"""Angular acceleration out of the gyros: Mu and Fang, section 3.3."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from scipy.signal import lfilter

from sins_align.types import Array


class Differentiator(Protocol):
    """Derivative of a signal that comes in stretches."""

    def __call__(self, t: Array, w: Array) -> Array:
        """dw/dt (3, N) [rad/s^2] at the inner ones of the stamps t (N+2,) [s].

        w (3, N+2) [rad/s]. The first inner stamp is the last inner one of the stretch before.
        """

    def lag(self, h: float) -> float:
        """How late the derivative of a slow signal is, for samples every h [s]: [s]."""


class CentralDifference:
    """(w_{k+1} - w_{k-1}) / (t_{k+1} - t_{k-1}): no lag, half the noise of the observer."""

    def __call__(self, t: Array, w: Array) -> Array:
        """As `Differentiator`."""
        slope: Array = (w[:, 2:] - w[:, :-2]) / (t[2:] - t[:-2])
        return slope

    def lag(self, h: float) -> float:
        """None: the difference is centred."""
        return 0.0


class ExtendedStateObserver:
    """The paper's extended state observer (ESO) with its two poles at 1 - b h.

    e = s1 - w,  s1' = s1 + h (s2 - 2 b e),  s2' = s2 - h b^2 e       b: bandwidth [rad/s]

    s2 after sample k is taken as dw/dt at sample k. Written as one linear filter it is

    s2 / w = h b^2 (1 - z^-1) / (1 - (1 - b h) z^-1)^2,

    which at the paper's b = 1000, h = 1 ms is (w_k - w_{k-1}) / h: no filtering of noise,
    and half a sample of lag, which turns the lever arm about the axis of a coning motion.

    Parameters
    ----------
    bandwidth : [rad/s]; None: 1 / h. More than 1 / h makes the observer ring and, from 2 / h
        on, diverge: it is limited to 1 / h.
    """

    def __init__(self, bandwidth: float | None) -> None:
        self._bandwidth = bandwidth
        self._state = np.zeros((3, 2))
        self._last: Array | None = None

    def __call__(self, t: Array, w: Array) -> Array:
        """As `Differentiator`; h is the mean interval of the stretch."""
        h = float(t[-1] - t[0]) / (t.size - 1)
        gain = self._gain(h)
        pole = 1.0 - gain
        # At rest before the first sample; later, the first inner sample has been taken in.
        first = 0 if self._last is None else 1
        slope, self._state = lfilter(
            [gain * gain / h],
            [1.0, -2.0 * pole, pole * pole],
            np.diff(w[:, first:-1]),
            zi=self._state,
        )
        if self._last is not None:
            slope = np.concatenate((self._last, slope), axis=1)
        self._last = slope[:, -1:]
        return np.asarray(slope)

    def _gain(self, h: float) -> float:
        """Bandwidth times h: one minus the poles."""
        return 1.0 if self._bandwidth is None else min(self._bandwidth * h, 1.0)

    def lag(self, h: float) -> float:
        """Half a sample of the difference, and (1 - b h) / (b h) of each pole."""
        return (2.0 / self._gain(h) - 1.5) * h


def make_differentiator(name: str, bandwidth: float | None) -> Differentiator:
    """The one that `PaperConfig.differentiator` names: 'eso' or 'central'."""
    return ExtendedStateObserver(bandwidth) if name == "eso" else CentralDifference()


def noise_gain(differentiate: Differentiator, h: float, averaged: bool) -> float:
    """1 sigma of the derivative for white noise of 1 in samples every h [s]: [1/s].

    `differentiate` must be fresh. averaged : neighbours are averaged before.
    """
    impulse = np.zeros((3, 4000))
    impulse[:, 100] = 1.0
    if averaged:
        impulse = 0.5 * (impulse[:, :-1] + impulse[:, 1:])
    slope = differentiate(h * np.arange(impulse.shape[1], dtype=np.float64), impulse)
    return float(np.linalg.norm(slope[0]))
