"""Nodes in processes of their own, and an observer in this one."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Imu, NavSatFix

from sins_align.ros.bags_topics import odometer_type
from sins_align.ros.cdr import encode_imu
from sins_align.ros.introduction import Introduction
from sins_align.ros.messages import fix_message
from sins_align.ros.odometer import OdometerRow, odometer_rows
from sins_align.ros.portable_messages import odometer_message, ros_types
from sins_align.simulate import (
    SwingOptions,
    VehicleOptions,
    VehicleRun,
    simulate_swing,
    simulate_vehicle,
)
from sins_align.types import ImuSamples, OdometerSamples, Position

ROOT = Path(__file__).resolve().parent.parent
SWING = "swing_align_ros"
ODO = "odo_align_ros"
SYNTH = "sins_align.ros.synth_command"

# For subscriptions. What comes while this process is kept waiting has to find room: a node whose
# data are played runs far ahead of them.
LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RELIABLE = QoSProfile(depth=10_000)
TEXTS = {"state", "reason", "reason_keys", "remedy"}
# Of the diagnostics of every node; values of those that are no texts are numbers.
KEYS = TEXTS | {
    "elapsed_s", "sigma_east_arcmin", "sigma_north_arcmin", "sigma_heading_arcmin",
    "heading_limit_arcmin", "eta_s", "consistency", "imu_rate_hz", "imu_gaps", "imu_rejected",
    "odom_rejected", "latitude_deg", "latitude_sigma_deg",
}  # fmt: skip


def take_domain() -> tuple[int, socket.socket]:
    """A domain of ROS, and what keeps other runs on this machine from taking the same one.

    That is the TCP port of the number where DDS uses UDP. The nodes hold it too, so that those
    a killed run leaves behind do not speak into the next one.
    """
    for k in range(100):  # domains beyond 101 meet the system's ephemeral ports
        domain = 1 + (os.getpid() + k) % 100
        port = socket.socket()
        try:
            port.bind(("127.0.0.1", 7400 + 250 * domain))
        except OSError:
            port.close()
        else:
            return domain, port
    raise RuntimeError("every domain is taken")


DOMAIN, DOMAIN_PORT = take_domain()
ENVIRONMENT = {
    **os.environ,
    "PYTHONPATH": str(ROOT),
    "ROS_DOMAIN_ID": str(DOMAIN),
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
}
DEADLINE_S = 180.0  # of whatever is waited for, on a machine that does much else
# Met soon by the simulated motions below.
THRESHOLDS = {"heading_threshold_arcmin": 90.0, "level_threshold_arcsec": 300.0, "hold_s": 2.0}


def pitching(duration_s: float) -> ImuSamples:
    """On a base that pitches, by sensors without errors."""
    options = SwingOptions(
        scenario="pitch", grade="perfect", rate_hz=50.0, duration_s=duration_s, seed=1
    )
    return simulate_swing(options).imu


def urban_drive() -> VehicleRun:
    """A minute of it, with an odometer."""
    options = VehicleOptions(
        scenario="urban", grade="fog", rate_hz=50.0, odometer_rate_hz=10.0, duration_s=60.0, seed=3
    )
    return simulate_vehicle(options)


def arguments(parameters: dict[str, object]) -> list[str]:
    texts = [f"{name}:={value}" for name, value in parameters.items()]
    return ["--ros-args", *(word for text in texts for word in ("-p", text))]


def run_module(module: str, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", module, *words],
        env=ENVIRONMENT, timeout=DEADLINE_S, text=True, capture_output=True, check=False,
    )  # fmt: skip


@contextmanager
def running(module: str, *words: str, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A process whose output goes to `log`; ended by a signal if it still runs.

    Killed only where that does not help. Who is killed while it writes into the shared memory of
    DDS leaves a lock taken there: this process then waits for it when the observer closes, and
    crashes when DDS makes that piece of memory anew meanwhile.
    """
    with log.open("wb") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", module, *words],
            env=ENVIRONMENT, stdout=file, stderr=file, pass_fds=[DOMAIN_PORT.fileno()],
        )  # fmt: skip
        try:
            yield process
        finally:
            try:
                if process.poll() is None:
                    stop(process, signal.SIGTERM)
            finally:
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
        self._clients: dict[str, Client] = {}
        self.received: dict[str, list[Any]] = {}

    def listen(self, message_type: type, topic: str, qos: Any, key: str = "") -> None:
        self.received[key or topic] = found = []
        self.node.create_subscription(message_type, topic, found.append, qos)

    def wait(self, condition: Callable[[], object], what: str) -> None:
        end = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < end, f"waited in vain for {what}"
            self._executor.spin_once(timeout_sec=0.05)

    def wait_for_stamp(self, key: str, wanted_ns: int) -> None:
        """Until a message with this stamp is the newest of a topic."""
        found = self.received[key]
        self.wait(lambda: found and stamp_ns(found[-1]) == wanted_ns, f"the last of {key}")

    def call(self, service_type: type, name: str, request: Any = None) -> Any:
        if name not in self._clients:
            self._clients[name] = self.node.create_client(service_type, name)
            self.introduce(name[1:].rpartition("/")[0])  # else the answer might be lost
        client = self._clients[name]
        self.wait(client.service_is_ready, name)
        future = client.call_async(request or service_type.Request())
        self.wait(future.done, f"the answer of {name}")
        return future.result()

    def introduce(self, node: str) -> None:
        """Wait until a node knows of all that has been made here; its name is with its namespace.

        From then on it takes what is published here, and nothing that it publishes is missed.
        """
        introduction = Introduction(self.node, f"/{node}")
        self.wait(introduction.is_done, f"an answer of {node}")
        introduction.close()

    def listen_to_diagnostics(self) -> None:
        self.listen(DiagnosticArray, "/diagnostics", RELIABLE)

    def wait_for_diagnostics(self) -> None:
        """Begin to listen, and wait for the first: a node is up."""
        self.listen_to_diagnostics()
        self.wait(self.diagnostics, "diagnostics")

    def diagnostics(self, index: int = -1) -> dict[str, str]:
        """Keys and values of the newest ones, or of those before; none where none have come."""
        seen = self.received["/diagnostics"]
        return diagnostic_values(seen[index]) if seen else {}

    @property
    def state(self) -> str:
        """As the newest diagnostics have it, '' where there are none."""
        return self.diagnostics().get("state", "")

    def profile(self, node: str, topic: str) -> QoSProfile:
        """Of that node's one publisher or subscription of a topic."""
        self.wait(lambda: self.ends(node, topic), f"{topic} of {node}")
        (end,) = self.ends(node, topic)
        return end.qos_profile

    def ends(self, node: str, topic: str) -> list[Any]:
        """What is known by now of the node's publishers and subscriptions of a topic.

        They are known before it is known whose they are.
        """
        found = [
            *self.node.get_publishers_info_by_topic(topic),
            *self.node.get_subscriptions_info_by_topic(topic),
        ]
        return [end for end in found if f"{end.node_namespace}/{end.node_name}".strip("/") == node]

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


