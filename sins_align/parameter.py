"""One parameter: its type, range and checks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sins_align.grades import ConfigError, as_number

Value = bool | int | float | str | list[float]

NAN = math.nan
BOTH = ("swing_align", "odo_align")


# YAML, and with it a ROS parameter file and `-p`, reads this word as false.
OFF = "off"


@dataclass(frozen=True)
class Parameter:
    """One parameter.

    default : its type is the parameter's type; NaN stands for "not set"
    low, high : inclusive range of a number, or of every element of an array
    length : number of elements of an array, None when free
    runtime : can change while a node runs
    """

    name: str
    default: Value
    description: str
    nodes: tuple[str, ...] = BOTH
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    length: int | None = None
    runtime: bool = False

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
            if value is False and OFF in self.choices:
                value = OFF
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
