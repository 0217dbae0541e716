"""One code path for live and replay: what it makes of what a vehicle sends."""

from __future__ import annotations

import dataclasses
import functools
import math
import tracemalloc
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sins_align.config import SwingConfig, swing_config
from sins_align.session import Session
from sins_align.simulate import SwingOptions, simulate_swing
from sins_align.soundness import is_sound
from sins_align.types import (
    Advance,
    Estimate,
    ImuBlock,
    ImuSamples,
    ImuSampling,
    Position,
    State,
    Update,
)
from sins_align.units import DEG

SECOND = 1_000_000_000
LATITUDE_DEG = 40.0
POSITION = Position(LATITUDE_DEG * DEG)
OPTIONS = SwingOptions(
    duration_s=30.0, rate_hz=100.0, grade="fog", seed=3, latitude_deg=LATITUDE_DEG
)
CONFIG = swing_config({"latitude_deg": LATITUDE_DEG, "imu_grade": "fog"})
METHODS = pytest.mark.parametrize("method", ["inertial", "paper"])


@functools.cache
def imu(**changes: object) -> ImuSamples:
    samples = simulate_swing(dataclasses.replace(OPTIONS, **changes)).imu
    for array in samples:
        array.flags.writeable = False  # the tests share them
    return samples


def copied(samples: ImuSamples) -> ImuSamples:
    return ImuSamples(*(x.copy() for x in samples))


def config(**changes: object) -> SwingConfig:
    return swing_config({"latitude_deg": LATITUDE_DEG, "imu_grade": "fog", **changes})


def short_paper() -> SwingConfig:
    return config(method="paper", level_phase_s=5.0, switch_times_s=[3.0, 8.0])


def config_of(method: str) -> SwingConfig:
    return short_paper() if method == "paper" else CONFIG


def shifted(samples: ImuSamples, by_ns: int) -> ImuSamples:
    return ImuSamples(samples.stamp_ns + by_ns, samples.w_ib_b, samples.f_ib_b)


def joined(*parts: ImuSamples) -> ImuSamples:
    return ImuSamples(
        np.concatenate([p.stamp_ns for p in parts]),
        np.concatenate([p.w_ib_b for p in parts], axis=1),
        np.concatenate([p.f_ib_b for p in parts], axis=1),
    )


def run(samples: ImuSamples, settings_: SwingConfig = CONFIG) -> tuple[Session, list[Update]]:
    session = Session(settings_)
    return session, session.add_imu(samples)


def numbers(estimate: Estimate | None) -> tuple[object, ...]:
    """Every bit of an estimate."""
    if estimate is None:
        return ()
    lever_arm = estimate.lever_arm
    return (
        estimate.stamp_ns,
        *(
            getattr(estimate, name).tobytes()
            for name in (
                "q_nb", "misalignment_covariance", "gyro_bias", "gyro_bias_sigma", "accel_bias",
                "accel_bias_sigma",
            )
        ),
        repr(estimate.consistency),
        *(() if lever_arm is None else (lever_arm.r_b.tobytes(), lever_arm.covariance.tobytes())),
    )  # fmt: skip


def trace(updates: list[Update]) -> list[tuple[object, ...]]:
    return [(u.stamp_ns, numbers(u.estimate), u.status) for u in updates]


def assert_add_up(session: Session, handed_over: int) -> None:
    counts = session.counts
    assert counts.imu_samples + counts.imu_rejected == handed_over
    assert min(counts.rejected.values()) >= 0


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


# -- gaps, clocks, slow sensors


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


# -- positions


