"""Parameter values: from a table, a ROS 2 parameter file, the command line."""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from sins_align.grades import ConfigError
from sins_align.parameter import BOTH, NAN, Parameter, Value
from sins_align.parameter_table import GRADE_OVERRIDES, PARAMETERS

__all__ = [
    "BOTH",
    "GRADE_OVERRIDES",
    "NAN",
    "PARAMETERS",
    "Parameter",
    "Value",
    "check_values",
    "parameters_of",
    "parse_override",
    "read_parameter_file",
]

WILDCARD = "/**"


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
