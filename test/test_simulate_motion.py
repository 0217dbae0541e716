"""The analytic truth against numerical differentiation, the paper, and integration."""

import dataclasses
import math

import numpy as np
import pytest
from motion_differences import (
    ACCELERATION_TOLERANCE,
    BUSY,
    DRIVE,
    FIRST,
    FORCE_TOLERANCE,
    RATE_TOLERANCE,
    SECOND,
    base_of,
    differentiate,
    earth_turn,
    inertial_position,
    stencil,
)
from scipy.integrate import cumulative_simpson
from scipy.spatial.transform import Rotation

from sins_align.simulate import SCENARIOS, SingleAxisSwing, SwingOptions, simulate_swing
from sins_align.simulate.attitude_motion import SmoothTurn
from sins_align.simulate.base_motion import BaseMotion
from sins_align.simulate.geodesy import EARTH_RATE, plumb_gravity
from sins_align.simulate.random_streams import random_streams
from sins_align.simulate.scenarios import C_RFU_FLU, ErectCone, find_scenario
from sins_align.types import Array

DEG = math.pi / 180.0
MICRO_RAD = 1e-6
# Before, within and after the turn, away from its ends, where the polynomial changes.
TIMES = np.array([0.0, 3.3, 21.0, 24.9, 30.0, 33.7, 39.0, 47.7])
MOTIONS = [*SCENARIOS, SingleAxisSwing(axis="y"), SingleAxisSwing(axis="z", amplitude_deg=20.0)]


@pytest.fixture(params=MOTIONS, ids=lambda m: m if isinstance(m, str) else f"{m.name}_{m.axis}")
def base(request: pytest.FixtureRequest) -> BaseMotion:
    return base_of(dataclasses.replace(BUSY, scenario=request.param))


def test_attitude_is_a_rotation(base: BaseMotion) -> None:
    C_nb = np.moveaxis(base.attitude(TIMES).C_nb, -1, 0)
    np.testing.assert_allclose(
        C_nb @ C_nb.transpose(0, 2, 1), np.broadcast_to(np.eye(3), C_nb.shape), atol=1e-14
    )
    np.testing.assert_allclose(np.linalg.det(C_nb), 1.0, atol=1e-14)


def test_rate_differentiates_attitude(base: BaseMotion) -> None:
    C_nb, w_nb_b, _ = base.attitude(TIMES)
    dC = differentiate(base.attitude(stencil(TIMES)).C_nb, FIRST, 1)
    W = np.einsum("jin,jkn->ikn", C_nb, dC)  # dC_nb = C_nb [w_nb_b x]
    assert np.abs(W + W.transpose(1, 0, 2)).max() < RATE_TOLERANCE
    np.testing.assert_allclose([W[2, 1], W[0, 2], W[1, 0]], w_nb_b, atol=RATE_TOLERANCE)


def test_acceleration_differentiates_rate(base: BaseMotion) -> None:
    dw = differentiate(base.attitude(stencil(TIMES)).w_nb_b, FIRST, 1)
    np.testing.assert_allclose(
        base.attitude(TIMES).dw_nb_b, dw, rtol=0, atol=ACCELERATION_TOLERANCE
    )


def test_sensed_rate_is_inertial(base: BaseMotion) -> None:
    def C_ib(t: Array) -> Array:
        return np.einsum("nij,jkn->ikn", earth_turn(base, t), base.attitude(t).C_nb)

    W = np.einsum("jin,jkn->ikn", C_ib(TIMES), differentiate(C_ib(stencil(TIMES)), FIRST, 1))
    w_ib_b, _ = base.sense(TIMES)
    np.testing.assert_allclose([W[2, 1], W[0, 2], W[1, 0]], w_ib_b, atol=RATE_TOLERANCE)


def test_specific_force_is_inertial_acceleration_less_gravitation(base: BaseMotion) -> None:
    _, f_ib_b = base.sense(TIMES)
    acceleration_i = differentiate(inertial_position(base, stencil(TIMES)), SECOND, 2)
    acceleration_n = np.einsum("nji,jn->in", earth_turn(base, TIMES), acceleration_i)
    acceleration_n[2] += base.gravity
    f_expected = np.einsum("jin,jn->in", base.attitude(TIMES).C_nb, acceleration_n)
    np.testing.assert_allclose(f_ib_b, f_expected, rtol=0, atol=FORCE_TOLERANCE)


