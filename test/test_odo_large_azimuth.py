"""Laws of the filters with a large azimuth error: of all five, which differ by the moment rule.

Drives and errors are those of test_odo_wander.py.
"""

from __future__ import annotations

import copy
import math
from functools import cache

import numpy as np
import pytest
from large_azimuth_filters import (
    at_start,
    every_method,
    follow,
    handed_over,
    run_and_know,
    turn,
    with_rule,
)
from scipy.spatial.transform import Rotation
from test_odo_wander import (
    ALPHA,
    ARCSEC,
    DEGREE,
    EXACT,
    PERFECT,
    STATES,
    Faults,
    config,
    epoch_at,
    exact_epoch,
    left_over,
    run_filter,
    second_of_most,
    tolerance_for,
    true_navigation,
    with_error,
)

from sins_align.odo.fading import Fading, Innovation, NoFading, PublishedFading, ScaleJumpFading
from sins_align.odo.filter import AidedFilter
from sins_align.odo.knowledge import knowledge_of
from sins_align.odo.large_azimuth import LargeAzimuthFilter
from sins_align.odo.layout import (
    ACCEL_BIAS,
    ENU_SIZE,
    GYRO_BIAS,
    GYRO_TURN,
    ODOMETER,
    PHI,
    SHARED,
    VELOCITY,
    U,
)
from sins_align.odo.layout import (
    ALPHA as ALPHA_STATE,
)
from sins_align.odo.moments import (
    ConditionallyLinear,
    Cubature,
    Linearised,
    MomentRule,
    Moments,
    ReducedGaussHermite,
    Unscented,
)
from sins_align.odo.odometer_model import OdometerModel
from sins_align.odo.standing import Standing
from sins_align.odo.wander import WanderFilter
from sins_align.types import Array

RULES: dict[str, MomentRule] = {
    "gauss_hermite": ReducedGaussHermite(3),
    "seven nodes": ReducedGaussHermite(7),
    "cubature": Cubature(),
    "linearised": Linearised(),
    "unscented": Unscented(),
}


# -- an error is found


# One of U is one of phi's vertical part; the azimuth of the axis is known for good.
@every_method
@pytest.mark.parametrize("name", [n for n in STATES if not n.startswith(("axis", "azimuth"))])
def test_one_epoch_tells_an_error(name: str, method: str) -> None:
    """The only thing wrong is found, sign and size: difference of two signs of the error."""
    index, x = STATES[name]
    ends = []
    for sign in (1.0, -1.0):
        wander, epoch, _ = with_error(name, sign * x)
        filter_ = follow(wander, method)
        # So large that the noise takes nothing off the gain, and U's square does not matter.
        factors = {"phi 2": 20.0, "gyro turn": 30.0, "gyro bias": 100.0}
        kind = name if index == U else name[:9]
        sigma = factors.get(kind, 1e3) * x
        filter_.P = np.zeros((ENU_SIZE, ENU_SIZE))
        filter_.P[index, index] = sigma**2
        filter_.process(epoch, Standing.NO)
        ends.append(left_over(name, filter_))
    found = 0.5 * (ends[0] - ends[1])
    is_sensor = GYRO_BIAS.start <= index < GYRO_TURN.stop
    expected = x if is_sensor else -x if name in ("scale", "latency") else 0.0
    assert found == pytest.approx(expected, abs=tolerance_for(name) * x)


@pytest.mark.parametrize("name", [n for n in STATES if n.startswith("azimuth")])
@every_method
def test_the_wander_angle_s_error_is_one_of_the_azimuth(name: str, method: str) -> None:
    """A wander filter that has alpha wrong, and knows it, hands it over as U."""
    _, x = STATES[name]
    ends = []
    for sign in (1.0, -1.0):
        wander, epoch, _ = with_error(name, sign * x)
        wander.P[ALPHA_STATE, ALPHA_STATE] = x**2
        filter_ = follow(wander, method)
        speed = np.linalg.norm(filter_.navigation.v_a)
        # The velocity is wrong by as much as its direction.
        assert filter_.P[U, U] == pytest.approx(x**2)
        assert filter_.P[VELOCITY, VELOCITY].trace() == pytest.approx((x * speed) ** 2, rel=0.01)
        filter_.process(epoch, Standing.NO)
        truth = true_navigation(second_of_most(True) + 1.0, 0.0).C_ab
        off = knowledge_of(filter_).C_nb @ truth.T
        ends.append(-Rotation.from_matrix(off).as_rotvec()[2])
    # What velocity and attitude have in common is not seen in an epoch: nothing is found, and
    # nothing but that is lost.
    assert 0.5 * (ends[0] - ends[1]) == pytest.approx(-x, rel=0.02)


LARGE = 0.5  # [rad]


@cache
def steady_second() -> float:
    """Where the vehicle drives straight on, as fast as before."""
    velocity = np.array([true_navigation(float(k), 0.0).v_a for k in range(179)])
    change = np.linalg.norm(np.diff(velocity, axis=0), axis=1)
    change[np.linalg.norm(velocity[:-1], axis=1) < 5.0] = np.inf
    return float(np.argmin(change))


