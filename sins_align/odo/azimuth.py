"""From the horizontal part of the Earth's axis to the azimuth.

e_h = cos L (sin alpha, cos alpha) is known with a Gaussian error; that its length is cos L
is known too. The azimuth's density on the circle is summed up on a grid; where it is narrow,
Newton's method finds its maximum from there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sins_align.types import Array

FINE_SIGMA = 0.1  # [rad]
NEWTON_STEPS = 8
MOST_OFF = 9.0  # of the normalised square off the circle
FAR = 0.5  # [rad], beyond it another maximum
_GRID = np.arange(180) * (math.tau / 180)
_UNIT = np.stack((np.sin(_GRID), np.cos(_GRID)))


class Azimuth(NamedTuple):
    """The azimuth, and how well the estimate fits the circle.

    alpha [rad] and its 1 sigma [rad]; e_h : (2,) on the circle; tangent : (2,) de_h/dalpha
    excess : factor on all covariances, 1 where the estimate is on the circle as it should be
    """

    alpha: float
    sigma: float
    e_h: Array
    tangent: Array
    excess: float = 1.0


def find_azimuth(e_h: Array, P: Array, cos_latitude: float, least: float = 1.0) -> Azimuth:
    """The azimuth given the length of e_h.

    That e_h is off the circle by more than its error should be is a test of the covariance
    that costs nothing: chi-square with one degree of freedom. Beyond three sigma the covariance
    is taken as so much larger.

    Parameters
    ----------
    e_h : (2,) estimated horizontal part; P : (2, 2) its covariance
    cos_latitude : its length, above zero
    least : excess at the least
    """
    information = np.linalg.inv(P) * cos_latitude**2
    mean = e_h / cos_latitude
    alpha, sigma, square = _search(mean, information)
    excess = max(square if square > MOST_OFF else 1.0, least)
    if excess > 1.0:
        alpha, sigma, _ = _search(mean, information / excess)
    s, c = math.sin(alpha), math.cos(alpha)
    point, tangent = np.array([s, c]), np.array([c, -s])
    return Azimuth(alpha, sigma, cos_latitude * point, cos_latitude * tangent, excess)


def _search(mean: Array, information: Array) -> tuple[float, float, float]:
    """Azimuth, sigma, and the least normalised square of a point on the circle.

    On the grid, and where that is too coarse, by Newton from there.
    """
    alpha, sigma, aside, least = _on_grid(mean, information)
    if sigma < FINE_SIGMA:
        alpha, sigma = _newton(mean, information, alpha)
        sigma = math.hypot(sigma, aside)
    off = np.array([math.sin(alpha), math.cos(alpha)]) - mean
    return alpha, sigma, min(least, float(off @ information @ off))


def _on_grid(mean: Array, information: Array) -> tuple[float, float, float, float]:
    """Circular mean, root of the mean square angle from it, what is far off adds to that.

    And the least normalised square.
    """
    off = _UNIT - mean[:, None]
    weight = -0.5 * np.einsum("in,ij,jn->n", off, information, off)
    most = float(weight.max())
    weight = np.exp(weight - most)
    weight /= weight.sum()
    s, c = _UNIT @ weight
    alpha = math.atan2(s, c)
    angle = (_GRID - alpha + math.pi) % math.tau - math.pi
    square = weight * (angle * angle)
    aside = float(square[np.abs(angle) > FAR].sum())
    return alpha, math.sqrt(float(square.sum())), math.sqrt(aside), -2.0 * most


def _newton(mean: Array, information: Array, alpha: float) -> tuple[float, float]:
    (a, b), (_, d) = information.tolist()
    x, y = mean.tolist()
    curvature = 1.0
    for _ in range(NEWTON_STEPS):
        s, c = math.sin(alpha), math.cos(alpha)
        # Gradient of the half square J(u - m), u' = (c, -s), u'' = -u.
        rx, ry = a * (s - x) + b * (c - y), b * (s - x) + d * (c - y)
        slope = c * rx - s * ry
        tangent = a * c * c - 2.0 * b * s * c + d * s * s
        curvature = max(tangent - (s * rx + c * ry), 0.1 * tangent)
        alpha -= slope / curvature
    return alpha, 1.0 / math.sqrt(curvature)
