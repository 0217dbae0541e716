"""What the node `odo_align` makes of its odometer: types, values, silence, wrong parameters."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticStatus
from node_harness import (
    ODO,
    SYNTH,
    Player,
    arguments,
    observing,
    run_module,
    running,
)

from sins_align.ros.bags_topics import KINDS
from sins_align.ros.odometer import OdometerRow
from sins_align.ros.portable_messages import odometer_message, ros_types
from sins_align.simulate import VehicleOptions, simulate_vehicle

pytestmark = [pytest.mark.ros, pytest.mark.slow]

PLACE = {"latitude_deg": 40.0, "imu_grade": "fog"}
T0 = 1_700_000_000_000_000_000


def short(message_type: str) -> str:
    return message_type.rpartition("/")[2]


@pytest.mark.parametrize(
    ("module", "parameters", "words"),
    [
        (ODO, {"odom_type": "Twist"}, ["odom_type", "TwistStamped", "Odometry"]),
        (ODO, {"aiding": "wheels"}, ["aiding", "stationary"]),
        (ODO, {"odometer_scale_sigma": -1.0}, ["odometer_scale_sigma"]),
        (ODO, {"lever_arm_prior_sigma_m": 1.0}, ["lever_arm_prior_sigma_m", "unknown"]),
        (SYNTH, {"kind": "fly"}, ["kind", "swing, odo"]),
        (SYNTH, {"kind": "odo", "scenario": "pitch"}, ["scenario", "moving_start"]),
        (SYNTH, {"kind": "odo", "dropouts": "[1.0]"}, ["dropouts", "pairs"]),
        (SYNTH, {"odometer_latency_s": 0.1}, ["odometer_latency_s", "unknown"]),
    ],
)
def test_wrong_parameter_is_one_line_and_status_2(
    module: str, parameters: dict[str, Any], words: list[str]
) -> None:
    done = run_module(module, *arguments(parameters))
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert all(word in line for word in words), line


@pytest.mark.parametrize("message_type", KINDS["odom"])
def test_every_type_is_taken_and_what_cannot_be_is_counted(
    tmp_path: Path, message_type: str
) -> None:
    parameters = {**PLACE, "odom_type": short(message_type)}
    with observing() as observer, running(ODO, *arguments(parameters), log=tmp_path / "log"):
        observer.listen_to_diagnostics()
        publisher = observer.node.create_publisher(ros_types(message_type), "/odom", 10)
        row = OdometerRow(T0, math.nan, 0.0)

        def is_refused() -> bool:
            publisher.publish(odometer_message(ros_types, message_type, row, "axle"))
            return int(observer.diagnostics().get("odom_rejected", 0)) > 0

        observer.wait(is_refused, "the count of what was refused")
    assert "Traceback" not in (tmp_path / "log").read_text()


def test_another_type_on_the_topic_is_said(tmp_path: Path) -> None:
    node = arguments({**PLACE, "odom_type": "TwistStamped"})
    with observing() as observer, running(ODO, *node, log=tmp_path / "log"):
        observer.listen_to_diagnostics()
        publisher = observer.node.create_publisher(ros_types("nav_msgs/msg/Odometry"), "/odom", 10)
        observer.wait(lambda: "odom_type" in observer.diagnostics().get("remedy", ""), "the remedy")
        reason = observer.diagnostics()["reason"]
        assert "nav_msgs/msg/Odometry" in reason and "TwistStamped" in reason
        observer.node.destroy_publisher(publisher)
        observer.wait(lambda: "odom_type" not in observer.diagnostics()["remedy"], "its end")


def test_a_silent_odometer_is_a_warning_with_a_remedy(tmp_path: Path) -> None:
    run = simulate_vehicle(VehicleOptions(scenario="static", rate_hz=50.0, duration_s=12.0))
    with observing() as observer, running(ODO, *arguments(PLACE), log=tmp_path / "log"):
        observer.listen_to_diagnostics()
        Player(observer, "odo_align").play(run.imu)
        observer.wait(observer.diagnostics, "diagnostics")
        observer.wait(lambda: "no odometer" in observer.diagnostics()["reason"], "the reason")
        status = observer.received["/diagnostics"][-1].status[0]
        assert status.level in (DiagnosticStatus.WARN, DiagnosticStatus.ERROR)
        found = observer.diagnostics()
        assert "odom" in found["remedy"] and "stationary" in found["remedy"]
        assert found["sigma_heading_arcmin"] == "unknown"