def test_before_a_position_samples_are_counted_and_no_more() -> None:
    settings_ = swing_config({"imu_grade": "fog"})
    session, updates = run(imu(duration_s=5.0), settings_)
    assert not updates
    assert session.estimate is None and session.conclusion is None
    assert (session.status.state, session.status.reason) == (State.WAITING, "no latitude")
    assert "latitude_deg" in session.status.remedy
    assert session.counts.imu_samples == 501
    session.set_position(POSITION)
    assert session.position == POSITION
    rest = imu().select(slice(501, None))
    session.add_imu(rest)
    expected, _ = run(rest)
    assert numbers(session.estimate) == numbers(expected.estimate) != ()
    assert session.restarts == 0


def test_the_first_position_counts() -> None:
    session = Session(swing_config({"imu_grade": "fog"}))
    session.set_position(POSITION)
    session.add_imu(imu().select(slice(0, 2000)))
    before = numbers(session.estimate)
    session.set_position(Position(0.1))
    assert session.position == POSITION
    assert numbers(session.estimate) == before != ()


def test_a_configured_position_is_not_overruled_by_a_fix() -> None:
    session = Session(CONFIG)
    session.set_position(Position(-0.3))
    assert session.position is not None
    assert session.position.latitude == POSITION.latitude


@pytest.mark.parametrize(
    "position",
    [Position(math.nan), Position(1.6), Position(-1.6), Position(math.inf),
     Position(0.1, math.nan), Position(0.1, 0.0, math.inf)],
)  # fmt: skip
def test_no_position_on_the_earth(position: Position) -> None:
    session = Session(swing_config())
    with pytest.raises(ValueError, match="not a position"):
        session.set_position(position)
    assert session.position is None


@pytest.mark.parametrize("latitude_deg", [90.0, -90.0, 89.9])
def test_at_the_pole_there_is_no_heading_and_no_crash(latitude_deg: float) -> None:
    session, _ = run(imu(), config(latitude_deg=latitude_deg))
    assert session.status.state in (State.COARSE, State.FAILED)
    assert session.status.remedy
    assert session.conclusion is None


def test_without_a_position_memory_does_not_grow() -> None:
    session = Session(swing_config())
    samples = imu()
    tracemalloc.start()
    sizes = []
    for k in range(12):
        for at in range(0, 3000, 50):
            session.add_imu(shifted(samples.select(slice(at, at + 50)), k * 30 * SECOND))
        sizes.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert session.counts.imu_samples == 36_000
    # 36,000 samples are 2 MB; an open block is 6 kB.
    assert sizes[-1] - sizes[2] < 50_000


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


# -- wrong calls


def wrong_arrays() -> dict[str, ImuSamples]:
    stamps, w, f = imu().select(slice(0, 10))
    return {
        "stamp_ns: an array of int64": ImuSamples(stamps * 1e-9, w, f),  # type: ignore[arg-type]
        "stamp_ns: an array of int64 is expected, not uint64": ImuSamples(
            stamps.astype(np.uint64),
            w,
            f,  # type: ignore[arg-type]
        ),
        "stamp_ns: an array of int64 is expected, not list": ImuSamples(stamps.tolist(), w, f),
        "stamp_ns: shape": ImuSamples(stamps[:, None], w, f),
        "stamp_ns: shape \\(N,\\)": ImuSamples(np.array(5), w, f),
        "w_ib_b: an array of float64": ImuSamples(stamps, w.astype(np.float32), f),  # type: ignore[arg-type]
        "w_ib_b: an array of float64 is expected, not int64": ImuSamples(stamps, w.astype(int), f),
        "w_ib_b: shape": ImuSamples(stamps, w.T, f),
        "w_ib_b: shape \\(3, 10\\) is expected, not \\(3, 9\\)": ImuSamples(stamps, w[:, 1:], f),
        "f_ib_b: shape": ImuSamples(stamps, w, f[0]),
        "f_ib_b: an array of float64 is expected, not NoneType": ImuSamples(stamps, w, None),  # type: ignore[arg-type]
    }


@pytest.mark.parametrize("message", wrong_arrays())
def test_wrong_arrays_are_refused_at_the_door(message: str) -> None:
    session = Session(CONFIG)
    with pytest.raises(ValueError, match=message):
        session.add_imu(wrong_arrays()[message])
    assert_add_up(session, 0)


