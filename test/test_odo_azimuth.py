"""The azimuth from the Earth's axis against its density, summed up by brute force."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sins_align.odo.azimuth import Azimuth, find_azimuth
from sins_align.types import Array

DEGREE = math.radians(1.0)
COS_LATITUDE = math.cos(math.radians(40.0))
FINE = np.arange(200_000) * (math.tau / 200_000)


def wrapped(angle: Array) -> Array:
    return (angle + math.pi) % math.tau - math.pi


def posterior(e_h: Array, P: Array, cos_latitude: float = COS_LATITUDE) -> tuple[float, float]:
    """Circular mean, and the root of the mean square angle from it."""
    off = cos_latitude * np.stack((np.sin(FINE), np.cos(FINE))) - e_h[:, None]
    exponent = -0.5 * np.einsum("in,ij,jn->n", off, np.linalg.inv(P), off)
    weight = np.exp(exponent - exponent.max())
    weight /= weight.sum()
    alpha = math.atan2(weight @ np.sin(FINE), weight @ np.cos(FINE))
    return alpha, math.sqrt(float(weight @ wrapped(FINE - alpha) ** 2))


def ellipse(long_sigma: float, short_sigma: float, angle: float) -> Array:
    """Covariance in units of cos L; the angle is that of the long axis from x."""
    c, s = math.cos(angle), math.sin(angle)
    R = np.array([[c, -s], [s, c]])
    return COS_LATITUDE**2 * R @ np.diag([long_sigma**2, short_sigma**2]) @ R.T


def point(alpha: float, length: float = 1.0) -> Array:
    return length * COS_LATITUDE * np.array([math.sin(alpha), math.cos(alpha)])


def assert_agrees(found: Azimuth, e_h: Array, P: Array, mean: float, sigma: float) -> None:
    """mean : tolerance of alpha over its sigma; sigma : relative tolerance of that."""
    alpha, spread = posterior(e_h, found.excess * P)
    assert abs(wrapped(np.array(found.alpha - alpha))) < mean * spread
    assert found.sigma == pytest.approx(spread, rel=sigma)


@pytest.mark.parametrize("sigma", [3.0, 1.0, 0.7, 0.4, 0.2])
@pytest.mark.parametrize("alpha", [0.0, 0.3, 2.0, -3.1])
def test_wide_errors(sigma: float, alpha: float) -> None:
    """The grid's two degrees are fine enough for these."""
    e_h, P = point(alpha, 0.6), ellipse(sigma, 0.8 * sigma, 0.4)
    assert_agrees(find_azimuth(e_h, P, COS_LATITUDE), e_h, P, 0.02, 0.01)


@pytest.mark.parametrize("sigma", [0.09, 0.05, 0.01, 1e-3, 1e-5])
@pytest.mark.parametrize("alpha", [0.0, 0.3, 2.0, -3.1])
def test_narrow_errors(sigma: float, alpha: float) -> None:
    e_h = point(alpha + 1.5 * sigma, 1.0 - sigma)
    P = ellipse(sigma, 0.5 * sigma, 1.0)
    fine = sigma > 1e-4  # the brute sum's own step is 3e-5
    if fine:
        # Of a density that is not quite Gaussian, its maximum for its mean.
        assert_agrees(find_azimuth(e_h, P, COS_LATITUDE), e_h, P, 2.0 * sigma + 0.01, 0.05)
    else:
        found = find_azimuth(e_h, P, COS_LATITUDE)
        tangent = found.tangent
        assert found.sigma == pytest.approx((tangent @ np.linalg.solve(P, tangent)) ** -0.5, 1e-3)


@pytest.mark.parametrize("angle", np.arange(8) * math.pi / 8)
@pytest.mark.parametrize(("long", "short"), [(1.0, 0.02), (0.35, 0.01), (0.3, 0.05), (0.7, 0.1)])
def test_elongated_errors(angle: float, long: float, short: float) -> None:
    """Where the circle crosses the long axis once."""
    alpha = 0.5 * math.pi - angle  # the long axis points there
    e_h, P = point(alpha, 1.05), ellipse(long, short, angle)
    found = find_azimuth(e_h, P, COS_LATITUDE)
    spread = posterior(e_h, found.excess * P)[1]
    if spread < 0.5:
        assert_agrees(found, e_h, P, 0.15, 0.15)
    else:
        # Two ends of a diameter: the sigma must say so.
        assert found.sigma == pytest.approx(spread, rel=0.15)


