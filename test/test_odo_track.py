"""Distance from mean speeds: exact at the stamps, over holes, however the samples come."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from odometer_tracks import (
    MM,
    RNG,
    T0,
    driven,
    given_speeds,
    means,
    must_read,
    read,
    speed_of,
    track_of,
    with_speed,
)

from sins_align.odo.hampel import HAMPEL_SIDE
from sins_align.odo.odometer_intake import MAX_LATE_NS
from sins_align.odo.track import MAX_BRIDGE_S, OdometerTrack
from sins_align.types import OdometerSamples

# Distance


@pytest.mark.parametrize("jitter", [0.0, 0.3])
@pytest.mark.parametrize("rate", [1.0, 5.0, 20.0, 100.0])
def test_distance_is_exact_at_the_stamps(rate: float, jitter: float) -> None:
    t = (np.arange(60 * rate) + jitter * RNG(1).uniform(-0.5, 0.5, round(60 * rate))) / rate
    samples = means(t)
    stamps = (samples.stamp_ns[2:-2] - T0) * 1e-9
    S = must_read(track_of(samples), stamps).distance
    np.testing.assert_allclose(S - S[0], driven(stamps) - driven(stamps[0]), rtol=0, atol=1e-9)


@pytest.mark.parametrize(("rate", "error_m"), [(1.0, 0.04), (5.0, 0.3 * MM), (20.0, 5e-6)])
def test_distance_between_the_stamps(rate: float, error_m: float) -> None:
    track = track_of(means(np.arange(60 * rate) / rate))
    t = np.linspace(3.0, 55.0, 5000)
    stretch = must_read(track, t)
    S = stretch.distance - driven(t)
    assert np.ptp(S) < 2.0 * error_m
    assert np.abs(stretch.speed - speed_of(t)).max() < 10.0 * rate * error_m


def test_speed_is_the_derivative_and_has_no_steps() -> None:
    track = track_of(means(np.cumsum(RNG(2).uniform(0.04, 0.06, 400))))
    t = np.linspace(2.0, 15.0, 40001)
    stretch = must_read(track, t)
    middle = np.diff(stretch.distance) / np.diff(t)
    np.testing.assert_allclose(
        middle, 0.5 * (stretch.speed[1:] + stretch.speed[:-1]), rtol=0, atol=1e-4
    )
    assert np.abs(np.diff(stretch.speed)).max() < 2e-3


def test_a_steady_acceleration_is_exact_everywhere() -> None:
    track = track_of(means(np.arange(20.0), lambda t: 0.4 * t * t))
    t = np.linspace(1.0, 19.0, 300)
    stretch = must_read(track, t)
    np.testing.assert_allclose(stretch.speed, 0.8 * t, rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        stretch.distance - stretch.distance[0], 0.4 * (t * t - 1.0), rtol=0, atol=1e-9
    )


def test_reverse_and_standstill() -> None:
    t = np.arange(200) * 0.05
    track = track_of(given_speeds(t, np.where(t < 5.0, 0.0, -2.0)))
    stretch = must_read(track, np.array([1.0, 4.5, 5.0, 9.0]))
    np.testing.assert_allclose(
        stretch.distance - stretch.distance[0], [0.0, 0.0, -0.1, -8.1], atol=1e-9
    )
    assert stretch.speed[0] == 0.0


def test_nothing_outside_of_the_track() -> None:
    track = track_of(means(np.arange(0.0, 10.0, 0.05)))
    assert read(track, np.array([0.01, 5.0])) is None
    assert read(track, np.array([5.0, 9.96])) is None
    assert read(track, np.array([0.05, 5.0])) is not None
    assert read(track, np.array([5.0, 9.95])) is not None
    assert OdometerTrack().read(np.array([0.0, 1.0])) is None


def test_variance_is_that_of_the_samples_summed() -> None:
    samples = means(np.arange(0.0, 10.0, 0.05), variance=0.04)
    track = track_of(samples)
    for begin, end in ((2.0, 3.0), (2.025, 3.0), (2.0, 3.01)):
        variance = must_read(track, np.array([begin, end])).variance
        assert variance == pytest.approx((end - begin) / 0.05 * 0.04 * 0.05**2)
    assert (
        must_read(track_of(means(np.arange(0.0, 10.0, 0.05))), np.array([2.0, 3.0])).variance == 0
    )


# Holes


@pytest.mark.parametrize("lost", [1, 3, 7])
def test_a_short_hole_is_bridged(lost: int) -> None:
    samples = means(np.arange(0.0, 10.0, 0.05))
    keep = np.ones(len(samples), dtype=bool)
    keep[100 : 100 + lost] = False
    track = track_of(samples.select(keep))
    t = np.array([4.0, 8.0])
    stretch = must_read(track, t)
    hole = lost * 0.05
    assert stretch.variance == pytest.approx(hole**4, rel=1e-6)
    error = np.diff(stretch.distance)[0] - np.diff(driven(t))[0]
    assert 0.0 < abs(error) < hole**2


def test_a_long_hole_is_not() -> None:
    samples = means(np.arange(0.0, 10.0, 0.05))
    keep = np.ones(len(samples), dtype=bool)
    keep[100:108] = False
    track = track_of(samples.select(keep))
    assert MAX_BRIDGE_S < 8 * 0.05
    assert read(track, np.array([4.0, 8.0])) is None
    assert read(track, np.array([4.0, 5.0])) is not None
    # The first sample after the hole stands for the usual interval before it.
    assert read(track, np.array([5.39, 8.0])) is None
    stretch = must_read(track, np.array([5.40, 8.0]))
    assert np.diff(stretch.distance)[0] == pytest.approx(np.diff(driven(np.array([5.4, 8.0])))[0])


def test_a_step_half_as_long_again_is_one_interval() -> None:
    t = np.arange(0.0, 60.0)
    t[30:] += 0.45
    track = track_of(means(t))
    stretch = must_read(track, np.array([20.0, 40.45]))
    assert stretch.variance == 0.0
    assert np.diff(stretch.distance)[0] == pytest.approx(
        np.diff(driven(np.array([20.0, 40.45])))[0]
    )


def test_a_step_above_two_seconds_is_always_a_hole() -> None:
    track = track_of(means(np.arange(0.0, 60.0, 2.5)))
    assert read(track, np.array([10.0, 12.5])) is None
    assert read(track, np.array([11.0, 12.0])) is None


def test_a_lost_sample_at_one_hertz() -> None:
    samples = means(np.arange(0.0, 30.0))
    keep = np.ones(len(samples), dtype=bool)
    keep[14] = False
    track = track_of(samples.select(keep))
    assert read(track, np.array([14.0, 15.0])) is None
    assert read(track, np.array([13.0, 14.0])) is not None
    assert read(track, np.array([15.0, 16.0])) is not None


def test_a_new_rate_is_learned() -> None:
    t = np.concatenate((np.arange(0.0, 10.0, 0.05), np.arange(10.0, 60.0)))
    track = track_of(means(t))
    assert read(track, np.array([25.0, 59.0])) is not None


# Order of arrival


def flatten(track: OdometerTrack) -> bytes:
    return track._knots.tobytes()


drives = st.tuples(
    st.sampled_from([1.0, 4.0, 10.0, 20.0, 100.0]),  # rate
    st.sampled_from([0.0, 0.3, 0.9]),  # jitter
    st.sampled_from([0.0, 0.1, 0.5]),  # lost
    st.sampled_from([None, 0.0, 0.05]),  # quantum
    st.integers(0, 10000),
)


@given(drives)
@settings(max_examples=60, deadline=None)
def test_chunks_do_not_matter(drive: tuple[float, float, float, float | None, int]) -> None:
    rate, jitter, lost, quantum, seed = drive
    rng = RNG(seed)
    t = np.sort((np.arange(300) + jitter * rng.uniform(-0.5, 0.5, 300)) / rate)
    samples = means(t)
    speed = 0.05 * rate * np.round(samples.speed / (0.05 * rate))
    speed[rng.random(299) < 0.03] += 20.0
    samples = with_speed(samples, speed).select(rng.random(299) >= lost)
    whole, parts = OdometerTrack(quantum), OdometerTrack(quantum)
    whole.add(samples)
    whole.settle()
    edges = np.unique(np.concatenate(([0, len(samples)], rng.integers(0, len(samples), 40))))
    for begin, end in pairwise(edges.tolist()):
        parts.add(samples.select(slice(begin, end)))
        if rng.random() < 0.7:
            parts.settle()
    parts.settle()
    assert flatten(whole) == flatten(parts)
    assert (whole.replaced, whole.quantum) == (parts.replaced, parts.quantum)


@given(st.integers(0, 10000))
@settings(max_examples=40, deadline=None)
def test_late_samples_find_their_place_whoever_asked_meanwhile(seed: int) -> None:
    rng = RNG(seed)
    samples = means(np.arange(0.0, 8.0, 0.05))
    order = np.arange(len(samples))
    for k in rng.integers(5, len(samples) - 5, 15):
        order[k], order[k + 1] = order[k + 1], order[k]
    asked, not_asked = OdometerTrack(0.0), OdometerTrack(0.0)
    for k in order:
        one = samples.select(slice(k, k + 1))
        asked.add(one)
        asked.settle()
        not_asked.add(one)
    asked.settle()
    not_asked.settle()
    assert flatten(asked) == flatten(not_asked)
    assert asked.too_late == not_asked.too_late


def test_a_swapped_pair_makes_no_difference() -> None:
    samples = means(np.arange(0.0, 8.0, 0.05))
    order = np.arange(len(samples))
    order[[60, 61]] = order[[61, 60]]
    swapped, ordered = track_of(samples.select(order)), track_of(samples)
    assert flatten(swapped) == flatten(ordered)
    assert swapped.too_late == 0


def test_what_comes_after_the_judgement_is_refused() -> None:
    samples = means(np.arange(0.0, 8.0, 0.05))
    track = OdometerTrack(0.0)
    track.add(samples.select(slice(0, 50)))
    track.settle(np.inf)
    before = flatten(track)
    track.add(samples.select(slice(48, 49)))
    assert track.too_late == 1
    assert flatten(track) == before


def test_samples_are_judged_when_their_window_is_whole() -> None:
    samples = means(np.arange(0.0, 8.0, 0.05))
    track = OdometerTrack(0.0)
    track.add(samples.select(slice(0, 40)))
    track.settle()
    assert track.knots.shape[0] == 40 - HAMPEL_SIDE
    later = samples.select(slice(60, 61))  # nothing that is still to come is in a window
    track.add(later)
    track.settle()
    assert track.knots[-1] == pytest.approx(39 * 0.05)
    track.settle(track.time(int(later.stamp_ns[0])))
    assert track.knots[-1] == pytest.approx(60 * 0.05)


def test_slow_samples_are_judged_at_once() -> None:
    track = OdometerTrack()
    samples = means(np.arange(0.0, 40.0))
    for k in range(len(samples)):
        track.add(samples.select(slice(k, k + 1)))
        track.settle()
        assert track.knots.shape[0] == k + 1 or k == 0


def test_a_clock_set_back_begins_anew() -> None:
    samples = means(np.arange(0.0, 20.0, 0.05))
    track = OdometerTrack(0.0)
    track.add(samples)
    track.settle()
    back = OdometerSamples(samples.stamp_ns - 30_000_000_000, samples.speed, samples.variance)
    track.add(back)
    track.settle()
    assert track.origin_ns == back.stamp_ns[0]
    assert MAX_LATE_NS < 30_000_000_000
    assert read(track, np.array([-25.0, -15.0])) is not None
    assert read(track, np.array([5.0, 6.0])) is None


def test_memory_is_bounded() -> None:
    track = OdometerTrack()
    for k in range(400):  # standing still for more than an hour, and then driving
        t = 10.0 * k + np.arange(0.05, 10.001, 0.05)
        track.add(given_speeds(t, np.full(200, 0.0 if k < 380 else 3.0)))
        track.settle()
        track.drop_before(10.0 * k)
    assert track._knots.shape[1] < 600
    assert track._raw.shape[1] < 100
    assert sum(part[0].size for part in track._finder._parts) < 5000
