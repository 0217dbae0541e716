"""Laws of the filters with a large azimuth error: of all five, which differ by the moment rule.

Drives and errors are those of test_odo_wander.py.
"""

from __future__ import annotations

import copy
import math
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_odo_wander import (
    ALPHA,
    ARCSEC,
    DEGREE,
    EXACT,
    FOG,
    LEVER_ARM,
    MOUNTING_DEG,
    PERFECT,
    STATES,
    Faults,
    about_up,
    config,
    epoch_at,
    exact_epoch,
    left_over,
    make_filter,
    run_filter,
    second_of_most,
    small_turn,
    tolerance_for,
    true_navigation,
    with_error,
)

from sins_align.config import odo_config
from sins_align.odo.fading import Fading, Innovation, NoFading, PublishedFading, ScaleJumpFading
from sins_align.odo.filter import AidedFilter
from sins_align.odo.knowledge import Knowledge, knowledge_of
from sins_align.odo.large_azimuth import PLACE_SIGMA, LargeAzimuthFilter, start_sigma
from sins_align.odo.layout import (
    ACCEL_BIAS,
    AZIMUTH,
    ENU_SIZE,
    GYRO_BIAS,
    GYRO_TURN,
    ODOMETER,
    PHI,
    PLACE,
    SHARED,
    SIZE,
    VELOCITY,
    U,
)
from sins_align.odo.layout import (
    ALPHA as ALPHA_STATE,
)
from sins_align.odo.methods import make_large_azimuth_filter
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

# As they are configured; `sghf` with each fading that is to be right.
METHODS: dict[str, dict[str, object]] = {
    "sghf": {"method": "sghf"},
    "sghf without fading": {"method": "sghf", "fading": "none"},
    "ghf": {"method": "ghf"},
    "ckf": {"method": "ckf"},
    "ekf": {"method": "ekf"},
    "ukf": {"method": "ukf"},
}
RULES: dict[str, MomentRule] = {
    "gauss_hermite": ReducedGaussHermite(3),
    "seven nodes": ReducedGaussHermite(7),
    "cubature": Cubature(),
    "linearised": Linearised(),
    "unscented": Unscented(),
}
every_method = pytest.mark.parametrize("method", METHODS)


def turn(angle: float) -> Array:
    """Rz(U) = [c s 0; -s c 0; 0 0 1]."""
    return about_up(-angle)


def follow(wander: WanderFilter, method: str) -> LargeAzimuthFilter:
    parameters = {
        "imu_grade": "fog",
        "odometer_lever_arm_m": list(LEVER_ARM),
        "mounting_rpy_deg": list(MOUNTING_DEG),
    }
    return make_large_azimuth_filter(odo_config({**parameters, **METHODS[method]}), wander)


def with_rule(
    wander: WanderFilter, rule: MomentRule, fading: Fading | None = None
) -> LargeAzimuthFilter:
    return LargeAzimuthFilter(wander, FOG, rule, fading or NoFading())


@cache
def _found() -> tuple[WanderFilter, int]:
    filter_ = make_filter(ALPHA)
    for second in range(150):
        run_filter(filter_, second, second + 1)
        speed = float(np.linalg.norm(filter_.navigation.v_a))
        if knowledge_of(filter_).covariance[2, 2] < start_sigma(config()) ** 2 and speed > 5.0:
            return filter_, second + 1
    raise AssertionError("no start")


def at_start() -> tuple[WanderFilter, int]:
    """A wander filter of two azimuth states, on the move, from which one may start; the second."""
    filter_, second = _found()
    assert not filter_.one_azimuth
    return copy.deepcopy(filter_), second


@cache
def _handed_over() -> tuple[WanderFilter, int]:
    filter_, second = at_start()
    while not filter_.one_azimuth or np.linalg.norm(filter_.navigation.v_a) < 5.0:
        run_filter(filter_, second, second + 1)
        second += 1
    return filter_, second


def handed_over() -> tuple[WanderFilter, int]:
    """As `at_start`, of one azimuth state."""
    filter_, second = _handed_over()
    return copy.deepcopy(filter_), second


STARTS = {"two azimuth states": at_start, "one azimuth state": handed_over}
every_start = pytest.mark.parametrize("start", STARTS)


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


