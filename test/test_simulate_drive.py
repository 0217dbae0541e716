"""The drive within a swing: against numerical differentiation, its road, and its random numbers."""

import dataclasses
import math

import numpy as np
import pytest
from motion_differences import (
    BUSY,
    DRIVE,
    FIRST,
    FORCE_TOLERANCE,
    SECOND,
    base_of,
    differentiate,
    earth_turn,
    inertial_position,
    stencil,
)

from sins_align.simulate import SwingOptions, SwingRun, simulate_swing
from sins_align.simulate.drive import RoadShake
from sins_align.simulate.geodesy import EARTH_RATE
from sins_align.types import ImuSamples

DEG = math.pi / 180.0
SHORT = SwingOptions(duration_s=20.0, grade="fog", seed=5)
BEGIN = SHORT.start_stamp_ns


def run(**changes: object) -> SwingRun:
    return simulate_swing(dataclasses.replace(SHORT, **changes))


def assert_same(a: ImuSamples, b: ImuSamples) -> None:
    for x, y in zip(a, b, strict=True):
        np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize("scenario", ["pitch", "still"])
def test_specific_force_in_the_drive_is_inertial_acceleration(scenario: str) -> None:
    base = base_of(dataclasses.replace(BUSY, scenario=scenario, **DRIVE))
    t = np.array([20.5, 33.0, 35.7, 39.0, 41.0, 45.3, 47.0, 50.0])  # two of them at rest
    acceleration_i = differentiate(inertial_position(base, stencil(t)), SECOND, 2)
    acceleration_n = np.einsum("nji,jn->in", earth_turn(base, t), acceleration_i)
    acceleration_n[2] += base.gravity
    f_expected = np.einsum("jin,jn->in", base.attitude(t).C_nb, acceleration_n)
    # Positions of 100 m are rounded to 1.4e-14 m.
    np.testing.assert_allclose(base.sense(t)[1], f_expected, rtol=0, atol=100 * FORCE_TOLERANCE)


def test_drive_moves_the_centre_as_told_and_nothing_else() -> None:
    plain, driving = base_of(BUSY), base_of(dataclasses.replace(BUSY, **DRIVE))
    t = np.array([0.0, 32.0, 40.003, 48.003, 60.0])
    moved = driving.centre_position(t) - plain.centre_position(t)
    forward = np.array([math.sin(70.0 * DEG), math.cos(70.0 * DEG), 0.0])
    np.testing.assert_allclose(
        moved, np.outer(forward, [0.0, 0.0, 50.0, 100.0, 100.0]), rtol=0, atol=1e-11
    )
    np.testing.assert_array_equal(driving.attitude(t).C_nb, plain.attitude(t).C_nb)
    # Standing where it came to, it feels what it would feel where it started, but for the
    # centrifugal acceleration.
    far = EARTH_RATE**2 * 100.0
    for driven, stood in zip(driving.sense(t[-1:]), plain.sense(t[-1:]), strict=True):
        np.testing.assert_allclose(driven, stood, rtol=0, atol=far)


def test_shake_differentiates_and_stops_with_the_drive() -> None:
    base = base_of(dataclasses.replace(BUSY, **DRIVE, drive_shake_m_s2=0.5))
    shakes = [motion for motion in base.centre if isinstance(motion.displacement, RoadShake)]
    np.testing.assert_allclose(
        [motion.direction_n for motion in shakes],
        [[0.0, 0.0, 1.0], [math.cos(70.0 * DEG), -math.sin(70.0 * DEG), 0.0]],
        atol=1e-15,
    )
    # In the rise, the middle and the fall. As `STEP`, but for 12 Hz: the differences are wrong
    # by (12 Hz step)^8 / 630 of the derivative, 2e-12, and by the rounding of 75 rad/s t.
    step = 1e-3
    t = np.array([33.0, 35.2, 40.0, 44.9, 47.5])
    around = (t + step * np.arange(-4, 5)[:, np.newaxis]).ravel()
    for shake in (motion.displacement for motion in shakes):
        _, velocity, acceleration = shake(t)
        position, speed, _ = (row.reshape(9, -1) for row in shake(around))
        np.testing.assert_allclose(velocity, FIRST @ position / step, rtol=0, atol=1e-12)
        np.testing.assert_allclose(acceleration, FIRST @ speed / step, rtol=0, atol=1e-11)
        for row in shake(np.array([0.0, 32.003, 48.003, 60.0])):
            np.testing.assert_array_equal(row, 0.0)


