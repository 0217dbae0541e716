"""Axes of the large-azimuth filters: the frame's azimuth is free, errors fed back turn with it."""

from __future__ import annotations

import copy
import math

import numpy as np
import pytest
from large_azimuth_filters import (
    STARTS,
    every_method,
    every_start,
    follow,
    handed_over,
    run_and_know,
    turn,
    with_rule,
)
from scipy.spatial.transform import Rotation
from test_odo_wander import (
    ALPHA,
    EXACT,
    PERFECT,
    about_up,
    config,
    epoch_at,
    second_of_most,
    small_turn,
    true_navigation,
)

from sins_align.odo.fading import NoFading
from sins_align.odo.large_azimuth import LargeAzimuthFilter
from sins_align.odo.layout import AZIMUTH, ENU_SIZE, PHI, PLACE, SIZE, VELOCITY, U
from sins_align.odo.moments import ReducedGaussHermite
from sins_align.odo.odometer_model import OdometerModel
from sins_align.odo.standing import Standing
from sins_align.odo.wander import WanderFilter


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