@pytest.mark.parametrize("seed", range(40))
def test_any_error(seed: float) -> None:
    """Never far from the truth by its own sigma, never surer than it may be."""
    rng = np.random.default_rng(seed)
    long = 10.0 ** rng.uniform(-3.0, 0.3)
    P = ellipse(long, long * 10.0 ** rng.uniform(-1.5, 0.0), rng.uniform(0.0, math.pi))
    alpha = rng.uniform(-math.pi, math.pi)
    e_h = point(alpha) + np.linalg.cholesky(P) @ rng.normal(size=2)
    found = find_azimuth(e_h, P, COS_LATITUDE)
    mean, spread = posterior(e_h, found.excess * P)
    off = abs(float(wrapped(np.array(found.alpha - mean))))
    assert off < 0.35 * spread
    assert 0.75 * spread < found.sigma < 1.35 * spread


def test_nothing_known() -> None:
    """Uniform on the circle: pi / sqrt(3)."""
    found = find_azimuth(np.zeros(2), 0.5 * COS_LATITUDE**2 * np.eye(2), COS_LATITUDE)
    assert found.sigma == pytest.approx(math.pi / math.sqrt(3.0), rel=1e-3)


@pytest.mark.parametrize("turn", [0.1, 1.0, -2.0])
def test_turning_all_turns_the_answer(turn: float) -> None:
    R = Rotation.from_rotvec([0.0, 0.0, -turn]).as_matrix()[:2, :2]  # alpha is clockwise
    e_h, P = point(0.4, 0.95), ellipse(0.05, 0.02, 0.3)
    one = find_azimuth(e_h, P, COS_LATITUDE)
    other = find_azimuth(R @ e_h, R @ P @ R.T, COS_LATITUDE)
    assert wrapped(np.array(other.alpha - one.alpha - turn)) == pytest.approx(0.0, abs=1e-9)
    assert other.sigma == pytest.approx(one.sigma, rel=1e-9)


def test_vectors() -> None:
    """e_h lies on the circle, and the tangent is its derivative."""
    found = find_azimuth(point(1.2, 0.9), ellipse(0.1, 0.1, 0.0), COS_LATITUDE)
    np.testing.assert_allclose(found.e_h, point(found.alpha), atol=1e-15)
    difference = (point(found.alpha + 1e-6) - point(found.alpha - 1e-6)) / 2e-6
    np.testing.assert_allclose(found.tangent, difference, atol=1e-9)


@pytest.mark.parametrize("cos_latitude", [1.0, 0.1, 1.7e-3, 1e-6])
def test_latitude_is_a_scale(cos_latitude: float) -> None:
    scale = cos_latitude / COS_LATITUDE
    e_h, P = point(2.2, 0.9), ellipse(0.2, 0.1, 0.3)
    here = find_azimuth(e_h, P, COS_LATITUDE)
    there = find_azimuth(scale * e_h, scale**2 * P, cos_latitude)
    assert there.alpha == pytest.approx(here.alpha, abs=1e-6 * DEGREE)
    assert there.sigma == pytest.approx(here.sigma, rel=1e-6)


def test_an_estimate_off_the_circle_is_not_believed() -> None:
    """By eight sigma: the covariance is 64 times too small; by one and a half it may be right."""
    P = ellipse(0.05, 0.05, 0.0)
    assert find_azimuth(point(1.0, 0.6), P, COS_LATITUDE).excess == pytest.approx(64.0)
    assert find_azimuth(point(1.0, 0.925), P, COS_LATITUDE).excess == 1.0
    assert find_azimuth(point(1.0), P, COS_LATITUDE, 9.0).excess == 9.0