class Player:
    """Publishes samples from this process, as fast as the node takes them and no faster.

    The node's `~/processed` tells how far it has come. No more than WINDOW samples are under
    way: a best-effort subscription then loses none.

    Parameters
    ----------
    node : name of the node that takes them, with its namespace
    odom_type : the odometer's message type, None: no odometer
    position : sent as a fix with the first sample of every `play`; None: no fix
    """

    WINDOW = 100

    def __init__(
        self,
        observer: Observer,
        node: str = "swing_align",
        imu_topic: str = "/imu",
        odom_topic: str = "/odom",
        odom_type: str | None = None,
        position: Position | None = None,
        fix_topic: str = "/fix",
    ) -> None:
        self._observer = observer
        self._imu = observer.node.create_publisher(Imu, imu_topic, 2000)
        self._publishers = [self._imu]
        self._rows: list[OdometerRow] = []
        self._position = position
        if odom_type is not None:
            self._odom_type = odometer_type(odom_type)
            self._odom = observer.node.create_publisher(ros_types(self._odom_type), odom_topic, 200)
            self._publishers.append(self._odom)
        if position is not None:
            self._fix = observer.node.create_publisher(NavSatFix, fix_topic, 10)
            self._publishers.append(self._fix)
        # Not latched: what was taken before is of no interest here.
        self._taken: list[Time] = []
        observer.node.create_subscription(Time, f"/{node}/processed", self._taken.append, RELIABLE)
        observer.wait(lambda: self._connected(node), f"the inputs of {node}")
        observer.introduce(node)

    def _connected(self, node: str) -> bool:
        """Whether the publishers know of the node, and not only of others that take the same."""
        return all(
            publisher.get_subscription_count() and self._observer.ends(node, publisher.topic_name)
            for publisher in self._publishers
        )

    def play(
        self, imu: ImuSamples, odometer: OdometerSamples | None = None, lead: int = 50
    ) -> None:
        """Publish all of it; returns when the node has taken the last sample of the IMU.

        Call it again for what comes next, also where that begins at an earlier time.

        Parameters
        ----------
        imu : in the order of publication, whatever the stamps are
        odometer : by stamp
        lead : how many samples of the IMU the odometer is ahead; negative: behind
        """
        stamps = imu.stamp_ns.tolist()
        payloads = [bytes(payload) for payload in encode_imu(imu, "imu")]
        self._rows = [] if odometer is None else odometer_rows(odometer)
        if self._position is not None:
            self._fix.publish(fix_message(stamps[0], self._position, "gnss"))
        taken = sent = 0
        while taken < len(stamps):
            end = min(taken + self.WINDOW, len(stamps))
            for k in range(sent, end):
                if 0 <= k + lead < len(stamps):
                    self._publish_odometer(stamps[k + lead])
                self._imu.publish(payloads[k])
            sent = max(sent, end)
            if sent == len(stamps):
                self._publish_odometer(np.iinfo(np.int64).max)
            self._observer.wait(lambda: self._taken, "the node to take samples")
            processed, self._taken[:] = self._taken[-1], []
            stamp = processed.sec * 1_000_000_000 + processed.nanosec
            # Of what is under way: elsewhere the same stamp may stand for another sample.
            under_way = [k + 1 for k in range(taken, sent) if stamps[k] == stamp]
            taken = max(under_way, default=taken)

    def burst(self, imu: ImuSamples) -> None:
        """Publish all of it at once, whether the node takes it or not."""
        for payload in encode_imu(imu, "imu"):
            self._imu.publish(bytes(payload))

    def _publish_odometer(self, until_ns: int) -> None:
        while self._rows and self._rows[0].stamp_ns <= until_ns:
            row = self._rows.pop(0)
            self._odom.publish(odometer_message(ros_types, self._odom_type, row, "base_link"))
