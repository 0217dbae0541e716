"""The moment rules: laws that all of them obey, and what each is by itself."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

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

# Errors are counted in units of the quantities' own sigmas.
ROUNDING = 1e-12
# Unscented's points are alpha = 1e-3 apart, Linearised's differences a step of 1e-4 rad.
DIFFERENCED = 1e-8
DEGREE = math.radians(1.0)

SIGMA_POINTS = [Cubature(), Unscented(), Unscented(alpha=0.7, beta=1.5, kappa=2.0)]
GAUSS_HERMITE = [
    ReducedGaussHermite(2),
    ReducedGaussHermite(),
    ReducedGaussHermite(7),
    FullGaussHermite(2),
    FullGaussHermite(),
]
RULES: list[MomentRule] = [*GAUSS_HERMITE, *SIGMA_POINTS, Linearised()]
every_rule = pytest.mark.parametrize("rule", RULES, ids=str)


@dataclass(frozen=True)
class Trigonometric:
    """F(U) = F[0] + F[1] sin U + F[2] cos U, g the same: F (3, k, n), g (3, k)."""

    F: Array
    g: Array

    def at(self, angle: Array) -> tuple[Array, Array]:
        terms = np.stack((np.ones_like(angle), np.sin(angle), np.cos(angle)), axis=1)
        return np.einsum("mt,tkn->mkn", terms, self.F), terms @ self.g

    def by_angle(self, angle: float) -> tuple[Array, Array]:
        """dF/dU (k, n), dg/dU (k,)."""
        terms = np.array([0.0, math.cos(angle), -math.sin(angle)])
        return np.einsum("t,tkn->kn", terms, self.F), terms @ self.g


@dataclass(frozen=True)
class Constant:
    """y = F x + g, of one F (k, n) and g (k,), which are read-only."""

    F: Array
    g: Array

    def at(self, angle: Array) -> tuple[Array, Array]:
        many = (angle.size,)
        return np.broadcast_to(self.F, many + self.F.shape), np.broadcast_to(
            self.g, many + self.g.shape
        )


@dataclass(frozen=True)
class Transformed:
    """The same map of other states x' = T x + shift e_index, T[index] = T[:, index] = e_index."""

    of: ConditionallyLinear
    T: Array
    shift: float
    index: int

    def at(self, angle: Array) -> tuple[Array, Array]:
        F, g = self.of.at(angle - self.shift)
        F = F @ np.linalg.inv(self.T)
        return F, g - self.shift * F[:, :, self.index]


def random_map(rng: np.random.Generator, k: int, n: int) -> Trigonometric:
    return Trigonometric(rng.normal(size=(3, k, n)), rng.normal(size=(3, k)))


def random_covariance(rng: np.random.Generator, n: int, rank: int | None = None) -> Array:
    """(n, n) of unit variances."""
    S = rng.normal(size=(n, n if rank is None else rank))
    S /= np.linalg.norm(S, axis=1)[:, None]
    return frozen(S @ S.T)


def frozen(array: Array) -> Array:
    array.setflags(write=False)
    return array


def tolerance(rule: MomentRule) -> float:
    return DIFFERENCED if isinstance(rule, Unscented | Linearised) else ROUNDING


def assert_close(got: Moments, wanted: Moments, P: Array, atol: float) -> None:
    """Moments of y that is about 1; cross per sigma of x."""
    sigma = np.sqrt(P.diagonal())[:, None]
    np.testing.assert_allclose(got.mean, wanted.mean, rtol=0.0, atol=atol)
    np.testing.assert_allclose(got.covariance, wanted.covariance, rtol=0.0, atol=atol)
    assert (np.abs(got.cross - wanted.cross) <= atol * sigma).all()


# Covariances of any rank, with sigmas of any size.
@st.composite
def covariances(draw: st.DrawFn, n: int) -> Array:
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    P = random_covariance(rng, n, draw(st.integers(1, n)))
    sigma = 10.0 ** np.array(draw(st.lists(st.floats(-10.0, 2.0), min_size=n, max_size=n)))
    known = np.array(draw(st.lists(st.integers(0, 5), min_size=n, max_size=n))) == 0
    sigma[known] = 0.0
    return frozen(P * np.outer(sigma, sigma))


seeds = st.integers(0, 2**32 - 1)


# --- laws of all rules


@every_rule
@given(P=covariances(4), seed=seeds, index=st.integers(0, 3), size=st.sampled_from([0.0, 1e4]))
def test_a_linear_map_is_exact(
    rule: MomentRule, P: Array, seed: int, index: int, size: float
) -> None:
    """F P F' for any P, with variances of 0 and from 1e-20 to 1e4, and means of any size."""
    rng = np.random.default_rng(seed)
    F, g = frozen(rng.normal(size=(5, 4))), frozen(size * rng.normal(size=5))
    mean = frozen(size * rng.normal(size=4))
    got = rule(Constant(F, g), mean, P, index)
    sigma = np.sqrt(P.diagonal())
    spread = np.abs(F) @ sigma
    largest = np.abs(F) @ np.abs(mean) + np.abs(g) + spread
    assert (np.abs(got.mean - F @ mean - g) <= ROUNDING * largest).all()
    error = np.abs(got.covariance - F @ P @ F.T)
    assert (error <= ROUNDING * np.outer(spread, spread)).all()
    assert (np.abs(got.cross - P @ F.T) <= ROUNDING * np.outer(sigma, spread)).all()


