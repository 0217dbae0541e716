"""Strong tracking: the published factor, and where it fails; the guarded one."""

from __future__ import annotations

import math
from functools import cache
from unittest.mock import patch

import numpy as np
import pytest
from odo_sessions import Curve, align, curve_of, vehicle

from sins_align.odo import large_azimuth
from sins_align.odo.fading import Innovation, PublishedFading, ScaleJumpFading
from sins_align.odo.layout import ENU_SIZE, ODOMETER
from sins_align.odo.odometer_model import SCALE
from sins_align.types import Array, State, Update

ARCMIN = math.radians(1.0 / 60.0)
N = ENU_SIZE + 3
SCALE_STATE = ODOMETER.start + SCALE

# -- the published factor


def covariance(rng: np.random.Generator, size: int, sigma: float) -> Array:
    root = rng.normal(size=(size, size))
    return sigma**2 / size * root @ root.T


def innovation_of(P: Array, H: Array, R: Array, value: Array) -> Innovation:
    S = H @ P @ H.T
    return Innovation(value, S, R, np.linalg.inv(S + R), H)


def printed_factor(V: Array, P: Array, Q: Array, H: Array, R: Array) -> float:
    """lambda = max(1, tr(V - H Q H' - beta R) / tr(H Phi P Phi' H')), beta = 1."""
    N_k = V - H @ Q @ H.T - R
    M_k = H @ (P - Q) @ H.T
    return max(1.0, float(np.trace(N_k) / np.trace(M_k)))


def test_published_fading_is_that_of_the_strong_tracking_filter() -> None:
    """P = lambda (P - Q) + Q, V_k = (rho V_k-1 + nu nu') / (1 + rho) with rho = 0.95."""
    rng = np.random.default_rng(5)
    fading, V = PublishedFading(), np.zeros((0, 0))
    fired = 0
    # Innovations of all sizes: the memory of the large ones goes on for some epochs.
    for k, size in enumerate([0.1, 0.5, 5.0, 1.0, 0.5, 0.1, 0.1, 0.1, 0.1, 20.0, 1.0, 1.0, 0.1]):
        Q = covariance(rng, N, 0.1)
        P = covariance(rng, N, 1.0) + Q
        H, R = rng.normal(size=(3, N)) / math.sqrt(N), covariance(rng, 3, 0.3)
        value = size * rng.normal(size=3)
        square = np.outer(value, value)
        V = square if k == 0 else (0.95 * V + square) / 1.95
        factor = printed_factor(V, P, Q, H, R)
        inflated = fading.inflate(P.copy(), Q, innovation_of(P, H, R, value), 10.0)
        if factor == 1.0:
            assert inflated is None
        else:
            fired += 1
            assert inflated is not None
            np.testing.assert_allclose(inflated, factor * (P - Q) + Q, rtol=1e-9, atol=1e-12)
            assert np.linalg.eigvalsh(inflated - P).min() > -1e-9
    assert 3 <= fired <= 10


def test_published_fading_grows_what_no_innovation_sees() -> None:
    """One factor for all: its variance grows with every large innovation, and never shrinks."""
    fading, Q, R = PublishedFading(), np.zeros((N, N)), 1e-2 * np.eye(3)
    H = np.zeros((3, N))
    H[:, :3] = np.eye(3)
    P = np.eye(N)
    for _ in range(5):
        value = np.full(3, 3.0)
        inflated = fading.inflate(P, Q, innovation_of(P, H, R, value), 10.0)
        P = P if inflated is None else inflated
        gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        P = P - gain @ H @ P
    assert P[:3, :3].max() < 0.1
    assert P[-1, -1] > 1e4


# -- the guarded one


def test_guarded_fading_puts_the_inflation_where_the_mismatch_is() -> None:
    """Five epochs that all tell of the same jump: K's variance, and nothing else, grows."""
    rng = np.random.default_rng(6)
    fading, jump = ScaleJumpFading(), 0.02
    P, Q, R = covariance(rng, N, 1e-3), np.zeros((N, N)), 1e-4 * np.eye(3)
    for k in range(5):
        H = rng.normal(size=(3, N)) * 1e-3
        H[:, SCALE_STATE] = 10.0, 3.0, 0.1
        value = H[:, SCALE_STATE] * jump
        inflated = fading.inflate(P, Q, innovation_of(P, H, R, value), 10.0)
        assert (inflated is None) is (k < 4)
    assert inflated is not None
    expected = P.copy()
    expected[SCALE_STATE, :] = expected[:, SCALE_STATE] = 0.0
    assert inflated[SCALE_STATE, SCALE_STATE] == pytest.approx(jump**2, rel=1e-6)
    expected[SCALE_STATE, SCALE_STATE] = inflated[SCALE_STATE, SCALE_STATE]
    np.testing.assert_array_equal(inflated, expected)


def test_guarded_fading_leaves_an_outlier_alone() -> None:
    rng = np.random.default_rng(7)
    fading = ScaleJumpFading()
    P, Q, R = covariance(rng, N, 1e-3), np.zeros((N, N)), 1e-4 * np.eye(3)
    for k in range(12):
        H = rng.normal(size=(3, N)) * 1e-3
        H[:, SCALE_STATE] = 10.0, 3.0, 0.1
        value = H[:, SCALE_STATE] * (0.3 if k == 6 else 1e-4) + 1e-3 * rng.normal(size=3)
        assert fading.inflate(P, Q, innovation_of(P, H, R, value), 10.0) is None


