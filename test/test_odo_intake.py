"""Which odometer samples are taken, refused, held back and put in their place."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sins_align.intake import MAX_STAMP_NS
from sins_align.odo.odometer_intake import (
    MAX_LATE_NS,
    MAX_SPEED,
    MAX_STEP_NS,
    MIN_STEP_NS,
    RECENT_NS,
    OdometerIntake,
)
from sins_align.types import InputCounts, OdometerSamples

T0 = 1_700_000_000_000_000_000
STEP = 50_000_000
SECOND = 1_000_000_000


def samples(
    stamps: Iterable[int], speed: Sequence[float] | None = None, variance: float = 0.0
) -> OdometerSamples:
    stamp_ns = np.array(list(stamps), dtype=np.int64)
    size = stamp_ns.shape[0]
    return OdometerSamples(
        stamp_ns,
        np.arange(size) % 20.0 if speed is None else np.array(speed, dtype=float),
        np.full(size, variance),
    )


def regular(count: int, start: int = T0, step: int = STEP) -> list[int]:
    return [start + k * step for k in range(count)]


class Stream:
    def __init__(self) -> None:
        self.counts = InputCounts()
        self.intake = OdometerIntake(self.counts)
        self.stamps: list[int] = []
        self.speeds: list[float] = []

    def add(self, part: OdometerSamples) -> list[int]:
        accepted = self.intake.add(part)
        self.stamps += accepted.stamp_ns.tolist()
        self.speeds += accepted.speed.tolist()
        assert self.counts.odom_rejected == sum(self.intake.rejected.values())
        assert self.counts.odom_samples == len(self.stamps)
        return accepted.stamp_ns.tolist()


def test_good_samples_pass_as_they_are() -> None:
    stream = Stream()
    given_ = samples(regular(100), variance=0.01)
    accepted = stream.intake.add(given_)
    for got, want in zip(accepted, given_, strict=True):
        np.testing.assert_array_equal(got, want)
    assert (stream.counts.odom_samples, stream.counts.odom_rejected) == (100, 0)


def test_nothing_in_nothing_out() -> None:
    stream = Stream()
    assert stream.add(samples([])) == []
    assert len(stream.intake.recent()) == 0


def test_the_callers_arrays_are_not_kept() -> None:
    stream = Stream()
    part = samples(regular(10))
    accepted = stream.intake.add(part)
    part.speed[:] = -1.0
    assert accepted.speed.min() >= 0.0
    assert stream.intake.recent().speed.min() >= 0.0


@pytest.mark.parametrize(
    ("speed", "reason"),
    [
        (np.nan, "not_finite"),
        (np.inf, "not_finite"),
        (-np.inf, "not_finite"),
        (MAX_SPEED + 1.0, "out_of_range"),
        (-MAX_SPEED - 1.0, "out_of_range"),
    ],
)
def test_impossible_speeds_are_refused_and_change_nothing(speed: float, reason: str) -> None:
    stream = Stream()
    stamps = regular(10)
    stream.add(samples(stamps, [1.0] * 5 + [speed] + [1.0] * 4))
    assert stream.stamps == stamps[:5] + stamps[6:]
    assert stream.intake.rejected[reason] == stream.counts.odom_rejected == 1


@pytest.mark.parametrize("variance", [np.nan, -1.0, -np.inf])
def test_impossible_variance_is_an_unknown_one(variance: float) -> None:
    accepted = OdometerIntake(InputCounts()).add(samples(regular(3), variance=variance))
    np.testing.assert_array_equal(accepted.variance, np.zeros(3))


def test_infinite_variance_is_refused() -> None:
    stream = Stream()
    assert stream.add(samples(regular(3), variance=np.inf)) == []
    assert stream.intake.rejected["not_finite"] == 3


@pytest.mark.parametrize("stamp", [MAX_STAMP_NS + 1, -MAX_STAMP_NS - 1, 2**63 - 1, -(2**63)])
def test_impossible_stamps_are_refused(stamp: int) -> None:
    stream = Stream()
    stamps = regular(4)
    stream.add(samples([*stamps[:2], stamp, *stamps[2:]]))
    assert stream.stamps == stamps
    assert stream.intake.rejected["out_of_range"] == 1


@pytest.mark.parametrize("apart", [0, 1, MIN_STEP_NS - 1])
def test_repeated_stamps_are_refused(apart: int) -> None:
    stream = Stream()
    stamps = regular(4)
    stream.add(samples([*stamps, stamps[-1] + apart]))
    stream.add(samples([stamps[1] + apart]))
    assert stream.stamps == stamps
    assert stream.intake.rejected["repeated"] == 2


def test_a_late_sample_takes_the_place_that_is_free() -> None:
    stream = Stream()
    stamps = regular(20)
    stream.add(samples(stamps[:16] + stamps[17:]))
    assert stream.add(samples([stamps[16]])) == [stamps[16]]
    assert stream.intake.recent().stamp_ns.tolist() == stamps
    stream.add(samples([stamps[16]]))
    assert stream.intake.rejected["repeated"] == 1


def test_a_late_sample_without_a_place_is_refused() -> None:
    stream = Stream()
    stamps = regular(20)
    stream.add(samples(stamps))
    assert stream.add(samples([stamps[17] + STEP // 2])) == []
    assert stream.intake.rejected["backward"] == 1


def test_a_sample_that_is_too_late_is_refused() -> None:
    stream = Stream()
    stamps = regular(20)
    stream.add(samples(stamps[:10] + stamps[11:]))
    assert stamps[10] < stamps[-1] - MAX_LATE_NS
    assert stream.add(samples([stamps[10]])) == []
    assert stream.intake.rejected["backward"] == 1


def test_a_single_stamp_far_ahead_is_not_believed() -> None:
    stream = Stream()
    stamps = regular(40)
    stream.add(samples([*stamps[:20], T0 + 3600 * SECOND, *stamps[20:]]))
    assert stream.stamps == stamps
    assert stream.intake.rejected["out_of_range"] == 1


def test_after_a_dropout_the_first_sample_waits_for_the_second() -> None:
    stream = Stream()
    stream.add(samples(regular(20)))
    later = regular(20, T0 + 30 * SECOND)
    assert stream.add(samples(later[:1])) == []
    assert stream.counts.odom_rejected == 1
    assert stream.add(samples(later[1:2])) == later[:2]
    assert stream.counts.odom_rejected == 0


def test_a_suspect_that_comes_twice_is_a_repeat() -> None:
    stream = Stream()
    stream.add(samples(regular(20)))
    ahead = T0 + 30 * SECOND
    assert stream.add(samples([ahead, ahead])) == []
    assert stream.intake.rejected["repeated"] == 1
    assert stream.add(samples([ahead + STEP])) == [ahead, ahead + STEP]


@pytest.mark.parametrize("back_s", [0.9, 5.0, 3600.0])
def test_a_clock_set_back_begins_anew(back_s: float) -> None:
    stream = Stream()
    stream.add(samples(regular(100)))
    back = regular(100, T0 + 100 * STEP - round(back_s * SECOND))
    stream.add(samples(back))
    assert stream.stamps[-80:] == back[-80:]
    backward = np.diff(stream.stamps)
    assert np.count_nonzero(backward < -MAX_LATE_NS) == 1
    assert (backward[backward >= -MAX_LATE_NS] > 0).all()
    assert stream.intake.recent().stamp_ns[0] >= back[0]


def test_a_first_stamp_far_ahead_does_not_lock_out_the_rest() -> None:
    stream = Stream()
    stamps = regular(100)
    stream.add(samples([T0 + 3600 * SECOND, *stamps]))
    assert stream.stamps[1:] == stamps[100 - len(stream.stamps) + 1 :]
    assert len(stream.stamps) > 80


def test_a_little_step_back_costs_no_more_than_itself() -> None:
    stream = Stream()
    stream.add(samples(regular(100)))
    stream.add(samples(regular(100, T0 + 100 * STEP - SECOND // 2 - STEP // 2)))
    assert (np.diff(stream.stamps) > 0).all()
    assert len(stream.stamps) >= 188


def test_recent_keeps_ten_seconds() -> None:
    stream = Stream()
    for stamp in regular(1000):
        stream.add(samples([stamp]))
    recent = stream.intake.recent().stamp_ns
    assert recent[-1] == T0 + 999 * STEP
    assert recent[-1] - recent[0] == RECENT_NS
    np.testing.assert_array_equal(recent, stream.intake.recent().stamp_ns)


def test_recent_stays_bounded_when_samples_come_late() -> None:
    stream = Stream()
    stamps = regular(1000)
    for one, other in zip(stamps[::2], stamps[1::2], strict=True):
        stream.add(samples([other]))
        stream.add(samples([one]))
    assert stream.stamps[1:5] == [stamps[3], stamps[2], stamps[5], stamps[4]]
    assert len(stream.intake.recent()) <= 202


def test_one_second_apart_is_fine() -> None:
    stream = Stream()
    stamps = regular(50, step=SECOND)
    del stamps[10]
    stream.add(samples(stamps))
    assert stream.stamps == stamps


stamp_lists = st.lists(
    st.one_of(
        st.integers(0, 40).map(lambda k: T0 + k * STEP),
        st.integers(-3, 3).map(lambda k: T0 + k * SECOND),
        st.sampled_from([2**63 - 1, -(2**63), 0, T0 + MAX_STEP_NS, T0 + 40 * STEP + 1]),
    ),
    max_size=40,
)


@given(
    odd=stamp_lists,
    speeds=st.lists(st.sampled_from([1.0, 2.0, np.nan, 200.0]), min_size=120, max_size=120),
    cuts=st.lists(st.integers(0, 120), max_size=20),
    order=st.randoms(use_true_random=False),
)
@settings(max_examples=150, deadline=None)
def test_chunks_do_not_matter(
    odd: list[int], speeds: list[float], cuts: list[int], order: object
) -> None:
    stamps = regular(41)
    for stamp in odd:
        stamps.insert(order.randrange(len(stamps)), stamp)  # type: ignore[attr-defined]
    everything = samples(stamps, speeds[: len(stamps)])
    whole, parts = Stream(), Stream()
    whole.add(everything)
    edges = [0, *sorted(c for c in cuts if c < len(stamps)), len(stamps)]
    for begin, end in pairwise(edges):
        parts.add(everything.select(slice(begin, end)))
    assert whole.stamps == parts.stamps
    assert whole.speeds == parts.speeds
    assert whole.intake.rejected == parts.intake.rejected
    for one, other in zip(whole.intake.recent(), parts.intake.recent(), strict=True):
        np.testing.assert_array_equal(one, other)
    assert (np.diff(whole.intake.recent().stamp_ns) >= MIN_STEP_NS).all()
