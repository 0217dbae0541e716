"""The odometer: what it counts, and that each fault does what it says."""

import dataclasses
import math

import numpy as np
import pytest

from sins_align.simulate import VehicleOptions, VehicleRun, simulate_vehicle
from sins_align.simulate.odometer import speed_variance
from sins_align.types import Array

PLAIN = VehicleOptions(
    scenario="urban",
    grade="perfect",
    seed=3,
    duration_s=200.0,
    rate_hz=2.0,
    odometer_scale_error=0.0,
)
INTERVAL_NS = 50_000_000
EXACT = {"odometer_quantum_m": 0.0}


def run(**changes: object) -> VehicleRun:
    return simulate_vehicle(dataclasses.replace(PLAIN, **changes))


def elapsed(drive: VehicleRun) -> Array:
    return (drive.odometer.stamp_ns - PLAIN.start_stamp_ns) * 1e-9


def true_mean(drive: VehicleRun, delay_s: float = 0.0) -> Array:
    """(N,) true mean speed over the interval of each sample that is `delay_s` late."""
    end = drive.odometer.stamp_ns - round(delay_s * 1e9)
    truth = drive.truth
    return (truth.distance_at(end) - truth.distance_at(end - INTERVAL_NS)) / 0.05


def test_mean_speed_of_the_interval() -> None:
    drive = run(**EXACT)
    np.testing.assert_allclose(drive.odometer.speed, true_mean(drive), atol=1e-6)
    assert drive.odometer.speed.max() > 8.0


def test_stamps() -> None:
    offsets = []
    for seed in range(6):
        stamp_ns = run(seed=seed, duration_s=10.0).odometer.stamp_ns
        assert stamp_ns.dtype == np.int64
        assert np.abs(np.diff(stamp_ns) - INTERVAL_NS).max() <= 1
        offsets.append(stamp_ns[0] - PLAIN.start_stamp_ns)
        assert INTERVAL_NS <= offsets[-1] < 2 * INTERVAL_NS
        assert 0 <= PLAIN.start_stamp_ns + 10_000_000_000 - stamp_ns[-1] < INTERVAL_NS
    assert len(set(offsets)) == 6


@pytest.mark.parametrize("quantum", [0.01, 0.3])
def test_counts_are_whole_and_add_up(quantum: float) -> None:
    drive = run(odometer_quantum_m=quantum, odometer_scale_error=0.02)
    counts = drive.odometer.speed * 0.05 / quantum
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
    stamps = drive.odometer.stamp_ns
    true = drive.truth.distance_at(stamps) - drive.truth.distance_at(int(stamps[0]) - INTERVAL_NS)
    error = np.cumsum(drive.odometer.speed) * 0.05 - 1.02 * true
    assert np.abs(error).max() <= quantum * (1.0 + 1e-6)
    assert np.abs(error).max() > 0.5 * quantum


def test_standing_reads_zero() -> None:
    drive = run()
    standing = (drive.truth.speed_at(drive.odometer.stamp_ns) == 0.0) & (
        drive.truth.speed_at(drive.odometer.stamp_ns - INTERVAL_NS) == 0.0
    )
    assert np.count_nonzero(standing) > 100
    assert not np.any(drive.odometer.speed[standing])
    assert not np.any(run(scenario="static").odometer.speed)


def test_scale_error_is_random_unless_given() -> None:
    errors = [
        run(seed=seed, duration_s=1.0, odometer_scale_error=None).truth.odometer_scale_error
        for seed in range(40)
    ]
    # The sigma of the sigma of 40 is 11 %.
    assert np.std(errors) == pytest.approx(0.01, rel=0.4)
    drive = run(odometer_scale_error=None, **EXACT)
    scale = 1.0 + drive.truth.odometer_scale_error
    np.testing.assert_allclose(drive.odometer.speed, scale * true_mean(drive), atol=1e-6)


def test_scale_step() -> None:
    drive = run(scale_step=(100.0, 0.02), odometer_scale_error=0.01, **EXACT)
    t = elapsed(drive)
    # At 40 m/s^3 at most the interval around the step is between the two.
    before, after = t <= 100.0, t > 100.05
    mean = true_mean(drive)
    np.testing.assert_allclose(drive.odometer.speed[before], 1.01 * mean[before], atol=1e-6)
    np.testing.assert_allclose(drive.odometer.speed[after], 1.01 * 1.02 * mean[after], atol=1e-6)


@pytest.mark.parametrize("latency", [0.13, -0.2])
def test_latency(latency: float) -> None:
    drive = run(odometer_latency_s=latency, **EXACT)
    np.testing.assert_array_equal(drive.odometer.stamp_ns, run().odometer.stamp_ns)
    np.testing.assert_allclose(drive.odometer.speed, true_mean(drive, latency), atol=1e-6)
    assert drive.truth.odometer_latency_s == latency


