"""How a filter with a large azimuth error starts from a wander filter."""

from __future__ import annotations

import copy
import math

import numpy as np
from large_azimuth_filters import STARTS, every_start, with_rule
from scipy.spatial.transform import Rotation
from test_odo_wander import about_up, run_filter, small_turn

from sins_align.odo.fading import ScaleJumpFading
from sins_align.odo.filter import AidedFilter
from sins_align.odo.knowledge import Knowledge, knowledge_of
from sins_align.odo.large_azimuth import PLACE_SIGMA, LargeAzimuthFilter
from sins_align.odo.layout import (
    ACCEL_BIAS,
    AZIMUTH,
    GYRO_BIAS,
    GYRO_TURN,
    ODOMETER,
    PHI,
    PLACE,
    SHARED,
    VELOCITY,
    U,
)
from sins_align.odo.layout import (
    ALPHA as ALPHA_STATE,
)
from sins_align.odo.moments import ReducedGaussHermite
from sins_align.odo.wander import WanderFilter
from sins_align.types import Array


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
