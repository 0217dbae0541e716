"""The parameters: one table for YAML, the command line, the node and the README.

Values here keep the unit that their name carries; `sins_align.config` converts them.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from sins_align.grades import GRADE_KEYS, ConfigError, as_number, grade_names

Value = bool | int | float | str | list[float]

NAN = math.nan
WILDCARD = "/**"
BOTH = ("swing_align", "odo_align")
SWING = ("swing_align",)


@dataclass(frozen=True)
class Parameter:
    """One parameter.

    default : its type is the parameter's type; NaN stands for "not set"
    low, high : inclusive range of a number, or of every element of an array
    length : number of elements of an array, None when free
    """

    name: str
    default: Value
    description: str
    nodes: tuple[str, ...] = BOTH
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    length: int | None = None

    def check(self, value: object) -> Value:
        """`value` in the parameter's type.

        Raises
        ------
        ConfigError : wrong type, out of range, not one of the choices; names the key
        """
        if isinstance(self.default, list):
            return self._check_array(value)
        if isinstance(self.default, bool):
            if not isinstance(value, bool):
                raise ConfigError(f"{self.name}: {value!r} is not true or false")
            return value
        if isinstance(self.default, str):
            if not isinstance(value, str):
                raise ConfigError(f"{self.name}: {value!r} is not a text")
            if self.choices and value not in self.choices:
                raise ConfigError(f"{self.name}: {value!r} is not one of {', '.join(self.choices)}")
            return value
        number = self._check_number(value)
        if isinstance(self.default, int):
            if number != int(number):
                raise ConfigError(f"{self.name}: {value!r} is not a whole number")
            return int(number)
        return number

    def _check_number(self, value: object) -> float:
        number = as_number(self.name, value)
        unset = isinstance(self.default, float) and math.isnan(self.default)
        if math.isnan(number) and unset:
            return number
        if not math.isfinite(number) or not self.low <= number <= self.high:
            raise ConfigError(f"{self.name}: {value!r} is outside {self.range_text()}")
        return number

    def _check_array(self, value: object) -> list[float]:
        if isinstance(value, np.ndarray):
            value = value.tolist()
        if not isinstance(value, list | tuple):
            raise ConfigError(f"{self.name}: {value!r} is not a list of numbers")
        if self.length is not None and len(value) != self.length:
            raise ConfigError(f"{self.name}: {value!r} has not {self.length} elements")
        return [self._check_number(element) for element in value]

    def range_text(self) -> str:
        """The range in words, '' where there is none."""
        if self.choices:
            return ", ".join(self.choices)
        if math.isinf(self.low) and math.isinf(self.high):
            return "finite numbers" if isinstance(self.default, float | list) else ""
        return f"[{self.low:g}, {self.high:g}]"


def _grade_override(name: str, what: str) -> Parameter:
    return Parameter(name, NAN, f"{what}; NaN: as the grade says", low=0.0, high=1e9)


PARAMETERS: tuple[Parameter, ...] = (
    Parameter("method", "inertial", "estimation method", SWING, choices=("inertial", "paper")),
    Parameter(
        "latitude_deg",
        NAN,
        "geodetic latitude, north positive; NaN: from topic fix",
        low=-90.0,
        high=90.0,
    ),
    Parameter(
        "longitude_deg",
        NAN,
        "longitude, east positive; NaN: from topic fix, else 0",
        low=-180.0,
        high=360.0,
    ),
    Parameter(
        "altitude_m",
        NAN,
        "height above the ellipsoid; NaN: from topic fix, else 0",
        low=-1000.0,
        high=20000.0,
    ),
    Parameter("imu_grade", "rlg", "noise grade, a name in imu_grades.yaml", choices=grade_names()),
    _grade_override("gyro_bias_deg_h", "gyro bias, 1 sigma"),
    _grade_override("gyro_arw_deg_sqrt_h", "angle random walk"),
    _grade_override("gyro_bias_instability_deg_h", "gyro bias instability over 300 s, 1 sigma"),
    _grade_override("accel_bias_ug", "accelerometer bias, 1 sigma"),
    _grade_override("accel_vrw_ug_sqrt_hz", "velocity random walk"),
    Parameter(
        "imu_sampling",
        "instantaneous",
        "what a sample stands for: the mean over the interval that ends at its stamp, or the"
        " instantaneous value",
        choices=("mean", "instantaneous"),
    ),
    Parameter(
        "heading_threshold_arcmin",
        6.0,
        "aligned when sigma of heading is below",
        low=1e-6,
        high=10800.0,
    ),
    Parameter(
        "level_threshold_arcsec",
        30.0,
        "aligned when sigma of both levels is below",
        low=1e-6,
        high=324000.0,
    ),
    Parameter("hold_s", 10.0, "and has been for so long", low=0.0, high=3600.0),
    Parameter("publish_rate_hz", 50.0, "rate of the attitude output", low=0.1, high=1000.0),
    Parameter("nav_frame", "map", "frame_id of the ENU frame"),
    Parameter("result_file", "", "result.json is written here; empty: nowhere"),
    Parameter("executor", "single", "rclpy executor of the node", choices=("single", "events")),
    Parameter(
        "passes",
        3,
        "at most so many backtracking passes over the stored increments",
        low=1,
        high=10,
    ),
    Parameter(
        "lever_arm_prior_m",
        [0.0, 0.0, 0.0],
        "prior of the lever arm, swing centre to IMU, FLU",
        SWING,
        low=-1000.0,
        high=1000.0,
        length=3,
    ),
    Parameter(
        "lever_arm_prior_sigma_m",
        10.0,
        "its 1 sigma per axis; 0: the prior is exact",
        SWING,
        low=0.0,
        high=1000.0,
    ),
    Parameter(
        "position_noise_m",
        0.0005,
        "floor of the swing centre's position noise at each filter step, 1 sigma; it grows"
        " with the innovations",
        SWING,
        low=0.0,
        high=100.0,
    ),
    Parameter(
        "position_walk_m_sqrt_s",
        NAN,
        "random walk of the swing centre; NaN: 0.4 position_noise_m per sqrt(s)",
        SWING,
        low=0.0,
        high=100.0,
    ),
    Parameter(
        "differentiator",
        "eso",
        "paper: source of the angular acceleration",
        SWING,
        choices=("eso", "central"),
    ),
    Parameter(
        "regression",
        "epls",
        "paper: lever arm by least squares with (epls) or without (ls) the misalignment columns",
        SWING,
        choices=("ls", "epls"),
    ),
    Parameter(
        "eso_bandwidth_rad_s",
        NAN,
        "paper: bandwidth of the observer; NaN: 1 / sampling interval, as printed at 1 kHz",
        SWING,
        low=1e-3,
        high=1e5,
    ),
    Parameter(
        "switch_times_s",
        [15.0, 30.0, 70.0],
        "paper: times of the filter's closed-loop switches, counted from the level phase's end",
        SWING,
        low=0.0,
        high=1e5,
    ),
    Parameter(
        "level_phase_s", 120.0, "paper: duration of the level phase", SWING, low=1.0, high=1e5
    ),
    Parameter(
        "initial_rpy_deg",
        [0.0, 0.0, 0.0],
        "paper: attitude it starts from: roll, pitch, yaw of FLU in ENU (REP-103)",
        SWING,
        low=-360.0,
        high=360.0,
        length=3,
    ),
)


def parameters_of(node: str) -> dict[str, Parameter]:
    """The parameters of one node (`swing_align`, `odo_align`), by name."""
    return {p.name: p for p in PARAMETERS if node in p.nodes}


def check_values(node: str, values: Mapping[str, object]) -> dict[str, Value]:
    """`values`, checked, over the defaults of `node`.

    Raises
    ------
    ConfigError : unknown key, wrong type, out of range; names the key
    """
    table = parameters_of(node)
    for key in values:
        if key not in table:
            raise ConfigError(f"{key}: unknown parameter of {node}")
    return {
        name: p.check(values[name]) if name in values else copy.copy(p.default)
        for name, p in table.items()
    }


class _RosYaml(yaml.SafeLoader):
    """YAML with the numbers that ROS reads: to PyYAML alone, 1e-6 is a text."""


_RosYaml.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+$"),
    list("-+.0123456789"),
)


def read_parameter_file(path: Path, node: str) -> dict[str, object]:
    """The values for `node` in a ROS 2 parameter file.

    Sections `node` and `/node` win over `/**` wherever they stand, as in rclpy.

    Raises
    ------
    ConfigError : no such file, no YAML, no section for the node; names the file
    """
    try:
        document: Any = yaml.load(path.read_text(encoding="utf-8"), _RosYaml)
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from None
    except yaml.YAMLError as error:
        raise ConfigError(f"{path}: no valid YAML: {' '.join(str(error).split())}") from None
    if not isinstance(document, dict):
        raise ConfigError(f"{path}: not a ROS 2 parameter file (a map of nodes is expected)")
    sections = [name for name in document if name in (WILDCARD, node, f"/{node}")]
    if not sections:
        raise ConfigError(f"{path}: has no section for {node}")
    values: dict[str, object] = {}
    for section in sorted(sections, key=lambda name: name != WILDCARD):
        content = document[section]
        if not isinstance(content, dict) or set(content) != {"ros__parameters"}:
            raise ConfigError(f"{path}: {section}: 'ros__parameters' is expected, and only that")
        parameters = content["ros__parameters"]
        if not isinstance(parameters, dict | None):
            raise ConfigError(f"{path}: {section}: ros__parameters: a map of names is expected")
        values.update(parameters or {})
    return values


def parse_override(text: str, node: str) -> tuple[str, object]:
    """`name:=value`, as after -p, with the value read as YAML.

    Raises
    ------
    ConfigError : no `:=`, unknown name, or a value that is no YAML
    """
    name, separator, value = text.partition(":=")
    if not separator or not name:
        raise ConfigError(f"-p {text}: name:=value is expected")
    parameter = parameters_of(node).get(name)
    if parameter is None:
        raise ConfigError(f"{name}: unknown parameter of {node}")
    try:
        parsed = yaml.load(value, _RosYaml)
    except yaml.YAMLError:
        raise ConfigError(f"{name}: {value!r} is no valid YAML") from None
    # Without the dot of YAML, nan and inf are texts.
    if isinstance(parsed, str) and isinstance(parameter.default, int | float):
        try:
            parsed = float(parsed)
        except ValueError:
            raise ConfigError(f"{name}: {value!r} is not a number") from None
    return name, parsed


GRADE_OVERRIDES = tuple(key for key in GRADE_KEYS if key in parameters_of("swing_align"))