def test_still_base_feels_earth_rate_and_gravity() -> None:
    options = dataclasses.replace(BUSY, scenario="still", turn_deg=0.0, heave_m=0.0, sway_m=0.0)
    base = base_of(dataclasses.replace(options, heading_deg=90.0, lever_arm_m=(0.0, 0.0, 0.0)))
    w, f = base.sense(np.zeros(1))
    # Heading east, so north is to the left.
    sine, cosine = math.sin(35.0 * DEG), math.cos(35.0 * DEG)
    np.testing.assert_allclose(w[:, 0], EARTH_RATE * np.array([0.0, cosine, sine]), atol=1e-19)
    np.testing.assert_allclose(f[:, 0], [0.0, 0.0, base.gravity], atol=1e-14)


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_heading_and_turn_are_clockwise_about_up(scenario: str) -> None:
    plain = SwingOptions(scenario=scenario, seed=8, duration_s=60.0)
    t = np.array([60.0])
    C_plain = base_of(plain).attitude(t).C_nb[:, :, 0]
    clockwise_50 = Rotation.from_rotvec([0.0, 0.0, -50.0 * DEG]).as_matrix()
    for change in ({"heading_deg": 50.0}, {"turn_deg": 50.0}):
        C_nb = base_of(dataclasses.replace(plain, **change)).attitude(t).C_nb[:, :, 0]
        np.testing.assert_allclose(C_nb, clockwise_50 @ C_plain, atol=1e-14)


def test_turn_is_smooth_and_complete() -> None:
    turn = SmoothTurn(2.0, 10.0, 5.0)
    angle, rate, acceleration = turn(np.array([0.0, 10.0, 12.5, 15.0, 99.0]))
    np.testing.assert_allclose(angle, [0.0, 0.0, 1.0, 2.0, 2.0], atol=1e-14)
    np.testing.assert_array_equal(rate[[0, 1, 3, 4]], 0.0)
    np.testing.assert_array_equal(acceleration[[0, 1, 3, 4]], 0.0)
    assert rate[2] == pytest.approx(2.0 * 35.0 / 16.0 / 5.0)


def test_heave_and_sway_move_the_centre_as_told() -> None:
    base = base_of(BUSY)
    east, north, up = base.centre_position(np.arange(0.0, 180.0, 0.01))
    # Over a whole number of periods of either, 6 s and 9 s, the mean square is half the
    # amplitude's.
    assert up.std() == pytest.approx(0.3 / math.sqrt(2.0), rel=1e-9)
    assert np.hypot(east.std(), north.std()) == pytest.approx(0.2 / math.sqrt(2.0), rel=1e-9)
    np.testing.assert_allclose(east * math.cos(30 * DEG), north * math.sin(30 * DEG), atol=1e-15)


def test_pitch_is_the_papers() -> None:
    scenario = find_scenario("pitch")
    phases = np.array([0.3, 1.1, 2.5])
    base = dataclasses.replace(base_of(SwingOptions()), rotations=scenario.rotations(phases))
    t = 17.0
    psi, theta, gamma = (
        (mean + amplitude * math.sin(math.tau * f * t + phase)) * DEG
        for mean, amplitude, f, phase in zip(
            (30, 55, 15), (8, 7, 9), (1 / 10, 1 / 8, 1 / 12), phases, strict=True
        )
    )
    C_p_b = Rotation.from_euler("ZXY", [psi, theta, gamma]).as_matrix()
    C_nb = base.attitude(np.array([t])).C_nb[:, :, 0]
    np.testing.assert_allclose(C_nb @ C_RFU_FLU.T, C_p_b, atol=1e-15)
    np.testing.assert_allclose(base.r_b, [2.0, -4.0, 3.0], atol=1e-15)


def test_erect_is_the_papers() -> None:
    scenario = ErectCone()
    printed = [[0.1464, -0.5, 0.8536], [-0.5, 0.7071, 0.5], [-0.8536, -0.5, -0.1464]]
    np.testing.assert_allclose(scenario.C_b2_b, printed, atol=5e-5)
    base = base_of(SwingOptions(scenario="erect"))
    np.testing.assert_allclose(scenario.C_paper_b @ base.r_b, [4.0, 2.0, 3.0], atol=1e-14)


def test_cone_is_the_papers() -> None:
    base = base_of(SwingOptions(scenario="erect", seed=2))
    phase = random_streams(2)["attitude_phases"].uniform(0.0, math.tau, 3)[0]
    angle = math.tau / 8 * TIMES + phase
    cone, omega = 10.0 * DEG, math.tau / 8
    C_nb, w_nb_b, _ = base.attitude(TIMES)
    C_b_b2 = ErectCone().C_paper_b.T
    C_b1_p = Rotation.from_euler("x", -90.0 * DEG).as_matrix()
    rotvec = cone * np.stack((np.sin(angle), 0.0 * angle, np.cos(angle)), axis=1)
    np.testing.assert_allclose(
        np.einsum("ij,jkn,kl->nil", C_b1_p, C_nb, C_b_b2),
        Rotation.from_rotvec(rotvec).as_matrix(),
        atol=1e-14,
    )
    # Section 4.4 prints the rate against p, in b2.
    w_printed = omega * np.stack(
        (
            np.cos(angle) * math.sin(cone),
            np.full_like(angle, math.cos(cone) - 1.0),
            -np.sin(angle) * math.sin(cone),
        )
    )
    np.testing.assert_allclose(C_b_b2.T @ w_nb_b, w_printed, atol=1e-15)


