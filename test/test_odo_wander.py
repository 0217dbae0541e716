"""Laws of the wander-azimuth filters: what is known to be wrong is put right, and no more."""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sins_align.config import OdometerConfig, odo_config
from sins_align.grades import ImuGrade, load_grade
from sins_align.odo.epoch import AidedEpoch, integrate_epoch
from sins_align.odo.filter import FINE_VARIANCE
from sins_align.odo.knowledge import knowledge_of
from sins_align.odo.layout import (
    ACCEL_BIAS,
    AZIMUTH,
    GYRO_BIAS,
    GYRO_TURN,
    ODOMETER,
    PHI,
    SIZE,
    VELOCITY,
)
from sins_align.odo.navigation import WanderNavigation
from sins_align.odo.odometer_model import (
    DIRECTION,
    DIRECTION_TIME_S,
    GRADIENT,
    LATENCY,
    LEVER,
    MOUNTING,
    POSITION,
    SCALE,
    OdometerModel,
)
from sins_align.odo.pairing import Paired
from sins_align.odo.standing import Standing
from sins_align.odo.wander import WanderFilter
from sins_align.simulate import VehicleOptions, VehicleRun, simulate_vehicle
from sins_align.types import Array, ImuBlock, ImuSampling, Position

ARCSEC = math.radians(1.0 / 3600.0)
DEGREE = math.radians(1.0)
RATE_HZ = 200
LEVER_ARM = (0.5, -0.3, 0.8)
MOUNTING_DEG = (1.0, -2.0, 30.0)
# A perfect IMU: what is left is the noise that stands for none.
PERFECT = ImuGrade()
FOG = load_grade("fog")


@cache
def drive() -> VehicleRun:
    """A town drive that goes exactly where the vehicle's nose points."""
    return simulate_vehicle(
        VehicleOptions(
            scenario="urban",
            grade="perfect",
            seed=5,
            rate_hz=RATE_HZ,
            duration_s=180.0,
            altitude_m=0.0,
            sampling="instantaneous",
            odometer_lever_arm_m=LEVER_ARM,
            mounting_rpy_deg=MOUNTING_DEG,
            sideslip_deg_per_m_s2=0.0,
            suspension_roll_deg_per_m_s2=0.0,
            suspension_pitch_deg_per_m_s2=0.0,
            road_motion_deg=0.0,
            direction_noise_deg=0.0,
            standing_motion_arcsec=0.0,
        )
    )


def about_up(angle: float) -> Array:
    return Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()


def small_turn(phi: Array) -> Array:
    """I - [phi x], as a rotation."""
    return Rotation.from_rotvec(-np.asarray(phi)).as_matrix()


class Faults(NamedTuple):
    """What is wrong with the epoch's data: gyro and accel biases, odometer's scale, delay."""

    gyro: Array = np.zeros(3)
    accel: Array = np.zeros(3)
    scale: float = 0.0
    latency: float = 0.0


NONE = Faults()


def epoch_at(second: float, faults: Faults = NONE) -> AidedEpoch:
    run = drive()
    k = round(second * RATE_HZ)
    part = run.imu.select(slice(k, k + RATE_HZ + 1))
    late = round(faults.latency * 1e9)
    distance = run.truth.distance_at(part.stamp_ns + late) * (1.0 + faults.scale)
    speed = run.truth.speed_at(part.stamp_ns + late) * (1.0 + faults.scale)
    block = ImuBlock(
        part.stamp_ns, part.w_ib_b + faults.gyro[:, None], part.f_ib_b + faults.accel[:, None]
    )
    return integrate_epoch(Paired(block, distance, speed, 0.0), ImuSampling.INSTANTANEOUS)


def config(**parameters: object) -> OdometerConfig:
    return odo_config(
        {
            "odometer_lever_arm_m": list(LEVER_ARM),
            "mounting_rpy_deg": list(MOUNTING_DEG),
            **parameters,
        }
    ).odometer


