"""Epochs in a row: what a vibration leaves at the edges between them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sins_align.odo.epoch import AidedEpoch, as_measured, integrate_epoch
from sins_align.odo.pairing import Paired, Pairing
from sins_align.rotation import unskew3
from sins_align.types import ImuBlock, ImuSampling

SECONDS, RATE_HZ = 60, 20
AMPLITUDE = math.radians(0.15)  # of the road, rate about x
FORCE = 0.3  # [m/s^2]


def epochs(frequency_hz: float, sampling: ImuSampling, jitter_s: float = 0.0) -> list[AidedEpoch]:
    """A rocking about x, and a vibration along z, in blocks of a second."""
    omega, h = math.tau * frequency_hz, 1.0 / RATE_HZ
    t = h * np.arange(SECONDS * RATE_HZ + 1)
    t[1:-1] += jitter_s * np.random.default_rng(1).uniform(-1.0, 1.0, t.size - 2)
    values = np.zeros((6, t.size))
    if sampling is ImuSampling.MEAN:
        change = np.diff(np.sin(omega * t + 0.4), prepend=math.nan) / np.diff(t, prepend=math.nan)
        change[0] = 0.0
        values[0], values[5] = AMPLITUDE * change, FORCE / omega * change
    else:
        values[0] = AMPLITUDE * omega * np.cos(omega * t + 0.4)
        values[5] = FORCE * np.cos(omega * t + 0.4)
    stamp_ns = np.rint(1e9 * t).astype(np.int64)
    pairing, found = Pairing(None), []
    for k in range(0, t.size - 1, RATE_HZ):
        part = slice(k, k + RATE_HZ + 1)
        pairing.add_imu(ImuBlock(stamp_ns[part], values[:3, part], values[3:, part]))
        while (paired := pairing.next(0.0)) is not None:
            found.append(integrate_epoch(paired, sampling))
    assert len(found) == SECONDS
    return found


@pytest.mark.parametrize("frequency_hz", [1.0, 2.0, 2.013, 2.5])
def test_a_vibration_leaves_no_rate(frequency_hz: float) -> None:
    """Against the truth; of 2 Hz it was 3 deg/h, and a fibre gyro has 0.02."""
    found, ends = epochs(frequency_hz, ImuSampling.INSTANTANEOUS), np.arange(1.0, SECONDS + 1.0)
    omega = math.tau * frequency_hz
    wave = np.sin(omega * ends + 0.4) - math.sin(0.4)
    angle = np.cumsum([unskew3(epoch.C_end)[0] for epoch in found]) - AMPLITUDE * wave
    rate = np.polyfit(ends, angle, 1)[0]
    assert abs(math.degrees(rate) * 3600.0) < 0.02
    velocity = np.cumsum([epoch.u[2] for epoch in found]) - FORCE / omega * wave
    assert abs(np.polyfit(ends, velocity, 1)[0]) < 1e-5
    # Where the edge was mended the attitude is still one.
    for epoch in found:
        assert np.abs(epoch.C_end @ epoch.C_end.T - np.eye(3)).max() < 1e-14


def test_path_and_velocity_are_mended_alike() -> None:
    """Of a vibration along z alone: s is the double integral."""
    omega = math.tau * 2.0
    found = epochs(2.0, ImuSampling.INSTANTANEOUS)
    for k, epoch in enumerate(found[1:], start=1):
        v0, v1 = (FORCE / omega * math.sin(omega * t + 0.4) for t in (k, k + 1.0))
        p0, p1 = (-FORCE / omega**2 * math.cos(omega * t + 0.4) for t in (k, k + 1.0))
        assert epoch.u[2] == pytest.approx(v1 - v0, abs=1e-4)
        assert epoch.s[2] == pytest.approx(p1 - p0 - v0, abs=2e-4)


def test_means_and_uneven_stamps_are_left_alone() -> None:
    for found in (
        epochs(2.0, ImuSampling.MEAN),
        epochs(2.0, ImuSampling.INSTANTANEOUS, jitter_s=0.01),
    ):
        assert all(math.isfinite(epoch.u[2]) for epoch in found)
    means = epochs(2.0, ImuSampling.MEAN)
    angle = np.cumsum([unskew3(epoch.C_end)[0] for epoch in means])
    assert np.abs(angle).max() < 2.0 * AMPLITUDE


def test_what_was_measured_is_the_epoch_without_its_biases() -> None:
    """To first order, and as if it turned at one rate."""
    stream = np.random.default_rng(5)
    t = np.arange(101) / 50.0
    w = 0.2 * np.sin(t + np.arange(3)[:, None]) + 0.02 * stream.standard_normal((3, 101))
    f = np.array([[0.3], [-0.5], [9.8]]) + 0.5 * np.sin(3.0 * t + np.arange(3)[:, None])
    block = ImuBlock(np.round(t * 1e9).astype(np.int64), w, f)
    paired = Paired(block, None, None, 0.0)
    bias = np.array([3e-5, -2e-5, 5e-5, 2e-3, -1e-3, 4e-3])
    whole = integrate_epoch(paired, ImuSampling.MEAN)
    found = as_measured(integrate_epoch(paired, ImuSampling.MEAN, bias), bias)
    without = integrate_epoch(paired, ImuSampling.MEAN, bias)
    for name, share in (("C_end", 1e-3), ("u", 2e-2)):
        off = np.abs(getattr(found, name) - getattr(whole, name)).max()
        assert off < share * np.abs(getattr(without, name) - getattr(whole, name)).max()
