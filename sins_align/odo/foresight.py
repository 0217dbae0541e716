"""When sigma of heading will be what it should be, if the motion goes on as it was of late.

Of every epoch the transition A, its noise Q, the measurement H and its noise R are kept. With
the innovation of no interest, the covariance at the end of an epoch is that at its start by

    P+ = F P (I + G P)^-1 F' + W
    S = H Q H' + R,  K = Q H' S^-1,  F = (I - K H) A,  W = (I - K H) Q,  G = A' H' S^-1 H A

and so it is over any number of epochs: (F, W, G) of two in a row are, by Redheffer's star
product, with M = (I + W_1 G_2)^-1,

    F = F_2 M F_1      W = W_2 + F_2 M W_1 F_2'      G = G_1 + F_1' G_2 M F_1

Those of late are put together to one, that one doubled to an hour, and the time is found by
halving. Samples lost now and then go on to be lost; a gap that came once does not come again.
Nothing of the filter is touched.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from functools import reduce
from typing import NamedTuple

import numpy as np

from sins_align.odo.filter import GAP_INDEX, Step
from sins_align.odo.layout import AZIMUTH, PHI, SIZE, VELOCITY
from sins_align.odo.wander import WanderFilter
from sins_align.types import Array

# What is taken to go on, and the least that tells [s]. With more, a vehicle that has set out would
# do so again and again; with less, turns that come now and then are missed.
MOTION_S, LEAST_MOTION_S = 40.0, 10.0
# From so many epochs with samples missing on there will be more of them: as many, and as those in
# the middle. One long gap may stand for all the others together, and tells nothing.
OFTEN = 3
# Farther nothing is foreseen [s].
HORIZON_S = 3600.0

_UNIT = np.eye(SIZE)


class Stretch(NamedTuple):
    """What some epochs do to the covariance: F, W, G (n, n), and their length [s]."""

    F: Array
    W: Array
    G: Array
    duration_s: float

    def then(self, other: Stretch) -> Stretch:
        """The two in a row."""
        M = np.linalg.solve(_UNIT + self.W @ other.G, np.hstack((self.F, self.W)))
        F, W = other.F @ M[:, :SIZE], other.F @ M[:, SIZE:] @ other.F.T
        G = self.F.T @ other.G @ M[:, :SIZE]
        total = self.duration_s + other.duration_s
        return Stretch(F, other.W + 0.5 * (W + W.T), self.G + 0.5 * (G + G.T), total)

    def carry(self, P: Array) -> Array:
        """Covariance at its end."""
        P = self.F @ np.linalg.solve(_UNIT + P @ self.G, P) @ self.F.T + self.W
        return 0.5 * (P + P.T)


class Foresight:
    """Keeps what the last epochs did to the covariance of a wander filter."""

    def __init__(self) -> None:
        # With the axes of the azimuth states, and C_ab at the start.
        self._steps: deque[tuple[Step, Array | None, Array]] = deque()
        self._kept_s = 0.0
        self._C_ab: Array | None = None  # at the end of the last one

    def add(self, filter_: WanderFilter) -> None:
        """After an epoch of the filter."""
        if filter_.step is None:
            return
        axes = _axes(filter_.navigation.e_a) if filter_.one_azimuth else None
        C_ab = filter_.navigation.C_ab
        self._steps.append((filter_.step, axes, C_ab if self._C_ab is None else self._C_ab))
        self._C_ab = C_ab
        self._kept_s += filter_.step.duration_s
        while self._kept_s > MOTION_S:
            self._kept_s -= self._steps.popleft()[0].duration_s

    def time_until(self, filter_: WanderFilter, heading: float) -> float:
        """Until sigma of heading is below `heading` [rad]; inf: not in an hour, NaN early on."""
        if self._kept_s < LEAST_MOTION_S:
            return math.nan
        azimuth = filter_.azimuth()
        stretches = [_stretch(step, axes) for step, axes, _ in self._steps]
        gaps = [step.gap for step, _, _ in self._steps if step.gap is not None]
        if len(gaps) >= OFTEN:
            lost = len(gaps) / self._kept_s * np.median(gaps, axis=0)
            stretches = [_after_loss(stretch, lost) for stretch in stretches]
        turn = _turn(self._steps[0][2], filter_.navigation.C_ab)
        T = _UNIT.copy()
        T[AZIMUTH, AZIMUTH] = _axes(azimuth.e_h)
        P = T @ filter_.with_one_azimuth(azimuth)[1] @ T.T
        by_errors = azimuth.tangent / filter_.cos_latitude**2

        def is_reached(P: Array, turned: float) -> bool:
            row = np.zeros(SIZE)
            row[PHI.stop - 1] = 1.0
            row[AZIMUTH] = -_about_up(-turned)[:2, :2] @ by_errors
            return bool(row @ P @ row < heading**2)

        return _search(P, stretches, turn, is_reached)


def _axes(e: Array) -> Array:
    """(2, 2) de_h by one azimuth, and its direction."""
    length = math.hypot(e[0], e[1])
    return np.array([[e[1], e[0] / length], [-e[0], e[1] / length]])


def _about_up(angle: float) -> Array:
    s, c = math.sin(angle), math.cos(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _turn(C_start: Array, C_end: Array) -> float:
    """About up, counter-clockwise [rad]."""
    R = C_end @ C_start.T
    return math.atan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])


def _turned_axes(angle: float) -> Array:
    """(n, n) errors in axes turned about up, counter-clockwise, by those in axes that are not."""
    D = _UNIT.copy()
    D[PHI, PHI] = D[VELOCITY, VELOCITY] = back = _about_up(-angle)
    D[AZIMUTH, AZIMUTH] = back[:2, :2]
    return D


def _search(
    P: Array, stretches: list[Stretch], turn: float, is_reached: Callable[[Array, float], bool]
) -> float:
    """The time after which P is as wanted [s].

    turn : of the vehicle over all stretches. It goes on from there: the next time the same motion,
    the first one too, is that of axes turned by it, in which the errors are seen
    """
    D = _turned_axes(turn)
    F, W, G, total_s = reduce(Stretch.then, stretches)
    doubled = [Stretch(D @ F, D @ W @ D.T, G, total_s)]
    while doubled[-1].duration_s < HORIZON_S / 2.0:
        doubled.append(doubled[-1].then(doubled[-1]))
    P = D @ P @ D.T
    time_s, count = 0.0, 1
    for k in reversed(range(len(doubled))):
        ahead, more = doubled[k].carry(P), count + 2**k
        if not is_reached(ahead, more * turn):
            P, count, time_s = ahead, more, time_s + doubled[k].duration_s
    for stretch in stretches:
        P, time_s = stretch.carry(P), time_s + stretch.duration_s
        if is_reached(P, count * turn):
            return time_s if time_s < HORIZON_S else math.inf
    return math.inf


def _after_loss(stretch: Stretch, variance: Array) -> Stretch:
    """With what missing samples add at its start; variance : (6,) of `GAP_INDEX`, per second."""
    unknown = np.zeros_like(_UNIT)
    unknown[GAP_INDEX, GAP_INDEX] = variance * stretch.duration_s
    return Stretch(_UNIT, unknown, np.zeros_like(_UNIT), 0.0).then(stretch)


def _stretch(step: Step, axes: Array | None) -> Stretch:
    """axes : (2, 2) those of the azimuth states; None: both components of e_h."""
    A, H, Q = step.A, step.H, step.Q
    if axes is not None:
        back = np.linalg.inv(axes)
        A, H = A.copy(), H.copy()
        A[:, AZIMUTH] = A[:, AZIMUTH] @ back
        A[AZIMUTH] = _UNIT[AZIMUTH]
        H[:, AZIMUTH] = H[:, AZIMUTH] @ back
    HA, HQ = H @ A, H @ Q
    inverse = np.linalg.inv(HQ @ H.T + step.R)
    K = HQ.T @ inverse
    W = (Q - K @ HQ)[:SIZE, :SIZE]
    return Stretch((A - K @ HA)[:SIZE], 0.5 * (W + W.T), HA.T @ inverse @ HA, step.duration_s)