# No walk, and noise well above second powers of the errors, well below what they do.
EXACT = {
    "odometer_noise_m": [1e-3] * 3,
    "odometer_noise_per_m": [0.0] * 3,
    "odometer_direction_sigma_deg": 0.0,
    "odometer_scale_walk_sqrt_s": 0.0,
    "odometer_latency_walk_s_sqrt_s": 0.0,
    "odometer_quantum_m": 0.0,
}


def true_navigation(second: float, alpha: float, known: bool = True) -> WanderNavigation:
    run = drive()
    stamp = int(run.imu.stamp_ns[round(second * RATE_HZ)])
    latitude, longitude, altitude = run.truth.position_at(stamp)
    C_an = about_up(-alpha)
    navigation = WanderNavigation(
        C_an @ run.truth.C_nb_at(stamp),
        C_an @ run.truth.v_n_at(stamp),
        Position(latitude, longitude, altitude),
    )
    if known:
        navigation.e_a = C_an @ [0.0, math.cos(latitude), math.sin(latitude)]
    return navigation


@cache
def second_of_most(turning: bool) -> float:
    """Where the vehicle turns most, or where its speed changes most."""
    run = drive()
    stamps = run.imu.stamp_ns[::RATE_HZ]
    speed = run.truth.speed_at(stamps)
    change = np.unwrap(run.truth.heading_at(stamps)) if turning else speed
    return float(np.argmax((np.abs(np.diff(change)) * (np.abs(speed[:-1]) > 3.0))[:-2]))


def second_for(name: str) -> float:
    return second_of_most(name not in ("latency", "gradient 1"))


ALPHA = 0.7
# State, its index, and the error put in: of the size of a prior's sigma, so small that its
# square does not matter.
STATES = {
    **{f"phi {k}": (PHI.start + k, 1e-3) for k in range(3)},
    **{f"velocity {k}": (VELOCITY.start + k, 0.1) for k in range(3)},
    **{f"axis {k}": (AZIMUTH.start + k, 0.3) for k in range(2)},
    "azimuth": (AZIMUTH.start, 0.1),
    **{f"gyro bias {k}": (GYRO_BIAS.start + k, 1e-4) for k in range(3)},
    **{f"accel bias {k}": (ACCEL_BIAS.start + k, 1e-2) for k in range(3)},
    **{f"gyro turn {k}": (GYRO_TURN.start + k, 1e-3) for k in range(3)},
    "scale": (ODOMETER.start + SCALE, 3e-3),
    "latency": (ODOMETER.start + LATENCY, 0.02),
    **{f"lever {k}": (ODOMETER.start + LEVER.start + k, 0.2) for k in range(3)},
    **{f"mounting {k}": (ODOMETER.start + MOUNTING.start + k, 3e-3) for k in range(2)},
    **{f"direction {k}": (ODOMETER.start + DIRECTION.start + k, 3e-3) for k in range(2)},
    **{f"gradient {k}": (ODOMETER.start + GRADIENT.start + k, 3e-3) for k in range(2)},
}


def with_error(name: str, x: float) -> tuple[WanderFilter, AidedEpoch, float]:
    """A filter of which one state is wrong by x, which it knows; the epoch, and the decay."""
    index, _ = STATES[name]
    second = second_for(name)
    navigation = true_navigation(second, ALPHA)
    odometer = OdometerModel(config(**EXACT))
    decay = 1.0
    faults, bare = NONE, epoch_at(second)
    rate = float(navigation.C_ab[2] @ Rotation.from_matrix(bare.C_end).as_rotvec())
    e = np.zeros(SIZE)
    e[index] = x
    if name == "azimuth":
        navigation.e_a = about_up(-x) @ navigation.e_a
    elif name.startswith("axis"):
        navigation.e_a = navigation.e_a + np.array([*e[AZIMUTH], 0.0])
    elif name.startswith("gyro turn"):
        faults = Faults(gyro=e[GYRO_TURN] * rate / bare.duration_s)
    elif index < ODOMETER.start:
        faults = Faults(gyro=e[GYRO_BIAS], accel=e[ACCEL_BIAS])
    elif name in ("scale", "latency"):
        # Faults that are not known of. The error is estimate minus truth; a clock that is ahead
        # is read too late.
        faults = Faults(scale=-x) if name == "scale" else Faults(latency=x)
    navigation.C_ab = small_turn(e[PHI]) @ navigation.C_ab
    navigation.v_a = navigation.v_a + e[VELOCITY]
    filter_ = WanderFilter(
        navigation, odometer, PERFECT, 1.0, 1.0, None if name.startswith("axis") else 1.0
    )
    if index > ODOMETER.start + LATENCY:
        odometer.x = odometer.x + e[ODOMETER]
        if name.startswith("direction"):
            decay = math.exp(-bare.duration_s / DIRECTION_TIME_S[int(name[-1])])
    P = np.zeros((SIZE, SIZE))
    P[AZIMUTH, AZIMUTH] = 1e-30 * np.eye(2)
    # So large that the noise takes nothing off the gain.
    P[index, index] = (1e3 * x) ** 2
    filter_.P = P
    return filter_, epoch_at(second, faults), decay


