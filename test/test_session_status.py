"""What a session says on the way from waiting to aligned, and for how long it will be."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest

from sins_align.config import SwingConfig, swing_config
from sins_align.ros.eta import EtaClock
from sins_align.session import Session
from sins_align.simulate import SwingOptions, simulate_swing
from sins_align.types import Estimate, ImuSamples, State, Update
from sins_align.units import DEG

SECOND = 1_000_000_000


def swing(**changes: object) -> ImuSamples:
    options = {"grade": "rlg", "duration_s": 30.0, "rate_hz": 50.0, "seed": 3, **changes}
    return simulate_swing(SwingOptions(**options)).imu


@functools.cache
def laser() -> ImuSamples:
    """A minute and a half of a swing that gets aligned."""
    samples = swing(duration_s=90.0)
    for array in samples:
        array.flags.writeable = False  # the tests share them
    return samples


def laser_config(**changes: object) -> SwingConfig:
    return swing_config({"latitude_deg": 40.0, "imu_grade": "rlg", "hold_s": 5.0, **changes})


def run(samples: ImuSamples, settings: SwingConfig) -> tuple[Session, list[Update]]:
    session = Session(settings)
    return session, session.add_imu(samples)


def shifted(samples: ImuSamples, by_ns: int) -> ImuSamples:
    return ImuSamples(samples.stamp_ns + by_ns, samples.w_ib_b, samples.f_ib_b)


def numbers(estimate: Estimate | None) -> tuple[object, ...]:
    """Every bit of attitude and covariance."""
    if estimate is None:
        return ()
    P, q = estimate.misalignment_covariance, estimate.q_nb
    return estimate.stamp_ns, q.tobytes(), P.tobytes(), estimate.gyro_bias.tobytes()


def trace(updates: list[Update]) -> list[tuple[object, ...]]:
    return [(u.stamp_ns, numbers(u.estimate), u.status) for u in updates]


def test_states_in_their_order() -> None:
    """The levels before heading, heading before two degrees of it, and those before the hold."""
    session, updates = run(laser(), laser_config(level_threshold_arcsec=10.0))
    assert (updates[0].status.state, updates[0].estimate) == (State.WAITING, None)
    assert updates[0].status.keys == ("levelling",)
    states = list(dict.fromkeys(u.status.state for u in updates))
    assert states == [State.WAITING, State.COARSE, State.FINE, State.ALIGNED]
    order = [states.index(u.status.state) for u in updates]
    assert order == sorted(order)
    known = [u.estimate is not None for u in updates]
    assert known == sorted(known)
    assert State.WAITING not in {u.status.state for u in updates if u.estimate is not None}
    aligned = session.status
    assert aligned.aligned_at_s is not None
    first = next(u for u in updates if u.status.keys == ("holding",))
    assert aligned.aligned_at_s - first.status.elapsed_s >= 5.0


def test_before_the_levels_are_known_it_waits() -> None:
    session, updates = run(laser().select(slice(0, 52)), laser_config())
    assert len(updates) == 1
    assert (session.status.state, session.status.keys) == (State.WAITING, ("levelling",))
    assert session.estimate is None


def test_the_time_to_go() -> None:
    """Foretold to the length of a cycle, which is 15 % of the time; then the hold runs down."""
    settings = laser_config(heading_threshold_arcmin=4.0)
    whole, updates = run(laser(), settings)
    assert whole.status.state is State.ALIGNED and whole.eta_s == 0.0
    aligned_at_s = whole.status.aligned_at_s
    below = [u.status.elapsed_s for u in updates if u.status.keys == ("holding",)]
    assert aligned_at_s is not None and below[0] > 30.0
    session = Session(settings)
    assert math.isnan(session.eta_s)
    seen = {}
    for second in range(90):
        session.add_imu(laser().select(slice(50 * second, 50 * second + 50)))
        seen[second] = session.eta_s
    assert math.isnan(seen[0])
    for second in (20, 25, 30):
        assert seen[second] + second == pytest.approx(aligned_at_s, rel=0.2)
    assert seen[30] < seen[25] < seen[20]
    # Below: what is left is the hold, to the end of a cycle, and known to the second.
    soon = math.ceil(below[0]) + 1
    assert seen[soon] + soon == pytest.approx(aligned_at_s, abs=1.5)
    assert seen[89] == 0.0


def test_no_time_to_go_where_it_cannot_be_said() -> None:
    assert math.isnan(Session(swing_config()).eta_s)
    failed, _ = run(swing(rate_hz=5.0), laser_config())
    assert failed.status.state is State.FAILED and math.isnan(failed.eta_s)
    restarted, _ = run(laser(), laser_config())
    restarted.restart()
    assert math.isnan(restarted.eta_s)
    # What standing never reaches, it does not promise.
    never, _ = run(swing(scenario="still"), laser_config(heading_threshold_arcmin=0.01))
    assert never.eta_s == math.inf


def test_no_time_to_go_while_a_doubt_stands() -> None:
    """Sigma would be small enough soon; when what contradicts it goes nobody knows."""
    right, _ = run(laser(), laser_config(heading_threshold_arcmin=1.5))
    assert "heading_sigma" in right.status.keys and 0.0 < right.eta_s < 600.0
    wrong, _ = run(laser(), laser_config(heading_threshold_arcmin=1.5, latitude_deg=41.0))
    assert "latitude_doubted" in wrong.status.keys and math.isnan(wrong.eta_s)


def test_no_time_to_go_where_a_level_is_out_of_reach() -> None:
    """Heading is there at last, and what is left is not the hold."""
    settings = laser_config(level_threshold_arcsec=0.5, heading_threshold_arcmin=20.0)
    still = swing(scenario="still", duration_s=60.0)
    for seconds in (20, 60):
        session, _ = run(still.select(slice(0, 50 * seconds)), settings)
        assert "level_limit" in session.status.keys and math.isnan(session.eta_s)


def session_alone_with(key: str, samples: ImuSamples, settings: SwingConfig) -> Session:
    """At the last update before aligned at which nothing else was waited for."""
    session, updates = run(samples, settings)
    assert session.status.keys == () and session.eta_s == 0.0
    alone = [u.stamp_ns for u in updates if u.status.keys == (key,)][-1]
    return run(samples.select(samples.stamp_ns <= alone), settings)[0]


def test_no_time_to_go_where_heading_waits_for_something_else() -> None:
    settings = laser_config(heading_threshold_arcmin=200.0, latitude_check="off")
    session = session_alone_with("unproven", swing(scenario="pitch", duration_s=60.0), settings)
    assert session.status.keys == ("unproven",) and math.isnan(session.eta_s)


def test_the_time_to_go_where_heading_waits_for_the_latitude() -> None:
    """To a cycle, which is 15 % of the time."""
    settings = laser_config(heading_threshold_arcmin=20.0, level_threshold_arcsec=100.0)
    still = swing(scenario="still", duration_s=60.0)
    session = session_alone_with("latitude_unproven", still, settings)
    aligned_at_s = run(still, settings)[0].status.aligned_at_s
    assert session.status.keys == ("latitude_unproven",) and aligned_at_s is not None
    left_s = aligned_at_s - session.status.elapsed_s
    assert session.eta_s == pytest.approx(left_s, abs=0.15 * aligned_at_s)


def test_a_time_that_was_told_does_not_outlive_what_makes_it_void() -> None:
    """A clock that asks now and then asks at once where something else is said."""
    samples = laser()
    session, clock = Session(laser_config(heading_threshold_arcmin=1.5)), EtaClock()
    session.add_imu(samples.select(slice(0, 2001)))
    assert 0.0 < clock.eta_s(session) < 600.0
    after = samples.select(slice(2001, 2201))
    session.add_imu(ImuSamples(after.stamp_ns, after.w_ib_b, np.zeros_like(after.f_ib_b)))
    assert session.status.state is State.FAILED and math.isnan(clock.eta_s(session))


def test_a_clock_counts_down_in_between() -> None:
    session, clock = Session(laser_config(heading_threshold_arcmin=1.5)), EtaClock()
    session.add_imu(laser().select(slice(0, 2001)))
    first, then_s = clock.eta_s(session), session.status.elapsed_s
    for k in range(2001, 2501, 50):
        session.add_imu(laser().select(slice(k, k + 50)))
    passed = session.status.elapsed_s - then_s
    assert passed > 0.0 and clock.eta_s(session) == pytest.approx(first - passed, rel=0.1)


def test_a_forecast_that_breaks_down_breaks_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    def break_down(*_: object) -> float:
        raise np.linalg.LinAlgError

    session, _ = run(laser().select(slice(0, 1001)), laser_config())
    monkeypatch.setattr("sins_align.swing.inertial.time_to", break_down)
    assert math.isnan(session.eta_s)


def test_asking_for_the_time_to_go_changes_nothing() -> None:
    whole, expected = run(laser(), laser_config())
    asked = Session(laser_config())
    found = []
    for k in range(0, len(laser()), 137):
        found += asked.add_imu(laser().select(slice(k, k + 137)))
        first = asked.eta_s
        assert repr(asked.eta_s) == repr(first)
    assert trace(found) == trace(expected)
    assert numbers(asked.conclusion) == numbers(whole.conclusion) != ()


def test_other_thresholds_lose_nothing() -> None:
    """From the next step on, and as if they had been there before."""
    narrow = laser_config(latitude_check="off")
    wide = laser_config(latitude_check="off", heading_threshold_arcmin=1000.0)
    session = Session(narrow)
    before = session.add_imu(laser().select(slice(0, 1451)))
    assert before[-1].status.state is State.FINE and "heading_sigma" in before[-1].status.keys
    session.set_completion(wide.completion)
    assert session.config.completion == wide.completion
    assert session.eta_s < 10.0
    after = session.add_imu(laser().select(slice(1451, None)))
    expected, updates = run(laser(), narrow)
    assert [numbers(u.estimate) for u in (*before, *after)] == [
        numbers(u.estimate) for u in updates
    ]
    assert after[0].status.keys == ("holding",)
    aligned = [s.status.aligned_at_s for s in (session, expected)]
    assert aligned[0] is not None and aligned[1] is not None and aligned[0] < aligned[1]
    session.set_completion(laser_config(heading_threshold_arcmin=1e-3).completion)
    assert session.status.state is State.ALIGNED  # no step, no change
    session.restart()
    session.add_imu(shifted(laser(), 1000 * SECOND))
    assert session.status.state is State.FINE  # kept over a restart


def test_a_hint_of_the_units_reaches_the_status() -> None:
    """y of the gyros turned against the accelerometers': said, and never aligned."""
    samples = laser()
    turned = samples.w_ib_b * np.array([[1.0], [-1.0], [1.0]])
    wrong = ImuSamples(samples.stamp_ns, turned, samples.f_ib_b)
    session, updates = run(wrong, laser_config())
    assert "axes_differ" in session.status.keys
    assert "axes and signs" in session.status.remedy
    assert State.ALIGNED not in {u.status.state for u in updates}


@pytest.mark.parametrize(
    ("check", "state"),
    [("warn", State.FINE), ("fail", State.FAILED), ("off", State.FINE)],
)
def test_a_wrong_latitude(check: str, state: State) -> None:
    """By a degree: a word, failed, or not looked at; but no gyro has such a bias."""
    samples = swing(duration_s=150.0)
    wrong = laser_config(
        latitude_deg=41.0, latitude_check=check, heading_threshold_arcmin=600.0,
        level_threshold_arcsec=6000.0, gyro_bias_deg_h=0.03,
    )  # fmt: skip
    session, _ = run(samples, wrong)
    keys = {"warn": "latitude_differs", "fail": "latitude_wrong"}
    for name, key in keys.items():
        assert (key in session.status.keys) == (check == name)
    estimate = session.estimate
    assert estimate is not None and estimate.latitude is not None
    assert abs(estimate.latitude.latitude / DEG - 40.0) < 0.5
    assert session.status.state is state
    assert "bias_beyond" in session.status.keys