@pytest.mark.parametrize(("order", "tolerance"), [(3, 0.03), (7, 1e-3)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_one_epoch_tells_a_large_azimuth_error(sign: float, order: int, tolerance: float) -> None:
    """U ~ N(0, s^2), s = 0.5, is seen as sin U and 1 - cos U: the best linear estimate of it.

    E U sin U / E sin^2 U = s^2 exp(-s^2/2) / ((1 - exp(-2 s^2)) / 2); 1 - cos U tells nothing.
    The velocity is known and steady: of its change, turned by U, only a Gaussian gets to the
    measurement. Cubature puts its points sqrt(35) s from the mean: beyond half a turn.
    """
    second = steady_second()
    navigation = true_navigation(second, ALPHA)
    navigation.C_ab = turn(sign * LARGE) @ navigation.C_ab
    wander = WanderFilter(navigation, OdometerModel(config(**EXACT)), PERFECT, 1.0, 1.0, 1.0)
    filter_ = LargeAzimuthFilter(wander, PERFECT, ReducedGaussHermite(order), NoFading())
    filter_.P = np.zeros((ENU_SIZE, ENU_SIZE))
    filter_.P[U, U] = LARGE**2
    filter_.process(epoch_at(second), Standing.NO)
    square = LARGE**2
    gain = square * math.exp(-0.5 * square) / (0.5 * (1.0 - math.exp(-2.0 * square)))
    expected = LARGE - gain * math.sin(LARGE)
    truth = true_navigation(second + 1.0, ALPHA)
    found = -Rotation.from_matrix(filter_.navigation.C_ab @ truth.C_ab.T).as_rotvec()[2]
    assert sign * found == pytest.approx(expected, abs=tolerance)
    assert abs(found) < 0.1 * LARGE


# -- what is linear


class Kalman:
    """The Kalman filter of the map at U = 0, its derivative by differences of second order."""

    def __call__(self, map_: ConditionallyLinear, mean: Array, P: Array, index: int) -> Moments:
        h = 1e-5
        F, g = map_.at(np.array([mean[index], mean[index] + h, mean[index] - h]))
        A = F[0].copy()
        A[:, index] += ((F[1] - F[2]) @ mean + g[1] - g[2]) / (2.0 * h)
        return Moments(F[0] @ mean + g[0], A @ P @ A.T, P @ A.T)


# Three digits go where an epoch takes a variance down to a thousandth.
LINEAR_TOLERANCE = 1e-8


def without_azimuth(filter_: LargeAzimuthFilter) -> None:
    """U known, now."""
    P = filter_.P.copy()
    P[U, :] = P[:, U] = 0.0
    filter_.P = P


def assert_same(one: AidedFilter, other: AidedFilter, tolerance: float) -> None:
    """State and covariance, relative to sigma; attitude, velocity and odometer."""
    sigma = np.sqrt(one.P.diagonal())
    np.testing.assert_allclose(
        other.P / np.outer(sigma, sigma), one.P / np.outer(sigma, sigma), rtol=0.0, atol=tolerance
    )
    off = Rotation.from_matrix(other.navigation.C_ab @ one.navigation.C_ab.T).as_rotvec()
    assert (np.abs(off) < tolerance * np.maximum(sigma[PHI], 1e-7)).all()
    pairs = [
        (one.navigation.v_a, other.navigation.v_a, VELOCITY),
        (one.sensors.gyro_bias, other.sensors.gyro_bias, GYRO_BIAS),
        (one.sensors.accel_bias, other.sensors.accel_bias, ACCEL_BIAS),
        (one.sensors.gyro_turn, other.sensors.gyro_turn, GYRO_TURN),
        (one.odometer.x, other.odometer.x, ODOMETER),
    ]
    for a, b, index in pairs:
        # They add up over the epochs; second powers of U, then known to 1e-6, with them.
        assert (np.abs(a - b) < 5.0 * tolerance * sigma[index]).all(), index


@pytest.mark.parametrize("rule", RULES)
def test_with_a_known_azimuth_it_is_a_kalman_filter(rule: str) -> None:
    """P and estimates, in epochs that start with U known."""
    wander, second = at_start()
    filters = [with_rule(wander, r) for r in (Kalman(), RULES[rule])]
    before = filters[0].P[VELOCITY, VELOCITY].trace()
    for k in range(5):
        for filter_ in filters:
            without_azimuth(filter_)
            filter_.process(exact_epoch(second + k), Standing.NO)
        assert_same(*filters, LINEAR_TOLERANCE)
    # And it did learn something.
    assert filters[0].P[VELOCITY, VELOCITY].trace() < 0.5 * before


def test_with_a_known_azimuth_it_is_the_wander_filter() -> None:
    """Of one azimuth state that is known: the same errors, the place in its own state."""
    wander, second = handed_over()
    P = wander.P.copy()
    for index in (U, ALPHA_STATE):
        P[index, :] = P[:, index] = 0.0
    wander.P = P
    large = with_rule(wander, ReducedGaussHermite())
    for k in range(5):
        for filter_ in (wander, large):
            filter_.process(exact_epoch(second + k), Standing.NO)
        sigma = np.sqrt(wander.P.diagonal()[:SHARED])
        sigma[U] = max(sigma[U], 1e-9)
        scale = np.outer(sigma, sigma)
        np.testing.assert_allclose(
            large.P[:SHARED, :SHARED] / scale, wander.P[:SHARED, :SHARED] / scale, atol=1e-3
        )
        off = knowledge_of(large).C_nb @ knowledge_of(wander).C_nb.T
        assert Rotation.from_matrix(off).magnitude() < 1e-4 * ARCSEC + 1e-3 * sigma[0]


class Counted:
    """A fading, with how often it fired."""

    def __init__(self, fading: Fading) -> None:
        self.fading = fading
        self.fired = 0

    def inflate(self, P: Array, Q: Array, innovation: Innovation, distance: float) -> Array | None:
        inflated = self.fading.inflate(P, Q, innovation, distance)
        self.fired += inflated is not None
        return inflated


@pytest.mark.parametrize("fading", [PublishedFading, ScaleJumpFading])
def test_fading_that_never_fires_is_none(fading: type[Fading]) -> None:
    """Bit for bit, on data within what is declared; and the same fading does fire on others."""
    wander, second = at_start()
    # The data are exact, and the noise declared is not.
    for quiet, scale in ((True, 0.0), (False, 0.05)):
        start = copy.deepcopy(wander)
        loud = {"odometer_noise_m": [1.0] * 3} if quiet else {}
        start.odometer.config = config(**loud)
        counted = Counted(fading())
        one = with_rule(start, ReducedGaussHermite(), counted)
        other = with_rule(start, ReducedGaussHermite())
        for k in range(20):
            epoch = epoch_at(second + k, Faults(scale=scale))
            for filter_ in (one, other):
                filter_.process(epoch, Standing.NO)
        same = np.array_equal(one.P, other.P) and np.array_equal(
            one.navigation.C_ab, other.navigation.C_ab
        )
        assert (counted.fired == 0) is quiet
        assert same is quiet
        if quiet:
            np.testing.assert_array_equal(one.odometer.x, other.odometer.x)
            np.testing.assert_array_equal(one.navigation.v_a, other.navigation.v_a)


# -- covariance


def faulty(second: int) -> tuple[Faults, bool]:
    """What is wrong in this second: a slip, a bias; and whether the odometer is silent."""
    scale = 0.5 if second % 17 == 3 else 0.0
    accel = np.array([0.05, 0.0, 0.0]) if second % 23 == 5 else np.zeros(3)
    return Faults(accel=accel, scale=scale), second % 11 == 7


@every_method
def test_covariance_stays_one(method: str) -> None:
    """Symmetric and positive, as a correlation, to the end of the drive."""
    wander, second = at_start()
    filter_ = follow(wander, method)
    for k in range(second, 178):
        faults, silent = faulty(k)
        epoch = epoch_at(k, faults)
        if silent:
            epoch = epoch._replace(travel=None)
        filter_.process(epoch, Standing.NO)
        sigma = np.sqrt(filter_.P.diagonal())
        correlation = filter_.P / np.outer(sigma, sigma)
        # Exactly, but for the turn at the end: two products.
        np.testing.assert_allclose(correlation, correlation.T, rtol=0.0, atol=1e-12)
        assert np.linalg.eigvalsh(correlation).min() > -1e-9
        assert np.linalg.eigvalsh(knowledge_of(filter_).covariance).min() > 0.0


def attitude_error(filter_: AidedFilter, second: float) -> Array:
    truth = true_navigation(second, 0.0).C_ab
    return -Rotation.from_matrix(knowledge_of(filter_).C_nb @ truth.T).as_rotvec()


@every_method
def test_perfect_sensors_find_the_azimuth(method: str) -> None:
    wander, second = at_start()
    filter_ = follow(wander, method)
    run_filter(filter_, second, 170)
    sigma = math.sqrt(knowledge_of(filter_).covariance[2, 2])
    east, north, up = attitude_error(filter_, 170.0)
    assert sigma < 0.2 * DEGREE
    assert abs(up) < min(0.05 * DEGREE, sigma)
    assert max(abs(east), abs(north)) < 5.0 * ARCSEC


NODES_TOLERANCE = 0.02  # of sigma


def test_three_nodes_are_as_good_as_seven() -> None:
    wander, second = at_start()
    filters = [with_rule(wander, ReducedGaussHermite(order)) for order in (3, 7)]
    for begin in range(second, 160, 10):
        a, b = (run_and_know(filter_, begin, begin + 10) for filter_ in filters)
        sigma = np.sqrt(a.covariance.diagonal())
        off = Rotation.from_matrix(a.C_nb @ b.C_nb.T).as_rotvec()
        assert (np.abs(off) < NODES_TOLERANCE * sigma).all()
        np.testing.assert_allclose(np.sqrt(b.covariance.diagonal()), sigma, rtol=NODES_TOLERANCE)