def run_and_know(filter_: AidedFilter, begin: int, end: int) -> Knowledge:
    for second in range(begin, end):
        filter_.process(exact_epoch(second), Standing.NO)
    return knowledge_of(filter_)


# -- axes


def turned(wander: WanderFilter, angle: float) -> WanderFilter:
    """The same filter, its a turned about up: everything in a turns."""
    other = copy.deepcopy(wander)
    R = about_up(angle)
    navigation = other.navigation
    navigation.C_ab, navigation.v_a = R @ navigation.C_ab, R @ navigation.v_a
    navigation.e_a = R @ navigation.e_a
    J = np.eye(SIZE)
    J[PHI, PHI] = J[VELOCITY, VELOCITY] = R
    if not wander.one_azimuth:
        J[AZIMUTH, AZIMUTH] = R[:2, :2]
    other.P = J @ other.P @ J.T
    return other


GAUGE_TOLERANCE = 1e-7  # of sigma
# The density of two azimuth states is summed up on a grid, which does not turn with them.
START_GAUGE_TOLERANCE = 1e-5


@every_method
@every_start
@pytest.mark.parametrize("angle", [0.5, -2.0, math.pi])
def test_start_azimuth_of_the_frame_does_not_matter(method: str, start: str, angle: float) -> None:
    wander, second = STARTS[start]()
    filters = [follow(w, method) for w in (wander, turned(wander, angle))]
    tolerance = GAUGE_TOLERANCE if wander.one_azimuth else START_GAUGE_TOLERANCE
    end = min(second + 40, 178)
    a, b = (run_and_know(filter_, second, end) for filter_ in filters)
    sigma = np.sqrt(a.covariance.diagonal())
    off = Rotation.from_matrix(a.C_nb @ b.C_nb.T).as_rotvec()
    assert (np.abs(off) < tolerance * sigma).all()
    scale = np.outer(sigma, sigma)
    np.testing.assert_allclose(a.covariance / scale, b.covariance / scale, atol=tolerance)


@pytest.mark.parametrize("angle", [0.8, -2.5])
def test_feedback_of_a_large_azimuth_error(angle: float) -> None:
    """What is left, of errors drawn from P beside an estimate of them, has the P after it."""
    rng = np.random.default_rng(3)
    wander, _ = handed_over()
    filter_ = with_rule(wander, ReducedGaussHermite())
    truth, v_true = filter_.navigation.C_ab.copy(), filter_.navigation.v_a.copy()
    root = rng.normal(size=(6, 6)) * np.array([[1, 3, 2, 100, 100, 100]]).T
    before = 1e-10 * root @ root.T
    dx = np.zeros(ENU_SIZE)
    dx[:6] = 2e-3, -1e-3, angle, 0.3, -0.2, 0.1
    left = []
    for e in rng.multivariate_normal(np.zeros(6), before, size=2000):
        x = dx[:6] + e
        filter_.P = np.zeros((ENU_SIZE, ENU_SIZE))
        filter_.P[:6, :6] = before
        navigation = filter_.navigation
        navigation.C_ab = small_turn([x[0], x[1], 0.0]) @ turn(x[2]) @ truth
        navigation.v_a = v_true + x[VELOCITY]
        filter_._correct(dx)
        phi = -Rotation.from_matrix(navigation.C_ab @ truth.T).as_rotvec()
        left.append([*phi, *(navigation.v_a - v_true)])
    after = filter_.P[:6, :6]
    sigma = np.sqrt(after.diagonal())
    scale = np.outer(sigma, sigma)
    # 2000 of them: 0.032 is the sigma of a variance.
    np.testing.assert_allclose(np.cov(np.transpose(left)) / scale, after / scale, atol=0.15)
    np.testing.assert_allclose(np.mean(left, axis=0) / sigma, 0.0, atol=0.15)
    # It is not what it was.
    assert np.abs(before / scale - after / scale).max() > 0.5
    assert not filter_.P[6:].any()


