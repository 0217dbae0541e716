"""What the intake takes, refuses, orders and cuts."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sins_align.intake import (
    BLOCK_NS,
    MAX_GAP_NS,
    MAX_LATE_NS,
    MAX_RATE,
    MAX_SPECIFIC_FORCE,
    MIN_STEP_NS,
    Intake,
    all_usable,
    usable,
)
from sins_align.types import ImuBlock, ImuSamples, InputCounts, IntArray

T0 = 1_700_000_000_000_000_000
STEP = 10_000_000
SECOND = 1_000_000_000


def samples(stamps: Iterable[int]) -> ImuSamples:
    """Every value tells from which stamp it is."""
    stamp_ns = np.array(list(stamps), dtype=np.int64)
    s = ((stamp_ns - T0) * 1e-9).clip(-30.0, 30.0)
    return ImuSamples(stamp_ns, np.stack((s, s + 0.1, s + 0.2)), np.stack((-s, -s, -s)))


def regular(count: int, start: int = T0, step: int = STEP) -> list[int]:
    return [start + k * step for k in range(count)]


class Stream:
    """An intake, and the breaks as `Session` mends them."""

    def __init__(self) -> None:
        self.counts = InputCounts()
        self.intake = Intake(self.counts)
        self.blocks: list[ImuBlock] = []
        self.reasons: list[str] = []

    def add(self, part: ImuSamples) -> None:
        self.intake.add(part)
        while True:
            block = self.intake.next_block()
            if block is not None:
                self.blocks.append(block)
            elif self.intake.break_reason:
                rest = self.intake.take_after_break()
                self.reasons.append(self.intake.break_reason)
                self.intake = Intake(self.counts)
                self.intake.add_usable(rest)
            else:
                return

    def pending(self) -> ImuBlock | None:
        return self.intake.pending_block()


def feed(stamps: Iterable[int]) -> Stream:
    stream = Stream()
    stream.add(samples(stamps))
    return stream


def stamps_of(stream: Stream) -> list[int]:
    """All stamps taken in by blocks and the open one, each once."""
    found: list[int] = []
    for block in (*stream.blocks, stream.pending()):
        if block is not None:
            found += [s for s in block.stamp_ns.tolist() if not found or s != found[-1]]
    return found


# -- blocks


def test_blocks_end_at_the_first_stamp_on_or_after_the_grid() -> None:
    step = 300_000_000
    stream = feed(regular(12, step=step))
    ends = [(int(b.stamp_ns[-1]) - T0) / 1e9 for b in stream.blocks]
    assert ends == [1.2, 2.1, 3.0]
    for one, other in pairwise(stream.blocks):
        assert one.stamp_ns[-1] == other.stamp_ns[0]
    pending = stream.pending()
    assert pending is not None
    assert pending.stamp_ns.tolist() == [T0 + 10 * step, T0 + 11 * step]


def test_values_stay_with_their_stamps() -> None:
    stream = feed(regular(250))
    for block in stream.blocks:
        expected = samples(block.stamp_ns.tolist())
        np.testing.assert_array_equal(block.w_ib_b, expected.w_ib_b)
        np.testing.assert_array_equal(block.f_ib_b, expected.f_ib_b)


def test_the_callers_arrays_may_be_used_again() -> None:
    stream, part = Stream(), samples(regular(50))
    stream.add(part)
    for array in part:
        array[...] = 0
    stream.add(samples(regular(60, T0 + 50 * STEP)))
    np.testing.assert_array_equal(stream.blocks[0].w_ib_b, samples(regular(101)).w_ib_b)


def test_interval_and_gaps() -> None:
    stream = feed([s for k, s in enumerate(regular(301)) if k not in (50, 150, 151, 299)])
    assert stream.intake.interval_s == pytest.approx(0.01)
    assert (stream.counts.imu_gaps, stream.counts.imu_lost) == (3, 4)


def test_an_interval_that_changes_is_no_gap() -> None:
    stamps = regular(200) + regular(100, T0 + 200 * STEP, 2 * STEP)
    stream = feed(stamps)
    assert stream.intake.interval_s == pytest.approx(0.02)
    # Only what fell into the block in which it changed.
    assert stream.counts.imu_gaps <= 1
    assert stream.counts.imu_rejected == 0


def test_every_other_sample_lost_for_a_while() -> None:
    """Irregular losses do not change the interval."""
    rng = np.random.default_rng(0)
    kept = [s for s in regular(1001) if s == T0 or rng.random() > 0.4]
    stream = feed(kept)
    assert stream.intake.interval_s == pytest.approx(0.01)
    assert stream.counts.imu_lost == pytest.approx(1001 - len(kept), abs=45)


# -- values


def test_which_values_are_usable() -> None:
    part = samples(regular(8))
    part.w_ib_b[...] = 0.0
    part.f_ib_b[...] = 0.0
    part.w_ib_b[1, 1], part.f_ib_b[2, 2], part.f_ib_b[0, 3] = np.nan, np.inf, -np.inf
    part.w_ib_b[0, 4], part.f_ib_b[1, 5] = -1.0001 * MAX_RATE, 1.0001 * MAX_SPECIFIC_FORCE
    part.w_ib_b[0, 6], part.f_ib_b[1, 6] = MAX_RATE, -MAX_SPECIFIC_FORCE
    finite, in_range = usable(part)
    assert (~finite).nonzero()[0].tolist() == [1, 2, 3]
    assert (finite & ~in_range).nonzero()[0].tolist() == [4, 5]
    for k in range(8):
        one = part.select(slice(k, k + 1))
        assert all_usable(one) == bool(finite[k] and in_range[k])
    stream = Stream()
    stream.add(part)
    assert stream.counts.rejected == {
        "not_finite": 3, "out_of_range": 2, "repeated": 0, "backward": 0,
    }  # fmt: skip
    assert stream.counts.imu_samples == 3


@pytest.mark.parametrize("stamp", [2**63 - 1, -(2**63), 2**62, -(2**62)])
def test_stamps_whose_differences_would_overflow(stamp: int) -> None:
    stream = feed([*regular(10), stamp, *regular(300, T0 + 10 * STEP)])
    assert stream.counts.rejected["out_of_range"] == 1
    assert stamps_of(stream) == regular(310)


# -- order


def test_a_late_sample_is_put_in_its_place() -> None:
    stamps = regular(150)
    late = [*stamps[:40], *stamps[41:60], stamps[40], *stamps[60:]]
    stream = feed(late)
    assert stream.counts.imu_reordered == 1
    assert stream.counts.imu_rejected == 0
    for found, expected in zip(stream.blocks[0], feed(stamps).blocks[0], strict=True):
        np.testing.assert_array_equal(found, expected)


def test_neighbours_swapped_all_the_way() -> None:
    stamps = regular(400)
    swapped = list(stamps)
    for k in range(50, 350, 3):
        swapped[k], swapped[k + 1] = swapped[k + 1], swapped[k]
    stream = feed(swapped)
    assert not stream.reasons
    # A block ends with the sample that fills it; what comes later than that is refused.
    assert stream.counts.rejected["backward"] <= 3
    assert stream.counts.imu_samples + stream.counts.imu_rejected == 400
    assert stamps_of(stream) == sorted(stamps_of(stream))


def test_a_late_sample_for_a_closed_block_is_refused() -> None:
    stamps = regular(150)
    late = [*stamps[:40], *stamps[41:120], stamps[40], *stamps[120:]]
    for stream in (feed(late), Stream()):
        for stamp in late if not stream.blocks else ():
            stream.add(samples([stamp]))
        assert stream.counts.rejected["backward"] == 1
        assert stamps_of(stream) == [*stamps[:40], *stamps[41:]]


def test_repeats() -> None:
    """Each sample twice, also at the very start and at the ends of blocks."""
    stream = feed([s for s in regular(250) for _ in range(2)])
    assert stamps_of(stream) == regular(250)
    assert stream.counts.rejected["repeated"] == 250


def test_all_stamps_alike() -> None:
    stream = feed([0] * 1000)
    assert stream.counts.rejected["repeated"] == 999
    assert stream.counts.imu_samples == 1


def test_stamps_in_a_wrong_unit_do_not_fill_the_memory() -> None:
    """A driver that puts microseconds where nanoseconds belong: 1 kHz comes as 1 GHz."""
    stream = Stream()
    for k in range(20):
        stream.add(samples(regular(1000, T0 + k * 1_000_000, 1000)))
    assert stream.counts.imu_samples == 20_000 * 1000 / MIN_STEP_NS
    assert stream.counts.imu_samples + stream.counts.imu_rejected == 20_000


def test_a_sample_that_fits_nowhere_is_refused() -> None:
    """Not one that was lost: between two samples there is no room."""
    stamps = regular(80)
    stream = feed([*stamps, stamps[40] + STEP // 3, *regular(80, T0 + 80 * STEP)])
    assert stream.counts.rejected["backward"] == 1
    assert stamps_of(stream) == regular(160)


@pytest.mark.parametrize("back_s", [0.35, 1.7, 3600.0, 1.7e9])
def test_a_clock_set_back_is_a_new_start(back_s: float) -> None:
    """Without it, everything would be refused until the clock has caught up."""
    back = round(back_s * SECOND) + STEP // 3
    stream = feed([*regular(250), *regular(250, T0 + 250 * STEP - back)])
    (reason,) = stream.reasons
    assert "jumped back" in reason
    assert len(stream.blocks) == 4
    assert stream.counts.imu_samples + stream.counts.imu_rejected == 500
    assert stream.counts.imu_rejected <= MAX_LATE_NS // STEP + 2


def test_a_first_stamp_from_before_the_clock_was_set() -> None:
    stream = feed([0, *regular(250)])
    assert len(stream.reasons) == 1
    assert len(stream.blocks) == 2
    stream = feed([T0 + 10**18, *regular(250)])
    assert len(stream.reasons) == 1
    assert len(stream.blocks) == 2


def test_samples_sent_again_are_no_clock_set_back() -> None:
    stream = feed([*regular(130), *regular(60, T0 + 70 * STEP), *regular(200, T0 + 130 * STEP)])
    assert not stream.reasons
    assert stream.counts.rejected["repeated"] == 60
    assert stamps_of(stream) == regular(330)


# -- gaps


def test_a_single_stamp_far_ahead_is_refused() -> None:
    stamps = regular(250)
    for wrong in (stamps[100] + 10**15, stamps[100] + MAX_GAP_NS + STEP):
        stream = feed([*stamps[:100], wrong, *stamps[100:]])
        assert not stream.reasons
        assert stream.counts.rejected["out_of_range"] == 1
        assert stamps_of(stream) == stamps


@pytest.mark.parametrize("begin", [50, 99, 100, 101, 150])
def test_a_long_gap_is_a_break(begin: int) -> None:
    """Also at the boundary of a block; what was whole before stays."""
    stamps = regular(begin + 1) + regular(250, T0 + begin * STEP + 2 * SECOND)
    stream = feed(stamps)
    assert stream.reasons == ["2.0 s without IMU data"]
    assert len(stream.blocks) == begin // 100 + 2
    assert stream.blocks[begin // 100].stamp_ns[0] == stamps[begin + 1]
    assert stream.counts.imu_samples == len(stamps)
    assert (stream.counts.imu_rejected, stream.counts.imu_gaps) == (0, 1)


def test_half_a_second_is_bridged_and_no_more() -> None:
    bridged = feed(regular(80) + regular(100, T0 + 79 * STEP + MAX_GAP_NS))
    assert not bridged.reasons
    cut = feed(regular(80) + regular(100, T0 + 79 * STEP + MAX_GAP_NS + 1))
    assert cut.reasons == ["0.5 s without IMU data"]


def test_a_repeat_does_not_put_off_the_confirmation() -> None:
    after = T0 + 10 * SECOND
    stream = feed([*regular(50), after, after, after + STEP])
    assert len(stream.reasons) == 1
    assert stream.counts.rejected["repeated"] == 1
    assert stream.counts.imu_samples == 52


def test_many_breaks_in_one_call() -> None:
    stamps = [s for k in range(30) for s in regular(150, T0 + k * 10 * SECOND)]
    stream = feed(stamps)
    assert len(stream.reasons) == 29
    assert len(stream.blocks) == 30
    assert stream.counts.imu_samples == len(stamps)
    assert stream.counts.imu_gaps == 29


def test_slower_than_twice_a_second_is_refused_and_counted() -> None:
    stream = feed(regular(50, step=SECOND))
    assert not stream.blocks
    assert stream.counts.imu_samples == 1
    assert stream.counts.rejected["out_of_range"] == 49


# -- any stream at all

jumps = st.one_of(
    st.integers(1, 5).map(lambda k: k * STEP),
    st.integers(-8, 8).map(lambda k: k * STEP),
    st.integers(-200, 200).map(lambda k: k * STEP),
    st.sampled_from([0, 1, -1, MIN_STEP_NS, MAX_GAP_NS, MAX_GAP_NS + 1, BLOCK_NS, -BLOCK_NS]),
    st.integers(-(2**60), 2**60),
)
pieces = st.tuples(jumps, st.integers(1, 130))


def wild_stream(parts: list[tuple[int, int]]) -> list[int]:
    stamps = [T0]
    for jump, count in parts:
        first = min(max(stamps[-1] + jump, -(2**62)), 2**62)
        stamps += regular(count, first)
    return stamps


@settings(max_examples=120, deadline=None)
@given(st.lists(pieces, max_size=8), st.lists(st.integers(0, 600), max_size=12), st.booleans())
def test_handing_over_in_parts_changes_nothing(
    parts: list[tuple[int, int]], cuts: list[int], one_by_one: bool
) -> None:
    everything = samples(wild_stream(parts))
    whole, split = Stream(), Stream()
    whole.add(everything)
    size = len(everything)
    edges = range(size + 1) if one_by_one else sorted({0, size, *(c for c in cuts if c < size)})
    for a, b in pairwise(edges):
        split.add(everything.select(slice(a, b)))
        split.pending()
        # Nothing gets lost on the way, at no time.
        assert split.counts.imu_samples + split.counts.imu_rejected == b
        assert min(split.counts.rejected.values()) >= 0
    assert split.counts == whole.counts
    assert split.reasons == whole.reasons
    assert len(split.blocks) == len(whole.blocks)
    found, expected = ((*stream.blocks, stream.pending()) for stream in (split, whole))
    for one, other in zip(found, expected, strict=True):
        assert_same(one, other)


def assert_same(one: ImuBlock | None, other: ImuBlock | None) -> None:
    assert (one is None) == (other is None)
    if one is not None and other is not None:
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)
            assert a.flags.c_contiguous and b.flags.c_contiguous


@settings(max_examples=100, deadline=None)
@given(st.lists(pieces, max_size=8))
def test_blocks_are_always_fit_for_integration(parts: list[tuple[int, int]]) -> None:
    stream = feed(wild_stream(parts))
    for block in stream.blocks:
        steps = np.diff(block.stamp_ns)
        assert steps.size >= 2
        assert steps.min() >= MIN_STEP_NS
        assert steps.max() <= MAX_GAP_NS
        assert BLOCK_NS - MAX_GAP_NS < steps.sum() < BLOCK_NS + MAX_GAP_NS


def test_an_empty_call_is_nothing() -> None:
    stream = feed([])
    assert stream.counts == InputCounts()
    assert stream.pending() is None
    empty: IntArray = np.empty(0, dtype=np.int64)
    stream.add(ImuSamples(empty, np.empty((3, 0)), np.empty((3, 0))))
    assert stream.intake.elapsed_s(T0) == 0.0
