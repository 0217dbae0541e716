"""Latitudes by the two parts of the Earth's rate, and the one that both make.

The length of the horizontal part, Omega cos L, says nothing at the equator, where it hardly
changes, and nothing of the hemisphere; the vertical part, Omega sin L, says most there.
"""

from __future__ import annotations

import math

import numpy as np

from sins_align.earth import EARTH_RATE
from sins_align.types import LatitudeEstimate

LEAST_SLOPE = 1e-3
# Two latitudes that are further apart, over the sigma of both, are not of one place.
MOST_APART = 5.0


def latitude_of_rate(excess: float, sigma: float, given: float) -> LatitudeEstimate:
    """Of the rate about up, by how much it exceeds that at the latitude given [rad/s].

    The slope is that of the chord from the one to the other, so that their difference over sigma
    is that of the rates, which are Gaussian.
    """
    latitude = math.asin(min(max(math.sin(given) + excess / EARTH_RATE, -1.0), 1.0))
    half = 0.5 * (latitude - given)
    slope = math.cos(0.5 * (latitude + given)) * float(np.sinc(half / math.pi))
    return LatitudeEstimate(latitude, sigma / (EARTH_RATE * max(slope, LEAST_SLOPE)))


def combine_latitudes(
    length: LatitudeEstimate | None, up: LatitudeEstimate | None
) -> LatitudeEstimate | None:
    """By the length of the horizontal part and by the vertical part: they have nothing in common.

    Where they contradict each other the hemisphere may be the other one, of which the length
    knows nothing: the mean would be neither.
    """
    if length is None or up is None:
        return length if up is None else up
    return mean_latitude(length, up) if are_of_one_place(length, up) else up


def are_of_one_place(one: LatitudeEstimate, other: LatitudeEstimate) -> bool:
    """Whether two latitudes do not contradict each other."""
    apart = math.hypot(one.sigma, other.sigma)
    return abs(one.latitude - other.latitude) <= MOST_APART * apart


def mean_latitude(one: LatitudeEstimate, other: LatitudeEstimate) -> LatitudeEstimate:
    """Weighted by what each knows."""
    a, b = one.sigma**-2, other.sigma**-2
    latitude = (a * one.latitude + b * other.latitude) / (a + b)
    return LatitudeEstimate(latitude, 1.0 / math.sqrt(a + b))
