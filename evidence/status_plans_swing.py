"""What a run of `swing_align` is, by its number."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from evidence.status_plans import (
    IMU_FAULTS,
    Dice,
    Draft,
    draw_common,
    draw_faults,
    impulse,
    make_plan,
)
from evidence.status_runs import Plan
from sins_align.simulate import SCENARIOS, SwingOptions

DURATION_S = (300.0, 420.0)
LEVER_SIGMA_M = 2.0
WEAK = "weak"
KINDS = (*SCENARIOS, WEAK)


def swing_plan(number: int) -> Plan:
    """The run of that number."""
    dice = Dice(1, number)
    draft = draw_common(dice, DURATION_S)
    draft.scenario = scenario = dice.one_of(KINDS)
    draft.options["scenario"] = scenario
    if scenario == WEAK:
        # Between too weak to tell the lever arm and too weak for it to disturb.
        swing = dice.size(0.02, 1.0)
        draft.options["scenario"] = replace(
            SCENARIOS["level"], name=WEAK, amplitude_deg=(swing, swing, swing)
        )
        draft.scenario = f"{WEAK} {swing:.2f} deg"
    draft.options["lever_arm_m"] = dice.normal(LEVER_SIGMA_M)
    draft.parameters["lever_arm_prior_sigma_m"] = LEVER_SIGMA_M
    return make_plan(draft, number, SwingOptions, draw_faults(draft, FAULTS))


def _heave(draft: Draft) -> str:
    size, period = draft.dice.size(0.0005, 0.1), draft.dice.size(2.0, 150.0)
    draft.options.update(heave_m=size, heave_period_s=period)
    return f"{1e3 * size:.1f} mm, {period:.0f} s"


def _sway(draft: Draft) -> str:
    size, period = draft.dice.size(0.0005, 0.1), draft.dice.size(2.0, 150.0)
    azimuth = draft.dice.between(0.0, 180.0)
    draft.options.update(sway_m=size, sway_period_s=period, sway_azimuth_deg=azimuth)
    return f"{1e3 * size:.1f} mm, {period:.0f} s, along {azimuth:.0f} deg"


def _lever(draft: Draft) -> str:
    sigma, ratio = draft.dice.size(0.02, 1.0), draft.dice.size(2.0, 10.0)
    r_b = draft.options["lever_arm_m"]
    off = [ratio * sigma * draft.dice.sign() for _ in r_b]
    draft.parameters["lever_arm_prior_m"] = [r + e for r, e in zip(r_b, off, strict=True)]
    draft.parameters["lever_arm_prior_sigma_m"] = sigma
    return f"{ratio:.1f} times its sigma of {sigma:.2f} m"


def _turn(draft: Draft) -> str:
    dice = draft.dice
    angle, begin = dice.between(-180.0, 180.0), draft.moment()
    duration = dice.between(5.0, 40.0)
    draft.options.update(turn_deg=angle, turn_start_s=begin, turn_duration_s=duration)
    return f"{angle:.0f} deg at {begin:.0f} s in {duration:.0f} s"


def _drive_off(draft: Draft) -> str:
    """The vehicle drives somewhere else, and stops there."""
    dice = draft.dice
    begin, distance, duration = draft.moment(), dice.size(1.0, 300.0), dice.between(5.0, 60.0)
    draft.options.update(
        drive_m=distance,
        drive_start_s=begin,
        drive_duration_s=duration,
        drive_azimuth_deg=dice.between(0.0, 360.0),
    )
    return f"{distance:.0f} m at {begin:.0f} s in {duration:.0f} s"


FAULTS: Mapping[str, Any] = {
    **IMU_FAULTS,
    "heave": _heave,
    "sway": _sway,
    "lever arm": _lever,
    "turn": _turn,
    "impulse": impulse,
    "drive off": _drive_off,
}
