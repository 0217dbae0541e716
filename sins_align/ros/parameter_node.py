"""A node whose parameters are those of the table, some of which can change while it runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from sins_align.grades import ConfigError
from sins_align.parameters import parameters_of
from sins_align.ros.command import error_text
from sins_align.ros.node_parameters import checked_changes, declare_parameters
from sins_align.ros.whole_file import check_target


class ParameterNode(Node):
    """Declares the parameters and keeps their values.

    Parameters
    ----------
    node_name : its parameters are those of the table for this name, also when the node itself
        has been given another one

    values : the parameters' values as they are now

    Raises
    ------
    ConfigError : a parameter that cannot be used; names the key
    OSError : the result file could not be written; names it
    """

    def __init__(self, node_name: str) -> None:
        super().__init__(node_name, automatically_declare_parameters_from_overrides=True)
        self._table = parameters_of(node_name)
        self.values: dict[str, Any] = declare_parameters(self, self._table)
        _check_result_file(self.values)  # known now, not when the alignment is done
        self.add_post_set_parameters_callback(self._take_over)

    def get_logger(self) -> RcutilsLogger:
        """Once ROS is down, one that leaves /rosout alone, where nothing can be published."""
        if self.context.ok():
            return super().get_logger()
        return get_logger(f"{super().get_logger().name}.end")

    def set_parameters_atomically(self, changes: list[RosParameter]) -> SetParametersResult:
        """Set all of them or none; what cannot be is refused in the words of the table.

        The services come here: `set_parameters` for one after the other, each with its own
        result, `set_parameters_atomically` for all.
        """
        try:
            changes = checked_changes(self, self._table, changes)
            _check_result_file({change.name: change.value for change in changes})
        except (ConfigError, OSError) as error:
            return SetParametersResult(successful=False, reason=error_text(error))
        return super().set_parameters_atomically(changes)

    def _take_over(self, changes: list[RosParameter]) -> None:
        changed = {change.name: change.value for change in changes if change.name in self._table}
        if not changed:
            return
        self.values.update(changed)
        texts = ", ".join(f"{name}: {value}" for name, value in changed.items())
        self.get_logger().info(f"parameters set: {texts}")
        self.use_changed(changed)

    def use_changed(self, changed: dict[str, Any]) -> None:
        """Use values that have just been set; nothing here. They stand in `values` as well."""


def _check_result_file(values: dict[str, Any]) -> None:
    if values.get("result_file"):
        check_target(Path(values["result_file"]))
