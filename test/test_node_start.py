"""Start of the nodes: parameters, position, breaks."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from node_harness import (
    SWING,
    SYNTH,
    THRESHOLDS,
    Player,
    arguments,
    observing,
    pitching,
    run_module,
    running,
)
from sensor_msgs.msg import NavSatFix
from std_srvs.srv import Trigger

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
        observer.wait(fix.get_subscription_count, "the subscription of the fix")
        player = Player(observer)  # from now on the node knows of both
        invalid = fix_message(0, Position(0.1), "gnss")
        invalid.status.status = -1
        fix.publish(invalid)
        fix.publish(fix_message(0, Position(math.radians(40.0)), "gnss"))
        observer.wait(lambda: "position from topic fix" in log.read_text(), "the position")
        player.play(samples)
        observer.wait(lambda: "the alignment began anew" in log.read_text(), "the restart")
        observer.wait(
            lambda: "began_anew" in observer.diagnostics()["reason_keys"],
            "the reason in diagnostics",
        )
        assert int(observer.diagnostics()["imu_rejected"]) == 3
    assert "40.000000 deg" in log.read_text()
    assert log.read_text().count("the alignment began anew: 2.0 s without IMU data") == 1


def test_silence_is_in_the_log_and_no_time_to_go_is_told(tmp_path: Path) -> None:
    """What has been told with the samples that came is void when no more do."""
    log, parameters = tmp_path / "log", {**THRESHOLDS, "latitude_deg": 40.0}
    with observing() as observer, running(SWING, *arguments(parameters), log=log):
        observer.wait_for_diagnostics()
        Player(observer).play(pitching(12.0))
        observer.wait(
            lambda: "imu_silent" in observer.diagnostics()["reason_keys"], "the IMU's silence"
        )
        silent = observer.diagnostics()
        assert "heading_sigma" in silent["reason_keys"] and silent["eta_s"] == "unknown"
    assert log.read_text().count("no usable IMU data for") == 1


def test_align_synth_plays_twice_to_one_node_and_loses_nothing(tmp_path: Path) -> None:
    """What the node took of the first time is no leave to send all of the second at once."""
    node = arguments({"latitude_deg": 40.0, "result_file": tmp_path / "result.json"})
    synth = {"rate": 200.0, "duration_s": 20.0, "grade": "perfect", "speed": 0.0}
    with observing() as observer, running(SWING, *node, log=tmp_path / "log"):
        for count in (4001, 8002):
            done = run_module(SYNTH, *arguments(synth))
            assert done.returncode == 0, done.stderr
            assert observer.call(Trigger, "/swing_align/save").success
            found = json.loads((tmp_path / "result.json").read_text())["input"]
            taken = found["imu_samples"] + found["imu_rejected"]
            assert (taken, found["imu_gaps"]) == (count, 0)
