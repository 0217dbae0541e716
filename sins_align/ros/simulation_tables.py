"""The simulators' settings as parameters: field of the options -> parameter of `align_synth`.

Without its unit (_s) and with hyphens the parameter's name is the option of `align_simulate`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from sins_align.grades import grade_names
from sins_align.parameters import NAN, Parameter
from sins_align.simulate import SCENARIOS, VEHICLE_SCENARIOS

Table = Mapping[str, Parameter]

_LIMIT = 1e9


def _number(
    name: str, default: float, description: str, *, low: float = -_LIMIT, high: float = _LIMIT
) -> Parameter:
    return Parameter(name, default, description, low=low, high=high)


def _positive(name: str, default: float, description: str) -> Parameter:
    return Parameter(name, default, description, low=0.0, high=_LIMIT)


def _part(name: str, description: str) -> Parameter:
    return Parameter(name, 0.0, description, low=0.0, high=0.99)


def _list(name: str, default: list[float], description: str, length: int | None) -> Parameter:
    return Parameter(name, default, description, low=-_LIMIT, high=_LIMIT, length=length)


_COMMON: Table = {
    "scenario": Parameter("scenario", "pitch", "how the base moves", choices=tuple(SCENARIOS)),
    "grade": Parameter("grade", "rlg", "grade of the IMU", choices=grade_names()),
    "seed": Parameter("seed", 0, "of everything random", low=0, high=2**53),
    "rate_hz": Parameter("rate", 200.0, "samples per second", low=0.1, high=1e5),
    "duration_s": Parameter("duration_s", 420.0, "of the run [s]", low=0.01, high=1e6),
    "latitude_deg": Parameter("latitude_deg", 40.0, "north positive", low=-90.0, high=90.0),
    "longitude_deg": Parameter("longitude_deg", 116.0, "east positive", low=-180.0, high=180.0),
    "altitude_m": Parameter("altitude_m", 50.0, "above the ellipsoid", low=-1e3, high=2e4),
    "sampling": Parameter(
        "sampling", "instantaneous", "what a sample stands for", choices=("mean", "instantaneous")
    ),
    "lost_fraction": _part("lost", "part of the samples that is lost"),
    "stamp_jitter_s": Parameter(
        "jitter_s", 0.0, "jitter of the stamps, 1 sigma [s]", low=0.0, high=1.0
    ),
}

SWING_TABLE: Table = {
    **_COMMON,
    "lever_arm_m": _list(
        "lever_arm_m", [NAN] * 3, "swing centre to IMU, forward, left, up [m]; NaN: the paper's", 3
    ),
    "heading_deg": _number("heading_deg", 0.0, "turns the whole scenario clockwise"),
    "turn_deg": _number("turn_deg", 0.0, "the base is turned once by this, clockwise"),
    "turn_start_s": _positive("turn_start_s", NAN, "when [s]; NaN: in the middle"),
    "turn_duration_s": _number("turn_duration_s", 20.0, "how long that takes [s]", low=1e-3),
    "heave_m": _positive("heave_m", 0.0, "vertical motion of the swing centre, amplitude"),
    "heave_period_s": _number("heave_period_s", 6.0, "its period [s]", low=1e-3),
    "sway_m": _positive("sway_m", 0.0, "the same horizontally"),
    "sway_period_s": _number("sway_period_s", 9.0, "its period [s]", low=1e-3),
    "sway_azimuth_deg": _number(
        "sway_azimuth_deg", 90.0, "its direction, clockwise from north"
    ),
    "drive_m": _positive("drive_m", 0.0, "the swing centre drives so far once, and stops"),
    "drive_start_s": _positive("drive_start_s", NAN, "when [s]; NaN: in the middle"),
    "drive_duration_s": _number("drive_duration_s", 30.0, "how long that takes [s]", low=1e-3),
    "drive_azimuth_deg": _number("drive_azimuth_deg", 0.0, "where to, clockwise from north"),
    "drive_shake_m_s2": _positive(
        "drive_shake_m_s2", 0.0, "vibration by the road in the drive, 1 sigma [m/s^2]"
    ),
}  # fmt: skip


def _with_default(field: str, default: Any, **changes: Any) -> dict[str, Parameter]:
    return {field: replace(_COMMON[field], default=default, **changes)}


VEHICLE_TABLE: Table = {
    **_COMMON,
    **_with_default(
        "scenario", "urban", description="how the vehicle drives", choices=tuple(VEHICLE_SCENARIOS)
    ),
    **_with_default("grade", "fog"),
    **_with_default("duration_s", 600.0),
    "heading_deg": _number(
        "heading_deg", NAN, "course at the start, clockwise from north; NaN: random"
    ),
    "ground_roll_deg": _number(
        "ground_roll_deg", NAN, "tilt of the ground there, right side down; NaN: random"
    ),
    "ground_pitch_deg": _number("ground_pitch_deg", NAN, "the same, nose down; NaN: random"),
    "mounting_rpy_deg": _list(
        "mounting_rpy_deg", [0.0] * 3, "vehicle's axes in the IMU's: roll, pitch, yaw", 3
    ),
    "sideslip_deg_per_m_s2": _number(
        "sideslip_deg_per_m_s2", 0.15, "heading inwards of the course, per lateral acceleration"
    ),
    "suspension_roll_deg_per_m_s2": _number(
        "suspension_roll_deg_per_m_s2", 0.3, "outwards, per lateral acceleration"
    ),
    "suspension_pitch_deg_per_m_s2": _number(
        "suspension_pitch_deg_per_m_s2", 0.2, "nose up, per forward acceleration"
    ),
    "road_motion_deg": _positive("road_motion_deg", 0.1, "rms of roll and pitch when driving"),
    "direction_noise_deg": _positive(
        "direction_noise_deg", 0.05, "rms of the direction of travel in the vehicle's axes"
    ),
    "standing_motion_arcsec": _positive(
        "standing_motion_arcsec", 5.0, "rms about each axis when standing"
    ),
    "odometer_rate_hz": _number(
        "odometer_rate_hz", 20.0, "odometer: samples per second", low=0.01, high=1e4
    ),
    "odometer_lever_arm_m": _list(
        "odometer_lever_arm_m", [0.0] * 3, "odometer: from the IMU to it, forward, left, up [m]", 3
    ),
    "odometer_scale_error": _number(
        "odometer_scale_error", NAN, "odometer: measured over true distance, minus 1; NaN: random",
        low=-0.99,
    ),
    "odometer_scale_sigma": _positive(
        "odometer_scale_sigma", 0.01, "odometer: 1 sigma of a random scale error"
    ),
    "scale_step": _list(
        "scale_step", [NAN, NAN], "odometer: at so many seconds the scale changes by so much", 2
    ),
    "odometer_quantum_m": _positive(
        "odometer_quantum_m", 0.01, "odometer: distance of one count; 0: not quantised"
    ),
    "odometer_noise_m_s": _positive(
        "odometer_noise_m_s", 0.0, "odometer: white noise of the speed, 1 sigma [m/s]"
    ),
    "odometer_latency_s": _number(
        "odometer_latency_s", 0.0, "odometer: by how much its stamps are late [s]"
    ),
    "odometer_clock_drift": _number(
        "odometer_clock_drift", 0.0, "odometer: drift of its stamps, seconds per second"
    ),
    "odometer_jitter_s": _positive(
        "odometer_jitter_s", 0.0, "odometer: jitter of its stamps, 1 sigma [s]"
    ),
    "odometer_report_variance": Parameter(
        "odometer_report_variance", False, "odometer: fill in the variance"
    ),
    "unsigned_wheel": Parameter("unsigned_wheel", False, "odometer: counts up in reverse too"),
    "slip_count": Parameter(
        "slip_count", 0, "odometer: so many times the wheel slips", low=0, high=1e6
    ),
    "slip_duration_s": _positive("slip_duration_s", 2.0, "odometer: for so long [s]"),
    "slip_fraction": _number("slip_fraction", 0.5, "odometer: turning too far by this part"),
    "dropouts": _list(
        "dropouts", [], "odometer: no samples; begin and duration [s], one pair after the other",
        None,
    ),
    "stuck": _list("stuck", [], "odometer: speed of 0; as dropouts", None),
    "outlier_fraction": _part("outlier_fraction", "odometer: part of its samples that is wild"),
}  # fmt: skip
