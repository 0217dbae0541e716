"""What a run of `odo_align` is, by its number."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from evidence.status_plans import (
    IMU_FAULTS,
    Dice,
    Draft,
    draw_common,
    draw_faults,
    make_plan,
)
from evidence.status_runs import Plan
from sins_align.config import odo_config
from sins_align.odo.odometer_model import GRADIENT_SIGMA
from sins_align.simulate import VehicleOptions
from sins_align.units import DEG

DURATION_S = (300.0, 400.0)
KINDS = ("ring", "figure8", "urban", "moving_start", "static", "straight")
# A vehicle that turns learns its gyros' biases, and gets below the limit of one that does not.
TURNING, BELOW_LIMIT = ("ring", "figure8", "urban", "moving_start"), 0.5
# No heading is shown above 3 deg.
MOST_THRESHOLD_ARCMIN = 150.0


def odo_plan(number: int) -> Plan:
    """The run of that number."""
    dice = Dice(2, number)
    draft = draw_common(dice, DURATION_S)
    draft.scenario = draft.options["scenario"] = dice.one_of(KINDS)
    threshold = draft.parameters["heading_threshold_arcmin"]
    if draft.scenario in TURNING:
        threshold *= dice.size(BELOW_LIMIT, 1.0)
    draft.parameters["heading_threshold_arcmin"] = min(threshold, MOST_THRESHOLD_ARCMIN)
    if draft.scenario == "static" and dice.happens(0.5):
        draft.scenario, draft.parameters["aiding"] = "static, no odometer", "stationary"
    _draw_odometer(draft)
    return make_plan(draft, number, VehicleOptions, draw_faults(draft, FAULTS))


def _draw_odometer(draft: Draft) -> None:
    """As uncertain as is declared, where nothing else is said: by the defaults."""
    dice, declared = draft.dice, odo_config({}).odometer
    pitch, yaw, _ = dice.normal(declared.mounting_sigma / DEG)
    draft.options["mounting_rpy_deg"] = (0.0, pitch, yaw)
    lever = declared.lever_arm_sigma * dice.normal(1.0)
    draft.options["odometer_lever_arm_m"] = tuple(lever.tolist())
    # A stamp is late and never early.
    draft.options["odometer_latency_s"] = abs(dice.normal(declared.latency_sigma)[0])
    draft.options["odometer_scale_sigma"] = declared.scale_sigma
    draft.options["direction_noise_deg"] = declared.direction_sigma / DEG
    sideslip, suspension, _ = dice.normal(GRADIENT_SIGMA / DEG)
    draft.options["sideslip_deg_per_m_s2"] = sideslip
    draft.options["suspension_pitch_deg_per_m_s2"] = suspension


def _slip(draft: Draft) -> str:
    count, share = int(draft.dice.size(1.0, 30.0)), draft.dice.size(0.02, 1.0) * draft.dice.sign()
    length = draft.dice.size(0.5, 20.0)
    draft.options.update(slip_count=count, slip_fraction=share, slip_duration_s=length)
    return f"{count} times {100.0 * share:+.0f} % for {length:.1f} s"


def _outliers(draft: Draft) -> str:
    draft.options["outlier_fraction"] = share = draft.dice.size(0.001, 0.05)
    return f"{100.0 * share:.1f} %"


def _stuck(draft: Draft) -> str:
    begin, length = draft.moment(), draft.dice.size(1.0, 60.0)
    draft.options["stuck"] = ((begin, length),)
    return f"{length:.0f} s at {begin:.0f} s"


def _dropout(draft: Draft) -> str:
    begin, length = draft.moment(), draft.dice.size(1.0, 60.0)
    draft.options["dropouts"] = ((begin, length),)
    return f"{length:.0f} s at {begin:.0f} s"


def _latency(draft: Draft) -> str:
    draft.options["odometer_latency_s"] = latency = draft.dice.between(0.15, 0.6)
    return f"{latency:.2f} s"


def _clock(draft: Draft) -> str:
    drift = draft.dice.size(1e-6, 1e-3) * draft.dice.sign()
    draft.options["odometer_clock_drift"] = drift
    return f"{1e6 * drift:+.0f} ppm"


def _mounting(draft: Draft) -> str:
    pitch, yaw = (draft.dice.between(-5.0, 5.0) for _ in range(2))
    draft.options["mounting_rpy_deg"] = (0.0, pitch, yaw)
    return f"{pitch:+.1f}, {yaw:+.1f} deg"


def _lever(draft: Draft) -> str:
    draft.options["odometer_lever_arm_m"] = r_b = draft.dice.normal(2.5)
    return " ".join(f"{x:+.1f}" for x in r_b) + " m"


def _reverse(draft: Draft) -> str:
    before, draft.options["scenario"] = draft.scenario, "reverse"
    draft.parameters["aiding"] = "odometer"
    return f"instead of {before}"


def _scale_step(draft: Draft) -> str:
    at_s, change = draft.moment(), draft.dice.size(0.002, 0.1) * draft.dice.sign()
    draft.options["scale_step"] = (at_s, change)
    return f"{100.0 * change:+.1f} % at {at_s:.0f} s"


def _scale(draft: Draft) -> str:
    draft.options["odometer_scale_error"] = e = draft.dice.size(0.03, 0.5) * draft.dice.sign()
    return f"{100.0 * e:+.0f} %"


def _opposite(draft: Draft) -> str:
    draft.more["is_opposite"] = True
    return "all the time"


FAULTS: Mapping[str, Any] = {
    **IMU_FAULTS,
    "slip": _slip,
    "outliers": _outliers,
    "stuck": _stuck,
    "dropout": _dropout,
    "latency": _latency,
    "odometer's clock": _clock,
    "mounting": _mounting,
    "odometer's lever arm": _lever,
    "reverse": _reverse,
    "scale step": _scale_step,
    "scale": _scale,
    "opposite sign": _opposite,
}
