"""Start of the nodes: parameters, position, breaks."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from builtin_interfaces.msg import Time
from node_harness import SWING, SYNTH, arguments, observing, run_module, running
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu, NavSatFix

from sins_align.ros.cdr import encode_imu
from sins_align.ros.messages import fix_message
from sins_align.simulate import SwingOptions, simulate_swing
from sins_align.types import ImuSamples, Position

pytestmark = [pytest.mark.ros, pytest.mark.slow]


@pytest.mark.parametrize(
    ("module", "parameter", "words"),
    [
        (SWING, "latitude_deg:=95.0", ["latitude_deg", "-90", "90"]),
        (SWING, "imu_grade:=gold", ["imu_grade", "gold", "tactical"]),
        (SWING, "hold_s:=soon", ["hold_s", "soon"]),
        (SWING, "lever_arm_prior_m:=[1.0, 2.0]", ["lever_arm_prior_m", "3"]),
        (SWING, "holds_s:=3.0", ["holds_s", "unknown"]),
        (SWING, "result_file:=/dev/null/result.json", ["/dev/null/result.json"]),
        (SWING, "initial_result_file:=/dev/null", ["initial_result_file", "/dev/null", "JSON"]),
        (SYNTH, "truth_file:=/dev/null/truth.json", ["/dev/null/truth.json"]),
        (SYNTH, "scenario:=storm", ["scenario", "storm", "still"]),
        (SYNTH, "jitter_s:=0.5", ["stamp_jitter_s"]),
    ],
)
def test_wrong_parameter_is_one_line_and_status_2(
    module: str, parameter: str, words: list[str]
) -> None:
    done = run_module(module, "--ros-args", "-p", parameter)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert all(word in line for word in words), line


def test_an_unknown_argument_is_named() -> None:
    done = run_module(SWING, "--ros-args", "--params", "x.yaml")
    assert done.returncode == 2
    assert "unknown arguments" in done.stderr and "--params" in done.stderr


def test_a_missing_subscriber_is_one_line_and_status_1() -> None:
    done = run_module(
        SYNTH, *arguments({"duration_s": 1.0, "wait_timeout_s": 0.1, "grade": "perfect"})
    )
    assert done.returncode == 1
    assert "0 of 1 subscribers" in done.stderr


def test_position_comes_from_the_fix_and_a_gap_begins_anew(tmp_path: Path) -> None:
    """The observer plays the IMU itself: 3 s, a hole of 2 s, 3 s."""
    imu = simulate_swing(SwingOptions(scenario="still", rate_hz=100.0, duration_s=8.0)).imu
    elapsed = (imu.stamp_ns - imu.stamp_ns[0]) * 1e-9
    broken = imu.select((elapsed < 3.0) | (elapsed >= 5.0))
    # A sample that is not a number, one that repeats, one that is far out of range.
    w_ib_b = broken.w_ib_b.copy()
    w_ib_b[0, 50], w_ib_b[1, 60] = np.nan, 1e4
    stamps = broken.stamp_ns.copy()
    stamps[70] = stamps[69]
    samples = ImuSamples(stamps, w_ib_b, broken.f_ib_b)
    log = tmp_path / "log"
    with observing() as observer, running(SWING, log=log):
        observer.wait_for_diagnostics()
        assert "latitude" in observer.diagnostics()["reason"]
        assert "fix" in observer.diagnostics()["remedy"]
        fix = observer.node.create_publisher(NavSatFix, "/fix", 10)
        publisher = observer.node.create_publisher(Imu, "/imu", 2000)
        observer.listen(Time, "/swing_align/processed", QoSProfile(depth=1))

        # A publisher knows of a subscription before the subscription knows of it: publish
        # until there is an answer.
        def position_taken() -> bool:
            invalid = fix_message(0, Position(0.1), "gnss")
            invalid.status.status = -1
            fix.publish(invalid)
            fix.publish(fix_message(0, Position(math.radians(40.0)), "gnss"))
            return "position from topic fix" in log.read_text()

        def sample_taken() -> bool:
            publisher.publish(payloads[0])
            return bool(observer.received["/swing_align/processed"])

        payloads = [bytes(payload) for payload in encode_imu(samples, "imu")]
        observer.wait(position_taken, "the position")
        observer.wait(sample_taken, "the first sample")
        for payload in payloads[1:]:
            publisher.publish(payload)
        observer.wait(lambda: "the alignment began anew" in log.read_text(), "the restart")
        observer.wait(
            lambda: "began_anew" in observer.diagnostics()["reason_keys"],
            "the reason in diagnostics",
        )
        assert int(observer.diagnostics()["imu_rejected"]) >= 3
    assert "40.000000 deg" in log.read_text()
    assert log.read_text().count("the alignment began anew: 2.0 s without IMU data") == 1
