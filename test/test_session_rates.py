"""IMUs that are slow, that lose samples, and whose interval changes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from swing_sessions import METHODS, assert_add_up, config_of, imu, joined, run, shifted

from sins_align.types import ImuSampling, State


@pytest.mark.parametrize("rate_hz", [2.5, 5.0, 7.0])
def test_too_slow_an_imu_is_told_so(rate_hz: float) -> None:
    samples = imu(rate_hz=rate_hz)
    session, updates = run(samples)
    assert session.status.state is State.FAILED
    assert f"{rate_hz:.1f} samples a second" in session.status.reason
    assert session.status.remedy
    assert session.estimate is None
    assert {u.status.state for u in updates} == {State.FAILED}
    assert_add_up(session, len(samples))
    # It is the rate that counts, not the past.
    session.add_imu(shifted(imu(), int(samples.stamp_ns[-1] - imu().stamp_ns[0]) + 10_000_000))
    assert session.status.state in (State.COARSE, State.FINE)
    assert session.estimate is not None


@pytest.mark.parametrize("rate_hz", [0.5, 1.0, 1.9])
def test_hardly_any_samples_are_no_crash(rate_hz: float) -> None:
    session, updates = run(imu(rate_hz=rate_hz))
    assert not updates
    assert session.status.state is State.WAITING
    assert "refused" in session.status.reason and "rate" in session.status.remedy


@METHODS
@pytest.mark.parametrize("rate_hz", [10.0, 12.5, 20.0])
@pytest.mark.parametrize("sampling", ["mean", "instantaneous"])
def test_slow_imus_work(method: str, rate_hz: float, sampling: str) -> None:
    settings_ = dataclasses.replace(config_of(method), sampling=ImuSampling(sampling))
    samples = imu(rate_hz=rate_hz, sampling=sampling, lost_fraction=0.02)
    session, _ = run(samples, settings_)
    assert session.status.state is not State.FAILED
    assert session.estimate is not None


def test_losses_do_not_make_an_imu_slow() -> None:
    """10 Hz, and half of a second missing."""
    samples = imu(rate_hz=10.0)
    session, updates = run(samples.select(np.delete(np.arange(len(samples)), [101, 102, 104, 107])))
    assert State.FAILED not in {u.status.state for u in updates}
    assert session.estimate is not None
    assert session.counts.imu_lost == 4


def test_a_stream_whose_interval_changes() -> None:
    first, then = imu(), imu(rate_hz=50.0)
    at = int(first.stamp_ns[1500])
    samples = joined(first.select(first.stamp_ns <= at), then.select(then.stamp_ns > at))
    session, _ = run(samples)
    assert session.imu_rate_hz == pytest.approx(50.0)
    assert session.counts.imu_gaps <= 1
    assert session.restarts == 0
    expected = run(first)[0].estimate
    found = session.estimate
    assert found is not None and expected is not None
    assert np.abs(found.q_nb - expected.q_nb).max() < 1e-3
