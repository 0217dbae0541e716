"""The node `odo_align` from outside: topics, diagnostics, and the numbers of a replay."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from node_harness import (
    KEYS,
    LATCHED,
    ODO,
    RELIABLE,
    SYNTH,
    TEXTS,
    Observer,
    arguments,
    observing,
    run_module,
    running,
    stamp_ns,
    stop,
)
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from sensor_msgs.msg import Imu
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from sins_align.rotation import dcm_from_quaternion, log_rotation

pytestmark = [pytest.mark.ros, pytest.mark.slow]

ODOMETER_KEYS = {
    "odometer_scale_error", "odometer_scale_sigma", "odometer_latency_s",
    "odometer_latency_sigma_s",
}  # fmt: skip

SIMULATION = {
    "scenario": "ring", "grade": "fog", "seed": 3, "rate": 100.0, "duration_s": 160.0,
    "odometer_rate_hz": 10.0, "odom_type": "TwistWithCovarianceStamped",
    "odometer_latency_s": 0.1, "odometer_report_variance": True,
}  # fmt: skip
ALIGNMENT = {
    "latitude_deg": 40.0, "longitude_deg": 116.0, "altitude_m": 50.0,
    "imu_grade": "fog",
    "odom_type": "TwistWithCovarianceStamped",
    "heading_threshold_arcmin": 30.0, "level_threshold_arcsec": 120.0, "hold_s": 2.0,
}  # fmt: skip
PUBLISH_RATE_HZ = 10
TOPICS = ("attitude", "misalignment", "mounting", "aligned")


class Run(NamedTuple):
    """A node that has seen everything a simulation has, and still runs."""

    observer: Observer
    process: Any
    result: Path
    truth: dict[str, Any]
    received: dict[str, list[Any]]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    folder = tmp_path_factory.mktemp("run")
    result = folder / "result.json"
    node = {**ALIGNMENT, "publish_rate_hz": float(PUBLISH_RATE_HZ), "result_file": result}
    synth = {"kind": "odo", **SIMULATION, "speed": 0.0, "truth_file": folder / "truth.json"}
    with observing() as observer:
        pose = PoseWithCovarianceStamped
        for message_type, name in zip((Imu, pose, pose), TOPICS[:3], strict=True):
            observer.listen(message_type, f"/odo_align/{name}", RELIABLE)
        observer.listen(Bool, "/odo_align/aligned", LATCHED)
        observer.listen_to_diagnostics()
        with running(ODO, *arguments(node), log=folder / "node.log") as process:
            observer.wait(observer.diagnostics, "diagnostics")
            observer.wait(lambda: observer.received["/odo_align/aligned"], "aligned")
            observer.introduce("odo_align")
            with running(SYNTH, *arguments(synth), log=folder / "synth.log") as player:
                observer.wait(lambda: player.poll() is not None, "the end of align_synth")
                assert player.returncode == 0, (folder / "synth.log").read_text()
            truth = json.loads((folder / "truth.json").read_text())
            for name in ("attitude", "misalignment"):
                observer.wait_for_stamp(f"/odo_align/{name}", truth["stamp_ns"])
            observer.wait(lambda: observer.state == "aligned", "the state aligned")
            yield Run(observer, process, result, truth, observer.received)


def rotation(q: Any) -> np.ndarray:
    return dcm_from_quaternion(np.array([q.w, q.x, q.y, q.z]))


def test_attitude_meets_the_truth_within_its_covariance(run: Run) -> None:
    last = run.received["/odo_align/attitude"][-1]
    assert stamp_ns(last) == run.truth["stamp_ns"]
    C_true = dcm_from_quaternion(np.array(run.truth["q_nb_wxyz"]))
    phi = -log_rotation(rotation(last.orientation) @ C_true.T)
    covariance = last.orientation_covariance.reshape(3, 3)
    assert (np.abs(phi) < 4.0 * np.sqrt(np.diag(covariance))).all()
    assert math.degrees(np.linalg.norm(phi)) < 0.5
    assert last.header.frame_id == "imu"


def test_no_heading_before_its_sigma_is_below_three_degrees(run: Run) -> None:
    attitude = run.received["/odo_align/attitude"]
    stamps = np.array([stamp_ns(message) for message in attitude])
    assert (np.diff(stamps) == 1_000_000_000 // PUBLISH_RATE_HZ).all()
    assert 20.0 < (run.truth["stamp_ns"] - stamps[0]) * 1e-9 < SIMULATION["duration_s"] - 5.0
    for message in attitude:
        assert math.sqrt(message.orientation_covariance[8]) < math.radians(3.0)
        numbers = [*message.orientation_covariance, message.orientation.w]
        numbers += [message.angular_velocity.x, message.linear_acceleration.z]
        assert np.isfinite(numbers).all()


def test_misalignment_carries_the_same_covariance(run: Run) -> None:
    attitude, pose = (
        run.received[f"/odo_align/{name}"][-1] for name in ("attitude", "misalignment")
    )
    assert pose.header.frame_id == "map"
    assert pose.header.stamp == attitude.header.stamp
    assert pose.pose.pose.orientation == attitude.orientation
    block = pose.pose.covariance.reshape(6, 6)[3:, 3:]
    np.testing.assert_array_equal(block.ravel(), attitude.orientation_covariance)


def test_aligned_goes_from_false_to_true(run: Run) -> None:
    assert [message.data for message in run.received["/odo_align/aligned"]] == [False, True]


def test_late_joiner_gets_the_mounting(run: Run) -> None:
    observer = run.observer
    observer.listen(PoseWithCovarianceStamped, "/odo_align/mounting", LATCHED, "late mounting")
    observer.wait(lambda: observer.received["late mounting"], "the mounting")
    message = observer.received["late mounting"][0]
    early = run.received["/odo_align/mounting"]
    observer.wait(lambda: early and early[-1] == message, "the same by the other subscription")
    assert message.header.frame_id == "imu"
    covariance = message.pose.covariance.reshape(6, 6)
    sigma = np.sqrt(np.diag(covariance))
    position = message.pose.pose.position
    error = np.array([position.x, position.y, position.z]) - run.truth["odometer_lever_arm_m"]
    assert (np.abs(error) < 4.0 * sigma[:3]).all()
    # The simulated vehicle is mounted straight. Its roll does not show in a forward speed.
    turned = log_rotation(rotation(message.pose.pose.orientation))
    assert (np.abs(turned[1:]) < 4.0 * sigma[4:]).all()
    assert (sigma[4:] < math.radians(0.5)).all()


def test_diagnostics_say_everything_every_time(run: Run) -> None:
    seen = run.received["/diagnostics"]
    for k, message in enumerate(seen):
        (status,) = message.status
        found = run.observer.diagnostics(k)
        assert set(found) == KEYS | ODOMETER_KEYS
        for key in set(found) - TEXTS:
            assert re.fullmatch(r"unknown|-?\d+(\.\d+)?", found[key]), (key, found[key])
        assert bool(found["reason"]) == (status.level != DiagnosticStatus.OK)
    first = run.observer.diagnostics(0)
    assert seen[0].status[0].level == DiagnosticStatus.ERROR
    assert {first[key] for key in ODOMETER_KEYS} == {"unknown"}
    last = run.observer.diagnostics()
    assert (last["imu_rejected"], last["odom_rejected"]) == ("0", "0")
    for name, true in (
        ("odometer_scale", run.truth["odometer_scale_error"]),
        ("odometer_latency", run.truth["odometer_latency_s"]),
    ):
        value, sigma = [float(last[key]) for key in sorted(ODOMETER_KEYS) if key.startswith(name)]
        assert abs(value - true) < 4.0 * sigma, name


def test_qos_is_that_of_the_interface(run: Run) -> None:
    for topic, reliability, durability in (
        ("/imu", ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE),
        ("/odom", ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE),
        ("/odo_align/attitude", ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE),
        ("/odo_align/mounting", ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL),
        ("/odo_align/aligned", ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL),
    ):
        profile = run.observer.profile("odo_align", topic)
        assert profile.reliability == reliability, topic
        assert profile.durability == durability, topic


def test_live_and_replay_are_bit_identical(run: Run, tmp_path: Path) -> None:
    assert run.observer.call(Trigger, "/odo_align/save").success
    live = json.loads(run.result.read_text())
    flags = {name for name, value in SIMULATION.items() if value is True}
    options = [word for name, value in SIMULATION.items() if name not in flags
               for word in (option(name), str(value))]  # fmt: skip
    options += [option(name) for name in flags]
    made = run_module(
        "sins_align.ros.simulate_command", "odo", *options, "--out", str(tmp_path / "bag")
    )
    assert made.returncode == 0, made.stderr
    overrides = [word for name, value in ALIGNMENT.items() for word in ("-p", f"{name}:={value}")]
    replayed = run_module(
        "sins_align.ros.replay_command", "odo", str(tmp_path / "bag"), "--json", "-", *overrides
    )
    assert replayed.returncode == 0, replayed.stderr
    replay = json.loads(replayed.stdout)
    assert live["input"]["imu_samples"] == 16001
    assert live["input"]["odom_samples"] > 1580
    assert live["mounting_rpy_deg"] is not None
    for document in (live, replay):
        del document["timing"]
    assert live == replay


def option(name: str) -> str:
    return "--" + name.removesuffix("_s").replace("_", "-")


# The last two tests: they end what the others look at.


def test_restart_forgets_everything(run: Run) -> None:
    aligned = run.received["/odo_align/aligned"]
    assert run.observer.call(Trigger, "/odo_align/restart").success
    run.observer.wait(lambda: not aligned[-1].data, "aligned to become false")
    run.observer.wait(lambda: run.observer.state == "waiting", "the state waiting")
    assert run.observer.diagnostics()["odometer_scale_error"] == "unknown"


def test_sigint_ends_with_the_result_written(run: Run) -> None:
    run.result.unlink()
    assert stop(run.process) == 0
    document = json.loads(run.result.read_text())
    assert (document["node"], document["state"]) == ("odo_align", "waiting")
    assert (document["q_nb_wxyz"], document["odometer_scale_error"]) == (None, None)
