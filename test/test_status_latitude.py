"""What a latitude that is wrong, or in doubt, does to the status."""

from __future__ import annotations

import pytest
from completed_estimates import COMPLETION, HOLD_S, LATITUDE, estimate, expecting, having, status_of

from sins_align.grades import ImuGrade
from sins_align.reasons import LATITUDE_DOUBTED
from sins_align.status import Completer, Expectation
from sins_align.types import Advance, Estimate, LatitudeEstimate, State
from sins_align.units import DEG, DEG_PER_H


def at_latitude(off: float, sigma: float) -> Estimate:
    return having(latitude=LatitudeEstimate(LATITUDE + off, sigma))


@pytest.mark.parametrize(
    ("check", "state", "keys"),
    [
        ("warn", State.ALIGNED, ("latitude_differs",)),
        ("fail", State.FAILED, ("latitude_wrong",)),
        ("off", State.ALIGNED, ()),
    ],
)
def test_what_a_wrong_latitude_does(check: str, state: State, keys: tuple[str, ...]) -> None:
    status = status_of(at_latitude(1.0 * DEG, 0.01 * DEG), expecting(latitude_check=check))
    assert (status.state, status.keys) == (state, keys)
    if keys:
        assert "latitude is 40.000 deg" in status.reason
        assert "41.000 deg (sigma 0.010)" in status.reason
        assert "latitude_deg" in status.remedy


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("sigma_deg", "bound_deg"),
    [(0.1, 0.5), (1.0, 5.0), (0.001, 0.1)],  # five sigma, but a tenth of a degree at least
)
def test_when_a_latitude_is_wrong(sign: float, sigma_deg: float, bound_deg: float) -> None:
    expectation = expecting(latitude_check="fail")
    for share, state in ((0.999, State.ALIGNED), (1.001, State.FAILED)):
        found = at_latitude(sign * share * bound_deg * DEG, sigma_deg * DEG)
        assert status_of(found, expectation).state is state


def test_without_a_position_no_latitude_is_wrong() -> None:
    expectation = Expectation(ImuGrade(), None, latitude_check="fail")
    assert status_of(at_latitude(1.0, 1e-6), expectation).state is State.ALIGNED
    assert status_of(having(latitude=None), expecting(latitude_check="fail")).findings == ()


@pytest.mark.parametrize("check", ["warn", "fail", "off"])
@pytest.mark.parametrize("bias_deg_h", [0.005, 0.02])
def test_whom_a_doubted_latitude_stops(check: str, bias_deg_h: float) -> None:
    """Gyros of navigation grade, or whoever asks for it; with other thresholds at run time too."""
    grade = ImuGrade(gyro_bias=bias_deg_h * DEG_PER_H)
    expectation = expecting(latitude_check="warn")._replace(grade=grade)
    doubt = (LATITUDE_DOUBTED(ratio=4.0, sigma_deg=0.1),)
    completer = Completer(COMPLETION, expectation)
    completer.set_completion(COMPLETION, check)
    step = Advance(0, estimate(), doubt)
    completer.update(step, 0.0)
    stops = check == "fail" or (check == "warn" and bias_deg_h < 0.01)
    status = completer.update(step, HOLD_S)
    assert (status.state is State.ALIGNED, status.keys) == (
        not stops,
        ("latitude_doubted",) if stops else (),
    )
    waiting = completer.update(Advance(0, None, doubt), HOLD_S + 1.0)
    assert ("latitude_doubted" in waiting.keys) == (check != "off")
