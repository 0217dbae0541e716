"""From the horizontal part of the Earth's axis to the azimuth.

e_h = cos L (sin alpha, cos alpha) is known with a Gaussian error; that its length is cos L
is known too. While the error is large the azimuth's density on the circle is summed up on a
grid; when it is small, Newton's method finds its maximum.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sins_align.types import Array

# Up to this variance of (sin, cos) the density is as good as Gaussian on the circle.
SMALL_VARIANCE = 0.02
FINE_SIGMA = 0.1  # [rad]
FAR = 0.5  # [rad], beyond it another maximum
_GRID = np.arange(180) * (math.tau / 180)
_UNIT = np.stack((np.sin(_GRID), np.cos(_GRID)))


class Azimuth(NamedTuple):
    """alpha [rad] and its 1 sigma [rad]; e_h : (2,) on the circle; tangent : (2,) de_h/dalpha."""

    alpha: float
    sigma: float
    e_h: Array
    tangent: Array


def find_azimuth(e_h: Array, P: Array, cos_latitude: float) -> Azimuth:
    """The azimuth given the length of e_h.

    Parameters
    ----------
    e_h : (2,) estimated horizontal part; P : (2, 2) its covariance
    cos_latitude : its length, above zero
    """
    information = np.linalg.inv(P) * cos_latitude**2
    mean = e_h / cos_latitude
    if P[0, 0] + P[1, 1] > SMALL_VARIANCE * cos_latitude**2:
        alpha, sigma, aside = _on_grid(mean, information)
        if sigma < FINE_SIGMA:  # too narrow for the grid, however long the error's axis
            alpha, sigma = _newton(mean, information, alpha)
            sigma = math.hypot(sigma, aside)
    else:
        alpha, sigma = _newton(mean, information, math.atan2(mean[0], mean[1]))
    s, c = math.sin(alpha), math.cos(alpha)
    return Azimuth(alpha, sigma, cos_latitude * np.array([s, c]), cos_latitude * np.array([c, -s]))


def _on_grid(mean: Array, information: Array) -> tuple[float, float, float]:
    """Circular mean, root of the mean square angle from it, and what is far off adds to that."""
    off = _UNIT - mean[:, None]
    weight = -0.5 * np.einsum("in,ij,jn->n", off, information, off)
    weight = np.exp(weight - weight.max())
    weight /= weight.sum()
    s, c = _UNIT @ weight
    alpha = math.atan2(s, c)
    angle = (_GRID - alpha + math.pi) % math.tau - math.pi
    square = weight * (angle * angle)
    aside = float(square[np.abs(angle) > FAR].sum())
    return alpha, math.sqrt(float(square.sum())), math.sqrt(aside)


def _newton(mean: Array, information: Array, alpha: float) -> tuple[float, float]:
    (a, b), (_, d) = information.tolist()
    x, y = mean.tolist()
    curvature = 1.0
    for _ in range(3):
        s, c = math.sin(alpha), math.cos(alpha)
        # Gradient of the half square J(u - m), u' = (c, -s), u'' = -u.
        rx, ry = a * (s - x) + b * (c - y), b * (s - x) + d * (c - y)
        slope = c * rx - s * ry
        tangent = a * c * c - 2.0 * b * s * c + d * s * s
        curvature = max(tangent - (s * rx + c * ry), 0.1 * tangent)
        alpha -= slope / curvature
    return alpha, 1.0 / math.sqrt(curvature)
