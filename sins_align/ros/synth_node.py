"""The node `align_synth`: publishes a simulated IMU, and an odometer where there is one, live.

With `speed` above 0 the samples go out when they are due. With `speed` 0 they go out as
fast as the aligner takes them: its topic `~/processed` tells how far it has come, and no
more than WINDOW samples are ever under way. So a best-effort subscription loses nothing,
though nothing in DDS would hold a publisher back. The odometer is then LEAD samples of the
IMU ahead, for nothing in DDS keeps the order of two topics either.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

# Small matrices: threads cost more than they bring. It counts before numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu, NavSatFix

from sins_align.parameters import Parameter
from sins_align.ros.bags_topics import odometer_type
from sins_align.ros.cdr import encode_imu
from sins_align.ros.introduction import Introduction
from sins_align.ros.messages import fix_message
from sins_align.ros.node_parameters import declare_parameters, given_value
from sins_align.ros.odometer import odometer_rows
from sins_align.ros.portable_messages import odometer_message, ros_types
from sins_align.ros.run_node import run_node
from sins_align.ros.simulation_options import SIMULATIONS, odometer_of, position_of
from sins_align.ros.whole_file import write_text_whole
from sins_align.types import IntArray, OdometerSamples

NAME = "align_synth"
WINDOW = 200  # samples under way at speed 0; the shared memory of Fast DDS holds 512
LEAD = 50  # samples
BURST = 100  # samples at a time when the timetable is behind
STALLED_S = 20.0
SETTLE_S = 0.5
END_S = 2.0  # how long the end waits for the last samples to be taken in real time
_NS = 1_000_000_000

KIND = Parameter("kind", "swing", "what is simulated", choices=tuple(SIMULATIONS))


def synth_parameters(kind: str) -> dict[str, Parameter]:
    """The parameters of the node for a kind of simulation, by name."""
    simulation = SIMULATIONS[kind]
    play = (
        KIND,
        Parameter(
            "speed", 1.0, "1: real time; 0: as fast as the aligner takes the samples",
            low=0.0, high=1e6,
        ),
        Parameter("wait_for_subscribers", 1, "of imu, before it starts", low=0, high=1000),
        Parameter("wait_timeout_s", 30.0, "for as long [s]", low=0.0, high=1e6),
        Parameter("aligner", simulation.node, "the node whose progress counts at speed 0"),
        Parameter("frame_id", "imu", "of the IMU"),
        Parameter("truth_file", "", "truth.json is written here; empty: nowhere"),
    )  # fmt: skip
    return simulation.parameters | {parameter.name: parameter for parameter in play}


class OdometerFeed:
    """The odometer's messages, published up to a stamp.

    Parameters
    ----------
    samples : in the order of their stamps
    message_type : one of kind "odom"
    """

    def __init__(self, node: Node, samples: OdometerSamples, message_type: str) -> None:
        self._stamp_ns = samples.stamp_ns
        self._rows = odometer_rows(samples)
        self._type = message_type
        self._sent = 0
        self._publisher = node.create_publisher(ros_types(message_type), "odom", 200)

    @property
    def has_subscriber(self) -> bool:
        """Whether anybody listens."""
        return bool(self._publisher.get_subscription_count())

    def publish(self, until_ns: int) -> None:
        """Publish what is not later than `until_ns` and has not been published."""
        end = int(np.searchsorted(self._stamp_ns, until_ns, side="right"))
        for row in self._rows[self._sent : end]:
            message = odometer_message(ros_types, self._type, row, "base_link")
            self._publisher.publish(message)
        self._sent = max(self._sent, end)


class SynthNode(Node):
    """The simulation, ready to be played.

    Raises
    ------
    ConfigError : a parameter that cannot be used; names the key
    """

    def __init__(self) -> None:
        super().__init__(NAME, automatically_declare_parameters_from_overrides=True)
        kind = str(given_value(self, KIND))
        self._values: dict[str, Any] = declare_parameters(self, synth_parameters(kind))
        run = SIMULATIONS[kind].run(self._values)
        if self._values["truth_file"]:
            text = json.dumps(run.truth.truth_dict(), indent=1) + "\n"
            write_text_whole(Path(self._values["truth_file"]), text)
        self._stamp_ns: IntArray = run.imu.stamp_ns
        self._payloads = [bytes(p) for p in encode_imu(run.imu, self._values["frame_id"])]
        self._position = position_of(run)
        odometer = odometer_of(run)
        self._odom = None
        if odometer is not None:
            self._odom = OdometerFeed(self, odometer, odometer_type(self._values["odom_type"]))
        self._odom_until = self._stamps_ahead(0 if self._values["speed"] > 0.0 else LEAD)
        self._sent = 0
        self._next_fix_ns = 0
        self._processed_ns = -1
        # Offered as reliable, so that a subscription of either kind gets it.
        self._imu = self.create_publisher(Imu, "imu", 2000)
        self._fix = self.create_publisher(NavSatFix, "fix", 10)
        self._progress = f"{self._values['aligner']}/processed"
        # Not latched: what was taken before is of no interest here.
        self.create_subscription(Time, self._progress, self._on_processed, QoSProfile(depth=1))

    def _on_processed(self, stamp: Time) -> None:
        self._processed_ns = stamp.sec * _NS + stamp.nanosec

    def _stamps_ahead(self, lead: int) -> list[int]:
        """For each sample the stamp of the one `lead` later; for the last one, the end of time."""
        last = len(self._stamp_ns) - 1
        ahead = self._stamp_ns[np.minimum(np.arange(lead, lead + last + 1), last)]
        return [*ahead[:-1].tolist(), np.iinfo(np.int64).max]

    def play(self) -> None:
        """Publish everything.

        Raises
        ------
        TimeoutError : nobody subscribes, or the aligner stopped taking samples
        """
        speed = self._values["speed"]
        self._wait_for_subscribers()
        if speed > 0.0:
            self._play_timed(speed)
        else:
            self._play_throttled()
        self._wait_for_the_last(END_S if speed > 0.0 else STALLED_S)
        self.get_logger().info(f"{self._sent} samples published")

    def _wait_for_subscribers(self) -> None:
        needed = self._values["wait_for_subscribers"]
        end = time.monotonic() + self._values["wait_timeout_s"]
        throttled = self._values["speed"] == 0.0
        while True:
            found = self._imu.get_subscription_count()
            if found >= needed and (not throttled or self._has_aligner()):
                break
            if time.monotonic() > end:
                name = self._progress if found >= needed else self._imu.topic_name
                raise TimeoutError(f"{found} of {needed} subscribers; nobody on {name}")
            rclpy.spin_once(self, timeout_sec=0.05)
        # A subscription that is known here may not know of this publisher yet.
        end = time.monotonic() + SETTLE_S
        while time.monotonic() < end:
            rclpy.spin_once(self, timeout_sec=0.05)
        if throttled:
            self._introduce()

    def _introduce(self) -> None:
        """Wait until the aligner knows of the publishers: it is sent no sample twice."""
        introduction = Introduction(self, self._values["aligner"])
        end = time.monotonic() + STALLED_S
        while not introduction.is_done():
            if time.monotonic() > end:
                raise TimeoutError(f"{self._values['aligner']} does not answer")
            rclpy.spin_once(self, timeout_sec=0.05)
        introduction.close()

    def _has_aligner(self) -> bool:
        """Whether the aligner has all it needs to follow."""
        others = self._odom is None or self._odom.has_subscriber
        return bool(
            others and self._fix.get_subscription_count() and self.count_publishers(self._progress)
        )

    def _play_timed(self, speed: float) -> None:
        begin = time.monotonic()
        first = int(self._stamp_ns[0])
        while self._sent < len(self._payloads):
            elapsed_ns = (time.monotonic() - begin) * speed * 1e9
            due = int(np.searchsorted(self._stamp_ns, first + elapsed_ns, side="right"))
            self._publish(min(due, self._sent + BURST))
            time.sleep(0.001)
            if not rclpy.ok():
                return

    def _play_throttled(self) -> None:
        window = WINDOW if self._odom is None else WINDOW // 2  # the odometer's queue is shorter
        last_progress = time.monotonic()
        while self._sent < len(self._payloads):
            taken = int(np.searchsorted(self._stamp_ns, self._processed_ns, side="right"))
            if taken + window > self._sent:
                self._publish(min(taken + window, len(self._payloads)))
                last_progress = time.monotonic()
            rclpy.spin_once(self, timeout_sec=0.5)
            if time.monotonic() - last_progress > STALLED_S:
                raise TimeoutError(f"{self._values['aligner']} stopped taking samples")

    def _wait_for_the_last(self, patience_s: float) -> None:
        """The last samples are still under way: this publisher has to outlive them."""
        seen_ns, end = self._processed_ns, time.monotonic() + patience_s
        while self._processed_ns < self._stamp_ns[-1] and time.monotonic() < end:
            rclpy.spin_once(self, timeout_sec=0.1)
            if self._processed_ns != seen_ns:
                seen_ns, end = self._processed_ns, time.monotonic() + patience_s

    def _publish(self, end: int) -> None:
        """Publish the samples up to `end`, each with what is due before it.

        That is a fix at the first one of every second, and the odometer.
        """
        for k in range(self._sent, end):
            stamp = int(self._stamp_ns[k])
            if self._odom is not None:
                self._odom.publish(self._odom_until[k])
            if stamp >= self._next_fix_ns:
                self._next_fix_ns = stamp + _NS
                self._fix.publish(fix_message(stamp, self._position, "gnss"))
            self._imu.publish(self._payloads[k])
        self._sent = end


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns its exit status."""
    return run_node(NAME, SynthNode, _prepare, args)


def _prepare(node: SynthNode) -> Callable[[], None]:
    """What plays, with the executor that `rclpy.spin_once` takes made already."""
    rclpy.get_global_executor()
    return node.play
