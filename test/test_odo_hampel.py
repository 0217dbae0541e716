"""Outliers among an odometer's samples: which are found, and what passes unchanged."""

from __future__ import annotations

import numpy as np
import pytest
from odometer_tracks import RNG, T0, driven, given_speeds, means, must_read, track_of, with_speed

from sins_align.odo.hampel import HAMPEL_LEAST, HAMPEL_M_S, HAMPEL_S, HAMPEL_SIDE, MEDIAN_STEPS
from sins_align.types import Array, OdometerSamples


def slow_hampel(t: Array, v: Array, quantum: float) -> Array:
    """The filter as it reads, sample by sample."""
    result = v.copy()
    for j in range(v.shape[0]):
        steps = np.sort(np.diff(t[max(j - MEDIAN_STEPS, 0) : j + 1]))
        if not steps.size:
            continue
        usual = steps[(steps.size - 1) // 2]
        if usual > 2.0 * HAMPEL_S / (HAMPEL_LEAST - 1):
            continue
        near = range(max(j - HAMPEL_SIDE, 0), min(j + HAMPEL_SIDE + 1, v.shape[0]))
        window = [v[k] for k in near if abs(t[k] - t[j]) <= HAMPEL_S]
        if len(window) < HAMPEL_LEAST:
            continue
        if abs(v[j] - np.median(window)) > max(HAMPEL_M_S, 3.1 * quantum / usual):
            result[j] = np.median(window)
    return result


@pytest.mark.parametrize("quantum", [0.0, 0.01, 0.2])
@pytest.mark.parametrize("rate", [4.0, 5.0, 12.0, 20.0, 50.0])
def test_the_filter_does_what_it_says(rate: float, quantum: float) -> None:
    for seed in range(4):
        rng = RNG(seed)
        t = np.cumsum(rng.uniform(0.8, 1.2, 300)) / rate
        t[200:] += 3.0
        samples = means(t)
        speed = samples.speed + rng.normal(0.0, 0.3, 299)
        outlier = rng.random(299) < 0.05
        speed[outlier] += rng.uniform(-10.0, 10.0, np.count_nonzero(outlier))
        samples = with_speed(samples, speed)
        track = track_of(samples, quantum)
        times = (samples.stamp_ns - samples.stamp_ns[0]) * 1e-9
        want = slow_hampel(times, speed, quantum)
        knots = track._knots
        got = knots[2, np.searchsorted(knots[0], times)]
        np.testing.assert_array_equal(got[1:], want[1:])
        assert track.replaced == np.count_nonzero(want[1:] != speed[1:]) + (want[0] != speed[0])


def test_one_outlier_in_a_hundred_is_found() -> None:
    rng = RNG(3)
    samples = means(np.arange(0.0, 600.0, 0.05))
    speed = samples.speed.copy()
    wild = rng.random(len(samples)) < 0.01
    speed[wild] = rng.uniform(-20.0, 40.0, np.count_nonzero(wild))
    track = track_of(with_speed(samples, speed))
    t = np.linspace(1.0, 599.0, 1000)
    S = must_read(track, t).distance - driven(t)
    assert np.ptp(S) < 0.2
    assert 0.9 * np.count_nonzero(wild) < track.replaced < 1.05 * np.count_nonzero(wild)


def test_a_clean_drive_passes_unchanged() -> None:
    t = np.arange(0.0, 60.0, 0.05)
    braking = 0.5 * (t + np.abs(t - 20.0)) - np.clip(t - 40.0, 0.0, None)  # 20 m/s^2 nowhere
    samples = given_speeds(t, 3.0 * braking)
    track = track_of(samples)
    assert track.replaced == 0


def test_stuck_at_zero_passes_unchanged() -> None:
    samples = means(np.arange(0.0, 90.0, 0.05))
    speed = samples.speed.copy()
    speed[600:1200] = 0.0
    track = track_of(with_speed(samples, speed))
    assert track.replaced == 0
    stretch = must_read(track, np.linspace(31.0, 59.0, 100))
    assert np.abs(stretch.speed).max() == 0.0
    assert np.ptp(stretch.distance) == 0.0


def test_counts_are_no_outliers() -> None:
    """At 100 Hz a count of 5 cm is 5 m/s: seldom counts must stay, or the scale is biased."""
    t = np.arange(0.0, 100.0, 0.01)
    stamps = T0 + np.rint(t * 1e9).astype(np.int64)
    counted = 0.05 * np.floor(1.3 * t / 0.05 + 0.3)
    speed = np.diff(counted) / 0.01
    samples = OdometerSamples(stamps[1:], speed, np.zeros(speed.shape[0]))
    for quantum in (None, 0.05):
        track = track_of(samples, quantum)
        assert track.replaced == 0
        assert track.quantum == pytest.approx(0.05)
        S = must_read(track, np.array([1.0, 99.0])).distance
        assert S[1] - S[0] == pytest.approx(1.3 * 98.0, abs=0.051)


def test_an_outlier_among_samples_that_are_too_slow_stays() -> None:
    samples = means(np.arange(0.0, 60.0))
    speed = samples.speed.copy()
    speed[30] += 30.0
    assert track_of(with_speed(samples, speed)).replaced == 0
