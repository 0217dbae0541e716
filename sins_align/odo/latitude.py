"""The latitude by the horizontal part of the Earth's axis, whose length is its cosine."""

from __future__ import annotations

import math

import numpy as np

from sins_align.types import Array, LatitudeEstimate

# Less certain than this it tells nothing [rad].
MOST_SIGMA = math.radians(6.0)
# Error of e_h over its length, beyond which the length is not as good as Gaussian.
MOST_SHARE = 0.2
LEAST_SLOPE = 1e-6


def latitude_of_axis(e_h: Array, P: Array, given: float) -> LatitudeEstimate | None:
    """The latitude of |e_h| = cos L, and sigma_L = sigma_|e_h| / sin L.

    In place of sin L stands the slope of the chord from it to the one given, so that their
    difference over sigma is that of the lengths, which are Gaussian, near the equator too. The
    hemisphere is not to be had from a length: it is that of the one given. The vertical part,
    taken as known, tells nothing of it: an error there is a gyro bias about the vertical.

    Parameters
    ----------
    e_h : (2,) horizontal part, estimated without its length; P : (2, 2) its covariance
    given : the latitude to compare it with [rad]

    Returns
    -------
    None where it is not known to 6 deg
    """
    length = math.hypot(*e_h.tolist())
    if not float(P.trace()) < (MOST_SHARE * length) ** 2:
        return None
    along = e_h / length
    return latitude_of_length(length, math.sqrt(float(along @ P @ along)), given)


def latitude_of_length(length: float, sigma: float, given: float) -> LatitudeEstimate | None:
    """See `latitude_of_axis`; sigma : of the length."""
    latitude = math.acos(min(length, 1.0))
    half = 0.5 * (latitude - abs(given))
    slope = math.sin(0.5 * (latitude + abs(given))) * float(np.sinc(half / math.pi))
    slope = max(slope, LEAST_SLOPE)  # at the equator, given and found, there is none
    if not sigma < MOST_SIGMA * slope:
        return None
    return LatitudeEstimate(math.copysign(latitude, given), sigma / slope)


class LengthError:
    """What a filter that takes the length of e_h as known is still told of it.

    Its error r, a constant, is split off as Friedland does a bias: the filter's errors are what
    they would be without it plus V r, and its innovations white noise plus H V r.

    V : (n,) errors of the filter's states by r, which is one of them, without variance
    r, information : estimate minus truth of the length, and the inverse of its variance
    """

    def __init__(self, V: Array, r: float, variance: float) -> None:
        self.V = V
        self.r = r
        self.information = 1.0 / variance
        self._ahead = V

    def propagate(self, A: Array) -> None:
        """Over an epoch; A : (n + 3, n) transition."""
        self._ahead = A @ self.V
        self.V = self._ahead[: self.V.shape[0]]

    def update(self, H: Array, gain: Array, value: Array, inverse: Array) -> None:
        """With an innovation (3,), the inverse of its covariance (3, 3) and the gain (n, 3)."""
        by_length = H @ self._ahead
        weighted = inverse @ by_length
        self.information += float(weighted @ by_length)
        self.r += float(weighted @ (value - by_length * self.r)) / self.information
        self.V = self.V - gain @ by_length
