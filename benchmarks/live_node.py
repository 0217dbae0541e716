"""CPU time of the live node beside that of an empty rclpy callback, and loss, at 1 kHz.

Both subscribe to the same publisher in the same run, so that they see the same machine.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
RATE_HZ = 1000

EMPTY_SUBSCRIBER = """
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu

rclpy.init()
node = rclpy.create_node("empty_subscriber")
qos = QoSProfile(depth=2000, reliability=ReliabilityPolicy.BEST_EFFORT)
node.create_subscription(Imu, "imu", lambda message: None, qos)
executor = SingleThreadedExecutor()
executor.add_node(node)
try:
    executor.spin()
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""


def cpu_s(process: subprocess.Popen[bytes]) -> float:
    """User and system time of a running process [s]."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def settled_cpu_s(processes: Sequence[subprocess.Popen[bytes]]) -> list[float]:
    """CPU times when all of them have started and come to rest [s]."""
    last = [0.0] * len(processes)
    while True:
        time.sleep(1.0)
        now = [cpu_s(process) for process in processes]
        if all(0.2 < n < b + 0.05 for n, b in zip(now, last, strict=True)):
            return now
        last = now


def measure_live(duration_s: float = 60.0, executor: str = "single") -> dict[str, float]:
    """Run node, empty subscriber and publisher; per-sample CPU [us], their ratio, and loss."""
    environment = dict(
        os.environ,
        PYTHONPATH=str(ROOT),
        ROS_DOMAIN_ID=str(1 + os.getpid() % 100),
        ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
        OPENBLAS_NUM_THREADS="1",
    )

    def start(*command: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, *command], env=environment, stderr=subprocess.DEVNULL
        )

    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result.json"
        node = start(
            "-m", "swing_align_ros", "--ros-args", "-p", "latitude_deg:=40.0",
            "-p", f"result_file:={result}", "-p", f"executor:={executor}",
        )  # fmt: skip
        empty = start("-c", EMPTY_SUBSCRIBER)
        both = (node, empty)
        try:
            begin = settled_cpu_s(both)  # what the start costs counts for neither
            synth = start(
                "-m", "sins_align.ros.synth_command", "--ros-args", "-p", f"rate:={RATE_HZ}.0",
                "-p", f"duration_s:={duration_s}", "-p", "wait_for_subscribers:=2",
            )  # fmt: skip
            synth.wait(timeout=duration_s + 120)
            end = [cpu_s(process) for process in both]
        finally:
            for process in both:
                process.send_signal(signal.SIGINT)
            for process in both:
                process.wait(timeout=20)
        received = json.loads(result.read_text())["input"]["imu_samples"]
    samples = int(duration_s * RATE_HZ) + 1
    node_us, empty_us = (1e6 * (e - b) / samples for b, e in zip(begin, end, strict=True))
    return {
        "samples": samples,
        "lost": samples - received,
        "node_us": node_us,
        "empty_callback_us": empty_us,
        "ratio": node_us / empty_us,
    }


if __name__ == "__main__":
    for key, value in measure_live(*map(float, sys.argv[1:2])).items():
        print(f"{key:20s} {value:10.3f}")
