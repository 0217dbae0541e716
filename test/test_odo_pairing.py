"""IMU and odometer in epochs: where they end, what is waited for, and that order is no matter."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sins_align.config import OdometerConfig, odo_config
from sins_align.odo.pairing import EPOCH_S, LONGER_S, SHORTER_S, Paired, Pairing
from sins_align.types import Array, ImuBlock, IntArray, OdometerSamples

T0 = 1_700_000_000_000_000_000
SECOND = 1_000_000_000
RNG = np.random.default_rng


def config(**parameters: object) -> OdometerConfig:
    return odo_config({"odometer_quantum_m": 0.0, **parameters}).odometer


def driven(t: Array) -> Array:
    return 8.0 * t + 20.0 * np.sin(0.3 * t) + 3.0 * np.cos(0.7 * t)


def odometer(t: Array, late_s: float = 0.0, variance: float = 0.0) -> OdometerSamples:
    """Means over (t[k-1], t[k]], with stamps that are late."""
    speed = np.diff(driven(t)) / np.diff(t)
    stamp_ns = T0 + np.rint((t[1:] + late_s) * 1e9).astype(np.int64)
    return OdometerSamples(stamp_ns, speed, np.full(speed.shape[0], variance))


def regular_odometer(
    duration_s: float, rate: float, begin_s: float = 0.0, late_s: float = 0.0
) -> OdometerSamples:
    return odometer(begin_s + np.arange(duration_s * rate + 1) / rate, late_s)


def imu_stamps(duration_s: int, rate: int, begin_s: int = 0) -> IntArray:
    return T0 + begin_s * SECOND + np.arange(duration_s * rate + 1) * (SECOND // rate)


def blocks_of(stamp_ns: IntArray) -> list[ImuBlock]:
    """Cut as `Intake` does; every value tells which stamp it is of."""
    value = (stamp_ns - T0) * 1e-9
    w, f = value + np.arange(3.0)[:, None], value - np.arange(3.0)[:, None]
    edges = np.searchsorted(stamp_ns, np.arange(stamp_ns[0], stamp_ns[-1] + 1, SECOND))
    return [
        ImuBlock(stamp_ns[a : b + 1], w[:, a : b + 1], f[:, a : b + 1]) for a, b in pairwise(edges)
    ]


def take(pairing: Pairing, delay_s: float = 0.0, quanta: list[float] | None = None) -> list[Paired]:
    """All epochs that are there, and into `quanta` what was known of the quantum at each."""
    epochs = []
    while (epoch := pairing.next(delay_s)) is not None:
        epochs.append(epoch)
        if quanta is not None:
            quanta.append(pairing.quantum)
    return epochs


def run(
    blocks: Iterable[ImuBlock],
    samples: OdometerSamples,
    settings_: OdometerConfig | None = None,
    delay_s: float = 0.0,
) -> list[Paired]:
    """With the odometer ahead."""
    pairing = Pairing(config() if settings_ is None else settings_)
    pairing.add_odometer(samples)
    for block in blocks:
        pairing.add_imu(block)
    return take(pairing, delay_s)


def seconds(epoch: Paired) -> Array:
    return (epoch.block.stamp_ns - T0) * 1e-9


def lengths(epochs: list[Paired]) -> Array:
    return np.array([np.ptp(seconds(e)) for e in epochs])


def check_tiling(epochs: list[Paired], stamp_ns: IntArray) -> None:
    """Every IMU sample is in one epoch, those between two epochs in both."""
    joined = np.concatenate([e.block.stamp_ns[1:] for e in epochs])
    np.testing.assert_array_equal(joined, stamp_ns[1 : joined.shape[0] + 1])
    for before, after in pairwise(epochs):
        assert before.block.stamp_ns[-1] == after.block.stamp_ns[0]
    for epoch in epochs:
        t = seconds(epoch)
        assert t.shape[0] >= 3
        np.testing.assert_array_equal(epoch.block.w_ib_b, t + np.arange(3.0)[:, None])
        np.testing.assert_array_equal(epoch.block.f_ib_b, t - np.arange(3.0)[:, None])
        assert epoch.distance is None or epoch.distance.shape == t.shape
        assert (epoch.speed is None) == (epoch.distance is None)


def errors(epochs: list[Paired]) -> Array:
    """Of the displacements over the epochs [m]."""
    known = [(seconds(e)[[0, -1]], e.distance) for e in epochs if e.distance is not None]
    return np.array([S[-1] - S[0] - np.diff(driven(t))[0] for t, S in known])


# Without an odometer


@pytest.mark.parametrize("rate", [10, 100, 200, 1000])
def test_without_odometer_epochs_last_a_second(rate: int) -> None:
    stamps = imu_stamps(20, rate)
    pairing = Pairing(None)
    for block in blocks_of(stamps):
        pairing.add_imu(block)
    epochs = take(pairing)
    assert len(epochs) == 20
    check_tiling(epochs, stamps)
    np.testing.assert_allclose(lengths(epochs), 1.0)
    assert all(e.distance is None and e.variance == 0.0 for e in epochs)
    assert pairing.quantum == 0.0 and pairing.track is None


def test_without_odometer_nothing_waits() -> None:
    pairing = Pairing(None)
    for block in blocks_of(imu_stamps(5, 100)):
        pairing.add_imu(block)
        assert len(take(pairing)) == 1


def test_odometer_samples_without_use_are_ignored() -> None:
    pairing = Pairing(None)
    pairing.add_odometer(regular_odometer(10, 20))
    pairing.add_imu(blocks_of(imu_stamps(1, 100))[0])
    assert take(pairing)[0].distance is None


def test_a_silent_odometer_is_waited_for_and_no_longer() -> None:
    pairing = Pairing(config(odom_timeout_s=2.0))
    count = 0
    for k, block in enumerate(blocks_of(imu_stamps(20, 100)), 1):
        pairing.add_imu(block)
        count += len(take(pairing))
        assert count == max(k - 2, 0)


# Where epochs end


@pytest.mark.parametrize("rate", [5.0, 20.0, 100.0])
def test_a_fast_odometer_gives_epochs_of_a_second(rate: float) -> None:
    stamps = imu_stamps(60, 200)
    epochs = run(blocks_of(stamps), regular_odometer(70, rate, -0.013))
    check_tiling(epochs, stamps)
    assert len(epochs) >= 58
    assert np.abs(lengths(epochs)[:-1] - 1.0).max() <= 0.5 / rate + 0.005
    assert all(e.distance is not None for e in epochs[1:])
    assert np.abs(errors(epochs)).max() < 1e-3


@pytest.mark.parametrize("imu_rate", [10, 200])
def test_a_slow_odometer_cuts_the_epochs(imu_rate: int) -> None:
    samples = regular_odometer(70, 1.0, 0.37)
    stamps = imu_stamps(60, imu_rate)
    epochs = run(blocks_of(stamps), samples)
    check_tiling(epochs, stamps)
    ends = np.array([seconds(e)[-1] for e in epochs[2:]])
    after = (ends - 0.37) % 1.0
    assert (after > 1.0 - 1.0 / imu_rate - 1e-6).all() or (after < 1e-6).all()
    assert all(e.distance is not None for e in epochs[2:])
    assert np.abs(errors(epochs[2:])).max() < (0.02 if imu_rate == 10 else 1e-3)


@pytest.mark.parametrize("step", [0.7, 0.99, 1.0, 1.1, 1.4])
def test_a_slow_odometer_is_met_whatever_its_phase(step: float) -> None:
    stamps = imu_stamps(20, 50)
    for phase in np.arange(0.0, 1.0, 0.03):
        samples = odometer(phase - 3.0 + step * np.arange(40.0))
        epochs = run(blocks_of(stamps), samples)
        missed = [k for k, e in enumerate(epochs) if e.distance is None]
        assert len(missed) <= (2 if step > 1.1 else 0), phase


def test_a_slow_odometer_whose_clock_drifts() -> None:
    t = 0.2 + np.arange(130.0)
    samples = odometer(t)
    samples = OdometerSamples(
        samples.stamp_ns + np.rint(4e6 * t[1:]).astype(np.int64), samples.speed, samples.variance
    )
    stamps = imu_stamps(120, 100)
    pairing = Pairing(config())
    epochs: list[Paired] = []
    pairing.add_odometer(samples)
    for block in blocks_of(stamps):
        pairing.add_imu(block)
        delay = 0.0 if not epochs else 0.004 * seconds(epochs[-1])[-1]
        epochs += take(pairing, delay)
    check_tiling(epochs, stamps)
    assert all(e.distance is not None for e in epochs[2:])
    assert np.abs(errors(epochs[2:])).max() < 0.1


@pytest.mark.parametrize("late_s", [-0.3, 0.1, 0.73, 4.0])
@pytest.mark.parametrize("rate", [1.0, 20.0])
def test_stamps_that_are_late_by_a_known_time(rate: float, late_s: float) -> None:
    stamps = imu_stamps(40, 200)
    epochs = run(blocks_of(stamps), regular_odometer(60, rate, -1.0, late_s), delay_s=late_s)
    check_tiling(epochs, stamps)
    assert len(epochs) >= 37
    assert all(e.distance is not None for e in epochs)
    assert np.abs(errors(epochs)).max() < 1e-3
    for epoch in epochs:
        assert epoch.speed is not None
        t = seconds(epoch)
        true = 8.0 + 6.0 * np.cos(0.3 * t) - 2.1 * np.sin(0.7 * t)
        assert np.abs(epoch.speed - true).max() < (0.3 if rate == 1.0 else 2e-3)


def test_ends_at_stamps_that_agree_but_for_rounding() -> None:
    """IMU and odometer stamps coincide, shifted by a delay that is no round number."""
    for late_s in (0.1, 0.3, 1.0 / 3.0):
        stamps = imu_stamps(40, 200)
        samples = regular_odometer(60, 1.0, -1.0, late_s)
        epochs = run(blocks_of(stamps), samples, delay_s=late_s)
        np.testing.assert_allclose(lengths(epochs), 1.0, atol=1e-9)
        assert np.abs(errors(epochs)).max() < 1e-7


def test_displacements_add_up() -> None:
    stamps = imu_stamps(60, 100)
    for rate in (1.0, 7.3, 20.0):
        epochs = run(blocks_of(stamps), regular_odometer(70, rate, -0.6))
        known = [e for e in epochs if e.distance is not None]
        total = sum(float(e.distance[-1] - e.distance[0]) for e in known if e.distance is not None)
        ends = np.array([seconds(known[0])[0], seconds(known[-1])[-1]])
        assert total == pytest.approx(np.diff(driven(ends))[0], abs=0.05)
        for before, after in pairwise(known):
            assert before.distance is not None and after.distance is not None
            assert before.distance[-1] == pytest.approx(after.distance[0], abs=1e-9)


def test_no_distance_before_the_first_sample() -> None:
    epochs = run(blocks_of(imu_stamps(20, 100)), regular_odometer(30, 20.0, 5.5))
    known = [e.distance is not None for e in epochs]
    assert known == [False] * known.index(True) + [True] * (len(known) - known.index(True))
    # The epoch before ends where the track begins, so that no more is lost.
    assert seconds(epochs[known.index(True)])[0] == pytest.approx(5.55)


def test_a_dropout_and_what_follows() -> None:
    samples = regular_odometer(60, 20.0, -1.0)
    t = (samples.stamp_ns - T0) * 1e-9
    samples = samples.select((t < 20.3) | (t > 30.42))
    stamps = imu_stamps(50, 100)
    epochs = run(blocks_of(stamps), samples)
    check_tiling(epochs, stamps)
    for epoch in epochs:
        a, b = seconds(epoch)[[0, -1]]
        assert (epoch.distance is None) == (b > 20.25 and a < 30.4 - 1e-6)
    assert np.abs(errors(epochs)).max() < 1e-3
    assert lengths(epochs).max() < EPOCH_S + LONGER_S + 0.01
    assert lengths(epochs).min() > EPOCH_S - SHORTER_S - 0.01


def test_short_holes_are_bridged_with_a_variance() -> None:
    samples = regular_odometer(40, 20.0, -1.0)
    t = (samples.stamp_ns - T0) * 1e-9
    epochs = run(blocks_of(imu_stamps(30, 100)), samples.select((t < 10.41) | (t > 10.62)))
    doubt = [e.variance for e in epochs]
    assert doubt[10] == pytest.approx(0.2**4, rel=1e-6)
    assert sum(doubt) == doubt[10]
    assert all(e.distance is not None for e in epochs)


def test_variances_of_the_samples_add_up() -> None:
    samples = odometer(np.arange(-1.0, 40.0, 0.05), variance=0.04)
    epochs = run(blocks_of(imu_stamps(30, 100)), samples)
    np.testing.assert_allclose([e.variance for e in epochs], 20 * 0.04 * 0.05**2, rtol=1e-6)


def test_lost_imu_samples() -> None:
    rng = RNG(4)
    stamps = imu_stamps(60, 100)
    keep = rng.random(stamps.shape[0]) > 0.1
    keep[::100] = True
    keep[2050:2090] = False
    stamps = stamps[keep]
    for rate in (1.0, 20.0):
        epochs = run(blocks_of(stamps), regular_odometer(80, rate, -1.27))
        check_tiling(epochs, stamps)
        assert all(e.distance is not None for e in epochs)
        assert np.abs(errors(epochs)).max() < 0.1
        assert lengths(epochs).min() > EPOCH_S - SHORTER_S - 0.41


def test_an_imu_that_is_slow_as_well() -> None:
    stamps = imu_stamps(60, 2)
    epochs = run(blocks_of(stamps), regular_odometer(80, 20.0, -1.0))
    check_tiling(epochs, stamps)
    assert np.abs(errors(epochs)).max() < 1e-3


def test_a_clock_set_back_costs_some_epochs_only() -> None:
    samples = regular_odometer(60, 20.0, -1.0)
    back = OdometerSamples(
        np.where(
            samples.stamp_ns > T0 + 30 * SECOND, samples.stamp_ns - 5 * SECOND, samples.stamp_ns
        ),
        samples.speed,
        samples.variance,
    )
    pairing = Pairing(config())
    epochs: list[Paired] = []
    for k, block in enumerate(blocks_of(imu_stamps(55, 100))):
        when = (samples.stamp_ns > T0 + (k - 1) * SECOND) & (samples.stamp_ns <= T0 + k * SECOND)
        pairing.add_odometer(back.select(when))
        pairing.add_imu(block)
        epochs += take(pairing, 0.0 if k < 31 else -5.0)
    missing = [seconds(e)[0] for e in epochs[2:] if e.distance is None]
    assert len(missing) < 5
    assert all(27.0 < t < 32.0 for t in missing)


# What is left over


def test_the_pending_block_begins_where_the_last_epoch_ended() -> None:
    stamps = imu_stamps(10, 100)
    pairing = Pairing(config())
    assert pairing.pending_block() is None
    pairing.add_odometer(regular_odometer(9, 1.0, 0.4))
    last = stamps[0]
    for block in blocks_of(stamps):
        pairing.add_imu(block)
        for epoch in take(pairing):
            last = epoch.block.stamp_ns[-1]
        pending = pairing.pending_block()
        assert pending is not None
        assert (pending.stamp_ns[0], pending.stamp_ns[-1]) == (last, block.stamp_ns[-1])
        np.testing.assert_array_equal(pending.w_ib_b[0], (pending.stamp_ns - T0) * 1e-9)


def test_what_is_given_out_is_not_shared() -> None:
    pairing = Pairing(None)
    for block in blocks_of(imu_stamps(3, 100)):
        pairing.add_imu(block)
    first = pairing.next(0.0)
    assert first is not None
    first.block.w_ib_b[:] = np.nan
    second = pairing.next(0.0)
    assert second is not None
    assert np.isfinite(second.block.w_ib_b).all()
    assert first.block.w_ib_b.flags.c_contiguous


def test_memory_is_bounded() -> None:
    pairing = Pairing(config(odom_timeout_s=2.0))
    samples = regular_odometer(300, 20.0)
    for k, block in enumerate(blocks_of(imu_stamps(300, 50))):
        pairing.add_odometer(samples.select(slice(20 * k, 20 * k + 20)))
        pairing.add_imu(block)
        take(pairing)
        assert pairing._stamp_ns.shape[0] <= 6 * 50
    assert pairing.track is not None
    assert pairing.track.knots.shape[0] < 600


# Order of arrival


def fingerprint(epochs: list[Paired]) -> list[tuple[object, ...]]:
    return [
        (
            *(part.tobytes() for part in e.block),
            None if e.distance is None else e.distance.tobytes(),
            None if e.speed is None else e.speed.tobytes(),
            e.variance,
        )
        for e in epochs
    ]


Run = tuple[list[Paired], list[float]]


def feed(
    blocks: list[ImuBlock],
    samples: OdometerSamples,
    settings_: OdometerConfig,
    late_s: float,
    rng: np.random.Generator,
) -> Run:
    """Odometer samples in chunks, before the IMU's block that ends `late_s` after them."""
    pairing = Pairing(settings_)
    epochs: list[Paired] = []
    quanta: list[float] = []
    begin = 0
    for block in blocks:
        end = int(np.searchsorted(samples.stamp_ns, block.stamp_ns[-1] - late_s * 1e9, "right"))
        end = max(end, begin)
        cuts = np.unique(np.concatenate(([begin, end], rng.integers(begin, end + 1, 3))))
        for a, b in pairwise(cuts.tolist()):
            pairing.add_odometer(samples.select(slice(a, b)))
            if rng.random() < 0.5:
                epochs += take(pairing, 0.123, quanta)
        begin = end
        pairing.add_imu(block)
        if rng.random() < 0.8:
            epochs += take(pairing, 0.123, quanta)
    epochs += take(pairing, 0.123, quanta)
    return epochs, quanta


