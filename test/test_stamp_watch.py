"""Jitter of stamps: of a smooth motion, of one that is not, and of a sensor that means it."""

from __future__ import annotations

import numpy as np
import pytest

from sins_align.stamp_watch import StampWatch
from sins_align.types import Array, ImuBlock, IntArray

RATE_HZ, SECONDS = 50.0, 40
ARW = 1.5e-7  # [rad/sqrt(s)]


def finding(jitter_s: float, amplitude: float, hertz: float, stamped_right: bool = False) -> str:
    """Key of what is found: a rate of that amplitude [rad/s] and frequency, sampled with jitter."""
    stream = np.random.default_rng(1)
    watch = StampWatch(ARW)
    count = round(RATE_HZ)
    for second in range(SECONDS):
        even = second + np.arange(count + 1) / RATE_HZ
        stamps = even + jitter_s * stream.standard_normal(count + 1)
        rate = rates(stamps if stamped_right else even, amplitude, hertz)
        watch.update(ImuBlock(nanoseconds(stamps), rate, np.zeros((3, count + 1))))
    return "" if watch.finding is None else watch.finding.reason.key


def rates(time_s: Array, amplitude: float, hertz: float) -> Array:
    return amplitude * np.sin(2.0 * np.pi * hertz * time_s + np.arange(3)[:, None])


def nanoseconds(time_s: Array) -> IntArray:
    return np.round(time_s * 1e9).astype(np.int64)


@pytest.mark.parametrize(
    ("jitter_s", "amplitude", "hertz", "key"),
    [
        (1e-3, 0.1, 0.2, "stamp_jitter"),  # a swing: smooth by number
        (1e-5, 0.1, 0.2, ""),  # a clock's
        (3e-4, 1e-2, 12.1, "stamp_jitter"),  # a vehicle that shakes: smooth by neither
        (3e-4, 1e-4, 12.1, ""),  # and little harm
        (1e-3, 0.0, 1.0, ""),  # a base at rest
    ],
)
def test_stamps_that_are_not_those_of_the_samples(
    jitter_s: float, amplitude: float, hertz: float, key: str
) -> None:
    assert finding(jitter_s, amplitude, hertz) == key


@pytest.mark.parametrize(("amplitude", "hertz"), [(0.1, 0.2), (1e-2, 2.0)])
def test_a_sensor_that_samples_unevenly_is_right(amplitude: float, hertz: float) -> None:
    assert finding(1e-3, amplitude, hertz, stamped_right=True) == ""
