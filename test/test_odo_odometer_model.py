"""The odometer's measurement against a vehicle and an odometer moved about by hand.

The reference is the definition: where the odometer's point goes, by fine steps of a kinematic
vehicle, and what a faulty odometer counts on the way.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.spatial.transform import Rotation

from sins_align.config import OdometerConfig, odo_config
from sins_align.odo.epoch import AidedEpoch, integrate_epoch
from sins_align.odo.odometer_model import (
    COUNT,
    DIRECTION,
    DIRECTION_TIME_S,
    GRADIENT,
    LATENCY,
    LEVER,
    MOUNTING,
    POSITION,
    SCALE,
    Displacement,
    OdometerModel,
)
from sins_align.odo.pairing import Paired
from sins_align.types import Array, ImuBlock, ImuSampling

DURATION, RATE_HZ = 1.0, 200
FINE = 2000  # steps of the reference
MILLIMETRE = 1e-3
DEGREE = math.radians(1.0)
# ODO.md: every block to 2e-3 of its size.
BLOCK_TOLERANCE = 2e-3

C_START = Rotation.from_euler("ZYX", [1.1, -0.05, 0.02]).as_matrix()
# Of the frame: as if it turned 50 times as fast as at 20 m/s, to be seen at all.
W_IA = np.array([1e-4, -2e-4, 5e-5])


def config(**parameters: object) -> OdometerConfig:
    return odo_config(
        {
            "odometer_lever_arm_m": [0.5, -0.3, 0.8],
            "mounting_rpy_deg": [1.0, -2.0, 30.0],
            "odometer_quantum_m": 0.02,
            **parameters,
        }
    ).odometer


class Drive(NamedTuple):
    """A second of driving; the rates grow linearly. Negative speed: reverse."""

    speed: float
    acceleration: float
    turn: float
    growth: float

    def distance_at(self, t: Array) -> Array:
        return self.speed * t + 0.5 * self.acceleration * t**2

    def speed_at(self, t: Array) -> Array:
        return self.speed + self.acceleration * t

    def w_b(self, t: Array) -> Array:
        return np.stack((0.01 + 0.0 * t, -0.02 * np.cos(2.0 * t), self.turn + self.growth * t))

    def C_at(self, t: Array) -> Array:
        """(N, 3, 3) b at t (N,), uniform, to b at 0, by small rotations at their middles."""
        dt = t[1] - t[0]
        turns = Rotation.from_rotvec(dt * self.w_b(t[:-1] + 0.5 * dt).T).as_matrix()
        C = [np.eye(3)]
        for turn in turns:
            C.append(C[-1] @ turn)
        return np.stack(C)


DRIVES = {
    "turning": Drive(12.0, 1.0, 0.2, 0.03),
    "braking": Drive(20.0, -2.0, -0.1, 0.02),
    "reverse": Drive(-3.0, -0.5, 0.3, 0.0),
}


def epoch_of(drive: Drive, latency: float = 0.0, variance: float = 0.0) -> AidedEpoch:
    """As the filter sees it, the odometer being read `latency` later than the IMU."""
    t = np.arange(round(DURATION * RATE_HZ) + 1) / RATE_HZ
    block = ImuBlock(np.rint(t * 1e9).astype(np.int64), drive.w_b(t), 9.8 + 0.0 * drive.w_b(t))
    distance, speed = drive.distance_at(t + latency), drive.speed_at(t + latency)
    return integrate_epoch(Paired(block, distance, speed, variance), ImuSampling.INSTANTANEOUS)


def frame(t: Array) -> Array:
    """(N, 3, 3) the navigation frame at 0 to that at t."""
    return Rotation.from_rotvec(-np.outer(t, W_IA)).as_matrix()


def direction(model: OdometerModel, x: Array, drive: Drive) -> Array:
    """(3,) of travel in b, by what the states say it is."""
    turned = simpson(drive.w_b(np.linspace(0.0, 1.0, 201)), dx=1.0 / 200)
    lateral = float(model.C_bm[:, 2] @ turned) * drive.distance_at(np.array(1.0))
    slopes = x[MOUNTING] + x[DIRECTION] + x[GRADIENT] * [lateral, drive.acceleration]
    f = np.array([1.0, *slopes])
    return model.C_bm @ (f / np.linalg.norm(f))


def counted(model: OdometerModel, x: Array, drive: Drive) -> Array:
    """(3,) displacement that the odometer tells of, in the navigation frame as it turns."""
    t = np.linspace(0.0, DURATION, FINE + 1)
    C = frame(t) @ C_START @ drive.C_at(t)
    along = C @ direction(model, x, drive)
    return simpson(along.T * drive.speed_at(t + x[LATENCY]), dx=t[1]) / (1.0 + x[SCALE])


def residual(model: OdometerModel, x: Array, drive: Drive) -> Array:
    """(3,) without any path: lever arm minus odometer."""
    t = np.linspace(0.0, DURATION, FINE + 1)
    C_end = frame(t[-1:])[0] @ C_START @ drive.C_at(t)[-1]
    return (C_end - C_START) @ x[LEVER] - counted(model, x, drive)


def measure(model: OdometerModel, x: Array, drive: Drive, standing: bool = False) -> Displacement:
    model.x = x.copy()
    C_end = frame(np.array([DURATION]))[0] @ C_START @ epoch_of(drive).C_end
    epoch = epoch_of(drive, float(x[LATENCY]))
    return model.measure(epoch, C_START, C_end, np.zeros(3), W_IA * DURATION, standing)


def state(model: OdometerModel, slope: float = 0.0) -> Array:
    x = model.x.copy()
    x[SCALE], x[LATENCY] = -0.013, 0.12
    x[MOUNTING], x[DIRECTION] = (slope, -0.7 * slope), (-0.3 * slope, 0.5 * slope)
    x[GRADIENT] = 0.3 * slope, -0.2 * slope
    return x


@pytest.mark.parametrize("drive", DRIVES.values(), ids=list(DRIVES))
def test_residual(drive: Drive) -> None:
    """A tenth of a millimetre on 20 m; sin for the angle turned is most of what is left."""
    model = OdometerModel(config())
    x = state(model, DEGREE)
    np.testing.assert_allclose(
        measure(model, x, drive).residual, residual(model, x, drive), atol=3.0 * MILLIMETRE
    )
    x[GRADIENT] = 0.0
    np.testing.assert_allclose(
        measure(model, x, drive).residual, residual(model, x, drive), atol=0.1 * MILLIMETRE
    )


STEPS = np.full(COUNT, 1e-4)
STEPS[LATENCY] = 1e-2
STEPS[LEVER] = 0.1
COLUMNS = {
    "scale": [SCALE],
    "latency": [LATENCY],
    "lever": list(range(LEVER.start, LEVER.stop)),
    "mounting": list(range(MOUNTING.start, MOUNTING.stop)),
    "direction": list(range(DIRECTION.start, DIRECTION.stop)),
    "gradient": list(range(GRADIENT.start, GRADIENT.stop)),
}


def numeric(function: Callable[[Array], Array], x: Array, index: list[int]) -> Array:
    columns = []
    for k in index:
        step = np.zeros(COUNT)
        step[k] = STEPS[k]
        columns.append((function(x + step) - function(x - step)) / (2.0 * STEPS[k]))
    return np.stack(columns, axis=1)


def relative(block: Array, reference: Array) -> float:
    return float(np.linalg.norm(block - reference) / np.linalg.norm(reference))


# The mean lateral acceleration is that of the mean speed and the angle turned, its sine.
GRADIENT_TOLERANCE = 2e-2


@pytest.mark.parametrize("drive", DRIVES.values(), ids=list(DRIVES))
@pytest.mark.parametrize("column", COLUMNS)
def test_column(drive: Drive, column: str) -> None:
    """About a straight mounting."""
    model = OdometerModel(config())
    x, index = state(model), COLUMNS[column]
    reference = numeric(lambda y: residual(model, y, drive), x, index)
    H = measure(model, x, drive).H[:, index]
    tolerance = GRADIENT_TOLERANCE if column == "gradient" else BLOCK_TOLERANCE
    assert relative(H, reference) < tolerance


@pytest.mark.parametrize("drive", DRIVES.values(), ids=list(DRIVES))
@pytest.mark.parametrize("column", COLUMNS)
def test_column_about_a_crooked_mounting(drive: Drive, column: str) -> None:
    """As crooked as one sigma of what is not known."""
    model = OdometerModel(config())
    x, index = state(model, DEGREE), COLUMNS[column]
    reference = numeric(lambda y: residual(model, y, drive), x, index)
    H = measure(model, x, drive).H[:, index]
    tolerance = GRADIENT_TOLERANCE if column == "gradient" else BLOCK_TOLERANCE
    assert relative(H, reference) < tolerance


@pytest.mark.parametrize("drive", DRIVES.values(), ids=list(DRIVES))
def test_arm(drive: Drive) -> None:
    """A misalignment at both ends: residual = - phi x arm."""
    model = OdometerModel(config())
    x = state(model)
    arm = measure(model, x, drive).arm
    np.testing.assert_allclose(arm, residual(model, x, drive), atol=0.1 * MILLIMETRE)
    epoch = epoch_of(drive, float(x[LATENCY]))
    C_end = frame(np.array([DURATION]))[0] @ C_START @ epoch.C_end
    for axis in np.eye(3):
        ends = []
        for sign in (1.0, -1.0):
            turn = Rotation.from_rotvec(-sign * 1e-4 * axis).as_matrix()
            seen = model.measure(
                epoch, turn @ C_START, turn @ C_end, np.zeros(3), W_IA * DURATION, False
            )
            ends.append(seen.residual)
        reference = (ends[0] - ends[1]) / 2e-4
        np.testing.assert_allclose(-np.cross(axis, arm), reference, atol=BLOCK_TOLERANCE)


def test_path_is_taken_as_it_is() -> None:
    model = OdometerModel(config())
    drive, path = DRIVES["turning"], np.array([1.0, 2.0, 3.0])
    epoch = epoch_of(drive)
    ends = C_START, C_START @ epoch.C_end
    with_path = model.measure(epoch, *ends, path, np.zeros(3), False).residual
    without = model.measure(epoch, *ends, np.zeros(3), np.zeros(3), False).residual
    np.testing.assert_allclose(with_path - without, path, atol=1e-12)


def test_standing_vehicle_goes_nowhere() -> None:
    """The path and the lever arm are all there is; nothing is learnt of the odometer."""
    model = OdometerModel(config())
    seen = measure(model, state(model), DRIVES["turning"], standing=True)
    others = np.delete(seen.H, np.r_[LEVER], axis=1)
    assert not others.any()
    np.testing.assert_allclose(seen.arm, seen.H[:, LEVER] @ model.x[LEVER])


def test_noise_grows_with_distance_and_keeps_to_its_axes() -> None:
    values = config(odometer_noise_m=[0.01, 0.02, 0.03], odometer_noise_per_m=[0.001, 0.002, 0.0])
    model = OdometerModel(values)
    straight = Drive(-10.0, 0.0, 0.0, 0.0)
    epoch = epoch_of(straight, variance=4e-4)
    R = model.measure(epoch, C_START, C_START, np.zeros(3), np.zeros(3), False).R
    C = C_START @ model.C_bm
    sigma = np.array([0.01 + 0.01, 0.02 + 0.02, 0.03])
    expected = np.diag(sigma**2 + [4e-4, 0.0, 0.0])
    # The vehicle still pitches by 1 deg.
    np.testing.assert_allclose(C.T @ R @ C, expected, atol=0.03 * expected.max())


def test_states_from_one_epoch_to_the_next() -> None:
    values = config(odometer_direction_sigma_deg=0.1)
    model = OdometerModel(values)
    model.x = np.arange(1.0, COUNT + 1.0)
    before = model.x.copy()
    factor, variance = model.advance(0.9)
    np.testing.assert_allclose(model.x, factor * before)
    decay = np.exp(-0.9 / DIRECTION_TIME_S)
    np.testing.assert_allclose(factor[DIRECTION], decay)
    # In the long run the direction has its sigma.
    steady = variance[DIRECTION] / (1.0 - factor[DIRECTION] ** 2)
    np.testing.assert_allclose(steady, (0.1 * DEGREE) ** 2)
    assert not factor[POSITION].any()
    kept = np.delete(factor, np.r_[DIRECTION, POSITION])
    assert np.all(kept == 1.0)
    assert variance[SCALE] == pytest.approx(0.9 * values.scale_walk**2)
    assert variance[LATENCY] == pytest.approx(0.9 * values.latency_walk**2)
    assert not variance[LEVER].any() and not variance[POSITION].any()


def test_prior() -> None:
    values = config()
    model = OdometerModel(values)
    variance = model.prior_variance()
    assert variance[SCALE] == pytest.approx(values.scale_sigma**2)
    assert variance[LATENCY] == pytest.approx(values.latency_sigma**2)
    np.testing.assert_allclose(variance[LEVER], values.lever_arm_sigma**2)
    np.testing.assert_allclose(variance[MOUNTING], values.mounting_sigma**2)
    np.testing.assert_allclose(variance[DIRECTION], values.direction_sigma**2)
    assert np.all(variance > 0.0)
    np.testing.assert_allclose(model.x[LEVER], values.lever_arm)


def test_estimate_in_terms_of_the_interface() -> None:
    """The vehicle travels along C_bm (1, 0, 0), the measured distance is (1 + K) of the true."""
    model = OdometerModel(config(odometer_latency_s=0.05))
    model.x[SCALE], model.x[LATENCY] = 0.02, 0.03
    model.x[MOUNTING] = 0.01, -0.02  # to the left, and down
    rng = np.random.default_rng(3)
    root = rng.normal(size=(COUNT, COUNT))
    covariance = 1e-6 * root @ root.T
    found = model.estimate(np.zeros(COUNT), covariance)
    assert found.scale_error == 0.02
    assert found.scale_sigma == pytest.approx(math.sqrt(covariance[SCALE, SCALE]))
    assert found.latency_s == pytest.approx(0.08)
    assert found.latency_sigma_s == pytest.approx(math.sqrt(covariance[LATENCY, LATENCY]))
    np.testing.assert_array_equal(found.lever_arm_b, model.x[LEVER])
    np.testing.assert_array_equal(found.lever_arm_covariance, covariance[LEVER, LEVER])

    def travel(tangents: Array) -> Array:
        f = np.array([1.0, *tangents])
        return model.C_bm @ (f / np.linalg.norm(f))

    roll, pitch, yaw = found.mounting_rpy
    C_bm = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    np.testing.assert_allclose(C_bm[:, 0], travel(model.x[MOUNTING]), atol=1e-5)
    # The covariance is that of the small rotations that move the direction.
    samples = rng.multivariate_normal(
        np.zeros(2), covariance[MOUNTING, MOUNTING], size=5000, check_valid="raise"
    )
    f_0 = travel(np.zeros(2))
    turns = np.stack([np.cross(f_0, travel(sample)) for sample in samples])
    size = np.sqrt(covariance.diagonal()[MOUNTING]).max() ** 2
    np.testing.assert_allclose(np.cov(turns.T), found.mounting_covariance, atol=0.1 * size)


@pytest.mark.parametrize(("yaw", "pitch"), [(3.0, 0.0), (0.0, 3.0)])
def test_mounting_signs(yaw: float, pitch: float) -> None:
    """Tangents of a vehicle that is really mounted so: nose left is positive, nose up too."""
    model = OdometerModel(config(mounting_rpy_deg=[0.0, 0.0, 0.0]))
    true = Rotation.from_euler("ZYX", np.radians([yaw, pitch, 0.0])).as_matrix()[:, 0]
    model.x[MOUNTING] = true[1:] / true[0]
    found = model.estimate(np.zeros(COUNT), np.eye(COUNT)).mounting_rpy
    np.testing.assert_allclose(found, np.radians([0.0, pitch, yaw]), atol=1e-4)


def test_latency_sign() -> None:
    """Stamps that are late by 0.1 s: the IMU's time t is the odometer's t + 0.1 s."""
    model = OdometerModel(config())
    drive = DRIVES["turning"]
    x = model.x.copy()
    x[LATENCY] = 0.1
    late = measure(model, x, drive).residual
    model = OdometerModel(config())
    right = measure(model, model.x, drive)
    H = right.H[:, LATENCY]
    np.testing.assert_allclose(late - right.residual, 0.1 * H, atol=0.1 * MILLIMETRE)
