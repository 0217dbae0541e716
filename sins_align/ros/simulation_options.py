"""The simulator's settings: one table for `align_simulate` and the node `align_synth`."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from typing import Any

from sins_align.grades import ConfigError, grade_names
from sins_align.parameters import NAN, Parameter
from sins_align.simulate import SCENARIOS, SwingOptions

_LIMIT = 1e9
_MAX_SAMPLES = 50_000_000  # some gigabytes

# Field of SwingOptions -> parameter of align_synth. Without its unit (_s) and with hyphens
# the parameter's name is the option of align_simulate.
_TABLE: dict[str, Parameter] = {
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
    "lever_arm_m": Parameter(
        "lever_arm_m", [NAN] * 3, "swing centre to IMU, forward, left, up [m]; NaN: the paper's",
        low=-_LIMIT, high=_LIMIT, length=3,
    ),
    "heading_deg": Parameter(
        "heading_deg", 0.0, "turns the whole scenario clockwise", low=-_LIMIT, high=_LIMIT
    ),
    "turn_deg": Parameter(
        "turn_deg", 0.0, "the base is turned once by this, clockwise", low=-_LIMIT, high=_LIMIT
    ),
    "turn_start_s": Parameter(
        "turn_start_s", NAN, "when [s]; NaN: in the middle", low=0.0, high=_LIMIT
    ),
    "turn_duration_s": Parameter(
        "turn_duration_s", 20.0, "how long that takes [s]", low=1e-3, high=_LIMIT
    ),
    "heave_m": Parameter(
        "heave_m", 0.0, "vertical motion of the swing centre, amplitude", low=0.0, high=_LIMIT
    ),
    "heave_period_s": Parameter("heave_period_s", 6.0, "its period [s]", low=1e-3, high=_LIMIT),
    "sway_m": Parameter("sway_m", 0.0, "the same horizontally", low=0.0, high=_LIMIT),
    "sway_period_s": Parameter("sway_period_s", 9.0, "its period [s]", low=1e-3, high=_LIMIT),
    "sway_azimuth_deg": Parameter(
        "sway_azimuth_deg", 90.0, "its direction, clockwise from north", low=-_LIMIT, high=_LIMIT
    ),
    "lost_fraction": Parameter("lost", 0.0, "part of the samples that is lost", low=0.0, high=0.99),
    "stamp_jitter_s": Parameter("jitter_s", 0.0, "jitter of the stamps, 1 sigma [s]", low=0.0,
                                high=1.0),
}  # fmt: skip

SIMULATION_PARAMETERS = {parameter.name: parameter for parameter in _TABLE.values()}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Give a parser an option for every parameter of the simulation."""
    for parameter in SIMULATION_PARAMETERS.values():
        default = parameter.default
        array = isinstance(default, list)
        choices = f": {', '.join(parameter.choices)}" if parameter.choices else ""
        unset = array or (isinstance(default, float) and math.isnan(default))
        parser.add_argument(
            "--" + parameter.name.removesuffix("_s").replace("_", "-"),
            dest=parameter.name,
            type=float if array else type(default),
            nargs=3 if array else None,
            default=default,
            metavar=("X", "Y", "Z") if array else parameter.name.rpartition("_")[2].upper(),
            help=parameter.description + choices + ("" if unset else f" (default {default})"),
        )


def swing_options(values: Mapping[str, Any]) -> SwingOptions:
    """What to simulate, from parameter values.

    Raises
    ------
    ConfigError : a value that cannot be simulated; names the parameter
    """
    fields: dict[str, Any] = {}
    for field, parameter in _TABLE.items():
        given = values[parameter.name]
        if given == parameter.default or given is parameter.default:
            value: Any = parameter.default
        else:
            value = parameter.check(given)
        fields[field] = _none_if_unset(value)
    samples = fields["rate_hz"] * fields["duration_s"]
    if samples > _MAX_SAMPLES:
        raise ConfigError(f"duration_s: {samples:g} samples, at most {_MAX_SAMPLES:g} are made")
    try:
        return SwingOptions(**fields)
    except ValueError as error:
        raise ConfigError(str(error)) from None


def _none_if_unset(value: Any) -> Any:
    elements = value if isinstance(value, list) else [value]
    if any(isinstance(element, float) and math.isnan(element) for element in elements):
        return None
    return value
