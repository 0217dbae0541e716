"""The quantum of an odometer that counts, found from its samples."""

from __future__ import annotations

import numpy as np
import pytest
from odometer_tracks import RNG, driven, given_speeds, speed_of, track_of, with_speed

from sins_align.odo.hampel import HAMPEL_M_S
from sins_align.odo.quantum import QuantumFinder, find_grid
from sins_align.odo.track import OdometerTrack
from sins_align.types import OdometerSamples


def find(samples: OdometerSamples) -> float:
    return track_of(samples, None).quantum


def counting(
    rate: float, quantum: float, kind: str, seed: int, duration: float = 0.0
) -> OdometerSamples:
    """kind: regular, timed (over the time that passed), nominal (stamps shake), coarse_values."""
    rng = RNG(seed)
    size = round(max(duration * rate, 700))
    t = np.arange(size) / rate
    if kind == "timed":
        t += rng.uniform(-0.3, 0.3, size) / rate
    true = 1.013 * driven(t)
    counted = quantum * np.floor(true / quantum + rng.random()) if quantum else true
    speed = np.diff(counted) / np.diff(t)
    if kind == "nominal":
        t += rng.normal(0.0, 0.05, size) / rate
    if kind == "rounded":
        speed = np.round(speed, 3)
    if kind == "single":
        speed = speed.astype(np.float32).astype(float)
    if kind == "outliers":
        wild = rng.random(size - 1) < 0.01
        speed[wild] = rng.uniform(-20.0, 40.0, np.count_nonzero(wild))
    if kind == "noisy":
        speed += rng.normal(0.0, 0.04 * quantum * rate, size - 1)
    return given_speeds(t[1:], speed)


@pytest.mark.parametrize(
    "kind", ["regular", "timed", "nominal", "rounded", "single", "outliers", "noisy"]
)
@pytest.mark.parametrize("quantum", [0.01, 0.02, 0.05, 0.3])
@pytest.mark.parametrize("rate", [1.0, 5.0, 20.0, 100.0])
def test_quantum_is_found(rate: float, quantum: float, kind: str) -> None:
    found = find(counting(rate, quantum, kind, seed=round(1000 * quantum)))
    if kind == "noisy" and rate == 1.0 and found == 0.0:
        return  # too few counts that differ by little: none is claimed
    assert found == pytest.approx(quantum, rel=0.02)


@pytest.mark.parametrize("noise", [0.0, 0.001, 0.02, 0.5])
@pytest.mark.parametrize("rate", [1.0, 5.0, 20.0, 100.0])
def test_no_quantum_is_invented(rate: float, noise: float) -> None:
    for seed in range(3):
        samples = counting(rate, 0.0, "regular", seed)
        shaken = samples.speed + RNG(seed).normal(0.0, noise, len(samples))
        assert find(with_speed(samples, shaken)) == 0.0


def test_no_quantum_from_a_vehicle_that_stands_or_keeps_its_speed() -> None:
    t = np.arange(0.0, 200.0, 0.05)
    assert find(given_speeds(t, np.zeros(t.shape[0]))) == 0.0
    assert find(given_speeds(t, np.full(t.shape[0], 7.0))) == 0.0


def test_no_quantum_from_steady_accelerations() -> None:
    t = np.arange(0.0, 200.0, 0.05)
    ramps = np.abs((t + 5.0) % 20.0 - 10.0)
    assert find(given_speeds(t, ramps)) == 0.0
    rng = RNG(5)
    wild = rng.random(t.shape[0]) < 0.03
    cruise = np.where(wild, rng.uniform(-20.0, 40.0, t.shape[0]), 5.0 + 0.1 * np.sin(t))
    assert find(given_speeds(t, cruise)) == 0.0


def test_speeds_of_a_cars_bus() -> None:
    """Whole kilometres an hour, once a second, whatever the stamps do."""
    t = np.arange(0.0, 300.0) + RNG(6).uniform(-0.1, 0.1, 300)
    kmh = np.round(speed_of(t) * 3.6)
    assert find(given_speeds(t, kmh / 3.6)) == pytest.approx(1.0 / 3.6, rel=0.02)


def test_a_quantum_too_coarse_is_mended() -> None:
    """Even counts first: twice the quantum explains them. Later the truth is seen."""
    t = np.arange(0.0, 200.0, 0.05)
    counts = np.round(20.0 + 6.0 * np.sin(0.9 * t) + 5.0 * np.sin(0.37 * t))
    early = np.where(np.arange(t.shape[0]) < 300, 2.0 * (counts // 2.0), counts)
    track = OdometerTrack()
    samples = given_speeds(t, early * 0.02 / 0.05)
    track.add(samples.select(slice(0, 300)))
    track.settle()
    assert track.quantum == pytest.approx(0.04)
    track.add(samples.select(slice(300, None)))
    track.settle()
    assert track.quantum == pytest.approx(0.02)


def test_a_given_quantum_is_kept() -> None:
    assert track_of(counting(20.0, 0.05, "regular", 1), 0.02).quantum == 0.02


def test_a_wheel_without_counts_gets_the_narrow_threshold() -> None:
    finder = QuantumFinder()
    assert finder.noise_quantum >= 0.1
    samples = counting(20.0, 0.0, "regular", 1)
    finder.add(samples.speed[:64], np.full(64, 0.05))
    assert finder.noise_quantum >= 0.1
    finder.add(samples.speed[64:256], np.full(192, 0.05))
    assert finder.noise_quantum / 0.05 * 3.1 < HAMPEL_M_S


def test_grid_of_nothing() -> None:
    assert find_grid(np.zeros(50)) == 0.0
    assert find_grid(np.ones(50)) == 0.0
