"""The rate about up by which the gyros disagree with the latitude that was given.

A base that sways, hangs or stands does not turn about up on the whole. The attitude that the gyros
carry on in axes of the Earth with a latitude L then does so at

    (sin L_true - sin L) Omega + b_U

which tells at the equator what `latitude` cannot tell there, and the hemisphere. As it takes for
granted what a moored ship does not keep to, and no truck that settles on its springs does to a
hundredth of a degree an hour, it is good for a doubt of the latitude alone, and not for one of the
gyro bias.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sins_align.earth import EARTH_RATE, earth_rate_n
from sins_align.grades import ImuGrade
from sins_align.latitudes import latitude_of_rate
from sins_align.rotation import rotations_about, unskew
from sins_align.swing.epochs import Epochs
from sins_align.types import Array, LatitudeEstimate

# The time that is looked at, and the least that tells [s].
WINDOW_S, LEAST_S = 300.0, 40.0
# Means are weighted by sin^6: what a swing of n periods leaves of its rate falls like n^-7, and
# the variance of white noise is NOISE times what it is in a plain mean.
NOISE = 2.31
# The whole time and three parts of it: where they begin, and how long they are. How the means over
# the parts differ, as the sum of squares about their mean, is by white noise NOISE_APART likewise.
BEGINS, LENGTHS = np.array([0.0, 0.0, 0.125, 0.25]), np.array([1.0, 0.75, 0.75, 0.75])
NOISE_APART = 3.24
# They differ less than they are wrong: all of them hold most of a slow turn. Below so many times
# what noise makes them differ by, they say nothing.
SLOWNESS, SEEN = 3.0, 2.0
# A base creeps by this, unseen [rad].
CREEP = 2e-6
# A rate that no latitude explains, by so many sigma, is that of a base that turns.
TURNS = 5.0


class Turning(NamedTuple):
    """By how much the base seems to turn too fast, and its 1 sigma without any bias [rad/s]."""

    excess: float
    sigma: float


def turning(epochs: Epochs, R: Array, latitude: float, grade: ImuGrade) -> Turning | None:
    """The turn of the last five minutes; None before there is enough.

    Parameters
    ----------
    R : (3, 3) columns east, north, up at t = 0 in b0; latitude : given [rad]
    """
    nodes_s = epochs.time_s
    first = int(np.searchsorted(nodes_s, nodes_s[-1] - WINDOW_S))
    T = float(nodes_s[-1] - nodes_s[first])
    if T < LEAST_S:
        return None
    # Of the mean over an epoch: shaking, seen once an epoch, would be a slow turn.
    t = 0.5 * (nodes_s[first:-1] + nodes_s[first + 1 :])
    mean = rotations_about(-earth_rate_n(latitude), t) @ (R.T @ epochs.B[first:])
    heading = _about_up(mean @ mean[0].T)
    share = (0.5 * (t[1:] + t[:-1]) - nodes_s[first]) / T
    inside = np.clip((share - BEGINS[:, None]) / LENGTHS[:, None], 0.0, 1.0)
    square = np.sin(math.pi * inside) ** 2
    weights = square * square * square
    whole, *parts = ((weights @ np.diff(heading)) / (weights @ np.diff(t))).tolist()
    apart = sum((part - sum(parts) / 3.0) ** 2 for part in parts)
    noise = grade.gyro_arw**2 / T
    apart = max(apart - SEEN**2 * NOISE_APART * noise, 0.0)
    variance = NOISE * noise + SLOWNESS**2 * apart + (2.0 * CREEP / T) ** 2
    if max(grade.gyro_scale, grade.misalignment) > 0.0:
        variance += _rectified(epochs, first, R[:, 2], grade)
    return Turning(whole, math.sqrt(variance))


def _rectified(epochs: Epochs, first: int, up_b0: Array, grade: ImuGrade) -> float:
    """Variance of the mean of up . C M w, by scale errors and misalignments M [rad^2/s^2].

    That of a base that cones is not zero. first : node from which on; up_b0 : (3,) unit vector
    """
    C, T = epochs.C[first:], float(epochs.time_s[-1] - epochs.time_s[first])
    turned = unskew(C[:-1].transpose(0, 2, 1) @ C[1:])
    up_b = up_b0 @ (0.5 * (C[:-1] + C[1:]))
    sigma = np.full((3, 3), grade.misalignment)
    np.fill_diagonal(sigma, grade.gyro_scale)
    return float(((sigma * (up_b.T @ turned) / T) ** 2).sum())


def latitude_of_turning(
    turn: Turning | None, latitude: float, bias: float
) -> LatitudeEstimate | None:
    """Of a base that does not turn: what `turning` found of it, for the latitude given [rad].

    bias : 1 sigma of the gyros', as declared [rad/s]
    """
    if turn is None:
        return None
    sigma = math.hypot(turn.sigma, bias)
    most = 1.0 + TURNS * sigma / EARTH_RATE
    if not abs(math.sin(latitude) + turn.excess / EARTH_RATE) < most:
        return None
    return latitude_of_rate(turn.excess, sigma, latitude)


def _about_up(turn: Array) -> Array:
    """(N,) by how much rotations (N, 3, 3), or their means, turn about up [rad].

    2 atan2(q_z, q_w): a further turn about up adds to it what it is, whatever the tilt.
    """
    angle = np.arctan2(turn[:, 1, 0] - turn[:, 0, 1], turn[:, 0, 0] + turn[:, 1, 1])
    return np.unwrap(angle)