def test_feedback_of_the_place() -> None:
    """It is the latitude's, and the height's; the wander angle is what it was."""
    wander, _ = handed_over()
    filter_ = with_rule(wander, ReducedGaussHermite())
    navigation = filter_.navigation
    latitude, altitude, alpha = navigation.latitude, navigation.altitude, navigation.wander_angle
    north = np.array([math.sin(alpha), math.cos(alpha), 0.0])
    east = np.array([math.cos(alpha), -math.sin(alpha), 0.0])
    dx = np.zeros(ENU_SIZE)
    dx[PLACE] = 500.0 * north - 300.0 * east + np.array([0.0, 0.0, 20.0])
    filter_._correct(dx)
    assert navigation.latitude - latitude == pytest.approx(-500.0 / 6378137.0, rel=1e-3)
    assert navigation.altitude - altitude == pytest.approx(-20.0)
    assert navigation.wander_angle == pytest.approx(alpha, abs=1e-12)


@pytest.mark.parametrize("seen", [True, False])
def test_mean_of_what_the_azimuth_does_is_fed_back(seen: bool) -> None:
    """The mean of the velocity's change, seen from any azimuth, is exp(-s^2/2) of it.

    Without an odometer, or with one that says as good as nothing.
    """
    second, sigma = second_of_most(False), 0.4
    ends = []
    for known in (True, False):
        wander = WanderFilter(
            true_navigation(second, ALPHA),
            OdometerModel(config(**{**EXACT, "odometer_noise_m": [100.0] * 3})),
            PERFECT, 1.0, 1.0, 1.0,
        )  # fmt: skip
        filter_ = LargeAzimuthFilter(wander, PERFECT, ReducedGaussHermite(7), NoFading())
        filter_.P = np.zeros((ENU_SIZE, ENU_SIZE))
        filter_.P[U, U] = 0.0 if known else sigma**2
        epoch = epoch_at(second)
        filter_.process(epoch if seen else epoch._replace(travel=None), Standing.NO)
        ends.append(filter_.navigation.v_a)
    change = ends[0] - true_navigation(second, ALPHA).v_a
    assert np.linalg.norm(change[:2]) > 1.0
    lost = (1.0 - math.exp(-0.5 * sigma**2)) * change[:2]
    np.testing.assert_allclose(ends[0][:2] - ends[1][:2], lost, atol=0.02 * np.linalg.norm(lost))


# -- the start


def draw(P: Array, count: int) -> Array:
    """(count, n) from N(0, P), whose variances differ by many powers of ten."""
    sigma = np.sqrt(np.maximum(P.diagonal(), 0.0))
    scale = np.divide(1.0, sigma, out=np.zeros_like(sigma), where=sigma > 0.0)
    correlation = P * np.outer(scale, scale)
    rng = np.random.default_rng(11)
    return rng.multivariate_normal(np.zeros(len(P)), correlation, size=count) * sigma


def sample_wander(wander: WanderFilter, count: int) -> tuple[Array, Array]:
    """Errors (count, SIZE) of a wander filter's estimates, and the true azimuth alpha (count,).

    Two azimuth states: alpha by its density on the circle, the rest given what that says of
    their errors.
    """
    rng = np.random.default_rng(12)
    P, e = wander.P, wander.navigation.e_a
    estimate = math.atan2(e[0], e[1])
    if wander.one_azimuth:
        errors = draw(P, count)
        return errors, estimate - errors[:, ALPHA_STATE]
    length = math.sqrt(1.0 - float(e[2]) ** 2)
    grid = estimate + np.linspace(-0.5, 0.5, 20001)
    off = e[:2, None] - length * np.stack((np.sin(grid), np.cos(grid)))
    exponent = -0.5 * np.einsum("in,ij,jn->n", off, np.linalg.inv(P[AZIMUTH, AZIMUTH]), off)
    weight = np.exp(exponent - exponent.max())
    drawn = rng.choice(grid.size, size=count, p=weight / weight.sum())
    gain = np.linalg.solve(P[AZIMUTH, AZIMUTH], P[AZIMUTH, :]).T
    rest = P - gain @ P[AZIMUTH, :]
    errors = off[:, drawn].T @ gain.T
    errors += draw(rest, count)
    return errors, grid[drawn]


