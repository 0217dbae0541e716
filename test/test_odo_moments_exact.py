"""The moment rules against expectations in closed form, and each against its textbook."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from moment_maps import (
    DEGREE,
    ROUNDING,
    SIGMA_POINTS,
    Constant,
    Trigonometric,
    assert_close,
    random_covariance,
    random_map,
)

from sins_align.odo.moments import (
    ConditionallyLinear,
    Cubature,
    FullGaussHermite,
    Linearised,
    MomentRule,
    Moments,
    ReducedGaussHermite,
    Unscented,
)
from sins_align.types import Array

# --- against expectations in closed form


SINES = Trigonometric(  # sin U, cos U, U sin U, U cos U of x = (U, v)
    np.array(
        [
            np.zeros((4, 2)),
            [[0, 0], [0, 0], [1, 0], [0, 0]],
            [[0, 0], [0, 0], [0, 0], [1, 0]],
        ]
    ),
    np.array([[0.0, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0]]),
)


def expected_sines(mu: float, variance: float) -> Array:
    """E of sin U, cos U, U sin U, U cos U: of exp(jU) and its derivative."""
    s, c = math.exp(-0.5 * variance) * np.array([math.sin(mu), math.cos(mu)])
    return np.array([s, c, mu * s + variance * c, mu * c - variance * s])


def sine_error(rule: MomentRule, sigma: float) -> float:
    """Largest error of the means, and of covariance and cross covariance of sin U and cos U."""
    mu, variance = 0.4, sigma**2
    P = variance * np.array([[1.0, 0.3], [0.3, 1.0]])
    got = rule(SINES, np.array([mu, 0.0]), P, 0)
    wanted = expected_sines(mu, variance)
    s, c = wanted[:2]
    s2, c2 = expected_sines(2.0 * mu, 4.0 * variance)[:2]
    covariance = np.array(
        [[0.5 * (1.0 - c2) - s * s, 0.5 * s2 - s * c], [0.5 * s2 - s * c, 0.5 * (1.0 + c2) - c * c]]
    )
    cross = P[:, :1] * np.array([[c, -s]])  # Stein: cov(x, f(U)) = cov(x, U) E f'(U)
    return max(
        np.abs(got.mean - wanted).max(),
        np.abs(got.covariance[:2, :2] - covariance).max(),
        np.abs(got.cross[:, :2] - cross).max(),
    )


def test_sines_as_the_order_grows() -> None:
    """sigma_U = 60 deg: from a useless answer to an exact one."""
    errors = [sine_error(ReducedGaussHermite(order), 60.0 * DEGREE) for order in range(2, 22)]
    assert errors[0] > 0.1
    assert all(later < 0.7 * e for e, later in itertools.pairwise(errors[:12]))
    assert errors[-1] < ROUNDING


def test_three_nodes_at_five_degrees() -> None:
    """Enough: 1e-7 rad is .02 arcsec. A Jacobian is wrong by 20 arcmin."""
    assert sine_error(ReducedGaussHermite(3), 5.0 * DEGREE) < 1e-7
    assert sine_error(Linearised(), 5.0 * DEGREE) > 5e-3


@pytest.mark.parametrize(
    ("rule", "power"),
    [
        (ReducedGaussHermite(2), 4),
        (ReducedGaussHermite(3), 6),
        (FullGaussHermite(3), 6),
        (Cubature(), 4),
        (Unscented(), 4),
        (Unscented(alpha=0.7, beta=1.5, kappa=2.0), 4),
        (Linearised(), 2),
    ],
    ids=str,
)
def test_power_of_sigma_in_the_error(rule: MomentRule, power: int) -> None:
    """The means of a Jacobian lack sigma^2, of points exact to degree 3 or 5 sigma^4 or 6."""
    ratio = sine_error(rule, 0.2) / sine_error(rule, 0.1)
    assert math.log2(ratio) == pytest.approx(power, abs=0.25)


def test_against_a_million_samples() -> None:
    """All of y at once, with U in F and g and all states correlated."""
    rng = np.random.default_rng(13)
    n, index, count = 3, 1, 1_000_000
    map_, P, mean = random_map(rng, 2, n), random_covariance(rng, n), rng.normal(size=n)
    got = ReducedGaussHermite(15)(map_, mean, P, index)
    x = mean + rng.normal(size=(count, n)) @ np.linalg.cholesky(P).T
    terms = np.stack((np.ones(count), np.sin(x[:, index]), np.cos(x[:, index])))
    y = np.einsum("ti,tkn,in->ik", terms, map_.F, x, optimize=True) + terms.T @ map_.g
    dx, dy = x - mean, y - got.mean
    sampled = [dy, dy[:, :, None] * dy[:, None, :], dx[:, :, None] * dy[:, None, :]]
    for samples, value in zip(sampled, [0.0, got.covariance, got.cross], strict=True):
        deviation = samples.std(axis=0) / math.sqrt(count)
        assert (np.abs(samples.mean(axis=0) - value) <= 4.5 * deviation).all()


# --- each by itself


def textbook(
    map_: ConditionallyLinear, points: Array, mean_weights: Array, weights: Array, mean: Array
) -> Moments:
    """Sums over points one by one, U first."""
    y = []
    for point in points:
        F, g = map_.at(point[:1])
        y.append(F[0] @ point + g[0])
    mean_y = sum(w * value for w, value in zip(mean_weights, y, strict=True))
    covariance, cross = np.zeros((mean_y.size, mean_y.size)), np.zeros((mean.size, mean_y.size))
    for w, point, value in zip(weights, points, y, strict=True):
        covariance += w * np.outer(value - mean_y, value - mean_y)
        cross += w * np.outer(point - mean, value - mean_y)
    return Moments(mean_y, covariance, cross)


@pytest.mark.parametrize(
    ("alpha", "beta", "kappa"), [(0.5, 2.0, 0.0), (1.0, 0.0, -1.0), (0.7, 1.5, 2.0)]
)
def test_unscented_is_the_textbooks(alpha: float, beta: float, kappa: float) -> None:
    rng = np.random.default_rng(14)
    n = 4
    map_, P, mean = random_map(rng, 3, n), random_covariance(rng, n), rng.normal(size=n)
    lam = alpha**2 * (n + kappa) - n
    columns = math.sqrt(n + lam) * np.linalg.cholesky(P).T
    points = mean + np.concatenate((np.zeros((1, n)), columns, -columns))
    mean_weights = np.full(2 * n + 1, 0.5 / (n + lam))
    mean_weights[0] = lam / (n + lam)
    weights = mean_weights + np.eye(2 * n + 1)[0] * (1.0 - alpha**2 + beta)
    wanted = textbook(map_, points, mean_weights, weights, mean)
    got = Unscented(alpha, beta, kappa)(map_, mean, P, 0)
    assert_close(got, wanted, P, 100 * ROUNDING)


def test_cubature_is_the_textbooks() -> None:
    rng = np.random.default_rng(15)
    n = 5
    map_, P, mean = random_map(rng, 3, n), random_covariance(rng, n), rng.normal(size=n)
    columns = math.sqrt(n) * np.linalg.cholesky(P).T
    weights = np.full(2 * n, 0.5 / n)
    points = mean + np.concatenate((columns, -columns))
    wanted = textbook(map_, points, weights, weights, mean)
    assert_close(Cubature()(map_, mean, P, 0), wanted, P, 100 * ROUNDING)


def test_linearised_is_the_jacobian() -> None:
    rng = np.random.default_rng(16)
    map_, P, mean = random_map(rng, 3, 4), random_covariance(rng, 4), rng.normal(size=4)
    (F,), (g,) = map_.at(mean[2:3])
    dF, dg = map_.by_angle(mean[2])
    J = F + np.outer(dF @ mean + dg, np.eye(4)[2])
    wanted = Moments(F @ mean + g, J @ P @ J.T, P @ J.T)
    # step^2 / 6 = 1.7e-9 of the third derivative
    assert_close(Linearised()(map_, mean, P, 2), wanted, P, 1e-6)
    with pytest.raises(AssertionError):
        assert_close(Linearised(step=0.1)(map_, mean, P, 2), wanted, P, 1e-6)


@pytest.mark.parametrize("rule", [*SIGMA_POINTS, FullGaussHermite()], ids=str)
def test_rounding_may_make_a_covariance_indefinite(rule: MomentRule) -> None:
    """A correlation of 1 + 1e-7 becomes the nearest that there is: half of that is wrong."""
    P = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0 + 1e-7], [0.0, 1.0 + 1e-7, 1.0]])
    got = rule(Constant(np.eye(3), np.zeros(3)), np.zeros(3), P, 0)
    np.testing.assert_allclose(got.covariance, P, rtol=0.0, atol=0.51e-7)


@pytest.mark.parametrize("rule", [*SIGMA_POINTS, FullGaussHermite()], ids=str)
def test_no_covariance(rule: MomentRule) -> None:
    """A correlation of 1.5."""
    P = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.5], [0.0, 1.5, 1.0]])
    with pytest.raises(np.linalg.LinAlgError, match="not semidefinite"):
        rule(Constant(np.eye(3), np.zeros(3)), np.zeros(3), P, 0)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: ReducedGaussHermite(1), "order of 2 or more, not 1"),
        (lambda: FullGaussHermite(1), "order of 2 or more, not 1"),
        (lambda: Unscented(alpha=0.0), "alpha must be positive"),
        (lambda: Unscented(alpha=math.nan), "alpha must be positive"),
        (lambda: Linearised(step=-1e-4), "step must be positive"),
    ],
)
def test_settings_that_are_none(make: object, says: str) -> None:
    assert callable(make)
    with pytest.raises(ValueError, match=says):
        make()


def test_settings_that_do_not_suit_the_states() -> None:
    n = 20
    linear, P = Constant(np.eye(n), np.zeros(n)), np.eye(n)
    with pytest.raises(ValueError, match="n \\+ kappa must be positive"):
        Unscented(kappa=-20.0)(linear, np.zeros(n), P, 0)
    with pytest.raises(ValueError, match="nodes are more than"):
        FullGaussHermite()(linear, np.zeros(n), P, 0)
