"""The moment rules: laws that all of them obey."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from moment_maps import (
    DIFFERENCED,
    ROUNDING,
    Constant,
    Trigonometric,
    assert_close,
    every_rule,
    frozen,
    random_covariance,
    random_map,
    tolerance,
)

from sins_align.odo.moments import (
    ConditionallyLinear,
    FullGaussHermite,
    Linearised,
    MomentRule,
    Moments,
    ReducedGaussHermite,
)
from sins_align.types import Array


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