@given(
    rate=st.sampled_from([1.0, 5.0, 10.0, 20.0, 100.0]),
    late_s=st.sampled_from([-100.0, -10.0, -1.0, 0.0, 0.2]),
    messy=st.booleans(),
    quantum=st.sampled_from([float("nan"), 0.01]),
    seed=st.integers(0, 10000),
)
@settings(max_examples=80, deadline=None)
def test_order_of_arrival_does_not_matter(
    rate: float, late_s: float, messy: bool, quantum: float, seed: int
) -> None:
    rng = RNG(seed)
    t = -1.0 + np.arange(round(35 * rate)) / rate
    if messy and rate > 1.0:
        t += rng.uniform(-0.4, 0.4, t.shape[0]) / rate
    samples = odometer(t, 0.1)
    step = 0.02 * rate
    samples.speed[:] = step * np.round(samples.speed / step)
    if messy and rate > 1.0:
        # Samples lost, outliers, and a dropout of some seconds.
        samples.speed[rng.random(len(samples)) < 0.02] += 15.0
        at = T0 + round(rng.uniform(5.0, 20.0) * 1e9)
        gone = (samples.stamp_ns > at) & (samples.stamp_ns < at + 6 * SECOND)
        samples = samples.select(~gone & (rng.random(len(samples)) > 0.05))
    blocks = blocks_of(imu_stamps(30, 50))
    set_ = config(odometer_quantum_m=quantum)
    ahead, at_once = feed(blocks, samples, set_, -1000.0, rng)
    other, late = feed(blocks, samples, set_, late_s, rng)
    assert len(other) >= 26
    size = min(len(ahead), len(other))
    assert fingerprint(ahead)[:size] == fingerprint(other)[:size]
    assert at_once[:size] == late[:size]
    if rate in (10.0, 20.0) and not messy and quantum != 0.01:
        assert at_once[0] == 0.1 and at_once[-1] == pytest.approx(0.02)


def test_an_odometer_that_is_too_late_is_not_waited_for() -> None:
    samples = regular_odometer(40, 20.0, -1.0)
    blocks = blocks_of(imu_stamps(30, 50))
    epochs, _ = feed(blocks, samples, config(), 5.0, RNG(1))
    assert len(epochs) >= 27
    assert all(e.distance is None for e in epochs)