def test_no_samples_at_all() -> None:
    session, updates = run(imu().select(slice(0, 0)))
    assert not updates
    assert session.status.reason == "no IMU data"


# -- an estimator that breaks down


class Broken:
    """An aligner whose numbers go wrong after some blocks."""

    made = 0
    singular = False

    def __init__(self, _: object, __: object) -> None:
        Broken.made += 1
        self._count = 0
        self._stamp_ns = 0

    def update(self, block: ImuBlock) -> list[Advance]:
        self._count += 1
        self._stamp_ns = int(block.stamp_ns[-1])
        if self.singular and self._count == 3:
            raise np.linalg.LinAlgError("not positive definite")
        return [Advance(self._stamp_ns, self.estimate)]

    @property
    def estimate(self) -> Estimate:
        bad = self._count == 3
        zero = np.zeros(3)
        covariance = 1e-8 * np.eye(3)
        covariance[2, 2] = math.nan if bad else 1e-8
        q_nb = np.array([1.0, 0.0, 0.0, 0.0])
        return Estimate(self._stamp_ns, q_nb, covariance, zero, zero, zero, zero)

    def propagate(self, _: ImuBlock) -> Estimate:
        return self.estimate

    conclude = propagate


@pytest.mark.parametrize("singular", [False, True])
def test_an_estimate_that_breaks_down_is_never_shown(
    monkeypatch: pytest.MonkeyPatch, singular: bool
) -> None:
    monkeypatch.setattr("sins_align.aligners.make_aligner", Broken)
    monkeypatch.setattr(Broken, "singular", singular)
    Broken.made = 0
    session, updates = run(imu(duration_s=7.0))
    states = [u.status.state for u in updates]
    assert states[2] is states[5] is State.FAILED
    assert ("positive definite" if singular else "broke down") in updates[2].status.reason
    assert updates[2].status.remedy
    assert all(u.estimate is None or is_sound(u.estimate) for u in updates)
    assert Broken.made == 3
    assert session.estimate is not None


def test_what_is_sound() -> None:
    good = Broken(None, None).estimate
    assert is_sound(good)
    for P in (np.diag([1.0, 1.0, -1e-30]), np.diag([1.0, math.inf, 1.0])):
        assert not is_sound(dataclasses.replace(good, misalignment_covariance=P))
    assert not is_sound(dataclasses.replace(good, q_nb=np.full(4, math.nan)))


@pytest.mark.parametrize(
    ("factor", "key", "size", "helps"),
    [
        (0.0, "gravity_removed", "0 m/s^2", "gravity included"),
        (1.0 / 9.80665, "force_in_g", "in g, not in m/s^2", "multiply by 9.80665"),
        (0.5, "gravity_removed", "4.87 m/s^2", "gravity included"),
        (2.0, "force_size", "19.5 m/s^2", "units and scale"),
    ],
)
def test_a_force_that_is_not_gravity_is_told(
    factor: float, key: str, size: str, helps: str
) -> None:
    """In g, with gravity removed, or doubled: refused by name, and never an attitude."""
    samples = imu(duration_s=20.0)
    wrong = ImuSamples(samples.stamp_ns, samples.w_ib_b, factor * samples.f_ib_b)
    session, updates = run(wrong)
    assert session.estimate is None
    assert updates and all(u.status.state is State.FAILED for u in updates)
    assert all(u.status.keys == (key,) for u in updates)
    assert size in session.status.reason and helps in session.status.remedy
    assert "gravity" in session.status.reason + session.status.remedy
    # Mended on the way, it begins by itself.
    session.add_imu(shifted(imu(), 20 * SECOND + 10_000_000))
    assert session.status.state in (State.COARSE, State.FINE)
    assert session.estimate is not None


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
