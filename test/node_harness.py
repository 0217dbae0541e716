"""Nodes in processes of their own, and an observer in this one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

ROOT = Path(__file__).resolve().parent.parent
SWING = "swing_align_ros.node"
ODO = "odo_align_ros.node"
SYNTH = "sins_align.ros.synth_node"

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RELIABLE = QoSProfile(depth=1000)
TEXTS = {"state", "reason", "remedy"}
# Of the diagnostics of every node; values of those that are no texts are numbers.
KEYS = TEXTS | {
    "elapsed_s", "sigma_east_arcmin", "sigma_north_arcmin", "sigma_heading_arcmin",
    "heading_limit_arcmin", "eta_s", "consistency", "imu_rate_hz", "imu_gaps", "imu_rejected",
    "odom_rejected",
}  # fmt: skip

# One a worker; domains beyond 101 meet the system's ephemeral ports.
DOMAIN = 1 + os.getpid() % 100
ENVIRONMENT = {
    **os.environ,
    "PYTHONPATH": str(ROOT),
    "ROS_DOMAIN_ID": str(DOMAIN),
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
}
DEADLINE_S = 90.0


def arguments(parameters: dict[str, object]) -> list[str]:
    texts = [f"{name}:={value}" for name, value in parameters.items()]
    return ["--ros-args", *(word for text in texts for word in ("-p", text))]


def run_module(
    module: str, *words: str, timeout: float = DEADLINE_S
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", module, *words],
        env=ENVIRONMENT, timeout=DEADLINE_S, text=True, capture_output=True, check=False,
    )  # fmt: skip


@contextmanager
def running(module: str, *words: str, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A process whose output goes to `log`; killed at the end if it still runs."""
    with log.open("wb") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", module, *words], env=ENVIRONMENT, stdout=file, stderr=file
        )
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()
            process.wait()


def diagnostic_values(message: Any) -> dict[str, str]:
    """The keys and values of a DiagnosticArray of one status."""
    return {entry.key: entry.value for entry in message.status[0].values}


def stamp_ns(message: Any) -> int:
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def stop(process: subprocess.Popen[bytes], number: int = signal.SIGINT) -> int:
    """Send a signal; the exit status."""
    process.send_signal(number)
    return process.wait(timeout=DEADLINE_S)


class Observer:
    """A node in this process, in a context of its own."""

    def __init__(self) -> None:
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        self.context = Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.node = Node("observer", context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self.received: dict[str, list[Any]] = {}

    def listen(self, message_type: type, topic: str, qos: Any, key: str = "") -> None:
        self.received[key or topic] = found = []
        self.node.create_subscription(message_type, topic, found.append, qos)

    def wait(self, condition: Callable[[], object], what: str) -> None:
        end = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < end, f"waited in vain for {what}"
            self._executor.spin_once(timeout_sec=0.05)

    def call(self, service_type: type, name: str, request: Any = None) -> Any:
        client = self.node.create_client(service_type, name)
        self.wait(client.service_is_ready, name)
        future = client.call_async(request or service_type.Request())
        self.wait(future.done, f"the answer of {name}")
        return future.result()

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@contextmanager
def observing() -> Iterator[Observer]:
    observer = Observer()
    try:
        yield observer
    finally:
        observer.close()
