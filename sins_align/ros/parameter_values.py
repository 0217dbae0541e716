"""Parameter values of a command: a ROS 2 parameter file and -p, as `ros2 run` takes them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from sins_align.parameters import parse_override, read_parameter_file

# What ROS itself reads from a parameter file.
_ROS_PARAMETERS = ("use_sim_time", "start_type_description_service", "qos_overrides")


def is_ros_parameter(name: str) -> bool:
    """True for the parameters that every ROS node has, also with `:=value` behind the name."""
    return name.partition(":=")[0].partition(".")[0] in _ROS_PARAMETERS


def read_values(node: str, file: Path | None, overrides: Iterable[str]) -> dict[str, object]:
    """The values that a parameter file and `name:=value` texts give; the latter win.

    Raises
    ------
    ConfigError : as `read_parameter_file` and `parse_override`
    """
    values = read_parameter_file(file, node) if file else {}
    values = {name: value for name, value in values.items() if not is_ros_parameter(name)}
    values.update(parse_override(text, node) for text in overrides if not is_ros_parameter(text))
    return values