@pytest.mark.parametrize("axis", "xyz")
def test_single_axis_swings_about_one_axis(axis: str) -> None:
    base = base_of(SwingOptions(scenario=SingleAxisSwing(axis=axis, amplitude_deg=10.0)))
    w = base.attitude(np.linspace(0.0, 8.0, 801)).w_nb_b
    others = [row for row in range(3) if row != "xyz".index(axis)]
    assert np.abs(w[others]).max() == 0.0
    assert np.abs(w).max() == pytest.approx(10.0 * DEG * math.tau / 8, rel=1e-4)


@pytest.mark.parametrize(
    ("latitude_deg", "expected"), [(0.0, 9.7803253359), (45.0, 9.806198), (90.0, 9.8321849)]
)
def test_gravity_on_the_ellipsoid(latitude_deg: float, expected: float) -> None:
    assert plumb_gravity(latitude_deg * DEG, 0.0) == pytest.approx(expected, abs=1e-6)


def test_gravity_falls_with_height() -> None:
    # The free-air gradient at 45 deg, 3.0855e-6 less 2 x 7.2e-13 h per second squared.
    fall = plumb_gravity(45.0 * DEG, 0.0) - plumb_gravity(45.0 * DEG, 1000.0)
    assert fall == pytest.approx(3.0855e-3 - 0.7e-6, abs=2e-7)


@pytest.mark.parametrize("scenario", ["pitch", "erect"])
def test_mean_sampling_is_the_mean(scenario: str) -> None:
    options = dataclasses.replace(BUSY, scenario=scenario, rate_hz=100.0, duration_s=30.0)
    run = simulate_swing(dataclasses.replace(options, sampling="mean"))
    base = base_of(options)
    for sample in (0, 1, 2345):  # the first interval lies before the first stamp
        # Midpoint rule on 10 us: error 1e-5^2 / 24 of a second derivative below 10.
        t = sample * 0.01 - 0.01 + 1e-5 * (np.arange(1000) + 0.5)
        w, f = base.sense(t)
        np.testing.assert_allclose(run.imu.w_ib_b[:, sample], w.mean(axis=1), atol=1e-11)
        np.testing.assert_allclose(run.imu.f_ib_b[:, sample], f.mean(axis=1), atol=1e-10)


@pytest.mark.parametrize(
    ("scenario", "drive"), [("pitch", {}), ("erect", {}), ("pitch", {**DRIVE, "drive_m": 300.0})]
)
def test_inertial_integration_closes(scenario: str, drive: dict[str, float]) -> None:
    """60 s of pure inertial navigation find the attitude and the place of the IMU again."""
    options = dataclasses.replace(BUSY, scenario=scenario, rate_hz=1000.0, **drive)
    base = base_of(options)
    imu = simulate_swing(options).imu
    turns = simulate_swing(dataclasses.replace(options, sampling="mean")).imu.w_ib_b.T * 1e-3
    # Coning: the second order of the rotation vector from two consecutive increments.
    turns[1:] += np.cross(turns[:-1], turns[1:]) / 12.0
    C_ib = np.empty((len(imu), 3, 3))
    C_ib[0] = base.attitude(np.zeros(1)).C_nb[:, :, 0]
    for k, step in enumerate(Rotation.from_rotvec(turns[1:]).as_matrix()):
        C_ib[k + 1] = C_ib[k] @ step
    t = np.arange(len(imu)) * 1e-3
    earth = earth_turn(base, t)
    truth = earth[-1] @ base.attitude(t[-1:]).C_nb[:, :, 0]
    assert Rotation.from_matrix(C_ib[-1] @ truth.T).magnitude() < 0.01 * MICRO_RAD

    force_i = np.einsum("nij,jn->in", C_ib, imu.f_ib_b) - base.gravity * earth[:, :, 2].T
    position = inertial_position(base, t)
    velocity = differentiate(inertial_position(base, stencil(t[:1])), FIRST, 1)
    travel = cumulative_simpson(
        velocity + cumulative_simpson(force_i, x=t, initial=0.0), x=t, initial=0.0
    )
    np.testing.assert_allclose(travel[:, -1], position[:, -1] - position[:, 0], atol=1e-6)
