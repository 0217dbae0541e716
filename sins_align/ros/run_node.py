"""A node from its start to its end: exit codes, signals, executors."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from sins_align.grades import ConfigError
from sins_align.ros.command import error_text
from sins_align.ros.node_base import AlignNode, RCLError
from sins_align.ros.signals import SIGNALS, signals_held

N = TypeVar("N", bound=Node)


_UNUSABLE = (
    ConfigError, ParameterException, RCLError, RuntimeError, ValueError, OSError, MemoryError
)  # fmt: skip


def run_node(
    name: str,
    make_node: Callable[[], N],
    work: Callable[[N], None],
    args: Sequence[str] | None = None,
) -> int:
    """Make a node and let it work until it is done, or until SIGINT, SIGTERM or a shutdown.

    Returns
    -------
    0 after work or shutdown; 2 for arguments or parameters that cannot be used and 1 for
    work that ended with an OSError, a TimeoutError among them; each with one line on standard
    error
    """
    # rclpy shuts ROS down at the signal and then calls the handler it found. Python's own
    # would raise in the middle of whatever is going on, a half-taken sample included.
    for number in SIGNALS:
        signal.signal(number, lambda *_: None)
    try:
        with signals_held():  # until there is a node that can end well
            rclpy.init(args=None if args is None else list(args))
            node = make_node()
    except _UNUSABLE as error:
        rclpy.try_shutdown()
        return _fail(name, error, 2)
    try:
        work(node)
    except ExternalShutdownException:
        pass
    except OSError as error:
        return _fail(name, error, 1)
    except RCLError:
        if rclpy.ok():  # else something was published while ROS went down
            raise
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
        # Nothing is left to be stopped, and Python's own exit takes a moment.
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)
    return 0


def spin_aligner(node: AlignNode) -> None:
    """Spin until ROS is shut down, then let the node finish."""
    try:
        _spin(node, node.executor_kind)
    finally:
        node.finish()


def _fail(name: str, error: Exception, status: int) -> int:
    text = error_text(error)
    if isinstance(error, rclpy_implementation.UnknownROSArgsError):  # the words, and no more
        text = f"unknown arguments after --ros-args: {text}"
    print(f"{name}: {text}", file=sys.stderr)
    return status


def _make_executor(kind: str) -> Any:
    if kind == "single":
        return SingleThreadedExecutor()
    from rclpy.experimental import EventsExecutor

    return EventsExecutor()


def _spin(node: Node, kind: str) -> None:
    with signals_held():  # none can be made once ROS is down
        if not rclpy.ok():
            return
        executor = _make_executor(kind)
    executor.add_node(node)
    if kind == "single":
        executor.spin()
        return
    while rclpy.ok():  # its spin() does not return at a signal
        executor.spin_once(timeout_sec=0.2)
