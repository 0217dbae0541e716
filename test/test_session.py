"""One code path for live and replay: what it makes of what a vehicle sends."""

from __future__ import annotations

import dataclasses
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from swing_sessions import (
    CONFIG,
    METHODS,
    SECOND,
    assert_add_up,
    config,
    config_of,
    copied,
    imu,
    joined,
    numbers,
    run,
    shifted,
    trace,
)

from sins_align.session import Session
from sins_align.soundness import is_sound
from sins_align.types import ImuSamples, ImuSampling, State

# -- the same samples, the same bits


@METHODS
@pytest.mark.parametrize("sampling", ["mean", "instantaneous"])
def test_one_by_one_is_all_at_once(method: str, sampling: str) -> None:
    samples = imu(sampling=sampling, lost_fraction=0.03, stamp_jitter_s=1e-4)
    settings_ = dataclasses.replace(config_of(method), sampling=ImuSampling(sampling))
    whole, expected = run(samples, settings_)
    single = Session(settings_)
    found = []
    for k in range(len(samples)):
        found += single.add_imu(samples.select(slice(k, k + 1)))
    assert trace(found) == trace(expected)
    assert numbers(single.estimate) == numbers(whole.estimate) != ()
    assert single.counts == whole.counts


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    st.lists(st.integers(0, 3001), max_size=20),
    st.lists(st.booleans(), min_size=21, max_size=21),
    st.sampled_from(["inertial", "paper"]),
)
def test_handing_over_and_asking_change_nothing(
    cuts: list[int], ask: list[bool], method: str
) -> None:
    samples = damaged(imu())
    whole, expected = run(samples, config_of(method))
    split = Session(config_of(method))
    found = []
    for (a, b), asked in zip(pairwise(sorted({0, len(samples), *cuts})), ask, strict=False):
        found += split.add_imu(samples.select(slice(a, b)))
        assert_add_up(split, min(b, len(samples)))
        if asked:
            before = numbers(split.estimate)
            # A conclusion makes something of samples that the estimate leaves for later.
            assert numbers(split.conclusion) or not before
            assert numbers(split.estimate) == before
    assert trace(found) == trace(expected)
    assert numbers(split.estimate) == numbers(whole.estimate)
    assert numbers(split.conclusion) == numbers(whole.conclusion)
    assert split.counts == whole.counts
    assert split.status == whole.status


def damaged(samples: ImuSamples) -> ImuSamples:
    """Losses, late samples, repeats, nonsense, a wrong stamp and a hole of 2 s."""
    order = np.arange(len(samples))
    order = np.delete(order, [150, 151, 730, *range(1200, 1400)])
    order[[300, 301]], order[[500, 505]] = order[[301, 300]], order[[505, 500]]
    order = np.insert(order, 800, [790, 800, 10])
    damaged_ = samples.select(order)
    damaged_.w_ib_b[1, 60] = np.nan
    damaged_.f_ib_b[0, 61] = np.inf
    damaged_.f_ib_b[0, 62] = 1e5
    damaged_.stamp_ns[1000] += 10**12
    return damaged_


