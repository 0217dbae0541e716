"""When an alignment is complete, and what an operator is told before."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from sins_align.config import Completion
from sins_align.status import POLE_REMEDY, Completer, Declared
from sins_align.types import Advance, Estimate, OdometerEstimate, State, Status, Witness
from sins_align.units import ARCMIN, ARCSEC

HEADING, LEVEL, HOLD_S = 6.0 * ARCMIN, 30.0 * ARCSEC, 10.0
COMPLETION = Completion(HEADING, LEVEL, HOLD_S)
BELOW = 0.99


def estimate(
    heading: float = BELOW * HEADING, east: float = BELOW * LEVEL, north: float = BELOW * LEVEL
) -> Estimate:
    nothing = np.zeros(3)
    return Estimate(
        stamp_ns=0,
        q_nb=np.array([1.0, 0.0, 0.0, 0.0]),
        misalignment_covariance=np.diag(np.square([east, north, heading])),
        gyro_bias=nothing,
        gyro_bias_sigma=nothing,
        accel_bias=nothing,
        accel_bias_sigma=nothing,
    )


def status_of(found: Estimate | None, limit: float = 0.0, **changes: Any) -> Status:
    """Held long enough."""
    completer = Completer(COMPLETION, **changes)
    completer.update(Advance(0, found), 1.0, limit, "")
    return completer.update(Advance(0, found), 1.0 + HOLD_S, limit, "")


def test_no_estimate_yet() -> None:
    status = Completer(COMPLETION).update(Advance(0, None), 12.0, 0.001, "")
    assert status == Status(
        State.COARSE, "collecting data for the coarse attitude (12 s)", "", 12.0, None, 0.001
    )
    again = Completer(COMPLETION).update(Advance(0, None), 3.0, 0.001, "2.0 s without IMU data")
    assert again.reason.endswith("; began anew: 2.0 s without IMU data")


def test_aligned_after_the_hold_and_not_before() -> None:
    completer = Completer(COMPLETION)
    times = [20.0, 25.0, 29.999, 30.0, 31.0]
    found = [completer.update(Advance(0, estimate()), t, 0.0, "") for t in times]
    assert [s.state for s in found] == [State.FINE] * 3 + [State.ALIGNED] * 2
    assert found[1].reason == "below the thresholds for 5 of 10 s"
    assert [s.aligned_at_s for s in found] == [None, None, None, 30.0, 30.0]
    assert (found[3].reason, found[3].remedy) == ("", "")
    assert [s.elapsed_s for s in found] == times


def test_other_thresholds_count_from_the_next_step_on() -> None:
    completer = Completer(COMPLETION)
    for elapsed_s in (0.0, HOLD_S):
        status = completer.update(Advance(0, estimate()), elapsed_s, 0.0, "")
    assert status.state is State.ALIGNED
    completer.set_completion(Completion(HEADING, LEVEL, 2.0 * HOLD_S))
    status = completer.update(Advance(0, estimate()), 1.5 * HOLD_S, 0.0, "")
    assert (status.state, status.reason) == (State.FINE, "below the thresholds for 15 of 20 s")
    status = completer.update(Advance(0, estimate()), 2.0 * HOLD_S, 0.0, "")
    assert (status.state, status.aligned_at_s) == (State.ALIGNED, 2.0 * HOLD_S)
    completer.set_completion(Completion(0.5 * HEADING, LEVEL, HOLD_S))
    status = completer.update(Advance(0, estimate()), 2.5 * HOLD_S, 0.0, "")
    assert "heading sigma" in status.reason


def test_without_a_hold_at_once() -> None:
    completer = Completer(dataclasses.replace(COMPLETION, hold_s=0.0))
    assert completer.update(Advance(0, estimate()), 5.0, 0.0, "").state is State.ALIGNED


@pytest.mark.parametrize("what", ["heading", "east", "north"])
def test_every_threshold_counts(what: str) -> None:
    threshold = HEADING if what == "heading" else LEVEL
    status = status_of(estimate(**{what: 1.01 * threshold}))
    assert status.state is State.FINE
    assert status.reason.startswith("heading" if what == "heading" else "level")
    assert status.aligned_at_s is None


@pytest.mark.parametrize("what", ["heading", "east", "north"])
def test_exactly_at_the_threshold_is_not_below(what: str) -> None:
    found = estimate(**{what: HEADING if what == "heading" else LEVEL})
    east, north, heading = (float(s) for s in found.sigma)
    if what == "heading":
        at = Completion(heading, LEVEL, 0.0)
        above = Completion(np.nextafter(heading, 1.0), LEVEL, 0.0)
    else:
        at = Completion(HEADING, max(east, north), 0.0)
        above = Completion(HEADING, np.nextafter(max(east, north), 1.0), 0.0)
    assert Completer(at).update(Advance(0, found), 1.0, 0.0, "").state is State.FINE
    assert Completer(above).update(Advance(0, found), 1.0, 0.0, "").state is State.ALIGNED


def test_both_are_named() -> None:
    status = status_of(estimate(heading=0.02, east=0.01))
    assert status.reason == (
        "heading sigma 68.75' not below 6'; level sigma 2062.6\" not below 30\""
    )


def test_sigma_that_rises_again_begins_the_hold_anew() -> None:
    completer = Completer(COMPLETION)

    def state(t: float, factor: float) -> State:
        return completer.update(Advance(0, estimate(heading=factor * HEADING)), t, 0.0, "").state

    assert [state(t, 0.9) for t in (0.0, 10.0)] == [State.FINE, State.ALIGNED]
    assert state(20.0, 1.1) is State.FINE
    assert [state(t, 0.9) for t in (21.0, 30.0)] == [State.FINE] * 2
    status = completer.update(Advance(0, estimate()), 31.0, 0.0, "")
    assert (status.state, status.aligned_at_s) == (State.ALIGNED, 31.0)


def test_an_estimate_that_goes_away_begins_the_hold_anew() -> None:
    completer = Completer(COMPLETION)
    for t in (0.0, 10.0):
        completer.update(Advance(0, estimate()), t, 0.0, "")
    completer.update(Advance(0, None), 11.0, 0.0, "")
    assert completer.update(Advance(0, estimate()), 12.0, 0.0, "").state is State.FINE
    assert completer.update(Advance(0, estimate()), 22.0, 0.0, "").aligned_at_s == 22.0


def test_coarse_and_fine() -> None:
    assert status_of(estimate(heading=math.radians(2.1))).state is State.COARSE
    assert status_of(estimate(heading=math.radians(1.9))).state is State.FINE


def test_remedy_where_the_gyro_does_not_allow_the_threshold() -> None:
    status = status_of(estimate(heading=2.0 * HEADING), limit=1.5 * HEADING)
    assert "allows 9.00'" in status.remedy
    assert "heading_threshold_arcmin" in status.remedy and "turn by 90 deg" in status.remedy
    assert status_of(estimate(heading=2.0 * HEADING), limit=0.99 * HEADING).remedy == ""
    # Turned about, the base gets below the limit: nothing to be mended.
    assert status_of(estimate(), limit=1.5 * HEADING).state is State.ALIGNED


def test_remedy_is_told_before_there_is_an_attitude() -> None:
    """A gyro of 10 deg/h never gets a coarse heading: not to wait for it in vain."""
    status = Completer(COMPLETION).update(Advance(0, None), 600.0, math.radians(50.0), "")
    assert status.state is State.COARSE
    assert "better gyro" in status.remedy


def test_remedy_where_the_accelerometers_do_not_allow_the_threshold() -> None:
    status = status_of(estimate(east=3.0 * LEVEL), level_limit=2.0 * LEVEL)
    assert 'allows 60.0"' in status.remedy and "level_threshold_arcsec" in status.remedy
    assert status_of(estimate(east=3.0 * LEVEL), level_limit=0.9 * LEVEL).remedy == ""
    both = status_of(estimate(1.0, 1.0), limit=HEADING, level_limit=LEVEL)
    assert "gyro" in both.remedy and "accelerometer" in both.remedy


def test_remedy_at_the_pole() -> None:
    assert Completer(COMPLETION).update(Advance(0, None), 1.0, math.nan, "").remedy == POLE_REMEDY
    assert status_of(estimate(heading=1.0), limit=math.nan).remedy == POLE_REMEDY


@pytest.mark.parametrize("what", ["heading", "east", "north"])
def test_not_a_number_is_never_aligned(what: str) -> None:
    status = status_of(estimate(**{what: math.nan}))
    assert status.state in (State.COARSE, State.FINE)
    assert status.reason
    assert status.aligned_at_s is None


def test_innovations_that_do_not_fit_are_not_aligned() -> None:
    found = dataclasses.replace(estimate(), consistency=2.5)
    status = status_of(found, remedy="look")
    assert status.state is not State.ALIGNED
    assert "2.5 times" in status.reason and status.remedy == "look"


def test_a_bias_beyond_the_declared_one_is_not_aligned() -> None:
    found = dataclasses.replace(estimate(), gyro_bias=np.array([0.0, -6e-6, 0.0]))
    assert status_of(found, declared=Declared(gyro_bias=2e-6)).state is State.ALIGNED
    status = status_of(found, declared=Declared(gyro_bias=1e-6))
    assert status.state is not State.ALIGNED
    assert "6.0 times" in status.reason


def test_an_accelerometer_bias_beyond_the_declared_one_is_not_aligned() -> None:
    level = dataclasses.replace(estimate(), accel_bias=np.array([6e-3, 0.0, 0.0]))
    upward = dataclasses.replace(estimate(), accel_bias=np.array([0.0, 0.0, 6e-3]))
    status = status_of(level, declared=Declared(accel_bias=1e-3))
    assert status.state is not State.ALIGNED and "accelerometer bias is 6.0 times" in status.reason
    assert status_of(upward, declared=Declared(accel_bias=1e-3)).state is State.ALIGNED
    assert status_of(level).state is State.ALIGNED


def test_a_scale_error_beyond_the_declared_one_is_not_aligned() -> None:
    """km/h for m/s, say."""
    nothing = np.zeros(3)
    odometer = OdometerEstimate(0.3, 0.01, 0.0, 0.1, nothing, np.eye(3), nothing, np.eye(3))
    found = dataclasses.replace(estimate(), odometer=odometer)
    status = status_of(found, declared=Declared(odometer_scale=0.02))
    assert status.state is not State.ALIGNED and "scale error is 15.0 times" in status.reason
    assert status_of(found, declared=Declared(odometer_scale=0.1)).state is State.ALIGNED


@pytest.mark.parametrize("square", [1.1, 100.0, math.nan])
def test_a_witness_that_says_otherwise(square: float) -> None:
    """Two filters on the same data that differ as if they were independent: one of them lies."""
    phi = np.array([0.0, 0.0, -4.0 * ARCMIN])
    found = dataclasses.replace(estimate(), witness=Witness("wander_kf", phi, square))
    status = status_of(found)
    assert status.state is State.FINE
    assert "wander_kf beside it differs by 4.0' in heading" in status.reason


def test_a_witness_that_agrees() -> None:
    witness = Witness("wander_kf", np.array([0.0, 0.0, 4.0 * ARCMIN]), 0.9)
    assert status_of(dataclasses.replace(estimate(), witness=witness)).state is State.ALIGNED