# -- drives: the same samples, one fading and the other

SEEDS = (1, 2, 3, 4)
STEP_S, STEP = 100.0, 0.02
END_S = 200.0
FAULTS = {"slips": {"slip_count": 4}, "scale step": {"scale_step": (STEP_S, STEP)}}
# What a filter that holds together knows at the end; one that does not is far from it.
GOOD, GOOD_SIGMA = 15.0 * ARCMIN, 8.0 * ARCMIN
BAD, BAD_SIGMA = 100.0 * ARCMIN, 60.0 * ARCMIN
MOST_SIGMA = 4.0


@cache
def driven(name: str, seed: int, fading: str) -> tuple[Curve, list[Update]]:
    """The filter by itself: it is not given up for wander_kf when it is lost."""
    with patch.object(large_azimuth, "LOST_RATIO", math.inf):
        return guarded_drive(name, seed, fading)


def guarded_drive(name: str, seed: int, fading: str) -> tuple[Curve, list[Update]]:
    run = vehicle("ring", END_S, seed=seed, **FAULTS[name])
    _, updates = align(run, method="sghf", fading=fading)
    return curve_of(run, updates), updates


every_seed = pytest.mark.parametrize("seed", SEEDS)


@every_seed
@pytest.mark.parametrize("name", FAULTS)
def test_guarded_fading_holds(name: str, seed: int) -> None:
    """Within 4 sigma all the time, and as good as without a fault at the end."""
    curve, updates = driven(name, seed, "guarded")
    assert any(u.status.state is State.ALIGNED for u in updates)
    assert curve.ratio.max() < MOST_SIGMA
    assert curve.time_s[-1] > END_S - 3.0
    assert abs(curve.phi[-1, 2]) < GOOD
    assert curve.sigma[-1, 2] < GOOD_SIGMA


@every_seed
def test_published_fading_loses_the_heading_by_slips(seed: int) -> None:
    """The same drives: four slips of two seconds, and what was known to 10' is not known."""
    curve, updates = driven("slips", seed, "published")
    # It had been as good as the other one.
    first = int(np.argmax(curve.sigma[:, 2] < 0.5 * BAD_SIGMA))
    assert first > 0 and curve.ratio[: first + 1].max() < MOST_SIGMA
    last = updates[-1]
    assert last.estimate is None or last.estimate.sigma[2] > BAD_SIGMA
    assert last.status.state is not State.ALIGNED


@every_seed
def test_published_fading_loses_the_heading_by_a_scale_step(seed: int) -> None:
    """The heading is inflated with the scale, and the mismatch goes into it."""
    before, _ = driven("scale step", seed, "guarded")
    curve, updates = driven("scale step", seed, "published")
    row = curve.at(STEP_S - 2.0)
    assert abs(curve.phi[row, 2] - before.phi[before.at(STEP_S - 2.0), 2]) < ARCMIN
    after = curve.time_s > STEP_S + 10.0
    assert np.abs(curve.phi[after, 2]).max() > BAD
    assert curve.sigma[after, 2].max() > BAD_SIGMA
    assert all(u.status.state is not State.ALIGNED for u in updates)


def test_published_fading_makes_sigma_lie() -> None:
    """Far beyond its sigma: what is given out is wrong and says that it is right."""
    ratios = [driven("scale step", seed, "published")[0].ratio.max() for seed in SEEDS]
    assert max(ratios) > 6.0
    assert sum(ratio > MOST_SIGMA for ratio in ratios) >= 2


def test_witness_says_that_the_published_fading_went_wrong() -> None:
    reasons = [driven("scale step", seed, "published")[1][-1].status.reason for seed in SEEDS]
    assert sum("wander_kf beside it differs" in reason for reason in reasons) >= 2


@pytest.mark.parametrize("name", FAULTS)
def test_a_lost_filter_is_given_up(name: str) -> None:
    """The product goes back to wander_kf, whose errors its sigma knows of."""
    given_up = 0
    for seed in SEEDS:
        curve, updates = guarded_drive(name, seed, "published")
        witnessed = [u.estimate.witness is not None for u in updates if u.estimate is not None]
        given_up += False in witnessed[witnessed.index(True) :]
        assert curve.ratio.max() < MOST_SIGMA
        assert abs(curve.phi[-1, 2]) < GOOD
    assert given_up >= len(SEEDS) - 1  # one takes over only after the slips


def scale_off(name: str, seed: int, fading: str, time_s: float) -> float:
    """Estimated scale error less the true one, after the step."""
    run = vehicle("ring", END_S, seed=seed, **FAULTS[name])
    curve, _ = driven(name, seed, fading)
    true = (1.0 + run.truth.odometer_scale_error) * (1.0 + STEP) - 1.0
    return float(curve.scale[curve.at(time_s)] - true)


@every_seed
def test_scale_step_is_found_where_it_is(seed: int) -> None:
    """Guarded: within 15 s, to a tenth of it; without fading 40 s find nothing of it."""
    assert abs(scale_off("scale step", seed, "guarded", STEP_S + 15.0)) < 0.1 * STEP
    assert abs(scale_off("scale step", seed, "none", STEP_S + 40.0)) > 0.8 * STEP