def left_over(name: str, filter_: WanderFilter) -> float:
    """The error of the state after the epoch, as far as it was not known beforehand."""
    index, _ = STATES[name]
    truth = true_navigation(second_for(name) + 1.0, ALPHA)
    navigation = filter_.navigation
    if index < PHI.stop:
        off = navigation.C_ab @ truth.C_ab.T
        return float(-Rotation.from_matrix(off).as_rotvec()[index])
    if index < VELOCITY.stop:
        return float((navigation.v_a - truth.v_a)[index - VELOCITY.start])
    if name == "azimuth":
        alphas = [math.atan2(e[0], e[1]) for e in (navigation.e_a, truth.e_a)]
        return alphas[0] - alphas[1]
    if AZIMUTH.start <= index < AZIMUTH.stop:
        return float((navigation.e_a - truth.e_a)[index - AZIMUTH.start])
    if index < GYRO_BIAS.stop:
        return float(filter_.sensors.gyro_bias[index - GYRO_BIAS.start])
    if index < ACCEL_BIAS.stop:
        return float(filter_.sensors.accel_bias[index - ACCEL_BIAS.start])
    if index < GYRO_TURN.stop:
        return float(filter_.sensors.gyro_turn[index - GYRO_TURN.start])
    return float(filter_.odometer.x[index - ODOMETER.start])


# What an epoch's innovation says of an error, over what it is.
RECOVERY_TOLERANCE = 1e-2
# The Earth's rate does in an epoch what a tenth of a millimetre of path does; that the frame's
# turning acts at the middle of the displacement is good to 25 um of it in a sharp turn.
AXIS_TOLERANCE = 0.2
# The rate of turning is the sine of the angle, which is 20 deg in this second.
TURN_TOLERANCE = 3e-2


def tolerance_for(name: str) -> float:
    if name.startswith("ax") or name == "azimuth":
        return AXIS_TOLERANCE
    return TURN_TOLERANCE if name.startswith("gyro turn") else RECOVERY_TOLERANCE


@pytest.mark.parametrize("name", STATES)
def test_one_epoch_tells_an_error(name: str) -> None:
    """The only thing wrong is found, sign and size: difference of two signs of the error."""
    index, x = STATES[name]
    ends = []
    for sign in (1.0, -1.0):
        filter_, epoch, decay = with_error(name, sign * x)
        filter_.process(epoch, Standing.NO)
        ends.append(left_over(name, filter_))
    found = 0.5 * (ends[0] - ends[1])
    # Errors of the samples are found where they were none: as large as they are.
    is_sensor = GYRO_BIAS.start <= index < GYRO_TURN.stop
    expected = x if is_sensor else -x if name in ("scale", "latency") else 0.0
    assert decay <= 1.0
    assert found == pytest.approx(expected, abs=tolerance_for(name) * x)