BAD = {
    "not a number": (lambda s, k: s.w_ib_b.__setitem__((0, k), np.nan), "not_finite"),
    "infinite": (lambda s, k: s.f_ib_b.__setitem__((2, k), -np.inf), "not_finite"),
    "too fast": (lambda s, k: s.w_ib_b.__setitem__((0, k), 1e3), "out_of_range"),
    "shaken": (lambda s, k: s.f_ib_b.__setitem__((1, k), 1e6), "out_of_range"),
    "far ahead": (lambda s, k: s.stamp_ns.__setitem__(k, s.stamp_ns[k] + 10**13), "out_of_range"),
    "overflow": (lambda s, k: s.stamp_ns.__setitem__(k, 2**63 - 1), "out_of_range"),
    "repeat": (lambda s, k: s.stamp_ns.__setitem__(k, s.stamp_ns[k - 1]), "repeated"),
    "from long ago": (lambda s, k: s.stamp_ns.__setitem__(k, s.stamp_ns[k] - 10**10), "backward"),
    "before the first": (lambda s, k: s.stamp_ns.__setitem__(k, 0), "backward"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_rejected_sample_changes_nothing(name: str) -> None:
    clean = imu(duration_s=15.0)
    places = [1, 57, 100, 101, 777, 1200, 1450]
    extra = ImuSamples(*(np.insert(x, places, x[..., places], axis=-1) for x in clean))
    spoil, reason = BAD[name]
    spoilt = np.array(places) + np.arange(len(places))
    for k in spoilt:
        spoil(extra, k)
    expected, expected_updates = run(clean)
    session, updates = run(extra)
    assert trace(updates) == trace(expected_updates)
    assert numbers(session.estimate) == numbers(expected.estimate) != ()
    assert session.counts.rejected[reason] == session.counts.imu_rejected == len(places)
    assert session.counts.imu_samples == len(clean)
    assert session.restarts == 0


wild_steps = st.lists(
    st.tuples(
        st.sampled_from([0, 1, -1, 5, 60, -60, 250, -250, 10**6, -(10**6)]), st.integers(1, 150)
    ),
    max_size=6,
)


@settings(max_examples=25, deadline=None)
@given(wild_steps, st.lists(st.integers(0, 900), max_size=5), st.integers(1, 400))
def test_any_stream_adds_up_and_does_no_harm(
    steps: list[tuple[int, int]], nonsense: list[int], chunk: int
) -> None:
    parts, at = [imu().select(slice(0, 120))], 120
    shift = 0
    for jump, count in steps:
        shift += jump * 10_000_000
        parts.append(shifted(imu().select(slice(at, at + count)), shift))
        at += count
    samples = joined(*parts)
    for k in nonsense:
        if k < len(samples):
            samples.w_ib_b[0, k] = math.nan
    session = Session(CONFIG)
    for k in range(0, len(samples), chunk):
        session.add_imu(samples.select(slice(k, k + chunk)))
        assert_add_up(session, min(k + chunk, len(samples)))
        estimate = session.estimate
        assert estimate is None or is_sound(estimate)
        assert session.status.state is not State.FAILED


# -- gaps, clocks, restarts


def test_a_gap_begins_anew_and_keeps_what_was() -> None:
    samples = imu()
    elapsed = samples.stamp_ns - samples.stamp_ns[0]
    broken = samples.select((elapsed < 12 * SECOND) | (elapsed >= 14 * SECOND))
    session, updates = run(broken)
    _, before = run(samples.select(elapsed < 12 * SECOND))
    assert trace(updates[: len(before)]) == trace(before)
    assert session.restarts == 1
    assert session.begin_reason == "2.0 s without IMU data"
    # And after it, all is as if nothing had been before.
    fresh, after = run(samples.select(elapsed >= 14 * SECOND))
    assert [numbers(u.estimate) for u in updates[len(before) :]] == [
        numbers(u.estimate) for u in after
    ]
    assert numbers(session.estimate) == numbers(fresh.estimate) != ()
    assert "began anew: 2.0 s without IMU data" in updates[len(before)].status.reason
    assert session.counts.imu_gaps == 1
    assert session.counts.duration_s == pytest.approx(30.0)


def test_a_clock_set_back_begins_anew() -> None:
    """A bag that is played again, or a clock that is set: not silence until it has caught up."""
    samples = imu(duration_s=12.0)
    session, _ = run(joined(samples, shifted(samples, -100 * SECOND)))
    assert session.restarts == 1
    assert "jumped back" in session.begin_reason
    # The first 0.1 s told that it was no late sample.
    expected, _ = run(samples.select(slice(11, None)))
    assert session.estimate is not None and expected.estimate is not None
    assert session.estimate.q_nb.tobytes() == expected.estimate.q_nb.tobytes()
    assert_add_up(session, 2 * len(samples))


def test_the_waiting_state_says_what_it_waits_for() -> None:
    session = Session(CONFIG)
    assert (session.status.state, session.status.reason) == (State.WAITING, "no IMU data")
    assert session.imu_rate_hz is None
    session.add_imu(imu().select(slice(0, 50)))
    assert (session.status.state, session.status.keys) == (State.WAITING, ("levelling",))
    stuck = Session(CONFIG)
    ones = copied(imu().select(slice(0, 200)))
    ones.stamp_ns[...] = 0
    stuck.add_imu(ones)
    assert stuck.status.reason == "199 of 200 IMU samples refused"
    assert "stamps" in stuck.status.remedy
    stuck.restart("again")
    assert stuck.status.state is State.WAITING
    assert stuck.status.reason == "no IMU data; began anew: again"
    assert "refused" not in stuck.status.reason and "topic imu" in stuck.status.remedy


def test_restart_forgets_all_but_the_counts() -> None:
    session, _ = run(imu())
    session.restart()
    assert session.estimate is None
    assert (session.restarts, session.begin_reason) == (1, "restarted on request")
    assert session.status.state is State.WAITING
    assert session.status.reason == "no IMU data; began anew: restarted on request"
    samples = shifted(imu(seed=9), 1000 * SECOND)
    session.add_imu(samples)
    expected, _ = run(samples)
    assert numbers(session.estimate) == numbers(expected.estimate) != ()
    assert_add_up(session, len(imu()) + len(samples))


def test_restart_with_a_sample_held_back() -> None:
    """A stamp far ahead that waits for the next one: counted, whatever becomes of it."""
    samples = copied(imu().select(slice(0, 101)))
    samples.stamp_ns[-1] += 5 * SECOND
    session, _ = run(samples)
    assert_add_up(session, 101)
    session.restart()
    assert_add_up(session, 101)


# -- other thresholds


@pytest.mark.parametrize("restart", [False, True])
def test_other_thresholds_count_from_the_next_estimate_on_and_lose_nothing(restart: bool) -> None:
    strict, loose = config(heading_threshold_arcmin=1e-5), config(
        heading_threshold_arcmin=600.0, level_threshold_arcsec=600.0, hold_s=1.0
    )  # fmt: skip
    samples = imu(duration_s=30.0)
    changed, always = Session(strict), Session(loose)
    for session in (changed, always):
        session.add_imu(samples.select(slice(0, 2000)))
    assert changed.status.state is State.FINE
    assert "not below 1e-05'" in changed.status.reason
    changed.set_completion(loose.completion)
    assert changed.config.completion == loose.completion
    if restart:
        for session in (changed, always):
            session.restart()
        samples = shifted(samples, 60 * SECOND)
    rest = samples.select(slice(0 if restart else 2000, None))
    found, expected = changed.add_imu(rest), always.add_imu(rest)
    assert found[-1].status.state is expected[-1].status.state is State.ALIGNED
    for one, other in zip(found, expected, strict=True):
        if one.estimate is not None and other.estimate is not None:
            np.testing.assert_array_equal(one.estimate.q_nb, other.estimate.q_nb)
    changed.set_completion(strict.completion)
    more = changed.add_imu(shifted(samples.select(slice(1, 1600)), 30 * SECOND))
    assert more[-1].status.state is not State.ALIGNED
    assert more[-1].status.aligned_at_s is None
