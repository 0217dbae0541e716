"""When an alignment is complete, what an operator is told before, and when it is lost again."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest
from completed_estimates import (
    COMPLETION,
    DECLARED,
    HEADING,
    HOLD_S,
    LATITUDE,
    LEVEL,
    ODOMETER,
    PERFECT,
    POSITION,
    aligned_completer,
    estimate,
    expecting,
    having,
    status_of,
)
from scipy.stats import chi2

from sins_align.config import Completion
from sins_align.consistency import (
    MAX_BIAS_RATIO,
    MAX_CONSISTENCY,
    MAX_DISAGREEMENT,
    MAX_UNSTEADINESS,
    RARE_GYRO_BIAS,
)
from sins_align.earth import EARTH_RATE
from sins_align.grades import ImuGrade
from sins_align.limits import HYSTERESIS
from sins_align.reasons import (
    AT_POLE,
    AXES_DIFFER,
    ESTIMATE_BROKE,
    GYRO_IN_DEGREES,
    LEVELLING,
    REASONS,
    STORED_DROPPED,
    SWING_WEAK,
    UNOBSERVABLE_HERE,
    Kind,
    Reason,
)
from sins_align.status import FINE_HEADING_SIGMA, Completer, Expectation
from sins_align.types import Advance, Estimate, Position, State, Status, Witness
from sins_align.units import DEG

# -- without an estimate


def test_no_estimate_yet() -> None:
    status = Completer(COMPLETION, expecting(HEADING / 2)).update(Advance(0, None), 12.0)
    assert (status.state, status.elapsed_s, status.aligned_at_s) == (State.COARSE, 12.0, None)
    assert status.reason == "heading is not known yet: collecting data (12 s)"
    assert status.remedy == ""
    assert status.heading_limit == pytest.approx(HEADING / 2)
    again = Completer(COMPLETION, PERFECT).update(Advance(0, None), 3.0, "2.0 s without IMU data")
    assert again.reason.endswith("; began anew: 2.0 s without IMU data")
    assert again.keys == ("heading_coarse", "began_anew")


@pytest.mark.parametrize(
    ("kinds", "state"),
    [
        ({Kind.WAIT}, State.WAITING),
        ({Kind.FAULT}, State.FAILED),
        ({Kind.FAULT, Kind.WAIT}, State.FAILED),
        ({Kind.WAIT, Kind.DOUBT, Kind.PROGRESS, Kind.HINT, Kind.NOTE}, State.WAITING),
        ({Kind.DOUBT}, State.COARSE),
        ({Kind.LIMIT}, State.COARSE),
        ({Kind.PROGRESS}, State.COARSE),
        ({Kind.HINT, Kind.NOTE}, State.COARSE),
    ],
)
def test_the_kind_of_a_reason_makes_the_state(kinds: set[Kind], state: State) -> None:
    findings = tuple(Reason(kind.name, kind, f"of {kind}", "", "")() for kind in Kind)
    given = tuple(f for f in findings if f.reason.kind in kinds)
    status = Completer(COMPLETION, PERFECT).update(Advance(0, None, given), 1.0)
    assert status.state is state
    assert status.findings == given


def test_levelling_is_waiting() -> None:
    """Before the levels are known the base may as well not be there."""
    step = Advance(0, None, (LEVELLING(elapsed_s=2.0),))
    status = Completer(COMPLETION, expecting(2.0 * HEADING)).update(step, 2.0)
    assert (status.state, status.keys) == (State.WAITING, ("levelling",))


# -- thresholds and hold


def test_aligned_after_the_hold_and_not_before() -> None:
    completer = Completer(COMPLETION, PERFECT)
    times = [20.0, 25.0, 29.999, 30.0, 31.0]
    found = [completer.update(Advance(0, estimate()), t) for t in times]
    assert [s.state for s in found] == [State.FINE] * 3 + [State.ALIGNED] * 2
    assert found[1].reason == "below the thresholds for 5 of 10 s"
    assert [s.aligned_at_s for s in found] == [None, None, None, 30.0, 30.0]
    assert (found[3].reason, found[3].remedy) == ("", "")
    assert [s.elapsed_s for s in found] == times
    assert completer.held_s(33.0) == 13.0


def test_without_a_hold_at_once() -> None:
    completer = Completer(dataclasses.replace(COMPLETION, hold_s=0.0), PERFECT)
    assert completer.update(Advance(0, estimate()), 5.0).state is State.ALIGNED


@pytest.mark.parametrize("what", ["heading", "east", "north"])
def test_every_threshold_counts(what: str) -> None:
    threshold = HEADING if what == "heading" else LEVEL
    status = status_of(estimate(**{what: 1.01 * threshold}))
    assert status.state is State.FINE
    assert status.keys == ("heading_sigma" if what == "heading" else "level_sigma",)
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
    assert Completer(at, PERFECT).update(Advance(0, found), 1.0).state is State.FINE
    assert Completer(above, PERFECT).update(Advance(0, found), 1.0).state is State.ALIGNED


def test_both_are_named() -> None:
    status = status_of(estimate(heading=0.02, east=0.01))
    assert status.reason == (
        "heading sigma 68.75' not below 6'; level sigma 2062.6\" not below 30\""
    )


def test_sigma_that_rises_again_begins_the_hold_anew() -> None:
    completer = Completer(COMPLETION, PERFECT)

    def state(t: float, factor: float) -> State:
        return completer.update(Advance(0, estimate(heading=factor * HEADING)), t).state

    # Within the hold already by the threshold itself.
    assert [state(t, f) for t, f in ((-9.0, 0.9), (-2.0, 1.1), (0.0, 0.9), (9.9, 0.9))] == (
        [State.FINE] * 4
    )
    assert state(10.0, 0.9) is State.ALIGNED
    assert state(20.0, 1.3) is State.FINE
    assert completer.held_s(20.0) == 0.0
    assert [state(t, 0.9) for t in (21.0, 30.0)] == [State.FINE] * 2
    status = completer.update(Advance(0, estimate()), 31.0)
    assert (status.state, status.aligned_at_s) == (State.ALIGNED, 31.0)


def test_an_estimate_that_goes_away_begins_the_hold_anew() -> None:
    completer = aligned_completer()
    completer.update(Advance(0, None), 11.0)
    assert completer.update(Advance(0, estimate()), 12.0).state is State.FINE
    assert completer.update(Advance(0, estimate()), 22.0).aligned_at_s == 22.0


def test_other_thresholds_from_the_next_step_on() -> None:
    completer = aligned_completer()
    completer.completion = dataclasses.replace(COMPLETION, heading_threshold=HEADING / 2)
    assert completer.update(Advance(0, estimate()), 11.0).keys == ("heading_sigma",)
    completer.completion = COMPLETION
    assert completer.update(Advance(0, estimate()), 12.0).keys == ("holding",)


def test_coarse_and_fine() -> None:
    assert status_of(estimate(heading=math.radians(2.1))).state is State.COARSE
    assert status_of(estimate(heading=math.radians(1.9))).state is State.FINE


# -- hysteresis

# The length of a gyro bias of which the data tell all three components.
ALL_TOLD = math.sqrt(chi2.isf(RARE_GYRO_BIAS, 3))
# What a criterion looks at, so many times its bound.
CRITERIA: dict[str, Callable[[float], Estimate]] = {
    "heading_sigma": lambda k: estimate(heading=k * HEADING),
    "level_sigma east": lambda k: estimate(east=k * LEVEL),
    "level_sigma north": lambda k: estimate(north=k * LEVEL),
    "inconsistent": lambda k: having(consistency=k * MAX_CONSISTENCY),
    "unsteady": lambda k: having(steadiness=k * MAX_UNSTEADINESS),
    "witness_differs": lambda k: having(witness=Witness("x", np.zeros(3), k * MAX_DISAGREEMENT)),
    "bias_beyond gyro": lambda k: having(gyro_bias=np.array([0.0, -k * ALL_TOLD * 1e-6, 0])),
    "bias_beyond accel": lambda k: having(accel_bias=np.array([k * MAX_BIAS_RATIO * 1e-3, 0, 0])),
    "bias_beyond scale": lambda k: having(
        odometer=dataclasses.replace(ODOMETER, scale_error=-k * MAX_BIAS_RATIO * 0.01)
    ),
}


@pytest.mark.parametrize("name", CRITERIA)
def test_aligned_is_left_at_a_wider_bound_than_entered(name: str) -> None:
    at, expectation = CRITERIA[name], expecting(declared=DECLARED)
    key = name.split()[0]
    # Entered at the bound itself ...
    assert status_of(at(0.999), expectation).state is State.ALIGNED
    before = status_of(at(1.001), expectation)
    assert (before.state, before.keys) == (State.FINE, (key,))
    # ... and left at the wider one.
    completer = aligned_completer(expectation)
    inside = completer.update(Advance(0, at(0.999 * HYSTERESIS)), 11.0)
    assert (inside.state, inside.aligned_at_s, inside.findings) == (State.ALIGNED, 10.0, ())
    outside = completer.update(Advance(0, at(1.001 * HYSTERESIS)), 12.0)
    assert (outside.state, outside.keys, outside.aligned_at_s) == (State.FINE, (key,), None)
    # Once left, the bound is the narrow one again.
    assert completer.update(Advance(0, at(1.001)), 13.0).keys == (key,)
    assert completer.update(Advance(0, at(0.999)), 14.0).keys == ("holding",)
    assert completer.update(Advance(0, at(1.001)), 15.0).keys == (key,)


def test_fine_is_left_at_a_wider_bound_than_entered() -> None:
    completer = Completer(COMPLETION, PERFECT)
    states = [
        completer.update(Advance(0, estimate(heading=k * FINE_HEADING_SIGMA)), float(t)).state
        for t, k in enumerate([1.001, 0.999, 1.001, 0.999 * HYSTERESIS, 1.001 * HYSTERESIS, 1.001])
    ]
    assert states == [State.COARSE, *[State.FINE] * 3, *[State.COARSE] * 2]
    # From aligned, too.
    wide = estimate(heading=0.999 * HYSTERESIS * FINE_HEADING_SIGMA)
    assert aligned_completer().update(Advance(0, wide), 11.0).state is State.FINE


def test_the_width_is_a_quarter() -> None:
    assert pytest.approx(1.25) == HYSTERESIS


# -- limits


def test_remedy_where_the_gyro_does_not_allow_the_threshold() -> None:
    status = status_of(estimate(heading=2.0 * HEADING), expecting(1.5 * HEADING, motion="dance"))
    assert status.keys == ("heading_sigma", "heading_limit")
    assert "6' cannot be reached" in status.reason and "the limit is 9.0'" in status.reason
    bias_deg_h = 1.5 * HEADING * EARTH_RATE * math.cos(LATITUDE) / DEG * 3600.0
    assert f"{bias_deg_h:.4f} deg/h" in status.reason
    assert "heading_threshold_arcmin" in status.remedy and "dance" in status.remedy
    assert status_of(estimate(heading=2.0 * HEADING), expecting(0.99 * HEADING)).remedy == ""
    # Turned about, the base gets below the limit: nothing to be mended.
    assert status_of(estimate(), expecting(1.5 * HEADING)).state is State.ALIGNED


def test_the_limit_is_that_of_an_hour() -> None:
    """What the noise leaves open after a minute, time mends; what it leaves after an hour, not."""
    horizontal = EARTH_RATE * math.cos(LATITUDE)
    for hours, keys in ((0.5, ()), (2.0, ("heading_limit",))):
        grade = ImuGrade(gyro_arw=HEADING * horizontal * math.sqrt(hours * 3600.0))
        status = status_of(estimate(heading=2.0 * HEADING), Expectation(grade, POSITION))
        assert status.keys == ("heading_sigma", *keys)
        assert status.heading_limit == pytest.approx(HEADING * math.sqrt(hours * 3600.0 / 11.0))


def test_remedy_is_told_before_there_is_an_attitude() -> None:
    """A gyro of 10 deg/h never gets a coarse heading: not to wait for it in vain."""
    completer = Completer(COMPLETION, expecting(math.radians(50.0)))
    status = completer.update(Advance(0, None), 600.0)
    assert status.state is State.COARSE
    assert "better gyro" in status.remedy


def test_remedy_where_the_accelerometers_do_not_allow_the_threshold() -> None:
    status = status_of(estimate(east=3.0 * LEVEL), expecting(level_limit=2.0 * LEVEL))
    assert status.keys == ("level_sigma", "level_limit")
    assert 'allows 60.0"' in status.reason and "level_threshold_arcsec" in status.remedy
    allowed = status_of(estimate(east=3.0 * LEVEL), expecting(level_limit=0.9 * LEVEL))
    assert allowed.remedy == ""
    both = status_of(estimate(1.0, 1.0), expecting(1.01 * HEADING, 1.01 * LEVEL))
    assert "gyro" in both.remedy and "accelerometer" in both.remedy


def test_remedy_at_the_pole() -> None:
    pole = Expectation(ImuGrade(), Position(math.pi / 2))
    for status in (
        Completer(COMPLETION, pole).update(Advance(0, None), 1.0),
        status_of(estimate(heading=1.0), pole),
    ):
        assert "at_pole" in status.keys and "check latitude_deg" in status.remedy
        assert math.isnan(status.heading_limit)


def test_without_a_position_no_limit_is_claimed() -> None:
    status = status_of(estimate(heading=1.0), Expectation(ImuGrade(gyro_bias=1.0)))
    assert status.keys == ("heading_sigma",)
    assert math.isnan(status.heading_limit)


# -- findings of the aligner, beside an estimate


def test_a_doubt_of_the_aligner_is_not_aligned() -> None:
    doubt = UNOBSERVABLE_HERE(limit_deg=30.0)
    status = status_of(estimate(), findings=(doubt,))
    assert (status.state, status.findings) == (State.FINE, (doubt,))


def test_a_hint_is_given_only_while_something_is_missing() -> None:
    hints = (SWING_WEAK(sigma_m=1.0), AXES_DIFFER(tilt_deg=2.0, left_deg=3.0))
    above = status_of(estimate(heading=2.0 * HEADING), findings=hints)
    assert above.keys == ("heading_sigma", "swing_weak", "axes_differ")
    completer = Completer(COMPLETION, PERFECT)
    holding = completer.update(Advance(0, estimate(), hints), 0.0)
    assert holding.keys == ("holding",)
    below = completer.update(Advance(0, estimate(), hints), HOLD_S)
    assert (below.state, below.findings) == (State.ALIGNED, ())
    # A doubt is no sigma: the hint would not help.
    doubtful = status_of(having(consistency=9.0), findings=hints)
    assert doubtful.keys == ("inconsistent",)


def test_a_note_is_given_beside_aligned() -> None:
    note = STORED_DROPPED(why="gravity has turned")
    status = status_of(estimate(), findings=(note,))
    assert (status.state, status.findings) == (State.ALIGNED, (note,))
    assert "gravity has turned" in status.reason
    both = status_of(estimate(heading=2.0 * HEADING), findings=(note,))
    assert both.keys == ("heading_sigma", "stored_dropped")


def test_a_fault_beside_an_estimate_is_failed() -> None:
    completer = aligned_completer()
    fault = ESTIMATE_BROKE(cause="it is not finite")
    status = completer.update(Advance(0, estimate(heading=2.0 * HEADING), (fault,)), 11.0)
    assert (status.state, status.aligned_at_s) == (State.FAILED, None)
    assert status.keys == ("estimate_broke", "heading_sigma")
    # And the hold begins anew.
    assert completer.update(Advance(0, estimate()), 12.0).keys == ("holding",)
    assert completer.held_s(13.0) == 1.0


# -- texts


def test_what_is_said_twice_is_said_once() -> None:
    a = GYRO_IN_DEGREES(angle_deg=10.0, span_s=20.0, scaled_deg=0.1)
    b = GYRO_IN_DEGREES(angle_deg=20.0, span_s=40.0, scaled_deg=0.2)
    status = Status(State.FAILED, (a, b, a))
    assert status.keys == ("gyro_in_degrees",)
    assert status.reason == f"{a.text}; {b.text}"
    assert status.remedy == a.remedy == b.remedy


def test_the_keys_of_the_table_are_names() -> None:
    keys = [reason.key for reason in REASONS]
    assert len(set(keys)) == len(keys) > 20
    assert all(key.isidentifier() and key == key.lower() for key in keys)


def test_the_pole_is_named_once() -> None:
    """By the aligner and by the thresholds."""
    pole = Expectation(ImuGrade(), Position(math.pi / 2))
    status = Completer(COMPLETION, pole).update(Advance(0, None, (AT_POLE(),)), 1.0)
    assert status.keys == ("at_pole",)