def test_position_noise_is_differenced() -> None:
    """What an epoch's end was read too far, the next epoch reads too short."""
    second, q = second_of_most(True), 0.02
    ends = []
    for sign in (1.0, -1.0):
        filter_ = WanderFilter(
            true_navigation(second, ALPHA), OdometerModel(config(**EXACT)), PERFECT, 1, 1, 1
        )
        # Position noise is the only thing there is, at the end of both epochs.
        filter_.P = np.zeros((SIZE, SIZE))
        filter_.P[AZIMUTH, AZIMUTH] = 1e-30 * np.eye(2)
        filter_.odometer.quantum = 1.0
        for k, more in ((0, sign * q), (1, -sign * q)):
            epoch = epoch_at(second + k)
            assert epoch.travel is not None
            forward = filter_.odometer.C_bm[:, 0]
            # The whole jump where the epoch ends: C_end there, C_start at the next start.
            C = epoch.C_end if k == 0 else np.eye(3)
            longer = epoch.travel.M + more * np.outer(C @ forward, forward)
            travel = epoch.travel._replace(M=longer)
            filter_.process(epoch._replace(travel=travel), Standing.NO)
            ends.append(filter_.odometer.x[POSITION][0])
    first, second_, third, fourth = ends
    assert 0.5 * (first - third) == pytest.approx(q, rel=RECOVERY_TOLERANCE)
    assert 0.5 * (second_ - fourth) == pytest.approx(0.0, abs=RECOVERY_TOLERANCE * q)


def make_filter(
    alpha: float, grade: ImuGrade = FOG, second: float = 0.0, **parameters: object
) -> WanderFilter:
    """From the true levels and velocity; the azimuth is not known."""
    navigation = true_navigation(second, alpha, known=False)
    return WanderFilter(navigation, OdometerModel(config(**parameters)), grade, 0.01, 0.2)


def run_filter(filter_: WanderFilter, begin: int, end: int) -> None:
    for second in range(begin, end):
        filter_.process(exact_epoch(second), Standing.NO)


@cache
def exact_epoch(second: int) -> AidedEpoch:
    return epoch_at(float(second))


def attitude_error(filter_: WanderFilter, second: float) -> Array:
    truth = true_navigation(second, 0.0).C_ab
    return -Rotation.from_matrix(knowledge_of(filter_).C_nb @ truth.T).as_rotvec()


@pytest.mark.parametrize("alpha", [0.0, 2.0, -3.0])
def test_perfect_sensors_find_the_azimuth(alpha: float) -> None:
    """Nothing but the start's ignorance is in the way; one model and then the other."""
    filter_ = make_filter(alpha)
    run_filter(filter_, 0, 170)
    assert filter_.azimuth().sigma < 0.2 * DEGREE
    east, north, up = attitude_error(filter_, 170.0)
    assert abs(up) < 0.05 * DEGREE
    assert max(abs(east), abs(north)) < 5.0 * ARCSEC
    assert abs(filter_.odometer.x[SCALE]) < 2e-4


GAUGE_TOLERANCE = 1e-6  # [rad]


@pytest.mark.parametrize("turn", [0.5, -2.0, math.pi])
def test_start_azimuth_of_the_frame_does_not_matter(turn: float) -> None:
    """Turning a about up turns everything in it; what comes out in ENU is the same."""
    one, other = make_filter(0.3), make_filter(0.3 + turn)
    for begin in (0, 20, 60):
        for filter_ in (one, other):
            run_filter(filter_, begin, {0: 20, 20: 60, 60: 100}[begin])
        a, b = knowledge_of(one), knowledge_of(other)
        off = Rotation.from_matrix(a.C_nb @ b.C_nb.T).magnitude()
        # The density of a wide azimuth is summed up on a grid, which does not turn with it.
        wide = one.azimuth().sigma > 5.0 * DEGREE
        assert off < (1e-3 if wide else GAUGE_TOLERANCE)
        size = np.abs(a.covariance).max()
        tolerance = (5e-2 if wide else 1e-4) * size
        np.testing.assert_allclose(a.covariance, b.covariance, atol=tolerance)


@cache
def at_hand_over() -> tuple[WanderFilter, int]:
    """A filter with two azimuth states that are about to become one."""
    filter_ = make_filter(1.0)
    limit = FINE_VARIANCE * math.cos(filter_.navigation.latitude) ** 2
    for second in range(170):
        run_filter(filter_, second, second + 1)
        if filter_.P[AZIMUTH, AZIMUTH].trace() < 2.0 * limit or filter_.one_azimuth:
            return filter_, second + 1
    raise AssertionError("no hand-over")