def errors_at_start(wander: WanderFilter, large: LargeAzimuthFilter, count: int) -> Array:
    """(count, SHARED) errors of the filter that starts, in ENU, of those of the wander filter."""
    errors, alpha = sample_wander(wander, count)
    own = large.navigation
    to_own = about_up(-own.wander_angle)
    C_estimate, v_estimate = wander.navigation.C_ab, wander.navigation.v_a
    found = np.empty((count, SHARED))
    for row, x, angle in zip(found, errors, alpha, strict=True):
        # The truth: estimates less their errors, in ENU by the true azimuth.
        to_enu = about_up(angle)
        C_nb = to_enu @ small_turn(x[PHI]).T @ C_estimate
        v_n = to_enu @ (v_estimate - x[VELOCITY])
        off = own.C_ab @ (to_own @ C_nb).T
        row[PHI] = off[1, 2], -off[0, 2], math.atan2(off[0, 1] - off[1, 0], off[0, 0] + off[1, 1])
        row[VELOCITY] = own.v_a - to_own @ v_n
        for index, before, after in (
            (GYRO_BIAS, wander.sensors.gyro_bias, large.sensors.gyro_bias),
            (ACCEL_BIAS, wander.sensors.accel_bias, large.sensors.accel_bias),
            (GYRO_TURN, wander.sensors.gyro_turn, large.sensors.gyro_turn),
        ):
            # These are what is left in the samples: true minus estimated.
            row[index] = before + x[index] - after
        row[ODOMETER] = large.odometer.x - (wander.odometer.x - x[ODOMETER])
    return found


@every_start
def test_covariance_of_the_start(start: str) -> None:
    """Monte Carlo: the velocity's correlation with U, and all the rest."""
    wander, _ = STARTS[start]()
    large = with_rule(wander, ReducedGaussHermite())
    errors = errors_at_start(wander, large, 4000)
    P = large.P[:SHARED, :SHARED]
    sigma = np.sqrt(P.diagonal())
    scale = np.outer(sigma, sigma)
    # 4000 of them: 0.022 is the sigma of a variance.
    np.testing.assert_allclose(np.cov(errors.T) / scale, P / scale, rtol=0.0, atol=0.11)
    np.testing.assert_allclose(errors.mean(axis=0) / sigma, 0.0, atol=0.11)
    # Moving, U is known with the velocity across.
    correlation = P / scale
    assert np.abs(correlation[U, VELOCITY]).max() > 0.8
    np.testing.assert_array_equal(large.P[PLACE, PLACE], PLACE_SIGMA**2 * np.eye(3))
    assert not large.P[:SHARED, PLACE].any()


START_TOLERANCE = 1e-9


@every_start
def test_start_does_not_change_what_is_given_out(start: str) -> None:
    wander, _ = STARTS[start]()
    before, after = knowledge_of(wander), knowledge_of(with_rule(wander, ReducedGaussHermite()))
    assert Rotation.from_matrix(before.C_nb @ after.C_nb.T).magnitude() < START_TOLERANCE
    pairs = [(before, after), (before.odometer, after.odometer)]
    for one, other in pairs:
        names = one._fields if isinstance(one, Knowledge) else vars(one)
        for name in names:
            if name != "odometer":
                a, b = np.asarray(getattr(one, name)), np.asarray(getattr(other, name))
                size = max(float(np.abs(a).max()), 1e-12)
                np.testing.assert_allclose(b, a, rtol=0.0, atol=START_TOLERANCE * size)


def state_of(filter_: AidedFilter) -> list[bytes]:
    """Every bit that a filter may change."""
    navigation, sensors = filter_.navigation, filter_.sensors
    arrays = [
        filter_.P, navigation.C_ab, navigation.v_a, navigation.e_a, filter_.odometer.x,
        filter_.odometer._growth, sensors.gyro_bias, sensors.accel_bias, sensors.gyro_turn,
        np.array([navigation.altitude, filter_.consistency, filter_.nis, filter_.epochs]),
    ]  # fmt: skip
    return [np.asarray(array).tobytes() for array in arrays]


@every_start
def test_neither_filter_changes_the_other(start: str) -> None:
    wander, second = STARTS[start]()
    alone, before = copy.deepcopy(wander), state_of(wander)
    large = with_rule(wander, ReducedGaussHermite(), ScaleJumpFading())
    assert state_of(wander) == before
    undisturbed = copy.deepcopy(large)
    end = min(second + 10, 178)
    for filter_ in (alone, undisturbed):
        run_filter(filter_, second, end)
    # Epoch by epoch, one and the other.
    for k in range(second, end):
        for filter_ in (large, wander):
            run_filter(filter_, k, k + 1)
    assert state_of(wander) == state_of(alone) != before
    assert state_of(large) == state_of(undisturbed)