def test_shake_is_as_strong_as_told() -> None:
    base = base_of(dataclasses.replace(BUSY, duration_s=400.0, drive_m=1.0, drive_start_s=0.0,
                                       drive_duration_s=400.0, drive_shake_m_s2=0.5))  # fmt: skip
    middle = np.arange(100.0, 300.0, 0.01)
    _, *shakes = base.centre[-3:]
    rows = [shake.displacement(middle)[2] for shake in shakes]
    # 12 frequencies, at least some 1 Hz apart, over 200 s: the beats average out to 1 %.
    np.testing.assert_allclose(np.std(rows, axis=1), 0.5, rtol=0.02)
    assert abs(np.corrcoef(rows)[0, 1]) < 0.1


def test_mean_sampling_is_the_mean_in_the_drive() -> None:
    options = dataclasses.replace(
        BUSY, **DRIVE, drive_shake_m_s2=0.5, rate_hz=100.0, duration_s=50.0, sampling="mean"
    )
    imu, base = simulate_swing(options).imu, base_of(options)
    # In the drive, and the intervals within which it begins and ends: there it is no polynomial.
    for sample, tolerance in ((3500, 1e-9), (4321, 1e-9), (3201, 3e-8), (4801, 3e-8)):
        # Midpoint rule on 1 us: error 1e-6^2 / 24 of a second derivative of some 1e4 m/s^4.
        t = sample * 0.01 - 0.01 + 1e-6 * (np.arange(10_000) + 0.5)
        _, f = base.sense(t)
        np.testing.assert_allclose(imu.f_ib_b[:, sample], f.mean(axis=1), rtol=0, atol=tolerance)


@pytest.mark.parametrize("start", [5.0, 99.0])
def test_without_a_drive_nothing_changes(start: float) -> None:
    """Also where the other options of a drive are set, be it out of place."""
    options = {"drive_start_s": start, "drive_azimuth_deg": 30.0, "drive_shake_m_s2": 0.3}
    plain, not_driving = run(), run(**options)
    assert_same(not_driving.imu, plain.imu)
    assert not_driving.truth.truth_dict() == plain.truth.truth_dict()


@pytest.mark.parametrize("sampling", ["instantaneous", "mean"])
def test_a_drive_changes_no_sample_before_it(sampling: str) -> None:
    drive = {"drive_m": 50.0, "drive_duration_s": 5.0, "drive_shake_m_s2": 0.3}
    plain, driving = run(sampling=sampling).imu, run(sampling=sampling, **drive).imu
    before = plain.stamp_ns <= BEGIN + 7_500_000_000
    assert_same(driving.select(before), plain.select(before))
    np.testing.assert_array_equal(driving.w_ib_b, plain.w_ib_b)
    change = np.abs(driving.f_ib_b - plain.f_ib_b).max(axis=0)
    assert change[~before].max() > 7.5 * 50.0 / 5.0**2 / math.sqrt(3.0)
    # Afterwards the centrifugal acceleration is another.
    assert change[plain.stamp_ns >= BEGIN + 12_505_000_000].max() < 1e-6


def test_the_shake_is_random_by_itself() -> None:
    drive = {"drive_m": 50.0, "drive_duration_s": 10.0}
    smooth, one, other = (
        run(
            grade="perfect", seed=seed, scenario="still", **drive, drive_shake_m_s2=shake
        ).imu.f_ib_b
        for seed, shake in ((5, 0.0), (5, 0.3), (6, 0.3))
    )
    middle = slice(1500, 2500)
    shakes = [(f - smooth)[:, middle] for f in (one, other)]
    for x in shakes:  # heading north: x is along the drive
        assert x[0].std() < 1e-4
        np.testing.assert_allclose(x[1:].std(axis=1), 0.3, rtol=0.2)
    assert np.abs(shakes[0] - shakes[1]).max() > 0.3


def test_truth_says_when_it_drove() -> None:
    assert run().truth.truth_dict()["drive_stamp_ns"] is None
    told = run(drive_m=9.0, drive_start_s=4.5, drive_duration_s=8.0).truth
    assert told.truth_dict()["drive_stamp_ns"] == [BEGIN + 4_500_000_000, BEGIN + 12_500_000_000]
    middle = run(drive_m=9.0, drive_duration_s=8.0).truth
    assert middle.truth_dict()["drive_stamp_ns"] == [BEGIN + 6 * 10**9, BEGIN + 14 * 10**9]


@pytest.mark.parametrize("start", [-1.0, 20.0, math.nan])
def test_drive_outside_the_run_is_refused(start: float) -> None:
    with pytest.raises(ValueError, match="drive_start_s"):
        run(drive_m=10.0, drive_start_s=start)


def test_drive_longer_than_the_run_has_no_middle() -> None:
    with pytest.raises(ValueError, match="drive_start_s"):
        run(drive_m=10.0, drive_duration_s=21.0)
