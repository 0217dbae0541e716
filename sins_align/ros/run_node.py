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
    prepare: Callable[[N], Callable[[], None]],
    args: Sequence[str] | None = None,
) -> int:
    """Make a node and let it work until it is done, or until SIGINT, SIGTERM or a shutdown.

    Parameters
    ----------
    name : before an error
    make_node : called with ROS up
    prepare : makes of the node the work to do. A signal waits for both, for neither a node
        nor an executor can be made once ROS is down.
    args : None: those of the process

    Returns
    -------
    0 after work or shutdown; 2 for arguments or parameters that cannot be used and 1 for
    work that ended with an OSError, a TimeoutError among them; each with one line on standard
    error
    """
    # At the signal a thread of rclpy's shuts ROS down, at any moment; the handler that it found
    # is called too. Python's own would raise in the middle of whatever is going on, a half-taken
    # sample included.
    for number in SIGNALS:
        signal.signal(number, lambda *_: None)
    try:
        with signals_held():
            rclpy.init(args=None if args is None else list(args))
            node = make_node()
            work = prepare(node)
    except _UNUSABLE as error:
        rclpy.try_shutdown()
        return _fail(name, error, 2)
    try:
        work()
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


def prepare_aligner(node: AlignNode) -> Callable[[], None]:
    """What spins the node until ROS is shut down, and then lets it finish."""
    executor = _make_executor(node.executor_kind)
    executor.add_node(node)
    if node.executor_kind == "events":
        # It takes the node's subscriptions and timers up in its first turn. A shutdown in the
        # middle of that leaves it some that it does not know of, and it ends by abort() then.
        executor.spin_once(timeout_sec=0.0)

    def spin() -> None:
        try:
            _spin(executor, node.executor_kind)
        finally:
            node.finish()

    return spin


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


def _spin(executor: Any, kind: str) -> None:
    if kind == "single":
        executor.spin()
        return
    while rclpy.ok():  # its spin() does not return at a signal
        executor.spin_once(timeout_sec=0.2)
