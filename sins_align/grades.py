"""Noise grades of inertial measurement units, by name from `config/imu_grades.yaml`."""

from __future__ import annotations

import dataclasses
import math
import numbers
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import yaml

from sins_align.config_path import shipped_config
from sins_align.units import ARCSEC, DEG_PER_H, DEG_PER_SQRT_H, MICRO_G, PPM


class ConfigError(ValueError):
    """A configuration that cannot be used; the message is one line and names the key."""


@dataclass(frozen=True)
class ImuGrade:
    """Error model of an IMU: 1 sigma per axis, or spectral density; SI.

    gyro_bias [rad/s], gyro_arw [rad/sqrt(s)], gyro_bias_instability [rad/s] of a
    first-order Gauss-Markov process with gyro_bias_correlation_s [s],
    accel_bias [m/s^2], accel_vrw [m/s/sqrt(s)], gyro_scale and accel_scale [1],
    misalignment [rad], each off-diagonal element of either triad.
    """

    gyro_bias: float = 0.0
    gyro_arw: float = 0.0
    gyro_bias_instability: float = 0.0
    accel_bias: float = 0.0
    accel_vrw: float = 0.0
    gyro_scale: float = 0.0
    accel_scale: float = 0.0
    misalignment: float = 0.0
    gyro_bias_correlation_s: float = 300.0

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not 0.0 <= value < float("inf"):
                raise ConfigError(f"{field.name}: {value} is not a finite number >= 0")
        if self.gyro_bias_correlation_s == 0.0:
            raise ConfigError("gyro_bias_correlation_s: 0 is not a correlation time")


# YAML key -> (field, unit): the only place where a grade's units are converted.
GRADE_KEYS: dict[str, tuple[str, float]] = {
    "gyro_bias_deg_h": ("gyro_bias", DEG_PER_H),
    "gyro_arw_deg_sqrt_h": ("gyro_arw", DEG_PER_SQRT_H),
    "gyro_bias_instability_deg_h": ("gyro_bias_instability", DEG_PER_H),
    "accel_bias_ug": ("accel_bias", MICRO_G),
    "accel_vrw_ug_sqrt_hz": ("accel_vrw", MICRO_G),
    "gyro_scale_ppm": ("gyro_scale", PPM),
    "accel_scale_ppm": ("accel_scale", PPM),
    "misalignment_arcsec": ("misalignment", ARCSEC),
}


def as_number(key: str, value: object) -> float:
    """`value` as a float.

    Raises
    ------
    ConfigError : it is no number
    """
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise ConfigError(f"{key}: {value!r} is not a number")
    try:
        return float(value)
    except OverflowError:
        return -math.inf if value < 0 else math.inf


def grade_from_values(values: Mapping[str, object], base: ImuGrade | None = None) -> ImuGrade:
    """The grade that `values` (YAML keys, YAML units) describe, on top of `base`.

    Raises
    ------
    ConfigError : for an unknown key or a value that is no finite number >= 0
    """
    changes: dict[str, float] = {}
    for key, value in values.items():
        if key not in GRADE_KEYS:
            raise ConfigError(f"{key}: unknown key; known are {', '.join(GRADE_KEYS)}")
        number = as_number(key, value)
        if not 0.0 <= number < float("inf"):
            raise ConfigError(f"{key}: {value} is not a finite number >= 0")
        field, unit = GRADE_KEYS[key]
        changes[field] = number * unit
    return dataclasses.replace(base if base is not None else ImuGrade(), **changes)


@lru_cache(maxsize=1)
def _shipped_grades() -> dict[str, ImuGrade]:
    path = shipped_config("imu_grades.yaml")
    table = yaml.safe_load(path.read_text(encoding="utf-8"))
    grades = {}
    for name, values in table.items():
        try:
            grades[name] = grade_from_values(values)
        except ConfigError as error:
            raise ConfigError(f"{path}: {name}: {error}") from None
    return grades


def grade_names() -> tuple[str, ...]:
    """The names that `load_grade` knows."""
    return tuple(_shipped_grades())


def load_grade(name: str) -> ImuGrade:
    """The shipped grade of that name.

    Raises
    ------
    ConfigError : no such grade
    """
    grades = _shipped_grades()
    if name not in grades:
        raise ConfigError(f"imu_grade: no grade {name!r}; known are {', '.join(grades)}")
    return grades[name]