def test_clock_drift() -> None:
    plain, drive = run(), run(odometer_clock_drift=1e-4)
    late_s = (drive.odometer.stamp_ns - plain.odometer.stamp_ns) * 1e-9
    np.testing.assert_allclose(late_s, 1e-4 * elapsed(plain), atol=2e-9)
    np.testing.assert_array_equal(drive.odometer.speed, plain.odometer.speed)


def test_jitter() -> None:
    plain, drive = run(), run(odometer_jitter_s=2e-3)
    error_s = (drive.odometer.stamp_ns - plain.odometer.stamp_ns) * 1e-9
    assert error_s.std() == pytest.approx(2e-3, rel=0.1)
    np.testing.assert_array_equal(drive.odometer.speed, plain.odometer.speed)
    assert np.diff(run(odometer_jitter_s=1.0).odometer.stamp_ns).min() > 0


def test_noise_and_its_variance() -> None:
    # A scale that makes no round number of counts of the speeds that are kept for long.
    drive = run(odometer_noise_m_s=0.05, odometer_report_variance=True, duration_s=600.0,
                odometer_scale_error=0.0137)  # fmt: skip
    moving = np.abs(true_mean(drive)) > 0.5
    error = (drive.odometer.speed - 1.0137 * true_mean(drive))[moving]
    assert np.mean(error**2) == pytest.approx(speed_variance(drive.options), rel=0.1)
    np.testing.assert_array_equal(drive.odometer.variance, speed_variance(drive.options))
    assert speed_variance(PLAIN) == pytest.approx(2.0 * (0.01 / math.sqrt(12.0) * 20.0) ** 2)
    assert not np.any(run().odometer.variance)


def test_slip() -> None:
    drive = run(scenario="straight", duration_s=600.0, slip_count=5, **EXACT)
    ratio = drive.odometer.speed / np.where(true_mean(drive) > 1.0, true_mean(drive), np.nan)
    slipping = np.abs(ratio - 1.5) < 1e-6
    clean = np.abs(ratio - 1.0) < 1e-6
    # Five events of 2 s, of which the first and the last interval are partly covered.
    assert np.count_nonzero(slipping) == pytest.approx(5 * 39, abs=2)
    assert np.count_nonzero(~slipping & ~clean & np.isfinite(ratio)) <= 10
    shorter = run(scenario="straight", duration_s=600.0, slip_count=5, slip_duration_s=1.0,
                  slip_fraction=0.2, **EXACT)  # fmt: skip
    extra = np.sum(shorter.odometer.speed - true_mean(shorter)) * 0.05
    assert extra == pytest.approx(5 * 1.0 * 0.2 * 15.0, rel=0.2)


def test_dropouts() -> None:
    whole, holed = run(), run(dropouts=((50.0, 10.0), (120.0, 0.5)))
    t = elapsed(whole)
    kept = ~(((t >= 50.0) & (t < 60.0)) | ((t >= 120.0) & (t < 120.5)))
    assert np.count_nonzero(~kept) == 210
    for x, y in zip(whole.odometer.select(kept), holed.odometer, strict=True):
        np.testing.assert_array_equal(x, y)


def test_stuck() -> None:
    plain, drive = run(), run(stuck=((50.0, 30.0),))
    t = elapsed(drive)
    during = (t >= 50.0) & (t < 80.0)
    assert np.any(plain.odometer.speed[during])
    assert not np.any(drive.odometer.speed[during])
    np.testing.assert_array_equal(drive.odometer.speed[~during], plain.odometer.speed[~during])


def test_outliers() -> None:
    plain, drive = run(duration_s=600.0), run(duration_s=600.0, outlier_fraction=0.02)
    changed = drive.odometer.speed != plain.odometer.speed
    assert np.mean(changed) == pytest.approx(0.02, rel=0.3)
    wild = drive.odometer.speed[changed]
    assert wild.min() > -20.0 and wild.max() < 40.0
    assert np.ptp(wild) > 50.0


def test_unsigned_wheel() -> None:
    signed = run(scenario="reverse", **EXACT)
    unsigned = run(scenario="reverse", unsigned_wheel=True, **EXACT)
    assert signed.odometer.speed.min() < -2.0
    np.testing.assert_allclose(unsigned.odometer.speed, np.abs(signed.odometer.speed), atol=1e-9)


def test_faults_leave_the_other_numbers_alone() -> None:
    """A slip, an outlier or a stuck spell changes nothing but the samples that it hits."""
    noisy = {"odometer_noise_m_s": 0.1, "odometer_jitter_s": 1e-3, **EXACT}
    plain = run(**noisy).odometer
    faulty = run(**noisy, slip_count=2, outlier_fraction=0.01, stuck=((30.0, 5.0),)).odometer
    np.testing.assert_array_equal(plain.stamp_ns, faulty.stamp_ns)
    same = np.isclose(plain.speed, faulty.speed, atol=1e-9)
    assert np.mean(~same) < 0.08


def test_a_run_shorter_than_an_interval() -> None:
    assert len(run(duration_s=1.0, odometer_rate_hz=0.1).odometer) == 0