def test_covariance_stays_one() -> None:
    """Symmetric and positive, as a correlation, in both models."""
    filter_ = make_filter(1.0)
    models = set()
    for second in range(170):
        run_filter(filter_, second, second + 1)
        models.add(filter_.one_azimuth)
        P = filter_.P
        if filter_.one_azimuth:
            assert not P[AZIMUTH.stop - 1].any()
            P = np.delete(np.delete(P, AZIMUTH.stop - 1, 0), AZIMUTH.stop - 1, 1)
        sigma = np.sqrt(P.diagonal())
        correlation = P / np.outer(sigma, sigma)
        np.testing.assert_allclose(correlation, correlation.T, rtol=0.0, atol=1e-12)
        assert np.linalg.eigvalsh(correlation).min() > -1e-9
        given = knowledge_of(filter_).covariance
        assert np.linalg.eigvalsh(given).min() > 0.0
    assert models == {False, True}


def test_hand_over_leaves_what_is_given_out() -> None:
    """Attitude and its covariance before and after, from the very same filter."""
    filter_, _ = at_hand_over()
    assert not filter_.one_azimuth
    before, biases = knowledge_of(filter_), filter_.sensors.gyro_bias.copy()
    filter_._hand_over()
    assert filter_.one_azimuth
    after = knowledge_of(filter_)
    off = Rotation.from_matrix(before.C_nb @ after.C_nb.T).magnitude()
    assert off < 1e-9
    scale = np.sqrt(before.covariance.diagonal())
    scale = np.outer(scale, scale)
    np.testing.assert_allclose(after.covariance / scale, before.covariance / scale, atol=1e-6)
    assert np.abs(filter_.sensors.gyro_bias - biases).max() < FOG.gyro_bias


def test_covariance_of_the_attitude_is_that_of_its_errors() -> None:
    """Errors drawn from P, taken off the truth, through `attitude`: what scatters is given."""
    rng = np.random.default_rng(2)
    root = rng.normal(size=(SIZE, SIZE))
    for one_azimuth in (True, False):
        filter_ = WanderFilter(
            true_navigation(0.0, 0.9),
            OdometerModel(config()),
            FOG,
            1.0,
            1.0,
            1.0 if one_azimuth else None,
        )
        P = root @ root.T
        sigma = np.full(SIZE, 1e-3)
        P *= np.outer(sigma, sigma) / SIZE
        if one_azimuth:
            P[AZIMUTH.start + 1, :] = P[:, AZIMUTH.start + 1] = 0.0
        filter_.P = P
        truth = filter_.navigation
        C_true, e_true = truth.C_ab.copy(), truth.e_a.copy()
        C_n = about_up(0.9) @ C_true
        expected = knowledge_of(filter_).covariance
        errors = []
        for e in rng.multivariate_normal(np.zeros(SIZE), P, size=3000):
            truth.C_ab = small_turn(e[PHI]) @ C_true
            if one_azimuth:
                truth.e_a = about_up(-e[AZIMUTH.start]) @ e_true
            else:
                truth.e_a = e_true + np.array([*e[AZIMUTH], 0.0])
            estimate = knowledge_of(filter_).C_nb
            errors.append(-Rotation.from_matrix(estimate @ C_n.T).as_rotvec())
        size = np.sqrt(expected.diagonal())
        size = np.outer(size, size)
        # 3000 of them: 0.026 is the sigma of a variance.
        np.testing.assert_allclose(np.cov(np.transpose(errors)) / size, expected / size, atol=0.12)


def test_without_odometer_errors_grow() -> None:
    filter_ = make_filter(0.5)
    run_filter(filter_, 0, 30)
    sigma = np.sqrt(filter_.P.diagonal())
    silent = epoch_at(30.0)._replace(travel=None)
    assert not filter_.process(silent, Standing.NO)
    assert np.all(np.sqrt(filter_.P.diagonal())[VELOCITY] > sigma[VELOCITY])
    np.testing.assert_allclose(filter_.P, filter_.P.T, atol=1e-12)