def run_filter(
    rule: MomentRule,
    process: list[ConditionallyLinear],
    measurement: list[ConditionallyLinear],
    mean: Array,
    P: Array,
    index: int,
    z: Array,
) -> list[tuple[Array, Array]]:
    """Mean and covariance after each epoch, of Q = 1e-2 and R = 0.1."""
    states = []
    for step, observe, value in zip(process, measurement, z, strict=True):
        mean, covariance, _ = rule(step, mean, P, index)
        P = covariance + 1e-2 * np.eye(mean.size)
        predicted, S, cross = rule(observe, mean, P, index)
        S = S + 0.1 * np.eye(predicted.size)
        K = np.linalg.solve(S, cross.T).T
        mean, P = mean + K @ (value - predicted), P - K @ S @ K.T
        P = 0.5 * (P + P.T)
        states.append((mean, P))
    return states


@every_rule
def test_with_a_linear_model_the_filter_is_kalmans(rule: MomentRule) -> None:
    rng = np.random.default_rng(3)
    epochs, n, index = 12, 4, 1
    F, H = 0.5 * rng.normal(size=(epochs, n, n)), rng.normal(size=(epochs, 2, n))
    g, h, z = (
        rng.normal(size=(epochs, n)),
        rng.normal(size=(epochs, 2)),
        rng.normal(size=(epochs, 2)),
    )
    mean, P = rng.normal(size=n), random_covariance(rng, n)
    states = run_filter(
        rule,
        [Constant(*pair) for pair in zip(F, g, strict=True)],
        [Constant(*pair) for pair in zip(H, h, strict=True)],
        mean,
        P,
        index,
        z,
    )
    for i, (got_mean, got_P) in enumerate(states):
        mean, P = F[i] @ mean + g[i], F[i] @ P @ F[i].T + 1e-2 * np.eye(n)
        gain = P @ H[i].T @ np.linalg.inv(H[i] @ P @ H[i].T + 0.1 * np.eye(2))
        mean, P = mean + gain @ (z[i] - H[i] @ mean - h[i]), P - gain @ H[i] @ P
        np.testing.assert_allclose(got_mean, mean, rtol=0.0, atol=ROUNDING)
        np.testing.assert_allclose(got_P, P, rtol=0.0, atol=ROUNDING)


@every_rule
@given(P=covariances(4), seed=seeds, index=st.integers(0, 3))
def test_symmetric_and_positive(rule: MomentRule, P: Array, seed: int, index: int) -> None:
    """The covariance of x and y together: what an update needs, to leave P positive."""
    rng = np.random.default_rng(seed)
    map_ = random_map(rng, 3, 4)
    _, covariance, cross = rule(map_, frozen(rng.normal(size=4)), P, index)
    np.testing.assert_array_equal(covariance, covariance.T)
    joint = np.block([[P, cross], [cross.T, covariance]])
    sigma = np.sqrt(joint.diagonal())
    # A variance of y may be rounding alone; it then has no correlations.
    floor = np.r_[np.zeros(4), np.full(3, math.sqrt(ROUNDING))]
    scale = np.where(sigma > floor, 1.0 / np.maximum(sigma, 1e-300), 0.0)
    correlation = joint * np.outer(scale, scale)
    assert np.linalg.eigvalsh(correlation)[0] >= -DIFFERENCED


@every_rule
@pytest.mark.parametrize("index", [0, 2])
def test_turning_the_other_states_changes_nothing(rule: MomentRule, index: int) -> None:
    rng = np.random.default_rng(5)
    map_, P, mean = random_map(rng, 3, 4), random_covariance(rng, 4), rng.normal(size=4)
    others = np.delete(np.arange(4), index)
    T = np.eye(4)
    T[np.ix_(others, others)] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    plain = rule(map_, mean, P, index)
    turned = rule(Transformed(map_, T, 0.0, index), T @ mean, T @ P @ T.T, index)
    wanted = Moments(plain.mean, plain.covariance, T @ plain.cross)
    assert_close(turned, wanted, P, tolerance(rule))


@every_rule
def test_the_order_of_the_states_changes_nothing(rule: MomentRule) -> None:
    rng = np.random.default_rng(6)
    map_, P, mean = random_map(rng, 3, 4), random_covariance(rng, 4), rng.normal(size=4)
    order = [2, 0, 3, 1]
    plain = rule(map_, mean, P, 0)
    moved = rule(Trigonometric(map_.F[:, :, order], map_.g), mean[order], P[order][:, order], 1)
    wanted = Moments(plain.mean, plain.covariance, plain.cross[order])
    assert_close(moved, wanted, P, tolerance(rule))


