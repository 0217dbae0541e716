"""A node's parameters, declared from a table of `sins_align.parameters.Parameter`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from sins_align.grades import ConfigError
from sins_align.parameters import Parameter, Value
from sins_align.ros.parameter_values import is_ros_parameter

_INTEGER_LIMIT = 2**63 - 1


def given_value(node: Node, parameter: Parameter) -> Value:
    """The value of one parameter of a node on which none is declared yet.

    The node must have been made as for `declare_parameters`. ConfigError as there.
    """
    override = node.get_parameters_by_prefix("").get(parameter.name)
    return parameter.default if override is None else parameter.check(override.value)


def declare_parameters(node: Node, table: Mapping[str, Parameter]) -> dict[str, Any]:
    """Declare the parameters of `table`, and return their values.

    The node must have been made with automatically_declare_parameters_from_overrides. Its
    overrides are undeclared here and declared again with description and range: so values
    are checked by the table, with the same words as for a replay, a whole number is good
    for a real one, and a name that is not in the table does not pass unnoticed. Those that
    cannot change while the node runs are read-only.

    Raises
    ------
    ConfigError : unknown name, wrong type, out of range; names the key
    """
    values: dict[str, Any] = {name: entry.default for name, entry in table.items()}
    for name, override in node.get_parameters_by_prefix("").items():
        if is_ros_parameter(name):
            continue
        if name not in table:
            raise ConfigError(f"{name}: unknown parameter of {node.get_name()}")
        given = override.value
        values[name] = table[name].check(given if _is_plain(given) else list(given))
        node.undeclare_parameter(name)
    for name, entry in table.items():
        node.declare_parameter(name, values[name], _descriptor(entry), ignore_override=True)
    return values


def checked_changes(
    node: Node, table: Mapping[str, Parameter], changes: Iterable[RosParameter]
) -> list[RosParameter]:
    """The parameters that somebody wants to set while the node runs, checked as at its start.

    rclpy itself would refuse a whole number for a real one, and say less of what is wrong.
    Parameters of ROS's own pass as they are.

    Raises
    ------
    ConfigError : unknown name, wrong type, out of range, or cannot change now; names the key
    """
    checked = []
    for change in changes:
        if not is_ros_parameter(change.name):
            entry = table.get(change.name)
            if entry is None:
                raise ConfigError(f"{change.name}: unknown parameter of {node.get_name()}")
            if not entry.runtime:
                raise ConfigError(
                    f"{change.name}: cannot change while the node runs; restart the node with"
                    " the new value"
                )
            change = RosParameter(change.name, value=entry.check(change.value))
        checked.append(change)
    return checked


def _is_plain(value: object) -> bool:
    return value is None or isinstance(value, bool | int | float | str)


def _descriptor(entry: Parameter) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=entry.description,
        additional_constraints=entry.range_text(),
        read_only=not entry.runtime,
    )
    default = entry.default
    if isinstance(default, bool | str | list):
        return descriptor
    # NaN, "not set", is in no range; then the text has to do.
    if isinstance(default, int):
        low, high = (
            int(min(max(limit, -_INTEGER_LIMIT), _INTEGER_LIMIT))
            for limit in (entry.low, entry.high)
        )
        descriptor.integer_range = [IntegerRange(from_value=low, to_value=high)]
    elif not math.isnan(default) and math.isfinite(entry.low) and math.isfinite(entry.high):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=entry.low, to_value=entry.high)
        ]
    return descriptor
