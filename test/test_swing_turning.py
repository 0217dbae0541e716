"""The rate about up: what it is, how sure, and what a base that does turn makes of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from sins_align.config import swing_config
from sins_align.grades import ImuGrade, load_grade
from sins_align.limits import latitude_differs
from sins_align.session import Session
from sins_align.simulate import SwingOptions, simulate_swing
from sins_align.swing.latitude import latitude_by_both, latitude_doubts
from sins_align.swing.turning import (
    BEGINS,
    LENGTHS,
    NOISE,
    NOISE_APART,
    WINDOW_S,
    Turning,
    latitude_of_turning,
    turning,
)
from sins_align.types import Array, ImuSamples, LatitudeEstimate, State
from sins_align.units import DEG, DEG_PER_H

EARTH = 7.292115e-5  # [rad/s]
RLG = load_grade("rlg")
Law = Callable[[Array], Array]


def epochs_of(heading: Law, latitude: float, end_s: float, tilts: bool = False) -> Any:
    """Epochs of a base that turns by a heading law and, where asked for, pitches and rolls.

    b0 is n at t = 0, which the Earth turns in inertial space from then on.
    """
    t = np.arange(round(2.0 * end_s) + 1) * 0.5
    pitch, roll = (tilts * np.sin(math.tau * t / k + k) * DEG for k in (8.0, 11.0))
    axis = np.array([0.0, math.cos(latitude), math.sin(latitude)])
    earth = Rotation.from_rotvec(EARTH * t[:, None] * axis)
    base = Rotation.from_euler("ZXY", np.stack((heading(t), pitch, roll), axis=1))
    C = (earth * base).as_matrix()
    return SimpleNamespace(time_s=t, C=C, B=0.25 * (C[1:] + C[:-1]))


def turn_of(epochs: Any, given: float, grade: ImuGrade = RLG) -> Turning:
    found = turning(epochs, np.eye(3), given, grade)
    assert found is not None
    return found


@pytest.mark.parametrize("tilts", [False, True])
@pytest.mark.parametrize("latitude_deg", [-40.0, 0.0, 3.0, 60.0])
@pytest.mark.parametrize("off_deg", [-1.0, 0.0, 2.0])
def test_it_is_the_earths_rate_about_up(latitude_deg: float, off_deg: float, tilts: bool) -> None:
    """And a gyro bias: 0.1 deg/h here, of a base that swings by 3 deg about up or is still.

    Where it began tilted by 1 deg, half of that is seen of a horizontal rate.
    """
    bias, swing = 0.1 * DEG_PER_H, 3.0 * DEG * tilts
    latitude, given = latitude_deg * DEG, (latitude_deg + off_deg) * DEG
    epochs = epochs_of(
        lambda t: swing * np.sin(math.tau * t / 10.3) + bias * t, latitude, 250.0, tilts
    )
    found = turn_of(epochs, given)
    expected = EARTH * (math.sin(latitude) - math.sin(given)) + bias
    across = EARTH * (math.cos(latitude) - math.cos(given)) * 1.5 * DEG * tilts
    assert abs(found.excess - expected) < 1e-3 * DEG_PER_H + 0.5 * abs(across)
    assert found.sigma < 0.02 * DEG_PER_H


def test_noise_of_the_windows() -> None:
    """The constants, by integrals of the windows themselves."""
    x = (np.arange(40_000) + 0.5) / 40_000
    inside = (x - BEGINS[:, None]) / LENGTHS[:, None]
    weights = np.where((inside > 0.0) & (inside < 1.0), np.sin(math.pi * inside) ** 6, 0.0)
    weights /= weights.mean(axis=1)[:, None]
    covariance = weights @ weights.T / x.size
    parts = covariance[1:, 1:]
    assert covariance[0, 0] == pytest.approx(NOISE, rel=1e-3)
    assert np.trace(parts) - parts.sum() / 3.0 == pytest.approx(NOISE_APART, rel=2e-3)


@pytest.mark.parametrize("end_s", [60.0, 280.0])
def test_sigma_of_noise_is_honest(end_s: float) -> None:
    """White noise of a tactical gyro, which what a base may creep by is nothing against."""
    noise, count, stream = 0.06 * DEG / 60.0, 200, np.random.default_rng(7)
    squares = []
    for _ in range(count):
        steps = noise * math.sqrt(0.5) * stream.standard_normal(round(2 * end_s))
        walk = np.concatenate(([0.0], np.cumsum(steps)))
        found = turn_of(
            epochs_of(lambda t, walk=walk: walk, 0.3, end_s), 0.3, ImuGrade(gyro_arw=noise)
        )
        squares.append((found.excess / found.sigma) ** 2)
    low, high = (float(chi2.ppf(p, count)) / count for p in (1e-4, 1.0 - 1e-4))
    # What noise makes the parts differ by is left out below twice its size, now and then it is not.
    assert 0.8 * low < np.mean(squares) < high


def test_a_cone_turns_scale_errors_into_a_rate() -> None:
    """sigma is that of many draws of M, each of them carried on by gyros that have it."""
    rate, cone, t = math.tau / 8.0, 10.0 * DEG, np.arange(240 * 40 + 1) / 40.0
    axis = np.stack((np.sin(rate * t), np.cos(rate * t), np.zeros_like(t)), axis=1)
    true = Rotation.from_rotvec(cone * axis)
    steps = (true[:-1].inv() * true[1:]).as_rotvec()
    grade = replace(RLG, gyro_arw=0.0, gyro_scale=2e-5, misalignment=1e-5)
    stream, found = np.random.default_rng(3), []
    for _ in range(40):
        M = grade.misalignment * stream.standard_normal((3, 3))
        np.fill_diagonal(M, grade.gyro_scale * stream.standard_normal(3))
        C = true[0].as_matrix()
        carried = [C]
        for step in Rotation.from_rotvec(steps + steps @ M.T).as_matrix():
            C = C @ step
            carried.append(C)
        C = np.array(carried)[::20]
        earth = Rotation.from_rotvec(EARTH * t[::20, None] * np.array([0.0, 1.0, 0.0]))
        C = earth.as_matrix() @ C
        found.append(
            turn_of(SimpleNamespace(time_s=t[::20], C=C, B=0.25 * (C[1:] + C[:-1])), 0, grade)
        )
    sigma = np.mean([f.sigma for f in found])
    low, high = (float(chi2.ppf(p, 40)) / 40 for p in (1e-4, 1.0 - 1e-4))
    assert low < np.mean([f.excess**2 for f in found]) / sigma**2 < high
    still = turn_of(epochs_of(np.zeros_like, 0.0, 240.0), 0.0, grade)
    assert sigma > 5.0 * still.sigma


def test_only_the_last_minutes_count() -> None:
    """A quarter turn, and then five minutes of rest."""
    turned = epochs_of(lambda t: 90.0 * DEG * np.clip(t / 20.0, 0.0, 1.0), 0.1, 30.0 + WINDOW_S)
    assert abs(turn_of(turned, 0.1).excess) < 1e-4 * DEG_PER_H
    within = epochs_of(lambda t: 90.0 * DEG * np.clip(t / 20.0 - 5.0, 0.0, 1.0), 0.1, 250.0)
    found = turn_of(within, 0.1)
    assert abs(found.excess) < 3.0 * found.sigma
    assert turning(epochs_of(np.zeros_like, 0.1, 30.0), np.eye(3), 0.1, RLG) is None


@pytest.mark.parametrize("grade", ["rlg", "fog"])
@pytest.mark.parametrize("period_s", [60.0, 120.0, 300.0, 600.0])
def test_a_base_that_yaws_by_degrees_is_not_another_latitude(grade: str, period_s: float) -> None:
    """At any phase and at any time."""
    bias = load_grade(grade).gyro_bias
    for phase in np.arange(0.0, math.tau, math.tau / 12.0):
        yaw = epochs_of(
            lambda t, p=phase: 2.0 * DEG * np.sin(math.tau * t / period_s + p), 0.0, 400
        )
        for end in (80, 120, 200, 300, 450, 600, 800):
            part = SimpleNamespace(time_s=yaw.time_s[: end + 1], B=yaw.B[:end], C=yaw.C[: end + 1])
            found = turn_of(part, 0.0, load_grade(grade))
            latitude = latitude_of_turning(found, 0.0, bias)
            assert latitude is None or not latitude_differs(0.0, latitude)


@pytest.mark.parametrize("rate_deg_min", [-5.0, 1.0, 5.0])
def test_a_base_that_turns_tells_nothing(rate_deg_min: float) -> None:
    rate = rate_deg_min * DEG / 60.0
    found = turn_of(epochs_of(lambda t: rate * t, 0.5, 200.0), 0.5)
    assert found.excess == pytest.approx(rate, rel=1e-6)
    assert latitude_of_turning(found, 0.5, RLG.gyro_bias) is None


def test_two_latitudes_make_one() -> None:
    own, turn = LatitudeEstimate(0.5, 0.01), LatitudeEstimate(0.54, 0.02)
    both = latitude_by_both(own, turn)
    assert both is not None and both.latitude == pytest.approx(0.508)
    assert both.sigma == pytest.approx(0.01 * 0.8**0.5)
    assert latitude_by_both(own, None) is own and latitude_by_both(None, turn) is turn
    # Where gravity tells a degree, nothing else is taken for granted.
    told = own._replace(sigma=0.0025)
    assert latitude_by_both(told, turn) is told
    # Gravity is much the same in the other hemisphere ...
    south = latitude_by_both(own, LatitudeEstimate(-0.54, 0.02))
    assert south is not None and south.latitude == pytest.approx(-0.508)
    # ... and nowhere else: then it is the base that turns.
    assert latitude_by_both(own, LatitudeEstimate(0.8, 0.02)) is own


@pytest.mark.parametrize(
    ("grade", "sigma_deg", "sways_s", "waits"),
    [
        ("rlg", 0.5, 60.0, True),
        ("rlg", 0.16, 60.0, False),  # told
        ("rlg", 0.5, 210.0, False),  # for too long
        ("rlg", 0.5, math.inf, False),  # it turns
        ("fog", 0.5, 60.0, False),
    ],
)
def test_at_the_equator_a_base_that_sways_is_waited_for(
    grade: str, sigma_deg: float, sways_s: float, waits: bool
) -> None:
    own = LatitudeEstimate(0.0, sigma_deg * DEG)
    findings = latitude_doubts(load_grade(grade), 0.0, own, False, sways_s)
    assert [f.reason.key for f in findings] == ["latitude_unproven"] * waits


def run(true_deg: float, off_about_up: float = 0.0, **changes: Any) -> Session:
    """Session of a still base with an rlg; off_about_up : of the gyros [rad/s]."""
    options = SwingOptions(
        scenario="still", grade="rlg", seed=4, rate_hz=100.0, duration_s=130.0,
        latitude_deg=true_deg, altitude_m=50.0, lever_arm_m=(0.0, 0.0, 0.0),
    )  # fmt: skip
    parameters = {"latitude_deg": true_deg, "altitude_m": 50.0, "imu_grade": "rlg"}
    imu = simulate_swing(options).imu
    w_ib_b = imu.w_ib_b + off_about_up * np.array([[0.0], [0.0], [1.0]])
    imu = ImuSamples(imu.stamp_ns, w_ib_b, imu.f_ib_b)
    session = Session(swing_config({**parameters, **changes}))
    session.add_imu(imu)
    return session


@pytest.mark.parametrize(
    ("true_deg", "given_deg"), [(0.0, 1.0), (-0.5, 0.5), (4.0, 3.0), (-30.0, 30.0), (-5.0, 5.0)]
)
def test_the_session_names_the_latitude(true_deg: float, given_deg: float) -> None:
    """At the equator, and that of the other hemisphere."""
    session = run(true_deg, latitude_deg=given_deg)
    assert "latitude_differs" in session.status.keys
    estimate = session.estimate
    assert estimate is not None and estimate.latitude is not None
    assert abs(estimate.latitude.latitude / DEG - true_deg) < 0.1
    assert run(true_deg).status.state is State.ALIGNED


def test_a_base_that_settles_is_no_other_latitude_where_gravity_tells_it() -> None:
    """It turns by two arcminutes an hour, which at 40 deg would be 0.2 deg of latitude."""
    session = run(40.0, 2.0 / 60.0 * DEG_PER_H)
    assert session.status.state is State.ALIGNED
    assert not {"latitude_differs", "latitude_doubted"} & set(session.status.keys)


@pytest.mark.parametrize("latitude_deg", [0.0, -5.0])
def test_the_time_to_go_waits_for_the_latitude(latitude_deg: float) -> None:
    """A level swing near the equator: what is foreseen after a minute, against what came."""
    options = SwingOptions(
        scenario="level",
        grade="rlg",
        seed=1,
        rate_hz=100.0,
        duration_s=200.0,
        latitude_deg=latitude_deg,
    )
    imu = simulate_swing(options).imu
    config = {"latitude_deg": latitude_deg, "altitude_m": 50.0, "imu_grade": "rlg"}
    waits, off = (Session(swing_config({**config, "latitude_check": c})) for c in ("warn", "off"))
    foreseen = []
    for session in (waits, off):
        session.add_imu(imu.select(slice(0, 5501)))
        foreseen.append(55.0 + session.eta_s)
        session.add_imu(imu.select(slice(5501, None)))
    came = [session.status.aligned_at_s for session in (waits, off)]
    assert came[0] is not None and came[1] is not None
    assert came[1] + 40.0 < came[0]
    assert foreseen == pytest.approx(came, rel=0.2)
