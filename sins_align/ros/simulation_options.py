"""What can be simulated: one description for `align_simulate` and the node `align_synth`."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from sins_align.grades import ConfigError
from sins_align.parameters import Parameter, parameters_of
from sins_align.ros.simulation_tables import SWING_TABLE, VEHICLE_TABLE, Table
from sins_align.simulate import (
    SwingOptions,
    SwingRun,
    VehicleOptions,
    VehicleRun,
    simulate_swing,
    simulate_vehicle,
)
from sins_align.types import OdometerSamples, Position
from sins_align.units import DEG

_MAX_SAMPLES = 50_000_000  # some gigabytes
_PAIRS = ("dropouts", "stuck")

Run = SwingRun | VehicleRun


@dataclass(frozen=True)
class Simulation:
    """One kind of simulation.

    node : the aligner that it is for
    what : in words
    table : the settings
    make_options, run_options : those of `sins_align.simulate`
    extra : parameters beside the settings
    """

    node: str
    what: str
    table: Table
    make_options: Callable[..., Any]
    run_options: Callable[[Any], Run]
    extra: tuple[Parameter, ...] = ()

    @property
    def parameters(self) -> dict[str, Parameter]:
        """All parameters by name."""
        return {p.name: p for p in (*self.table.values(), *self.extra)}

    def options(self, values: Mapping[str, Any]) -> Any:
        """What to simulate, from parameter values.

        Raises
        ------
        ConfigError : a value that cannot be simulated; names the parameter
        """
        fields: dict[str, Any] = {}
        for field, parameter in self.table.items():
            given = values[parameter.name]
            if given == parameter.default or given is parameter.default:
                value: Any = parameter.default
            else:
                value = parameter.check(given)
            fields[field] = _pairs(field, value) if field in _PAIRS else _field_value(value)
        samples = fields["rate_hz"] * fields["duration_s"]
        if samples > _MAX_SAMPLES:
            raise ConfigError(f"duration_s: {samples:g} samples, at most {_MAX_SAMPLES:g} are made")
        try:
            return self.make_options(**fields)
        except ValueError as error:
            raise ConfigError(str(error)) from None

    def run(self, values: Mapping[str, Any]) -> Run:
        """The simulation of parameter values; ConfigError as `options`."""
        options = self.options(values)
        try:
            return self.run_options(options)
        except ValueError as error:
            raise ConfigError(str(error)) from None


SIMULATIONS: Mapping[str, Simulation] = {
    "swing": Simulation(
        "swing_align", "an IMU on a swinging or still base", SWING_TABLE,
        SwingOptions, simulate_swing,
    ),
    "odo": Simulation(
        "odo_align", "an IMU and an odometer on a vehicle", VEHICLE_TABLE,
        VehicleOptions, simulate_vehicle, (parameters_of("odo_align")["odom_type"],),
    ),
}  # fmt: skip


def odometer_of(run: Run) -> OdometerSamples | None:
    """The odometer of a run, None where it has none."""
    return run.odometer if isinstance(run, VehicleRun) else None


def position_of(run: Run) -> Position:
    """Where the run begins."""
    what = run.options
    return Position(what.latitude_deg * DEG, what.longitude_deg * DEG, what.altitude_m)


def add_options(parser: argparse.ArgumentParser, simulation: Simulation) -> None:
    """Give a parser an option for every parameter of the simulation."""
    for parameter in simulation.parameters.values():
        # Without the unit s, unless that is the end of m/s.
        option = "--" + re.sub("(?<!_m)_s$", "", parameter.name).replace("_", "-")
        choices = f": {', '.join(parameter.choices)}" if parameter.choices else ""
        default = parameter.default
        if isinstance(default, bool):
            parser.add_argument(
                option, dest=parameter.name, action="store_true", help=parameter.description
            )
            continue
        array = isinstance(default, list)
        unset = array or (isinstance(default, float) and math.isnan(default))
        parser.add_argument(
            option,
            dest=parameter.name,
            type=float if array else type(default),
            nargs=(parameter.length or "+") if array else None,
            default=default,
            metavar=_metavar(parameter),
            help=parameter.description + choices + ("" if unset else f" (default {default})"),
        )


def _metavar(parameter: Parameter) -> str | tuple[str, ...]:
    if isinstance(parameter.default, list):
        return ("X", "Y", "Z")[: parameter.length] if parameter.length else "X"
    return parameter.name.rpartition("_")[2].upper()


def _field_value(value: Any) -> Any:
    """None for what is not set, a tuple for an array."""
    elements = value if isinstance(value, list) else [value]
    if any(isinstance(element, float) and math.isnan(element) for element in elements):
        return None
    return tuple(value) if isinstance(value, list) else value


def _pairs(field: str, numbers: list[float]) -> tuple[tuple[float, float], ...]:
    if len(numbers) % 2:
        raise ConfigError(f"{field}: {numbers} are not pairs of a begin and a duration")
    return tuple(zip(numbers[::2], numbers[1::2], strict=True))