@every_rule
@pytest.mark.parametrize("shift", [-2.0, 0.3, 5.0])
def test_the_zero_of_the_angle_does_not_matter(rule: MomentRule, shift: float) -> None:
    rng = np.random.default_rng(7)
    map_, P, mean = random_map(rng, 3, 4), random_covariance(rng, 4), rng.normal(size=4)
    moved = mean + shift * np.eye(4)[2]
    got = rule(Transformed(map_, np.eye(4), shift, 2), moved, P, 2)
    assert_close(got, rule(map_, mean, P, 2), P, tolerance(rule))


@every_rule
def test_a_known_angle(rule: MomentRule) -> None:
    """Then the map is linear, with its F at that angle."""
    rng = np.random.default_rng(8)
    map_, mean = random_map(rng, 3, 4), rng.normal(size=4)
    P = random_covariance(rng, 4).copy()
    P[1] = P[:, 1] = 0.0
    (F,), (g,) = map_.at(mean[1:2])
    wanted = Moments(F @ mean + g, F @ P @ F.T, P @ F.T)
    assert_close(rule(map_, mean, P, 1), wanted, P, ROUNDING)


@every_rule
def test_a_small_angle_is_linear(rule: MomentRule) -> None:
    """With sigma_U = 1e-5 rad all rules say the same, to sigma_U^2."""
    rng = np.random.default_rng(9)
    map_, mean = random_map(rng, 3, 4), rng.normal(size=4)
    scale = np.array([1.0, 1.0, 1e-5, 1.0])
    P = random_covariance(rng, 4) * np.outer(scale, scale)
    (F,), (g,) = map_.at(mean[2:3])
    dF, dg = map_.by_angle(mean[2])
    J = F.copy()
    J[:, 2] += dF @ mean + dg
    wanted = Moments(F @ mean + g, J @ P @ J.T, P @ J.T)
    assert_close(rule(map_, mean, P, 2), wanted, P, 1e-4)
    flat = Moments(F @ mean + g, F @ P @ F.T, P @ F.T)
    with pytest.raises(AssertionError):
        assert_close(rule(map_, mean, P, 2), flat, np.eye(4) * scale**2, 1e-7)


@every_rule
def test_one_state(rule: MomentRule) -> None:
    """The angle alone: y = 2 + 3 sin U, of a small U."""
    map_ = Trigonometric(np.zeros((3, 1, 1)), np.array([[2.0], [3.0], [0.0]]))
    mean, covariance, cross = rule(map_, np.zeros(1), np.array([[1e-6]]), 0)
    assert mean == pytest.approx(2.0, abs=ROUNDING)
    assert covariance[0, 0] == pytest.approx(9e-6, rel=1e-5)
    assert cross[0, 0] == pytest.approx(3e-6, rel=1e-5)


@every_rule
@pytest.mark.parametrize("variance", [-1e-9, math.nan])
def test_no_variance(rule: MomentRule, variance: float) -> None:
    P = np.diag([1.0, variance, 1.0])
    with pytest.raises(np.linalg.LinAlgError, match="variance is negative or not a number"):
        rule(Constant(np.eye(3), np.zeros(3)), np.zeros(3), P, 0)


# --- Gauss-Hermite over the angle alone is the same as over all states


@pytest.mark.parametrize("order", [2, 3, 5])
@pytest.mark.parametrize(("n", "rank"), [(2, 2), (3, 3), (4, 4), (4, 2), (3, 1)])
@given(seed=seeds)
def test_reduced_is_full(n: int, rank: int, order: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    map_, P, mean = random_map(rng, 5, n), random_covariance(rng, n, rank), rng.normal(size=n)
    index = int(rng.integers(n))
    full = FullGaussHermite(order)(map_, mean, P, index)
    assert_close(ReducedGaussHermite(order)(map_, mean, P, index), full, P, 100 * ROUNDING)


@pytest.mark.parametrize("n", [2, 3, 4])
def test_reduced_is_full_in_a_filter(n: int) -> None:
    """Ten epochs, each with coefficients of its own; the sines matter."""
    rng = np.random.default_rng(11)
    epochs, index = 10, n - 1
    process = [
        Trigonometric(0.4 * m.F, m.g) for m in (random_map(rng, n, n) for _ in range(epochs))
    ]
    measurement = [random_map(rng, 2, n) for _ in range(epochs)]
    z, mean, P = rng.normal(size=(epochs, 2)), rng.normal(size=n), random_covariance(rng, n)
    reduced, full, linearised = (
        run_filter(rule, [*process], [*measurement], mean, P, index, z)
        for rule in (ReducedGaussHermite(4), FullGaussHermite(4), Linearised())
    )
    for (a_mean, a_P), (b_mean, b_P) in zip(reduced, full, strict=True):
        np.testing.assert_allclose(a_mean, b_mean, rtol=0.0, atol=100 * ROUNDING)
        np.testing.assert_allclose(a_P, b_P, rtol=0.0, atol=100 * ROUNDING)
    assert np.abs(reduced[-1][0] - linearised[-1][0]).max() > 0.01


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
