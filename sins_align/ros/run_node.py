"""A node from its start to its end: exit codes, signals, executors."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Sequence

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

from sins_align.grades import ConfigError
from sins_align.ros.node_base import AlignNode

try:  # where rclpy keeps it differs between releases
    from rclpy.impl.implementation_singleton import rclpy_implementation

    RCLError = rclpy_implementation.RCLError
except ImportError:
    RCLError = RuntimeError


def one_line(error: object) -> str:
    """The text of an error in one line."""
    return " ".join(str(error).split())


def run_node(
    name: str, make_node: Callable[[], AlignNode], args: Sequence[str] | None = None
) -> int:
    """Run a node until SIGINT, SIGTERM or a shutdown of ROS.

    Returns
    -------
    0 after a shutdown, 2 for arguments or parameters that cannot be used, with one line on
    standard error
    """
    # rclpy shuts ROS down at the signal and then calls the handler it found. Python's own
    # would raise in the middle of whatever is going on, a half-taken sample included.
    signal.signal(signal.SIGINT, lambda *_: None)
    try:
        rclpy.init(args=list(args) if args is not None else None)
        node = make_node()
    except (ConfigError, ParameterException, RCLError, RuntimeError, ValueError) as error:
        print(f"{name}: {one_line(error)}", file=sys.stderr)
        rclpy.try_shutdown()
        return 2
    try:
        spin(node, node.executor_kind)
    except ExternalShutdownException:
        pass
    except RCLError:
        if rclpy.ok():  # else something was published while ROS went down
            raise
    finally:
        node.finish()
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


def spin(node: rclpy.node.Node, kind: str) -> None:
    """Spin until ROS is shut down; `kind` is the parameter `executor`."""
    if kind == "events":
        from rclpy.experimental import EventsExecutor

        executor = EventsExecutor()
    else:
        executor = SingleThreadedExecutor()
    executor.add_node(node)
    if kind == "single":
        executor.spin()
    while rclpy.ok():  # the spin() of the events executor does not return at a signal
        executor.spin_once(timeout_sec=0.2)
